"""The origin of an imported dataset: its files, and what the options of `datagen import` state about them."""

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import Field, SerializerFunctionWrapHandler, model_serializer

from datagen.config.base import Settings, without_unset
from datagen.config.scans import Metres


class ImportedFile(Settings):
    """One file that was read."""

    name: Annotated[str, Field(min_length=1, max_length=1000)]
    """Name of the file, without its folder."""
    sha256: Annotated[str, Field(pattern=r"^[0-9a-f]{64}$")]
    format: Literal["tal", "mat", "numpy", "frames"]
    frames: Annotated[int, Field(ge=1)] | None = None
    """How many frames the file holds, each a scene. None: the file is one scene."""
    taken: Annotated[str, Field(max_length=2000)] | None = None
    """What the import took for the file's layout, axes, units, time zero and wall."""
    labels: dict[str, str | int | float] | None = None
    """What the names of the file and its folders, and the file of places, say of what is hidden."""

    @model_serializer(mode="wrap")
    def _plain(self, plain: SerializerFunctionWrapHandler) -> dict[str, Any]:
        return without_unset(self, plain, "taken", "labels")


class ImportOptions(Settings):
    """What the options of `datagen import` state where a file does not, and how much of a file is kept."""

    bin_width_ps: Annotated[float, Field(gt=0, le=1e9)] | None = None
    """Width of a time bin, for files that do not state it."""
    wall_m: tuple[Metres, Metres] | None = None
    """Width and height of a grid from its first to its last point, for files that do not state them."""
    axes: Annotated[str, Field(pattern=r"^[fyxtc]{3,5}$")] | None = None
    """Order of the axes of a grid, where it is another than its variable's usual one: y and x (the grid), t (time), f
    (frames), c (channels, which are added up)."""
    delays: ImportedFile | Literal["none"] | None = None
    """The file with `tofgrid`, the time from the laser to each point and back to the sensor; `none`: times do not
    include it."""
    bins: Annotated[int, Field(ge=1, le=1_000_000)] | None = None
    """How many of the first time bins are kept; left out: all."""
    variable: Annotated[str, Field(min_length=1, max_length=200)] | None = None
    """The array of a grid, in files of no layout that is known."""
    laser: Literal["confocal"] | tuple[float, float, float] | None = None
    """Where the laser points of a grid are, for files that do not state it: at the point that is looked at
    (`confocal`), or all at one place, metres in the frame of the wall."""
    points: ImportedFile | None = None
    """The file with the places of the points of a grid."""
    start_ns: Annotated[float, Field(ge=0, le=1e9)] | None = None
    """Time at which the first bin begins, for files that do not state it."""

    @model_serializer(mode="wrap")
    def _plain(self, plain: SerializerFunctionWrapHandler) -> dict[str, Any]:
        return without_unset(self, plain, "variable", "laser", "points", "start_ns")
