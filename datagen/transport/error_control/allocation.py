"""How many samples each stratum gets next: where the variance is, at what it costs.

With variance Vᵢ = gᵢ²/Nᵢ and cost cᵢ Nᵢ, the least cost for a given total variance is at Nᵢ ∝ gᵢ/√cᵢ (Neyman 1934,
with costs), over strata and, within a stratum, over laser points. Everything here is a function of counts and
variances.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from datagen.records.arrays import Floats, Ints
from datagen.transport.error_control.confidence import total_variance
from datagen.transport.error_control.strata import Stratum

REPLICATES = 8
"""Fewest replicates of a round; up to twice as many, so that lookins for each can stay a power of two."""
LEVELS = 4.0
"""Most that a laser point's share may differ from the mean, both ways."""
WORTH_LEVELS = 0.85
"""Largest share of the cost, as compared with equal samples everywhere, for which laser points are told apart."""
GROWTH = 8.0
"""Most that one round may add to the cost, relative to all before it: the first variances are uncertain."""
WITHOUT_VARIANCE = 0.05
"""Share of the cost for a stratum whose variance seems to be nothing: it may not have been met yet."""
TOO_FEW = 0.05
"""Additions below this share of what a stratum has are left for later."""


@dataclass(frozen=True)
class Allotment:
    """Lookins for each laser point (L,) in each of so many replicates; nothing where all are 0."""

    points: Ints
    replicates: int

    @property
    def lookins(self) -> float:
        """Lookins over all laser points and replicates."""
        return float(self.points.sum()) * self.replicates


def levels(stratum: Stratum) -> Floats:
    """(L,) share of lookins of each laser point, a power of two, relative to the mean; 1 where it is not worth it."""
    even = np.ones(len(stratum.weight))
    seen = stratum.task.points.part >= 0
    if not stratum.by_laser or seen.sum() < 2:
        return even
    g = np.sqrt(stratum.scale * stratum.points)[seen]
    if g.mean() <= 0 or g.mean() ** 2 > WORTH_LEVELS * (g**2).mean():
        return even
    even[seen] = 2.0 ** np.round(np.log2(np.clip(g / g.mean(), 1 / LEVELS, LEVELS)))
    return even


def _per_lookin(stratum: Stratum) -> float:
    """g, the root of the variance times lookins, on average over the laser points."""
    seen = stratum.task.points.part >= 0
    return float(np.sqrt(stratum.scale * stratum.points)[seen].mean())


def _allotment_up_to(stratum: Stratum, level: Floats, base: float) -> Allotment:
    """The allotment that brings a stratum to about `base` lookins a laser point (of level 1) in all."""
    new = base - float((stratum.weight / level).mean())
    if new <= TOO_FEW * float(stratum.weight.mean()) or new <= 0:
        return Allotment(np.zeros(len(level), np.int64), REPLICATES)
    count = 2 ** max(0, int(np.floor(np.log2(max(new / REPLICATES, 1.0)))))
    points = np.maximum(count * level, 1).astype(np.int64)
    return Allotment(points, min(2 * REPLICATES, max(REPLICATES, int(np.ceil(new / count)))))


def _predicted_variance(stratum: Stratum, allotment: Allotment) -> float:
    """Variance of the stratum after an allotment, by the observed exponent of convergence."""
    weight = np.maximum(stratum.weight, 1.0)
    old = sum((one.weight**2 * one.variance for one in stratum.rounds), start=np.zeros(len(weight)))
    new = allotment.points * float(allotment.replicates)
    with np.errstate(divide="ignore"):
        fresh = (
            stratum.scale
            * (stratum.points / np.maximum(allotment.points, 1)) ** stratum.exponent
            / allotment.replicates
        )
    return stratum.excess * float(((old + new**2 * fresh) / (weight + new) ** 2).sum())


def next_allotments(strata: Sequence[Stratum], goal: float, lookins_left: float) -> list[Allotment] | None:
    """The cheapest allotments predicted to bring the variance down to `goal`, or as far towards it as a round may go;
    None where the lookins that are left allow nothing.

    lookins_left : rays from all laser points together.
    """
    level = [levels(stratum) for stratum in strata]
    worth = [_per_lookin(s) / np.sqrt(max(s.growing, 1e-9)) for s in strata]
    spent = sum(stratum.work.cost for stratum in strata)

    def at(scale: float) -> list[Allotment]:
        bases = [scale * w for w in worth]
        whole = sum(b * s.growing for b, s in zip(bases, strata, strict=True))
        bases = [max(b, WITHOUT_VARIANCE * whole / s.growing) for b, s in zip(bases, strata, strict=True)]
        return [_allotment_up_to(*of) for of in zip(strata, level, bases, strict=True)]

    def enough(allotments: list[Allotment]) -> bool:
        return sum(_predicted_variance(*of) for of in zip(strata, allotments, strict=True)) <= goal

    def too_much(allotments: list[Allotment]) -> bool:
        cost = sum(
            s.growing * o.lookins + s.standing * o.replicates * (o.lookins > 0)
            for s, o in zip(strata, allotments, strict=True)
        )
        rays = sum(s.rays_per_lookin * o.lookins for s, o in zip(strata, allotments, strict=True))
        return cost > GROWTH * spent or rays > lookins_left

    if not any(worth):
        return None
    low = min(float(s.weight.mean()) / w for s, w in zip(strata, worth, strict=True) if w > 0) / 2
    high = 2.0**40 * low
    least, most = (
        _threshold(low, high, lambda x: enough(at(x)))[1],
        _threshold(low, high, lambda x: too_much(at(x)))[0],
    )
    allotments = at(min(least, most))
    if not any(allotment.lookins for allotment in allotments):
        allotments = one_more(strata, [int(np.argmax([total_variance(stratum.scatters()) for stratum in strata]))])
    return None if too_much(allotments) else allotments


def one_more(strata: Sequence[Stratum], chosen: Sequence[int]) -> list[Allotment]:
    """A little more for the strata with these indices: a quarter of what they have."""
    allotments = []
    for k, stratum in enumerate(strata):
        base = 1.25 * float(stratum.weight.mean()) + REPLICATES if k in chosen else 0.0
        allotments.append(_allotment_up_to(stratum, np.ones(len(stratum.weight)), base))
    return allotments


def _threshold(low: float, high: float, holds: Callable[[float], bool]) -> tuple[float, float]:
    """Two values in low … high, 1 % apart, between which a condition that holds for large values begins to hold; the
    condition is false at the first and true at the second, unless it is so nowhere in the range."""
    if not holds(high):
        return high, high
    while high > 1.01 * low:
        middle = float(np.sqrt(low * high))
        if holds(middle):
            high = middle
        else:
            low = middle
    return low, high
