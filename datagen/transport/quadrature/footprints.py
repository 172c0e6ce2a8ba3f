"""Footprint of a pixel on the wall as a tree: the whole, its quarters, their quarters …, each with its middle point.

Where a pixel sees more than one surface, or past an edge, the finest footprints have a point of a (0, 2)-net each
instead of their middle: areas on both sides of an edge are then right to nearly the inverse of the number of points,
also where the edge runs along their rows (Niederreiter, "Random Number Generation and Quasi-Monte Carlo Methods"
(1992), ch. 4).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from datagen.records import Scene, Sensor
from datagen.records.arrays import Bools, Floats, Ints
from datagen.seeding import LightStream
from datagen.transport.fields_of_view import FovPool, PixelCones, fov_points
from datagen.transport.sampling import scrambled_sobol, stream_seeds
from datagen.transport.visibility.raycast import Raycaster

BENT = 0.02
"""1 − cosine of the angle between the normals of a footprint and of its quarters from which it counts as uneven."""
LEAST_SIZE = 1e-9
"""Least size of a footprint, metres, so that one may divide by it."""
LOOKS, MOST_LOOKS = range(1, 4), 1 << 16
"""Times that pixels are quartered to find out whether they hold an edge: as many as need at most this number of lines
of sight for all pixels, for a small piece in one of many pixels is little light."""


class Patches(NamedTuple):
    """Q = 1 + 4 + 16 + … footprints for each of P pixels.

    Attributes
    ----------
    position, normal, to_sensor : (P, Q, 3) of the middle: metres, unit normal and unit direction towards the sensor.
        Where its line of sight meets nothing, that of one of its quarters.
    part : (P, Q) part index, −1 where the line of sight meets nothing.
    weight : (P, Q) effective aperture × solid angle, m² sr, and what air leaves on the way to the sensor.
    most : (P, Q) what that is at most in any footprint within it, for as much of the pixel.
    footprint : (P, Q) its area, m².
    leg : (P, Q) distance to the sensor, m.
    size : (P, Q) how far it reaches, m.
    across : (P, Q, 2, 3) from side to side of it, along the pixel's two directions, m.
    uneven : (P, Q) whether its quarters lie on other surfaces than its middle.
    quarters : (Q, 4) footprints, −1 for the finest.
    share : (Q,) of its pixel, 4^−level: how much of the error that an element may make it may make seen from there,
        for what it is wrong by for one footprint it is wrong by for the next.
    """

    position: Floats
    normal: Floats
    to_sensor: Floats
    part: Ints
    weight: Floats
    most: Floats
    footprint: Floats
    leg: Floats
    size: Floats
    across: Floats
    uneven: Bools
    quarters: Ints
    share: Floats

    @classmethod
    def of(
        cls, caster: Raycaster, scene: Scene, sensor: Sensor, cones: PixelCones, pixels: Ints, levels: int, seed: int
    ) -> Patches:
        """The footprints of some pixels, quartered at most `levels` times."""

        def at(pixels: Ints, finest: Floats) -> Patches:
            places = [*(_middles(level, len(pixels)) for level in range(levels)), finest]
            pools = [fov_points(caster, scene, sensor, cones, pixels, uv, uv.shape[1]) for uv in places]
            corner = sensor.pixels[pixels] - sensor.position
            across = [
                _across(pool, corner, uv) / 2**k for k, (pool, uv) in enumerate(zip(pools, places, strict=True))
            ]
            return cls._joined(pools, np.concatenate(across, axis=1), _quarters(levels), scene.attenuation_per_m)

        patches = at(pixels, _middles(levels, len(pixels)))
        at_edges = np.flatnonzero(patches.uneven[:, 0])
        if len(at_edges):
            several = at(pixels[at_edges], _net(levels, stream_seeds(seed, LightStream.PATCHES, pixels[at_edges])))
            for ours, theirs in zip(patches[:-2], several[:-2], strict=True):
                ours[at_edges] = theirs
        return patches

    @classmethod
    def _joined(cls, pools: list[FovPool], across: Floats, quarters: Ints, attenuation: float) -> Patches:
        position, normal, to_sensor, part, weight, footprint, leg = (
            np.concatenate([getattr(pool, name) for pool in pools], axis=1)
            for name in ("position", "normal", "to_sensor", "part", "weight", "footprint", "last_leg")
        )
        weight *= np.exp(-attenuation * np.where(part >= 0, leg, 0.0))
        most = weight.copy()
        by_level = [slice((4**k - 1) // 3, (4 ** (k + 1) - 1) // 3) for k in range(len(pools) - 1)]
        for level in reversed(by_level):
            within = quarters[level]
            most[:, level] = np.maximum(most[:, level], 4.0 * most[:, within].max(axis=2))
            stand_in = np.take_along_axis(within[None], most[:, within].argmax(axis=2)[..., None], axis=2)[..., 0]
            lost = part[:, level] < 0
            position[:, level][lost] = np.take_along_axis(position, stand_in[..., None], axis=1)[lost]
        inner = np.flatnonzero(quarters[:, 0] >= 0)
        below = quarters[inner]
        size = np.where(part >= 0, np.sqrt(2.0 * footprint), 0.0)
        apart = np.linalg.norm(position[:, below] - position[:, inner, None], axis=3)
        apart = np.where(most[:, below] > 0, apart, 0.0).max(axis=2)
        size[:, inner] = np.maximum(size[:, inner], 4.0 * apart)
        size = np.maximum(size, LEAST_SIZE)
        uneven = np.zeros(part.shape, np.bool_)
        cosine = np.einsum("pqik,pqk->pqi", normal[:, below], normal[:, inner])
        other = (part[:, below] != part[:, inner, None]) | ((cosine < 1 - BENT) & (part[:, below] >= 0))
        uneven[:, inner] = other.any(axis=2)
        # A footprint that is even but whose quarters are not, is not; level by level, the last first.
        for level in reversed(by_level):
            uneven[:, level] |= uneven[:, quarters[level]].any(axis=2)
        share = np.repeat([4.0**-level for level in range(len(pools))], [pool.part.shape[1] for pool in pools])
        return cls(
            position, normal, to_sensor, part, weight, most, footprint, leg, size, across, uneven, quarters, share
        )


def at_edges(caster: Raycaster, scene: Scene, sensor: Sensor, cones: PixelCones) -> Bools:
    """(P,) whether a pixel sees more than one surface, or past the edge of one, along a grid of lines of sight."""
    pixels = np.arange(len(sensor.pixels))
    level = max((k for k in LOOKS if len(pixels) * 4**k <= MOST_LOOKS), default=LOOKS[0])
    places = _middles(level, len(pixels))
    pool, side = fov_points(caster, scene, sensor, cones, pixels, places, places.shape[1]), 1 << level
    part, normal = pool.part.reshape(-1, side, side), pool.normal.reshape(-1, side, side, 3)
    found = (part != part[:, :1, :1]).any(axis=(1, 2)) | (part[:, 0, 0] < 0)
    for one, other in ((normal[:, 1:], normal[:, :-1]), (normal[:, :, 1:], normal[:, :, :-1])):
        found |= (np.einsum("prck,prck->prc", one, other) < 1 - BENT).any(axis=(1, 2))
    return np.asarray(found)


def _middles(level: int, pixels: int) -> Floats:
    """(P, 4^level, 2) the middle of each footprint, row by row."""
    side = 1 << level
    knots = (np.arange(side) + 0.5) / side
    uv = np.stack([np.tile(knots, side), np.repeat(knots, side)], axis=1)
    return np.broadcast_to(uv, (pixels, side * side, 2)).copy()


def _across(pool: FovPool, corner: Floats, uv: Floats) -> Floats:
    """(P, Q, 2, 3) derivatives, by u and by v, of the place that a line of sight meets, metres; zero where it meets
    nothing. corner : (P, 4, 3) corners of the pixels from the sensor. uv : (P, Q, 2) of the lines of sight."""
    u, v = uv[..., :1], uv[..., 1:]
    a, b, c, d = (corner[:, None, k] for k in range(4))
    line = (1 - v) * ((1 - u) * a + u * b) + v * ((1 - u) * d + u * c)
    moved = np.stack([(1 - v) * (b - a) + v * (c - d), (1 - u) * (d - a) + u * (c - b)], axis=2)
    steep = np.einsum("pqk,pqk->pq", pool.normal, line)
    seen = (pool.part >= 0) & (steep != 0)
    slip = np.einsum("pqk,pqik->pqi", pool.normal, moved) / np.where(seen, steep, 1.0)[..., None]
    scale = np.where(seen, pool.last_leg / np.linalg.norm(line, axis=2), 0.0)
    return np.asarray(scale[..., None, None] * (moved - slip[..., None] * line[:, :, None]))


def _net(level: int, seeds: NDArray[np.uint64]) -> Floats:
    """(P, 4^level, 2) points of a net, one in each footprint, row by row; one seed a pixel."""
    side = 1 << level
    points = scrambled_sobol(seeds, side * side, 2)
    column, row = np.moveaxis((points * side).astype(np.int64), 2, 0)
    return np.take_along_axis(points, np.argsort(row * side + column, axis=1)[..., None], axis=1)


def _quarters(levels: int) -> Ints:
    """(Q, 4) the four footprints of the next level within each, row by row; −1 at the last."""
    first = [(4**level - 1) // 3 for level in range(levels + 2)]
    quarters = np.full((first[-1], 4), -1)
    for level in range(levels):
        side = 1 << level
        row, column = np.divmod(np.arange(side * side), side)
        for k, (down, right) in enumerate(((0, 0), (0, 1), (1, 0), (1, 1))):
            quarters[first[level] : first[level + 1], k] = (
                first[level + 1] + (2 * row + down) * 2 * side + 2 * column + right
            )
    return quarters
