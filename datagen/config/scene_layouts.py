"""The key `scene.layout`: which kind of room, and how its dimensions are drawn."""

from __future__ import annotations

from typing import Annotated, ClassVar, Literal

from pydantic import model_validator

from datagen.config.base import Settings
from datagen.config.distributions import Distribution, Fraction, Length, Uniform, support, within

NonNegative = Annotated[Distribution, within(0)]


class Layout(Settings):
    """What all rooms share. Every dimension is metres and is drawn anew for every scene."""

    turn: Literal["left", "right", "random"] = "random"
    """The side that the hidden part lies on, as seen from the device."""
    relay_distance_m: Length = Uniform(uniform=(5.0, 7.0))
    """From the device straight ahead to the relay wall."""
    height_m: Length = Uniform(uniform=(2.4, 3.2))
    """Floor to ceiling."""
    device_height_m: Length = Uniform(uniform=(0.8, 1.6))
    """Height of laser and sensor above the floor."""
    device_offset: Annotated[Distribution, within(0.02, 0.98)] = Uniform(uniform=(0.35, 0.65))
    """Where the device stands across the corridor: 0 at the closed side, 1 at the side of the hidden part."""

    choices: ClassVar[frozenset[str]] = frozenset({"kind", "turn", "floor", "ceiling"})
    """Keys that are no dimensions."""

    def dimensions(self) -> dict[str, Distribution]:
        """The dimensions to draw, in their declared order."""
        return {name: getattr(self, name) for name in type(self).model_fields if name not in self.choices}

    @model_validator(mode="after")
    def _device_below_ceiling(self) -> Layout:
        self._less("device_height_m", "height_m", "no room is higher than the device; lower the first")
        return self

    def _less(self, small: str, large: str, reason: str) -> None:
        """Refuse when not even the smallest `small` is below the largest `large`."""
        least, most = support(getattr(self, small))[0], support(getattr(self, large))[1]
        if least >= most:
            raise ValueError(f"{small} ≥ {least:g} with {large} ≤ {most:g}: {reason} or raise {large}")


class LCorridor(Layout):
    """A corridor to the relay wall; before its end a room opens to one side, behind the inner corner."""

    kind: Literal["l_corridor"] = "l_corridor"
    corridor_width_m: Length = Uniform(uniform=(1.6, 2.4))
    corridor_behind_m: Length = Uniform(uniform=(0.5, 2.0))
    """Corridor behind the device."""
    room_length_m: Length = Uniform(uniform=(2.5, 4.0))
    """From the relay wall back to the inner corner."""
    room_width_m: Length = Uniform(uniform=(3.0, 5.0))
    """From the corridor to the far wall of the room."""

    @model_validator(mode="after")
    def _corner_before_device(self) -> LCorridor:
        self._less("room_length_m", "relay_distance_m", "the inner corner lies behind the device; lower the first")
        return self

    def largest_hidden_m(self) -> tuple[float, float]:
        """Largest extents of the hidden part, along x and across."""
        return support(self.room_length_m)[1], support(self.room_width_m)[1]


__all__ = ["Fraction", "LCorridor", "Layout", "NonNegative"]
