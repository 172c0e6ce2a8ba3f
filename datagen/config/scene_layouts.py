"""The key `scene.layout`: which kind of room, and how its dimensions are drawn.

What each kind looks like is told in `scene_library/layouts.py`, whose functions take these dimensions.
"""

from __future__ import annotations

from typing import Annotated, ClassVar, Literal, Self

from pydantic import Tag, model_validator

from datagen.config.base import Settings, tag
from datagen.config.distributions import Distribution, Fraction, Length, Uniform, support, within
from datagen.config.scene_kinds import kind_of, unknown_kind
from datagen.config.scene_relay import RelayWall

NonNegative = Annotated[Distribution, within(0)]


class Layout(Settings):
    """What all layouts share. Every dimension is drawn anew for every scene."""

    turn: Literal["left", "right", "random"] = "random"
    """The side that the hidden part lies on, as seen from the device."""
    floor: bool = True
    ceiling: bool = True
    relay_distance_m: Length = Uniform(uniform=(5.0, 7.0))
    """From the device straight ahead to the relay wall."""
    height_m: Length = Uniform(uniform=(2.4, 3.2))
    """Floor to ceiling; in the open, height of relay wall and screen."""
    device_height_m: Length = Uniform(uniform=(0.8, 1.6))
    """Height of laser and sensor above the floor."""
    device_offset: Annotated[Distribution, within(0.02, 0.98)] = Uniform(uniform=(0.35, 0.65))
    """Where the device stands across the corridor: 0 at the side away from the hidden part, 1 at its side."""

    relay_wall: RelayWall = RelayWall()
    """Whether the relay wall is flat, and what stands before it."""

    choices: ClassVar[frozenset[str]] = frozenset(
        {"kind", "turn", "floor", "ceiling", "out_of_square_deg", "relay_wall"}
    )
    """Keys that are no dimensions of the plan."""

    def dimensions(self) -> dict[str, Distribution]:
        """The dimensions to draw, in their declared order."""
        return {name: getattr(self, name) for name in type(self).model_fields if name not in self.choices}

    def largest_hidden_m(self) -> tuple[float, float]:
        """Largest extents of the hidden part, along x and across."""
        raise NotImplementedError

    @model_validator(mode="after")
    def _device_below_ceiling(self) -> Self:
        self._less("device_height_m", "height_m", "no room is higher than the device; lower the first")
        return self

    def _less(self, small: str, large: str, reason: str) -> None:
        """Refuse when not even the smallest `small` is below the largest `large`."""
        least, most = support(getattr(self, small))[0], support(getattr(self, large))[1]
        if least >= most:
            raise ValueError(f"{small} ≥ {least:g} with {large} ≤ {most:g}: {reason} or raise {large}")

    def _largest(self, *names: str) -> float:
        return sum(support(getattr(self, name))[1] for name in names)


class Closed(Layout):
    """Layouts with walls all around."""

    out_of_square_deg: Annotated[Distribution, within(-15, 15)] = 0.0
    """Every wall but the relay wall is turned by an angle of its own, drawn from this."""


class Corridor(Closed):
    """Layouts in which the device stands in a corridor."""

    corridor_width_m: Length = Uniform(uniform=(1.6, 2.4))
    corridor_behind_m: Length = Uniform(uniform=(0.5, 2.0))
    """Corridor behind the device."""


class StraightCorridor(Corridor):
    """A straight corridor with a partition jutting out from one side; behind it is hidden."""

    kind: Literal["straight_corridor"] = "straight_corridor"
    corridor_width_m: Length = Uniform(uniform=(3.0, 4.5))
    device_offset: Annotated[Distribution, within(0.02, 0.98)] = Uniform(uniform=(0.2, 0.4))
    partition_distance_m: Length = Uniform(uniform=(2.0, 3.5))
    """From the relay wall back to the partition."""
    partition_reach: Annotated[Distribution, within(0.05, 0.95)] = Uniform(uniform=(0.4, 0.55))
    """Share of the corridor's width that the partition covers."""
    partition_thickness_m: Length = Uniform(uniform=(0.05, 0.2))

    @model_validator(mode="after")
    def _partition_before_device(self) -> Self:
        self._less("partition_distance_m", "relay_distance_m", "the partition is behind the device; lower the first")
        return self

    def largest_hidden_m(self) -> tuple[float, float]:
        return self._largest("partition_distance_m"), self._largest("corridor_width_m")


class LCorridor(Corridor):
    """A corridor to the relay wall; before its end a room opens to one side, behind the inner corner."""

    kind: Literal["l_corridor"] = "l_corridor"
    room_length_m: Length = Uniform(uniform=(2.5, 4.0))
    """From the relay wall back to the inner corner."""
    room_width_m: Length = Uniform(uniform=(3.0, 5.0))
    """From the corridor to the far wall of the room."""

    @model_validator(mode="after")
    def _corner_before_device(self) -> Self:
        self._less("room_length_m", "relay_distance_m", "the inner corner lies behind the device; lower the first")
        return self

    def largest_hidden_m(self) -> tuple[float, float]:
        return self._largest("room_length_m"), self._largest("room_width_m")


class TCorridor(Corridor):
    """A corridor that meets a cross corridor, whose far side is the relay wall; both arms are hidden."""

    kind: Literal["t_corridor"] = "t_corridor"
    arm_width_m: Length = Uniform(uniform=(1.8, 3.0))
    """From the relay wall back to the corners."""
    left_arm_m: Length = Uniform(uniform=(3.0, 5.0))
    """Length of the arm on the side of `turn`."""
    right_arm_m: Length = Uniform(uniform=(3.0, 5.0))
    """Length of the other arm."""

    @model_validator(mode="after")
    def _corner_before_device(self) -> Self:
        self._less("arm_width_m", "relay_distance_m", "the corners lie behind the device; lower the first")
        return self

    def largest_hidden_m(self) -> tuple[float, float]:
        return self._largest("arm_width_m"), max(self._largest("left_arm_m"), self._largest("right_arm_m"))


class ZCorridor(Corridor):
    """Two bends: the corridor to the relay wall, a hidden middle leg to the side, a last leg beyond the wall."""

    kind: Literal["z_corridor"] = "z_corridor"
    middle_width_m: Length = Uniform(uniform=(1.8, 3.0))
    """From the relay wall back to the inner corner."""
    middle_length_m: Length = Uniform(uniform=(4.0, 6.0))
    last_width_m: Length = Uniform(uniform=(1.4, 2.2))
    last_length_m: Length = Uniform(uniform=(1.0, 4.0))

    @model_validator(mode="after")
    def _corner_before_device(self) -> Self:
        self._less("middle_width_m", "relay_distance_m", "the inner corner lies behind the device; lower the first")
        self._less("last_width_m", "middle_length_m", "the last leg has no room to leave; lower the first")
        return self

    def largest_hidden_m(self) -> tuple[float, float]:
        return self._largest("middle_width_m"), self._largest("middle_length_m")


class CorridorRoom(Corridor):
    """A corridor that opens into a wider room, whose far wall is the relay wall."""

    kind: Literal["corridor_room"] = "corridor_room"
    room_length_m: Length = Uniform(uniform=(3.0, 4.5))
    """From the relay wall back to the corridor's end."""
    room_width_m: Length = Uniform(uniform=(5.0, 8.0))
    opening_offset: Fraction = Uniform(uniform=(0.2, 0.8))
    """Where the corridor enters: 0 puts all of the room on the side of `turn`, 1 on the other."""

    @model_validator(mode="after")
    def _corner_before_device(self) -> Self:
        self._less("room_length_m", "relay_distance_m", "the room's corners lie behind the device; lower the first")
        self._less("corridor_width_m", "room_width_m", "the room is narrower than the corridor; lower the first")
        return self

    def largest_hidden_m(self) -> tuple[float, float]:
        return self._largest("room_length_m"), self._largest("room_width_m")


class DoorwayRoom(Closed):
    """A room seen through a doorway from a hall; the room's far wall is the relay wall."""

    kind: Literal["doorway_room"] = "doorway_room"
    door_width_m: Length = Uniform(uniform=(0.8, 1.1))
    door_height_m: Length = Uniform(uniform=(2.0, 2.2))
    wall_thickness_m: Length = Uniform(uniform=(0.1, 0.25))
    hall_width_m: Length = Uniform(uniform=(2.0, 4.0))
    hall_behind_m: Length = Uniform(uniform=(0.5, 2.0))
    """Hall behind the device."""
    room_length_m: Length = Uniform(uniform=(3.0, 4.5))
    """From the relay wall back to the wall with the doorway."""
    room_width_m: Length = Uniform(uniform=(4.0, 7.0))
    opening_offset: Fraction = Uniform(uniform=(0.2, 0.8))
    """Where the doorway is: 0 puts all of the room on the side of `turn`, 1 on the other."""

    @model_validator(mode="after")
    def _door_fits(self) -> Self:
        self._less("room_length_m", "relay_distance_m", "the doorway lies behind the device; lower the first")
        self._less("door_width_m", "room_width_m", "the doorway is wider than the room; lower the first")
        self._less("door_width_m", "hall_width_m", "the doorway is wider than the hall; lower the first")
        self._less("door_height_m", "height_m", "the doorway is higher than the room; lower the first")
        self._less("device_height_m", "door_height_m", "the device looks at the lintel; lower the first")
        return self

    def largest_hidden_m(self) -> tuple[float, float]:
        return self._largest("room_length_m"), self._largest("room_width_m")


class IsolatedWall(Layout):
    """The classic bench: a relay wall in free space, objects hidden from the device by a screen beside it."""

    kind: Literal["isolated_wall"] = "isolated_wall"
    floor: bool = False
    ceiling: bool = False
    relay_distance_m: Length = Uniform(uniform=(2.5, 4.0))
    height_m: Length = Uniform(uniform=(2.0, 2.6))
    device_height_m: Length = Uniform(uniform=(0.8, 1.4))
    wall_width_m: Length = Uniform(uniform=(2.0, 3.0))
    screen_to_wall_m: Length = Uniform(uniform=(1.5, 2.2))
    """From the relay wall back to the end of the screen."""
    screen_offset_m: Length = Uniform(uniform=(0.2, 0.5))
    """From the line of sight to the screen."""
    space_width_m: Length = Uniform(uniform=(2.0, 3.0))
    """From the screen to the far side of the space that holds the objects."""

    @model_validator(mode="after")
    def _screen_before_device(self) -> Self:
        self._less("screen_to_wall_m", "relay_distance_m", "the screen ends behind the device; lower the first")
        return self

    def largest_hidden_m(self) -> tuple[float, float]:
        return self._largest("screen_to_wall_m"), self._largest("space_width_m", "wall_width_m")


LAYOUT_KINDS = (
    "straight_corridor",
    "l_corridor",
    "t_corridor",
    "z_corridor",
    "corridor_room",
    "doorway_room",
    "isolated_wall",
)
AnyLayout = Annotated[
    Annotated[StraightCorridor, Tag(tag("straight_corridor"))]
    | Annotated[LCorridor, Tag(tag("l_corridor"))]
    | Annotated[TCorridor, Tag(tag("t_corridor"))]
    | Annotated[ZCorridor, Tag(tag("z_corridor"))]
    | Annotated[CorridorRoom, Tag(tag("corridor_room"))]
    | Annotated[DoorwayRoom, Tag(tag("doorway_room"))]
    | Annotated[IsolatedWall, Tag(tag("isolated_wall"))]
    | Annotated[LCorridor, *unknown_kind(*LAYOUT_KINDS)],
    kind_of(*LAYOUT_KINDS),
]
