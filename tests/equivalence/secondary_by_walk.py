"""The secondary of four captures by path tracing, which the factorised form is compared with.

`python tests/equivalence/secondary_by_walk.py` computes `data/secondary_by_walk.npz` anew (some minutes); a nightly
test does so with other seeds.
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from rooms import furnished_box, one_point_capture

from datagen import Accuracy, simulate

STORED = Path(__file__).parent / "data" / "secondary_by_walk.npz"
RUNS = 8
PLACES = {
    "open wall": one_point_capture(),
    "1 mm from two walls": one_point_capture((0, -1.499, 0.001)),
    "FoV in the same corner": one_point_capture((0, -1.499, 0.001), (0, -1.3, 0.2), 0.2),
    "confocal at an object": one_point_capture((0, 1.45, 2.45), (0, 1.4, 2.4), 0.1),
}


def walked(place: str, seeds: range) -> NDArray[np.float64]:
    """(n, 41) the secondary of one run for each seed: 40 bins of 0.5 m, then their sum."""
    accuracy = Accuracy(1 << 14, 16, 4, 1)
    runs = [simulate(furnished_box(), PLACES[place], accuracy, seed=s).components["secondary"][0, 0] for s in seeds]
    return coarse(np.array(runs))


def coarse(runs: NDArray[np.float64]) -> NDArray[np.float64]:
    """Runs (n, 200) in bins of 0.5 m, so that each bin holds many paths and its spread is nearly normal, followed by
    their sum."""
    return np.column_stack([runs.reshape(len(runs), 40, 5).sum(axis=2), runs.sum(axis=1)])


def stored(place: str) -> NDArray[np.float64]:
    with np.load(STORED) as arrays:
        return np.asarray(arrays[place])


if __name__ == "__main__":
    STORED.parent.mkdir(exist_ok=True)
    np.savez_compressed(STORED, **{place: walked(place, range(RUNS)) for place in PLACES})
