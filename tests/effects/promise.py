"""The switchboard's promise: leaving out effects changes a scene's results by no more than the tolerance.

The change is a relative L2 difference. Transients P as decided and F with every effect on are simulated twice each,
with independent noise (a and b):

    error² = (P_a − F_a)·(P_b − F_b) / (F_a · F_b),

in which the noise cancels on average; its standard error is that of the jackknife over channels. The larger of two
errors counts: that of the whole transient, and that of its light of three bounces and more, which the direct return
would hide. Histograms are compared by their expected values for the same transient.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from datagen.capture import capture_for
from datagen.config import DatasetConfig, EffectsConfig
from datagen.detector import detector_for, expected_histogram
from datagen.effects import EFFECTS, EffectDecisions, decide_detector_effects, decide_transport_effects
from datagen.records import Transient
from datagen.scene import generate_scene
from datagen.transport import simulate

EVERYTHING = EffectsConfig.model_validate({"tolerance": 0.0} | {row.name: "on" for row in EFFECTS})
"""Every effect switched on."""


@dataclass(frozen=True)
class Outcome:
    """The comparison of one scene.

    Attributes
    ----------
    states : effect → `on`, `off` (left out) or `absent`.
    transient_error, transient_least : relative L2 difference of the transient, and the same less two standard errors.
    histogram_error : of the expected histogram.
    """

    name: str
    states: dict[str, str]
    transient_error: float
    transient_least: float
    histogram_error: float

    def broken(self, tolerance: float) -> list[str]:
        """Promises not kept: differences beyond the tolerance, and beyond what noise could be."""
        found = []
        if self.transient_least > tolerance:
            found.append(f"{self.name}: the transient differs by {self.transient_error:.3g}")
        if self.histogram_error > tolerance:
            found.append(f"{self.name}: the expected histogram differs by {self.histogram_error:.3g}")
        return found


def run_case(config: DatasetConfig) -> Outcome:
    """The comparison of one scene as decided with the scene with every effect on."""
    scene = generate_scene(config.scene, config.seed, 0)
    capture = capture_for(config, scene, config.seed, 0)
    accuracy, tolerance = config.transport.accuracy(), config.detector.tolerance

    def decided(settings: EffectsConfig) -> EffectDecisions:
        return decide_transport_effects(scene, capture, accuracy, settings, seed=config.seed)

    def lit(decisions: EffectDecisions, seed: int) -> Transient:
        reduced_scene, reduced = decisions.apply_transport(scene, capture, accuracy)
        return simulate(reduced_scene, capture, reduced, seed=seed, split_parts=False)

    decisions, everything = decided(config.effects), decided(EVERYTHING)
    full = lit(everything, 1)
    error = least = 0.0
    if any(decision.left_out for decision in decisions.decisions):
        pairs = (lit(decisions, 1), lit(decisions, 2)), (full, lit(everything, 2))
        error, least = (
            max(pair) for pair in zip(*(difference(*pairs, part) for part in (whole, indirect)), strict=True)
        )
    given = detector_for(config.detector, config.seed, 0, capture.time)
    seen = (full.total, capture.time)

    decisions += decide_detector_effects(*seen, *given, config.effects, tolerance)
    used = decisions.apply_detector(*given, tolerance)[:2]
    mean, reference = (expected_histogram(*seen, *pair, approximate=True) for pair in (used, given))
    norm = float(np.linalg.norm(reference))
    histogram_error = float(np.linalg.norm(mean - reference)) / (norm if norm > 0 else 1.0)
    states = {d.effect: "on" if d.simulated else "off" if d.left_out else "absent" for d in decisions.decisions}
    return Outcome(config.name, states, error, least, histogram_error)


def whole(transient: Transient) -> NDArray[np.float64]:
    """(channel, bin) all light."""
    return transient.total.reshape(-1, transient.time.bins)


def indirect(transient: Transient) -> NDArray[np.float64]:
    """(channel, bin) light of three bounces and more."""
    return (transient.total - transient.components.get("direct", 0.0)).reshape(-1, transient.time.bins)


def difference(
    decided: tuple[Transient, Transient],
    full: tuple[Transient, Transient],
    part: Callable[[Transient], NDArray[np.float64]],
) -> tuple[float, float]:
    """Relative L2 difference of two pairs of independent transients, and the same less two standard errors."""
    reference = [part(f) for f in full]
    apart = [part(p) - f for p, f in zip(decided, reference, strict=True)]
    above, below = (apart[0] * apart[1]).sum(axis=1), (reference[0] * reference[1]).sum(axis=1)
    if not any(a.any() for a in apart):
        return 0.0, 0.0
    if below.sum() <= 0:
        return np.inf, np.inf
    square = float(above.sum() / below.sum())
    n = len(above)
    without = (above.sum() - above) / np.maximum(below.sum() - below, 1e-300)
    spread = float(np.sqrt((n - 1) / n * np.square(without - without.mean()).sum()))
    return float(np.sqrt(max(square, 0.0))), float(np.sqrt(max(square - 2 * spread, 0.0)))
