"""Footprint of a pixel on the wall as a tree: the whole, its quarters, their quarters …, each with its middle point.

If a pixel sees more than one surface, or past an edge, each of its finest footprints is represented by a point of a
(0, 2)-net instead of its middle. The error of areas on both sides of an edge is then nearly the inverse of the number
of points, even if the edge runs along their rows (Niederreiter, "Random Number Generation and Quasi-Monte Carlo
Methods" (1992), ch. 4).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from datagen.compiled import compiled
from datagen.records import Scene, Sensor
from datagen.records.arrays import Bools, Floats, Ints
from datagen.seeding import LightStream
from datagen.transport.fields_of_view import FovPool, PixelCones, fov_points
from datagen.transport.sampling import mix, scrambled_sobol, stream_seeds
from datagen.transport.visibility.raycast import Raycaster

BENT = 0.02
"""1 − cosine of the angle between two normals within a footprint from which on the footprint counts as uneven, about
11°. Half of it counts more footprints on curved surfaces as uneven, which are then quartered."""
FLAT = 1e-9
"""1 − cosine of an angle between normals that counts as none. It only has to be beyond rounding."""
LOOKS, MOST_LOOKS = range(1, 4), 1 << 16
"""Times that pixels may be quartered to find out whether they see an edge, and most lines of sight of all pixels
together, which decides between them: a small surface in one of many pixels is little light. Half of the second may
miss an edge in scans of many pixels."""


class Patches(NamedTuple):
    """Q = 1 + 4 + 16 + … footprints for each of P pixels.

    Attributes
    ----------
    position, normal, to_sensor : (P, Q, 3) of each footprint's middle: metres, unit normal and unit direction towards
        the sensor. Where the middle's line of sight meets nothing, the position is that of one of the quarters.
    part : (P, Q) part index, −1 where the middle's line of sight meets nothing.
    weight : (P, Q) effective aperture × solid angle × transmittance of air to the sensor, m² sr.
    most_weight : (P, Q) upper bound of the weight, if the footprint had that of any of its quarters in turn.
    footprint : (P, Q) area, m².
    leg : (P, Q) distance to the sensor, m.
    size : (P, Q) largest extent, m.
    across : (P, Q, 2, 3) vectors from side to side, along the pixel's two directions, m.
    uneven : (P, Q) whether some footprint within lies on another surface than the middle.
    bent : (P, Q) whether the surface at some footprint within is turned against the one at the middle.
    quarters : (Q, 4) indices of each footprint's quarters, −1 for the finest.
    fraction : (Q,) fraction of its pixel, 4^−level. With lobes, an element errs alike for all footprints of a pixel,
        so that it may make only this fraction of its error for each.
    """

    position: Floats
    normal: Floats
    to_sensor: Floats
    part: Ints
    weight: Floats
    most_weight: Floats
    footprint: Floats
    leg: Floats
    size: Floats
    across: Floats
    uneven: Bools
    bent: Bools
    quarters: Ints
    fraction: Floats

    @classmethod
    def of(
        cls, caster: Raycaster, scene: Scene, sensor: Sensor, cones: PixelCones, pixels: Ints, levels: int, seed: int
    ) -> Patches:
        """The footprints of the pixels with the given indices, quartered `levels` times."""

        def at(pixels: Ints, finest: Floats) -> Patches:
            """Footprints whose finest have the points `finest` (P, 4^levels, 2), in units of the pixel's sides."""
            places = [*(_middles(level, len(pixels)) for level in range(levels)), finest]
            pools = [fov_points(caster, scene, sensor, cones, pixels, uv, uv.shape[1]) for uv in places]
            corner = sensor.pixels[pixels] - sensor.position
            across = [
                _across(pool, corner, uv) / 2**k for k, (pool, uv) in enumerate(zip(pools, places, strict=True))
            ]
            return cls._joined(pools, np.concatenate(across, axis=1), _quarters(levels), scene.attenuation_per_m)

        patches = at(pixels, _middles(levels, len(pixels)))
        uneven = np.flatnonzero(patches.uneven[:, 0])
        if len(uneven):
            with_net = at(pixels[uneven], _net(levels, stream_seeds(seed, LightStream.PATCHES, pixels[uneven])))
            # The last two fields do not depend on the pixel.
            for values, of_net in zip(patches[:-2], with_net[:-2], strict=True):
                values[uneven] = of_net
        return patches

    @classmethod
    def _joined(cls, pools: list[FovPool], across: Floats, quarters: Ints, attenuation: float) -> Patches:
        """The footprints of all levels, from the points of each level and the vectors `across` (P, Q, 2, 3)."""
        position, normal, to_sensor, part, weight, footprint, leg = (
            np.concatenate([getattr(pool, name) for pool in pools], axis=1)
            for name in ("position", "normal", "to_sensor", "part", "weight", "footprint", "last_leg")
        )
        weight *= np.exp(-attenuation * np.where(part >= 0, leg, 0.0))
        most_weight = weight.copy()
        by_level = [slice((4**k - 1) // 3, (4 ** (k + 1) - 1) // 3) for k in range(len(pools) - 1)]
        # From the finest level upwards: each footprint takes over bounds and, if it has none, a position from below.
        for level in reversed(by_level):
            within = quarters[level]
            # A quarter has a quarter of the solid angle.
            most_weight[:, level] = np.maximum(most_weight[:, level], 4.0 * most_weight[:, within].max(axis=2))
            strongest = most_weight[:, within].argmax(axis=2)[..., None]
            stand_in = np.take_along_axis(within[None], strongest, axis=2)[..., 0]
            lost = part[:, level] < 0
            position[:, level][lost] = np.take_along_axis(position, stand_in[..., None], axis=1)[lost]
        inner = np.flatnonzero(quarters[:, 0] >= 0)
        below = quarters[inner]
        size = np.where(part >= 0, np.sqrt(2.0 * footprint), 0.0)
        apart = np.linalg.norm(position[:, below] - position[:, inner, None], axis=3)
        apart = np.where(most_weight[:, below] > 0, apart, 0.0).max(axis=2)
        # The middles of the quarters of a square are a quarter of its diagonal from its own middle. A size is never
        # zero, so that one may divide by it.
        size[:, inner] = np.maximum(size[:, inner], 4.0 * apart)
        size = np.maximum(size, 1e-9)
        uneven, bent = np.zeros((2, *part.shape), np.bool_)
        cosine = np.einsum("pqik,pqk->pqi", normal[:, below], normal[:, inner])
        other = (part[:, below] != part[:, inner, None]) | ((cosine < 1 - BENT) & (part[:, below] >= 0))
        uneven[:, inner] = other.any(axis=2)
        bent[:, inner] = ((cosine < 1 - FLAT) & (part[:, below] >= 0)).any(axis=2)
        # A footprint with an uneven quarter is uneven, too, and one with a bent quarter is bent.
        for level in reversed(by_level):
            for some in (uneven, bent):
                some[:, level] |= some[:, quarters[level]].any(axis=2)
        fraction = np.repeat([4.0**-level for level in range(len(pools))], [pool.part.shape[1] for pool in pools])
        return cls(
            position, normal, to_sensor, part, weight, most_weight, footprint, leg, size, across, uneven, bent,
            quarters, fraction,
        )  # fmt: skip


@compiled()
def finest_within(quarters, q, word):  # type: ignore[no-untyped-def]
    """Index of one of the finest footprints within footprint q, at random; q itself if it has no quarters.

    quarters : (Q, 4) as in `Patches`. word : random word.
    """
    while quarters[q, 0] >= 0:
        word = mix(word, np.uint64(q))
        q = quarters[q, np.int64(word & np.uint64(3))]
    return q


def at_edges(caster: Raycaster, scene: Scene, sensor: Sensor, cones: PixelCones) -> Bools:
    """(P,) whether a pixel sees more than one surface, or past the edge of one, along a grid of lines of sight."""
    pixels = np.arange(len(sensor.pixels))
    level = max((k for k in LOOKS if len(pixels) * 4**k <= MOST_LOOKS), default=LOOKS[0])
    places = _middles(level, len(pixels))
    pool, side = fov_points(caster, scene, sensor, cones, pixels, places, places.shape[1]), 1 << level
    part, normal = pool.part.reshape(-1, side, side), pool.normal.reshape(-1, side, side, 3)
    edge = (part != part[:, :1, :1]).any(axis=(1, 2)) | (part[:, 0, 0] < 0)
    # Neighbouring lines of sight whose surfaces are turned against each other meet on different faces.
    for one, other in ((normal[:, 1:], normal[:, :-1]), (normal[:, :, 1:], normal[:, :, :-1])):
        edge |= (np.einsum("prck,prck->prc", one, other) < 1 - BENT).any(axis=(1, 2))
    return np.asarray(edge)


def _middles(level: int, pixels: int) -> Floats:
    """(P, 4^level, 2) the middle of each footprint of a level, row by row, in units of the pixel's sides."""
    side = 1 << level
    knots = (np.arange(side) + 0.5) / side
    uv = np.stack([np.tile(knots, side), np.repeat(knots, side)], axis=1)
    return np.broadcast_to(uv, (pixels, side * side, 2)).copy()


def _across(pool: FovPool, corner: Floats, uv: Floats) -> Floats:
    """(P, Q, 2, 3) derivatives, by u and by v, of the point that a line of sight meets, metres; zero where it meets
    nothing.

    pool : the points. corner : (P, 4, 3) corners of the pixels, seen from the sensor, metres. uv : (P, Q, 2) where
    the lines of sight pass through their pixel.
    """
    u, v = uv[..., :1], uv[..., 1:]
    a, b, c, d = (corner[:, None, k] for k in range(4))
    line = (1 - v) * ((1 - u) * a + u * b) + v * ((1 - u) * d + u * c)
    moved = np.stack([(1 - v) * (b - a) + v * (c - d), (1 - u) * (d - a) + u * (c - b)], axis=2)
    steep = np.einsum("pqk,pqk->pq", pool.normal, line)
    seen = (pool.part >= 0) & (steep != 0)
    # The point slides along its plane: the part of the change that leaves the plane is made up along the line.
    slip = np.einsum("pqk,pqik->pqi", pool.normal, moved) / np.where(seen, steep, 1.0)[..., None]
    scale = np.where(seen, pool.last_leg / np.linalg.norm(line, axis=2), 0.0)
    return np.asarray(scale[..., None, None] * (moved - slip[..., None] * line[:, :, None]))


def _net(level: int, seeds: NDArray[np.uint64]) -> Floats:
    """(P, 4^level, 2) points of a net, one in each footprint of a level, row by row; one seed for each pixel."""
    side = 1 << level
    points = scrambled_sobol(seeds, side * side, 2)
    # A net has exactly one point in each footprint; they only have to be sorted.
    column, row = np.moveaxis((points * side).astype(np.int64), 2, 0)
    return np.take_along_axis(points, np.argsort(row * side + column, axis=1)[..., None], axis=1)


def _quarters(levels: int) -> Ints:
    """(Q, 4) indices of the quarters of each footprint, row by row; −1 at the last level."""
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
