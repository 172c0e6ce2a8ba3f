"""Path tracing, averaged over independent replicates: the mean by component, its standard error, and its cost."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np

from datagen.records import Spend
from datagen.records.arrays import Floats, Ints
from datagen.transport.error_control.cost import Work
from datagen.transport.fields_of_view import FovPool
from datagen.transport.memory import VALUES_AT_ONCE
from datagen.transport.path_tracing.connections import Tally
from datagen.transport.path_tracing.replicate_spread import Sketch, standard_error
from datagen.transport.path_tracing.trace import blocks_for, pool_for, trace_chunk
from datagen.transport.path_tracing.vertices import runs_of
from datagen.transport.problem import Problem, TallyRows
from datagen.transport.sampling import Streams

LOOKINS_TOGETHER = 1 << 14
"""First hidden vertices up to which several replicates share one call. With more of them the call itself costs
little; half as many make up to twice the calls where replicates are small."""


@dataclass(frozen=True)
class Average:
    """The mean over replicates.

    Attributes
    ----------
    rows : one (L, P, T) array for each row of `TallyRows`.
    stderr : (L, P, T) standard error of the sum of `rows`, NaN for one replicate.
    overflow : (L, P) energy outside the window.
    work : number of rays, connections and calls that the mean took.
    """

    rows: list[Floats]
    stderr: Floats
    overflow: Floats
    work: Work


@dataclass(frozen=True)
class Estimate:
    """The result of an integrator; the fields have the names and meanings of those of `Transient`."""

    components: dict[str, Floats]
    parts: dict[str, Floats]
    stderr: Floats
    overflow: Floats
    spend: Spend
    error_bound: float | None = None
    met_target: bool | None = None
    part_errors: dict[str, float] = field(default_factory=dict)
    rays: dict[str, int] = field(default_factory=dict)


def split_rows(rows: list[Floats], splits: TallyRows) -> tuple[dict[str, Floats], dict[str, Floats]]:
    """Arrays by component, in the order of `splits.components`, and arrays of the primary by part, from one array for
    each row."""
    components = dict(zip(splits.others, rows[splits.primary :], strict=True))
    if splits.primary:
        primary = rows[0].copy() if splits.primary > 1 else rows[0]
        for row in rows[1 : splits.primary]:
            primary += row
        components["primary"] = primary
    ordered = {name: components[name] for name in splits.components}
    return ordered, dict(zip(splits.parts, rows, strict=False))


def rays_of(problem: Problem, work: Work) -> dict[str, int]:
    """`Transient.rays`: how many connections that could carry energy were checked by a shadow ray, and how many were
    assumed to be visible."""
    assumed = problem.accuracy.occlusion == "off"
    return {"asked": 0 if assumed else int(work.bright), "assumed": int(work.bright) if assumed else 0}


def path_average(problem: Problem, sketch: Sketch | None = None) -> Average:
    """The mean of independent replicates of path tracing, with their spread as the standard error.

    sketch : receives each replicate's transient, for the correlations between bins.
    """
    lasers, pixels, bins = problem.capture.shape
    splits, lookins = problem.tally_rows, problem.accuracy.lookins
    replicates = min(problem.accuracy.replicates, lookins)
    squares = np.zeros((lasers, pixels, bins))
    overflow = np.zeros((lasers, pixels))
    rows = [np.zeros((lasers, pixels, bins)) for _ in range(splits.count)]
    work = Work(calls=0)
    counts = lookins // replicates + (np.arange(replicates) < lookins % replicates)
    for count in np.unique(counts):
        for replicate, first, tally, done in _traced(problem, int(count), np.flatnonzero(counts == count)):
            work += done
            histogram = tally.histogram.reshape(-1, pixels, splits.count, bins)
            place = slice(first, first + len(histogram))
            total = histogram.sum(axis=2)
            if sketch is not None:
                sketch.add(replicate, total, first * pixels * bins)
            squares[place] += np.square(total, out=total)
            overflow[place] += tally.overflow.reshape(-1, pixels, splits.count).sum(axis=2)
            for k, row in enumerate(rows):
                row[place] += histogram[:, :, k]
    for row in rows:
        row /= replicates
    return Average(rows, standard_error(rows, squares, replicates), overflow / replicates, work)


def _traced(problem: Problem, count: int, replicates: Ints) -> Iterator[tuple[int, int, Tally, Work]]:
    """Pieces of the replicates: (replicate, index of the piece's first laser point, light of a run of laser points
    from that one on, work).

    count : first hidden vertices of each laser point in each replicate. A call of the tracing code costs some
    milliseconds, however little it traces. So several small replicates are traced in one call, as copies of the laser
    points with random numbers of their own.
    """
    _, pixels, bins = problem.capture.shape
    existing = np.flatnonzero(problem.points.part >= 0)
    if not len(existing):
        return
    confocal = problem.capture.pairing == "confocal"
    seen = existing if confocal else np.arange(pixels)
    fov_points = len(seen) * problem.accuracy.fov_samples * blocks_for(problem, seen, count)
    values = VALUES_AT_ONCE // (pixels * problem.tally_rows.count * bins)
    together = min(LOOKINS_TOGETHER // count, values) // len(existing)
    together = max(1, min(together, VALUES_AT_ONCE // (8 * fov_points), len(replicates)))
    size = max(1, min(VALUES_AT_ONCE // (32 * count), values) // together)
    for few in np.split(replicates, range(together, len(replicates), together)):
        # Laser points that all pixels see share their FoV points; confocally each has those of its own pixel.
        shared, drawn = None, Work(calls=0)
        if not confocal:
            shared = _shared_pool(problem, count, few)
            drawn = Work(rays=shared.weight.size, calls=0)
        for run in runs_of(existing, size):
            if len(few) == 1:
                part, chunk = problem, run
                streams = Streams.of(problem.seed, few, np.arange(len(problem.points.part)))
            else:
                part, chunk = problem.for_lasers(np.tile(run, len(few))), np.arange(len(few) * len(run))
                streams = Streams.of(problem.seed, few, run)
            pool = shared
            if pool is None:
                pool = pool_for(part, chunk, blocks_for(problem, run, count), Streams.of(problem.seed, few, run))
                drawn = Work(rays=pool.weight.size, calls=0)
            tally, done = trace_chunk(part, chunk, pool, count, streams)
            for piece, replicate in zip(tally.apart(len(few)), few, strict=True):
                yield int(replicate), int(run[0]), piece, done + drawn
                done = drawn = Work(calls=0)


def _shared_pool(problem: Problem, count: int, replicates: Ints) -> FovPool:
    """FoV points of all pixels that all laser points share, with an independent set for each replicate."""
    pixels = np.arange(problem.capture.shape[1])
    streams = Streams.of(problem.seed, replicates, pixels)
    pool = pool_for(problem, np.tile(pixels, len(replicates)), blocks_for(problem, pixels, count), streams)
    return pool.side_by_side(len(replicates))
