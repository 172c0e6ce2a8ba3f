"""What `datagen bench accuracy` sweeps: one quantity at a time about one base setting."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from datagen.paper.as_printed import AsPrinted, simulate_as_printed
from datagen.records import Accuracy, Capture, Scene
from datagen.transport import simulate

Run = Callable[[Scene, Capture, int], NDArray[np.float64]]
"""(scene, capture, seed) → (laser, pixel, bin)."""

WIDEST = 9
"""Bins of the bin-width sweep are ⅓, 1, 3 and 9 times as wide as the configured ones: odd ratios, because then the
centres of wide bins are centres of narrow ones, and a transient in narrow bins gives that in wide ones exactly."""
FACTORS: tuple[tuple[int, int], ...] = ((1, 3), (1, 1), (3, 1), (WIDEST, 1))
"""(p, q): bins p/q times as wide."""
OBSERVED = 1024
"""Observed points of the factorised secondary in the sweeps of other quantities."""
SMALLEST_SWEPT = 16


@dataclass(frozen=True)
class Setting:
    """One point of a sweep.

    Attributes
    ----------
    quantity, value : what is swept, and what it is here.
    config : how a configuration says so, keys of its section `transport`; empty where none does.
    run : (scene, capture, seed) → transient.
    widening : (p, q), bins p/q times as wide as configured.
    fixed : the same for every seed.
    complete : whether its truth is all bounce orders; else those of the base setting.
    scaled : its level means nothing, so it is compared after the best scaling.
    """

    quantity: str
    value: str
    config: str
    run: Run
    widening: tuple[int, int] = (1, 1)
    fixed: bool = False
    complete: bool = False
    scaled: bool = False


def settings_of(base: Accuracy) -> list[list[Setting]]:
    """Every sweep about a base setting, cheapest setting first; two of them have all bounce orders as their truth."""
    lookins = [n for n in (base.lookins * 4**k // 64 for k in range(6)) if n >= SMALLEST_SWEPT]
    factorised, everything = replace(base, observed=OBSERVED), replace(base, max_bounces=None)
    target = Accuracy(max_bounces=base.max_bounces, direct=base.direct, target=1.0)
    sweeps = [
        [of_accuracy("lookins", str(n), replace(base, lookins=n)) for n in lookins],
        [of_accuracy("FoV points", str(n), replace(base, fov_samples=n)) for n in (1, 4, 16, 64)],
        [
            replace(of_accuracy("bin width", _times(p, q), base), widening=(p, q), config="")
            for p, q in reversed(FACTORS)
        ],
        [of_accuracy("target", f"{t:g}", replace(target, target=t)) for t in (0.2, 0.1, 0.05, 0.02, 0.01)],
        [
            of_accuracy("observed points", str(n), replace(base, observed=n))
            for n in (64, 256, OBSERVED, 4 * OBSERVED)
        ],
        [of_accuracy("k strongest paths", str(k), replace(factorised, secondary=k)) for k in (1, 8, 64, 512)],
        [of_accuracy("estimator", "walk", base), of_accuracy("estimator", "factorised", factorised)],
        [_printed(10, 20), _printed(10, 60), _printed(20, 60)],
    ]
    complete = [
        [of_accuracy(ALL_LOOKINS, str(n), replace(everything, lookins=n)) for n in lookins],
        [
            of_accuracy("bounce orders", "all" if b is None else f"≤ {b}", replace(base, max_bounces=b))
            for b in BOUNCES
        ],
    ]
    # First what most users change: should the budget be spent, what comes last is left out.
    return sweeps[:2] + [[replace(setting, complete=True) for setting in sweep] for sweep in complete] + sweeps[2:]


ALL_LOOKINS = "lookins, all bounces"
BOUNCES: tuple[int | None, ...] = (3, 4, 5, 6, 8, 12, None)


def of_accuracy(quantity: str, value: str, accuracy: Accuracy) -> Setting:
    """A setting that the solver is given."""

    def run(scene: Scene, capture: Capture, seed: int) -> NDArray[np.float64]:
        return simulate(scene, capture, accuracy, seed, split_parts=False).total

    return Setting(quantity, value, _as_configured(accuracy), run)


def _as_configured(accuracy: Accuracy) -> str:
    orders = "null" if accuracy.max_bounces is None else str(accuracy.max_bounces)
    if accuracy.target is not None:
        return f"target: {accuracy.target:g}, max_bounces: {orders}"
    text = f"lookins: {accuracy.lookins}, fov_samples: {accuracy.fov_samples}, max_bounces: {orders}"
    if accuracy.observed is not None:
        text += f", observed: {accuracy.observed}"
    return text if accuracy.secondary == "all" else f"{text}, secondary: {accuracy.secondary}"


def _printed(rays: int, pixels: int) -> Setting:
    settings = AsPrinted(rays=rays, pixels=pixels)

    def run(scene: Scene, capture: Capture, seed: int) -> NDArray[np.float64]:
        return simulate_as_printed(scene, capture, settings).total

    return Setting("estimator", f"as printed {rays}²×{pixels}²", "", run, fixed=True, scaled=True)


def _times(p: int, q: int) -> str:
    return f"× 1/{q}" if p == 1 and q > 1 else f"× {p}"
