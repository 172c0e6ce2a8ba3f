"""Light transport: from a scene and a capture to the transient."""

from datagen.transport.sequences import simulate_sequence
from datagen.transport.simulate import simulate, transient_of

__all__ = ["simulate", "simulate_sequence", "transient_of"]
