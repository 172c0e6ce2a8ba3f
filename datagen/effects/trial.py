"""The trial run: the same transport at a fiftieth of its cost, to see how much of the light has how many bounces.

Two independent runs a and b of a few laser points and pixels, by one call where it tells them apart: small runs cost
little beside their preparation. A component x is compared with T, all light of three bounces and more, by

    ‖(x_a + x_b)/2‖ / √(T_a · T_b),

where the noise of the runs adds to the numerator and cancels, on average, in the denominator: few samples overrate a
component, never the whole. The direct return is no part of T, although it is of the transient: it may be 10⁴ times as
bright as all the rest, which a gate then lets through alone. Nor does a trial run follow it: it comes by few pairs of
laser points and pixels, and a bound tells (`scene_figures.py`). What the choice of channels leaves uncertain is
added as three standard errors (jackknife over channels).

Channels in even steps would not do: every 8th of 16 × 16 laser points are two of the 16 columns, and every 8th of
8 × 8 pixels one other column, which never looks at any of them. So places are chosen by where they are: each as far
from those before it as can be (farthest-point sampling; Gonzalez, Theoretical Computer Science 38 (1985)), which
takes the outermost first and leaves no gap; and half of them among the laser points that lie in a pixel, and the
pixels that a chosen laser point lies in. Where there is no such pair, those that come nearest to one are taken.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from datagen.records import Accuracy, Capture, Scene
from datagen.records.arrays import Floats, Ints
from datagen.transport import transient_of
from datagen.transport.error_control.cost import BIN, CALL, RAY
from datagen.transport.fields_of_view import PixelCones
from datagen.transport.path_tracing.vertices import LaserPoints
from datagen.transport.visibility.raycast import Raycaster

SHARE = 0.02
"""Share of the transport's cost that a trial run may take."""
LARGEST_SHARE = 0.1
"""Share above which the smallest trial run is not worth its cost: then nothing is measured."""
OVERHEAD = 60_000.0
"""What a call costs whatever its size, in shadow rays: the scene is prepared, each order is traced for few walks."""
FEWEST_WALKS, MOST_WALKS = 512, 4096
"""Walks of one of the two runs, all channels together."""
LASERS, PIXELS = 32, 8
"""Most laser points, and most pixels of each (exhaustive pairing)."""
COMPONENTS = 3
"""Primary, secondary and higher light."""
MOST_ORDERS = 8
"""Bounces that count for the cost: of longer paths few are left."""
BINS = 512
"""Bins, at most, for the norm of the whole: fewer and wider ones make it smaller, never larger."""
VALUES = 1 << 22
"""Most histogram values of a run."""
MOST_UNSEEN = 3.0
"""Paths of a kind that are expected, at most, where none was seen: seeing none of so many has a chance of 5 %."""


@dataclass(frozen=True)
class Trial:
    """Two runs: name of a component → (2, channel, bin) photons per emitted photon.

    pixels : channels that share their walks, as all pixels of a laser point do.
    """

    components: Mapping[str, NDArray[np.float64]]
    pixels: int = 1

    @property
    def dark(self) -> bool:
        """Whether neither run found any light."""
        return not any(component.any() for component in self.components.values())

    def share(self, name: str) -> float | None:
        """Upper estimate of ‖x‖ / ‖T‖ for a component x, at most 1; None where T is lost in noise.

        Of a component that no path was seen of, among n that were, 3/n may still be there: a run that hardly met any
        light says nothing about the rest.
        """
        x = self.components.get(name)
        if x is None:
            return 0.0
        total = sum(self.components.values(), start=np.zeros_like(x))
        wide = -(-total.shape[2] // BINS)
        padded = np.pad(total, ((0, 0), (0, 0), (0, -total.shape[2] % wide)))
        coarse = padded.reshape(*padded.shape[:2], -1, wide).sum(axis=3)
        above = np.square(x.mean(axis=0)).sum(axis=1)
        below = (coarse[0] * coarse[1]).sum(axis=1) / wide
        if below.sum() <= 0:
            return None
        if not x.any():
            return min(MOST_UNSEEN * self.pixels / np.count_nonzero(total), 1.0)
        square = above.sum() / below.sum()
        # Nothing that is left out makes up more than the whole.
        return min(float(np.sqrt(square + 3 * _jackknife(above, below, square))), 1.0)


def _jackknife(above: NDArray[np.float64], below: NDArray[np.float64], ratio: float) -> float:
    """Standard error of Σ above / Σ below over independent channels; of few channels as much as the ratio itself."""
    n = len(above)
    if n < 4:
        return ratio
    rest = below.sum() - below
    if (rest <= 0).any():
        return ratio
    without = (above.sum() - above) / rest
    return float(np.sqrt((n - 1) / n * np.square(without - without.mean()).sum()))


def affordable(capture: Capture, accuracy: Accuracy) -> bool:
    """Whether the smallest trial run costs no more than `LARGEST_SHARE` of the transport; with a target, always."""
    if accuracy.target is not None:
        return True
    return _Size.of(capture, FEWEST_WALKS).cost(capture, accuracy) <= LARGEST_SHARE * _cost(capture, accuracy)


@dataclass(frozen=True)
class _Size:
    """How large a trial run is: laser points and pixels of each run, histogram entries of each of them, and walks.

    at_once : whether both runs are made by one call, in which the capture is there twice over.
    """

    lasers: int
    pixels: int
    entries: int
    walks: int
    at_once: bool

    @classmethod
    def of(cls, capture: Capture, walks: int) -> _Size:
        lasers, (_, pixels, bins) = len(capture.laser.targets), capture.shape
        entries = bins * COMPONENTS
        channels = int(np.clip(VALUES // entries, 1, LASERS * PIXELS))
        seen = min(pixels, PIXELS, channels)
        lit = min(lasers, LASERS, max(channels // seen, 1))
        # Of L laser points and P pixels twice over, 2 L P pairs are of one copy with the other. Flood illumination
        # gives the mean over laser points, so that its copies cannot be told apart.
        idle = 0 if capture.pairing == "confocal" else 2 * lit * seen * entries
        return cls(lit, seen, entries, walks, capture.illumination == "scan" and BIN * idle <= OVERHEAD)

    def cost(self, capture: Capture, accuracy: Accuracy) -> float:
        """In the units of `_cost`, for each order."""
        orders = min(accuracy.max_bounces or MOST_ORDERS, MOST_ORDERS) - 2
        copies = 2 if self.at_once and capture.pairing != "confocal" else 1
        calls = OVERHEAD * (1 if self.at_once else 2) + 2 * copies * BIN * self.lasers * self.pixels * self.entries
        return calls / orders + 2 * self.walks * (RAY + copies * self.pixels)


def run_trial(
    scene: Scene, capture: Capture, accuracy: Accuracy, seed: int, caster: Raycaster | None = None
) -> Trial:
    """Simulate a few channels of the capture twice, all bounce orders from the third."""
    budget = MOST_WALKS
    if accuracy.target is None:
        budget = int(SHARE * _cost(capture, accuracy) / (2 * (RAY + min(capture.shape[1], PIXELS))))
    size = _Size.of(capture, int(np.clip(budget, FEWEST_WALKS, MOST_WALKS)))
    few = replace(few_samples(accuracy, max(size.walks // size.lasers, 1)), direct=False)
    caster = Raycaster(scene) if caster is None else caster
    points = LaserPoints.of(caster, scene, capture.laser)
    lasers, pixels = trial_channels(capture, points, size.lasers, size.pixels)
    copies = 2 if size.at_once else 1
    twice = capture.excerpt(np.tile(lasers, copies), np.tile(pixels, copies))
    made = [transient_of(scene, twice, few, seed=seed, split_parts=False, caster=caster)]
    # The factorised form shares its points between laser points, whose noise is then no longer their own.
    if not size.at_once or (made[0].spend is not None and "factorised" in "".join(made[0].spend.way.values())):
        once = capture.excerpt(lasers, pixels)
        again = (seed + 1) % 2**64
        made.append(transient_of(scene, once, few, seed=again, split_parts=False, caster=caster))
    shape = capture.excerpt(lasers, pixels).shape[:2]
    return Trial(_paired([run.components for run in made], shape), shape[1])


def few_samples(accuracy: Accuracy, lookins: int) -> Accuracy:
    """The accuracy of a trial run: so many lookins, and one of every other sample."""
    secondary: Literal["none", "all"] = "none" if accuracy.secondary == "none" else "all"
    kept = {"max_bounces": accuracy.max_bounces, "direct": accuracy.direct, "occlusion": accuracy.occlusion}
    return Accuracy(lookins=lookins, fov_samples=1, replicates=1, secondary=secondary, **kept)  # type: ignore[arg-type]


def _paired(runs: list[Mapping[str, NDArray[np.float64]]], shape: tuple[int, int]) -> dict[str, NDArray[np.float64]]:
    """Two runs of `shape` laser points and pixels: the first of the first arrays, and the last of the last."""
    lasers, pixels = shape

    def pair(name: str) -> NDArray[np.float64]:
        corners = runs[0][name][:lasers, :pixels], runs[-1][name][-lasers:, -pixels:]
        return np.stack([corner.reshape(-1, corner.shape[2]) for corner in corners])

    return {name: pair(name) for name in runs[0]}


def _cost(capture: Capture, accuracy: Accuracy) -> float:
    """Cost of the transport in units of a shadow ray, for each order; see `transport/error_control/cost.py`."""
    lasers, pixels = len(capture.laser.targets), capture.shape[1]
    return lasers * accuracy.lookins * (RAY + pixels * accuracy.fov_samples) + CALL * accuracy.replicates


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
