"""Next-event estimation: vertices of paths are connected with FoV points, and their light is put into time bins.

The last leg of a path, from a vertex x₂ to a FoV point x₃, is found in two ways, combined by the balance heuristic:

- *connect*: x₂ is connected with each of M FoV points drawn from the pixel. The factor cosθ₂ cosθ₃ / R₂₃² grows
  without bound where the two surfaces touch;
- *follow*: one ray is drawn by the BRDF at x₂ and counts if it lands inside a pixel. It carries no 1/R².

Let a₃ be the footprint of a FoV point (the area of wall that one of the M points stands for) and p = pdf·cosθ₃/R₂₃²
the density per area of the second way. Then connections count with weight 1/(1 + p a₃) and rays with p a₃/(1 + p a₃).
So a connection never carries more light than its footprint could receive, and the rays add the light that this weight
takes away: each sample is bounded, and the mean is right for any number of samples. A vertex too far from a pixel's
patch to overfill a footprint needs no ray: its connections count whole (`PixelPatches.reach`).

Names that end in 1 belong to the laser point, in 2 to a vertex, in 3 to a FoV point.
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
from datagen.transport.binning import add_to_bin
from datagen.transport.brdf import LAMBERTIAN, Materials, MaterialTable, Vector, dot, evaluate, pdf
from datagen.transport.fields_of_view import FovPool, PixelCones, PixelPatches
from datagen.transport.memory import VALUES_AT_ONCE
from datagen.transport.path_tracing.vertices import LaserPoints, Vertices, at
from datagen.transport.visibility.raycast import Hits, Raycaster, lifted_and_scaled


class Clock(NamedTuple):
    """Arrival times: a path of some length arrives at the fractional bin length · per_metre − start.

    Attributes
    ----------
    per_metre : bins for each metre of path.
    start : time at which the window starts, in bins.
    device_leg : (laser,) distance from the laser to each laser point, m; −1 where the legs from the laser and to the
        sensor do not count (time origin `wall`).
    """

    per_metre: float
    start: float
    device_leg: Floats


class Rows(NamedTuple):
    """The order of histogram rows of a chunk of laser points: (laser point, pixel, row of `TallyRows`).

    Attributes
    ----------
    first_laser : index of the chunk's first laser point.
    confocal : whether laser point i has pixel i alone.
    pixels : number of pixels of each laser point.
    splits : rows for each laser point and pixel.
    """

    first_laser: int
    confocal: bool
    pixels: int
    splits: int


class Tally(NamedTuple):
    """The light so far: histogram (row, bin) and overflow (row,), the energy outside the window."""

    histogram: Floats
    overflow: Floats

    def apart(self, pieces: int) -> list[Tally]:
        """The tally cut into `pieces` runs of equally many rows."""
        return [
            Tally(*of) for of in zip(np.split(self.histogram, pieces), np.split(self.overflow, pieces), strict=True)
        ]


class Device(NamedTuple):
    """The sensor and the air as plain numbers.

    Attributes
    ----------
    position : (3,) metres.
    aperture_area : m². aperture_square : m², the addition to R² for a finite aperture (`fields_of_view.py`), or 0.
    fov_samples : FoV points that a vertex is connected with in each pixel.
    attenuation : of the air, 1/m.
    """

    position: Floats
    aperture_area: float
    aperture_square: float
    fov_samples: int
    attenuation: float


class Frame(NamedTuple):
    """Embree's unit frame (`raycast.lifted_and_scaled`).

    offset : height above the surface at which rays begin and end, m. scale : (4,) centre and half extent, m.
    """

    offset: float
    scale: Floats


class Arrivals(NamedTuple):
    """n contributions that arrive unless a surface hides them.

    owner : (n,) index of the vertex or laser point. row : (n,) histogram row. position : (n,) fractional bin.
    energy : (n,) photons per emitted photon.
    """

    owner: Ints
    row: Ints
    position: Floats
    energy: Floats


class Waiting(NamedTuple):
    """n connections that wait for their shadow rays: origins and spans (n, 3) of these in embree's frame, and the
    contributions."""

    origin: NDArray[np.float32]
    span: NDArray[np.float32]
    arrivals: Arrivals

    @classmethod
    def room(cls, n: int) -> Waiting:
        """Empty arrays with room for n connections."""
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
    """Whether surfaces may hide a vertex from a FoV point."""
    pool_set: Ints | None = None
    """(laser,) index of the pool's set of FoV points that each of the chunk's laser points uses; None if the pool has
    one set."""

    @property
    def device(self) -> Device:
        """The sensor for the compiled loops."""
        sensor = self.sensor
        near = sensor.aperture_radius_m**2 if sensor.finite_aperture else 0.0
        return Device(
            sensor.position, sensor.aperture_area_m2, near, self.points_per_vertex, self.scene.attenuation_per_m
        )

    def connect(self, vertices: Vertices, choice: Floats, split_of_part: Ints) -> int:
        """Number of connections that could carry energy, after adding those that no surface hides to the tally.

        Every vertex is connected with one block of FoV points in each of its pixels.

        choice : (n,) numbers in 0 … 1 that pick the blocks. split_of_part : (K,) row of `TallyRows` for a vertex on
        each part.
        """
        blocks = self.pool.weight.shape[1] // (self.points_per_vertex * self.pool.sets)
        block = np.minimum(choice * blocks, blocks - 1).astype(np.int64)
        if self.pool_set is not None:
            block += blocks * self.pool_set[vertices.laser - self.rows.first_laser]
        count, bright = len(vertices.laser), 0
        per_vertex = (1 if self.rows.confocal else self.rows.pixels) * self.points_per_vertex
        per_batch = max(1, min(VALUES_AT_ONCE // (8 * per_vertex), count))
        waiting = Waiting.room(per_batch * per_vertex)
        frame = Frame(self.caster.offset_m, np.append(self.caster.center, self.caster.half_extent_m))
        for start in range(0, count, per_batch):
            batch = slice(start, start + per_batch)
            connected = connections(
                vertices.take(batch), block[batch], self.pool, self.patches, self.materials.arrays, self.device,
                self.clock, self.rows, split_of_part, frame, waiting,
            )  # fmt: skip
            arrivals = Arrivals._make(values[:connected] for values in waiting.arrivals)
            hidden = np.zeros(connected, np.bool_)
            if self.occlusion:
                hidden = self.caster.occluded_scaled(waiting.origin[:connected], waiting.span[:connected])
            deposit(arrivals, hidden, self.tally)
            bright += connected
        return bright

    def near(self, vertices: Vertices) -> Ints:
        """Indices of the vertices whose own rays count: those near the patch of any of their pixels."""
        return np.asarray(near_a_pixel(vertices, self.materials.kind, self.patches, self.rows))

    def follow(
        self, vertices: Vertices, hits: Hits, directions: Floats, throughput: Floats, split_of_part: Ints
    ) -> None:
        """Add to the tally the light of the vertices' own rays that land inside a pixel.

        hits, directions, throughput : of one ray from each vertex, as `vertices.scattered_rays` returns them.
        """
        part = np.where(hits.valid, self.scene.face_part[hits.face], -1).astype(np.int64)
        arrivals = landed(
            vertices, hits, part, directions, throughput, self.materials.arrays, self.cones, self.patches,
            self.device, self.clock, self.rows, split_of_part,
        )  # fmt: skip
        at = arrivals.owner
        self._add_if_seen(hits.position[at] + self.caster.offset_m * hits.normal[at], arrivals)

    def add_laser_points(self, points: LaserPoints, lasers: Ints, split: int) -> None:
        """Add to the tally the light of one bounce: laser points that lie inside a pixel and that the sensor sees."""
        arrivals = laser_points_seen(
            lasers, points, self.materials.arrays, self.cones, self.device, self.clock, self.rows, split
        )  # fmt: skip
        at = arrivals.owner
        self._add_if_seen(points.position[at] + self.caster.offset_m * points.normal[at], arrivals)

    def _add_if_seen(self, lifted: Floats, arrivals: Arrivals) -> None:
        """Add to the tally the contributions from the points `lifted` (n, 3) that the sensor sees."""
        deposit(arrivals, self.caster.occluded(self.sensor.position, lifted), self.tally)


@compiled(inline="always")
def _is_near(position: Vector, kind: int, patches: PixelPatches, p: int) -> bool:
    """Whether a vertex could overfill a footprint of pixel p; one whose BRDF has a lobe always could."""
    reach = patches.reach[p]
    if kind != LAMBERTIAN or reach == np.inf:
        return True
    c = patches.center
    d = (position[0] - c[p, 0], position[1] - c[p, 1], position[2] - c[p, 2])
    return bool(dot(d, d) < reach * reach)


@compiled(inline="always")
def _first_pixel(rows: Rows, local: int) -> int:
    """Index of the first pixel of the chunk's laser point `local`, which confocally has its own pixel alone."""
    return local if rows.confocal else 0


@compiled(inline="always")
def _end_of_pixels(rows: Rows, local: int) -> int:
    """One more than the index of the last pixel of the chunk's laser point `local`."""
    return local + 1 if rows.confocal else rows.pixels


@compiled(inline="always")
def _row(rows: Rows, local: int, p: int, split: int) -> int:
    """Histogram row of the chunk's laser point `local`, pixel p and row `split` of `TallyRows`."""
    return (local if rows.confocal else local * rows.pixels + p) * rows.splits + split


@compiled(inline="always")
def _bin(path: float, last_leg: float, local: int, clock: Clock) -> float:
    """Fractional bin at which a path arrives; `path` leads from the laser point to the FoV point, m."""
    device = clock.device_leg[local] + last_leg if clock.device_leg[local] >= 0.0 else 0.0
    return (path + device) * clock.per_metre - clock.start


@compiled(inline="always")
def _inside(span: Vector, cones: PixelCones, p: int) -> bool:
    """Whether a point lies inside pixel p, as seen from the sensor; `span` leads from the point to the sensor."""
    inside = True
    for k in range(4):
        inside = inside and dot(span, at(cones.planes[p], k)) <= 0.0
    return inside


@compiled()
def near_a_pixel(v: Vertices, kind: NDArray[np.integer], patches: PixelPatches, rows: Rows) -> Ints:
    """Indices of the vertices that could overfill a footprint of any of their pixels."""
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
    """Number of connections that can carry energy, after writing them and their shadow rays to `waiting`.

    block : (n,) index of each vertex's block of FoV points.
    The energy is power · f₂ cosθ₂ · cosθ₃ f₃ / R₂₃² · A dΩ of the FoV point, by the balance heuristic.
    """
    n, wait = 0, waiting.arrivals
    for i in range(len(v.laser)):
        local = v.laser[i] - rows.first_laser
        x2, n2, w_in = at(v.position, i), at(v.normal, i), at(v.to_previous, i)
        k2, material2 = materials.kind[v.part[i]], materials.values[v.part[i]]
        # Both ends of a shadow ray are lifted off their surfaces, which embree's single precision could otherwise let
        # hide them.
        start = lifted_and_scaled(x2, n2, frame.offset, frame.scale)
        for p in range(_first_pixel(rows, local), _end_of_pixels(rows, local)):
            near = _is_near(v.position[i], k2, patches, p)
            for q in range(block[i] * device.fov_samples, (block[i] + 1) * device.fov_samples):
                # The line of sight met nothing, or a surface edge-on.
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
                # The weight 1/(1 + p a₃) turns 1/R² into 1/(R² + pdf cosθ₃ a₃), bounded where surfaces touch.
                followed = pdf(k2, material2, n2, w_in, w) * cos3 * pool.footprint[p, q] if near else 0.0
                energy = v.power[i] * f2 * f3 * cos2 * cos3 * pool.weight[p, q] / (square + followed)
                if device.attenuation > 0.0:
                    energy *= math.exp(-device.attenuation * (distance + pool.last_leg[p, q]))
                # `not … > 0` leaves out NaN as well, which `<= 0` would let pass.
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
    """Add to the tally the arrivals (n,) whose `hidden` (n,) is False."""
    for k in range(len(arrivals.row)):
        if not hidden[k]:
            row = arrivals.row[k]
            tally.overflow[row] += add_to_bin(tally.histogram[row], arrivals.position[k], arrivals.energy[k])


@compiled()
def landed(
    v: Vertices, hits: Hits, part3: Ints, direction: Floats, throughput: Floats, materials: Materials,
    cones: PixelCones, patches: PixelPatches, device: Device, clock: Clock, rows: Rows, split_of_part: Ints,
) -> Arrivals:  # fmt: skip
    """Contributions of the vertices' own rays that landed inside a pixel; they count if the sensor sees the place.

    part3 : (n,) index of the part that each ray met, −1 for none. direction, throughput : (n, 3), (n,) of the rays.
    """
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
            # Connections of a vertex that is not near count whole, so its ray must not add the same light again.
            if not (_is_near(v.position[i], k2, patches, p) and _inside(span, cones, p)):
                continue
            d = (x3[0] - x2[0], x3[1] - x2[1], x3[2] - x2[2])
            square = dot(d, d)
            distance = math.sqrt(square)
            density = pdf(k2, material2, at(v.normal, i), at(v.to_previous, i), w)
            # The balance heuristic needs the footprint that a FoV point would have had here: Ω R_s² / (cosθ_s M).
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
    # The lists began with one entry each, from which the compiler takes their types.
    return Arrivals(np.array(owners[1:]), np.array(in_rows[1:]), np.array(positions[1:]), np.array(energies[1:]))


@compiled()
def laser_points_seen(
    lasers: Ints, points: LaserPoints, materials: Materials, cones: PixelCones, device: Device, clock: Clock,
    rows: Rows, split: int,
) -> Arrivals:  # fmt: skip
    """Contributions f cosθ A / R² of laser points that lie inside a pixel; they count if the sensor sees them."""
    owners, in_rows = [np.int64(0)], [np.int64(0)]
    positions, energies = [0.0], [0.0]
    for o in lasers:
        local = o - rows.first_laser
        x1, n1, part1 = at(points.position, o), at(points.normal, o), points.part[o]
        span = (device.position[0] - x1[0], device.position[1] - x1[1], device.position[2] - x1[2])
        reach_square = dot(span, span)
        reach = math.sqrt(reach_square)
        out = (span[0] / reach, span[1] / reach, span[2] / reach)
        # One bounce leaves nothing to integrate over: the path is known, and only its visibility is open.
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
