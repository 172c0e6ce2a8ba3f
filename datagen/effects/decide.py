"""The switchboard: the table of all effects, and for a scene the decisions which of them are simulated."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from datagen.config.effects import EffectsConfig
from datagen.detector import Exposure, Spad
from datagen.detector.sampler_choice import DEFAULT_TOLERANCE
from datagen.effects.detector_effects import DETECTOR_EFFECTS, Detection
from datagen.effects.rule import Decision, Effect, decide
from datagen.effects.scene_figures import SceneFigures
from datagen.effects.transport_effects import TRANSPORT_EFFECTS
from datagen.effects.trial import few_samples
from datagen.errors import InputError
from datagen.records import Accuracy, Capture, Scalar, Scene, TimeAxis, Transient
from datagen.records.checks import check_kind, check_number, check_seed
from datagen.transport import transient_of
from datagen.transport.visibility.raycast import Raycaster

EFFECTS: tuple[Effect[Any], ...] = (*TRANSPORT_EFFECTS, *DETECTOR_EFFECTS)
"""Every effect there is, one row each, in the order in which light meets them."""

FORESEEN_LOOKINS = 256
"""Lookins of the transient by which the detector's effects are decided when there is none yet."""


@dataclass(frozen=True)
class EffectDecisions:
    """The decisions for a scene: which effects are simulated, and why.

    Attributes
    ----------
    decisions : one for each effect of the stages decided for.
    tolerance : relative L2 change of a stage's answer that all effects left out by `auto` may cause together.
    """

    decisions: tuple[Decision, ...]
    tolerance: float

    def __getitem__(self, effect: str) -> Decision:
        """The decision for an effect by its name."""
        for decision in self.decisions:
            if decision.effect == effect:
                return decision
        raise InputError(
            f"effect {effect!r}: decided are {', '.join(d.effect for d in self.decisions) or 'no decision'}"
        )

    def __add__(self, other: EffectDecisions) -> EffectDecisions:
        """Both stages' decisions together."""
        return EffectDecisions(self.decisions + other.decisions, max(self.tolerance, other.tolerance))

    def apply_transport(self, scene: Scene, capture: Capture, accuracy: Accuracy) -> tuple[Scene, Accuracy]:
        """The scene and accuracy to simulate: what is left out is no part of them."""
        reduced = _applied(TRANSPORT_EFFECTS, self.decisions, SceneFigures(scene, capture, accuracy))
        return reduced.scene, reduced.accuracy

    def apply_detector(
        self, spad: Spad, exposure: Exposure, tolerance: float = DEFAULT_TOLERANCE
    ) -> tuple[Spad, Exposure, float]:
        """The detector, its exposure and the tolerance for `detect`, which is 0 where the dead time's effects, or
        those of avalanches, are switched on."""
        given = Detection(np.zeros((1, 1, 1)), TimeAxis(1, 1e-9), spad, exposure, tolerance)
        reduced = _applied(DETECTOR_EFFECTS, self.decisions, given)
        return reduced.spad, reduced.exposure, reduced.tolerance

    def parameters(self) -> dict[str, Scalar]:
        """The decisions as scalars, to be stored with a sample: `effect.NAME.on`, `.kind`, `.estimate`."""
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
    """Decide for the effects of the transport; parameters as of `plan_effects`, and a caster of the scene, where one
    was made already."""
    return _decided(TRANSPORT_EFFECTS, SceneFigures(scene, capture, accuracy, seed, caster), settings)


def decide_detector_effects(
    transient: NDArray[np.float64], time: TimeAxis, spad: Spad, exposure: Exposure,
    settings: EffectsConfig | None = None, tolerance: float = DEFAULT_TOLERANCE,
) -> EffectDecisions:  # fmt: skip
    """Decide for the effects of the detector; parameters as of `plan_effects` (transient: laser, pixel, bin)."""
    return _decided(DETECTOR_EFFECTS, Detection(transient, time, spad, exposure, tolerance), settings)


def plan_effects(
    scene: Scene, capture: Capture, accuracy: Accuracy | None = None, spad: Spad | None = None,
    exposure: Exposure | None = None, *, settings: EffectsConfig | None = None, transient: Transient | None = None,
    tolerance: float = DEFAULT_TOLERANCE, seed: int = 0,
) -> EffectDecisions:  # fmt: skip
    """Which effects a scene calls for (docs/physics.md): what changes the answer too little to matter is left out.

    What an effect changes is bounded, or measured by a trial run (twice the transport at about a hundredth of its
    cost). Those whose changes together stay within `settings.tolerance` are left out, the costliest first. Effects
    that cost no time of their own are simulated.

    Parameters
    ----------
    scene, capture : the scene, and how it is looked at.
    accuracy : what the transport is to simulate, default `Accuracy()`.
    spad, exposure : the detector; left out, only the transport is decided for.
    settings : tolerance, and `on`, `off` or `auto` for each effect; left out, all are `auto`.
    transient : what the detector is to see; left out, it is estimated with `FORESEEN_LOOKINS` lookins.
    tolerance : of `detect`: largest relative bias of a cheaper sampler.
    seed : of the trial run; the same arguments give the same decisions on any machine.

    Returns
    -------
    EffectDecisions; its `apply_transport` and `apply_detector` give what to hand to `simulate` and `detect`.

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
        few = few_samples(reduced, FORESEEN_LOOKINS)
        transient = transient_of(reduced_scene, capture, few, seed=seed, split_parts=False)
    seen = (transient.total, capture.time, spad, exposure or Exposure())
    return decided + decide_detector_effects(*seen, settings, tolerance)


def decision_lines(decided: EffectDecisions) -> list[str]:
    """A heading and a line for each decision, for people: effect, what was decided, by how much it counts, why."""
    titles = {row.name: row.title for row in EFFECTS}
    lines = [f"{'effect':30}{'is':5}{'from':8}{'change':>9}  why"]
    for decision in decided.decisions:
        state = "on" if decision.simulated else "off" if decision.left_out else "–"
        value = None if decision.kind == "absent" else decision.estimate
        number = "" if value is None else "> 1" if value > 1 else f"{value:.2g}"
        lines.append(f"{titles[decision.effect]:30}{state:5}{decision.kind:8}{number:>9}  {decision.reason}")
    return lines


def _decided(rows: Sequence[Effect[Any]], given: Any, settings: EffectsConfig | None) -> EffectDecisions:
    settings = settings or EffectsConfig()
    return EffectDecisions(decide(rows, given, settings.of, settings.tolerance), settings.tolerance)


def _applied(rows: Sequence[Effect[Any]], decisions: Sequence[Decision], given: Any) -> Any:
    """The scene or detector with the decisions applied, last row first: dead time across cycles before pile-up."""
    made = {decision.effect: decision for decision in decisions}
    for row in reversed(rows):
        decision = made.get(row.name)
        if decision is not None and decision.kind != "absent":
            if not decision.simulated:
                given = row.without(given)
            elif decision.setting != "auto":
                given = row.always(given, decision.setting)
    return given
