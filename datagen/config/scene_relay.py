"""The key `scene.layout.relay_wall`: a relay wall that is not flat, and things that stand or hang before it."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from datagen.config.base import Settings
from datagen.config.distributions import Count, Distribution, Length, Uniform, within
from datagen.config.scene_materials import SurfaceMaterial

ClutterKind = Literal["pillar", "pipe", "frame", "shelf"]
Within1m = Annotated[Distribution, within(0, 1, open_low=True)]


class Clutter(SurfaceMaterial):
    """Things before the visible part of the relay wall, which laser points and pixels then fall on as well."""

    kinds: Annotated[tuple[ClutterKind, ...], Field(min_length=1)] = ("pillar", "pipe", "frame", "shelf")
    """What to draw from, equally likely: pillars and pipes from floor to ceiling, hanging frames, shelves."""
    count: Count = 0
    """How many."""
    reach_m: Within1m = Uniform(uniform=(0.05, 0.25))
    """How far each stands out from the wall."""
    width_m: Within1m = Uniform(uniform=(0.1, 0.5))
    """Width along the wall; a pipe is as thick as this or `reach_m`, whichever is less."""


class RelayWall(Settings):
    """The shape of the relay wall. Scans, fields of view and labels refer to its nominal plane, that of the flat
    wall; where light meets it is found by rays."""

    kind: Literal["flat", "curved", "corrugated", "bumpy", "stepped"] = "flat"
    """`curved`: a shallow niche; `corrugated`: a sine; `bumpy`: smooth and random; `stepped`: panels of random depth.
    All lie behind the nominal plane, touch it at their highest places, and fade out towards the wall's edges."""
    relief_m: Within1m = Uniform(uniform=(0.01, 0.05))
    """Depth of the deepest places behind the nominal plane."""
    length_m: Length = Uniform(uniform=(0.2, 0.5))
    """Period of the corrugation, correlation length ℓ of the bumps (exp(−r²/2ℓ²)), or side of the panels."""
    ridges: Literal["vertical", "horizontal"] = "vertical"
    """Direction of a corrugated wall's ridges."""
    max_triangles: Annotated[int, Field(ge=200, le=1_000_000)] = 8000
    """Budget of the uneven wall; where it cannot resolve `length_m` the room is drawn again, or refused."""
    clutter: Clutter = Clutter()
