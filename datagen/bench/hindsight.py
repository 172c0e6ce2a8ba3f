"""What a target would have cost somebody who knew the best fixed sample counts beforehand.

*Fixed counts* are `Accuracy(lookins=N, fov_samples=M)` with the default of eight replicates. Their error is measured
by many repetitions, not taken from one run's own scatter. Two things may be asked of them: that the error is the
target on average (root mean square), which half of all runs miss; or that it is within the target in 95 % of all
runs, which is what `Accuracy(target=…)` promises.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from datagen.records import Accuracy, Capture, Scene
from datagen.transport.solver import prepared, with_fixed_counts
from datagen.transport.spread import Sketch

REPLICATES = 8
REPETITIONS = 4
LOOKINS = (16, 128)
"""Lookins of a replicate at which the error and its order of convergence are measured."""
FOV_SAMPLES = (1, 4, 16, 64)
CONNECTIONS_AT_MOST = 256
"""Connections of a vertex beyond which more FoV points are not tried."""
PROMISED = 0.95
DRAWS = 2000
ORDERS = 1.0, 1.6
"""Bounds of α in squared error ∝ lookins^−α."""


@dataclass(frozen=True)
class Hindsight:
    """Cost, in connections, of the cheapest fixed counts. on_average : whose root mean square error is the target.
    promised : whose error is within the target in 95 % of runs."""

    on_average: float
    promised: float


@dataclass(frozen=True)
class _Counts:
    """lookins : of each replicate. square : squared error, as its mean and its 95 % quantile. cost : of a run."""

    fov_samples: int
    lookins: int
    square: tuple[float, float]
    cost: float


def hindsight(
    scene: Scene, capture: Capture, base: Accuracy, targets: Sequence[float], seed: int, norm: float
) -> list[Hindsight]:
    """For each target; norm : ‖truth‖. NaN where there is no light."""
    if norm <= 0:
        return [Hindsight(math.nan, math.nan)] * len(targets)
    pairs: list[tuple[_Counts, _Counts]] = []
    for samples in FOV_SAMPLES:
        if pairs and samples * capture.shape[1] > CONNECTIONS_AT_MOST:
            break
        few, many = (_measured(scene, capture, base, samples, n, seed) for n in LOOKINS)
        pairs.append((few, many))
        if len(pairs) > 1 and _price(*pairs[-1]) > _price(*pairs[-2]):
            break

    def cost(kind: int, target: float) -> float:
        square = (target * norm) ** 2
        lookins, (few, many) = min(
            ((_needed(kind, square, *pair), pair) for pair in pairs), key=lambda of: _cost(of[0], *of[1])
        )
        if lookins > 2 * many.lookins:
            nearer = _measured(scene, capture, base, many.fov_samples, 1 << round(math.log2(lookins)), seed + 1)
            lookins, few, many = _needed(kind, square, many, nearer), many, nearer
        return _cost(lookins, few, many)

    return [Hindsight(cost(0, target), cost(1, target)) for target in targets]


def _needed(kind: int, square: float, few: _Counts, many: _Counts) -> float:
    """Lookins of a replicate that the squared error (its mean or quantile) asks for; one at least."""
    if min(few.square[kind], many.square[kind]) <= 0:
        return 1.0
    order = math.log(few.square[0] / many.square[0]) / math.log(many.lookins / few.lookins)
    return max(many.lookins * (many.square[kind] / square) ** (1 / min(max(order, ORDERS[0]), ORDERS[1])), 1.0)


def _cost(lookins: float, few: _Counts, many: _Counts) -> float:
    """On the line through both costs."""
    return few.cost + (many.cost - few.cost) * (lookins - few.lookins) / (many.lookins - few.lookins)


def _price(few: _Counts, many: _Counts) -> float:
    """Squared error × cost of a lookin: what more FoV points lower, up to a number that they do not."""
    return many.square[0] * (many.cost - few.cost)


def _measured(scene: Scene, capture: Capture, base: Accuracy, fov_samples: int, lookins: int, seed: int) -> _Counts:
    """Runs with different seeds; what eight of all their replicates may give is drawn from them again and again."""
    counts = replace(base, lookins=lookins * REPLICATES, fov_samples=fov_samples, replicates=REPLICATES)
    transients, costs = [], []
    for repetition in range(REPETITIONS):
        sketch = Sketch(REPLICATES)
        job = prepared(scene, capture, counts, seed + 2 * repetition, split_parts=False)
        costs.append(with_fixed_counts(job, sketch).spend.cost)
        transients.append(sketch.folded)
    return _Counts(fov_samples, lookins, _squares(np.concatenate(transients)), float(np.mean(costs)))


def _squares(transients: NDArray[np.float64]) -> tuple[float, float]:
    """Mean and 95 % quantile of ‖deviation‖² of the mean of `REPLICATES` of the rows (bootstrap; the rows' own mean
    stands for the truth, which makes their deviations too small by n / (n − 1))."""
    n = len(transients)
    deviation = transients - transients.mean(axis=0)
    products = deviation @ deviation.T * n / (n - 1)
    draws = np.random.default_rng(0).multinomial(REPLICATES, np.full(n, 1 / n), size=DRAWS) / REPLICATES
    squares = np.einsum("ri,ij,rj->r", draws, products, draws)
    return float(np.trace(products)) / (n * REPLICATES), float(np.quantile(squares, PROMISED))
