"""The section `transport`: which light is simulated, and how accurately."""

from __future__ import annotations

from typing import Annotated, Any

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
    """Accuracy and effects; see `datagen.Accuracy`."""

    target: Annotated[float, _within("target")] | None = None
    """Relative L2 error of each transient that is aimed at; 0.02 if `samples` are not given either."""
    samples: Annotated[int, _within("samples")] | None = None
    """Plain paths of each order for each pair of laser point and pixel, instead of a target."""
    max_bounces: Annotated[int, Field(ge=3, le=MAX_BOUNCES)] | None = Accuracy.max_bounces
    """Highest number of bounces; 3 is the primary, 4 adds the secondary; null: all."""
    direct: bool = False
    """Also simulate the direct return (1 and 2 bounces), which a gated measurement keeps out. With a `capture.device`
    that lights all at once, which looks straight at things, it is true unless it is given."""
    part_target: Annotated[float, _within("part_target")] | None = None
    """With `target`: relative L2 error of each object's own primary that is aimed at; left out: 2.5 times the target,
    at most 1."""

    def accuracy(self) -> Accuracy:
        """The record of this section that `simulate` takes."""
        return Accuracy(**{name: getattr(self, name) for name in type(self).model_fields})

    def _check(self) -> None:
        try:
            self.accuracy()
        except InputError as error:
            raise ValueError(str(error).replace("Accuracy.", "")) from None
