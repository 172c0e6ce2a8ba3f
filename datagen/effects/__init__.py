"""The switchboard, which leaves out the effects that hardly change a scene's answer (docs/physics.md)."""

from datagen.effects.decide import (
    EFFECTS,
    EffectDecisions,
    decide_detector_effects,
    decide_transport_effects,
    plan_effects,
)
from datagen.effects.rule import Change, Decision, Effect

__all__ = [
    "EFFECTS", "Change", "Decision", "Effect", "EffectDecisions", "decide_detector_effects",
    "decide_transport_effects", "plan_effects",
]  # fmt: skip
