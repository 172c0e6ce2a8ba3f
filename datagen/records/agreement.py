"""The laws by which two results of one scene agree that two versions, or two kinds of processor, made: rooms are the
same to rounding, light differs by no more than the errors that both claim, and counts by what these and chance make.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from datagen.records.arrays import Bools, Floats

ROUNDING = 1e-9
"""Largest relative difference of a number that was drawn for a room, far above what rounding comes to."""
COUNTING_SIGMAS = 4.0
"""Standard deviations by which counts may be off; one sound comparison in ten thousand is further off."""
SPANS = 8
"""Spans of the time axis in which counts are added up, over the whole scan."""


@dataclass(frozen=True)
class Agreement:
    """The relative L2 difference of two results, and the largest that the law allows; this is NaN if an error of the
    light is unknown."""

    difference: float
    allowed: float

    @property
    def holds(self) -> bool:
        """Whether the results agree; never if it cannot be told."""
        return self.difference <= self.allowed


def same_to_rounding(own: NDArray[Any], due: NDArray[Any]) -> Bools:
    """Which numbers of two arrays of one shape are the same to rounding; NaN is the same as NaN."""
    own, due = np.asarray(own, np.float64), np.asarray(due, np.float64)
    # Infinite numbers are the same only if they are equal.
    with np.errstate(invalid="ignore"):
        near = np.abs(own - due) <= ROUNDING * np.maximum(np.abs(due), 1.0)
    return np.asarray((own == due) | (near & np.isfinite(due)) | (np.isnan(own) & np.isnan(due)))


def same_parameter(own: object, due: object) -> bool:
    """Whether two parameters of a sample are the same: numbers with a fraction to rounding, all others exactly."""
    if isinstance(own, float) and isinstance(due, float):
        return bool(same_to_rounding(np.array(own), np.array(due)))
    return isinstance(own, bool) is isinstance(due, bool) and own == due


def light_agreement(own: NDArray[Any], due: NDArray[Any], light: float, claimed: float) -> Agreement:
    """The agreement of two arrays of light, or of their standard errors.

    light : L2 norm of the whole transient, to which the claims refer. claimed : relative errors of both, added up.
    """
    off = _norm(np.nan_to_num(np.asarray(own, np.float64) - np.asarray(due, np.float64)))
    same_gaps = np.array_equal(np.isnan(own), np.isnan(due))
    return Agreement((off / light if light > 0 else math.inf if off > 0 else 0.0) if same_gaps else math.inf, claimed)


def counts_in_spans(histogram: NDArray[Any]) -> Floats:
    """(SPANS,) the counts of histograms (…, T) in spans of time, equal but for a bin."""
    over_time = histogram.sum(axis=tuple(range(histogram.ndim - 1)), dtype=np.float64)
    return np.array([span.sum() for span in np.array_split(over_time, SPANS)])


def counts_agreement(
    own: Sequence[Floats], due: Sequence[Floats], claimed: Sequence[float], drawn: float
) -> Agreement:
    """The agreement of the counts of some scenes.

    own, due : `counts_in_spans` of each scene. claimed : of each scene the relative errors of both lights, added up.
    drawn : variance of the differences that chance makes: all counts, of `own` and of `due`, unless these are means.
    """
    size = max(_norm(due), 1.0)
    by_light = _norm([error * _norm(counts) for error, counts in zip(claimed, due, strict=True)])
    chance = COUNTING_SIGMAS * math.sqrt(drawn)
    return Agreement(_norm(np.subtract(own, due)) / size, (by_light + chance) / size)


def _norm(values: Any) -> float:
    return float(np.linalg.norm(np.ravel(np.asarray(values, np.float64))))
