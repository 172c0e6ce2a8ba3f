"""Light transport: from a scene and a capture to the transient."""

from datagen.transport.simulate import simulate, transient_of

__all__ = ["simulate", "transient_of"]
