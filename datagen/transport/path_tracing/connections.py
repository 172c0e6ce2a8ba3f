"""Connections from path vertices to FoV points: geometry, BRDFs and binning in compiled loops.

Two ways of joining a vertex x₂ to a pixel are combined by the balance heuristic:

- *connect*: to each of M FoV points x₃. The kernel cosθ₂ cosθ₃ / R₂₃² has no bound where the two surfaces touch;
- *follow*: one ray drawn by the BRDF at x₂, which counts where it lands inside a pixel. It carries no 1/R².

With the footprint a₃ of a FoV point (the wall area one of the M points stands for) and p = pdf·cosθ₃/R₂₃² the area
density of the second way, the first is worth 1/(1 + p a₃) of itself and the second p a₃/(1 + p a₃). So a connection
never carries more than its footprint could receive, and what that bound takes away comes back by the followed rays:
bounded for a single sample, unbiased for any number. A vertex too far from a pixel's patch to overfill a footprint
needs no followed ray: there the first way counts whole (`PixelPatches.reach`).
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from datagen.records import Scene, Sensor
from datagen.records.arrays import Floats, Ints
from datagen.transport.brdf import MaterialTable
from datagen.transport.fields_of_view import FovPool, PixelCones, PixelPatches
from datagen.transport.path_tracing.kernels import (
    deposit,
    gather,
    inside_pixels,
    laser_points_in_pixels,
    near_a_pixel,
)
from datagen.transport.path_tracing.vertices import LaserPoints, Vertices
from datagen.transport.visibility.clear_sight import ClearSight
from datagen.transport.visibility.raycast import Hits, Raycaster

CONNECTIONS_PER_BATCH = 1 << 19


@dataclass(frozen=True)
class Clock:
    """Path length → fractional bin: position = path · per_metre − start.

    Attributes
    ----------
    per_metre : bins for each metre of path.
    start : bin number of the window's start.
    device_leg : (laser,) path from laser to laser point, m; −1 where device legs do not count (time origin `wall`).
    """

    per_metre: float
    start: float
    device_leg: Floats


@dataclass(frozen=True)
class Rows:
    """Which histogram row a contribution belongs to: rows are ordered (laser, pixel, split).

    Attributes
    ----------
    first_laser : index of the chunk's first laser point.
    confocal : pixel i belongs to laser point i alone.
    pixels : that a laser point has.
    splits : rows for each laser point and pixel.
    """

    first_laser: int
    confocal: bool
    pixels: int
    splits: int


@dataclass(frozen=True)
class Tally:
    """Where energy goes: histogram (row, bin) and overflow (row,)."""

    histogram: Floats
    overflow: Floats

    def apart(self, pieces: int) -> list[Tally]:
        """As many equal runs of rows."""
        return [
            Tally(*of) for of in zip(np.split(self.histogram, pieces), np.split(self.overflow, pieces), strict=True)
        ]


@dataclass(frozen=True)
class Receiver:
    """The sensor's side of a chunk of laser points: FoV points, pixels, clock and rows."""

    caster: Raycaster
    scene: Scene
    materials: MaterialTable
    sensor: Sensor
    pool: FovPool
    cones: PixelCones
    patches: PixelPatches
    points_per_vertex: int
    clock: Clock
    rows: Rows
    tally: Tally
    sight: ClearSight = field(default_factory=ClearSight.asking)
    pool_set: Ints | None = None
    """(laser,) the set of the pool that each of the chunk's laser points is joined to; None where there is one."""

    @property
    def aperture_square(self) -> float:
        """What a finite aperture adds to R² (see `fields_of_view.py`), m²."""
        return self.sensor.aperture_radius_m**2 if self.sensor.finite_aperture else 0.0

    def connect(self, vertices: Vertices, choice: Floats, split_of_part: Ints) -> None:
        """Join every vertex to a block of FoV points of each of its pixels, and add what nothing hides.

        choice : (n,) in 0 … 1 picks the block; split_of_part : (K,) the split for a vertex on each part.
        """
        if not len(vertices):
            return
        blocks = self.pool.weight.shape[1] // (self.points_per_vertex * self.pool.sets)
        block = np.minimum(choice * blocks, blocks - 1).astype(np.int64)
        if self.pool_set is not None:
            block += blocks * self.pool_set[vertices.laser - self.rows.first_laser]
        per_vertex = (1 if self.rows.confocal else self.rows.pixels) * self.points_per_vertex
        per_batch = min(max(1, CONNECTIONS_PER_BATCH // per_vertex), len(vertices))
        capacity = per_batch * per_vertex
        origins, spans = np.empty((capacity, 3), np.float32), np.empty((capacity, 3), np.float32)
        row, position, energy = np.empty(capacity, np.int64), np.empty(capacity), np.empty(capacity)
        v, pool, rows, tally = vertices, self.pool, self.rows, self.tally
        seen = rows.first_laser + np.arange(len(pool.weight)) if rows.confocal else np.arange(rows.pixels)
        self.sight.prepare(len(v) * per_vertex)
        tile = self.sight.tiles(pool, seen)
        for start in range(0, len(vertices), per_batch):
            stop = min(start + per_batch, len(v))
            own = v.laser[start:stop] if rows.confocal else None
            clear = self.sight.clear(v.position[start:stop], v.normal[start:stop], own)
            found, added = gather(
                start, stop, v.laser, v.position, v.normal, v.to_previous, v.part, v.power,
                v.path, block, pool.position, pool.normal, pool.to_sensor, pool.part, pool.weight, pool.footprint,
                pool.last_leg, self.patches.center, self.patches.reach, self.materials.kind, self.materials.values,
                self.points_per_vertex, self.scene.attenuation_per_m, rows.first_laser, rows.confocal, rows.pixels,
                split_of_part, rows.splits, self.clock.per_metre, self.clock.start, self.clock.device_leg,
                self.caster.center, self.caster.half_extent_m, self.caster.offset_m, tile, clear, tally.histogram,
                tally.overflow, origins, spans, row, position, energy,
            )  # fmt: skip
            self.sight.count(found + added, without_ray=added)
            hidden = self.caster.occluded_scaled(origins[:found], spans[:found])
            deposit(row[:found], position[:found], energy[:found], hidden, tally.histogram, tally.overflow)

    def near(self, vertices: Vertices) -> Ints:
        """The vertices whose followed rays count: those near any of their pixels."""
        return np.asarray(
            near_a_pixel(
                vertices.laser, vertices.position, vertices.part, self.materials.kind, self.patches.center,
                self.patches.reach, self.rows.first_laser, self.rows.confocal,
            )
        )  # fmt: skip

    def follow(
        self, vertices: Vertices, hits: Hits, directions: Floats, throughput: Floats, split_of_part: Ints
    ) -> None:
        """Add those of the vertices' own rays (with their throughput f cosθ / pdf) that land inside a pixel."""
        part = np.where(hits.valid, self.scene.face_part[hits.face], -1).astype(np.int64)
        v, rows = vertices, self.rows
        owner, row, position, energy = inside_pixels(
            hits.position, hits.normal, part, directions, throughput, v.laser, v.position, v.normal, v.to_previous,
            v.part, v.power, v.path, self.materials.kind, self.materials.values, self.sensor.position,
            self.cones.planes, self.cones.solid_angle, self.patches.center, self.patches.reach,
            self.sensor.aperture_area_m2, self.aperture_square, self.scene.attenuation_per_m, self.points_per_vertex,
            rows.first_laser, rows.confocal, rows.pixels, split_of_part, rows.splits, self.clock.per_metre,
            self.clock.start, self.clock.device_leg,
        )  # fmt: skip
        self._add_if_seen(hits.position[owner] + self.caster.offset_m * hits.normal[owner], row, position, energy)

    def add_laser_points(self, points: LaserPoints, lasers: Ints, split: int) -> None:
        """Add the laser points themselves where a pixel looks at them: the direct return of one bounce."""
        rows = self.rows
        owner, row, position, energy = laser_points_in_pixels(
            lasers, points.position, points.normal, points.to_laser, points.part, points.leg, self.materials.kind,
            self.materials.values, self.sensor.position, self.cones.planes, self.sensor.aperture_area_m2,
            self.aperture_square, self.scene.attenuation_per_m, rows.first_laser, rows.confocal, rows.pixels, split,
            rows.splits, self.clock.per_metre, self.clock.start, self.clock.device_leg,
        )  # fmt: skip
        self._add_if_seen(points.position[owner] + self.caster.offset_m * points.normal[owner], row, position, energy)

    def _add_if_seen(self, lifted: Floats, row: Ints, position: Floats, energy: Floats) -> None:
        hidden = self.caster.occluded(self.sensor.position, lifted)
        deposit(row, position, energy, hidden, self.tally.histogram, self.tally.overflow)
