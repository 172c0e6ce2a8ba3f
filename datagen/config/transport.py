"""The section `transport`: which light is simulated, and how accurately."""

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import Field

from datagen.config.base import Settings
from datagen.errors import InputError
from datagen.records import Accuracy
from datagen.records.accuracy import LIMITS, MAX_BOUNCES, TARGETS


def _within(name: str) -> Any:
    """pydantic's form of the limits of a number of `Accuracy`."""
    low, high = LIMITS.get(name, TARGETS)
    return Field(ge=low, le=high)


class TransportConfig(Settings):
    """Sample counts and effects; see `datagen.Accuracy`."""

    lookins: Annotated[int, _within("lookins")] = int(Accuracy.lookins)
    """Rays from each laser point into the scene: the number of hidden vertices."""
    fov_samples: Annotated[int, _within("fov_samples")] = int(Accuracy.fov_samples)
    """FoV points that each vertex of a light path connects to, per pixel."""
    max_bounces: Annotated[int, Field(ge=3, le=MAX_BOUNCES)] | None = Accuracy.max_bounces
    """Highest number of bounces; 3 is the primary, 4 adds the secondary; null: all."""
    replicates: Annotated[int, _within("replicates")] = int(Accuracy.replicates)
    """Independent randomisations, from which the standard error comes."""
    observed: Annotated[int, _within("observed")] | None = None
    """Second hidden vertices for each hidden vertex: the secondary in the factorised form; left out: by path
    tracing."""
    secondary: Literal["all", "none", "strongest"] | Annotated[int, Field(ge=1)] = "all"
    """All secondary paths, none, or only the strongest (or k strongest) of each hidden vertex, which needs
    `observed`."""
    direct: bool = False
    """Also simulate the direct return (1 and 2 bounces), which a gated measurement keeps out. True unless
    given with a `capture.device` that lights all at once, which looks straight at things."""
    target: Annotated[float, _within("target")] | None = None
    """Largest relative L2 error of each transient: then the sample counts are chosen, and may not be given."""
    part_target: Annotated[float, _within("part_target")] | None = None
    """With `target`: largest relative L2 error of each object's own primary; left out: 2.5 times the target, at most
    1."""
    max_lookins: Annotated[int, _within("max_lookins")] = Accuracy.max_lookins
    """With `target`: give up before more rays than this, over all components, leave the average laser point."""

    def accuracy(self) -> Accuracy:
        """The record of this section that `simulate` takes."""
        return Accuracy(**{name: getattr(self, name) for name in self.changed()})

    def _check(self) -> None:
        try:
            self.accuracy()
        except InputError as error:
            raise ValueError(str(error).replace("Accuracy.", "")) from None
