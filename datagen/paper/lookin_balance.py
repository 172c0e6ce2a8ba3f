"""What reaches each lookin by a detour, beside what reaches it straight from the laser point."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from datagen.paper.as_printed_paths import PrintedRoom, arriving, lighting, observe, place_lookins
from datagen.paper.as_printed_sampling import half_cube, ray_grid
from datagen.records import Capture, Lambertian, Scene
from datagen.transport.factorised.convolution import Paths


@dataclass(frozen=True)
class LookinBalance:
    """Over the lookins of one grid of rays, arriving secondary over arriving primary light.

    strongest, every : (n,) Â₁Â₂ / A₁ as printed, of the strongest path and of the sum of all, in the unit of length.
    least_detour_m : how much longer than the way straight to its lookin the shortest detour of all is; NaN for none.
    irradiance : (n,) the same ratio of irradiances, every pixel weighted by its solid angle; None for a room that is
        not Lambertian throughout.
    """

    strongest: NDArray[np.float64]
    every: NDArray[np.float64]
    least_detour_m: float
    irradiance: NDArray[np.float64] | None


def lookin_balance(scene: Scene, capture: Capture, rays: int, pixels: int, unit_m: float) -> LookinBalance:
    """The balance of the first laser point, with α₁ of Eq. 8 over the whole room."""
    room, camera = PrintedRoom.of(scene, capture, unit_m), half_cube(pixels)
    lookins = place_lookins(room, 0, ray_grid(rays, "angles"))
    strongest, every, total_b1 = np.zeros(len(lookins)), np.zeros(len(lookins)), 0.0
    irradiance = np.full(len(lookins), np.nan)
    diffuse = all(isinstance(material, Lambertian) for material in scene.materials)
    least = np.inf
    size = max(1, (1 << 18) // len(camera))
    for first in range(0, len(lookins), size):
        some = slice(first, first + size)
        chunk = lookins.take(some)
        seen = observe(room, chunk, camera)
        light = lighting(room, 0, seen)
        into = arriving(room, 0, chunk, seen, light)
        total_b1 += float(light.brdf.sum())
        rows = [slice(*into.first[k : k + 2]) for k in range(len(chunk))]
        strongest[some] = [into.energy[row].max(initial=0.0) for row in rows]
        every[some] = [into.energy[row].sum() for row in rows]
        least = min(least, _least_detour(room, into, chunk.distance))
        if diffuse:
            # As printed, A₁ and Â₁Â₂ lack the receiving cosines and solid angles; here they are, for Lambert's law.
            to_laser = room.points.position[0] - chunk.position
            cos_j = np.einsum("nk,nk->n", to_laser, chunk.normal) / chunk.distance
            cos_1 = -(to_laser @ room.points.normal[0]) / chunk.distance
            direct = cos_1 * cos_j / (np.pi * chunk.distance**2)
            span = room.points.position[0] - seen.position
            cos_k = np.einsum("nmk,nmk->nm", span, seen.normal) / light.distance
            gamma = room.materials.reflectivity[np.maximum(seen.part, 0)]
            radiance = gamma * light.brdf * np.maximum(cos_k, 0.0) / (np.pi * light.distance) ** 2
            indirect = radiance @ (camera[:, 2] * _solid_angles(camera, pixels))
            irradiance[some] = np.divide(indirect, direct, out=np.full(len(chunk), np.nan), where=direct > 0)
    scale = np.where(lookins.amplitude > 0, 1.0 / np.where(lookins.amplitude > 0, lookins.amplitude, 1.0), np.nan)
    scale /= total_b1 if total_b1 > 0 else 1.0
    detour = least if np.isfinite(least) else float("nan")
    return LookinBalance(strongest * scale, every * scale, detour, irradiance if diffuse else None)


def _least_detour(room: PrintedRoom, into: Paths, straight_m: NDArray[np.float64]) -> float:
    per_bin = 1.0 / float(room.bins(np.array(1.0)))
    return float((into.position * per_bin - np.repeat(straight_m, np.diff(into.first))).min(initial=np.inf))


def _solid_angles(camera: NDArray[np.float64], pixels: int) -> NDArray[np.float64]:
    """(m,) solid angle of each pixel of the half cube, sr: (side of a pixel)² / |v|³ for v on the cube of side 2."""
    return np.asarray((4.0 / pixels) ** 2 * np.abs(camera).max(axis=1) ** 3, np.float64)
