"""Light transport: from a scene and a capture to the transient."""

from datagen.transport.solver import simulate

__all__ = ["simulate"]
