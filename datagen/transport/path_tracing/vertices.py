"""Vertices of light paths: laser points, the first hidden vertices that they light, and later hidden vertices.

A first hidden vertex is drawn in either of two ways:

- where a ray from the laser point lands, drawn by the laser point's BRDF; its density already has the 1/R² of the
  geometry (docs/physics.md);
- uniformly on the area of small parts, so that a small or distant object gets its share of samples.

The balance heuristic combines them (Veach & Guibas, SIGGRAPH 1995): the mean is unbiased, and no vertex weighs more
than it would with rays alone. Every later vertex is where a ray lands that the BRDF at the vertex before it draws.
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
"""Random numbers that a vertex needs: one picks its block of FoV points, two aim its ray, one is for Russian
roulette."""
SOBOL_STEPS = 3
"""Bounces of a path whose random numbers are Sobol' coordinates; later bounces, which bring less light, have
independent ones. With half as many the secondary gets noisier."""


class LaserPoints(NamedTuple):
    """Laser points: where each of L laser rays first meets a surface.

    position, normal, to_laser : (L, 3) metres; unit normal facing the laser; unit direction to it. NaN without a hit.
    part : (L,) part index, −1 without a hit. leg : (L,) distance to the laser, m.
    """

    position: Floats
    normal: Floats
    to_laser: Floats
    part: Ints
    leg: Floats

    @classmethod
    def of(cls, caster: Raycaster, scene: Scene, laser: Laser) -> LaserPoints:
        """The laser points of the rays from the laser toward its targets."""
        span = laser.targets - laser.position
        hits = caster.closest(laser.position, span)
        part = np.where(hits.valid, scene.face_part[hits.face], -1).astype(np.int64)
        position = np.where(hits.valid[:, None], hits.position, np.nan)
        to_laser = -span / np.linalg.norm(span, axis=1, keepdims=True)
        return cls(position, hits.normal, to_laser, part, np.linalg.norm(position - laser.position, axis=1))

    def take(self, lasers: Ints) -> LaserPoints:
        """The laser points with the given indices, which may repeat."""
        return LaserPoints._make(values[lasers] for values in self)


class Vertices(NamedTuple):
    """The last vertices of n light paths so far, each of which began at a laser point.

    laser : (n,) index of the laser point.
    position, normal, to_previous : (n, 3) metres; unit normal on the lit side; unit direction to the vertex before.
    part : (n,) part index.
    power : (n,) share of the emitted photon that arrives here, over the density with which the path was drawn.
    path : (n,) length from the laser point, m.
    choices : (n, CHOICES · SOBOL_STEPS or fewer) Sobol' coordinates for the choices at the path's hidden vertices.
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
        """The vertices in the given rows."""
        return Vertices._make(values[rows] for values in self)

    def numbers(self, step: int) -> Floats:
        """(n, CHOICES) random numbers in 0 … 1 for a path's first hidden vertex (step 0), its second (step 1), …"""
        if (step + 1) * CHOICES <= self.choices.shape[1]:
            return self.choices[:, step * CHOICES : (step + 1) * CHOICES]
        return np.asarray(_independent_numbers(self.stream, step, CHOICES))


@dataclass(frozen=True)
class AreaTarget:
    """The n triangles on which first hidden vertices are drawn by area.

    Attributes
    ----------
    share : share of the first hidden vertices that are drawn by area, 0 … 7/8.
    faces : (n,) indices of the triangles.
    cumulative : (n,) running share of their area.
    area_m2 : total area of the triangles.
    contains : (F,) whether each triangle of the scene is one of them.
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
        """The triangles of objects that rays from the laser points seldom meet, as trial rays tell.

        The same seed gives the same triangles. Triangles and share change the variance only; the mean is the same for
        any of them.
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
        # A part that a laser point lies on, such as a wall, gets no light from the points of its own plane.
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
    """Runs of at most `size` consecutive laser points; a gap in `lasers` (a ray that met nothing) ends a run."""
    runs = np.split(lasers, np.flatnonzero(np.diff(lasers) != 1) + 1)
    return [run[k : k + size] for run in runs for k in range(0, len(run), size)]


def laser_point_vertices(
    points: LaserPoints, lasers: Ints, count: int, streams: Streams, attenuation_per_m: float
) -> Vertices:
    """The laser points themselves as vertices: `count` copies of each, which share the emitted photon."""
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
    """First hidden vertices of each of `lasers`: of `count` samples those that the laser point lights.

    lasers : indices of laser points that exist. steps : number of hidden vertices of a path, which decides how many
    Sobol' coordinates a sample takes.
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
        # A place is lit if a ray to it meets its own triangle first. Of two coinciding triangles only the one counts
        # that a ray drawn by the BRDF would meet, too, as the balance heuristic demands.
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
    # The number of a sample within its laser point, by which its independent numbers are seeded.
    rays = by_ray * len(lasers)
    number = np.where(kept < rays, kept % by_ray, by_ray + (kept - rays) % max(by_area, 1))
    power *= np.exp(-scene.attenuation_per_m * (points.leg[owner] + distance))
    none = np.zeros(len(owner), np.uint64)
    stream = streams.seeds(LightStream.WALK_STEPS, owner, number) if steps > SOBOL_STEPS else none
    return Vertices(
        laser=owner, position=position[kept], normal=normal, to_previous=to_previous,
        part=scene.face_part[face[kept]].astype(np.int64), power=power, path=distance, choices=sobol[kept, 2:],
        stream=stream,
    )  # fmt: skip


def continued(scene: Scene, vertices: Vertices, hits: Hits, directions: Floats, throughput: Floats) -> Vertices:
    """The next vertices of the paths, where the rays from `vertices` land; paths whose ray met nothing are left out.

    directions : (n, 3) of the rays. throughput : (n,) factor by which a bounce changes the power, 0 to end a path.
    """
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
    """Hits, unit directions (n, 3) and throughput f cosθ / pdf (n,) of one ray from each vertex, drawn by its BRDF.

    numbers : (n, CHOICES), of which the second and third aim the ray.
    """
    uv = np.ascontiguousarray(numbers[:, 1:3])
    directions, throughput = _scattered(materials.arrays, vertices.part, vertices.normal, vertices.to_previous, uv)
    return caster.leaving(vertices.position, vertices.normal, directions), directions, throughput


def _rays(caster: Raycaster, materials: MaterialTable, points: LaserPoints, owner: Ints, uv: Floats) -> Hits:
    """Hits of n rays from the laser points `owner` (n,), drawn by their BRDFs from the numbers uv (n, ≥ 2)."""
    normals = points.normal[owner]
    directions, _ = _scattered(materials.arrays, points.part[owner], normals, points.to_laser[owner], uv)
    return caster.leaving(points.position[owner], normals, directions)


def _points_on_area(caster: Raycaster, target: AreaTarget, sobol: Floats) -> tuple[NDArray[np.int32], Floats]:
    """Triangle indices (n,) and points (n, 3) uniform on the target's area, from the first two columns of `sobol`."""
    # The first coordinate picks the triangle. Stretched back to 0 … 1 within its share it serves once more as a
    # coordinate on the triangle.
    pick = np.minimum(np.searchsorted(target.cumulative, sobol[:, 0], side="right"), len(target.faces) - 1)
    upper = target.cumulative[pick]
    lower = np.where(pick > 0, target.cumulative[pick - 1], 0.0)
    face = target.faces[pick].astype(np.int32)
    root = np.sqrt(np.clip((sobol[:, 0] - lower) / (upper - lower), 0.0, 1.0))
    weights = np.stack([1 - root, root * (1 - sobol[:, 1]), root * sobol[:, 1]], axis=1)
    return face, np.einsum("ik,ikj->ij", weights, caster.corners[face])


@compiled(inline="always")
def at(array: Floats, i: int) -> Vector:
    """Row i of an (n, 3) array as a vector."""
    return (array[i, 0], array[i, 1], array[i, 2])


@compiled()
def _scattered(materials: Materials, part: Ints, normal: Floats, w_in: Floats, uv: Floats) -> tuple[Floats, Floats]:
    """Unit directions (n, 3) drawn by each vertex's BRDF from uv (n, ≥ 2), and their throughput f cosθ / pdf (n,)."""
    directions, throughput = np.empty((len(part), 3)), np.empty(len(part))
    for i in range(len(part)):
        k, material = materials.kind[part[i]], materials.values[part[i]]
        n, incoming = at(normal, i), at(w_in, i)
        w = sample(k, material, n, incoming, uv[i, 0], uv[i, 1])
        directions[i, 0], directions[i, 1], directions[i, 2] = w
        # A lobe may send a ray below the surface, where no light leaves: its throughput is 0.
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
            # Half a step above the multiple of 2⁻³²: neither 0, of which a lobe may take the logarithm, nor 1.
            out[i, k] = (np.float64(word) + 0.5) * 2.0**-32
    return out


@compiled()
def _lit(
    face: NDArray[np.int32], position: Floats, owner: Ints, points: LaserPoints, materials: Materials,
    face_normal: Floats, by_area_too: Bools, rays: float, area_density: float,
) -> tuple[Ints, Floats, Floats, Floats, Floats]:  # fmt: skip
    """Candidates for first hidden vertices that their laser points light: indices (n,), unit normals on the lit side
    (n, 3), unit directions (n, 3) and distances (n,) to the laser point, and power (n,).

    The power is f₁ cosθ₁ cosθ₂ / R² over the expected number of samples per area by both ways together. rays : number
    of rays of a laser point. area_density : 1/m², of points drawn by area on triangles where `by_area_too` (F,).
    """
    kept = np.empty(len(face), np.int64)
    normal, to_laser_point = np.empty((len(face), 3)), np.empty((len(face), 3))
    distance, power = np.empty(len(face)), np.empty(len(face))
    n = 0
    for i in range(len(face)):
        f, o = face[i], owner[i]
        # The ray met nothing, or another surface than the one that was drawn by area.
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
        # The balance heuristic: whichever way drew this place, its power is divided by the density of both ways.
        density = rays * pdf(k1, material1, n1, w_in, w) * spread
        if by_area_too[f]:
            density += area_density
        if density <= 0.0:
            continue
        energy = evaluate(k1, material1, n1, w_in, w) * cos1 * spread / density
        # `not … > 0` leaves out NaN as well, which `<= 0` would let pass.
        if not energy > 0.0:
            continue
        kept[n], distance[n], power[n] = i, r, energy
        for k in range(3):
            normal[n, k] = side * facing[k]
            to_laser_point[n, k] = -w[k]
        n += 1
    return kept[:n], normal[:n], to_laser_point[:n], distance[:n], power[:n]
