"""Light transport: from a scene and a capture to the transient."""

from pathlib import Path

from datagen.compiled import drop_stale_kernels
from datagen.transport.solver import simulate, transient_of

__all__ = ["simulate", "transient_of"]

drop_stale_kernels(Path(__file__).parent)
