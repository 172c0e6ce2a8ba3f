"""Light of three bounces for pairs of laser point and pixel: the arrays that the kernel reads, and the call to it."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from datagen.records.arrays import Bools, Floats, Ints
from datagen.records.materials import Lambertian
from datagen.seeding import LightStream
from datagen.transport.brdf import lobe_width
from datagen.transport.memory import VALUES_AT_ONCE
from datagen.transport.problem import Problem
from datagen.transport.quadrature.footprints import Patches, at_edges
from datagen.transport.quadrature.mesh_rays import LEVEL, SHARPEST, TRIANGLES, Outlines, gather_by_rays
from datagen.transport.quadrature.three_bounce_kernel import Room, gather
from datagen.transport.quadrature.weights import AT_ONCE
from datagen.transport.sampling import stream_seeds
from datagen.transport.bvh import Hierarchy
from datagen.transport.visibility.occluder_rows import Occluders
from datagen.units import path_from_time

LEVELS, SIZED, TINY = (2, 5), 64, 1e-4
"""Fewest and most times that a pixel which sees one flat surface is quartered (with one instead of two, trials of a
pixel inside an open ball agreed with each other on 3 % too little light); number of pixels whose size is measured
for that (half as many may miss the largest pixel); and size, relative to the scene and to the narrowest lobe, up to
which a pixel counts as a point and is not quartered (half of it quarters pixels in vain)."""
RAY_FOOTPRINT = 0.4
"""Largest footprint that one connection with the hit of a ray stands for, relative to its distance from there and to
the square root of the product of the error asked of an object's light and the narrowest lobe on the way, rad. With
twice as much, light of a large pixel beside a mesh arrives at times that are 9 % off."""
EDGE_LEVELS, MOST_AT_EDGES = range(2, 6), 1 << 14
"""Times that pixels which see more than one surface may be quartered in the first trial, and most footprints of all
such pixels together, which decides between them. Errors of one pixel's footprints average out over many pixels, so
that many pixels need fewer. Half of the second takes one quartering less from many pixels."""


class Lasers(NamedTuple):
    """Laser points as the kernel reads them: fields of `LaserPoints`, and `power` (L,), photons that arrive at
    each per photon emitted."""

    position: Floats
    normal: Floats
    to_laser: Floats
    part: Ints
    power: Floats
    leg: Floats


class Cutting(NamedTuple):
    """How finely surfaces are cut into elements.

    Attributes
    ----------
    error : (K,) L2 error in a histogram, photons, that one element of each part may make; infinite for parts that are
        left out.
    sharp : (K,) 1/width² of each part's narrowest lobe, 1 for a matt surface.
    peak : (K,) upper bound of each part's BRDF, 1/sr.
    rays_on_last_leg : whether shadow rays between elements and the pixel are cast.
    seed : (K,) seed of the random points on each part.
    """

    error: Floats
    sharp: Floats
    peak: Floats
    rays_on_last_leg: bool
    seed: Ints


class Clock(NamedTuple):
    """Arrival time in bins from a path in metres: path · per_metre − start.

    Attributes
    ----------
    device : whether the legs from the laser and to the sensor belong to the path.
    attenuation : of the air, 1/m.
    opens, closes : first and last path within the window of time, metres.
    """

    per_metre: float
    start: float
    device: bool
    attenuation: float
    opens: float
    closes: float


class Scan(NamedTuple):
    """All that the kernel reads: surfaces (`tree`), triangles that can hide something (`occluders`), laser points,
    footprints of the pixels (`patches`), BRDFs (`kind` (K,) and `values` (K, n)), how finely surfaces are cut into
    elements (`cutting`), and arrival times (`clock`)."""

    tree: Hierarchy
    occluders: Occluders
    lasers: Lasers
    patches: Patches
    kind: Ints | NDArray[np.uint8]
    values: Floats
    cutting: Cutting
    clock: Clock


class Tally(NamedTuple):
    """All that the kernel writes.

    Attributes
    ----------
    row_of_pair, row_of_part : (n,) and (K,) indices; the light of a pair by way of a part goes into their sum's row.
    number : (n,) number of each pair, which seeds its random points: a pair of a trial and the same pair of the whole
        scan have the same points.
    histogram, overflow : (rows, T) and (rows,) photons within the window and outside.
    work : (K, 2) number of elements whose light was added, or of rays of a lattice; and of shadow rays.
    most_work : sum of `work` from which on nothing more is added.
    """

    row_of_pair: Ints
    row_of_part: Ints
    number: Ints
    histogram: Floats
    overflow: Floats
    work: Ints
    most_work: int


class TooMuchWork(Exception):
    """Light takes more elements and shadow rays than was allowed."""


@dataclass(frozen=True)
class Gathered:
    """The light of three bounces of n pairs of laser point and pixel.

    Attributes
    ----------
    histogram : (n, rows, T) photons per photon emitted.
    overflow : (n,) photons outside the window of time.
    cells, rays : (K,) number of elements, or of rays of a lattice, and of shadow rays of each part.
    """

    histogram: Floats
    overflow: Floats
    cells: Ints
    rays: Ints


@dataclass(frozen=True)
class Seen:
    """A batch of n pairs of laser point and pixel, with the footprints of their pixels.

    which : (n,) index of each pair among all pairs. pairs : (n, 2) indices of laser point and of row in `patches`.
    """

    which: Ints
    pairs: Ints
    patches: Patches


@dataclass(frozen=True)
class Gathering:
    """A scene and a capture in the arrays that the kernel reads.

    Attributes
    ----------
    width : (K,) half width of the narrowest lobe of each part, rad.
    peak : (K,) upper bound of each part's BRDF, 1/sr.
    at_edge : (P,) whether a pixel sees more than one surface, or past the edge of one.
    """

    task: Problem
    tree: Hierarchy
    occluders: Occluders
    lasers: Lasers
    clock: Clock
    width: Floats
    peak: Floats
    at_edge: Bools

    @classmethod
    def of(cls, task: Problem) -> Gathering:
        """The arrays of a task."""
        points, axis, air = task.points, task.capture.time, task.scene.attenuation_per_m
        lasers = Lasers(
            points.position, points.normal, points.to_laser, points.part, np.exp(-air * np.nan_to_num(points.leg)),
            points.leg,
        )  # fmt: skip
        per_metre, start = 1.0 / float(path_from_time(axis.width_s)), axis.start_s / axis.width_s
        clock = Clock(
            per_metre, start, axis.origin == "source", air, start / per_metre, (start + axis.bins) / per_metre
        )
        # The peak of a lobe is at most 1/width² times that of a matt surface with the same albedo, which is added.
        width = np.array([lobe_width(material) for material in task.scene.materials])
        lobes = np.array([not isinstance(material, Lambertian) for material in task.scene.materials])
        peak = task.materials.values[:, 0] / math.pi * (1.0 / width**2 + lobes)
        tree = Hierarchy.of(task.scene)
        # The radius is infinite where some line of sight of the pixel meets nothing.
        at_edge = np.isinf(task.patches.radius)
        at_edge |= at_edges(task.caster, task.scene, task.capture.sensor, task.cones)
        return cls(
            task, tree, Occluders.of(task.scene, tree), lasers, clock, width, peak, at_edge,
        )  # fmt: skip

    @cached_property
    def by_rays(self) -> Bools:
        """(K,) whether the light of each part comes by rays (`mesh_rays.py`): that of meshes of many triangles,
        unless a lobe on the path is narrow."""
        sharp = 1.0 / self.width**2
        sharpest = np.maximum(sharp, sharp[self.ends].max(initial=1.0))
        triangles = np.bincount(self.task.scene.face_part, minlength=len(sharp))
        return np.asarray((triangles >= TRIANGLES) & (sharpest <= SHARPEST))

    @property
    def ends(self) -> Bools:
        """(K,) which parts may hold a laser point or a pixel: any but objects."""
        return np.array([role != "object" for role in self.task.scene.roles])

    @cached_property
    def outlines(self) -> Outlines:
        """Convex hulls of the parts whose light comes by rays."""
        return Outlines.of(self.task.scene, self.by_rays)

    @property
    def ray_footprint(self) -> float:
        """Largest footprint that the hit of a ray is connected with, relative to its distance."""
        # Within a footprint light and arrival time are taken as independent, which a lobe makes wrong.
        narrowest = float(self.width[self.by_rays | self.ends].min(initial=1.0))
        return RAY_FOOTPRINT * math.sqrt(self.task.accuracy.each_part * narrowest)

    def ray_levels(self) -> int:
        """Times that pixels must be quartered so that footprints as small as `ray_footprint` have quarters, of which
        a random one brings the light."""
        meshes, even, patches = np.flatnonzero(self.by_rays), ~self.at_edge, self.task.patches
        if not (len(meshes) and even.any()) or self.as_points:
            return 0
        middle, radius = self.outlines.middle[meshes], self.outlines.radius[meshes]
        near = np.linalg.norm(patches.center[even, None] - middle, axis=2) - radius
        # The pixel may lie within a mesh's bounding sphere: the distance is then negative, and all levels are wanted.
        wanted = (
            2.0 * patches.radius[even]
            <= 0.5 * self.ray_footprint * near.min(axis=1) * 2.0 ** np.arange(LEVEL)[:, None]
        )
        # In a confocal pixel shadow rays go to its quarters, for its middle sees whatever the laser point lights.
        return max(int((~wanted.all(axis=1)).sum()), int(self.task.capture.pairing == "confocal"))

    @cached_property
    def pixel_size(self) -> float:
        """Largest size of some pixels that see one flat surface, metres."""
        even = np.flatnonzero(~self.at_edge)
        return float(patches_of(self.task, even[:: len(even) // SIZED + 1], 0).size.max(initial=0.0))

    @property
    def as_points(self) -> bool:
        """Whether pixels that see one flat surface are so small that they count as points."""
        at_once = self.pixel_size * self.clock.per_metre <= AT_ONCE
        return at_once and self.pixel_size <= TINY * self.tree.extent * self.width.min()

    @property
    def lobed(self) -> bool:
        """Whether some surface is not Lambertian."""
        return bool(self.task.materials.kind.any())

    def levels(self) -> int:
        """Most times that pixels which see one flat surface are quartered: once more than brings the size of their
        footprints down to one bin."""
        if self.as_points:
            return 0
        levels = math.ceil(math.log2(self.pixel_size * self.clock.per_metre)) + 1
        return max(int(np.clip(levels, *LEVELS)), self.ray_levels())

    def edge_levels(self) -> int:
        """Times that pixels which see more than one surface are quartered in the first trial."""
        return max((k for k in EDGE_LEVELS if self.at_edge.sum() * 4**k <= MOST_AT_EDGES), default=1)

    def seen(self, pairs: Ints, levels: int, edge_levels: int | None = None) -> Iterator[Seen]:
        """Footprints of the pixels of pairs (n, 2), in batches of pairs whose footprints fit into memory.

        levels, edge_levels : times that pixels which see one flat surface, and pixels at edges, are quartered; the
        latter `self.edge_levels()` if None.
        """
        at_edge, edge_levels = self.at_edge[pairs[:, 1]], self.edge_levels() if edge_levels is None else edge_levels
        for quartered, alike in ((levels, np.flatnonzero(~at_edge)), (edge_levels, np.flatnonzero(at_edge))):
            # All pairs of one pixel come in one batch, so that its footprints are computed once.
            alike = alike[np.argsort(pairs[alike, 1], kind="stable")]
            first = np.flatnonzero(np.diff(pairs[alike, 1], prepend=-1))
            for which in np.split(alike, first[:: max(VALUES_AT_ONCE // 32 >> 2 * quartered, 1)][1:]):
                if len(which):
                    pixels, row = np.unique(pairs[which, 1], return_inverse=True)
                    local = np.stack([pairs[which, 0], row.reshape(-1)], axis=1)
                    yield Seen(which, local, patches_of(self.task, pixels, quartered))

    def gathered(
        self, pairs: Ints, seen: Iterable[Seen], error: Floats, row_of_part: Ints, draw: Ints | None = None,
        matt: bool = False, clear: bool = False, most_work: int = int(np.iinfo(np.int64).max),
    ) -> Gathered:  # fmt: skip
        """The light of pairs (n, 2) of laser point and pixel, by way of part k in row row_of_part[k].

        seen : the pairs in batches, from the method `seen`.
        error : (K,) L2 error that one element of each part may make, photons; infinite for parts to be left out.
        draw : (K,) index of the set of random points on each part; zeros if None.
        matt : whether every surface is taken as Lambertian with its albedo.
        clear : whether nothing is taken to hide anything.
        most_work : elements and shadow rays beyond which `TooMuchWork` is raised.
        """
        task, parts, rows = self.task, len(error), int(row_of_part.max()) + 1
        histogram = np.zeros((len(pairs) * rows, task.capture.time.bins))
        overflow, work = np.zeros(len(histogram)), np.zeros((parts, 2), np.int64)
        seed = stream_seeds(task.seed, LightStream.CLUSTERS, 0, np.zeros(parts, np.int64) if draw is None else draw)
        materials, sharp = task.materials, 1.0 / self.width**2
        if matt:
            materials, sharp = replace(materials, kind=np.zeros_like(materials.kind)), np.ones(parts)
        cutting = Cutting(error, sharp, self.peak, not clear, seed.astype(np.int64))
        room = Room.new()
        for batch in seen:
            scan = Scan(
                self.tree, self.occluders, self.lasers, batch.patches, materials.kind, materials.values, cutting,
                self.clock,
            )  # fmt: skip
            number = pairs[batch.which, 0] * len(self.at_edge) + pairs[batch.which, 1]
            tally = Tally(batch.which, row_of_part * len(pairs), number, histogram, overflow, work, most_work)
            gather(batch.pairs, scan, self.by_rays, tally, room)
            if self.by_rays.any():
                gather_by_rays(
                    task.caster, task.scene.face_part, batch.pairs, scan, self.outlines, tally, self.ray_footprint
                )
            if work.sum() > most_work:
                raise TooMuchWork
        # In `histogram` the pairs of one row follow each other.
        of_rows = histogram.reshape(rows, len(pairs), task.capture.time.bins)
        return Gathered(
            np.moveaxis(of_rows, 0, 1), overflow.reshape(rows, len(pairs)).sum(axis=0), work[:, 0], work[:, 1]
        )


def patches_of(task: Problem, pixels: Ints, levels: int) -> Patches:
    """The footprints of the pixels with the given indices, quartered at most `levels` times."""
    return Patches.of(task.caster, task.scene, task.capture.sensor, task.cones, pixels, levels, task.seed)
