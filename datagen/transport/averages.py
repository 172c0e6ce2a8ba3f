"""Averages over independent scramblings of the walk: means by component, their standard error, and what they cost."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from datagen.records import Spend
from datagen.transport.connections import Tally
from datagen.transport.cost import Work
from datagen.transport.fov import FovPool
from datagen.transport.sampling import Streams
from datagen.transport.spread import Sketch, standard_error
from datagen.transport.vertices import runs_of
from datagen.transport.walk import (
    FOV_POINTS_PER_POOL,
    Job,
    Splits,
    blocks_for,
    part_of,
    pool_for,
    trace_chunk,
)

LOOKINS_PER_CHUNK = 1 << 17
"""Lookins traced at once, over as many laser points as fit."""
LOOKINS_TOGETHER = 1 << 14
"""Lookins up to which scramblings are traced in one call: of more, the call itself costs little."""
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
    squares = np.zeros((lasers, pixels, bins))
    overflow = np.zeros((lasers, pixels))
    rows = [np.zeros((lasers, pixels, bins)) for _ in range(splits.count)]
    work = Work(calls=0)
    counts = lookins // scramblings + (np.arange(scramblings) < lookins % scramblings)
    for count in np.unique(counts):
        for scrambling, first, tally, done in _traced(job, int(count), np.flatnonzero(counts == count)):
            work += done
            histogram = tally.histogram.reshape(-1, pixels, splits.count, bins)
            place = slice(first, first + len(histogram))
            total = histogram.sum(axis=2)
            if sketch is not None:
                sketch.add(scrambling, total, first * pixels * bins)
            squares[place] += np.square(total, out=total)
            overflow[place] += tally.overflow.reshape(-1, pixels, splits.count).sum(axis=2)
            for k, row in enumerate(rows):
                row[place] += histogram[:, :, k]
    for row in rows:
        row /= scramblings
    return Average(rows, standard_error(rows, squares, scramblings), overflow / scramblings, work)


def _traced(job: Job, count: int, scramblings: NDArray[np.int64]) -> Iterator[tuple[int, int, Tally, Work]]:
    """Trace `count` lookins of each laser point in each scrambling: (scrambling, first laser point, its light and
    that of those after it, work) for one piece after the other.

    A call of the tracing code costs some milliseconds, whatever it traces. So scramblings of few lookins are traced
    together, as copies of the laser points with random numbers of their own.
    """
    _, pixels, bins = job.capture.shape
    existing = np.flatnonzero(job.points.part >= 0)
    if not len(existing):
        return
    confocal = job.capture.pairing == "confocal"
    seen = existing if confocal else np.arange(pixels)
    fov_points = len(seen) * job.accuracy.fov_samples * blocks_for(job, seen, count)
    values = HISTOGRAM_VALUES_PER_CHUNK // (pixels * job.splits.count * bins)
    together = min(LOOKINS_TOGETHER // count, values) // len(existing)
    together = max(1, min(together, FOV_POINTS_PER_POOL // fov_points, len(scramblings)))
    size = max(1, min(LOOKINS_PER_CHUNK // count, values) // together)
    for few in np.split(scramblings, range(together, len(scramblings), together)):
        shared, drawn = None, Work(calls=0)
        if not confocal:
            shared = _shared_pool(job, count, few)
            drawn = Work(rays=shared.weight.size, calls=0)
        for run in runs_of(existing, size):
            if len(few) == 1:
                part, chunk, streams = job, run, Streams.of(job.seed, few, np.arange(len(job.points.part)))
            else:
                part, chunk = part_of(job, np.tile(run, len(few))), np.arange(len(few) * len(run))
                streams = Streams.of(job.seed, few, run)
            pool = shared
            if pool is None:
                pool = pool_for(part, chunk, blocks_for(job, run, count), Streams.of(job.seed, few, run))
                drawn = Work(rays=pool.weight.size, calls=0)
            tally, done = trace_chunk(part, chunk, pool, count, streams)
            for piece, scrambling in zip(tally.apart(len(few)), few, strict=True):
                yield int(scrambling), int(run[0]), piece, done + drawn
                done = drawn = Work(calls=0)


def _shared_pool(job: Job, count: int, scramblings: NDArray[np.int64]) -> FovPool:
    """FoV points that all laser points share, a set for each scrambling."""
    pixels = np.arange(job.capture.shape[1])
    streams = Streams.of(job.seed, scramblings, pixels)
    pool = pool_for(job, np.tile(pixels, len(scramblings)), blocks_for(job, pixels, count), streams)
    return pool.side_by_side(len(scramblings))
