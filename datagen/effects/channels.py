"""Which laser points and pixels a trial run looks at, so that it can see whatever the whole capture sees.

Numbers in even steps do not do: every 8th of 16 × 16 laser points are two of the 16 columns, and every 8th of 8 × 8
pixels one other column, which never looks at any of them. So places are chosen by where they are: each as far from
those before it as can be (farthest-point sampling; Gonzalez, Theoretical Computer Science 38 (1985)), which takes the
outermost first and leaves no gap; and half of them among the laser points that lie in a pixel, and the pixels that a
laser point chosen lies in. Where there is no such pair, those that come nearest to one are taken.
"""

from __future__ import annotations

import numpy as np

from datagen.records import Capture
from datagen.records.arrays import Floats, Ints
from datagen.transport.fov import PixelCones
from datagen.transport.vertices import LaserPoints

PAIRS_AT_ONCE = 1 << 20
"""Pairs of laser points and pixels looked at in one call of numpy: 100 MB of intermediate arrays."""
AS_FAR = 1e-9
"""Distances that agree to this share of the largest are one and the same: on a regular grid ties are the rule, and
rounding, which differs between processors, is not to decide them. The lower number goes first."""
INSIDE = -1e-9
"""How deep (sine of the angle to the nearest side) a laser point on a pixel's edge lies inside of it, at least."""


def trial_channels(capture: Capture, points: LaserPoints, lasers: int, pixels: int) -> tuple[Ints, Ints]:
    """Numbers of at most so many laser points and pixels of a capture; both in rising order.

    Laser points that are not there (a ray that meets nothing) are chosen only where there is no other. Confocal
    pixels go with their laser points, whatever numbers of pixels are returned.
    """
    there = np.flatnonzero(points.part >= 0)
    if not len(there):
        there = np.arange(len(points.part))
        place = np.asarray(capture.laser.targets)
    else:
        place = points.position[there]
    if capture.pairing == "confocal":
        return there[_spread_out(place, lasers)], np.arange(min(pixels, len(capture.sensor.pixels)))
    sensor = capture.sensor
    cones = PixelCones.of(sensor)
    lit = there[_paired_and_spread(place, _depth(cones, place - sensor.position)[0], lasers)]
    seen = sensor.pixels.mean(axis=1) - sensor.position
    chosen = place[np.searchsorted(there, lit)]
    deepest = _depth(cones, chosen - sensor.position)[1]
    return lit, _paired_and_spread(seen / np.linalg.norm(seen, axis=1, keepdims=True), deepest, pixels)


def _depth(cones: PixelCones, span: Floats) -> tuple[Floats, Floats]:
    """How deep each of some directions (L, 3) lies inside the pixel that holds it, or comes nearest to (L,), and how
    deep the deepest of them lies in each pixel (P,): the sine of the angle to the nearest side, below 0 outside."""
    planes = cones.planes / np.linalg.norm(cones.planes, axis=2, keepdims=True)
    span = span / np.linalg.norm(span, axis=1, keepdims=True)
    of_laser, of_pixel = np.empty(len(span)), np.full(len(planes), -np.inf)
    step = max(PAIRS_AT_ONCE // len(planes), 1)
    for start in range(0, len(span), step):
        depth = np.einsum("psk,lk->lps", planes, span[start : start + step]).min(axis=2)
        of_laser[start : start + step] = depth.max(axis=1)
        of_pixel = np.maximum(of_pixel, depth.max(axis=0))
    return of_laser, of_pixel


def _paired_and_spread(place: Floats, depth: Floats, count: int) -> Ints:
    """`count` of some places (n, 3), half of them with a counterpart (depth ≥ 0) or next to having one."""
    count = min(count, len(place))
    half = -(-count // 2)
    paired = np.flatnonzero(depth >= INSIDE)
    if len(paired) >= half:
        first = paired[_spread_out(place[paired], half)]
    else:
        first = np.argsort(-np.rint(depth / AS_FAR), kind="stable")[:half]
    return _spread_out(place, count, first)


def _spread_out(place: Floats, count: int, first: Ints | None = None) -> Ints:
    """Numbers of `count` of some places (n, 3), or of all, in rising order: `first`, then always that which is
    farthest from those chosen before it; without `first`, from the middle of all."""
    count = min(count, len(place))
    middle = place.mean(axis=0)
    unit = float(np.linalg.norm(place - middle, axis=1).max()) or 1.0

    def distance(k: int | None) -> Floats:
        far = np.linalg.norm(place - (middle if k is None else place[k]), axis=1)
        return np.asarray(np.rint(far / (AS_FAR * unit)))

    chosen = [] if first is None else [int(k) for k in first]
    nearest = distance(None) if not chosen else np.full(len(place), np.inf)
    for k in chosen:
        nearest = np.minimum(nearest, distance(k))
    while len(chosen) < count:
        free = nearest.copy()
        free[chosen] = -1.0
        k = int(free.argmax())
        # The distance from the middle chooses the first alone.
        nearest = distance(k) if not chosen else np.minimum(nearest, distance(k))
        chosen.append(k)
    return np.sort(np.array(chosen, np.int64))
