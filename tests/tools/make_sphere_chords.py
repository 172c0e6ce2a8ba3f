"""Compute `tests/physics/data/sphere_chords.npz` anew: `python tests/tools/make_sphere_chords.py`, half a minute."""

from __future__ import annotations

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "physics"))

import numpy as np
from sphere_chords import STORED, chords

if __name__ == "__main__":
    STORED.parent.mkdir(exist_ok=True)
    np.savez_compressed(STORED, **chords(32, 500_000, 1)._asdict())
