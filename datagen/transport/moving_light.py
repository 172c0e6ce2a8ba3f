"""The own light of a part that moves, by cuts, for all its poses with one tree.

The part's mesh stays where it is at time 0. Laser points and FoV points are moved instead, by the inverse of the pose
that the part has when the laser point is measured. So each laser point may have its own time. Elements, which are cut
in the frame of the part, get the same random numbers in all frames, and change only as far as the geometry does.

Where things move within an exposure its light is the mean over instants. They share its elements: each takes fewer,
with other random numbers, so that many instants cost hardly more than one.

Shadow rays are tested in the part's own mesh first, and then carried to where the part is: in the static room, and in
the frames of other movers.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from datagen.compiled import compiled
from datagen.records.arrays import Floats, Ints
from datagen.transport.cut_elements import Walk
from datagen.transport.cut_steps import Asked, emit, legs_of
from datagen.transport.cuts import AT_LEAST, Cuts
from datagen.transport.fov_clusters import FovClusters
from datagen.transport.geometry import get, put
from datagen.transport.laser_points import LaserPoints
from datagen.transport.movers import (
    STANDS,
    Mover,
    direction_before,
    directions_before,
    place_after,
    place_before,
    places_before,
)

TURNED = (3, 11, 14)
"""Columns of a cluster's row where directions begin; its middle is in the first columns."""
FIRST = 10
"""Column of the index of a cluster's first valid point."""
JOBS = 512
"""Histograms at once, whose FoV points, moved, take 10 MB."""


class Jobs(NamedTuple):
    """Histograms that are looked at: laser point and pixel of each, (n,); and frames (F, n) in which they are, F for
    each."""

    laser: Ints
    pixel: Ints
    frame: Ints

    @classmethod
    def of(cls, cuts: Cuts, histogram: Ints, frame: Ints) -> Jobs:
        """Those of some histograms (n,) in frames (F, n)."""
        ends = cuts.pairs.ends[histogram]
        return cls(ends[:, 0], ends[:, 1], frame)

    def take(self, some: Ints) -> Jobs:
        """Some of the histograms, in all of their frames."""
        return Jobs(self.laser[some], self.pixel[some], self.frame[:, some])


class OwnLight:
    """The light of one mover.

    cuts : the problem of all parts, with FoV points and laser points of the static setup. mover, others : the part,
    and all others that move. samples : drawn so far. is_limited : whether a run had as many as it may have.
    """

    def __init__(self, cuts: Cuts, mover: Mover, others: Sequence[Mover]) -> None:
        self.cuts, self.mover, self.others = cuts, mover, others
        self.samples, self.is_limited = 0, False
        parts = len(cuts.groups)
        self.slot, self.group = np.full(parts, -1), int(cuts.groups[mover.part])
        self.slot[mover.part] = 0
        self.frame = cuts.problem.caster.frame

    def run(self, jobs: Jobs, delta: Floats, error: Floats, number: int) -> tuple[Floats, Floats]:
        """The light (2, F, n, T) of two replicates of some histograms, of elements that bring at most `delta` (F,)
        photons in each frame, and what is outside of the window (2, F, n).

        error : (F,) L2 error that a histogram may have, photons. number : of the run; each has random numbers of its
        own, which are the same in all frames.
        """
        cuts, shape = self.cuts, jobs.frame.shape
        light, outside = np.zeros((2, *shape, cuts.problem.capture.time.bins)), np.zeros((2, *shape))
        instants = len(self.mover.pose)
        # Of n instants with noise of their own each may have √n of the error, and n times as much in an element.
        every_part = np.ones(len(self.slot))
        asked = [
            Asked(instants * most * every_part, self.slot, instants**0.5 * own * every_part, cuts.straight, 1.0)
            for most, own in zip(delta, error, strict=True)
        ]
        squares = cuts.squares[jobs.pixel]
        for count in np.unique(squares):
            every = np.flatnonzero(squares == count)
            for some in np.array_split(every, -(-len(every) * int(count) // (16 * JOBS))):
                own, first = jobs.take(some), int(some[0])
                pixels, of = np.unique(own.pixel, return_inverse=True)
                rng = np.random.default_rng(cuts.seed(4, number, int(count), first))
                pool = FovClusters.of(cuts.problem, pixels, int(count), rng)
                both, over = np.zeros((len(some), light.shape[3])), np.zeros(len(some))
                for r in range(2):
                    for f in range(shape[0]):
                        both[:], over[:] = 0.0, 0.0
                        for s in range(instants):
                            seed = cuts.seed(5, number, self.mover.part, first, r + 2 * s)
                            self._add(own, f, s, of, pool, asked[f], r, seed, both, over)
                        light[r, f, some], outside[r, f, some] = both / instants, over / instants
        return light, outside

    def _add(
        self, jobs: Jobs, turn: int, instant: int, of: Ints, pool: FovClusters, asked: Asked, replicate: int,
        seed: int, light: Floats, outside: Floats,
    ) -> None:  # fmt: skip
        """Adds a replicate of the light of some histograms, each in its frame of a turn, to light (n, T) and outside
        (n,), as at an instant of each exposure. of : (n,) the pixel's number in `pool`."""
        cuts, n, frame = self.cuts, len(of), jobs.frame[turn]
        at = (instant, frame, jobs.laser)
        pose, *others = (np.ascontiguousarray(mover.pose[at]) for mover in (self.mover, *self.others))
        setup = cuts.setup._replace(
            lasers=_lasers_before(cuts.setup.lasers, jobs.laser, pose), power=cuts.setup.power[jobs.laser]
        )
        own_pool, rows = _pool_before(pool, of, pose), np.arange(n)
        pairs, most = np.column_stack([rows, rows, rows]), cuts.most * max(n, AT_LEAST)
        walk = Walk.of(np.random.default_rng(seed).random())
        while walk.at[0] < n:
            used = emit(pairs, n, asked, most, replicate, seed, setup, own_pool, walk, cuts.expected, cuts.batch)
            self.samples += used
            cuts.pour(self._rows_in_sight(pose, others, cuts.every[:used]), light, outside)
        self.is_limited |= bool(walk.at[3] >= most)

    def _rows_in_sight(self, pose: Floats, others: Sequence[Floats], rows: Ints) -> Ints:
        """Those samples of the batch, by number, that nothing hides: neither the part itself at its poses (n, 5), nor
        the static room, nor other movers at theirs."""
        cuts, stands = self.cuts, np.tile(STANDS, (len(pose), 1))
        for leg in range(2):
            origin, span = cuts.origin[: len(rows)], cuts.span[: len(rows)]
            legs_of(cuts.batch, rows, leg, origin, span)
            rows = rows[~self.mover.hides(origin, span)]
        hides = [cuts.problem.caster.occluded_scaled, *(other.hides for other in self.others)]
        for is_hidden, back in zip(hides, [stands, *others], strict=True):
            for leg in range(2):
                origin, span = cuts.origin[: len(rows)], cuts.span[: len(rows)]
                _legs_elsewhere(cuts.batch, rows, leg, pose, back, self.frame, origin, span)
                rows = rows[~is_hidden(origin, span)]
        return rows


def _lasers_before(lasers: LaserPoints, which: Ints, pose: Floats) -> LaserPoints:
    """Some laser points before the moves of poses (n, 5), each by its own."""
    some = lasers.take(which)
    return some._replace(
        position=places_before(pose, some.position), normal=directions_before(pose, some.normal),
        to_laser=directions_before(pose, some.to_laser),
    )  # fmt: skip


def _pool_before(pool: FovClusters, of: Ints, pose: Floats) -> FovClusters:
    """The FoV points of the pixels `of` (n,) before the moves of poses (n, 5), each pixel by its own."""
    each = len(pool.part) // len(pool.cluster)
    points = (of[:, None] * each + np.arange(each)).ravel()
    of_points, cluster = np.repeat(pose, each, axis=0), pool.cluster[of]
    _move_clusters(pose, of, each, cluster)
    return FovClusters(
        places_before(of_points, pool.position[points]), directions_before(of_points, pool.normal[points]),
        directions_before(of_points, pool.to_sensor[points]), pool.part[points], pool.weight[points],
        pool.leg[points], cluster,
    )  # fmt: skip


@compiled(allocates=False)
def _move_clusters(pose, of, each, cluster):  # type: ignore[no-untyped-def]
    """Carries clusters (n, C, 18) of pixels `of` (n,), with `each` so many points, back by poses (n, 5)."""
    for k in range(len(of)):
        for c in range(cluster.shape[1]):
            row = cluster[k]
            put(row, c, 0, place_before(pose[k], get(row, c, 0)))
            for column in TURNED:
                put(row, c, column, direction_before(pose[k], get(row, c, column)))
            row[c, FIRST] += (k - of[k]) * each


@compiled(allocates=False)
def _legs_elsewhere(batch, rows, leg, there, back, frame, origin, span):  # type: ignore[no-untyped-def]
    """Sets origins and spans (…, 3) of rays as `legs_of` does, after the moves of poses `there` (n, 5) of their
    histograms and before those of `back`. frame : (4,) middle and half extent of embree's frame, metres."""
    for n in range(len(rows)):
        ends, row = batch.ends[rows[n]], batch.row[rows[n]]
        for end in range(2):
            k = 1 if end == 0 else 2 * leg
            p = (
                ends[k, 0] * frame[3] + frame[0], ends[k, 1] * frame[3] + frame[1], ends[k, 2] * frame[3] + frame[2]
            )  # fmt: skip
            p = place_before(back[row], place_after(there[row], p))
            for c in range(3):
                value = np.float32((p[c] - frame[c]) / frame[3])
                if end == 0:
                    origin[n, c] = value
                else:
                    span[n, c] = value - origin[n, c]
