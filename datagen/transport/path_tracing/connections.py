"""Next-event estimation: path vertices are connected with FoV points, and what arrives is put into time bins.

Two ways to find the last leg, from a vertex x₂ to a FoV point x₃, are combined by the balance heuristic:

- *connect* x₂ to each of M FoV points drawn from the pixel. The factor cosθ₂ cosθ₃ / R₂₃² has no bound where the two
  surfaces touch;
- *follow* one ray drawn by the BRDF at x₂, which counts where it lands inside a pixel. It carries no 1/R².

With the footprint a₃ of a FoV point (the wall area one of the M points stands for) and p = pdf·cosθ₃/R₂₃² the area
density of the second way, the first is worth 1/(1 + p a₃) of itself and the second p a₃/(1 + p a₃). So a connection
never carries more than its footprint could receive, and what that bound takes away comes back by the rays that are
followed: bounded for a single sample, unbiased for any number. A vertex too far from a pixel's patch to overfill a
footprint needs no such ray: there the first way counts whole (`PixelPatches.reach`).

In the loops a trailing 1 means at the laser point, 2 at a vertex, 3 at a FoV point.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from datagen.compiled import compiled
from datagen.records import Scene, Sensor
from datagen.records.arrays import Bools, Floats, Ints
from datagen.transport.binning import put
from datagen.transport.brdf import LAMBERTIAN, Materials, MaterialTable, Vector, dot, evaluate, pdf
from datagen.transport.fields_of_view import FovPool, PixelCones, PixelPatches
from datagen.transport.path_tracing.vertices import LaserPoints, Vertices, at
from datagen.transport.visibility.raycast import Hits, Raycaster, lifted_and_scaled

CONNECTIONS_PER_BATCH = 1 << 19
"""Connections whose shadow rays wait together, 24 MiB; with half as many embree's calls still cost nothing."""


class Clock(NamedTuple):
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


class Rows(NamedTuple):
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


class Tally(NamedTuple):
    """Where energy goes: histogram (row, bin) and overflow (row,)."""

    histogram: Floats
    overflow: Floats

    def apart(self, pieces: int) -> list[Tally]:
        """As many equal runs of rows."""
        return [
            Tally(*of) for of in zip(np.split(self.histogram, pieces), np.split(self.overflow, pieces), strict=True)
        ]


class Device(NamedTuple):
    """The sensor, and the air before it.

    Attributes
    ----------
    position : (3,) metres.
    aperture_area, aperture_square : m²; what a finite aperture adds to R² (`fields_of_view.py`), or 0.
    fov_samples : FoV points that a vertex is connected with in each pixel.
    attenuation : of the air, 1/m.
    """

    position: Floats
    aperture_area: float
    aperture_square: float
    fov_samples: int
    attenuation: float


class Frame(NamedTuple):
    """Embree's frame (`raycast.lifted_and_scaled`): how far ray ends are lifted, and centre with half extent (4,)."""

    offset: float
    scale: Floats


class Arrivals(NamedTuple):
    """Energies that arrive if nothing hides them.

    owner : (n,) vertex or laser point. row : (n,) of the histogram. position : (n,) fractional bin. energy : (n,).
    """

    owner: Ints
    row: Ints
    position: Floats
    energy: Floats


class Waiting(NamedTuple):
    """Room for connections that wait for their shadow rays: origins and spans (n, 3) in embree's frame."""

    origin: NDArray[np.float32]
    span: NDArray[np.float32]
    arrivals: Arrivals

    @classmethod
    def room(cls, n: int) -> Waiting:
        """Room for n connections."""
        arrivals = Arrivals(np.empty(n, np.int64), np.empty(n, np.int64), np.empty(n), np.empty(n))
        return cls(np.empty((n, 3), np.float32), np.empty((n, 3), np.float32), arrivals)


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
    occlusion: bool = True
    """Whether anything may stand between a vertex and a FoV point."""
    pool_set: Ints | None = None
    """(laser,) the set of the pool that each of the chunk's laser points connects with; None where there is one."""

    @property
    def device(self) -> Device:
        """The sensor as the loops want it."""
        sensor = self.sensor
        near = sensor.aperture_radius_m**2 if sensor.finite_aperture else 0.0
        return Device(
            sensor.position, sensor.aperture_area_m2, near, self.points_per_vertex, self.scene.attenuation_per_m
        )

    def connect(self, vertices: Vertices, choice: Floats, split_of_part: Ints) -> int:
        """Connect every vertex with a block of FoV points of each of its pixels, and add what nothing hides; returns
        how many connections could carry energy.

        choice : (n,) in 0 … 1 picks the block; split_of_part : (K,) the split for a vertex on each part.
        """
        blocks = self.pool.weight.shape[1] // (self.points_per_vertex * self.pool.sets)
        block = np.minimum(choice * blocks, blocks - 1).astype(np.int64)
        if self.pool_set is not None:
            block += blocks * self.pool_set[vertices.laser - self.rows.first_laser]
        count, bright = len(vertices.laser), 0
        per_vertex = (1 if self.rows.confocal else self.rows.pixels) * self.points_per_vertex
        per_batch = max(1, min(CONNECTIONS_PER_BATCH // per_vertex, count))
        waiting = Waiting.room(per_batch * per_vertex)
        frame = Frame(self.caster.offset_m, np.append(self.caster.center, self.caster.half_extent_m))
        for start in range(0, count, per_batch):
            batch = slice(start, start + per_batch)
            found = connections(
                vertices.take(batch), block[batch], self.pool, self.patches, self.materials.arrays, self.device,
                self.clock, self.rows, split_of_part, frame, waiting,
            )  # fmt: skip
            arrivals = Arrivals._make(values[:found] for values in waiting.arrivals)
            hidden = np.zeros(found, np.bool_)
            if self.occlusion:
                hidden = self.caster.occluded_scaled(waiting.origin[:found], waiting.span[:found])
            deposit(arrivals, hidden, self.tally)
            bright += found
        return bright

    def near(self, vertices: Vertices) -> Ints:
        """The vertices whose followed rays count: those near any of their pixels."""
        return np.asarray(near_a_pixel(vertices, self.materials.kind, self.patches, self.rows))

    def follow(
        self, vertices: Vertices, hits: Hits, directions: Floats, throughput: Floats, split_of_part: Ints
    ) -> None:
        """Add those of the vertices' own rays (with their throughput f cosθ / pdf) that land inside a pixel."""
        part = np.where(hits.valid, self.scene.face_part[hits.face], -1).astype(np.int64)
        found = landed(
            vertices, hits, part, directions, throughput, self.materials.arrays, self.cones, self.patches,
            self.device, self.clock, self.rows, split_of_part,
        )  # fmt: skip
        self._add_if_seen(hits.position[found.owner] + self.caster.offset_m * hits.normal[found.owner], found)

    def add_laser_points(self, points: LaserPoints, lasers: Ints, split: int) -> None:
        """Add the laser points themselves where a pixel looks at them: the direct return of one bounce."""
        found = laser_points_seen(
            lasers, points, self.materials.arrays, self.cones, self.device, self.clock, self.rows, split
        )  # fmt: skip
        self._add_if_seen(points.position[found.owner] + self.caster.offset_m * points.normal[found.owner], found)

    def _add_if_seen(self, lifted: Floats, found: Arrivals) -> None:
        deposit(found, self.caster.occluded(self.sensor.position, lifted), self.tally)


@compiled(inline="always")
def _is_near(position: Vector, kind: int, patches: PixelPatches, p: int) -> bool:
    """Whether a vertex could overfill a footprint of pixel p; a lobe narrower than Lambert's always could."""
    reach = patches.reach[p]
    if kind != LAMBERTIAN or reach == np.inf:
        return True
    c = patches.center
    d = (position[0] - c[p, 0], position[1] - c[p, 1], position[2] - c[p, 2])
    return bool(dot(d, d) < reach * reach)


@compiled(inline="always")
def _first_pixel(rows: Rows, local: int) -> int:
    """The first pixel that laser point `local` of the chunk is seen by; confocally its own is all it has."""
    return local if rows.confocal else 0


@compiled(inline="always")
def _end_of_pixels(rows: Rows, local: int) -> int:
    return local + 1 if rows.confocal else rows.pixels


@compiled(inline="always")
def _row(rows: Rows, local: int, p: int, split: int) -> int:
    return (local if rows.confocal else local * rows.pixels + p) * rows.splits + split


@compiled(inline="always")
def _bin(path: float, last_leg: float, local: int, clock: Clock) -> float:
    """Fractional bin at which a path arrives; legs to and from the devices count where the clock has any."""
    device = clock.device_leg[local] + last_leg if clock.device_leg[local] >= 0.0 else 0.0
    return (path + device) * clock.per_metre - clock.start


@compiled(inline="always")
def _inside(span: Vector, cones: PixelCones, p: int) -> bool:
    """Whether the point from which `span` leads to the sensor lies inside pixel p."""
    inside = True
    for k in range(4):
        inside = inside and dot(span, at(cones.planes[p], k)) <= 0.0
    return inside


@compiled()
def near_a_pixel(v: Vertices, kind: NDArray[np.integer], patches: PixelPatches, rows: Rows) -> Ints:
    """Indices of the vertices that are near any of their pixels."""
    kept = np.empty(len(v.laser), np.int64)
    n = 0
    for i in range(len(v.laser)):
        local = v.laser[i] - rows.first_laser
        for p in range(_first_pixel(rows, local), _end_of_pixels(rows, local)):
            if _is_near(v.position[i], kind[v.part[i]], patches, p):
                kept[n] = i
                n += 1
                break
    return kept[:n]


@compiled()
def connections(
    v: Vertices, block: Ints, pool: FovPool, patches: PixelPatches, materials: Materials, device: Device,
    clock: Clock, rows: Rows, split_of_part: Ints, frame: Frame, waiting: Waiting,
) -> int:  # fmt: skip
    """Write every connection of the vertices that can carry energy to `waiting`; returns how many these are.

    The energy is power · f₂ cosθ₂ · cosθ₃ f₃ / R₂₃² · A dΩ of the FoV point, by the balance heuristic.
    """
    n, wait = 0, waiting.arrivals
    for i in range(len(v.laser)):
        local = v.laser[i] - rows.first_laser
        x2, n2, w_in = at(v.position, i), at(v.normal, i), at(v.to_previous, i)
        k2, material2 = materials.kind[v.part[i]], materials.values[v.part[i]]
        # Both ends of a shadow ray are lifted off their surfaces, which would hide them by single-precision rounding.
        start = lifted_and_scaled(x2, n2, frame.offset, frame.scale)
        for p in range(_first_pixel(rows, local), _end_of_pixels(rows, local)):
            near = _is_near(v.position[i], k2, patches, p)
            for q in range(block[i] * device.fov_samples, (block[i] + 1) * device.fov_samples):
                # A line of sight that met nothing, or a surface edge-on.
                if pool.weight[p, q] == 0.0:
                    continue
                x3, n3 = at(pool.position[p], q), at(pool.normal[p], q)
                d = (x3[0] - x2[0], x3[1] - x2[1], x3[2] - x2[2])
                square = dot(d, d)
                # Surfaces transmit nothing: each end must lie before the other's front side.
                toward, away = dot(d, n2), -dot(d, n3)
                if toward <= 0.0 or away <= 0.0 or square == 0.0:
                    continue
                distance = math.sqrt(square)
                inverse = 1.0 / distance
                w = (d[0] * inverse, d[1] * inverse, d[2] * inverse)
                back = (-w[0], -w[1], -w[2])
                cos2, cos3 = toward * inverse, away * inverse
                f2 = evaluate(k2, material2, n2, w_in, w)
                part3 = pool.part[p, q]
                f3 = evaluate(materials.kind[part3], materials.values[part3], n3, back, at(pool.to_sensor[p], q))
                # 1/R² becomes 1/(R² + pdf cosθ₃ a₃): the balance heuristic's share of this way, which bounds it.
                followed = pdf(k2, material2, n2, w_in, w) * cos3 * pool.footprint[p, q] if near else 0.0
                energy = v.power[i] * f2 * f3 * cos2 * cos3 * pool.weight[p, q] / (square + followed)
                if device.attenuation > 0.0:
                    energy *= math.exp(-device.attenuation * (distance + pool.last_leg[p, q]))
                # Not `<= 0`: what is no number is left out, too.
                if not energy > 0.0:
                    continue
                end = lifted_and_scaled(x3, n3, frame.offset, frame.scale)
                for k in range(3):
                    waiting.origin[n, k], waiting.span[n, k] = start[k], end[k] - start[k]
                wait.row[n] = _row(rows, local, p, split_of_part[v.part[i]])
                wait.position[n] = _bin(v.path[i] + distance, pool.last_leg[p, q], local, clock)
                wait.energy[n] = energy
                n += 1
    return n


@compiled()
def deposit(arrivals: Arrivals, hidden: Bools, tally: Tally) -> None:
    """Add the arrivals that nothing hides."""
    for k in range(len(arrivals.row)):
        if not hidden[k]:
            row = arrivals.row[k]
            tally.overflow[row] += put(tally.histogram[row], arrivals.position[k], arrivals.energy[k])


@compiled()
def landed(
    v: Vertices, hits: Hits, part3: Ints, direction: Floats, throughput: Floats, materials: Materials,
    cones: PixelCones, patches: PixelPatches, device: Device, clock: Clock, rows: Rows, split_of_part: Ints,
) -> Arrivals:  # fmt: skip
    """The vertices' own rays that landed inside a pixel, which count if the sensor sees where."""
    owners, in_rows = [np.int64(0)], [np.int64(0)]
    positions, energies = [0.0], [0.0]
    for i in range(len(v.laser)):
        if part3[i] < 0 or throughput[i] <= 0.0:
            continue
        x2, x3, n3, w = at(v.position, i), at(hits.position, i), at(hits.normal, i), at(direction, i)
        span = (device.position[0] - x3[0], device.position[1] - x3[1], device.position[2] - x3[2])
        reach_square = dot(span, span)
        reach = math.sqrt(reach_square)
        out = (span[0] / reach, span[1] / reach, span[2] / reach)
        cos_sensor, cos3 = dot(out, n3), -dot(w, n3)
        # Only the side that the light falls on is seen.
        if cos_sensor <= 0.0 or cos3 <= 0.0:
            continue
        local = v.laser[i] - rows.first_laser
        k2, material2 = materials.kind[v.part[i]], materials.values[v.part[i]]
        for p in range(_first_pixel(rows, local), _end_of_pixels(rows, local)):
            # Of vertices that are not near, connections have taken all of the light.
            if not (_is_near(v.position[i], k2, patches, p) and _inside(span, cones, p)):
                continue
            d = (x3[0] - x2[0], x3[1] - x2[1], x3[2] - x2[2])
            square = dot(d, d)
            distance = math.sqrt(square)
            density = pdf(k2, material2, at(v.normal, i), at(v.to_previous, i), w)
            # The footprint that a connection would have had here: Ω R_s² / (cosθ_s M).
            followed = density * cos3 * cones.solid_angle[p] * reach_square / (cos_sensor * device.fov_samples)
            f3 = evaluate(materials.kind[part3[i]], materials.values[part3[i]], n3, (-w[0], -w[1], -w[2]), out)
            energy = (
                v.power[i] * throughput[i] * (followed / (square + followed))
                * f3 * device.aperture_area * cos_sensor / (reach_square + device.aperture_square)
            )  # fmt: skip
            if device.attenuation > 0.0:
                energy *= math.exp(-device.attenuation * (distance + reach))
            if not energy > 0.0:
                continue
            owners.append(np.int64(i))
            in_rows.append(np.int64(_row(rows, local, p, split_of_part[v.part[i]])))
            positions.append(_bin(v.path[i] + distance, reach, local, clock))
            energies.append(energy)
    # The first entries only told the compiler the types of the lists.
    return Arrivals(np.array(owners[1:]), np.array(in_rows[1:]), np.array(positions[1:]), np.array(energies[1:]))


@compiled()
def laser_points_seen(
    lasers: Ints, points: LaserPoints, materials: Materials, cones: PixelCones, device: Device, clock: Clock,
    rows: Rows, split: int,
) -> Arrivals:  # fmt: skip
    """Laser points that a pixel looks at (one bounce), which count if the sensor sees them: f cosθ A / R²."""
    owners, in_rows = [np.int64(0)], [np.int64(0)]
    positions, energies = [0.0], [0.0]
    for o in lasers:
        local = o - rows.first_laser
        x1, n1, part1 = at(points.position, o), at(points.normal, o), points.part[o]
        span = (device.position[0] - x1[0], device.position[1] - x1[1], device.position[2] - x1[2])
        reach_square = dot(span, span)
        reach = math.sqrt(reach_square)
        out = (span[0] / reach, span[1] / reach, span[2] / reach)
        # There is no vertex to connect with, so all is known but whether a pixel looks there and the sensor sees it.
        f = evaluate(materials.kind[part1], materials.values[part1], n1, at(points.to_laser, o), out)
        energy = f * dot(out, n1) * device.aperture_area / (reach_square + device.aperture_square)
        energy *= math.exp(-device.attenuation * (points.leg[o] + reach))
        # The sensor looks at the other side of the surface.
        if not energy > 0.0:
            continue
        for p in range(_first_pixel(rows, local), _end_of_pixels(rows, local)):
            if _inside(span, cones, p):
                owners.append(np.int64(o))
                in_rows.append(np.int64(_row(rows, local, p, split)))
                positions.append(_bin(0.0, reach, local, clock))
                energies.append(energy)
    return Arrivals(np.array(owners[1:]), np.array(in_rows[1:]), np.array(positions[1:]), np.array(energies[1:]))
