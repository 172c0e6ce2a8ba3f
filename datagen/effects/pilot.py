"""The pilot: the same transport at a fiftieth of its cost, to see how much of the light takes each way.

Two independent runs a and b of a few laser points and pixels. A component x is compared with T, all light of three
bounces and more, by

    ‖(x_a + x_b)/2‖ / √(T_a · T_b),

where the noise of the runs adds to the numerator and cancels, on average, in the denominator: few samples overrate a
component, never the whole. The direct return is no part of T, although it is of the transient: it may be 10⁴ times as
bright as all the rest, which a gate then lets through alone. What the choice of channels leaves uncertain is added as
three standard errors (jackknife over channels).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from datagen.records import Accuracy, Capture, Laser, Scene, Sensor
from datagen.transport import simulate
from datagen.transport.cost import CALL, RAY

SHARE = 0.02
"""Share of the transport's cost that a pilot may take."""
LARGEST_SHARE = 0.1
"""Share above which the smallest pilot is not worth its cost: then nothing is measured."""
OVERHEAD = 60_000.0
"""What a run costs whatever its size, in shadow rays: the scene is prepared anew, calls are made for few walks."""
FEWEST_WALKS, MOST_WALKS = 512, 4096
"""Walks of one of the two runs, all channels together."""
LASERS, PIXELS = 32, 8
"""Most laser points, and most pixels of each (exhaustive pairing)."""
MOST_ORDERS = 8
"""Bounces that count for the cost: of longer paths few are left."""
BINS = 512
"""Bins, at most, for the norm of the whole: fewer and wider ones make it smaller, never larger."""
VALUES = 1 << 22
"""Most histogram values of a run."""


@dataclass(frozen=True)
class Pilot:
    """Two runs. components, parts : name → (2, channel, bin) photons per emitted photon."""

    components: Mapping[str, NDArray[np.float64]]
    parts: Mapping[str, NDArray[np.float64]]

    @property
    def dark(self) -> bool:
        """Whether neither run found any light."""
        return not any(component.any() for component in self.components.values())

    def share(self, *found: NDArray[np.float64]) -> float | None:
        """Upper estimate of ‖x‖ / ‖T‖ for x the sum of what is `found`, at most 1; None where T is lost in noise."""
        x = sum(found, start=np.zeros_like(next(iter(self.components.values()))))
        if not x.any():
            return 0.0
        indirect = [component for name, component in self.components.items() if name != "direct"]
        total = sum(indirect, start=np.zeros_like(x))
        wide = -(-total.shape[2] // BINS)
        padded = np.pad(total, ((0, 0), (0, 0), (0, -total.shape[2] % wide)))
        coarse = padded.reshape(*padded.shape[:2], -1, wide).sum(axis=3)
        above = np.square(x.mean(axis=0)).sum(axis=1)
        below = (coarse[0] * coarse[1]).sum(axis=1) / wide
        if below.sum() <= 0:
            return None
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
    """Whether even the smallest pilot costs no more than `LARGEST_SHARE` of the transport; with a target, always."""
    orders = min(accuracy.max_bounces or MOST_ORDERS, MOST_ORDERS) - 2
    smallest = 2 * (OVERHEAD / orders + FEWEST_WALKS * (RAY + _pixels(capture)))
    return accuracy.target is not None or smallest <= LARGEST_SHARE * _cost(capture, accuracy)


def run_pilot(scene: Scene, capture: Capture, accuracy: Accuracy, seed: int) -> Pilot:
    """Simulate a few channels of the capture twice, all orders and parts."""
    lasers, pixels, bins = capture.shape
    budget = MOST_WALKS
    if accuracy.target is None:
        budget = int(SHARE * _cost(capture, accuracy) / (2 * (RAY + _pixels(capture))))
    walks = int(np.clip(budget, FEWEST_WALKS, MOST_WALKS))
    rows = len(scene.part_names) + 3
    channels = int(np.clip(VALUES // (bins * rows), 1, LASERS * PIXELS))
    looked_at = min(_pixels(capture), channels)
    chosen = _spread(lasers, max(min(LASERS, channels // looked_at), 1))
    few = Accuracy(
        lookins=max(walks // len(chosen), 1),
        fov_samples=1,
        max_bounces=accuracy.max_bounces,
        scramblings=1,
        direct=accuracy.direct,
        secondary="none" if accuracy.secondary == "none" else "all",
    )
    part_of = _excerpt(capture, chosen, _spread(pixels, looked_at))
    runs = [simulate(scene, part_of, few, seed=(seed + k) % 2**64) for k in (0, 1)]
    return Pilot(_paired([run.components for run in runs]), _paired([run.parts for run in runs]))


def _paired(runs: list[Mapping[str, NDArray[np.float64]]]) -> dict[str, NDArray[np.float64]]:
    return {name: np.stack([run[name].reshape(-1, run[name].shape[2]) for run in runs]) for name in runs[0]}


def _pixels(capture: Capture) -> int:
    return min(capture.shape[1], PIXELS)


def _cost(capture: Capture, accuracy: Accuracy) -> float:
    """Of the transport, in units of a shadow ray, for each order; see `transport.cost`."""
    lasers, pixels, _ = capture.shape
    return lasers * accuracy.lookins * (RAY + pixels * accuracy.fov_samples) + CALL * accuracy.scramblings


def _spread(total: int, count: int) -> NDArray[np.int64]:
    """`count` different numbers below `total`, evenly spread, or all of them."""
    count = min(count, total)
    return ((np.arange(count) + 0.5) * total / count).astype(np.int64)


def _excerpt(capture: Capture, lasers: NDArray[np.int64], pixels: NDArray[np.int64]) -> Capture:
    """The capture with only some laser points and pixels."""
    sensor = capture.sensor
    seen = lasers if capture.pairing == "confocal" else pixels
    return replace(
        capture,
        laser=Laser(capture.laser.position, capture.laser.targets[lasers]),
        sensor=Sensor(sensor.position, sensor.pixels[seen], sensor.aperture_radius_m, sensor.finite_aperture),
    )
