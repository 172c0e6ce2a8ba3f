"""What is stated of an imported dataset: which files it was read from, and what was said of them."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from datagen.config.base import Settings

Metres = Annotated[float, Field(gt=0, le=1e5)]


class ImportedFile(Settings):
    """One file that was read."""

    name: Annotated[str, Field(min_length=1, max_length=1000)]
    """Without its folder."""
    sha256: Annotated[str, Field(pattern=r"^[0-9a-f]{64}$")]
    format: Literal["tal", "mat"]


class ImportOptions(Settings):
    """What the options of `datagen import` said where a file did not, or of which part of it is kept."""

    bin_width_ps: Annotated[float, Field(gt=0, le=1e9)] | None = None
    """Width of a time bin, of files that do not say it."""
    wall_m: tuple[Metres, Metres] | None = None
    """Width and height of a grid from its first to its last point, of files that do not say it."""
    axes: Literal["xyt", "yxt", "txy", "tyx"] | None = None
    """Order of the axes of a grid in a MATLAB file, where it is another than its variable's usual one."""
    delays: ImportedFile | Literal["none"] | None = None
    """Where `tofgrid` is, the light's way to the wall and back at each point; `none`: there is none to take off."""
    bins: Annotated[int, Field(ge=1, le=1_000_000)] | None = None
    """Keep so many of the first time bins."""
