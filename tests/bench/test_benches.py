"""Every bench runs at a tiny size and prints its table; what the tables rest on is held against known answers."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from datasets import write_dataset

from datagen.bench import accuracy, stages
from datagen.bench.accuracy import Row, fewer_laser_points, picture
from datagen.bench.plain_check import RUNS, Checked, PlainPaths
from datagen.capture import capture_for
from datagen.cli import run
from datagen.config import load_config
from datagen.scene import generate_scene

CONFIG = """
name: tiny
scenes: 8
capture: {pairing: confocal, scan: {rows: 3, columns: 3}, time: {bins: 108, bin_width_ps: 800}}
transport: {samples: 64}
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
    options = ["--seconds", "2", "--repeats", "1", "--laser-points", "2", "--scene", "1"]
    printed = printed_by(["accuracy", config, str(tmp_path / "out"), *options], capsys)
    # How many rows the seconds leave time for is the machine's affair.
    assert rows_of(printed, "asked")[0][:2] == ["target", "0.1"]
    assert "max_bounces: 3 leaves out" in printed and "2 of its 9 laser points" in printed
    assert (tmp_path / "out/accuracy.png").read_bytes()[:4] == b"\x89PNG"


def test_accuracy_draws_what_the_time_left_room_for(tmp_path: Path) -> None:
    row = Row("target", "0.1", 0.1, 0.1, Checked(0.0, 1.0))
    for rows in ([], [row]):
        assert picture(rows, "a room", tmp_path / "accuracy.png").read_bytes()[:4] == b"\x89PNG"


def test_a_first_run_that_compiles_leaves_as_many_paths(monkeypatch: pytest.MonkeyPatch) -> None:
    """A million samples take a second here, and the first run twenty seconds more."""
    calls = list[int]()

    def timed(call: Callable[[], object]) -> tuple[object, float]:
        began = len(calls)
        return call(), sum(calls[began:]) * 1e-6

    def run(samples: int) -> None:
        calls.append(samples + 20_000_000 * (not calls))

    monkeypatch.setattr(accuracy, "processor_seconds", timed)
    assert 1e6 < accuracy._affordable(run, 4.0) < 4e6


def test_the_noise_of_the_plain_paths_is_taken_out() -> None:
    """Light that is right, and light that lacks a tenth, against Gaussian runs of paths: errors without bias, and
    their noise as large as it says."""
    rng, truth = np.random.default_rng(1), np.linspace(1.0, 2.0, 50)[None]
    for share, error in ((1.0, 0.0), (0.9, 0.1)):
        found = [
            PlainPaths({"primary": truth + 0.5 * rng.normal(size=(RUNS, 1, 50))}, np.arange(1)).check(
                share * truth[None], "primary"
            )
            for _ in range(300)
        ]
        squares = np.array([one.square for one in found])
        assert abs(squares.mean() - error**2) < 4 * squares.std() / np.sqrt(300) + 0.02 * error**2
        assert 0.8 < np.mean([one.noise for one in found]) / squares.std() < 2.0


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
        (["accuracy", "CONFIG", "OUT", "--repeats", "0"], "repeats"),
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
