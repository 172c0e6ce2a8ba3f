"""The trial run: the transport at a fiftieth of its cost, which measures how much of the light has how many bounces.

By plain paths, which share nothing with the samplers whose orders it decides about. It consists of two independent
runs a and b for a few channels (pairs of laser point and pixel). A component x is compared with T, all light of three
bounces and more, by

    ‖(x_a + x_b)/2‖ / √(T_a · T_b).

The noise of the runs adds to the numerator and cancels, on average, in the denominator, so few samples may overrate a
component but never the whole. The uncertainty that comes from the choice of channels is added as three standard
errors (jackknife over channels).
The direct return is no part of T, although it is part of the transient: it may be 10⁴ times as bright as all other
light, which a gate then lets through alone. The trial run does not simulate it either, because few channels have a
direct return; a bound decides on it (`transport_effects.py`).

Channels in regular steps would not do: every 8th of 16 × 16 laser points are two of the 16 columns. They are chosen
by farthest-point sampling (Gonzalez, Theoretical Computer Science 38 (1985)).
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from datagen.records import Accuracy, Capture, Scene
from datagen.records.arrays import Floats, Ints
from datagen.transport import transient_of
from datagen.transport.laser_points import LaserPoints
from datagen.transport.rays import Raycaster

SHARE = 0.02
"""Share of the transport's cost that a trial run may take: with less its estimates are noisier and leave out less."""
LARGEST_SHARE = 0.1
"""Share of the cost above which no trial run is made, and all orders of a small transport are simulated."""
FEWEST_PATHS, MOST_PATHS = 512, 4096
"""Paths of each of the two runs, all channels together; 4096 know a share of a tenth to some per cent of it."""
LASERS, PIXELS = 32, 8
"""Most laser points, and most pixels of each: the error of the choice falls with the root of their number."""
COMPONENTS = 3
"""Primary, secondary and higher light."""
BINS = 512
"""Most bins for the norm of the whole; longer time axes are rebinned to wider ones, which makes the norm smaller,
never larger, and less noisy."""
VALUES = 1 << 22
"""Most histogram values of a run, 32 MB."""
MOST_UNSEEN = 3.0
"""Number of paths of a component that may be missing if none was seen: seeing none of 3 expected ones has a
probability of 5 %."""


@dataclass(frozen=True)
class Trial:
    """The light of both runs.

    components : name of a component → (2, channel, bin) photons at the aperture per emitted photon.
    """

    components: Mapping[str, Floats]

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
            return min(MOST_UNSEEN / np.count_nonzero(total), 1.0)
        square = above.sum() / below.sum()
        # A component is never more than the whole.
        return min(float(np.sqrt(square + 3 * _jackknife(above, below, square))), 1.0)


def _jackknife(above: Floats, below: Floats, ratio: float) -> float:
    """Standard error of Σ above / Σ below over independent channels; the ratio itself if there are under four."""
    n = len(above)
    rest = below.sum() - below
    if n < 4 or (rest <= 0).any():
        return ratio
    without = (above.sum() - above) / rest
    return float(np.sqrt((n - 1) / n * np.square(without - without.mean()).sum()))


def _paths(capture: Capture, accuracy: Accuracy) -> float:
    """Paths of the transport, half as many as both runs of a trial may share; infinite with a target."""
    pairs = len(capture.laser.targets) * capture.shape[1]
    return math.inf if accuracy.samples is None else 0.5 * accuracy.samples * pairs


def is_affordable(capture: Capture, accuracy: Accuracy) -> bool:
    """Whether the smallest trial run costs at most `LARGEST_SHARE` of the transport; always true with a target."""
    return LARGEST_SHARE * _paths(capture, accuracy) >= FEWEST_PATHS


def run_trial(
    scene: Scene, capture: Capture, accuracy: Accuracy, seed: int, caster: Raycaster, points: LaserPoints
) -> Trial:
    """Two independent simulations of a few channels of the capture, with all orders from three bounces on."""
    channels = capture.excerpt(*trial_channels(capture, points))
    count = len(channels.laser.targets) * channels.shape[1]
    each = max(int(np.clip(SHARE * _paths(capture, accuracy), FEWEST_PATHS, MOST_PATHS)) // count, 1)
    few = replace(few_samples(accuracy, each), direct=False)
    runs = [
        transient_of(scene, channels, few, seed=(seed + k) % 2**64, split_parts=False, caster=caster).components
        for k in range(2)
    ]
    return Trial({name: np.stack([run[name].reshape(-1, capture.shape[2]) for run in runs]) for name in runs[0]})


def few_samples(accuracy: Accuracy, samples: int) -> Accuracy:
    """The accuracy of a trial run: so many paths of each pair of laser point and pixel."""
    return replace(accuracy, target=None, part_target=None, samples=samples)


def trial_channels(capture: Capture, points: LaserPoints) -> tuple[Ints, Ints]:
    """Numbers, ascending, of at most `LASERS` laser points and `PIXELS` pixels of a capture.

    Laser points whose ray meets nothing, or that a flood gives no light, are chosen only if there are no others. In
    confocal pairing the numbers of the pixels have no meaning, as each laser point has its own pixel.
    """
    channels = max(VALUES // (capture.shape[2] * COMPONENTS), 1)
    count = min(capture.shape[1], PIXELS, channels)
    has_light = capture.laser.shares > 0 if capture.illumination == "flood" else np.ones(len(points.part), np.bool_)
    there = np.flatnonzero((points.part >= 0) & has_light)
    place = points.position[there]
    if not len(there):
        there = np.flatnonzero(has_light)
        place = np.asarray(capture.laser.targets)[there]
    lit = there[_farthest_apart(place, min(LASERS, max(channels // count, 1)))]
    if capture.pairing == "confocal":
        return lit, np.arange(count)
    seen = capture.sensor.pixels.mean(axis=1) - capture.sensor.position
    return lit, _farthest_apart(seen / np.linalg.norm(seen, axis=1, keepdims=True), count)


def _farthest_apart(place: Floats, count: int) -> Ints:
    """Numbers, ascending, of `count` of the places (n, 3), or of all if they are fewer: first the place farthest from
    the middle of all, then always the place farthest from those chosen before."""
    chosen = list[int]()
    nearest = np.linalg.norm(place - place.mean(axis=0), axis=1)
    for _ in range(min(count, len(place))):
        k = int(nearest.argmax())
        distance = np.linalg.norm(place - place[k], axis=1)
        # The distance from the middle decides the first place only.
        nearest = np.minimum(nearest, distance) if chosen else distance
        chosen.append(k)
        nearest[chosen] = -1.0
    return np.sort(np.array(chosen, np.int64))
