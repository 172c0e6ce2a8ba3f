"""Foreign scenes are a function of their number; their truth has no bias; a transient that is wrong is found out."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh
from benchmarks import promise
from benchmarks.foreign_scenes import foreign_scene, mesh_files
from benchmarks.promise import WHOLE, case_of, checks_of, foreign_case, line_of, off_square

from datagen.config import load_config
from datagen.errors import InputError
from datagen.exit_status import guarded
from datagen.records import Capture, Scene, Transient

ROOT = Path(__file__).parents[2]
MESHES = ROOT.parent / "shared" / "meshes"
SIMPLE = 3
"""A scene of a few histograms for which 2¹⁶ samples are accurate enough."""


def test_scenes_are_functions_of_their_numbers_and_span_what_is_said(tmp_path: Path) -> None:
    """Every BRDF, shape, scan and surrounding; pixels of 2 mm to 20 cm, bins of 20 to 300 ps; meshes of a folder."""
    drawn = [foreign_scene(index) for index in range(100)]
    again = foreign_scene(5)
    assert np.array_equal(drawn[5].scene.vertices, again.scene.vertices)
    assert drawn[5].scene.materials == again.scene.materials != drawn[6].scene.materials
    assert {one.scan for one in drawn} == {"confocal", "exhaustive", "array"}
    assert {one.surroundings for one in drawn} == {"open", "floor", "room"}
    assert {one.max_bounces for one in drawn} == {3, 4}
    assert len({brdf for one in drawn for brdf in one.brdfs.values()}) == 6
    assert len({shape for one in drawn for shape in one.shapes.values()}) == 11
    sides = [np.ptp(one.capture.sensor.pixels[0], axis=0).max() for one in drawn]
    assert 0.0019 < min(sides) < 0.01 and 0.1 < max(sides) < 0.21
    widths = [one.capture.time.width_s for one in drawn]
    assert 20e-12 <= min(widths) < 30e-12 and 200e-12 < max(widths) <= 300e-12
    with pytest.raises(InputError, match="--meshes"):
        mesh_files(tmp_path)
    trimesh.creation.capsule().export(tmp_path / "mine.stl")
    assert 5 < sum("mine.stl" in foreign_scene(index, tmp_path).shapes.values() for index in range(20)) < 20


def test_the_square_of_an_error_has_no_bias() -> None:
    """Runs with noise of half or ten times the error: the mean of 400 trials is its square (level 10⁻³), and the
    standard error that is said is that of the trials."""
    rng, bins, runs = np.random.default_rng(1), 500, 8
    true = rng.uniform(0, 1, bins)
    ours = true + 0.1
    for noise in (0.05, 1.0):
        trials = np.array([off_square(ours, true + rng.normal(0, noise, (runs, bins))) for _ in range(400)])
        square, known = trials[:, 0], trials[:, 1]
        assert abs(square.mean() - 0.01 * bins) < 3.3 * square.std(ddof=1) / 20
        assert np.sqrt((known**2).mean()) == pytest.approx(square.std(ddof=1), rel=0.3)


@pytest.fixture(scope="module")
def few_samples() -> Iterator[None]:
    """Few samples of the truth, each run of it drawn once for all tests."""
    drawn, kept = promise.reference, dict[tuple[Any, ...], Transient]()

    def once(scene: Scene, capture: Capture, **how: Any) -> Transient:
        key = scene.vertices.tobytes(), how["samples"], how["seed"]
        if key not in kept:
            kept[key] = drawn(scene, capture, **how)
        return kept[key]

    with pytest.MonkeyPatch.context() as patch:
        for name, small in (("FIRST_SAMPLES", 1 << 17), ("MOST_SAMPLES", 1 << 20), ("reference", once)):
            patch.setattr(promise, name, small)
        yield


@pytest.mark.usefixtures("few_samples")
def test_a_wrong_transient_is_found_out(monkeypatch: pytest.MonkeyPatch) -> None:
    """All light a bin late, under a claim of 5 %; as it is, it is within."""
    plainly, case = promise._simulated, foreign_case(SIMPLE)
    (right,) = [one for one in checks_of(case, [0.05]) if one.what == WHOLE]
    assert right.decided and right.within and right.promised and not right.overclaimed
    assert right.energy == pytest.approx(1, abs=0.02)

    def late(run: Transient) -> Transient:
        return replace(run, components={name: np.roll(light, 1, axis=2) for name, light in run.components.items()})

    monkeypatch.setattr(promise, "_simulated", lambda light: late(plainly(light)))
    (wrong,) = [one for one in checks_of(case, [0.05], f"--first {SIMPLE}") if one.what == WHOLE]
    assert wrong.promised and wrong.decided and not wrong.within and wrong.overclaimed
    assert f"--first {SIMPLE} --target 0.05" in line_of(wrong)


def test_few_points_of_a_configuration_stand_for_all(monkeypatch: pytest.MonkeyPatch) -> None:
    """The error of the whole at 4 of 16 points is that at all of them to a factor of two, and so is the light."""
    for name, small in (("FIRST_SAMPLES", 1 << 18), ("MOST_SAMPLES", 1 << 18)):
        monkeypatch.setattr(promise, name, small)
    config = load_config(ROOT / "configs" / "quickstart.yaml")
    case = case_of(config, 0, points=16)
    few, every = (checks_of(replace(case, held=held), [0.1])[0] for held in (4, None))
    assert few.what == every.what == WHOLE and few.claimed == every.claimed
    assert 0.5 < few.error / every.error < 2
    assert few.energy == pytest.approx(1, abs=0.1) and every.energy == pytest.approx(1, abs=0.1)


@pytest.mark.usefixtures("few_samples")
def test_by_the_command_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """What was measured is kept; configurations without a target promise nothing; bad calls are told in a line."""
    printed = []
    for _ in range(2):
        arguments = [str(tmp_path), "--foreign", "1", "--first", str(SIMPLE), "--target", "0.1"]
        assert guarded(promise.main, arguments) == 0
        printed.append(capsys.readouterr().out)
    assert printed[0] == printed[1] and "1 foreign scenes" in printed[0]
    assert (tmp_path / "foreign.md").read_text().startswith("1 foreign scenes")
    scan = "capture: {pairing: confocal, scan: {rows: 3, columns: 3}, time: {bins: 108, bin_width_ps: 800}}"
    (tmp_path / "fixed.yaml").write_text(f"{scan}\ntransport: {{lookins: 256, fov_samples: 1}}")
    (tmp_path / "held.yaml").write_text(f"{scan}\ntransport: {{target: 0.1}}")
    configs = [str(tmp_path / f"{name}.yaml") for name in ("held", "fixed")]
    assert guarded(promise.main, [str(tmp_path), *configs, "--scenes", "1", "--points", "4", "--target", "0.1"]) == 0
    rows = [line.split(" | ") for line in capsys.readouterr().out.splitlines() if line.startswith("| whole ")]
    assert rows[0][1:3] == ["0.1", "1"]
    for wrong in (["--foreign", "0"], ["--foreign", "1", "a.yaml"], ["--meshes", "x"], []):
        assert guarded(promise.main, [str(tmp_path), *wrong]) == 2
        assert "--foreign" in capsys.readouterr().err


BROKEN = {
    6101: 0.02, 6104: 0.02, 6128: 0.05, 6145: 0.02, 6160: 0.02, 6193: 0.02, 6234: 0.02, 6274: 0.02, 6289: 0.05,
    6308: 0.02,
}  # fmt: skip
"""Foreign scene → target at which an error once was several times its claim: retroreflecting meshes before pixels as
wide as the lobe, plates behind others, meshes that shade each other, a floor nearly a mirror, light of four bounces
between small objects."""


@pytest.mark.nightly
@pytest.mark.parametrize("index", BROKEN)
def test_scenes_that_once_broke_their_claims_keep_them(index: int) -> None:
    if not (MESHES / "stanford-bunny.obj").is_file():
        pytest.skip("real meshes are not part of the repository; put them into shared/meshes beside the checkout")
    checks = checks_of(foreign_case(index, MESHES), [BROKEN[index]])
    assert not [line_of(one) for one in checks if one.overclaimed]
