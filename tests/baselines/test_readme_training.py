"""examples/readme_training.py at small size: README's own lines run, places are learnt, and the picture is drawn."""

from __future__ import annotations

import runpy
from pathlib import Path

import numpy as np
import pytest
from example_runs import run_example, small_quickstart
from numpy.typing import NDArray

import datagen

ROOT = Path(__file__).parents[2]
SCRIPT = ROOT / "examples" / "readme_training.py"


@pytest.mark.nightly
def test_the_example_learns_and_is_drawn(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    small = small_quickstart()
    monkeypatch.setattr(datagen, "load_config", lambda path: small)
    arguments = ("--scenes", 20, "--epochs", 80, "--workers", 1, "--dataset", tmp_path / "set")
    run_example(SCRIPT, tmp_path / "picture.png", *arguments)
    said, _, _, *lines = capsys.readouterr().out.splitlines()
    assert said.startswith("seed 0: ")
    # An object a line: median, 90 %, share within 25 cm, always the mean, in rooms trained on.
    rows = {name.strip(): cells for name, *cells in (line.strip("| ").split("|") for line in lines)}
    assert list(rows) == ["pillar", "box"]
    assert (tmp_path / "picture.png").stat().st_size > 10_000
    trained, kept = (places(tmp_path / "set", split) for split in ("train", "test"))
    always = np.linalg.norm(kept.mean(axis=0) - kept, axis=-1)
    spread = np.median(np.linalg.norm(trained.mean(axis=0) - trained, axis=-1), axis=0)
    for k, (median, ninety, near, mean, by_heart, *_) in enumerate(rows.values()):
        assert 0 < float(median) <= float(ninety) < 4 and 0 <= float(near.strip(" %")) <= 100
        # torch takes the lower of two middle values.
        assert float(mean) == pytest.approx(np.sort(always[:, k])[(len(always) - 1) // 2], abs=0.006)
        # Few rooms can be learnt by heart, which shows that the lines train what they are to train.
        assert float(by_heart) < 0.7 * spread[k], (k, by_heart, spread)


def places(path: Path, split: str) -> NDArray[np.float64]:
    """(room, object, 2) depth and right of the objects."""
    data = datagen.TransientDataset(path, ("object_box_center",), split=split)
    return np.stack([data[k]["object_box_center"].double().numpy()[:, [2, 0]] for k in range(len(data))])


def test_an_example_that_has_changed_is_noticed(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.syspath_prepend(str(SCRIPT.parent))
    example = runpy.run_path(str(SCRIPT))["example"](tmp_path / "set", 3)
    assert f"{str(tmp_path / 'set')!r}" in example and "range(3)" in example and "redraw_noise=True" in example
