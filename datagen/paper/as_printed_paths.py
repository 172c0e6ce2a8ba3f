"""The paths of the paper's Eq. 6 and Eq. 8: to the lookins, out of them to the sensor, and into them by a detour.

Scholes & Leach, Sensors 24, 6522 (2024), sec. 3 and 4. Each function gives the A factors of one stretch of path.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from datagen.paper.as_printed_sampling import PrintedMaterials, Seen, look
from datagen.records import Capture, Scene
from datagen.transport.factorised.convolution import Paths
from datagen.transport.fov import PixelCones
from datagen.transport.raycast import Raycaster
from datagen.transport.vertices import LaserPoints
from datagen.units import path_from_time

Array = NDArray[np.float64]


@dataclass(frozen=True)
class PrintedRoom:
    """A scene and capture as the printed equations want them; `unit_m` is the unit of length u of every 1/R²."""

    caster: Raycaster
    scene: Scene
    capture: Capture
    materials: PrintedMaterials
    cones: PixelCones
    points: LaserPoints
    unit_m: float

    @classmethod
    def of(cls, scene: Scene, capture: Capture, unit_m: float) -> PrintedRoom:
        """Raises `InputError` for a BRDF that the paper does not have, or a pixel that is no convex quadrilateral."""
        caster, materials, cones = Raycaster(scene), PrintedMaterials.of(scene), PixelCones.of(capture.sensor)
        points = LaserPoints.of(caster, scene, capture.laser)
        return cls(caster, scene, capture, materials, cones, points, unit_m)

    def loss(self, distance: Array, passes: int = 1) -> Array:
        """C_atm^(passes · R) / R² of legs R in metres, R² in the unit of length."""
        air = np.exp(-passes * self.scene.attenuation_per_m * distance)
        return air * (self.unit_m / distance) ** 2

    def bins(self, path_m: Array) -> Array:
        """A path's length in bins of the time axis."""
        return path_m / float(path_from_time(self.capture.time.width_s))


@dataclass(frozen=True)
class PrintedLookins:
    """The lookins of one laser point.

    Attributes
    ----------
    position, normal : (n, 3) metres; unit normal on the lit side.
    face, part : (n,) triangle and part index.
    distance : (n,) R_j, metres.
    amplitude : (n,) A₁ of Eq. 6.
    alpha : α₁ of Eq. 6.
    """

    position: Array
    normal: Array
    face: NDArray[np.int32]
    part: NDArray[np.int64]
    distance: Array
    amplitude: Array
    alpha: float

    def __len__(self) -> int:
        return len(self.part)

    def take(self, rows: slice | NDArray[np.int64]) -> PrintedLookins:
        """Some of them; the normalisation α stays that of all."""
        each = ("position", "normal", "face", "part", "distance", "amplitude")
        return replace(self, **{name: getattr(self, name)[rows] for name in each})


@dataclass(frozen=True)
class Lighting:
    """How the laser point lights observed points, (n, m) each.

    Attributes
    ----------
    lit : not in shadow.
    brdf : B₁ towards them, 0 in shadow.
    distance : R_k, metres.
    """

    lit: NDArray[np.bool_]
    brdf: Array
    distance: Array


@dataclass(frozen=True)
class Leaving:
    """Paths from lookins to FoV points and on to the sensor.

    Attributes
    ----------
    paths : rows (lookin, pixel), energy A₂A₃ without the aperture, position in bins.
    point : (q,) the observed point of each path as an index into (lookin, observed point).
    """

    paths: Paths
    point: NDArray[np.int64]


def place_lookins(room: PrintedRoom, laser: int, directions: Array) -> PrintedLookins:
    """Where rays along `directions` from one laser point first meet the scene (sec. 3.1), with A₁ of Eq. 6."""
    row, points = slice(laser, laser + 1), room.points
    own = points.position[row], points.normal[row], points.part[row]
    seen = look(room.caster, room.scene, room.materials, *own, directions)
    hit = seen.part[0] >= 0
    distance = seen.distance[0, hit]
    gamma = room.materials.reflectivity[points.part[laser]]
    amplitude = gamma * seen.share[0, hit] * room.loss(distance)
    place, surface = (seen.position[0, hit], seen.normal[0, hit]), (seen.face[0, hit], seen.part[0, hit])
    return PrintedLookins(*place, *surface, distance, amplitude, float(seen.alpha[0]))


def observe(room: PrintedRoom, lookins: PrintedLookins, camera: Array) -> Seen:
    """What the cameras at the lookins see (sec. 3.1): (lookin, pixel of the half cube)."""
    return look(room.caster, room.scene, room.materials, lookins.position, lookins.normal, lookins.part, camera)


def leaving(room: PrintedRoom, lookins: PrintedLookins, seen: Seen, pixels: NDArray[np.int64]) -> Leaving:
    """A₂A₃ of Eq. 6 for all observed points within the field of view of `pixels` (sec. 3.2).

    Within the field of view is what the sensor sees: inside the pixel's cone, facing it, nothing between.
    """
    sensor, offset = room.capture.sensor.position, room.caster.offset_m
    count = seen.part.size
    position, normal, part = seen.position.reshape(-1, 3), seen.normal.reshape(-1, 3), seen.part.ravel()
    span = sensor - position
    facing = np.flatnonzero((part >= 0) & (np.einsum("nk,nk->n", span, normal) > offset))
    inside = np.stack([((-span[facing] @ room.cones.planes[p].T) >= 0).all(axis=1) for p in pixels], axis=1)
    point, pixel = np.nonzero(inside)
    met, back = np.unique(facing[point], return_inverse=True)
    seen_by_sensor = ~room.caster.occluded(sensor, position[met] + offset * normal[met])
    distance = np.linalg.norm(span[met], axis=1)
    brdf = room.materials.brdf(part[met], normal[met], span[met] / distance[:, None])
    # A₃, the final bounce, and A₂ before it.
    energy = room.materials.reflectivity[part[met]] * room.materials.beta[part[met]] * brdf * room.loss(distance, 2)
    lookin = met // (count // max(len(lookins), 1))
    first_leg = seen.distance.ravel()[met]
    energy *= room.materials.reflectivity[lookins.part[lookin]] * seen.share.ravel()[met] * room.loss(first_leg)
    last_leg = distance if room.capture.time.origin == "source" else np.zeros_like(distance)
    kept = (seen_by_sensor & (energy > 0))[back]
    row = lookin[back[kept]] * len(pixels) + pixel[kept]
    first = np.concatenate([[0], np.cumsum(np.bincount(row, minlength=len(lookins) * len(pixels)))])
    order = np.argsort(row, kind="stable")
    chosen = back[kept][order]
    return Leaving(Paths(first, room.bins(first_leg + last_leg)[chosen], energy[chosen]), met[chosen])


def lighting(room: PrintedRoom, laser: int, seen: Seen) -> Lighting:
    """Which observed points the laser point lights, and B₁ towards them (sec. 3.1, Eq. 3–5; shadows sec. 3.2).

    Points in the laser point's own plane, to within the lift of a ray, count as unlit.
    """
    start, normal, offset = room.points.position[laser], room.points.normal[laser], room.caster.offset_m
    position = seen.position.reshape(-1, 3)
    span = position - start
    before = (seen.part.ravel() >= 0) & (span @ normal > offset)
    before &= -np.einsum("nk,nk->n", span, seen.normal.reshape(-1, 3)) > offset
    rows = np.flatnonzero(before)
    ends = position[rows] + offset * seen.normal.reshape(-1, 3)[rows]
    rows = rows[~room.caster.occluded(start + offset * normal, ends)]
    distance = np.linalg.norm(span, axis=1)
    lit, brdf = np.zeros(len(span), np.bool_), np.zeros(len(span))
    lit[rows] = True
    own = np.full(len(rows), room.points.part[laser])
    direction = span[rows] / distance[rows, None]
    brdf[rows] = room.materials.brdf(own, np.broadcast_to(normal, (len(rows), 3)), direction)
    shape = seen.part.shape
    return Lighting(lit.reshape(shape), brdf.reshape(shape), distance.reshape(shape))


def arriving(room: PrintedRoom, laser: int, lookins: PrintedLookins, seen: Seen, light: Lighting) -> Paths:
    """Â₁Â₂ of Eq. 8 with α₁ = 1: laser point → lit observed point → lookin (sec. 4); rows are lookins."""
    lookin, _ = chosen = np.nonzero(light.brdf > 0)
    position, normal, part = seen.position[chosen], seen.normal[chosen], seen.part[chosen]
    distance = seen.distance[chosen]
    back = (lookins.position[lookin] - position) / distance[:, None]
    materials = room.materials
    gamma = materials.reflectivity[room.points.part[laser]]
    energy = gamma * light.brdf[chosen] * room.loss(light.distance[chosen])
    energy *= materials.reflectivity[part] * materials.beta[part] * materials.brdf(part, normal, back)
    energy *= room.loss(distance)
    first = np.concatenate([[0], np.cumsum(np.bincount(lookin, minlength=len(lookins)))])
    return Paths(first, room.bins(light.distance[chosen] + distance), energy)
