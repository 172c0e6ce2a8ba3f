"""The switchboard: only the effects a scene calls for are simulated (DESIGN, sec. 6)."""

from datagen.effects.decision import Decision, Effect, Estimate
from datagen.effects.plan import (
    EFFECTS,
    EffectPlan,
    decision_lines,
    plan_detector_effects,
    plan_effects,
    plan_transport_effects,
)

__all__ = [
    "EFFECTS",
    "Decision",
    "Effect",
    "EffectPlan",
    "Estimate",
    "decision_lines",
    "plan_detector_effects",
    "plan_effects",
    "plan_transport_effects",
]
