"""The section `capture`: scan, field of view, pairing, time axis."""

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import BeforeValidator, Field, SerializerFunctionWrapHandler, ValidationInfo, model_serializer

from datagen.config.base import Settings, folder_of, from_plain, is_stored, named_file, without_unset
from datagen.config.capture_motion import SensorMotion, SensorPoints
from datagen.config.device import DeviceConfig, read_device
from datagen.config.distributions import Distribution, Length, Uniform, within
from datagen.config.scans import AnyScan, Coordinate, GridScan, Metres, Place, PointCount
from datagen.records import TimeAxis

Point = tuple[Coordinate, Coordinate, Coordinate]
LARGEST_FLOOD = 2**28
"""Largest number of values (points × pixels × bins) of a flood before its points are summed: 2 GiB, just enough for
64 × 64 points, 8 × 8 pixels and 1024 bins."""


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
    """The time bins of the transient, and of the histogram unless the sensor merges bins."""

    bins: Annotated[int, Field(ge=1, le=1_000_000)] = 512
    bin_width_ps: Annotated[float, Field(gt=0, le=1e9)] = 100.0
    start_ns: float = 0.0
    """Start of the first bin."""
    origin: Literal["source", "wall"] = "wall"
    """`source` counts from laser emission (both device legs included), `wall` from laser point to FoV point."""

    @classmethod
    def of(cls, axis: TimeAxis) -> TimeConfig:
        """The settings of a time axis, rounded to twelve digits: further ones come from the conversion of units."""
        width, start = (float(f"{value:.12g}") for value in (axis.width_s * 1e12, axis.start_s * 1e9))
        return cls(bins=axis.bins, bin_width_ps=width, start_ns=start, origin=axis.origin)

    def axis(self) -> TimeAxis:
        """The time axis in seconds."""
        return TimeAxis(self.bins, self.bin_width_ps * 1e-12, self.start_ns * 1e-9, self.origin)

    def merged(self, bins: int) -> TimeConfig:
        """The axis on which each run of so many bins is one bin."""
        return self.model_copy(update={"bins": self.bins // bins, "bin_width_ps": self.bin_width_ps * bins})


def _named_device(value: Any, info: ValidationInfo) -> Any:
    """The device of a name, of a file's path, or of plain values."""
    if isinstance(value, str):
        named_file(info, value)
        return read_device(value, DeviceConfig, folder_of(info))
    if not isinstance(value, dict):
        return value
    return from_plain(DeviceConfig, value, "device", folder_of(info), look_for_files=not is_stored(info))


NamedDevice = Annotated[DeviceConfig, BeforeValidator(_named_device, json_schema_input_type=str | DeviceConfig)]


class AtObjects(Settings):
    """The device stands inside the hidden part and looks straight at an object, one that is drawn for every scene."""

    share: Annotated[float, Field(gt=0, le=1)] = 1.0
    """Share of the scenes in which it does. In the others it looks at the relay wall from where the layout
    puts it."""
    distance_m: Length = Uniform(uniform=(0.4, 1.5))
    """From the device to the middle of the object."""
    height_m: Length = Uniform(uniform=(0.3, 1.5))
    """Height of the device; moved towards that of the object's middle where it would lie more than 45° above or below
    it."""
    aside_deg: Annotated[Distribution, within(-60, 60)] = Uniform(uniform=(-10.0, 10.0))
    """By how much the device looks to the left of the object's middle."""


class CaptureConfig(Settings):
    """How each scene is measured."""

    device: NamedDevice | None = None
    """A sensor with its light: a name of the catalogue (`datagen device`), or a device file (.yaml) relative to the
    configuration's folder. Pairing, illumination, scan, field of view, time axis and the laser's place then follow
    from it. A dataset stores the whole device here."""
    at_objects: AtObjects | None = None
    """Of a device: it looks straight at objects. Left out: at the middle of the visible relay wall."""
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
    motion: SensorMotion | None = None
    """How laser and sensor move, as one rigid thing, from frame to frame of a `sequence`; within a frame they stand.
    Left out: they stand in all frames."""

    @model_serializer(mode="wrap")
    def _plain(self, plain: SerializerFunctionWrapHandler) -> dict[str, Any]:
        return without_unset(self, plain, "motion")

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
        return self.illumination == "flood" and isinstance(scan, GridScan) and not own and self.device is None

    def _fill_from_device(self) -> None:
        """Fill in what follows from a device. A stored configuration states it as well, so the same is accepted."""
        if self.device is None:
            if self.at_objects is not None:
                raise ValueError("at_objects without device: only a device looks straight at objects; name one")
            return
        for name, value in _of_device(self.device).items():
            if name in self.model_fields_set and getattr(self, name) != value:
                raise ValueError(
                    f"{name} beside device {self.device.name!r}: follows from the device; leave it out, or write a "
                    "device file with another one"
                )
            object.__setattr__(self, name, value)

    def _check(self) -> None:
        self._fill_from_device()
        view, is_confocal, is_flood = self.field_of_view, self.pairing == "confocal", self.illumination == "flood"
        grid = [name for name in view.changed() if name in ("rows", "columns", "center_m")]
        if is_confocal and grid:
            raise ValueError(
                f"field_of_view.{grid[0]} with pairing 'confocal', which has one pixel around each laser point: "
                "leave it out, or set pairing: exhaustive"
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
        self._only_one_of("laser_position_m", "laser_offset_m")
        self._only_one_of("sensor_position_m", "sensor_offset_m", "at_objects")
        self._only_one_of("at_objects", "sensor_offset_m")
        if self.at_objects is not None and isinstance(self.motion, SensorPoints):
            raise ValueError(
                "at_objects beside motion.kind = 'points': both say where the device is; leave one of them out"
            )


def _of_device(device: DeviceConfig) -> dict[str, Any]:
    """Key of `capture` that follows from a device → its value."""
    zones, light, axis = device.zones, device.light, device.axis
    rows, columns = (zones.rows, zones.columns) if not zones.boxes else (1, zones.count)
    if light.confocal:
        rows = columns = 1
    return {
        "pairing": device.pairing,
        "illumination": "flood" if device.is_flood else "scan",
        "scan": GridScan(rows=light.rows, columns=light.columns),
        "field_of_view": FieldOfView(rows=rows, columns=columns, aperture_radius_mm=zones.aperture_radius_mm),
        "time": TimeConfig(bins=axis.bins, bin_width_ps=axis.width_s * 1e12, start_ns=axis.start_s * 1e9,
                           origin="source"),
        # Both move with the sensor's keys: the device's light.baseline_mm says where its laser is.
        "laser_position_m": None,
        "laser_offset_m": None,
    }  # fmt: skip
