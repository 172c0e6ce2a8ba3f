"""The paper's samples: a grid of rays from the laser point, a half cube of camera pixels at each lookin.

Scholes & Leach, Sensors 24, 6522 (2024), sec. 3.1. Every ray and every pixel counts alike there, whatever solid angle
it stands for. What the text leaves open is chosen here and said where it is.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from datagen.compiled import compiled
from datagen.errors import InputError
from datagen.records import Lambertian, Scene, SinLobe
from datagen.transport.brdf import Vector
from datagen.transport.brdf.sin_lobe import azimuth_sine
from datagen.transport.raycast import Raycaster

Grid = Literal["angles", "solid_angle"]
Array = NDArray[np.float64]

HEMISPHERE_OF_COSINE = math.pi
"""∫ cosφ dω over the hemisphere."""
HEMISPHERE_OF_SINE = 4.0
"""∫ |sinθ| dω over the hemisphere, θ the azimuth."""


def ray_grid(count: int, grid: Grid) -> Array:
    """(count², 3) unit directions of a count × count grid over the hemisphere, as (right, up, along the normal).

    The paper says "a 10 × 10 grid of rays" and that θ spans 2π and φ spans 0 … π/2 (sec. 3.1, Fig. 2b), no more:
    `angles` takes that as equal steps of both, which crowds the rays about the normal; `solid_angle` gives every ray
    the same solid angle, by equal steps of θ and cosφ. Both take the middles of the steps.
    """
    middles = (np.arange(count) + 0.5) / count
    theta = np.repeat(2 * np.pi * middles, count)
    phi = np.tile(0.5 * np.pi * middles if grid == "angles" else np.arccos(1 - middles), count)
    return np.stack([np.sin(phi) * np.cos(theta), np.sin(phi) * np.sin(theta), np.cos(phi)], axis=1)


def half_cube(pixels: int) -> Array:
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


def upright_frames(normal: Array) -> Array:
    """(n, 3, 3) rows right, up, normal: up is the vertical as far as the surface lets it, +x on floor and ceiling.

    The text fixes the cameras' axis only, the surface normal; their roll is chosen here.
    """
    up = np.array([0.0, 0.0, 1.0]) - normal[:, 2:3] * normal
    length = np.linalg.norm(up, axis=1, keepdims=True)
    level = length[:, 0] < 1e-6
    up[level] = np.array([1.0, 0.0, 0.0]) - normal[level, :1] * normal[level]
    up /= np.linalg.norm(up, axis=1, keepdims=True)
    return np.stack([np.cross(up, normal), up, normal], axis=1)


@dataclass(frozen=True)
class PrintedMaterials:
    """What the paper's equations know of each of K parts.

    Attributes
    ----------
    reflectivity : (K,) Γ.
    sine : (K,) whether B = |sinθ| and not cosφ.
    axis : (K, 3) from whose projection on the surface θ counts.
    beta : (K,) β, see `simulate_as_printed`.
    """

    reflectivity: Array
    sine: NDArray[np.bool_]
    axis: Array
    beta: Array

    @classmethod
    def of(cls, scene: Scene) -> PrintedMaterials:
        """Raises `InputError` for a BRDF that the paper does not have."""
        for name, material in zip(scene.part_names, scene.materials, strict=True):
            if not isinstance(material, (Lambertian, SinLobe)):
                raise InputError(
                    f"part {name!r}: {type(material).__name__} is no BRDF of the paper; as printed there are cosφ "
                    "(Lambertian) and |sinθ| (SinLobe) only: change it, or use dg.simulate"
                )
        sine = np.array([isinstance(m, SinLobe) for m in scene.materials])
        axes: Sequence[Vector] = [m.axis if isinstance(m, SinLobe) else (0.0, 0.0, 1.0) for m in scene.materials]
        return cls(
            np.array([float(m.albedo) for m in scene.materials]),
            sine,
            np.array(axes, np.float64),
            1.0 / np.where(sine, HEMISPHERE_OF_SINE, HEMISPHERE_OF_COSINE),
        )

    def brdf(self, part: NDArray[np.int64], normal: Array, direction: Array) -> Array:
        """(n,) B towards unit directions (n, 3) at surfaces (n,), (n, 3): cosφ, or |sinθ| with θ of Eq. 5.

        The light's incidence plays no part (sec. 3.2); below the surface B is 0. As printed, sinθ would be negative
        on one side: the modulus is taken.
        """
        return _brdf(self.sine[part], self.axis[part], normal, direction)


@compiled()
def _brdf(sine: NDArray[np.bool_], axis: Array, normal: Array, direction: Array) -> Array:
    out = np.zeros(len(direction))
    for i in range(len(direction)):
        n = (normal[i, 0], normal[i, 1], normal[i, 2])
        w = (direction[i, 0], direction[i, 1], direction[i, 2])
        cosine = n[0] * w[0] + n[1] * w[1] + n[2] * w[2]
        if cosine > 0.0:
            out[i] = azimuth_sine((axis[i, 0], axis[i, 1], axis[i, 2]), n, w) if sine[i] else cosine
    return out


@dataclass(frozen=True)
class Seen:
    """What a bundle of equally counted directions sees from each of n points: m samples each.

    Attributes
    ----------
    position, normal : (n, m, 3) first surface along the direction, metres, and its unit normal towards the point.
    face, part : (n, m) triangle and part index, −1 where there is nothing.
    distance : (n, m) metres, ∞ where there is nothing.
    share : (n, m) α B of each direction, 1 in all over each bundle, seen surfaces or not.
    alpha : (n,) α = 1 / Σ B, 0 where B is 0 in all directions.
    """

    position: Array
    normal: Array
    face: NDArray[np.int32]
    part: NDArray[np.int64]
    distance: Array
    share: Array
    alpha: Array


def look(
    caster: Raycaster,
    scene: Scene,
    materials: PrintedMaterials,
    position: Array,
    normal: Array,
    part: NDArray[np.int64],
    directions: Array,
) -> Seen:
    """Cast `directions` (m, 3), given in the surface's own frame, from surface points (n, 3) with normals and parts.

    The normalisation α = 1 / Σ B over the directions sampled is the text's "constant, to ensure the conservation of
    energy" (Eq. 1); a direction that meets nothing takes its share away.
    """
    n, m = len(position), len(directions)
    world = np.einsum("ma,nab->nmb", directions, upright_frames(normal))
    flat = world.reshape(-1, 3)
    brdf = materials.brdf(np.repeat(part, m), np.repeat(normal, m, axis=0), flat).reshape(n, m)
    total = brdf.sum(axis=1)
    alpha = np.divide(1.0, total, out=np.zeros_like(total), where=total > 0)
    hits = caster.closest(np.repeat(position + caster.offset_m * normal, m, axis=0), flat)
    valid = hits.valid
    where = np.where(valid[:, None], hits.position, 0.0).reshape(n, m, 3)
    distance = np.linalg.norm(where - position[:, None], axis=2)
    return Seen(
        position=where,
        normal=hits.normal.reshape(n, m, 3),
        face=hits.face.reshape(n, m),
        part=np.where(valid, scene.face_part[hits.face], -1).astype(np.int64).reshape(n, m),
        distance=np.where(valid.reshape(n, m), distance, np.inf),
        share=alpha[:, None] * brdf,
        alpha=alpha,
    )
