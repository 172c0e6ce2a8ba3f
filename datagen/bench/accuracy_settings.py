"""What `datagen bench accuracy` sweeps: one quantity at a time about one base setting."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from datagen.records import Accuracy, Capture

OBSERVED = 1024
"""Observed points of the factorised secondary where they are not what is swept."""
SMALLEST_SWEPT = 16
ALL_LOOKINS = "lookins, all bounces"
BOUNCES: tuple[int | None, ...] = (3, 4, 5, 6, 8, 12, None)


@dataclass(frozen=True)
class Setting:
    """One point of a sweep: what is swept, and its value here. complete : whether its truth is all bounce orders."""

    quantity: str
    value: str
    accuracy: Accuracy
    complete: bool = False

    @property
    def configured(self) -> str:
        """How a configuration says so, keys of its section `transport`."""
        accuracy = self.accuracy
        orders = f"max_bounces: {'null' if accuracy.max_bounces is None else accuracy.max_bounces}"
        if accuracy.target is not None:
            return f"target: {accuracy.target:g}, {orders}"
        text = f"lookins: {accuracy.lookins}, fov_samples: {accuracy.fov_samples}, {orders}"
        if accuracy.observed is not None:
            text += f", observed: {accuracy.observed}"
        return text if accuracy.secondary == "all" else f"{text}, secondary: {accuracy.secondary}"


@dataclass(frozen=True)
class Row:
    """One setting, measured: medians over `runs` runs with different seeds.

    Attributes
    ----------
    seconds : processor seconds of a run.
    error : relative L2 error against the truth.
    noise : its random part, relative to what the setting converges to.
    bias : its systematic part, which more samples do not mend; 0 where it is not above what noise leaves uncertain.
    complete : whether the truth is all bounce orders, or those of the base setting.
    front : on the Pareto front of its truth: nothing quicker has less error.
    """

    quantity: str
    value: str
    configured: str
    runs: int
    seconds: float
    error: float
    noise: float
    bias: float
    complete: bool
    front: bool = False


def sweeps(base: Accuracy) -> list[list[Setting]]:
    """Every sweep about a base setting, cheapest setting first, and first what most users change: should the budget
    be spent, what comes last is left out."""
    lookins = [n for n in (base.lookins * 4**k // 64 for k in range(6)) if n >= SMALLEST_SWEPT]
    factorised, everything = replace(base, observed=OBSERVED), replace(base, max_bounces=None)
    target = Accuracy(max_bounces=base.max_bounces, direct=base.direct, target=1.0)
    return [
        [Setting("lookins", str(n), replace(base, lookins=n)) for n in lookins],
        [Setting("FoV points", str(n), replace(base, fov_samples=n)) for n in (1, 4, 16, 64)],
        [Setting(ALL_LOOKINS, str(n), replace(everything, lookins=n), complete=True) for n in lookins],
        [
            Setting("bounce orders", f"≤ {b}" if b else "all", replace(base, max_bounces=b), complete=True)
            for b in BOUNCES
        ],
        [Setting("target", f"{t:g}", replace(target, target=t)) for t in (0.2, 0.1, 0.05, 0.02, 0.01)],
        [Setting("observed points", str(n), replace(base, observed=n)) for n in (64, 256, OBSERVED, 4 * OBSERVED)],
        [Setting("k strongest paths", str(k), replace(factorised, secondary=k)) for k in (1, 8, 64, 512)],
    ]


def fewer_laser_points(capture: Capture, most: int | None) -> Capture:
    """At most `most` of the laser points (confocal: with their pixels), spread evenly over the scan."""
    count = len(capture.laser.targets)
    if most is None or count <= most:
        return capture
    kept = np.unique(np.round((np.arange(most) + 0.5) * count / most - 0.5).astype(int))
    return capture.excerpt(kept)
