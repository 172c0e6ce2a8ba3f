"""examples/depth_training.py at small size: the error falls, and stands beside what is compared with it."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from example_runs import run_example, small_quickstart

import datagen

ROOT = Path(__file__).parents[2]
SCRIPT = ROOT / "examples" / "depth_training.py"


@pytest.mark.nightly
def test_the_example_learns_and_is_drawn(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    small = small_quickstart()
    monkeypatch.setattr(datagen, "load_config", lambda path: small)
    arguments = ("--scenes", 20, "--epochs", 10, "--workers", 1, "--dataset", tmp_path / "set")
    run_example(SCRIPT, tmp_path / "picture.png", *arguments)
    *epochs, by_heart, always, mean, by_one, by_four = capsys.readouterr().out.splitlines()
    errors = [float(line.split()[2]) for line in epochs]
    assert len(errors) == 10 and all(0.1 < error < 3 for error in errors)
    assert (tmp_path / "picture.png").stat().st_size > 10_000
    # What is compared with: the mean image of those trained on, on those kept back.
    train, test = (datagen.TransientDataset(tmp_path / "set", ("depth",), split=of) for of in ("train", "test"))
    depths = [np.stack([data[k]["depth"].numpy() for k in range(len(data))]) for data in (train, test)]
    blind = np.sqrt(np.mean((depths[0].mean(axis=0) - depths[1]) ** 2))
    assert mean == f"mean depth image {blind:.3f} m"
    constant = np.sqrt(np.mean((depths[0].mean() - depths[1]) ** 2))
    assert float(always.split()[-2]) == pytest.approx(constant, abs=0.002)
    moved = np.sqrt(np.mean(np.diff(depths[1], axis=-1, prepend=depths[1][..., :1]) ** 2))
    assert float(by_one.split()[-2]) == pytest.approx(moved, abs=0.001)
    assert float(by_four.split()[-2]) > float(by_one.split()[-2])
    # Few rooms can be learnt by heart, which shows that the network is trained.
    assert float(by_heart.split()[-2]) < 0.95 * np.sqrt(np.mean((depths[0].mean(axis=0) - depths[0]) ** 2))
