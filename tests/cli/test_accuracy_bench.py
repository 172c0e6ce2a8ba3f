"""`datagen bench accuracy`: its arithmetic against cases with known answers, and the command on a tiny scan."""

from __future__ import annotations

import json
import math
from pathlib import Path

import numpy as np
import pytest

from datagen.bench.accuracy import run as run_bench
from datagen.bench.accuracy_measure import (
    Problem,
    Reference,
    Row,
    Truth,
    fewer_laser_points,
    inner,
    measure,
    wider,
    with_front,
)
from datagen.bench.accuracy_report import advice, table
from datagen.bench.accuracy_settings import FACTORS, Setting
from datagen.capture import capture_for
from datagen.cli import run
from datagen.config import load_config
from datagen.scene import generate_scene
from datagen.transport.binning import splat

ROOT = Path(__file__).resolve().parents[2]
CONFIG = """
name: tiny
scenes: 2
capture: {pairing: confocal, scan: {rows: 3, columns: 3}, time: {bins: 108, bin_width_ps: 800}}
transport: {lookins: 256, fov_samples: 1}
detector: {photons_per_pulse: 1000.0}
"""


@pytest.mark.parametrize("times", [1, 3, 9])
def test_narrow_bins_give_wide_ones_exactly(times: int) -> None:
    """Paths put into narrow bins and widened, against the same paths put into wide bins."""
    rng = np.random.default_rng(1)
    narrow, wide = np.zeros(135), np.zeros(135 // times)
    for position, energy in zip(rng.uniform(0, 135, 500), rng.random(500), strict=True):
        splat(narrow, position, energy)
        splat(wide, position / times, energy)
    assert np.allclose(inner(wider(narrow, times)), inner(wide), rtol=0, atol=1e-12)


def noisy(truth: np.ndarray, noise: float, rng: np.random.Generator) -> np.ndarray:
    return truth + noise * np.linalg.norm(truth) / math.sqrt(truth.size) * rng.standard_normal(truth.shape)


def test_the_references_own_error_is_subtracted() -> None:
    """Halves with 20 % noise each, a run with 30 %: the error found is 30 %, not √(30² + 20²/2) %."""
    rng = np.random.default_rng(2)
    exact = np.exp(-np.linspace(0, 3, 4000)).reshape(1, 1, -1)
    truth = Truth.of([noisy(exact, 0.2, rng) for _ in range(2)])
    assert truth.relative_error == pytest.approx(0.2 / math.sqrt(2), rel=0.05)
    assert truth.error_of(inner(noisy(exact, 0.3, rng))) == pytest.approx(0.3, rel=0.05)
    assert truth.error_of(inner(exact)) < 0.03
    scaled = truth.scaled_to(inner(1e6 * exact))
    assert truth.error_of(scaled) < 0.03


def test_noise_and_bias_are_told_apart(tmp_path: Path) -> None:
    """A setting that lacks 30 % of the light and has 5 % noise; one that lacks nothing; one whose level is wrong."""
    (tmp_path / "tiny.yaml").write_text(CONFIG.replace("bins: 108", "bins: 2700"))
    config = load_config(tmp_path / "tiny.yaml")
    scene = generate_scene(config.scene, config.seed, 0)
    problem = Problem(scene, capture_for(config, scene))
    rng = np.random.default_rng(3)
    exact = rng.random((9, 1, 2700))
    truth = Truth.of([noisy(exact, 0.01, rng) for _ in range(2)])
    reference = Reference({(complete, w): truth for complete in (False, True) for w in FACTORS}, {}, 0.0)

    def row(level: float, noise: float, **changes: bool) -> Row:
        def made(scene: object, capture: object, seed: int) -> np.ndarray:
            return level * noisy(exact, noise, rng)

        return measure(Setting("x", "1", "", made, **changes), problem, reference, 3, 100.0)

    less, whole = row(0.7, 0.05), row(1.0, 0.05)
    assert less.bias == pytest.approx(0.3, rel=0.02) and less.noise == pytest.approx(0.05, rel=0.05)
    assert less.error == pytest.approx(math.hypot(0.3, 0.7 * 0.05), rel=0.02)
    assert whole.bias == 0.0 and whole.error == pytest.approx(0.05, rel=0.05)
    assert row(1e-9, 0.05, scaled=True).error == pytest.approx(0.05, rel=0.05)


def a_row(quantity: str, value: str, seconds: float, error: float, bias: float = 0.0, config: str = "c") -> Row:
    complete = quantity == "bounce orders"
    return Row(quantity, value, config, 3, seconds, error, 0.01, bias, None, complete, False)


def test_the_front_and_the_advice_follow_from_the_rows() -> None:
    rows = with_front(
        [
            a_row("lookins", "100", 0.1, 0.2, config="lookins: 100, max_bounces: 4"),
            a_row("lookins", "400", 0.4, 0.09, config="lookins: 400, max_bounces: 4"),
            a_row("lookins", "1600", 1.6, 0.045, config="lookins: 1600, max_bounces: 4"),
            a_row("FoV points", "16", 0.5, 0.1, config="fov_samples: 16, max_bounces: 4"),
            a_row("target", "0.05", 1.0, 0.04, config="target: 0.05, max_bounces: 4"),
            a_row("bin width", "× 9", 0.05, 0.001, config=""),
            a_row("bounce orders", "≤ 3", 0.05, 0.31, bias=0.3),
            a_row("bounce orders", "all", 0.3, 0.1),
        ]
    )
    assert [row.value for row in rows if row.front] == ["100", "400", "0.05", "≤ 3", "all"]
    text = "\n".join(advice(rows))
    assert "10 %: `lookins: 400, max_bounces: 4`" in text and "5 %: `lookins: 1600, max_bounces: 4`" in text
    assert "`target: 0.05, max_bounces: 4`, 1 s" in text and "≤ 3 bounces 30 %" in text
    # Halving the error took four times the lookins, so 2 % takes (4.5/2)² times as many.
    assert "2 %: no fixed setting of these; by the trend about 8.1e+03 lookins, 8.1 s" in text
    assert "bin width" not in text
    assert table(rows).count("●") == 5


def test_fewer_laser_points_keep_their_pixels() -> None:
    config = load_config(ROOT / "configs/quickstart.yaml")
    scene = generate_scene(config.scene, config.seed, 0)
    whole = capture_for(config, scene)
    few = fewer_laser_points(whole, 10)
    assert few.shape == (10, 1, 512)
    assert np.allclose(few.sensor.pixels.mean(axis=1), few.laser.targets)
    assert fewer_laser_points(whole, 1000) is whole


def test_the_command_writes_table_picture_and_numbers(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "tiny.yaml").write_text(CONFIG)
    out = tmp_path / "out"
    arguments = ["bench", "accuracy", str(tmp_path / "tiny.yaml"), str(out), "--seconds", "4", "--repeats", "2"]
    assert run([*arguments, "--laser-points", "4", "--scene", "1"]) == 0
    printed = capsys.readouterr().out
    assert sorted(path.name for path in out.iterdir()) == ["accuracy.json", "accuracy.md", "accuracy.png"]
    assert (out / "accuracy.png").read_bytes()[:4] == b"\x89PNG"
    values = json.loads((out / "accuracy.json").read_text())
    swept = {row["quantity"] for row in values["rows"]}
    assert {"lookins", "FoV points", "bounce orders", "lookins, all bounces"} <= swept
    assert values["laser_points"] == 4 and values["of_laser_points"] == 9 and values["scene"] == 1
    assert values["machine"]["cores"] >= 1 and "datagen" in values["versions"]
    for row in values["rows"]:
        assert row["seconds"] > 0 and row["error"] >= 0, row
    lookins = [row["error"] for row in values["rows"] if row["quantity"] == "lookins"]
    assert lookins[-1] < lookins[0]
    assert "What to choose" in printed and "4 of its 9 laser points" in printed


@pytest.mark.parametrize(
    ("options", "word"),
    [
        (["--scene", "2"], "--scene 2"),
        (["--seconds", "0"], "--seconds 0"),
        (["--repeats", "1"], "repeats"),
        (["--laser-points", "0"], "laser-points"),
    ],
)
def test_bad_input_is_one_line(
    options: list[str], word: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "tiny.yaml").write_text(CONFIG)
    assert run(["bench", "accuracy", str(tmp_path / "tiny.yaml"), str(tmp_path / "out"), *options]) == 2
    err = capsys.readouterr().err
    assert word in err and err.count("\n") == 1 and not (tmp_path / "out").exists()


def test_an_output_that_is_a_file_and_a_missing_config(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "tiny.yaml").write_text(CONFIG)
    (tmp_path / "file").write_text("mine")
    assert run(["bench", "accuracy", str(tmp_path / "tiny.yaml"), str(tmp_path / "file")]) == 2
    assert run(["bench", "accuracy", str(tmp_path / "none.yaml"), str(tmp_path / "out")]) == 2
    assert (tmp_path / "file").read_text() == "mine" and capsys.readouterr().err.count("\n") == 2


def test_a_dark_scene_is_told(tmp_path: Path) -> None:
    from datagen.errors import InputError

    (tmp_path / "tiny.yaml").write_text(CONFIG.replace("bins: 108, bin_width_ps: 800", "bins: 4, bin_width_ps: 1"))
    with pytest.raises(InputError, match="no light into the window"):
        run_bench(load_config(tmp_path / "tiny.yaml"), seconds=1.0)
