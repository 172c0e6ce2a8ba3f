"""The section `capture`: scan, field of view, pairing, time axis."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field, model_validator

from datagen.config.base import Settings
from datagen.records import TimeAxis

Count = Annotated[int, Field(ge=1, le=65536)]
Metres = Annotated[float, Field(gt=0, le=1e5)]
Point = tuple[float, float, float]


class GridScan(Settings):
    """Laser targets on a regular grid centred on the visible part of the relay wall."""

    kind: Literal["grid"] = "grid"
    rows: Count = 16
    """Laser points from top to bottom."""
    columns: Count = 16
    """Laser points from left to right, as seen from the room."""
    width_m: Metres | None = None
    """Distance between the first and last column; left out: 80 % of the visible width."""
    height_m: Metres | None = None
    """Distance between the first and last row; left out: 80 % of the visible height."""


class FieldOfView(Settings):
    """What the pixels see: squares around the laser points (confocal), or a grid on the wall (exhaustive)."""

    rows: Count = 1
    """Pixel rows (exhaustive pairing only)."""
    columns: Count = 1
    """Pixel columns (exhaustive pairing only)."""
    width_m: Metres | None = None
    """Width on the wall: of one pixel (confocal), or of the whole grid (exhaustive).
    Left out: 0.05 m (confocal), 80 % of the visible width (exhaustive)."""
    height_m: Metres | None = None
    """Height likewise."""
    aperture_radius_mm: Annotated[float, Field(gt=0, le=1e4)] = 20.0
    """Radius of the round entrance aperture."""


class TimeConfig(Settings):
    """The time bins of transient and histogram."""

    bins: Annotated[int, Field(ge=1, le=1_000_000)] = 512
    bin_width_ps: Annotated[float, Field(gt=0, le=1e9)] = 100.0
    start_ns: float = 0.0
    """Start of the first bin."""
    origin: Literal["source", "wall"] = "wall"
    """`source` counts from laser emission (both device legs included), `wall` from laser point to FoV point."""

    def axis(self) -> TimeAxis:
        """The time axis in seconds."""
        return TimeAxis(self.bins, self.bin_width_ps * 1e-12, self.start_ns * 1e-9, self.origin)


class CaptureConfig(Settings):
    """How each scene is measured."""

    pairing: Literal["confocal", "exhaustive"] = "confocal"
    """`confocal`: pixel i looks at laser point i; `exhaustive`: every pixel for every laser point."""
    scan: GridScan = GridScan()
    field_of_view: FieldOfView = FieldOfView()
    time: TimeConfig = TimeConfig()
    laser_position_m: Point | None = None
    """(x, y, z) of the laser; left out: where the scene puts the device."""
    sensor_position_m: Point | None = None
    """(x, y, z) of the sensor; left out: where the scene puts the device."""

    @model_validator(mode="after")
    def _confocal_has_one_pixel(self) -> CaptureConfig:
        view = self.field_of_view
        if self.pairing == "confocal" and view.rows * view.columns != 1:
            raise ValueError(
                f"field_of_view: {view.rows} × {view.columns} pixels with pairing 'confocal', which has one pixel "
                "a laser point; leave rows and columns out or set pairing: exhaustive"
            )
        return self
