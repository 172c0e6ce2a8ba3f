"""Averages over independent scramblings of the walk: means by component, their standard error, and what they cost."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from datagen.records import Spend
from datagen.transport.cost import Work
from datagen.transport.spread import Sketch, standard_error
from datagen.transport.walk import Job, Splits, pool_for, trace_chunk

LOOKINS_PER_CHUNK = 1 << 17
"""Lookins traced at once, over as many laser points as fit."""
HISTOGRAM_VALUES_PER_CHUNK = 1 << 22
"""Histogram entries filled at once (32 MiB), over as many laser points as fit."""


@dataclass(frozen=True)
class Average:
    """rows : one (L, P, T) array for each split of the job. stderr : (L, P, T) standard error of their sum, NaN for
    one scrambling. overflow : (L, P) energy outside the window. work : what was done."""

    rows: list[NDArray[np.float64]]
    stderr: NDArray[np.float64]
    overflow: NDArray[np.float64]
    work: Work

    def split(self, splits: Splits) -> tuple[dict[str, NDArray[np.float64]], dict[str, NDArray[np.float64]]]:
        """The rows as components, and as parts of the primary."""
        return split_rows(self.rows, splits)


@dataclass(frozen=True)
class Estimate:
    """What a way of estimating hands to the solver; the fields are those of `Transient`."""

    components: dict[str, NDArray[np.float64]]
    parts: dict[str, NDArray[np.float64]]
    stderr: NDArray[np.float64]
    overflow: NDArray[np.float64]
    spend: Spend
    error_bound: float | None = None
    met_target: bool | None = None


def split_rows(
    rows: list[NDArray[np.float64]], splits: Splits
) -> tuple[dict[str, NDArray[np.float64]], dict[str, NDArray[np.float64]]]:
    """One array for each split → arrays by component, and the primary's by part."""
    components = dict(zip(splits.others, rows[splits.primary :], strict=True))
    if splits.primary:
        primary = rows[0].copy() if splits.primary > 1 else rows[0]
        for row in rows[1 : splits.primary]:
            primary += row
        components["primary"] = primary
    ordered = {name: components[name] for name in splits.components}
    return ordered, dict(zip(splits.parts, rows, strict=False))


def walk_average(job: Job, sketch: Sketch | None = None) -> Average:
    """Average over independent scramblings; their spread is the standard error.

    sketch : gets each scrambling's transient too, for the correlations between bins.
    """
    lasers, pixels, bins = job.capture.shape
    splits, lookins = job.splits, job.accuracy.lookins
    scramblings = min(job.accuracy.scramblings, lookins)
    confocal = job.capture.pairing == "confocal"
    squares = np.zeros((lasers, pixels, bins))
    overflow = np.zeros((lasers, pixels))
    rows = [np.zeros((lasers, pixels, bins)) for _ in range(splits.count)]
    existing = np.flatnonzero(job.points.part >= 0)
    work = Work(calls=0)
    for scrambling in range(scramblings):
        count = lookins // scramblings + (scrambling < lookins % scramblings)
        size = min(LOOKINS_PER_CHUNK // count, HISTOGRAM_VALUES_PER_CHUNK // (pixels * splits.count * bins))
        shared = None if confocal else pool_for(job, np.arange(pixels), count, scrambling)
        if shared is not None:
            work += Work(rays=shared.weight.size, calls=0)
        for chunk in _chunks(existing, max(1, size)):
            pool = pool_for(job, chunk, count, scrambling) if shared is None else shared
            tally, done = trace_chunk(job, chunk, pool, count, scrambling)
            work += done if shared is not None else done + Work(rays=pool.weight.size, calls=0)
            histogram = tally.histogram.reshape(-1, pixels, splits.count, bins)
            place = slice(chunk[0], chunk[0] + len(chunk))
            total = histogram.sum(axis=2)
            if sketch is not None:
                sketch.add(scrambling, total, int(chunk[0]) * pixels * bins)
            squares[place] += np.square(total, out=total)
            overflow[place] += tally.overflow.reshape(-1, pixels, splits.count).sum(axis=2)
            for k, row in enumerate(rows):
                row[place] += histogram[:, :, k]
    for row in rows:
        row /= scramblings
    return Average(rows, standard_error(rows, squares, scramblings), overflow / scramblings, work)


def _chunks(lasers: NDArray[np.int64], size: int) -> list[NDArray[np.int64]]:
    """Runs of consecutive laser points, at most `size` in each; a laser ray that met nothing ends a run."""
    runs = np.split(lasers, np.flatnonzero(np.diff(lasers) != 1) + 1)
    return [run[k : k + size] for run in runs for k in range(0, len(run), size)] if len(lasers) else []
