"""Mean and spread of histograms, as log(1 + counts), and of labels, computed for each scene when it is written.

The results have the same bits on any processor, because all sums are sums of integers or exactly rounded.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass, fields
from typing import Annotated

import numpy as np
import pydantic
from numpy.typing import NDArray

from datagen.records.arrays import Floats

LABELS = ("depth", "normal", "albedo", "shaded", "occupancy", "sdf")
"""Labels whose values are quantities, not indices."""
COUNTS = ("histogram", "background_histogram")
WITH_STATS = (*COUNTS, *LABELS)

_Sane = Annotated[float, pydantic.Field(ge=-1e100, le=1e100)]


@dataclass(frozen=True)
class FieldStats:
    """Mean and standard deviation of a field's values (of a histogram: of log(1 + counts)), and the fraction of
    values that are not 0 (in most labels 0 means that nothing is there)."""

    mean: _Sane
    std: _Sane
    nonzero: _Sane


QUANTITIES = tuple(field.name for field in fields(FieldStats))


def stats_of(field: str, values: NDArray[np.generic]) -> FieldStats:
    """The statistics of one scene's values of a field."""
    size = max(values.size, 1)
    found = values[values != 0]
    if field in COUNTS:
        if values.dtype.itemsize <= 2:
            every = np.bincount(found)  # several times as fast as `unique`
            counts, times = np.flatnonzero(every), every[every > 0]
        else:
            counts, times = np.unique(found, return_counts=True)
        # numpy's log1p rounds differently on different processors.
        logs = np.array([math.log1p(count) for count in counts.tolist()])
        weighed = times * logs
        mean, square = (math.fsum(terms.tolist()) / size for terms in (weighed, weighed * logs))
    else:
        exact = found.astype(np.float64)
        mean, square = (_sum(x) / size for x in (exact, exact * exact))
    return FieldStats(mean, math.sqrt(max(square - mean * mean, 0.0)), found.size / size)


def _sum(values: Floats) -> float:
    """The sum of values, independent of their order. Each value is rounded to a multiple of 2^−steps, as fine as lets
    the sum fit into 62 bits. That is finer than a double, so the spread of almost equal values stays right."""
    largest = float(np.abs(values).max(initial=0.0)) * max(values.size, 1)
    if not math.isfinite(largest):
        return largest
    steps = min(62 - math.frexp(largest)[1], 1000)
    return math.ldexp(int(np.rint(values * math.ldexp(1.0, steps)).astype(np.int64).sum()), -steps)


def together(scenes: Sequence[FieldStats]) -> dict[str, float]:
    """The statistics of several scenes of one shape, from those of each: field of `FieldStats` → value."""
    if not scenes:
        raise ValueError("no scenes")
    mean, nonzero = (math.fsum(getattr(one, name) for one in scenes) / len(scenes) for name in ("mean", "nonzero"))
    square = math.fsum(one.std * one.std + one.mean * one.mean for one in scenes) / len(scenes)
    return asdict(FieldStats(mean, math.sqrt(max(square - mean * mean, 0.0)), nonzero))
