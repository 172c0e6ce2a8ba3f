"""The switchboard: one table of effects, and for a scene the plan of what is simulated of them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from datagen.config.effects import EffectsConfig
from datagen.detector import Exposure, Spad
from datagen.detector.plan import DEFAULT_TOLERANCE
from datagen.effects.decision import Decision, Effect, Stage, decide
from datagen.effects.detector_effects import DETECTOR_EFFECTS
from datagen.effects.detector_world import DetectorWorld
from datagen.effects.transport_effects import TRANSPORT_EFFECTS
from datagen.effects.transport_world import TransportWorld
from datagen.errors import InputError
from datagen.records import Accuracy, Capture, Scalar, Scene, TimeAxis, Transient
from datagen.transport import simulate

EFFECTS: tuple[Effect[Any], ...] = (*TRANSPORT_EFFECTS, *DETECTOR_EFFECTS)
"""Every effect there is, one row each, in the order in which light meets them."""

FORESEEN_LOOKINS = 256
"""Lookins of the transient by which the detector's effects are decided when there is none yet."""


@dataclass(frozen=True)
class EffectPlan:
    """What is simulated of a scene, and why: one decision for each effect of the stages planned.

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
            f"effect {effect!r}: this plan holds {', '.join(d.effect for d in self.decisions) or 'no decision'}"
        )

    def __add__(self, other: EffectPlan) -> EffectPlan:
        """Both stages' decisions in one plan."""
        return EffectPlan(self.decisions + other.decisions, max(self.tolerance, other.tolerance))

    def change(self, stage: Stage) -> float:
        """Bound on the relative change of a stage's answer by all that `auto` left out."""
        product = 1.0
        for decision in self.decisions:
            if decision.stage == stage and decision.left_out and decision.estimate is not None:
                product *= 1.0 + decision.estimate
        return product - 1.0

    def apply_transport(self, scene: Scene, capture: Capture, accuracy: Accuracy) -> tuple[Scene, Accuracy]:
        """The scene and accuracy to simulate: what is left out is no part of them."""
        world = _applied(TRANSPORT_EFFECTS, self.decisions, TransportWorld(scene, capture, accuracy))
        return world.scene, world.accuracy

    def apply_detector(
        self, spad: Spad, exposure: Exposure, tolerance: float = DEFAULT_TOLERANCE
    ) -> tuple[Spad, Exposure, float]:
        """The detector, its exposure and the tolerance for `detect`, which is 0 where the dead time's effects, or
        those of avalanches, are switched on."""
        nothing = np.zeros((1, 1, 1))
        world = _applied(
            DETECTOR_EFFECTS, self.decisions, DetectorWorld(nothing, TimeAxis(1, 1e-9), spad, exposure, tolerance)
        )
        return world.spad, world.exposure, world.tolerance

    def parameters(self) -> dict[str, Scalar]:
        """The decisions as scalars, to be stored with a sample: `effect.NAME.on`, `.kind`, `.estimate`."""
        flat: dict[str, Scalar] = {}
        for decision in self.decisions:
            prefix = f"effect.{decision.effect}"
            flat |= {f"{prefix}.on": decision.simulated, f"{prefix}.kind": decision.kind}
            if decision.estimate is not None:
                flat[f"{prefix}.estimate"] = decision.estimate
        return flat


def plan_transport_effects(
    scene: Scene, capture: Capture, accuracy: Accuracy, settings: EffectsConfig | None = None, seed: int = 0
) -> EffectPlan:
    """Decide for the effects of the transport; the same arguments give the same plan. seed : of the pilot."""
    settings = settings or EffectsConfig()
    world = TransportWorld(scene, capture, accuracy, seed)
    return EffectPlan(decide(TRANSPORT_EFFECTS, world, settings.of, settings.tolerance), settings.tolerance)


def plan_detector_effects(
    transient: NDArray[np.float64],
    time: TimeAxis,
    spad: Spad,
    exposure: Exposure,
    settings: EffectsConfig | None = None,
    tolerance: float = DEFAULT_TOLERANCE,
) -> EffectPlan:
    """Decide for the effects of the detector on a transient (laser, pixel, bin). tolerance : `detector.tolerance`."""
    settings = settings or EffectsConfig()
    world = DetectorWorld(transient, time, spad, exposure, tolerance, settings.tolerance)
    return EffectPlan(decide(DETECTOR_EFFECTS, world, settings.of, settings.tolerance), settings.tolerance)


def plan_effects(
    scene: Scene,
    capture: Capture,
    accuracy: Accuracy | None = None,
    spad: Spad | None = None,
    exposure: Exposure | None = None,
    *,
    settings: EffectsConfig | None = None,
    transient: Transient | None = None,
    tolerance: float = DEFAULT_TOLERANCE,
    seed: int = 0,
) -> EffectPlan:
    """Which effects a scene calls for (DESIGN, sec. 6): what changes the answer too little to matter is left out.

    Each effect has a bound, or a pilot measures it (two runs of the transport at about a hundredth of its cost each).
    Nothing is worked out or measured that would cost more than it can save.
    Those whose estimates together stay within `settings.tolerance` are left out, the costliest first.

    Parameters
    ----------
    accuracy : what the transport is to simulate, default `Accuracy()`.
    spad, exposure : the detector; left out, only the transport is planned.
    settings : tolerance, and `on`, `off` or `auto` for each effect; left out, all are `auto`.
    transient : what the detector is to see; left out, it is estimated with `FORESEEN_LOOKINS` lookins.
    tolerance : of `detect`: largest relative bias of a cheaper sampler.
    seed : of the pilot; the same arguments give the same plan on any machine.

    Returns
    -------
    EffectPlan; its `apply_transport` and `apply_detector` give what to hand to `simulate` and `detect`.
    """
    accuracy = accuracy or Accuracy()
    plan = plan_transport_effects(scene, capture, accuracy, settings, seed)
    if spad is None:
        return plan
    if transient is None:
        reduced_scene, reduced = plan.apply_transport(scene, capture, accuracy)
        few = Accuracy(
            lookins=FORESEEN_LOOKINS, fov_samples=1, replicates=1, max_bounces=reduced.max_bounces,
            direct=reduced.direct, secondary="none" if reduced.secondary == "none" else "all",
            occlusion=reduced.occlusion,
        )  # fmt: skip
        transient = simulate(reduced_scene, capture, few, seed=seed, split_parts=False)
    seen = (transient.total, capture.time, spad, exposure or Exposure())
    return plan + plan_detector_effects(*seen, settings, tolerance)


def decision_lines(plan: EffectPlan) -> list[str]:
    """A line for each decision, for people: effect, what was decided, by how much it counts, why."""
    titles = {row.name: row.title for row in EFFECTS}
    lines = []
    for decision in plan.decisions:
        state = "on" if decision.simulated else "off" if decision.left_out else "–"
        value = None if decision.kind == "absent" else decision.estimate
        number = "" if value is None else "> 1" if value > 1 else f"{value:.2g}"
        lines.append(f"{titles[decision.effect]:30}{state:5}{decision.kind:8}{number:>9}  {decision.reason}")
    return lines


def _applied(rows: Sequence[Effect[Any]], decisions: Sequence[Decision], world: Any) -> Any:
    """The world with what was decided. Backwards through the table: a dead time across cycles before pile-up."""
    made = {decision.effect: decision for decision in decisions}
    for row in reversed(rows):
        decision = made.get(row.name)
        if decision is None or decision.kind == "absent":
            continue
        if not decision.simulated:
            world = row.without(world)
        elif decision.setting != "auto":
            world = row.always(world, decision.setting)
        else:
            world = row.cheapest(world)
    return world
