"""What the secondary is sampled by: FoV points, lookins drawn from them, and the light near each laser point."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from datagen.records.arrays import Bools, Floats, Ints
from datagen.seeding import LightStream
from datagen.transport.brdf import cosine_directions
from datagen.transport.factorised.secondary_kernels import FovPoints, Frame, LaserVicinity, Lookins, Pace, Surfaces
from datagen.transport.fields_of_view import FovPool, fov_pool
from datagen.transport.path_tracing.trace import WalkTask
from datagen.transport.sampling import scrambled_sobol, stream_seeds

FOV_POINTS_PER_POOL = 1 << 16
RAYS_FROM_LASER_POINT = 1 / 8
"""Rays drawn from each laser point, as a share of the lookins or of the observed points, whichever is more."""
NEAR = 0.1
"""Radius of what is near a laser point, in half extents of the scene: 0.5 m in a room of 10 m."""

Placement = Literal["fov", "laser"]


@dataclass(frozen=True)
class SecondaryTask(WalkTask):
    """A secondary to compute: what is looked at, and the scene as the kernels want it."""

    observed: int
    placement: Placement
    plain: bool
    carries: Bools
    surfaces: Surfaces
    pace: Pace
    frame: Frame
    face_plane: NDArray[np.int32]

    def groups(self) -> list[tuple[Ints, Ints]]:
        """Runs of laser points that share their lookins, with the pixels they are seen by."""
        existing = np.flatnonzero(self.points.part >= 0)
        pixels = np.arange(len(self.capture.sensor.pixels))
        if self.capture.pairing == "confocal":
            return [(existing[k : k + 1], existing[k : k + 1]) for k in range(len(existing))]
        if self.placement == "laser":
            return [(existing[k : k + 1], pixels) for k in range(len(existing))]
        return [(existing, pixels)] if len(existing) else []

    @property
    def near_square(self) -> float:
        """Square of the distance that is near a laser point, m²; nothing is where the scheme is the paper's own."""
        own = self.placement == "laser" or self.accuracy.strongest is not None
        return 0.0 if own else (NEAR * self.caster.half_extent_m) ** 2


def fov_points(task: SecondaryTask, pixels: Ints, count: int, replicate: int) -> tuple[FovPool, FovPoints, int]:
    """Blocks of FoV points (their number a power of two, so that they cover the pixel evenly) and how many."""
    affordable = FOV_POINTS_PER_POOL // (len(pixels) * task.accuracy.fov_samples)
    blocks = 1 << max(0, min(count, affordable).bit_length() - 1)
    pool = fov_pool(
        task.caster, task.scene, task.capture.sensor, task.cones, pixels, task.accuracy.fov_samples, blocks,
        stream_seeds(task.seed, LightStream.FACTORISED_FOV_POINTS, replicate, pixels),
    )  # fmt: skip
    worth = np.where(pool.weight > 0, pool.weight * task.materials.values[pool.part, 0], 0.0)
    of_block = worth.reshape(len(pixels), blocks, -1).sum(axis=(0, 2))
    share = worth / np.where(of_block > 0, of_block, 1.0).repeat(task.accuracy.fov_samples)
    arrays = pool.position, pool.normal, pool.to_sensor, pool.part, pool.weight, pool.last_leg
    return pool, FovPoints(*arrays, share), blocks


def place_lookins(
    task: SecondaryTask, fov: FovPoints, blocks: int, lasers: Ints, pixels: Ints, count: int, replicate: int
) -> Lookins:
    """Lookins by cosine rays from FoV points, or from the laser point; those that cannot carry light are left out."""
    seeds = stream_seeds(task.seed, LightStream.FACTORISED_FIRST, replicate, int(lasers[0]))
    sobol = scrambled_sobol(seeds, count, 6)[0]
    scaled = sobol[:, 0] * blocks
    block = np.minimum(scaled, blocks - 1).astype(np.int64)
    if task.placement == "laser":
        normal = np.repeat(task.points.normal[lasers], count, axis=0)
        position = np.repeat(task.points.position[lasers], count, axis=0)
        drawn = np.ones(count, np.bool_)
    else:
        share = fov.share.reshape(len(pixels), blocks, -1).transpose(1, 0, 2).reshape(blocks, -1)
        running = np.cumsum(share, axis=1)
        drawn, points = running[block, -1] > 0, task.accuracy.fov_samples
        # One search serves all blocks: block k's running shares fill k … k + 1.
        shares = (running / np.where(running[:, -1:] > 0, running[:, -1:], 1.0) + np.arange(blocks)[:, None]).ravel()
        pick = np.searchsorted(shares, block + np.clip(scaled - block, 0.0, 1.0), side="left")
        pick = np.clip(pick - block * share.shape[1], 0, share.shape[1] - 1)
        pixel, point = pick // points, block * points + pick % points
        position, normal = fov.position[pixel, point], fov.normal[pixel, point]
    hits = task.caster.closest(position + task.caster.offset_m * normal, cosine_directions(normal, sobol[:, 1:3]))
    part = np.where(hits.valid, task.scene.face_part[hits.face], 0).astype(np.int64)
    kept = hits.valid & drawn & task.carries[part]
    return Lookins(hits.position[kept], hits.normal[kept], part[kept], block[kept], sobol[kept, 3], sobol[kept, 4:])


def laser_vicinities(task: SecondaryTask, lasers: Ints, count: int, replicate: int) -> list[LaserVicinity]:
    """The laser points, with where cosine rays from each land near it."""
    rays = int(np.ceil(max(count, task.observed) * RAYS_FROM_LASER_POINT)) if task.near_square > 0 else 0
    seeds = stream_seeds(task.seed, LightStream.FACTORISED_LIT, replicate, lasers)
    uv = scrambled_sobol(seeds, rays, 2).reshape(-1, 2)
    owner = np.repeat(lasers, rays)
    n1, x1 = task.points.normal[owner], task.points.position[owner]
    hits = task.caster.closest(x1 + task.caster.offset_m * n1, cosine_directions(n1, uv))
    part = np.where(hits.valid, task.scene.face_part[hits.face], 0).astype(np.int64)
    is_lit = hits.valid & (((hits.position - x1) ** 2).sum(axis=1) < task.near_square)
    vicinities = []
    for k, laser in enumerate(lasers):
        near = np.flatnonzero(is_lit[k * rays : (k + 1) * rays]) + k * rays
        vicinity = LaserVicinity(
            task.points.position[laser], task.points.normal[laser], task.points.to_laser[laser],
            int(task.points.part[laser]), float(task.points.leg[laser]), rays, task.near_square, hits.position[near],
            hits.normal[near], part[near],
        )  # fmt: skip
        vicinities.append(vicinity)
    return vicinities


def density_from(vicinity: LaserVicinity, lookins: Lookins) -> Floats:
    """Density per area with which cosine rays from the laser point meet each lookin."""
    u = lookins.position - vicinity.position
    cosines = (u @ vicinity.normal) * -np.einsum("nk,nk->n", u, lookins.normal)
    return np.asarray(np.maximum(cosines, 0.0) / (np.pi * (u**2).sum(axis=1) ** 2), np.float64)
