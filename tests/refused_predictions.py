"""Predictions that `score` refuses."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import datagen as dg
from datagen.cli import run


def assert_predictions_are_refused(
    suite: Path, values: Mapping[str, Any], folder: Path, piece: str, capsys: pytest.CaptureFixture[str]
) -> None:
    """From a file with status 2 and one line that has the piece, and as a mapping with our error."""
    np.savez(folder / "p.npz", **values)
    assert run(["score", str(suite), str(folder / "p.npz")]) == 2
    out, err = capsys.readouterr()
    assert out == "" and err.count("\n") == 1 and f"datagen: {folder}/p.npz" in err and piece in err, err
    with pytest.raises(dg.InputError, match=r"^predictions: "):
        dg.score(suite, values)
