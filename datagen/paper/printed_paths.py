"""The paths of the paper's Eq. 6 and Eq. 8: to the lookins, out of them to the sensor, and into them by a detour.

Scholes & Leach, Sensors 24, 6522 (2024), sec. 3 and 4. Samples are a grid of rays from the laser point and a half
cube of camera pixels at each lookin; every ray and pixel has the same weight, whatever its solid angle. Choices that
the text leaves open are named where they are made.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from datagen.compiled import compiled
from datagen.errors import InputError
from datagen.paper.convolution import Paths
from datagen.records import Capture, Lambertian, Scene, SinLobe
from datagen.records.arrays import Bools, Floats, Ints
from datagen.transport.brdf import Vector
from datagen.transport.brdf.sin_lobe import azimuth_sine
from datagen.transport.fields_of_view import PixelCones
from datagen.transport.laser_points import LaserPoints
from datagen.transport.rays import Raycaster
from datagen.units import path_from_time

Grid = Literal["angles", "solid_angle"]

HEMISPHERE_OF_COSINE = math.pi
"""∫ cosφ dω over the hemisphere."""
HEMISPHERE_OF_SINE = 4.0
"""∫ |sinθ| dω over the hemisphere, θ the azimuth."""


def ray_grid(count: int, grid: Grid) -> Floats:
    """(count², 3) unit directions of a count × count grid over the hemisphere, as (right, up, along the normal).

    The paper says "a 10 × 10 grid of rays" and that θ spans 2π and φ spans 0 … π/2 (sec. 3.1, Fig. 2b), no more:
    `angles` takes that as equal steps of both, which crowds the rays about the normal; `solid_angle` gives every ray
    the same solid angle, by equal steps of θ and cosφ. Both take the middles of the steps.
    """
    middles = (np.arange(count) + 0.5) / count
    theta = np.repeat(2 * np.pi * middles, count)
    phi = np.tile(0.5 * np.pi * middles if grid == "angles" else np.arccos(1 - middles), count)
    return np.stack([np.sin(phi) * np.cos(theta), np.sin(phi) * np.sin(theta), np.cos(phi)], axis=1)


def half_cube(pixels: int) -> Floats:
    """(3·pixels²/4, 3) unit directions of a lookin's camera, as (right, up, along the normal).

    A camera with a perspective picture cannot see 180°, so five stand in for it: a face of 90° along the normal with
    (pixels/2)² pixels, and the front halves, pixels/2 × pixels/4, of the four faces at its sides. Unfolded they make
    a cross within pixels × pixels; its four corners are empty, so the paper's 60 × 60 = 3600 are 2700 directions.
    """
    half = pixels // 2
    across = (2 * np.arange(half) + 1) / half - 1
    forward = (2 * np.arange(half // 2) + 1) / half
    x, y = np.tile(across, half), np.repeat(across, half)
    faces = [np.stack([x, y, np.ones(half * half)], axis=1)]
    along, depth = np.tile(across, half // 2), np.repeat(forward, half)
    for side in (-1.0, 1.0):
        edge = np.full(len(along), side)
        faces += [np.stack([edge, along, depth], axis=1), np.stack([along, edge, depth], axis=1)]
    directions = np.concatenate(faces)
    return np.asarray(directions / np.linalg.norm(directions, axis=1, keepdims=True), np.float64)


def upright_frames(normal: Floats) -> Floats:
    """(n, 3, 3) rows right, up, normal: up is the vertical as far as the surface lets it, +x on floor and ceiling.

    The text fixes the cameras' axis only, the surface normal; their roll is chosen here.
    """
    up = np.array([0.0, 0.0, 1.0]) - normal[:, 2:3] * normal
    length = np.linalg.norm(up, axis=1, keepdims=True)
    level = length[:, 0] < 1e-6
    up[level] = np.array([1.0, 0.0, 0.0]) - normal[level, :1] * normal[level]
    up /= np.linalg.norm(up, axis=1, keepdims=True)
    return np.stack([np.cross(up, normal), up, normal], axis=1)


class Seen(NamedTuple):
    """What a bundle of equally counted directions sees from each of n points: m samples each.

    position, normal : (n, m, 3) first surface along the direction, metres, and its unit normal towards the point.
    face, part : (n, m) triangle and part index, −1 where there is nothing.
    distance : (n, m) metres, ∞ where there is nothing.
    share : (n, m) α B of each direction, 1 in all over each bundle, seen surfaces or not.
    alpha : (n,) α = 1 / Σ B, 0 where B is 0 in all directions.
    """

    position: Floats
    normal: Floats
    face: NDArray[np.int32]
    part: Ints
    distance: Floats
    share: Floats
    alpha: Floats


@dataclass(frozen=True)
class PrintedLookins:
    """The n lookins of one laser point.

    position, normal : (n, 3) metres; unit normal on the lit side. face, part : (n,) triangle and part index.
    distance : (n,) R_j, metres. amplitude : (n,) A₁ of Eq. 6. alpha : α₁ of Eq. 6, of all of them.
    """

    position: Floats
    normal: Floats
    face: NDArray[np.int32]
    part: Ints
    distance: Floats
    amplitude: Floats
    alpha: float

    def __len__(self) -> int:
        return len(self.part)

    def take(self, rows: slice) -> PrintedLookins:
        """Some of them; the normalisation α stays that of all."""
        each = ("position", "normal", "face", "part", "distance", "amplitude")
        return replace(self, **{name: getattr(self, name)[rows] for name in each})


class Lighting(NamedTuple):
    """How the laser point lights observed points, (n, m) each: B₁ towards them, 0 in shadow, and R_k in metres."""

    brdf: Floats
    distance: Floats


@dataclass(frozen=True)
class PrintedRoom:
    """A scene of K parts and a capture in the quantities of the printed equations.

    unit_m : the unit of length u of every 1/R². reflectivity : (K,) Γ. sine : (K,) whether B = |sinθ| and not cosφ.
    axis : (K, 3) from whose projection on the surface θ counts. beta : (K,) β, see `simulate_as_printed`.
    """

    caster: Raycaster
    scene: Scene
    capture: Capture
    cones: PixelCones
    points: LaserPoints
    unit_m: float
    reflectivity: Floats
    sine: Bools
    axis: Floats
    beta: Floats

    @classmethod
    def of(cls, scene: Scene, capture: Capture, unit_m: float) -> PrintedRoom:
        """Raises `InputError` for a BRDF that the paper does not have, or a pixel that is no convex quadrilateral."""
        for name, material in zip(scene.part_names, scene.materials, strict=True):
            if not isinstance(material, (Lambertian, SinLobe)):
                raise InputError(
                    f"part {name!r}: {type(material).__name__} is no BRDF of the paper; as printed there are cosφ "
                    "(Lambertian) and |sinθ| (SinLobe) only: change it, or use dg.simulate"
                )
        caster, cones = Raycaster(scene), PixelCones.of(capture.sensor)
        points = LaserPoints.of(caster, scene, capture.laser)
        sine = np.array([isinstance(m, SinLobe) for m in scene.materials])
        axes: Sequence[Vector] = [m.axis if isinstance(m, SinLobe) else (0.0, 0.0, 1.0) for m in scene.materials]
        gamma = np.array([float(m.albedo) for m in scene.materials])
        beta = 1.0 / np.where(sine, HEMISPHERE_OF_SINE, HEMISPHERE_OF_COSINE)
        return cls(caster, scene, capture, cones, points, unit_m, gamma, sine, np.array(axes, np.float64), beta)

    def brdf(self, part: Ints, normal: Floats, direction: Floats) -> Floats:
        """(n,) B towards unit directions (n, 3) at surfaces (n,), (n, 3): cosφ, or |sinθ| with θ of Eq. 5.

        The light's incidence plays no part (sec. 3.2); below the surface B is 0. As printed, sinθ would be negative
        on one side: the modulus is taken.
        """
        return _brdf(self.sine[part], self.axis[part], normal, direction)

    def loss(self, distance: Floats, passes: int = 1) -> Floats:
        """C_atm^(passes · R) / R² of legs R in metres, R² in the unit of length."""
        air = np.exp(-passes * self.scene.attenuation_per_m * distance)
        return air * (self.unit_m / distance) ** 2

    def bins(self, path_m: Floats) -> Floats:
        """A path's length in bins of the time axis."""
        return path_m / float(path_from_time(self.capture.time.width_s))

    def look(self, position: Floats, normal: Floats, part: Ints, directions: Floats) -> Seen:
        """Cast `directions` (m, 3), given in the surface's own frame, from surface points (n, 3) with normals, parts.

        The normalisation α = 1 / Σ B over the directions sampled is the text's "constant, to ensure the conservation
        of energy" (Eq. 1); a direction that meets nothing takes its share away.
        """
        n, m = len(position), len(directions)
        flat = np.einsum("ma,nab->nmb", directions, upright_frames(normal)).reshape(-1, 3)
        brdf = self.brdf(np.repeat(part, m), np.repeat(normal, m, axis=0), flat).reshape(n, m)
        total = brdf.sum(axis=1)
        alpha = np.divide(1.0, total, out=np.zeros_like(total), where=total > 0)
        hits = self.caster.closest(np.repeat(position + self.caster.offset_m * normal, m, axis=0), flat)
        where = np.where(hits.valid[:, None], hits.position, 0.0).reshape(n, m, 3)
        distance = np.linalg.norm(where - position[:, None], axis=2)
        seen = np.where(hits.valid, self.scene.face_part[hits.face], -1).astype(np.int64).reshape(n, m)
        distance = np.where(hits.valid.reshape(n, m), distance, np.inf)
        place = where, hits.normal.reshape(n, m, 3), hits.face.reshape(n, m)
        return Seen(*place, seen, distance, alpha[:, None] * brdf, alpha)

    def lookins(self, laser: int, directions: Floats) -> PrintedLookins:
        """Where rays along `directions` from one laser point first meet the scene (sec. 3.1), with A₁ of Eq. 6."""
        row, points = slice(laser, laser + 1), self.points
        seen = self.look(points.position[row], points.normal[row], points.part[row], directions)
        hit = seen.part[0] >= 0
        distance = seen.distance[0, hit]
        amplitude = self.reflectivity[points.part[laser]] * seen.share[0, hit] * self.loss(distance)
        surface = seen.position[0, hit], seen.normal[0, hit], seen.face[0, hit], seen.part[0, hit]
        return PrintedLookins(*surface, distance, amplitude, float(seen.alpha[0]))

    def observed(self, lookins: PrintedLookins, camera: Floats) -> Seen:
        """What the cameras at the lookins see (sec. 3.1): (lookin, pixel of the half cube)."""
        return self.look(lookins.position, lookins.normal, lookins.part, camera)


@compiled()
def _brdf(sine: Bools, axis: Floats, normal: Floats, direction: Floats) -> Floats:
    out = np.zeros(len(direction))
    for i in range(len(direction)):
        n = (normal[i, 0], normal[i, 1], normal[i, 2])
        w = (direction[i, 0], direction[i, 1], direction[i, 2])
        cosine = n[0] * w[0] + n[1] * w[1] + n[2] * w[2]
        # Neither distribution sends light into the surface.
        if cosine > 0.0:
            out[i] = azimuth_sine((axis[i, 0], axis[i, 1], axis[i, 2]), n, w) if sine[i] else cosine
    return out


def leaving(room: PrintedRoom, lookins: PrintedLookins, seen: Seen, pixels: Ints) -> tuple[Paths, Ints]:
    """A₂A₃ of Eq. 6, without the aperture, for all observed points within the field of view of `pixels` (sec. 3.2).

    Paths of the rows (lookin, pixel), and of each the index of its observed point into (lookin, observed point).
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
    brdf = room.brdf(part[met], normal[met], span[met] / distance[:, None])
    # A₃, the final bounce, and A₂ before it.
    energy = room.reflectivity[part[met]] * room.beta[part[met]] * brdf * room.loss(distance, 2)
    lookin = met // (count // max(len(lookins), 1))
    first_leg = seen.distance.ravel()[met]
    energy *= room.reflectivity[lookins.part[lookin]] * seen.share.ravel()[met] * room.loss(first_leg)
    last_leg = distance if room.capture.time.origin == "source" else np.zeros_like(distance)
    kept = (seen_by_sensor & (energy > 0))[back]
    row = lookin[back[kept]] * len(pixels) + pixel[kept]
    first = np.concatenate([[0], np.cumsum(np.bincount(row, minlength=len(lookins) * len(pixels)))])
    chosen = back[kept][np.argsort(row, kind="stable")]
    return Paths(first, room.bins(first_leg + last_leg)[chosen], energy[chosen]), met[chosen]


def lighting(room: PrintedRoom, laser: int, seen: Seen) -> Lighting:
    """Which observed points the laser point lights (sec. 3.1, Eq. 3–5; shadows sec. 3.2).

    Points in the laser point's own plane, to within the lift of a ray, count as unlit.
    """
    start, normal, offset = room.points.position[laser], room.points.normal[laser], room.caster.offset_m
    position, own_normal = seen.position.reshape(-1, 3), seen.normal.reshape(-1, 3)
    span = position - start
    before = (seen.part.ravel() >= 0) & (span @ normal > offset)
    before &= -np.einsum("nk,nk->n", span, own_normal) > offset
    rows = np.flatnonzero(before)
    rows = rows[~room.caster.occluded(start + offset * normal, position[rows] + offset * own_normal[rows])]
    distance = np.linalg.norm(span, axis=1)
    brdf, own = np.zeros(len(span)), np.full(len(rows), room.points.part[laser])
    brdf[rows] = room.brdf(own, np.broadcast_to(normal, (len(rows), 3)), span[rows] / distance[rows, None])
    return Lighting(brdf.reshape(seen.part.shape), distance.reshape(seen.part.shape))


def arriving(room: PrintedRoom, laser: int, lookins: PrintedLookins, seen: Seen, light: Lighting) -> Paths:
    """Â₁Â₂ of Eq. 8 with α₁ = 1: laser point → lit observed point → lookin (sec. 4); rows are lookins."""
    lookin, _ = chosen = np.nonzero(light.brdf > 0)
    part, distance = seen.part[chosen], seen.distance[chosen]
    back = (lookins.position[lookin] - seen.position[chosen]) / distance[:, None]
    energy = room.reflectivity[room.points.part[laser]] * light.brdf[chosen] * room.loss(light.distance[chosen])
    energy *= room.reflectivity[part] * room.beta[part] * room.brdf(part, seen.normal[chosen], back)
    energy *= room.loss(distance)
    first = np.concatenate([[0], np.cumsum(np.bincount(lookin, minlength=len(lookins)))])
    return Paths(first, room.bins(light.distance[chosen] + distance), energy)
