"""Connections from lookins to FoV points: geometry, BRDFs and binning fused into two compiled loops.

Two ways of joining a lookin x₂ to a pixel are combined by the balance heuristic:

- *connect*: to each of M FoV points x₃. The kernel cosθ₂ cosθ₃ / R₂₃² has no bound where the two surfaces touch;
- *follow*: one ray drawn by the BRDF at x₂, which counts where it lands inside a pixel. It carries no 1/R².

With the footprint a₃ of a FoV point (the wall area one of the M points stands for) and p = pdf·cosθ₃/R₂₃² the area
density of the second way, the first is worth 1/(1 + p a₃) of itself and the second p a₃/(1 + p a₃). So a connection
never carries more than its footprint could receive, and what that bound takes away comes back by the followed rays:
bounded for a single sample, unbiased for any number. A lookin too far from a pixel's patch to overfill a footprint
needs no followed ray: there the first way counts whole (`PixelPatches.reach`).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from datagen.records import Scene, Sensor
from datagen.transport.brdf import MaterialTable, cosine_directions
from datagen.transport.fov import FovPool, PixelCones, PixelPatches
from datagen.transport.kernels import deposit, gather, inside_pixels, near_a_pixel
from datagen.transport.lookins import Lookins
from datagen.transport.raycast import Raycaster

CONNECTIONS_PER_BATCH = 1 << 19


@dataclass(frozen=True)
class Clock:
    """Path length → fractional bin: position = path · per_metre − start."""

    per_metre: float
    start: float


@dataclass(frozen=True)
class Tally:
    """Where energy goes: histogram (row, bin) and overflow (row,), rows ordered (laser, pixel, split)."""

    histogram: NDArray[np.float64]
    overflow: NDArray[np.float64]


@dataclass(frozen=True)
class Rows:
    """Which row a contribution belongs to.

    first_laser : index of the chunk's first laser point. confocal : pixel i belongs to laser point i alone.
    pixels : pixels a laser point has. split_of_part : (K,) row offset of each part; splits : how many there are.
    """

    first_laser: int
    confocal: bool
    pixels: int
    split_of_part: NDArray[np.int64]
    splits: int


def connect(
    caster: Raycaster,
    materials: MaterialTable,
    lookins: Lookins,
    pool: FovPool,
    patches: PixelPatches,
    points_per_lookin: int,
    clock: Clock,
    rows: Rows,
    tally: Tally,
) -> None:
    """Join every lookin to `points_per_lookin` FoV points of each of its pixels and add what is not occluded."""
    blocks = pool.weight.shape[1] // points_per_lookin
    block = np.minimum(lookins.further[:, 0] * blocks, blocks - 1).astype(np.int64)
    pixels = 1 if rows.confocal else rows.pixels
    per_lookin = pixels * points_per_lookin
    lookins_per_batch = max(1, CONNECTIONS_PER_BATCH // per_lookin)
    capacity = lookins_per_batch * per_lookin
    origins, spans = np.empty((capacity, 3), np.float32), np.empty((capacity, 3), np.float32)
    row, position, energy = np.empty(capacity, np.int64), np.empty(capacity), np.empty(capacity)
    for start in range(0, len(lookins.laser), lookins_per_batch):
        stop = min(start + lookins_per_batch, len(lookins.laser))
        found = gather(
            start, stop, lookins.laser, lookins.position, lookins.normal, lookins.to_laser_point, lookins.part,
            lookins.power, lookins.path, block, pool.position, pool.normal, pool.to_sensor, pool.part, pool.weight,
            pool.footprint, pool.leg,
            patches.center, patches.reach, materials.kind, materials.values, points_per_lookin, rows.first_laser,
            rows.confocal, rows.pixels, rows.split_of_part, rows.splits, clock.per_metre, clock.start, caster.center,
            caster.half_extent_m, caster.offset_m, origins, spans, row, position, energy,
        )  # fmt: skip
        hidden = caster.occluded_scaled(origins[:found], spans[:found])
        deposit(row[:found], position[:found], energy[:found], hidden, tally.histogram, tally.overflow)


def follow(
    caster: Raycaster,
    scene: Scene,
    sensor: Sensor,
    cones: PixelCones,
    patches: PixelPatches,
    materials: MaterialTable,
    lookins: Lookins,
    points_per_lookin: int,
    clock: Clock,
    rows: Rows,
    tally: Tally,
    count_last_leg: bool,
) -> None:
    """Send one BRDF-drawn ray from every lookin and add those that land inside a pixel."""
    near = near_a_pixel(
        lookins.laser, lookins.position, lookins.part, materials.kind, patches.center, patches.reach,
        rows.first_laser, rows.confocal,
    )  # fmt: skip
    if not len(near):
        return
    lookins = lookins.take(near)
    direction = cosine_directions(lookins.normal, lookins.further[:, 1:])
    hits = caster.closest(lookins.position + caster.offset_m * lookins.normal, direction)
    part = np.where(hits.valid, scene.face_part[hits.face], -1).astype(np.int64)
    owner, row, position, energy = inside_pixels(
        hits.position, hits.normal, part, direction, lookins.laser, lookins.position, lookins.normal,
        lookins.to_laser_point, lookins.part, lookins.power, lookins.path, materials.kind, materials.values,
        sensor.position, cones.planes, cones.solid_angle,
        patches.center, patches.reach, sensor.aperture_area_m2, points_per_lookin,
        rows.first_laser, rows.confocal, rows.pixels, rows.split_of_part, rows.splits, clock.per_metre, clock.start,
        count_last_leg,
    )  # fmt: skip
    lifted = hits.position[owner] + caster.offset_m * hits.normal[owner]
    hidden = caster.occluded(np.broadcast_to(sensor.position, lifted.shape), lifted)
    deposit(row, position, energy, hidden, tally.histogram, tally.overflow)
