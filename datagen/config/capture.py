"""The section `capture`: scan, field of view, pairing, time axis."""

from __future__ import annotations

from typing import Annotated, Literal, Self

from pydantic import Field, model_validator

from datagen.config.base import Settings
from datagen.config.scans import AnyScan, Coordinate, GridScan, Metres, Place, PointCount
from datagen.records import TimeAxis

Point = tuple[Coordinate, Coordinate, Coordinate]
LARGEST_FLOOD = 2**28
"""Largest number of values (points × pixels × bins) of a flood before its points are summed: 2 GiB. Half of it would
refuse a flood of 64 × 64 points, 8 × 8 pixels and 1024 bins."""


class FieldOfView(Settings):
    """What the pixels see: squares around the laser points (confocal), or a grid on the wall (exhaustive)."""

    rows: PointCount = 1
    """Pixel rows (exhaustive pairing only)."""
    columns: PointCount = 1
    """Pixel columns (exhaustive pairing only)."""
    width_m: Metres | None = None
    """Width on the wall: of one pixel (confocal), or of the whole grid (exhaustive).
    Left out: 0.05 m (confocal), 80 % of the visible width (exhaustive)."""
    height_m: Metres | None = None
    """Height likewise."""
    center_m: Place | None = None
    """Middle of the grid (exhaustive pairing only): (right, up) from the middle of the visible relay wall, or
    (x, y, z) on it. Left out: that middle."""
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
    illumination: Literal["scan", "flood"] = "scan"
    """`scan`: one laser point after the other; `flood`: all at once with equal shares of the light, as one wide beam,
    so there is one histogram a pixel. The scan's points then are the beam's quadrature: those of a grid are the
    midpoints of equal cells, which fill the field of view unless the scan has a size or a place of its own."""
    scan: AnyScan = GridScan()
    """Where the laser points are: a grid, or of another `kind`."""
    field_of_view: FieldOfView = FieldOfView()
    time: TimeConfig = TimeConfig()
    laser_position_m: Point | None = None
    """(x, y, z) of the laser; left out: where the scene puts the device."""
    sensor_position_m: Point | None = None
    """(x, y, z) of the sensor; left out: where the scene puts the device."""
    laser_offset_m: Point | None = None
    """From where the scene puts the device to the laser, along x (ahead), y (left) and z (up)."""
    sensor_offset_m: Point | None = None
    """From where the scene puts the device to the sensor, likewise."""

    @property
    def shape(self) -> tuple[int, int, int]:
        """(laser, pixel, bin) of every transient, known without a scene; confocal: pixel = 1; flood: laser = 1."""
        view = self.field_of_view
        pixels = 1 if self.pairing == "confocal" else view.rows * view.columns
        return 1 if self.illumination == "flood" else self.scan.laser_points, pixels, self.time.bins

    @property
    def flood_fills_view(self) -> bool:
        """Whether a flood's grid has the field of view as its rectangle."""
        scan = self.scan
        own = isinstance(scan, GridScan) and (scan.width_m, scan.height_m, scan.center_m) != (None, None, None)
        return self.illumination == "flood" and isinstance(scan, GridScan) and not own

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        view, is_confocal, is_flood = self.field_of_view, self.pairing == "confocal", self.illumination == "flood"
        if is_confocal and view.rows * view.columns != 1:
            raise ValueError(
                f"field_of_view: {view.rows} × {view.columns} pixels with pairing 'confocal', which has one pixel "
                "a laser point; leave rows and columns out or set pairing: exhaustive"
            )
        if is_confocal and view.center_m is not None:
            raise ValueError(
                f"field_of_view.center_m = {list(view.center_m)}: with pairing 'confocal' the pixels lie around the "
                "laser points; set scan.center_m instead, or pairing: exhaustive"
            )
        if is_flood and is_confocal:
            raise ValueError(
                "illumination = 'flood' with pairing 'confocal': a flood lights all points at once; set pairing: "
                "exhaustive"
            )
        values = self.scan.laser_points * self.shape[1] * self.time.bins
        if is_flood and values > LARGEST_FLOOD:
            raise ValueError(
                f"illumination = 'flood' with {self.scan.laser_points} points × {self.shape[1]} pixels × "
                f"{self.time.bins} bins: {values} values are kept at once, at most {LARGEST_FLOOD} fit (2 GiB); take "
                "fewer of one of them"
            )
        for name in ("rows", "columns") if self.flood_fills_view else ():
            points, pixels = getattr(self.scan, name), getattr(view, name)
            if points % pixels:
                raise ValueError(
                    f"scan.{name} = {points} with illumination 'flood' and field_of_view.{name} = {pixels}: some "
                    f"pixels would get more points of the flood than others; take a multiple of {pixels}"
                )
        for device in ("laser", "sensor"):
            place, offset = getattr(self, f"{device}_position_m"), getattr(self, f"{device}_offset_m")
            if place is not None and offset is not None:
                raise ValueError(
                    f"{device}_position_m = {list(place)} and {device}_offset_m = {list(offset)}: only one of both "
                    "can hold; leave one out"
                )
        return self
