"""Mean and spread of histograms, as log(1 + counts), and of labels, computed for each scene when it is written."""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass, fields
from typing import Annotated

import numpy as np
import pydantic
from numpy.typing import NDArray

from datagen.records.arrays import Floats
from datagen.records.label_fields import LABEL_FIELDS

LABELS = tuple(of.name for of in LABEL_FIELDS if of.is_quantity)
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
    # Most values are 0, and count by their number alone.
    found = values[values != 0].astype(np.float64)
    if field in COUNTS:
        found = np.log1p(found)
    mean = found.sum() / size
    square = (((found - mean) ** 2).sum() + (values.size - found.size) * mean * mean) / size
    return FieldStats(float(mean), math.sqrt(square), found.size / size)


def pooled_stats(mean: Floats, std: Floats, nonzero: Floats) -> dict[str, float]:
    """The statistics of several scenes of one shape, from those of each, (scenes,): field of `FieldStats` → value."""
    count = len(mean)
    if not count:
        raise ValueError("no scenes")
    # Sums of Python are exact, so the order of the scenes does not matter.
    middle, share = math.fsum(mean.tolist()) / count, math.fsum(nonzero.tolist()) / count
    with np.errstate(over="ignore"):
        square = math.fsum((std * std + mean * mean).tolist()) / count
    return asdict(FieldStats(middle, math.sqrt(max(square - middle * middle, 0.0)), share))
