"""Unbiased paths of light, drawn where most light is: the plain sampler, and the check of every faster one.

The paths estimate the integral of `reference.py`, equation (1) there: the mean is the same in every scene, and the
noise is far smaller. Nothing is shared with the faster ways but the ray caster and the BRDFs.

The last two vertices of a path, h = x_{B−1} and v = x_B, are drawn in three ways, given b = x_{B−2}:

- *join*: h from b, by the BRDF at b or, for x₂, also uniformly on the parts' areas; v from the pixel;
- *back*: v from the pixel, h from v by the BRDF at v. This way finds surfaces right beside the field of view;
- *land*: h from b, v from h by the BRDF at h, if v falls inside the pixel. This way finds lobes, and
  paths between surfaces that touch within the pixel, whose weight it bounds.

A path counts with the integrand over the sum of the densities of all three ways, whichever of them found it (the
balance heuristic: Veach & Guibas, SIGGRAPH 1995). So together they count every path once.

`Tracer` draws the paths, `path_light.py` adds them up in time bins; `sample_paths` returns them one by one:

    materials, caster = MaterialTable.of(scene.materials), Raycaster(scene)
    paths = sample_paths(caster, scene, materials, capture, pairs_of(capture), samples=64, max_bounces=4)
    energy_by_part = np.bincount(paths.part, paths.photons)
    transient = reference(scene, capture, samples=4096, max_bounces=4, draw=sample_paths)

Samples are followed in batches. Compiled loops (`path_steps.py`) make the rays of one step for a whole batch, embree
finds what they meet, and the next loop goes on from there.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from datagen.records import Capture, Scene
from datagen.records.arrays import Floats, Ints, joined_rows, rows_of
from datagen.seeding import LightStream
from datagen.transport import path_steps as steps
from datagen.transport.brdf import MaterialTable
from datagen.transport.fields_of_view import PixelCones
from datagen.transport.laser_points import targets_in_cells
from datagen.transport.path_aim import GUESSES_PER_SAMPLE, Aim, aim_at_pairs, aim_of
from datagen.transport.path_steps import Found, PathSetup, Rays, Samples, Vertices, empty_record, first_rows
from datagen.transport.rays import Raycaster
from datagen.transport.reference import Paths, dots
from datagen.transport.sampling import ROULETTE_FROM, SURVIVAL, sobol_points, stream_seeds
from datagen.transport.scene_numbers import SceneNumbers

AT_ONCE = 1 << 14
"""Samples in a batch. More take more memory (1 KB each); fewer spend more time between the compiled loops."""


class _Buffers:
    """Arrays for the steps of a batch, used again and again: fresh memory would cost a third of the time."""

    def __init__(self, samples: int) -> None:
        self.rays, self.found = empty_record(Rays, samples), empty_record(Found, samples)
        self.of = np.empty(samples, np.int64)
        self.fov, self.beside, self.back = (empty_record(Vertices, samples) for _ in range(3))
        # A path's last vertex, the one before, and the next one.
        self.turn = [empty_record(Vertices, samples) for _ in range(3)]


class _Batch:
    """Samples `first` … `last` − 1 of some pairs, counted pair by pair, and the steps of their paths.

    What a step returns holds until the same step is taken again.
    """

    def __init__(self, tracer: Tracer, first: int, last: int) -> None:
        self.tracer, self.setup, self.caster, self.buffers = tracer, tracer.setup, tracer.caster, tracer.buffers
        pair, number = np.divmod(np.arange(first, last), tracer.samples)
        self.laser, pixel = tracer.pairs[pair].T.copy()
        numbers = sobol_points(tracer.seeds[pair], number, steps.DIMENSIONS)
        aim = tracer.aim_of_pairs(np.arange(pair[0], pair[-1] + 1))
        self.samples = Samples(pixel, numbers, tracer.later[pair], number, pair - pair[0], aim)

    def first_faces(self, rays: Rays) -> NDArray[np.int32]:
        """The first triangle (n,) along each ray, −1 for none."""
        return self.caster.closest_scaled(rays.origin, rays.direction)

    def unhidden_paths(self, count: int) -> Found:
        """The first `count` paths, without those whose shadow ray meets something."""
        rays = first_rows(self.buffers.rays, count)
        is_hidden = self.caster.occluded_scaled(rays.origin, rays.direction)
        return rows_of(first_rows(self.buffers.found, count), ~is_hidden)

    def laser_points(self) -> Vertices:
        """The laser points x₁ of the samples whose laser ray meets a surface."""
        laser, points, number = self.tracer.capture.laser, self.tracer.lasers, self.tracer.laser_row[self.laser]
        if laser.cells is not None:
            # Where a beam states its cells, a laser point is anywhere in its own.
            toward = targets_in_cells(laser, self.laser, self.samples.numbers[:, 9:11])
            points, number = self.tracer.points_toward(toward)
        x = self.buffers.turn[2]
        return first_rows(x, steps.fill_laser_points(self.setup, points, number, x))

    def vertices_beside(self, v: Vertices) -> Vertices:
        """For each sample the vertex that its FoV point sees along a ray drawn by the BRDF, against the direction of
        light; its triangle is −1 for none."""
        rays = first_rows(self.buffers.rays, steps.rays_back(self.setup, v, self.samples.numbers, self.buffers.rays))
        steps.fill_seen_vertices(self.setup, v, rays, self.first_faces(rays), self.buffers.beside)
        return self.buffers.beside

    def vertices_at_ends(self, b: Vertices, count: int, order: int, returning: bool) -> tuple[Vertices, Ints]:
        """The vertices that vertices b, the last before the FoV point of paths of `order`, light along the first
        `count` rays, and the row of the b of each."""
        rays, turn = first_rows(self.buffers.rays, count), self.buffers.turn
        x = self.buffers.back if returning else turn[(order + 1) % 3]
        faces, of = self.first_faces(rays), self.buffers.of
        count = steps.fill_arrivals(self.setup, self.samples, b, rays, faces, order == 2, returning, x, of)
        return first_rows(x, count), of[:count]

    def join(self, x: Vertices, v: Vertices, order: int) -> int:
        """Number of paths of `order` bounces from vertices x to the FoV points drawn from the pixel; they and their
        shadow rays are in the buffers."""
        found, rays = self.buffers.found, self.buffers.rays
        return int(steps.fill_joined_paths(self.setup, self.samples, x, v, order, found, rays))

    def paths_back(self, b: Vertices, h: Vertices, v: Vertices, order: int) -> Found:
        """Paths of `order` bounces from vertices b by way of vertices h that `vertices_beside` found."""
        count = steps.rays_toward(self.setup, b, h, self.buffers.rays)
        # h was found by a ray from v, so that nothing stands between.
        x, _ = self.vertices_at_ends(b, count, order - 1, True)
        return first_rows(self.buffers.found, self.join(x, v, order))

    def vertices_onward(self, x: Vertices, order: int) -> tuple[Vertices, Ints]:
        """The next vertices that the vertices x of `order` light, and the row of the x of each."""
        if order == 2:
            count = steps.rays_to_second(self.setup, self.samples, x, self.buffers.rays)
        else:
            count = steps.rays_onward(self.setup, self.samples, x, order, self.buffers.rays)
        return self.vertices_at_ends(x, count, order, False)

    def paths_that_land(self, x: Vertices, y: Vertices, of: Ints, order: int) -> Found:
        """Paths of `order` bounces whose last vertex y, where a ray from x landed, falls inside the pixel."""
        found, rays = self.buffers.found, self.buffers.rays
        return self.unhidden_paths(steps.fill_landed_paths(self.setup, self.samples, x, y, of, order, found, rays))

    def paths_of_one_bounce(self, x: Vertices) -> Found:
        """Paths of one bounce: the laser points x themselves where the pixel sees them."""
        found, rays = self.buffers.found, self.buffers.rays
        return self.unhidden_paths(steps.fill_paths_of_one_bounce(self.setup, self.samples, x, found, rays))

    def survivors(self, x: Vertices, y: Vertices, of: Ints, order: int) -> Vertices:
        """Russian roulette: some of the vertices y, with more power, so that paths end."""
        stays = np.clip(y.power / x.power[of], *SURVIVAL)
        drawn = steps.later_numbers(self.samples.seeds[y.sample], self.samples.number[y.sample], order)
        return rows_of(y._replace(power=y.power / stays), drawn < stays)

    def paths(self, max_bounces: int | None, direct: bool) -> Iterator[tuple[int, Found]]:
        """All paths of the batch, by order and way."""
        x, v = self.laser_points(), self.tracer.fov_points(self.samples.pixel, self.samples.numbers)
        if direct:
            yield 1, self.paths_of_one_bounce(x)
        order, b, h = 2, x, v
        # x is the vertex before the FoV point of paths of `order`, and b the one before that.
        while max_bounces != 1 and len(x.sample):
            if order == 3:
                h = self.vertices_beside(v)
            is_wanted = order > 2 or direct
            if is_wanted:
                yield order, self.unhidden_paths(self.join(x, v, order))
            if order > 2:
                yield order, self.paths_back(b, h, v, order)
            if order == max_bounces and not is_wanted:
                return
            y, of = self.vertices_onward(x, order)
            if is_wanted:
                yield order, self.paths_that_land(x, y, of, order)
            if order == max_bounces:
                return
            if max_bounces is None and order >= ROULETTE_FROM:
                y = self.survivors(x, y, of, order)
            b, x, order = x, y, order + 1


class Tracer:
    """The paths of `samples` samples for each of some pairs of laser point and pixel."""

    def __init__(
        self, caster: Raycaster, scene: Scene, materials: MaterialTable, capture: Capture, pairs: Ints, samples: int,
        seed: int,
    ) -> None:  # fmt: skip
        self.caster, self.capture, self.samples = caster, capture, samples
        self.pairs = np.asarray(pairs, np.int64).reshape(-1, 2)
        # A scrambling for each pair, so that the errors of pairs are independent.
        rows = np.arange(len(self.pairs))
        self.seeds = stream_seeds(seed, LightStream.SAMPLED_PATHS, rows)
        self.later = stream_seeds(seed, LightStream.LATER_PATHS, rows)
        self.corners = capture.sensor.pixels - capture.sensor.position
        self.setup = self.setup_of(scene, materials)
        self.lasers, self.laser_row = self.points_toward(capture.laser.targets)
        planes = np.column_stack([self.lasers.position, self.lasers.normal])
        self.buffers = _Buffers(min(len(self.pairs) * samples, AT_ONCE))
        # No more guesses than a batch of samples pays for.
        self.even_aim = aim_of(caster, scene, planes, GUESSES_PER_SAMPLE * min(samples, AT_ONCE))
        middle = caster.corners.mean(axis=1, keepdims=True)
        self.radius = np.linalg.norm(caster.corners - middle, axis=2).max(axis=1)

    def paths(self, max_bounces: int | None, direct: bool) -> Iterator[tuple[int, int, Found]]:
        """All paths in batches of one order: the number of the batch's first sample, the order, the paths, which hold
        until the next batch.

        max_bounces : highest number of bounces, or None for no limit. direct : whether to add paths of one and two
        bounces.
        """
        total = len(self.pairs) * self.samples
        # Whole pairs in a batch where they fit, so that a pair's guesses are made once.
        at_once = AT_ONCE // self.samples * self.samples if self.samples <= AT_ONCE else AT_ONCE
        for first in range(0, total, at_once):
            for order, found in _Batch(self, first, min(first + at_once, total)).paths(max_bounces, direct):
                yield first, order, found

    def aim_of_pairs(self, pairs: Ints) -> Aim:
        """How some pairs (n,) draw points by area."""
        laser, pixel = self.pairs[pairs].T.copy()
        v, number = self.fov_points(pixel, np.full((len(pairs), 2), 0.5)), self.laser_row[laser]
        x = Vertices(*(values[number] for values in self.lasers)) if len(self.lasers.sample) else v
        x = x._replace(power=x.power * (number >= 0))
        size = 0.5 * np.sqrt(self.setup.solid_angle[pixel]) * v.path
        return aim_at_pairs(self.even_aim, self.setup, x, v, size, self.caster.face_area_m2, self.radius)

    def fov_points(self, pixel: Ints, numbers: Floats) -> Vertices:
        """FoV points of pixels (n,) at places in the pixel that two numbers (n, 2) give, a row for each; `power` is 0
        where a line of sight meets nothing."""
        rays, v = first_rows(self.buffers.rays, len(pixel)), first_rows(self.buffers.fov, len(pixel))
        solid = np.empty(len(pixel))
        steps.lines_of_sight(self.setup, self.corners, pixel, numbers, rays, solid)
        faces = self.caster.closest_scaled(rays.origin, rays.direction)
        steps.fill_fov_points(self.setup, rays, faces, solid, v)
        return v

    def setup_of(self, scene: Scene, materials: MaterialTable) -> PathSetup:
        """What the compiled loops need to know, but for the density of points by area."""
        caster, sensor = self.caster, self.capture.sensor
        cones, pixels, (x, y, z) = PixelCones.of(sensor), len(sensor.pixels), map(float, sensor.position)
        footprints, into = np.ones((pixels, 1, 1)), np.zeros((pixels, 3, 3))
        if sensor.footprints is not None:
            a, b, d = (self.corners[:, k] for k in (0, 1, 3))
            footprints, into = sensor.footprints.copy(), np.linalg.inv(np.stack([b - a, d - a, a], axis=2))
        return PathSetup(
            SceneNumbers.of(caster, scene, materials, self.capture.time), caster.corners, caster.face_normal,
            scene.face_part.astype(np.int64), (x, y, z), sensor.aperture_area_m2,
            sensor.aperture_radius_m**2 if sensor.finite_aperture else 0.0, cones.planes, cones.solid_angle,
            footprints, into,
        )  # fmt: skip

    def points_toward(self, targets: Floats) -> tuple[Vertices, Ints]:
        """Where laser rays toward targets (n, 3) meet a surface, and (n,) the row of each, −1 for none."""
        origin = self.capture.laser.position
        hits = self.caster.closest(origin, targets - origin)
        rows = np.flatnonzero(hits.valid)
        row = np.full(len(targets), -1)
        row[rows] = np.arange(len(rows))
        position, normal = hits.position[rows], hits.normal[rows]
        span = origin - position
        leg = np.sqrt(dots(span, span))
        # An emitted photon is shared by all samples.
        power = np.exp(-self.setup.scene.air * leg) / self.samples
        path, face = leg * self.setup.scene.from_source, hits.face[rows].astype(np.int64)
        points = Vertices(rows, face, position, normal, span / leg[:, None], power, np.zeros(len(rows)), path)
        return points, row


def sample_paths(
    caster: Raycaster, scene: Scene, materials: MaterialTable, capture: Capture, pairs: Ints, samples: int, *,
    max_bounces: int | None = 3, direct: bool = False, seed: int = 0,
) -> Paths:  # fmt: skip
    """Weighted paths of light for some pairs of laser point and pixel, unbiased for any number of samples.

    pairs : (n, 2) indices of laser point and pixel. samples : number for each pair; a sample finds up to three paths
        of each order. A power of two makes the most of the quasi-random numbers.
    max_bounces : highest number of bounces, or None for no limit (Russian roulette). direct : whether to add paths of
        one and two bounces. seed : the same seed gives the same paths.

    A laser point of a beam that states its cells (`Laser.cells`) lies anywhere in its cell, for paths of all orders.
    """
    none, nothing = np.empty(0, np.int64), np.empty(0)
    found = [Paths(none, none, none, none, nothing, nothing)]
    tracer = Tracer(caster, scene, materials, capture, pairs, samples, seed)
    for first, order, new in tracer.paths(max_bounces, direct):
        sample = new.sample + first
        # Copies, as the arrays of a batch are used again.
        found.append(Paths(
            sample // samples, sample, np.full(len(sample), order), new.part.copy(), new.path.copy(),
            new.photons.copy(),
        ))  # fmt: skip
    return joined_rows(*found)
