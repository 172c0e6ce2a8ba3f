"""The trial run: the transport at a fiftieth of its cost, which measures how much of the light has how many bounces.

It consists of two independent runs a and b for a few channels (pairs of laser point and pixel). One call makes both
if it can tell them apart, for small runs cost little beside their preparation. A component x is compared with T, all
light of three bounces and more, by

    ‖(x_a + x_b)/2‖ / √(T_a · T_b).

The noise of the runs adds to the numerator and cancels, on average, in the denominator, so few samples may overrate a
component but never the whole. The uncertainty that comes from the choice of channels is added as three standard
errors (jackknife over channels).
The direct return is no part of T, although it is part of the transient: it may be 10⁴ times as bright as all other
light, which a gate then lets through alone. The trial run does not simulate it either, because few channels have a
direct return; a bound decides on it (`scene_figures.py`).

Channels in regular steps would not do: every 8th of 16 × 16 laser points are two of the 16 columns, and every 8th of
8 × 8 pixels one other column, which never looks at any of them. Therefore places are chosen by farthest-point
sampling (Gonzalez, Theoretical Computer Science 38 (1985)), each as far as possible from those chosen before. Half of
them are chosen among the laser points that lie in a pixel, and among the pixels in which a chosen laser point lies;
if there are none, those that come nearest to it are taken.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from datagen.records import Accuracy, Capture, Scene
from datagen.records.arrays import Floats, Ints
from datagen.transport import transient_of
from datagen.transport.error_control.cost import BIN, CALL, RAY
from datagen.transport.fields_of_view import PixelCones
from datagen.transport.path_tracing.vertices import LaserPoints
from datagen.transport.visibility.raycast import Raycaster

SHARE = 0.02
"""Share of the transport's cost that a trial run may take. Halved, its estimates are noisier and leave out less."""
LARGEST_SHARE = 0.1
"""Share of the cost above which no trial run is made. Halved, more small transports have all effects."""
OVERHEAD = 60_000.0
"""Fixed cost of a call, in shadow rays: preparing the scene, and tracing each order for few paths. Halved, two calls
are made where one would be cheaper."""
FEWEST_PATHS, MOST_PATHS = 512, 4096
"""Paths of each of the two runs, all channels together. With half as many the noise is 1.4 times as large."""
LASERS, PIXELS = 32, 8
"""Most laser points, and most pixels of each. With half as many the error of the choice is 1.4 times as large."""
COMPONENTS = 3
"""Primary, secondary and higher light."""
MOST_ORDERS = 8
"""Most bounces that count for the cost, as few paths are longer. Halved, the cost of long paths is underrated."""
BINS = 512
"""Most bins for the norm of the whole; longer time axes are rebinned to wider ones, which makes the norm smaller,
never larger. Halved, components are overrated more."""
VALUES = 1 << 22
"""Most histogram values of a run, 32 MB. Halved, long time axes leave room for half the channels."""
MOST_UNSEEN = 3.0
"""Number of paths of a component that may be missing if none was seen: seeing none of 3 expected ones has a
probability of 5 %. Halved, of 22 %."""


@dataclass(frozen=True)
class Trial:
    """The light of both runs.

    components : name of a component → (2, channel, bin) photons at the aperture per emitted photon.
    pixels : number of channels that share their paths, as all pixels of a laser point do.
    """

    components: Mapping[str, Floats]
    pixels: int = 1

    @property
    def dark(self) -> bool:
        """Whether neither run found any light."""
        return not any(component.any() for component in self.components.values())

    def share(self, name: str) -> float | None:
        """Upper estimate of ‖x‖ / ‖T‖ for a component x, at most 1; None if T is lost in noise.

        If none of n paths belongs to the component, its share may still be 3/n: a run that met hardly any light says
        little about a component.
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
        # A component is never more than the whole.
        return min(float(np.sqrt(square + 3 * _jackknife(above, below, square))), 1.0)


def _jackknife(above: Floats, below: Floats, ratio: float) -> float:
    """Standard error of Σ above / Σ below over independent channels; the ratio itself if there are under four."""
    n = len(above)
    if n < 4:
        return ratio
    rest = below.sum() - below
    if (rest <= 0).any():
        return ratio
    without = (above.sum() - above) / rest
    return float(np.sqrt((n - 1) / n * np.square(without - without.mean()).sum()))


def affordable(capture: Capture, accuracy: Accuracy) -> bool:
    """Whether the smallest trial run costs at most `LARGEST_SHARE` of the transport; always true with a target."""
    if accuracy.target is not None:
        return True
    return _Size.of(capture, FEWEST_PATHS).cost(capture, accuracy) <= LARGEST_SHARE * _cost(capture, accuracy)


@dataclass(frozen=True)
class _Size:
    """The size of a trial run: laser points, pixels and paths of each run, and histogram entries of each channel.

    at_once : whether one call makes both runs, with a capture that holds the channels twice.
    """

    lasers: int
    pixels: int
    entries: int
    paths: int
    at_once: bool

    @classmethod
    def of(cls, capture: Capture, paths: int) -> _Size:
        """The size of a trial run of so many paths."""
        lasers, (_, pixels, bins) = len(capture.laser.targets), capture.shape
        entries = bins * COMPONENTS
        channels = int(np.clip(VALUES // entries, 1, LASERS * PIXELS))
        seen = min(pixels, PIXELS, channels)
        lit = min(lasers, LASERS, max(channels // seen, 1))
        # With L laser points and P pixels there twice, 2 L P pairs are between different copies and of no use. Flood
        # illumination gives the mean over laser points, which cannot be separated into copies.
        idle = 0 if capture.pairing == "confocal" else 2 * lit * seen * entries
        return cls(lit, seen, entries, paths, capture.illumination == "scan" and BIN * idle <= OVERHEAD)

    def cost(self, capture: Capture, accuracy: Accuracy) -> float:
        """Cost of the trial run in the units of `_cost`."""
        orders = min(accuracy.max_bounces or MOST_ORDERS, MOST_ORDERS) - 2
        copies = 2 if self.at_once and capture.pairing != "confocal" else 1
        calls = OVERHEAD * (1 if self.at_once else 2) + 2 * copies * BIN * self.lasers * self.pixels * self.entries
        return calls / orders + 2 * self.paths * (RAY + copies * self.pixels)


def run_trial(
    scene: Scene, capture: Capture, accuracy: Accuracy, seed: int, caster: Raycaster | None = None
) -> Trial:
    """Two independent simulations of a few channels of the capture, with all orders from three bounces on."""
    budget = MOST_PATHS
    if accuracy.target is None:
        budget = int(SHARE * _cost(capture, accuracy) / (2 * (RAY + min(capture.shape[1], PIXELS))))
    size = _Size.of(capture, int(np.clip(budget, FEWEST_PATHS, MOST_PATHS)))
    few = replace(few_samples(accuracy, max(size.paths // size.lasers, 1)), direct=False)
    caster = Raycaster(scene) if caster is None else caster
    points = LaserPoints.of(caster, scene, capture.laser)
    lasers, pixels = trial_channels(capture, points, size.lasers, size.pixels)
    copies = 2 if size.at_once else 1
    twice = capture.excerpt(np.tile(lasers, copies), np.tile(pixels, copies))
    runs = [transient_of(scene, twice, few, seed=seed, split_parts=False, caster=caster)]
    # The factorised form shares its points between laser points, so the copies in one call are not independent.
    if not size.at_once or (runs[0].spend is not None and "factorised" in "".join(runs[0].spend.way.values())):
        once = capture.excerpt(lasers, pixels)
        again = (seed + 1) % 2**64
        runs.append(transient_of(scene, once, few, seed=again, split_parts=False, caster=caster))
    shape = capture.excerpt(lasers, pixels).shape[:2]
    return Trial(_paired([run.components for run in runs], shape), shape[1])


def few_samples(accuracy: Accuracy, samples: int) -> Accuracy:
    """The accuracy of a trial run: so many hidden vertices, and one of every other kind of sample."""
    secondary: Literal["none", "all"] = "none" if accuracy.secondary == "none" else "all"
    kept = {"max_bounces": accuracy.max_bounces, "direct": accuracy.direct, "occlusion": accuracy.occlusion}
    return Accuracy(lookins=samples, fov_samples=1, replicates=1, secondary=secondary, **kept)  # type: ignore[arg-type]


def _paired(runs: list[Mapping[str, Floats]], shape: tuple[int, int]) -> dict[str, Floats]:
    """Component → (2, channel, bin) light of two runs of `shape` laser points and pixels.

    The first run lies in the first rows and columns of the first arrays, the second in the last of the last arrays.
    """
    lasers, pixels = shape

    def pair(name: str) -> Floats:
        corners = runs[0][name][:lasers, :pixels], runs[-1][name][-lasers:, -pixels:]
        return np.stack([corner.reshape(-1, corner.shape[2]) for corner in corners])

    return {name: pair(name) for name in runs[0]}


def _cost(capture: Capture, accuracy: Accuracy) -> float:
    """Cost of one order of the transport, in shadow rays; see `transport/error_control/cost.py`."""
    lasers, pixels = len(capture.laser.targets), capture.shape[1]
    return lasers * accuracy.lookins * (RAY + pixels * accuracy.fov_samples) + CALL * accuracy.replicates


PAIRS_AT_ONCE = 1 << 20
"""Pairs of laser points and pixels in one call of numpy: 100 MB of intermediate arrays. Halved, half of that."""
AS_FAR = 1e-9
"""Distances that agree to this share of the largest count as equal, and the lower number goes first: on a regular
grid ties are the rule, and rounding, which differs between processors, must not decide them. Halved, it does not
either."""
INSIDE = -1e-9
"""Least sine of the angle to the nearest side of a pixel at which a laser point counts as inside, so that points on
an edge do. Halved, they still do."""


def trial_channels(capture: Capture, points: LaserPoints, lasers: int, pixels: int) -> tuple[Ints, Ints]:
    """Numbers, ascending, of at most `lasers` laser points and `pixels` pixels of a capture.

    Laser points whose ray meets nothing are chosen only if there are no others. In confocal pairing the numbers of
    the pixels have no meaning, as each laser point has its own pixel.
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
    """(L,) depth of each direction `span` (L, 3) inside the pixel in which it lies deepest, and (P,) depth of the
    direction that lies deepest in each pixel: the sine of the angle to the nearest side, below 0 outside."""
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
    """Numbers of `count` of the places (n, 3), half of which have a counterpart (depth ≥ 0) or come nearest to it."""
    count = min(count, len(place))
    half = -(-count // 2)
    paired = np.flatnonzero(depth >= INSIDE)
    if len(paired) >= half:
        first = paired[_spread_out(place[paired], half)]
    else:
        first = np.argsort(-np.rint(depth / AS_FAR), kind="stable")[:half]
    return _spread_out(place, count, first)


def _spread_out(place: Floats, count: int, first: Ints | None = None) -> Ints:
    """Numbers, ascending, of `count` of the places (n, 3), or of all if they are fewer.

    They are `first`, and then in each step the place farthest from those chosen before; without `first` the place
    farthest from the middle of all comes first.
    """
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
        # The distance from the middle decides the first place only.
        nearest = distance(k) if not chosen else np.minimum(nearest, distance(k))
        chosen.append(k)
    return np.sort(np.array(chosen, np.int64))
