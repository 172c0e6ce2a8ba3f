"""The key `scene.layout`: which kind of room, and how its dimensions are drawn.

`scene_library/layouts.py` draws each kind: its functions take these dimensions.
"""

from __future__ import annotations

from typing import Annotated, Any, ClassVar, Literal

from pydantic import Field, SerializerFunctionWrapHandler, model_serializer

from datagen.config.base import Settings, without_unset
from datagen.config.distributions import Distribution, Fraction, Length, Uniform, within
from datagen.config.imported import ImportedFile, ImportOptions
from datagen.config.scene_relay import RelayWall


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
        {"kind", "place", "turn", "floor", "ceiling", "out_of_square_deg", "relay_wall"}
    )
    """Keys that are no dimensions of the plan."""

    def dimensions(self) -> dict[str, Distribution]:
        """The dimensions to draw, in their declared order, without those that are left out."""
        drawn = {name: getattr(self, name) for name in type(self).model_fields if name not in self.choices}
        return {name: value for name, value in drawn.items() if value is not None}

    @property
    def plan(self) -> str:
        """Name of the floor plan in `scene_library.layouts.PLANS`."""
        return str(getattr(self, "kind", ""))


class Closed(Layout):
    """Layouts with walls all around."""

    out_of_square_deg: Annotated[Distribution, within(-15, 15)] = 0.0
    """Every wall but the relay wall is rotated by an angle of its own, drawn from this."""


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


class LCorridor(Corridor):
    """A corridor to the relay wall; before its end a room opens to one side, behind the inner corner."""

    kind: Literal["l_corridor"] = "l_corridor"
    room_length_m: Length = Uniform(uniform=(2.5, 4.0))
    """From the relay wall back to the inner corner."""
    room_width_m: Length = Uniform(uniform=(3.0, 5.0))
    """From the corridor to the far wall of the room."""


class TCorridor(Corridor):
    """A corridor that meets a cross corridor, whose far side is the relay wall; both arms are hidden."""

    kind: Literal["t_corridor"] = "t_corridor"
    arm_width_m: Length = Uniform(uniform=(1.8, 3.0))
    """From the relay wall back to the corners."""
    left_arm_m: Length = Uniform(uniform=(3.0, 5.0))
    """Length of the arm on the side of `turn`."""
    right_arm_m: Length = Uniform(uniform=(3.0, 5.0))
    """Length of the other arm."""


class ZCorridor(Corridor):
    """Two bends: the corridor to the relay wall, a hidden middle leg to the side, a last leg beyond the wall."""

    kind: Literal["z_corridor"] = "z_corridor"
    middle_width_m: Length = Uniform(uniform=(1.8, 3.0))
    """From the relay wall back to the inner corner."""
    middle_length_m: Length = Uniform(uniform=(4.0, 6.0))
    last_width_m: Length = Uniform(uniform=(1.4, 2.2))
    last_length_m: Length = Uniform(uniform=(1.0, 4.0))


class CorridorRoom(Corridor):
    """A corridor that opens into a wider room, whose far wall is the relay wall."""

    kind: Literal["corridor_room"] = "corridor_room"
    room_length_m: Length = Uniform(uniform=(3.0, 4.5))
    """From the relay wall back to the corridor's end."""
    room_width_m: Length = Uniform(uniform=(5.0, 8.0))
    opening_offset: Fraction = Uniform(uniform=(0.2, 0.8))
    """Where the corridor enters: 0 puts all of the room on the side of `turn`, 1 on the other."""


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


NEAR_THE_WALL = Uniform(uniform=(0.3, 0.5))
"""Default distance of the device from the relay wall's plane with place `in_front`: nearer than the objects."""
BESIDE_ONLY = ("device_offset", "screen_to_wall_m", "screen_offset_m", "space_width_m", "space_back_m")
IN_FRONT_ONLY = ("beside_m", "space_depth_m")
"""Keys that have a meaning with one `place` only; a configuration with the other place does not have them."""


class IsolatedWall(Layout):
    """The classic bench: a relay wall in free space, and objects hidden from the device by a screen: beside the wall,
    or in front of it."""

    kind: Literal["isolated_wall"] = "isolated_wall"
    place: Literal["beside", "in_front"] = "beside"
    """`beside`: objects stand beside the wall, and the device before it. `in_front`: objects stand in a box before
    the wall, as wide and high as it is, and the device beside that box and nearer to the wall than any of them."""
    floor: bool = False
    ceiling: bool = False
    relay_distance_m: Length = Uniform(uniform=(2.5, 4.0))
    """From the device straight ahead to the plane of the relay wall; in_front, 0.3 to 0.5 m where left out."""
    height_m: Length = Uniform(uniform=(2.0, 2.6))
    device_height_m: Length = Uniform(uniform=(0.8, 1.4))
    wall_width_m: Length = Uniform(uniform=(2.0, 3.0))
    screen_to_wall_m: Length = Uniform(uniform=(1.5, 2.2))
    """From the relay wall back to the end of the screen; beside alone."""
    screen_offset_m: Length = Uniform(uniform=(0.2, 0.5))
    """From the line of sight to the screen; beside alone."""
    space_width_m: Length = Uniform(uniform=(2.0, 3.0))
    """From the screen to the far side of the space that holds the objects; beside alone."""
    space_back_m: Length | None = None
    """From the end of the screen back to the far side of that space; beside alone. Left out, objects stand between
    the relay wall and the end of the screen, and none beside the screen."""
    beside_m: Length = Uniform(uniform=(0.8, 1.2))
    """How far to the side of the wall's nearer end the device stands; in_front alone."""
    space_depth_m: Length = Uniform(uniform=(1.8, 2.4))
    """From the relay wall to the far side of the box that holds the objects; in_front alone."""

    def _check(self) -> None:
        for name in self.changed():
            if name in self._keys_of_the_other:
                raise ValueError(f"{name} with place = {self.place!r}: has no meaning there; leave it out")
        if self.place == "in_front" and "relay_distance_m" not in self.model_fields_set:
            # A default that follows from another key. The frozen model may still change, since nobody has it yet.
            object.__setattr__(self, "relay_distance_m", NEAR_THE_WALL)

    @model_serializer(mode="wrap")
    def _plain(self, plain: SerializerFunctionWrapHandler) -> dict[str, Any]:
        return without_unset(self, plain, "space_back_m")

    @property
    def _keys_of_the_other(self) -> tuple[str, ...]:
        return IN_FRONT_ONLY if self.place == "beside" else BESIDE_ONLY

    @property
    def plan(self) -> str:
        """As for every layout."""
        return self.kind if self.place == "beside" else f"{self.kind}, in_front"

    def dimensions(self) -> dict[str, Distribution]:
        """As for every layout, those of its place."""
        return {name: value for name, value in super().dimensions().items() if name not in self._keys_of_the_other}


class NoLayout(Layout):
    """Layouts of datasets whose rooms cannot be drawn. What makes such a dataset writes them; no user gives them."""

    is_offered = False
    why: ClassVar[str]
    """Why there is no room to draw, as a whole clause."""


class GivenScenes(NoLayout):
    """Scenes that were made in Python. Written by `build_from`; no dataset can be built with it."""

    why = "these scenes were made in Python, and cannot be drawn again here"

    kind: Literal["given"] = "given"
    digest: Annotated[str, Field(pattern=r"^[0-9a-f]{64}$")]
    """SHA-256 of the scenes and captures."""
    classes: tuple[str, ...] = ()
    """Classes of all objects, sorted."""
    most_objects: Annotated[int, Field(ge=1, le=10_000)] = 1
    """Largest number of objects in one scene."""


class ImportedCaptures(NoLayout):
    """Captures of another program or of a laboratory. Written by `datagen import`; no dataset can be built with
    it."""

    why = "these captures were imported, and have no room to draw"
    classes: ClassVar[tuple[str, ...]] = ()
    most_objects: ClassVar[int] = 1

    kind: Literal["imported"] = "imported"
    files: Annotated[tuple[ImportedFile, ...], Field(min_length=1)]
    """The files in the order of their scenes: one scene a file, or one for each of its frames."""
    options: ImportOptions = ImportOptions()
    """What the options of `datagen import` state where the files do not."""
    detector_is_known: bool = False
    """Whether the section `detector` describes the detector of these captures; False: it holds defaults."""


AnyLayout = Annotated[
    StraightCorridor | LCorridor | TCorridor | ZCorridor | CorridorRoom | DoorwayRoom | IsolatedWall | GivenScenes
    | ImportedCaptures,
    Field(discriminator="kind"),
]  # fmt: skip
