"""The key `motion` of the capture: how laser and sensor move together while the frames of a sequence are measured."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from datagen.config.base import Settings
from datagen.config.distributions import Distribution, Length, Uniform, within
from datagen.config.scene_motion import MotionPoint, check_times


class Hand(Settings):
    """Held in a hand: place and direction sway smoothly about those of a sensor that stands."""

    kind: Literal["hand"] = "hand"
    sway_mm: Annotated[Distribution, within(0, 1000)] = 8.0
    """Greatest distance from its place."""
    sway_deg: Annotated[Distribution, within(0, 45)] = 1.0
    """Greatest angle by which it is turned, about any axis."""
    fastest_hz: Annotated[Distribution, within(0, 1000, open_low=True)] = 3.0
    """It sways with this and lower frequencies only."""


class Drive(Settings):
    """Straight on and level, as on a robot, from where a sensor stands; it keeps looking in the same direction."""

    kind: Literal["drive"] = "drive"
    speed_m_s: Annotated[Distribution, within(0, 1000)] = Uniform(uniform=(0.2, 0.5))
    """Speed, drawn once for each scene."""
    bearing_deg: Annotated[Distribution, within(-360, 360)] = Uniform(uniform=(0.0, 360.0))
    """Where it drives to: 0 along the relay wall, to the right of somebody who faces it, 90 towards the wall. Drawn
    anew until the way is free."""


class SensorPoint(MotionPoint):
    """A place of the sensor, and when it is reached."""

    height_m: Length | None = None
    """Height above the floor. Left out: that of the point before, and of the first point that of a sensor that
    stands."""
    rotation_deg: Annotated[Distribution, within(-3600, 3600)] | None = None
    """Rotation about the vertical, counter-clockwise as seen from above, from the direction of a sensor that stands.
    Left out: that of the point before, and of the first point 0."""


class SensorPoints(Settings):
    """Through places that are given with their times: straight between them, and standing before the first and after
    the last."""

    kind: Literal["points"] = "points"
    points: Annotated[tuple[SensorPoint, ...], Field(min_length=1, max_length=10_000)]
    """The places, by time."""

    def _check(self) -> None:
        check_times(self.points)


class GivenPlaces(Settings):
    """Captures that were made in Python, one for each frame. Written by `build_from`; no dataset can be built with
    it."""

    is_offered = False

    kind: Literal["given"] = "given"


DrawnMotion = Hand | Drive | SensorPoints
SensorMotion = Annotated[DrawnMotion | GivenPlaces, Field(discriminator="kind")]
