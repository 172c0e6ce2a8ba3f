"""Lookins: points of the scene lit by a laser point, and the light each receives.

Two ways of drawing them are joined by the balance heuristic (Veach & Guibas, SIGGRAPH 1995), which is unbiased and
never gives a lookin more than the cosine rays alone would:

- rays from the laser point with density cosθ/π, which already carry the 1/R² of the geometry (DESIGN, sec. 2);
- points uniform on the area of small parts, so that a small or distant object gets its share of samples.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, fields

import numpy as np
from numba import njit
from numpy.typing import NDArray

from datagen.records import Laser, Scene
from datagen.transport.brdf import MaterialTable, cosine_directions
from datagen.transport.raycast import Raycaster
from datagen.transport.sampling import scrambled_sobol, stream_seeds

COSINE_STREAM, AREA_STREAM = 1, 2
DIMENSIONS = 5
"""Sobol' dimensions of a lookin: two place it, one picks its FoV points, two aim its followed ray."""


@dataclass(frozen=True)
class LaserPoints:
    """First surfaces of the laser rays: position, normal (facing the laser) (L, 3); part (L,), −1 for none;
    leg (L,) metres from the laser."""

    position: NDArray[np.float64]
    normal: NDArray[np.float64]
    part: NDArray[np.int64]
    leg: NDArray[np.float64]

    @classmethod
    def of(cls, caster: Raycaster, scene: Scene, laser: Laser) -> LaserPoints:
        hits = caster.closest(laser.position, laser.targets - laser.position)
        part = np.where(hits.valid, scene.face_part[hits.face], -1).astype(np.int64)
        position = np.where(hits.valid[:, None], hits.position, np.nan)
        return cls(position, hits.normal, part, np.linalg.norm(position - laser.position, axis=1))


@dataclass(frozen=True)
class Lookins:
    """n lookins, each lit by one laser point.

    laser : (n,) index of the laser point.
    position, normal, to_laser_point : (n, 3) metres; unit normal facing the laser point; unit direction to it.
    part : (n,) part index.
    power : (n,) share of the emitted photon that arrives here.
    path : (n,) metres travelled that count for the time axis.
    further : (n, 3) further Sobol' coordinates of each lookin, for the choices made after it.
    """

    laser: NDArray[np.int64]
    position: NDArray[np.float64]
    normal: NDArray[np.float64]
    to_laser_point: NDArray[np.float64]
    part: NDArray[np.int64]
    power: NDArray[np.float64]
    path: NDArray[np.float64]
    further: NDArray[np.float64]

    def take(self, rows: NDArray[np.int64]) -> Lookins:
        return Lookins(**{field.name: getattr(self, field.name)[rows] for field in fields(self)})


@dataclass(frozen=True)
class AreaTarget:
    """The triangles sampled by area and the share of lookins they get.

    share : 0 … 7/8; faces : (n,) triangle indices; cumulative : (n,) running share of area; area_m2 : their total.
    """

    share: float
    faces: NDArray[np.int64]
    cumulative: NDArray[np.float64]
    area_m2: float
    contains: NDArray[np.bool_]

    @classmethod
    def choose(cls, caster: Raycaster, scene: Scene, points: LaserPoints, seed: int) -> AreaTarget:
        """Aim at objects that too few cosine rays would meet: a pilot of rays decides (its seed fixes the answer).

        The share is a matter of variance only; any value gives the same mean.
        """
        seen = np.flatnonzero(points.part >= 0)
        object_parts = [k for k, role in enumerate(scene.roles) if role == "object"]
        nothing = cls(0.0, np.empty(0, np.int64), np.empty(0), 0.0, np.zeros(len(scene.part_names), np.bool_))
        if not len(seen) or not object_parts:
            return nothing
        pilots = seen[np.linspace(0, len(seen) - 1, min(len(seen), 8)).astype(int)]
        uv = scrambled_sobol(stream_seeds(seed, 0, pilots), 256, 2).reshape(-1, 2)
        normals = np.repeat(points.normal[pilots], 256, axis=0)
        origins = np.repeat(points.position[pilots], 256, axis=0) + caster.offset_m * normals
        hits = caster.closest(origins, cosine_directions(normals, uv))
        met = scene.face_part[hits.face[hits.valid]]
        frequency = np.bincount(met, minlength=len(scene.part_names)) / len(uv)
        # A part the laser spot itself lies on (a wall made of one part) is lit by nothing of its own plane.
        chosen = [k for k in object_parts if frequency[k] < 0.25 and not np.isin(k, points.part)]
        faces = np.flatnonzero(np.isin(scene.face_part, chosen))
        if not len(faces):
            return nothing
        elsewhere = frequency.sum() - frequency[chosen].sum()
        contains = np.zeros(len(scene.part_names), np.bool_)
        contains[chosen] = True
        cumulative = np.cumsum(caster.face_area_m2[faces])
        return cls(
            share=0.875 if elsewhere < 0.01 else 0.25,
            faces=faces,
            cumulative=cumulative / cumulative[-1],
            area_m2=float(cumulative[-1]),
            contains=contains,
        )


def draw_lookins(
    caster: Raycaster,
    scene: Scene,
    materials: MaterialTable,
    points: LaserPoints,
    lasers: NDArray[np.int64],
    count: int,
    target: AreaTarget,
    seed: int,
    scrambling: int,
    count_first_leg: bool,
) -> Lookins:
    """`count` lookins for each of `lasers` (indices of laser points that exist), from one scrambling."""
    by_area = min(round(count * target.share), count - 1)
    by_ray = count - by_area
    n1, x1 = points.normal[lasers], points.position[lasers]

    sobol = scrambled_sobol(stream_seeds(seed, COSINE_STREAM, scrambling, lasers), by_ray, DIMENSIONS)
    sobol = sobol.reshape(-1, DIMENSIONS)
    owner = np.repeat(np.arange(len(lasers)), by_ray)
    normals = n1[owner]
    hits = caster.closest(x1[owner] + caster.offset_m * normals, cosine_directions(normals, sobol))
    face, position = hits.face, hits.position
    if by_area:
        area_sobol = scrambled_sobol(stream_seeds(seed, AREA_STREAM, scrambling, lasers), by_area, DIMENSIONS)
        area_sobol = area_sobol.reshape(-1, DIMENSIONS)
        area_owner = np.repeat(np.arange(len(lasers)), by_area)
        area_face, area_position = _points_on_area(caster, target, area_sobol)
        # Seen means: met first. Of two coinciding triangles only the one that a ray would meet then counts.
        start = x1[area_owner] + caster.offset_m * n1[area_owner]
        first = caster.closest(start, area_position - start)
        face = np.concatenate([face, np.where(first.face == area_face, area_face, -1)])
        position = np.concatenate([position, area_position])
        owner = np.concatenate([owner, area_owner])
        sobol = np.concatenate([sobol, area_sobol])
    kept, normal, to_laser_point, distance, power = _light(
        face, position, owner, x1, n1, materials.values[points.part[lasers], 0], caster.face_normal,
        target.contains[scene.face_part], float(by_ray), by_area / (target.area_m2 or 1.0),
    )  # fmt: skip
    owner = owner[kept]
    return Lookins(
        laser=lasers[owner],
        position=position[kept],
        normal=normal,
        to_laser_point=to_laser_point,
        part=scene.face_part[face[kept]].astype(np.int64),
        power=power,
        path=distance + points.leg[lasers][owner] if count_first_leg else distance,
        further=sobol[kept, 2:],
    )


@njit(cache=True)
def _light(
    face: NDArray[np.int32],
    position: NDArray[np.float64],
    owner: NDArray[np.int64],
    x1: NDArray[np.float64],
    n1: NDArray[np.float64],
    albedo1: NDArray[np.float64],
    face_normal: NDArray[np.float64],
    by_area_too: NDArray[np.bool_],
    rays: float,
    area_density: float,
) -> tuple[NDArray[np.int64], NDArray[np.float64], NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """Which candidates are lit, their facing normal, direction and distance to the laser point, and their power."""
    kept = np.empty(len(face), np.int64)
    normal, to_laser = np.empty((len(face), 3)), np.empty((len(face), 3))
    distance, power = np.empty(len(face)), np.empty(len(face))
    n = 0
    for i in range(len(face)):
        f, o = face[i], owner[i]
        if f < 0:
            continue
        square, cos1, cos2 = 0.0, 0.0, 0.0
        for k in range(3):
            d = x1[o, k] - position[i, k]
            to_laser[n, k] = d
            square += d * d
            cos1 -= n1[o, k] * d
            cos2 += face_normal[f, k] * d
        if square == 0.0 or cos1 <= 0.0 or cos2 == 0.0:
            continue
        r = math.sqrt(square)
        side = 1.0 if cos2 > 0.0 else -1.0
        for k in range(3):
            to_laser[n, k] /= r
            normal[n, k] = side * face_normal[f, k]
        form = (cos1 / r) * (abs(cos2) / r) / (math.pi * square)
        density = rays * form
        if by_area_too[f]:
            density += area_density
        kept[n] = i
        distance[n] = r
        power[n] = albedo1[o] * form / density
        if power[n] > 0.0:
            n += 1
    return kept[:n], normal[:n], to_laser[:n], distance[:n], power[:n]


def _points_on_area(
    caster: Raycaster, target: AreaTarget, sobol: NDArray[np.float64]
) -> tuple[NDArray[np.int32], NDArray[np.float64]]:
    """Faces (n,) and points (n, 3) uniform on the target's area, from the first two of Sobol' coordinates (n, …)."""
    # The first coordinate picks the triangle and, stretched back to 0 … 1, serves once more within it.
    pick = np.minimum(np.searchsorted(target.cumulative, sobol[:, 0], side="right"), len(target.faces) - 1)
    upper = target.cumulative[pick]
    lower = np.where(pick > 0, target.cumulative[pick - 1], 0.0)
    face = target.faces[pick].astype(np.int32)
    root = np.sqrt(np.clip((sobol[:, 0] - lower) / (upper - lower), 0.0, 1.0))
    weights = np.stack([1 - root, root * (1 - sobol[:, 1]), root * sobol[:, 1]], axis=1)
    return face, np.einsum("ik,ikj->ij", weights, caster.corners[face])
