"""Light transport: from a scene and a capture to the transient."""

from datagen.transport.solver import simulate, transient_of

__all__ = ["simulate", "transient_of"]
