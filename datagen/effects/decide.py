"""The switchboard: the table of all effects, and the decisions which of them are simulated for a scene."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from datagen.config.effects import EffectsConfig
from datagen.detector import Exposure, Spad
from datagen.detector.sampler_choice import DEFAULT_TOLERANCE
from datagen.effects.detector_effects import DETECTOR_EFFECTS, Detection, Detector
from datagen.effects.rule import Decision, Effect, Reduced, decide
from datagen.effects.transport_effects import TRANSPORT_EFFECTS, Transport
from datagen.effects.trial import few_samples
from datagen.errors import InputError, shown
from datagen.records import Accuracy, Capture, Scalar, Scene, TimeAxis, Transient
from datagen.records.arrays import Floats
from datagen.records.checks import check_kind, check_number, check_seed
from datagen.transport import transient_of
from datagen.transport.rays import Raycaster

EFFECTS: tuple[Effect[Any, Any], ...] = (*TRANSPORT_EFFECTS, *DETECTOR_EFFECTS)
"""All effects, in the order in which light meets them."""

PILOT_SAMPLES = 64
"""Paths of each pair of the transient for which the detector's effects are decided if none is given."""


@dataclass(frozen=True)
class EffectDecisions:
    """The decisions for a scene: which effects are simulated, and why.

    Attributes
    ----------
    decisions : one decision for each effect of the transport, of the detector, or of both.
    tolerance : relative L2 change of a stage's result that all effects left out by `auto` may cause together.
    """

    decisions: tuple[Decision, ...]
    tolerance: float

    def __getitem__(self, effect: str) -> Decision:
        """The decision for an effect by its name."""
        for decision in self.decisions if isinstance(effect, str) else ():
            if decision.effect == effect:
                return decision
        raise InputError(
            f"effect {shown(effect)}: decided are {', '.join(d.effect for d in self.decisions) or 'no decision'}"
        )

    def __add__(self, other: EffectDecisions) -> EffectDecisions:
        """The decisions of both stages."""
        return EffectDecisions(self.decisions + other.decisions, max(self.tolerance, other.tolerance))

    def apply_transport(self, scene: Scene, capture: Capture, accuracy: Accuracy) -> tuple[Scene, Accuracy]:
        """The scene and the accuracy to simulate, without the effects that are left out."""
        reduced = _with_decisions(TRANSPORT_EFFECTS, self.decisions, Transport(scene, capture, accuracy))
        return reduced.scene, reduced.accuracy

    def apply_detector(
        self, spad: Spad, exposure: Exposure, tolerance: float = DEFAULT_TOLERANCE
    ) -> tuple[Spad, Exposure, float]:
        """The detector, the exposure and the tolerance for `detect`, which is 0 if an effect of the dead time or of
        avalanches is switched on."""
        reduced = _with_decisions(DETECTOR_EFFECTS, self.decisions, Detector(spad, exposure, tolerance))
        return reduced.spad, reduced.exposure, reduced.tolerance

    def parameters(self) -> dict[str, Scalar]:
        """The decisions as scalars, which are stored with a sample: `effect.NAME.on`, `.kind`, `.estimate`."""
        flat: dict[str, Scalar] = {}
        for decision in self.decisions:
            prefix = f"effect.{decision.effect}"
            flat |= {f"{prefix}.on": decision.simulated, f"{prefix}.kind": decision.kind}
            if decision.estimate is not None:
                flat[f"{prefix}.estimate"] = decision.estimate
        return flat


def decide_transport_effects(
    scene: Scene, capture: Capture, accuracy: Accuracy, settings: EffectsConfig | None = None, seed: int = 0,
    caster: Raycaster | None = None,
) -> EffectDecisions:  # fmt: skip
    """The decisions on the transport's effects; parameters as of `plan_effects`, and the scene's caster, if any."""
    return _decisions(TRANSPORT_EFFECTS, Transport(scene, capture, accuracy, seed, caster), settings)


def decide_detector_effects(
    transient: Floats, time: TimeAxis, spad: Spad, exposure: Exposure,
    settings: EffectsConfig | None = None, tolerance: float = DEFAULT_TOLERANCE,
) -> EffectDecisions:  # fmt: skip
    """The decisions on the detector's effects; parameters as of `plan_effects`, transient (laser, pixel, bin)."""
    return _decisions(DETECTOR_EFFECTS, Detection(spad, exposure, tolerance, transient, time), settings)


def plan_effects(
    scene: Scene, capture: Capture, accuracy: Accuracy | None = None, spad: Spad | None = None,
    exposure: Exposure | None = None, *, settings: EffectsConfig | None = None, transient: Transient | None = None,
    tolerance: float = DEFAULT_TOLERANCE, seed: int = 0,
) -> EffectDecisions:  # fmt: skip
    """The decisions which effects of a scene are simulated (docs/physics.md).

    The change that an effect makes is bounded, or measured by a trial run (twice the transport at about a hundredth
    of its cost). Effects whose changes together stay within `settings.tolerance` are left out, the costliest first.
    Effects that cost no time of their own are always simulated.

    Parameters
    ----------
    scene, capture : the scene and its capture.
    accuracy : the accuracy of the transport; left out, `Accuracy()`.
    spad, exposure : the detector; left out, only the transport's effects are decided.
    settings : tolerance, and `on`, `off` or `auto` for each effect; left out, all are `auto`.
    transient : the light that reaches the detector; left out, it is estimated by `PILOT_SAMPLES` paths a pair.
    tolerance : that of `detect`, the largest relative bias of a cheaper sampler.
    seed : seed of the trial run; the same arguments give the same decisions.

    Returns
    -------
    EffectDecisions; its `apply_transport` and `apply_detector` give the arguments of `simulate` and `detect`.

    Raises
    ------
    InputError : a scene or capture that `simulate` refuses.
    """
    check_kind("scene", scene, Scene)
    check_kind("capture", capture, Capture)
    optional: dict[str, tuple[object, type]] = {
        "accuracy": (accuracy, Accuracy), "spad": (spad, Spad), "exposure": (exposure, Exposure),
        "settings": (settings, EffectsConfig), "transient": (transient, Transient),
    }  # fmt: skip
    for name, (value, kind) in optional.items():
        if value is not None:
            check_kind(name, value, kind)
    check_number("plan_effects", "tolerance", tolerance, 0.0, 1.0, "a relative bias, such as 1e-3")
    check_seed(seed)
    accuracy = accuracy or Accuracy()
    decided = decide_transport_effects(scene, capture, accuracy, settings, seed)
    if spad is None:
        return decided
    if transient is None:
        reduced_scene, reduced = decided.apply_transport(scene, capture, accuracy)
        few = few_samples(reduced, PILOT_SAMPLES)
        transient = transient_of(reduced_scene, capture, few, seed=seed, split_parts=False)
    seen = (transient.total, capture.time, spad, exposure or Exposure())
    return decided + decide_detector_effects(*seen, settings, tolerance)


def _decisions(rows: Sequence[Effect[Any, Any]], given: Any, settings: EffectsConfig | None) -> EffectDecisions:
    """The decisions on the effects of one stage."""
    settings = settings or EffectsConfig()
    return EffectDecisions(decide(rows, given, settings.of, settings.tolerance), settings.tolerance)


def _with_decisions(rows: Sequence[Effect[Any, Reduced]], decisions: Sequence[Decision], given: Reduced) -> Reduced:
    """The scene or detector with the decisions applied, last row first, as pile-up is left out according to the mode
    that dead time across cycles leaves."""
    by_effect = {decision.effect: decision for decision in decisions}
    for row in reversed(rows):
        decision = by_effect.get(row.name)
        if decision is not None and decision.kind != "absent":
            if not decision.simulated:
                given = row.without(given)
            elif decision.setting != "auto":
                given = row.always(given, decision.setting)
    return given
