"""`datagen reproduce`: measurements that mean what they say, verdicts that follow the numbers, all files or none."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import datagen as dg
from datagen.cli import run
from datagen.config import config_from_mapping, load_config
from datagen.errors import InputError
from datagen.paper import reproduce as command
from datagen.paper.envelopes import component_curves
from datagen.paper.lookin_balance import lookin_balance
from datagen.paper.measures import (
    PEAKS_NS,
    best_copy,
    exceeds_from_ns,
    mean_ns,
    peak_ns,
    roughness,
    shape_difference,
    width_ns,
)
from datagen.paper.page import times
from datagen.paper.runs import QUICK, Runs, Simulation, run_all
from datagen.paper.statements import Statement, statements_of

ROOT = Path(__file__).parents[2]
CONFIG = ROOT / "configs" / "demonstration_room.yaml"
TINY = replace(QUICK, rays=(6, 9), pixels=12, reference=1 << 13, seeds=3, sweep=(4, 8), sweep_pixels=8)
IMAGES = {"figure_3.png", "figure_5.png", "figure_7.png", "figure_9.png"}


def test_measures_on_curves_with_known_answers() -> None:
    time = np.arange(400) * 0.1
    bell = np.exp(-0.5 * ((time - 12) / 0.8) ** 2)
    assert peak_ns(bell, time) == pytest.approx(12) and mean_ns(bell, time) == pytest.approx(12)
    assert width_ns(bell, time, 0.5) == pytest.approx(2.355 * 0.8, abs=0.2)
    assert shape_difference(3 * bell, bell) == pytest.approx(0) and roughness(bell) == pytest.approx(
        roughness(7 * bell)
    )
    comb = bell * (np.arange(400) % 4 == 0)
    assert roughness(comb) > 10 * roughness(bell)
    moved = 0.02 * np.concatenate([np.zeros(37), bell[:-37]])
    assert best_copy(bell, moved)[:2] == (37, pytest.approx(0.02)) and best_copy(bell, moved)[2] < 1e-6
    two = np.exp(-0.5 * ((time - 25) / 0.4) ** 2)
    assert best_copy(bell + two, two + np.roll(bell, 150))[2] > 0.3
    assert exceeds_from_ns(moved, bell, time) == pytest.approx(time[np.flatnonzero(moved <= bell)[-1] + 1])
    assert np.isnan(exceeds_from_ns(bell * 1e-3, bell, time)) and np.isnan(peak_ns(0 * bell, time))


@pytest.fixture(scope="module")
def reproduction(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Runs]:
    """By the command, with still fewer rays than `--quick`: its folder, and the runs that it made."""
    made: list[Runs] = []

    def recorded(*arguments: Any) -> Runs:
        made.append(run_all(*arguments))
        return made[-1]

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(command, "QUICK", TINY)
        patch.setattr(command, "run_all", recorded)
        out = tmp_path_factory.mktemp("reproduce") / "new" / "paper"
        assert run(["reproduce", str(out), "--quick", "--quiet"]) == 0
    return out, made[0]


@pytest.fixture(scope="module")
def folder(reproduction: tuple[Path, Runs]) -> Path:
    return reproduction[0]


@pytest.fixture(scope="module")
def runs(reproduction: tuple[Path, Runs]) -> Runs:
    return reproduction[1]


def statements(runs: Runs) -> dict[str, Statement]:
    balance = lookin_balance(runs.scene, runs.capture, runs.sparse, runs.sizes.pixels, 1e-3)
    return {statement.key: statement for statement in statements_of(runs, balance)}


def test_one_folder_holds_page_pictures_and_numbers(folder: Path) -> None:
    assert {path.name for path in folder.iterdir()} == {"index.html", "numbers.json"} | IMAGES
    assert [path.name for path in folder.parent.iterdir()] == ["paper"]
    page, found = (folder / "index.html").read_text(), json.loads((folder / "numbers.json").read_text())
    for image in IMAGES:
        assert (folder / image).read_bytes()[:4] == b"\x89PNG" and f'src="{image}"' in page
    for statement in found["statements"]:
        for kind in ("printed", "radiometric"):
            assert statement[kind]["numbers"].split(" ns")[0] in page.replace("&#x27;", "'")
    cases = found["cases"]
    assert {f"{kind}, {rays}, {scheme}" for kind in ("as printed", "radiometric") for rays in TINY.rays
            for scheme in ("all", "strongest")} | {"converged, 0, all"} <= set(cases)  # fmt: skip
    assert all(case["processor_s"] > 0 for case in cases.values())
    assert len(found["time_ns"]) == 1001
    assert np.argmax(cases["converged, 0, all"]["curves"]["box"]) == pytest.approx(250, abs=4)


def test_an_earlier_reproduction_is_replaced_and_other_files_are_not(
    folder: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    before = (folder / "index.html").read_bytes()

    def stop(*_: object) -> None:
        raise InputError("stopped on the way")

    monkeypatch.setattr(command, "run_all", stop)
    assert run(["reproduce", str(folder), "--quick"]) == 2
    assert capsys.readouterr().err == "datagen: stopped on the way\n"
    assert (folder / "index.html").read_bytes() == before
    assert [path.name for path in folder.parent.iterdir()] == ["paper"]
    (folder.parent / "notes.txt").write_text("mine")
    assert run(["reproduce", str(folder.parent), "--quick"]) == 2
    assert "holds other files" in capsys.readouterr().err
    (folder.parent / "notes.txt").unlink()


@pytest.mark.parametrize("place", ["file", "file/below", "new/deep/out"])
def test_a_failure_leaves_nothing(
    place: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "file").write_text("mine")

    def stop(*_: object) -> None:
        raise InputError("stopped on the way")

    monkeypatch.setattr(command, "run_all", stop)
    assert run(["reproduce", str(tmp_path / place), "--quiet"]) == 2
    message = capsys.readouterr().err
    assert message.count("\n") == 1 and "Traceback" not in message
    assert [path.name for path in tmp_path.iterdir()] == ["file"]


@pytest.mark.parametrize(
    ("change", "why"),
    [
        ("points_m: [[6, 0, 2.5], [6, 0, 2]]", "2 laser points"),
        ("relay_wall: {albedo: 1, brdf: {kind: phong}}", "Phong is no BRDF of the paper"),
    ],
)
def test_rooms_that_the_paper_could_not_compute_are_refused(
    change: str, why: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    key = change.partition(":")[0]
    text = CONFIG.read_text()
    old = next(line for line in text.splitlines() if f"{key}:" in line and "{" in line)
    start = old.index(f"{key}:")
    end = old.index("]]") + 2 if key == "points_m" else old.index("}") + 1
    (tmp_path / "room.yaml").write_text(text.replace(old, old[:start] + change + old[end:]))
    assert run(["reproduce", str(tmp_path / "out"), "--config", str(tmp_path / "room.yaml"), "--quiet"]) == 2
    assert why in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


def test_published_times_stand_beside_ours_at_the_papers_counts(runs: Runs) -> None:
    names = dict(zip(TINY.rays, (10, 45), strict=True))
    cases = {(kind, names.get(rays, rays), scheme): case for (kind, rays, scheme), case in runs.cases.items()}
    text = "".join(times(replace(runs, sizes=replace(TINY, rays=(10, 45), pixels=60), cases=cases)))
    for published in ("≈ 1 hour", "&lt; 30 s", "3 h 34 min 16 s", "2 min 00 s"):
        assert published in text
    assert f"{runs.case('as printed', runs.sparse).seconds:.2f}" in text
    assert "hour" not in "".join(times(runs))


def test_verdicts_follow_the_numbers(runs: Runs) -> None:
    found = statements(runs)
    assert found["minor"].printed.holds and found["minor"].radiometric.holds is False
    metres, millimetres = runs.in_metres[runs.sparse], runs.case("as printed", runs.sparse)
    assert metres.level["primary"] / millimetres.level["primary"] == pytest.approx(1e12, rel=1e-6)
    assert metres.ratio / millimetres.ratio == pytest.approx(1e6, rel=1e-6)
    assert found["unit"].printed.holds is False and found["unit"].radiometric.holds
    assert found["later"].printed.holds and found["later peak"].radiometric.holds
    case = runs.case("converged")
    faint = _with_secondary(case, 0.01)
    other = replace(runs, cases={**runs.cases, ("converged", 0, "all"): faint})
    assert statements(other)["minor"].radiometric.holds
    early = replace(case.curves, parts={n: np.roll(c, -20) for n, c in case.curves.parts.items()})
    moved = replace(runs, cases={**runs.cases, ("converged", 0, "all"): replace(case, curves=early)})
    assert statements(moved)["peaks"].radiometric.holds is False
    swapped = dict(zip(case.curves.parts, reversed(case.curves.parts.values()), strict=True))
    wrong = replace(case, curves=replace(case.curves, parts=swapped))
    assert (
        statements(replace(runs, cases={**runs.cases, ("converged", 0, "all"): wrong}))["order"].radiometric.holds
        is False
    )
    assert statements(replace(runs, in_metres={runs.sparse: millimetres}))["ratio unit"].printed.holds


def _with_secondary(case: Simulation, factor: float) -> Simulation:
    orders = {**case.curves.orders, "secondary": factor * case.curves.orders["secondary"]}
    level = {**case.level, "secondary": factor * case.level["secondary"]}
    return replace(case, curves=replace(case.curves, orders=orders), level=level)


def test_indirect_light_in_a_white_sphere_is_what_theory_says() -> None:
    """Inside a Lambertian sphere every bounce lights all of it evenly: indirect irradiance after one more bounce is
    albedo times the direct, at every lookin (a closed form)."""
    import trimesh

    sphere = trimesh.creation.icosphere(subdivisions=4, radius=2.0)
    scene = dg.Scene.from_parts([dg.Part("sphere", sphere, dg.Lambertian(0.6))])
    capture = dg.Capture(
        dg.Laser((0, 0, 0), [(2, 0.1, 0.2)]),
        dg.Sensor((0, 0, 0), [[(2, -0.1, -0.1), (2, 0.1, -0.1), (2, 0.1, 0.1), (2, -0.1, 0.1)]]),
        dg.TimeAxis(100, 1e-9),
    )
    balance = lookin_balance(scene, capture, 5, 40, 1e-3)
    assert balance.irradiance is not None and len(balance.irradiance) == 25
    # Facets light their neighbours too little or too much: lookins near the laser point stray.
    assert np.median(balance.irradiance) == pytest.approx(0.6, rel=0.01)
    assert (np.abs(balance.irradiance / 0.6 - 1) < 0.03).mean() > 0.6
    assert balance.least_detour_m > 0


def test_another_layout_has_the_published_peaks_by_the_printed_weights() -> None:
    """The paper gives no plan, and its peaks do not fix one."""
    values = load_config(CONFIG).model_dump(mode="json")
    values["scene"]["layout"]["height_m"] = 3.0
    for content in values["scene"]["contents"]:
        content |= {"box": {"height_m": 2.2}, "pillar": {"across": 0.7}}[content["kind"]]
    config = config_from_mapping(values)
    scene = dg.generate_scene(config.scene, config.seed, 0)
    capture = dg.capture_for(config, scene)
    transient = dg.simulate_as_printed(scene, capture, dg.AsPrinted(45, 20))
    curves = component_curves(config, scene, capture, transient)
    for name, published in PEAKS_NS.items():
        assert abs(peak_ns(curves.parts[name], curves.time_ns) - published) <= 0.31, name
    walls, box, pillar = (curves.parts[name].max() for name in PEAKS_NS)
    assert walls > box > 100 * pillar


def test_the_strongest_paths_keep_the_place_of_the_printed_secondary() -> None:
    config = load_config(CONFIG)
    scene = dg.generate_scene(config.scene, config.seed, 0)
    capture = dg.capture_for(config, scene)
    full, one = (
        component_curves(config, scene, capture, dg.simulate_as_printed(scene, capture, dg.AsPrinted(secondary=k)))
        for k in ("all", "strongest")
    )
    primary, time = np.sum(list(full.parts.values()), axis=0), full.time_ns
    every, strongest = full.orders["secondary"], one.orders["secondary"]
    assert abs(peak_ns(every, time) - peak_ns(strongest, time)) <= 0.31
    assert peak_ns(strongest, time) > peak_ns(primary, time) + 1
    assert strongest.max() < every.max() < 0.1 * primary.max()


def test_the_room_in_the_package_is_the_one_in_configs() -> None:
    assert command.ROOM.read_bytes() == CONFIG.read_bytes()
