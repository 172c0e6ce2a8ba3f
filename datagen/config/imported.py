"""The origin of an imported dataset: its files, and what the options of `datagen import` state about them."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from datagen.config.base import Settings
from datagen.config.scans import Metres


class ImportedFile(Settings):
    """One file that was read."""

    name: Annotated[str, Field(min_length=1, max_length=1000)]
    """Name of the file, without its folder."""
    sha256: Annotated[str, Field(pattern=r"^[0-9a-f]{64}$")]
    format: Literal["tal", "mat", "frames"]
    frames: Annotated[int, Field(ge=1)] | None = None
    """Of frames of a sensor: how many the file holds, each a scene. None: the file is one scene."""


class ImportOptions(Settings):
    """What the options of `datagen import` state where a file does not, and how much of a file is kept."""

    bin_width_ps: Annotated[float, Field(gt=0, le=1e9)] | None = None
    """Width of a time bin, for files that do not state it."""
    wall_m: tuple[Metres, Metres] | None = None
    """Width and height of a grid from its first to its last point, for files that do not state them."""
    axes: Literal["xyt", "yxt", "txy", "tyx"] | None = None
    """Order of the axes of a grid in a MATLAB file, where it is another than its variable's usual one."""
    delays: ImportedFile | Literal["none"] | None = None
    """The file with `tofgrid`, the time from the laser to each point and back to the sensor; `none`: times do not
    include it."""
    bins: Annotated[int, Field(ge=1, le=1_000_000)] | None = None
    """How many of the first time bins are kept; left out: all."""
