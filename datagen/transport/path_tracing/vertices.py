"""Vertices of light paths: laser points, the hidden vertices they light, and where the light goes from there.

A first hidden vertex can be drawn in two ways, combined by the balance heuristic (Veach & Guibas, SIGGRAPH 1995),
which is unbiased and never gives a vertex more than the rays alone would:

- rays from the laser point drawn by its BRDF, which already carry the 1/R² of the geometry (docs/physics.md);
- points uniform on the area of small parts, so that a small or distant object gets its share of samples.

Every later vertex is where a ray drawn by the BRDF of the one before it lands.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from datagen.compiled import compiled
from datagen.records import Laser, Scene
from datagen.records.arrays import Bools, Floats, Ints
from datagen.seeding import LightStream
from datagen.transport.brdf import Materials, MaterialTable, Vector, dot, evaluate, pdf, sample
from datagen.transport.sampling import Streams, mix, scrambled_sobol, stream_seeds
from datagen.transport.visibility.raycast import Hits, Raycaster

CHOICES = 4
"""Random numbers a vertex needs: one picks its FoV points, two aim its ray, one is for Russian roulette."""
SOBOL_STEPS = 3
"""Bounces of a path whose choices are Sobol' coordinates; later ones, which matter less, are independent."""


class LaserPoints(NamedTuple):
    """First surfaces of the laser rays.

    position, normal, to_laser : (L, 3) metres; unit normal facing the laser; unit direction to it. NaN without a hit.
    part : (L,) part index, −1 for none. leg : (L,) metres from the laser.
    """

    position: Floats
    normal: Floats
    to_laser: Floats
    part: Ints
    leg: Floats

    @classmethod
    def of(cls, caster: Raycaster, scene: Scene, laser: Laser) -> LaserPoints:
        """Where the rays towards the laser's targets first meet the scene."""
        span = laser.targets - laser.position
        hits = caster.closest(laser.position, span)
        part = np.where(hits.valid, scene.face_part[hits.face], -1).astype(np.int64)
        position = np.where(hits.valid[:, None], hits.position, np.nan)
        to_laser = -span / np.linalg.norm(span, axis=1, keepdims=True)
        return cls(position, hits.normal, to_laser, part, np.linalg.norm(position - laser.position, axis=1))

    def take(self, lasers: Ints) -> LaserPoints:
        """Some of them, or several copies of them."""
        return LaserPoints._make(values[lasers] for values in self)


class Vertices(NamedTuple):
    """n ends of light paths, each begun at one laser point.

    laser : (n,) index of the laser point.
    position, normal, to_previous : (n, 3) metres; unit normal on the lit side; unit direction the light comes from.
    part : (n,) part index.
    power : (n,) share of the emitted photon that arrives here.
    path : (n,) metres travelled so far that count for the time axis.
    choices : (n, CHOICES · SOBOL_STEPS or fewer) Sobol' coordinates for the choices to come.
    stream : (n,) seed of each path's independent numbers.
    """

    laser: Ints
    position: Floats
    normal: Floats
    to_previous: Floats
    part: Ints
    power: Floats
    path: Floats
    choices: Floats
    stream: NDArray[np.uint64]

    def take(self, rows: Ints | slice) -> Vertices:
        """Some of them."""
        return Vertices._make(values[rows] for values in self)

    def numbers(self, step: int) -> Floats:
        """(n, CHOICES) numbers in 0 … 1 for the choices at step 0 (the first hidden vertex), 1, 2 …"""
        if (step + 1) * CHOICES <= self.choices.shape[1]:
            return self.choices[:, step * CHOICES : (step + 1) * CHOICES]
        return np.asarray(_independent_numbers(self.stream, step, CHOICES))


@dataclass(frozen=True)
class AreaTarget:
    """The triangles sampled by area and the share of hidden vertices they get.

    Attributes
    ----------
    share : of the hidden vertices, 0 … 7/8.
    faces : (n,) triangle indices.
    cumulative : (n,) running share of area.
    area_m2 : their total.
    contains : (F,) whether a triangle is one of them.
    """

    share: float
    faces: Ints
    cumulative: Floats
    area_m2: float
    contains: Bools

    @classmethod
    def choose(
        cls, caster: Raycaster, scene: Scene, materials: MaterialTable, points: LaserPoints, seed: int
    ) -> AreaTarget:
        """Aim at objects that too few rays would meet: some trial rays decide (its seed fixes the answer).

        The share is a matter of variance only; any value gives the same mean.
        """
        seen = np.flatnonzero(points.part >= 0)
        object_parts = [k for k, role in enumerate(scene.roles) if role == "object"]
        contains = np.zeros(len(scene.triangles), np.bool_)
        nothing = cls(0.0, np.empty(0, np.int64), np.empty(0), 1.0, contains)
        if not len(seen) or not object_parts:
            return nothing
        trial = np.repeat(seen[np.linspace(0, len(seen) - 1, min(len(seen), 8)).astype(int)], 256)
        seeds = stream_seeds(seed, LightStream.TRIAL, trial[::256])
        hits = _rays(caster, materials, points, trial, scrambled_sobol(seeds, 256, 2).reshape(-1, 2))
        met = scene.face_part[hits.face[hits.valid]]
        frequency = np.bincount(met, minlength=len(scene.part_names)) / len(trial)
        # A part the laser point itself lies on (a wall made of one part) is lit by nothing of its own plane.
        chosen = [k for k in object_parts if frequency[k] < 0.25 and k not in points.part]
        faces = np.flatnonzero(np.isin(scene.face_part, chosen))
        if not len(faces):
            return nothing
        contains[faces] = True
        cumulative = np.cumsum(caster.face_area_m2[faces])
        elsewhere = frequency.sum() - frequency[chosen].sum()
        return cls(
            share=0.875 if elsewhere < 0.01 else 0.25, faces=faces, cumulative=cumulative / cumulative[-1],
            area_m2=float(cumulative[-1]), contains=contains,
        )  # fmt: skip


def runs_of(lasers: Ints, size: int) -> list[Ints]:
    """Runs of consecutive laser points, at most `size` in each; a laser ray that met nothing ends a run."""
    runs = np.split(lasers, np.flatnonzero(np.diff(lasers) != 1) + 1)
    return [run[k : k + size] for run in runs for k in range(0, len(run), size)]


def laser_point_vertices(
    points: LaserPoints, lasers: Ints, count: int, streams: Streams, attenuation_per_m: float
) -> Vertices:
    """The laser points themselves as vertices, `count` copies of each that share the emitted photon."""
    owner = np.repeat(lasers, count)
    return Vertices(
        laser=owner, position=points.position[owner], normal=points.normal[owner], to_previous=points.to_laser[owner],
        part=points.part[owner], power=np.exp(-attenuation_per_m * points.leg[owner]) / count,
        path=np.zeros(len(owner)),
        choices=scrambled_sobol(streams.seeds(LightStream.LASER_POINTS, lasers), count, CHOICES).reshape(-1, CHOICES),
        stream=np.zeros(len(owner), np.uint64),
    )  # fmt: skip


def draw_hidden_vertices(
    caster: Raycaster, scene: Scene, materials: MaterialTable, points: LaserPoints, lasers: Ints, count: int,
    target: AreaTarget, streams: Streams, steps: int,
) -> Vertices:  # fmt: skip
    """`count` first hidden vertices for each of `lasers` (indices of laser points that exist), those that are lit.

    `path` counts from the laser point; `steps` is how many bounces of the path will want Sobol' coordinates.
    """
    by_area = min(round(count * target.share), count - 1)
    by_ray = count - by_area
    dimensions = 2 + CHOICES * min(steps, SOBOL_STEPS)

    sobol = scrambled_sobol(streams.seeds(LightStream.COSINE_DIRECTIONS, lasers), by_ray, dimensions)
    sobol = sobol.reshape(-1, dimensions)
    owner = np.repeat(lasers, by_ray)
    hits = _rays(caster, materials, points, owner, sobol)
    face, position = hits.face, hits.position
    if by_area:
        area_sobol = scrambled_sobol(streams.seeds(LightStream.AREA_POINTS, lasers), by_area, dimensions)
        area_sobol = area_sobol.reshape(-1, dimensions)
        area_owner = np.repeat(lasers, by_area)
        area_face, area_position = _points_on_area(caster, target, area_sobol)
        # Seen means: met first. Of two coinciding triangles only the one that a ray would meet then counts.
        start = points.position[area_owner] + caster.offset_m * points.normal[area_owner]
        first = caster.closest(start, area_position - start)
        face = np.concatenate([face, np.where(first.face == area_face, area_face, -1)])
        position = np.concatenate([position, area_position])
        owner = np.concatenate([owner, area_owner])
        sobol = np.concatenate([sobol, area_sobol])
    kept, normal, to_previous, distance, power = _lit(
        face, position, owner, points, materials.arrays, caster.face_normal, target.contains, float(by_ray),
        by_area / target.area_m2,
    )  # fmt: skip
    owner = owner[kept]
    rays = by_ray * len(lasers)
    own = np.where(kept < rays, kept % by_ray, by_ray + (kept - rays) % max(by_area, 1))
    power *= np.exp(-scene.attenuation_per_m * (points.leg[owner] + distance))
    none = np.zeros(len(owner), np.uint64)
    stream = streams.seeds(LightStream.WALK_STEPS, owner, own) if steps > SOBOL_STEPS else none
    return Vertices(
        laser=owner, position=position[kept], normal=normal, to_previous=to_previous,
        part=scene.face_part[face[kept]].astype(np.int64), power=power, path=distance, choices=sobol[kept, 2:],
        stream=stream,
    )  # fmt: skip


def continued(scene: Scene, vertices: Vertices, hits: Hits, directions: Floats, throughput: Floats) -> Vertices:
    """Where each vertex's light goes next: the end of its ray, with the share of power that the BRDF passes on."""
    going = np.flatnonzero(hits.valid & (throughput > 0))
    last = vertices.take(going)
    position = hits.position[going]
    distance = np.linalg.norm(position - last.position, axis=1)
    return last._replace(
        position=position, normal=hits.normal[going], to_previous=-directions[going],
        part=scene.face_part[hits.face[going]].astype(np.int64),
        power=last.power * throughput[going] * np.exp(-scene.attenuation_per_m * distance), path=last.path + distance,
    )  # fmt: skip


def scattered_rays(
    caster: Raycaster, materials: MaterialTable, vertices: Vertices, numbers: Floats
) -> tuple[Hits, Floats, Floats]:
    """One ray from each vertex drawn by its BRDF: hits, unit directions (n, 3), throughput f cosθ / pdf (n,)."""
    uv = np.ascontiguousarray(numbers[:, 1:3])
    directions, throughput = _scattered(materials.arrays, vertices.part, vertices.normal, vertices.to_previous, uv)
    return caster.leaving(vertices.position, vertices.normal, directions), directions, throughput


def _rays(caster: Raycaster, materials: MaterialTable, points: LaserPoints, owner: Ints, uv: Floats) -> Hits:
    normals = points.normal[owner]
    directions, _ = _scattered(materials.arrays, points.part[owner], normals, points.to_laser[owner], uv)
    return caster.leaving(points.position[owner], normals, directions)


def _points_on_area(caster: Raycaster, target: AreaTarget, sobol: Floats) -> tuple[NDArray[np.int32], Floats]:
    """Faces (n,) and points (n, 3) uniform on the target's area, from the first two of Sobol' coordinates (n, …)."""
    # The first coordinate picks the triangle and, stretched back to 0 … 1, serves once more within it.
    pick = np.minimum(np.searchsorted(target.cumulative, sobol[:, 0], side="right"), len(target.faces) - 1)
    upper = target.cumulative[pick]
    lower = np.where(pick > 0, target.cumulative[pick - 1], 0.0)
    face = target.faces[pick].astype(np.int32)
    root = np.sqrt(np.clip((sobol[:, 0] - lower) / (upper - lower), 0.0, 1.0))
    weights = np.stack([1 - root, root * (1 - sobol[:, 1]), root * sobol[:, 1]], axis=1)
    return face, np.einsum("ik,ikj->ij", weights, caster.corners[face])


@compiled(inline="always")
def at(array: Floats, i: int) -> Vector:
    """Row i of (n, 3) numbers."""
    return (array[i, 0], array[i, 1], array[i, 2])


@compiled()
def _scattered(materials: Materials, part: Ints, normal: Floats, w_in: Floats, uv: Floats) -> tuple[Floats, Floats]:
    """Directions (n, 3) drawn by each vertex's BRDF, and the throughput f cosθ / pdf (n,)."""
    directions, throughput = np.empty((len(part), 3)), np.empty(len(part))
    for i in range(len(part)):
        k, material = materials.kind[part[i]], materials.values[part[i]]
        n, incoming = at(normal, i), at(w_in, i)
        w = sample(k, material, n, incoming, uv[i, 0], uv[i, 1])
        directions[i, 0], directions[i, 1], directions[i, 2] = w
        # A lobe may be drawn below the surface, where nothing leaves.
        density = pdf(k, material, n, incoming, w)
        f = evaluate(k, material, n, incoming, w)
        throughput[i] = f * dot(n, w) / density if f > 0.0 and density > 0.0 else 0.0
    return directions, throughput


@compiled()
def _independent_numbers(streams: NDArray[np.uint64], step: int, count: int) -> Floats:
    """(n, count) independent uniform numbers in the open interval 0 … 1, a function of (stream, step)."""
    out = np.empty((len(streams), count))
    for i in range(len(streams)):
        for k in range(count):
            word = mix(streams[i] + (np.uint64(step) << np.uint64(32)), np.uint64(k + 1))
            # Half a step up: neither 0, whose logarithm a lobe may take, nor 1.
            out[i, k] = (np.float64(word) + 0.5) * 2.0**-32
    return out


@compiled()
def _lit(
    face: NDArray[np.int32], position: Floats, owner: Ints, points: LaserPoints, materials: Materials,
    face_normal: Floats, by_area_too: Bools, rays: float, area_density: float,
) -> tuple[Ints, Floats, Floats, Floats, Floats]:  # fmt: skip
    """Which candidates for hidden vertices the laser points light, their normal on the lit side, direction and
    distance to the laser point, and the power that arrives, f₁ cosθ₁ cosθ₂ / R² over the density of both ways."""
    kept = np.empty(len(face), np.int64)
    normal, to_laser_point = np.empty((len(face), 3)), np.empty((len(face), 3))
    distance, power = np.empty(len(face)), np.empty(len(face))
    n = 0
    for i in range(len(face)):
        f, o = face[i], owner[i]
        if f < 0:
            continue
        d = (
            position[i, 0] - points.position[o, 0],
            position[i, 1] - points.position[o, 1],
            position[i, 2] - points.position[o, 2],
        )
        square = dot(d, d)
        if square == 0.0:
            continue
        r = math.sqrt(square)
        w = (d[0] / r, d[1] / r, d[2] / r)
        n1, w_in, facing = at(points.normal, o), at(points.to_laser, o), at(face_normal, f)
        cos2, cos1 = -dot(facing, w), dot(n1, w)
        if cos1 <= 0.0 or cos2 == 0.0:
            continue
        # Surfaces scatter on both sides: the normal is turned to where the light comes from.
        side = 1.0 if cos2 > 0.0 else -1.0
        k1, material1 = materials.kind[points.part[o]], materials.values[points.part[o]]
        spread = abs(cos2) / square
        # The balance heuristic: whichever way drew this place, it counts over the density of all that could have.
        density = rays * pdf(k1, material1, n1, w_in, w) * spread
        if by_area_too[f]:
            density += area_density
        if density <= 0.0:
            continue
        energy = evaluate(k1, material1, n1, w_in, w) * cos1 * spread / density
        # Not `<= 0`: what is no number is left out, too.
        if not energy > 0.0:
            continue
        kept[n], distance[n], power[n] = i, r, energy
        for k in range(3):
            normal[n, k] = side * facing[k]
            to_laser_point[n, k] = -w[k]
        n += 1
    return kept[:n], normal[:n], to_laser_point[:n], distance[:n], power[:n]
