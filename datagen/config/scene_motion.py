"""The key `motion` of an object: how it moves while the frames of a sequence are measured."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from typing import Annotated, Literal

from pydantic import Field

from datagen.config.base import Settings
from datagen.config.distributions import Distribution, Fraction, Length, Uniform, within

Speed = Annotated[Distribution, within(0, 1000)]
Turning = Annotated[Distribution, within(-3600, 3600)]


class Walk(Settings):
    """Straight legs between random places, front first: at the end of a leg the object turns on the spot towards the
    next one. `rotation_deg` follows from the first leg."""

    kind: Literal["walk"] = "walk"
    speed_m_s: Annotated[Distribution, within(0, 1000, open_low=True)] = Uniform(uniform=(0.5, 1.5))
    """Speed on the legs, drawn once for each object of a scene."""
    leg_m: Length = Uniform(uniform=(0.5, 2.5))
    """Length of a leg, drawn for every leg; legs that do not fit into the room are drawn anew, so long ones are rarer
    than declared in a small room."""
    turning_deg_s: Annotated[Distribution, within(0, 3600, open_low=True)] = 180.0
    """Speed of turning on the spot, drawn once for each object of a scene."""


class Straight(Settings):
    """A straight line in a random direction, with constant speed and turning."""

    kind: Literal["straight"] = "straight"
    speed_m_s: Speed = Uniform(uniform=(0.5, 1.5))
    """Speed."""
    turning_deg_s: Turning = 0.0
    """Turning about the vertical, counter-clockwise as seen from above."""


class MotionPoint(Settings):
    """A place on the way, and when it is reached."""

    time_s: Annotated[float, Field(ge=0, le=1e6)]
    """Seconds since the first frame began."""
    along: Fraction | None = None
    """Position within the hidden part: 0 farthest from the relay wall's plane, 1 in it."""
    across: Fraction | None = None
    """Position within the hidden part: 0 on the side it is entered from, 1 on the far side."""
    distance_m: Length | None = None
    """Distance from the relay wall's plane, in place of `along`."""
    offset_m: Annotated[Distribution, within(-1000, 1000)] | None = None
    """Distance to the right of the middle of the relay wall's visible part, for somebody who faces the wall, in place
    of `across`."""
    rotation_deg: Annotated[Distribution, within(-3600, 3600)] | None = None
    """Rotation about the vertical; from 350 to 370 the object turns by 20 degrees. Left out: that of the point
    before, and of the first point the object's `rotation_deg`."""

    def _check(self) -> None:
        for key, other in (("along", "distance_m"), ("across", "offset_m")):
            if (getattr(self, key) is None) == (getattr(self, other) is None):
                raise ValueError(f"{key}, {other}: one of them is needed, and only one of them can hold")


def check_times(points: Sequence[MotionPoint]) -> None:
    """Raise `ValueError` for points whose times do not increase."""
    for k, (before, point) in enumerate(pairwise(points)):
        if point.time_s <= before.time_s:
            raise ValueError(
                f"points[{k + 1}].time_s = {point.time_s:g} after {before.time_s:g}: times must increase; sort "
                "the points"
            )


class Points(Settings):
    """A way through places that are given with their times: straight between them, and standing before the first and
    after the last."""

    kind: Literal["points"] = "points"
    points: Annotated[tuple[MotionPoint, ...], Field(min_length=1, max_length=10_000)]
    """The places, by time."""

    def _check(self) -> None:
        check_times(self.points)


class Jump(Settings):
    """Another free place in each frame, drawn as the first one, where the object stands until the next frame."""

    kind: Literal["jump"] = "jump"


Motion = Annotated[Walk | Straight | Points | Jump, Field(discriminator="kind")]
