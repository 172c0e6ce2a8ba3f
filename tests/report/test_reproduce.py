"""`datagen reproduce`: figures, a page and numbers, all files or none; what of the paper another room keeps."""

from __future__ import annotations

import json
import re
from pathlib import Path

import numpy as np
import pytest

import datagen as dg
from datagen.cli import run
from datagen.config import load_config
from datagen.errors import InputError
from datagen.paper import reproduce as command
from datagen.paper.reproduce import peak_ns
from datagen.paper.runs import PEAKS_NS, Sizes, component_curves

ROOT = Path(__file__).parents[2]
CONFIG = ROOT / "configs" / "demonstration_room.yaml"
TINY = Sizes(rays=(4, 9), pixels=12, target=0.05)
pytestmark = pytest.mark.usefixtures("coarse")

IMAGES = {"figure_3.png", "figure_5.png", "figure_7.png", "figure_9.png"}


@pytest.fixture
def stopped(monkeypatch: pytest.MonkeyPatch) -> None:
    def stop(*_: object) -> None:
        raise InputError("stopped on the way")

    monkeypatch.setattr(command, "run_all", stop)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """By the command, with still fewer rays than `--quick`."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(command, "QUICK", TINY)
        out = tmp_path_factory.mktemp("reproduce") / "new" / "paper"
        assert run(["reproduce", str(out), "--quick", "--quiet"]) == 0
    return out


def test_one_folder_holds_page_pictures_and_numbers(folder: Path) -> None:
    assert {path.name for path in folder.iterdir()} == {"index.html", "numbers.json"} | IMAGES
    assert [path.name for path in folder.parent.iterdir()] == ["paper"]
    page, found = (folder / "index.html").read_text(), json.loads((folder / "numbers.json").read_text())
    for image in IMAGES:
        assert (folder / image).read_bytes()[:4] == b"\x89PNG" and f'src="{image}"' in page
    for name in PEAKS_NS:
        assert f"peak of {name}, ns" in page
    # Of the coarser grid no ray meets box or pillar.
    assert "nan" not in re.sub(r"<[^>]*>", " ", page).lower().split() and "not measured: no ray met it" in page
    cases = found["cases"]
    assert {f"{kind}, {rays}, {scheme}" for kind in ("as printed", "radiometric") for rays in TINY.rays
            for scheme in ("all", "strongest")} | {"converged, 0, all"} <= set(cases)  # fmt: skip
    assert all(case["processor_s"] > 0 for case in cases.values())
    assert len(found["time_ns"]) == 1001
    assert np.argmax(cases["converged, 0, all"]["curves"]["box"]) == pytest.approx(250, abs=4)


@pytest.mark.usefixtures("stopped")
def test_an_earlier_reproduction_and_other_files_are_kept(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    before = (folder / "index.html").read_bytes()
    assert run(["reproduce", str(folder), "--quick"]) == 2
    assert capsys.readouterr().err == "datagen: stopped on the way\n"
    assert (folder / "index.html").read_bytes() == before
    assert [path.name for path in folder.parent.iterdir()] == ["paper"]
    (folder.parent / "notes.txt").write_text("mine")
    assert run(["reproduce", str(folder.parent), "--quick"]) == 2
    assert "holds other files" in capsys.readouterr().err
    (folder.parent / "notes.txt").unlink()


@pytest.mark.usefixtures("stopped")
@pytest.mark.parametrize("place", ["file/below", "new/deep/out"])
def test_a_failure_leaves_nothing(place: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "file").write_text("mine")
    assert run(["reproduce", str(tmp_path / place), "--quiet"]) == 2
    message = capsys.readouterr().err
    assert message.count("\n") == 1 and "Traceback" not in message
    assert [path.name for path in tmp_path.iterdir()] == ["file"]


@pytest.mark.parametrize(
    ("change", "why"),
    [
        ("points_m: [[6, 0, 2.5], [6, 0, 2]]", "2 laser points"),
        ("relay_wall: {albedo: 1, brdf: {kind: phong}}", "Phong is no BRDF of the paper"),
        ("relay_wall: {albedo: 1, brdf: {kind: sin_lobe}}", "SinLobe does not factorise"),
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
