"""Every bench runs at a tiny size and prints its table; what the tables rest on is held against known answers."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
from datasets import write_dataset

from datagen.bench import stages
from datagen.bench.accuracy import Row, Truth, advice, fewer_laser_points, noise_and_bias, picture, table, with_front
from datagen.capture import capture_for
from datagen.cli import run
from datagen.config import load_config
from datagen.scene import generate_scene

CONFIG = """
name: tiny
scenes: 8
capture: {pairing: confocal, scan: {rows: 3, columns: 3}, time: {bins: 108, bin_width_ps: 800}}
transport: {lookins: 256, fov_samples: 1}
detector: {photons_per_pulse: 1000.0}
labels: {rows: 8, columns: 8}
"""


@pytest.fixture
def config(tmp_path: Path) -> str:
    (tmp_path / "tiny.yaml").write_text(CONFIG)
    return str(tmp_path / "tiny.yaml")


def rows_of(printed: str, head: str) -> list[list[str]]:
    """The cells of the table whose first heading is `head`."""
    lines = printed.split(f"| {head} |")[1].splitlines()[2:]
    rows = [[cell.strip() for cell in line.strip("|").split("|")] for line in lines[: (*lines, "").index("")]]
    assert rows and all(any(character.isdigit() for character in "".join(row)) for row in rows)
    return rows


def printed_by(arguments: list[str], capsys: pytest.CaptureFixture[str]) -> str:
    assert run(["bench", *arguments]) == 0
    printed = capsys.readouterr().out
    assert " cores" in printed
    return printed


def test_accuracy(config: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    options = ["--seconds", "1", "--repeats", "2", "--laser-points", "2", "--scene", "1"]
    printed = printed_by(["accuracy", config, str(tmp_path / "out"), *options], capsys)
    lookins = [row for row in rows_of(printed, "swept") if row[0] == "lookins"]
    # How many rows a second leaves time for is the machine's affair.
    assert len(lookins) == 1 or float(lookins[-1][3].split()[0]) < float(lookins[0][3].split()[0])
    assert "What to choose" in printed and "2 of its 9 laser points" in printed
    assert (tmp_path / "out/accuracy.png").read_bytes()[:4] == b"\x89PNG"


def test_accuracy_draws_what_the_time_left_room_for(tmp_path: Path) -> None:
    """No run of all bounces, or no run with an error at all: a slow machine has few, in a second."""
    row = Row("lookins", "1", "", 1, 0.1, 0.1, 0.1, 0.0, complete=False)
    for rows in ([], [row]):
        assert picture(rows, "a room", tmp_path / "accuracy.png").read_bytes()[:4] == b"\x89PNG"


def test_stages(config: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    """Its builds in this process, which workers of their own would take most of the time."""
    monkeypatch.setattr(stages, "build", lambda config, root, workers, progress: write_dataset(config, root))
    monkeypatch.setattr(stages, "scenes_per_second", lambda records, workers: len(records) / workers)
    rows = rows_of(printed_by(["stages", config, "--scenes", "8", "--workers", "1"], capsys), "workers")
    assert [row[0] for row in rows] == ["1"] and rows[0][-1] == "4.00"


def test_a_million_scenes(config: str, capsys: pytest.CaptureFixture[str]) -> None:
    printed = printed_by(["stages", config, "--scan", "2x2x54", "--million", "--scenes", "8"], capsys)
    assert "2x2x54, tiny" in printed and "mean of 8" in printed
    line = stages.a_million(load_config(config), [1.0, 2.0])
    assert "1.5 processor s" in line and "1.1 days on 16 cores" in line, "10⁶ × 1.5 s / 16 / 86 400 s"


def test_the_truth_s_own_error_is_subtracted_and_noise_told_from_bias() -> None:
    """Halves with 20 % noise each, a run with 30 %: the error is 30 %. Runs with 5 % noise that lack 30 % of all."""
    rng = np.random.default_rng(2)
    exact = np.exp(-np.linspace(0, 3, 4000))

    def noisy(noise: float) -> np.ndarray:
        return exact + noise * np.linalg.norm(exact) / math.sqrt(exact.size) * rng.standard_normal(exact.shape)

    truth = Truth.of(noisy(0.2), noisy(0.2))
    assert truth.relative_error == pytest.approx(0.2 / math.sqrt(2), rel=0.05)
    assert truth.error_of(noisy(0.3)) == pytest.approx(0.3, rel=0.05)
    close = Truth.of(noisy(0.01), noisy(0.01))
    for level, lacking in ((0.7, 0.3), (1.0, 0.0)):
        noise, bias = noise_and_bias(level * np.array([noisy(0.05) for _ in range(3)]), close)
        assert noise == pytest.approx(0.05, rel=0.05) and bias == pytest.approx(lacking, rel=0.02)


def test_the_front_and_the_advice_follow_from_the_rows() -> None:
    def row(quantity: str, value: str, seconds: float, error: float, configured: str, bias: float = 0.0) -> Row:
        return Row(quantity, value, configured, 3, seconds, error, 0.01, bias, quantity == "bounce orders")

    rows = with_front(
        [
            row("lookins", "100", 0.1, 0.2, "lookins: 100, max_bounces: 4"),
            row("lookins", "400", 0.4, 0.09, "lookins: 400, max_bounces: 4"),
            row("lookins", "1600", 1.6, 0.045, "lookins: 1600, max_bounces: 4"),
            row("FoV points", "16", 0.5, 0.1, "fov_samples: 16, max_bounces: 4"),
            row("target", "0.05", 1.0, 0.04, "target: 0.05, max_bounces: 4"),
            row("bounce orders", "≤ 3", 0.05, 0.31, "max_bounces: 3", bias=0.3),
            row("bounce orders", "all", 0.3, 0.1, "max_bounces: null"),
        ]
    )
    assert [row.value for row in rows if row.front] == ["100", "400", "0.05", "≤ 3", "all"]
    assert table(rows).count("●") == 5
    text = "\n".join(advice(rows))
    assert "10 %: `lookins: 400, max_bounces: 4`" in text and "5 %: `lookins: 1600, max_bounces: 4`" in text
    assert "`target: 0.05, max_bounces: 4`, 1 s" in text and "≤ 3 bounces 30 %" in text
    # Halving the error took four times the lookins, so 2 % takes (4.5/2)² times as many.
    assert "2 %: no fixed setting of these; by the trend about 8.1e+03 lookins, 8.1 s" in text


def test_fewer_laser_points_keep_their_pixels() -> None:
    loaded = load_config(Path(__file__).parents[2] / "configs/quickstart.yaml")
    whole = capture_for(loaded, generate_scene(loaded.scene, loaded.seed, 0))
    few = fewer_laser_points(whole, 10)
    assert few.shape == (10, 1, 512) and fewer_laser_points(whole, 1000) is whole
    assert np.allclose(few.sensor.pixels.mean(axis=1), few.laser.targets)


@pytest.mark.parametrize(
    ("options", "word"),
    [
        (["accuracy", "CONFIG", "OUT", "--scene", "8"], "--scene 8"),
        (["accuracy", "CONFIG", "OUT", "--seconds", "0"], "--seconds 0"),
        (["accuracy", "CONFIG", "OUT", "--repeats", "1"], "repeats"),
        (["accuracy", "CONFIG", "OUT", "--laser-points", "0"], "laser-points"),
        (["accuracy", "CONFIG", "CONFIG"], "tiny.yaml"),
        (["accuracy", "none.yaml", "OUT"], "none.yaml"),
        (["stages", "CONFIG", "--workers", "two"], "--workers two"),
        (["stages", "CONFIG", "--scan", "64x64"], "--scan 64x64"),
        (["paeers"], "paeers"),
    ],
)
def test_bad_input_is_one_line(
    options: list[str], word: str, config: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    named = {"CONFIG": config, "OUT": str(tmp_path / "out")}
    assert run(["bench", *(named.get(option, option) for option in options)]) == 2
    err = capsys.readouterr().err
    assert word in err and err.count("\n") == 1 and not (tmp_path / "out").exists()


@pytest.mark.filterwarnings("ignore:simulate. all light arrives outside:datagen.InputWarning")
def test_a_dark_scene_is_refused(config: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    Path(config).write_text(CONFIG.replace("bins: 108, bin_width_ps: 800", "bins: 4, bin_width_ps: 1"))
    assert run(["bench", "accuracy", config, str(tmp_path / "out"), "--seconds", "1"]) == 2
    assert "no light into the window" in capsys.readouterr().err
