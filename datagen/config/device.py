"""The key `capture.device`: a sensor that one can buy or that a laboratory built, with its light. What it looks at,
how it lights that, and how it counts.

Directions are tangents of the angle from the sensor's axis, (right, up) as the device sees it. Every number of a
device has its source in `sources`; a source that begins with `estimate` is one, with the reasoning after it.
"""

from __future__ import annotations

from functools import cache
from pathlib import Path
from typing import Annotated, Literal, Self, TypeVar

import numpy as np
from pydantic import Field, ValidationInfo, model_validator

from datagen.config.base import Settings, from_plain, named_file, near_hint
from datagen.config.yaml_text import read_yaml
from datagen.errors import InputError, as_line, shown
from datagen.records import Pairing, TimeAxis
from datagen.records.arrays import Floats
from datagen.records.checks import check_kind, check_path
from datagen.untrusted import one_line, read_npz

FOLDER = Path(__file__).parents[1] / "devices" / "catalogue"
"""Folder of the catalogue."""

Positive = Annotated[float, Field(gt=0)]
NotNegative = Annotated[float, Field(ge=0)]
Box = tuple[float, float, Positive, Positive]


class Zones(Settings):
    """Where the zones (or pixels) look, in the order of the device's histograms."""

    rows: Annotated[int, Field(ge=1, le=4096)] = 1
    """Rows of equal zones that fill `field_deg`, the first at the top."""
    columns: Annotated[int, Field(ge=1, le=4096)] = 1
    """Columns of equal zones, the first at the left."""
    field_deg: tuple[Positive, Positive] | None = None
    """Full width and height of the field of view, degrees."""
    boxes: tuple[Box, ...] = ()
    """Instead of rows, columns and field: (right, up) of each zone's middle, its width and height, in tangents."""
    map: str | None = None
    """Instead of boxes: an .npz file beside the device file, with `weights` (zones, rows, columns) ≥ 0, row 0 at the
    bottom, and `extent` (left, right, bottom, top) in tangents. It is read at once, into `boxes` and `weights`."""
    weights: tuple[tuple[tuple[NotNegative, ...], ...], ...] = ()
    """Sensitivity over each zone's box, (zones, rows, columns), row 0 at the bottom; left out: even."""
    blur: NotNegative = 0.0
    """Standard deviation of the Gaussian that blurs the zones' edges, in tangents."""
    gains: tuple[NotNegative, ...] = ()
    """Sensitivity of each zone relative to the others; left out: 1."""
    delays_ps: tuple[float, ...] = ()
    """By how much each zone records late; left out: 0."""
    glass: tuple[NotNegative, ...] = ()
    """Photons that the cover glass sends straight back to each zone, per emitted photon; left out: none."""
    dark_count_factors: tuple[NotNegative, ...] = ()
    """Dark counts of each zone over `counting.dark_count_rate_hz`; left out: 1."""
    crosstalk: Annotated[float, Field(ge=0, le=1)] = 0.0
    """Share of the light of all other zones that each zone receives, too."""
    aperture_radius_mm: Positive = 0.2
    """Radius of the round entrance aperture."""

    @property
    def count(self) -> int:
        """Number of zones."""
        return len(self.boxes) or self.rows * self.columns

    def _check(self) -> None:
        given = [bool(self.boxes), self.map is not None, self.field_deg is not None]
        if sum(given) != 1:
            raise ValueError("zones: exactly one of boxes, map, and field_deg (with rows and columns) is needed")
        for name in ("weights", "gains", "delays_ps", "glass", "dark_count_factors"):
            if len(getattr(self, name)) not in (0, self.count):
                raise ValueError(
                    f"zones.{name}: {len(getattr(self, name))} numbers given for {self.count} zones; give one a zone"
                )
        if bool(self.weights) + (self.map is not None) + (self.blur > 0) > 1:
            raise ValueError("zones: weights, map and blur each say how a zone's sensitivity fades; give one of them")
        if len({(len(zone), len(row)) for zone in self.weights for row in zone}) > 1:
            raise ValueError("zones.weights: zones or rows of unequal length; give (zones, rows, columns)")
        if self.field_deg is not None and max(self.field_deg) >= 180:
            raise ValueError(f"zones.field_deg = {list(self.field_deg)}: must be below 180 degrees")

    @model_validator(mode="after")
    def _map_read(self, info: ValidationInfo) -> Self:
        """Take boxes and weights from the file `map`, so that a device holds all that it consists of."""
        if self.map is not None:
            (left, right, bottom, top), weights = _read_map(named_file(info, self.map), self.count)
            box = ((left + right) / 2, (bottom + top) / 2, right - left, top - bottom)
            object.__setattr__(self, "boxes", (box,) * len(weights))
            object.__setattr__(self, "weights", tuple(tuple(map(tuple, zone)) for zone in weights.tolist()))
            object.__setattr__(self, "map", None)
        return self


class Light(Settings):
    """What lights the scene."""

    kind: Literal["flood", "dots", "scan"] = "flood"
    """`flood`: one wide beam; `dots`: narrow beams, all at once; `scan`: one narrow beam after another."""
    field_deg: tuple[Positive, Positive]
    """Full width and height of the lit field, degrees."""
    rows: Annotated[int, Field(ge=1, le=4096)] = 8
    """Rows of dots or points; of a flood those from which light of more than one bounce starts."""
    columns: Annotated[int, Field(ge=1, le=4096)] = 8
    """Columns of them."""
    spread: NotNegative | None = None
    """Standard deviation of a beam that fades towards its edges, in tangents; left out: even."""
    baseline_mm: tuple[float, float] = (0.0, 0.0)
    """(right, up) from the sensor to where the light leaves, as the device sees it."""
    confocal: bool = False
    """Of a scan: one pixel looks at each point of the scan and nowhere else; its size is `zones.field_deg`."""

    def _check(self) -> None:
        if self.confocal and self.kind != "scan":
            raise ValueError(f"light.confocal with kind {self.kind!r}: only a scan is confocal; leave it out")


class Timing(Settings):
    """The time axis of a histogram."""

    bins: Annotated[int, Field(ge=1, le=1_000_000)]
    """Bins of a histogram as the device gives it."""
    bin_width_ps: Positive
    """Width of a bin."""
    zero_bin: float = 0.0
    """Fractional bin at which light would arrive that travels no distance."""
    steps: Annotated[int, Field(ge=1, le=64)] = 1
    """Parts of a bin that are simulated one by one, so that arrival times are known within a bin."""


class EmittedPulse(Settings):
    """The pulse as the detector records it: a Gaussian, or measured samples."""

    fwhm_ps: NotNegative | None = None
    """Full width at half maximum of a Gaussian."""
    samples: tuple[NotNegative, ...] = ()
    """Instead: light in equal steps of time, in any unit."""
    sample_ps: Positive | None = None
    """Length of a step."""
    start_ps: float = 0.0
    """Start of the first step, after the moment that counts as emission."""

    def _check(self) -> None:
        if (self.fwhm_ps is None) == (not self.samples) or bool(self.samples) != (self.sample_ps is not None):
            raise ValueError("pulse: either fwhm_ps, or samples with sample_ps, is needed")


class Counting(Settings):
    """The detector of each zone, and one frame's exposure."""

    mode: Literal["ideal", "synchronous", "free_running"] = "free_running"
    """As `Spad.mode`."""
    pde: Annotated[float, Field(gt=0, le=1)]
    """Photon detection efficiency, with the fill factor."""
    dark_count_rate_hz: NotNegative = 0.0
    """Dark counts of a zone."""
    dead_time_ns: NotNegative = 0.0
    """Blind time after a detection."""
    jitter_fwhm_ps: NotNegative = 0.0
    """Jitter that is not in `pulse`."""
    jitter_tail_ps: NotNegative = 0.0
    """Mean delay of carriers that diffuse, if `pulse` does not hold it."""
    jitter_tail_fraction: Annotated[float, Field(ge=0, le=1)] = 0.0
    """Share of photons with that delay."""
    afterpulse_probability: Annotated[float, Field(ge=0, le=0.5)] = 0.0
    """As `Spad.afterpulse_probability`."""
    crosstalk_probability: Annotated[float, Field(ge=0, le=0.2)] = 0.0
    """Chance that an avalanche sets off one given neighbour."""
    gate_ns: tuple[float, Positive] | Literal["histogram"] | None = None
    """Start and width of the gate, nanoseconds after emission; `histogram`: on while the histogram lasts."""
    repetition_rate_mhz: Positive
    """Laser pulses a microsecond."""
    cycles: Annotated[int, Field(ge=1, le=2**40)]
    """Laser pulses of a frame that count in a zone, over all its detectors."""
    photons_per_pulse: Positive
    """Photons that leave the laser in a pulse."""
    ambient_rate_hz: NotNegative = 0.0
    """Background photons a second at a zone's aperture."""


class DeviceConfig(Settings):
    """A sensor with its light source, as a device file describes it."""

    name: str
    """Its name in the catalogue."""
    description: str
    """What it is, in a sentence."""
    wavelength_nm: Positive
    """Wavelength of the laser."""
    zones: Zones
    light: Light
    time: Timing
    pulse: EmittedPulse
    counting: Counting
    sources: dict[str, str] = Field(default_factory=dict)
    """Key (or section) → where its numbers come from; an estimate begins with `estimate`."""

    def _check(self) -> None:
        rate_mhz = self.counting.repetition_rate_mhz
        if beyond := self.axis.merged(self.time.steps).beyond_period(rate_mhz * 1e6):
            raise ValueError(f"counting.repetition_rate_mhz = {rate_mhz:g} with time: {beyond}")

    @property
    def pairing(self) -> Pairing:
        """Which zones go with which points of light."""
        return "confocal" if self.light.confocal else "exhaustive"

    @property
    def is_flood(self) -> bool:
        """Whether all of the light is there at once."""
        return self.light.kind != "scan"

    @property
    def axis(self) -> TimeAxis:
        """The time axis that is simulated, `time.steps` times finer than the device's bins."""
        width = self.time.bin_width_ps * 1e-12
        steps = self.time.steps
        return TimeAxis(self.time.bins * steps, width / steps, -self.time.zero_bin * width, "source")

    def __str__(self) -> str:
        """A table of all numbers and where each comes from."""
        lines = [f"{self.name}: {self.description}", f"  wavelength_nm = {self.wavelength_nm:g}"]
        for section in ("zones", "light", "time", "pulse", "counting"):
            for key, value in getattr(self, section).model_dump(exclude_defaults=True).items():
                lines.append(f"  {section}.{key} = {_short(value)}")
                lines.append(f"      {self.source_of(section, key)}")
        return "\n".join(map(as_line, lines))

    def source_of(self, section: str, key: str) -> str:
        """Where a number comes from: the source of its key, or of its section; empty where none is stated."""
        for name, value in (("section", section), ("key", key)):
            check_kind(name, value, str, remedy="such as source_of('time', 'bins')")
        return self.sources.get(f"{section}.{key}", self.sources.get(section, ""))


def _short(value: object) -> str:
    """A value for the table; long lists are cut."""
    text = f"{value:g}" if isinstance(value, float) else str(value)
    return text if len(text) <= 60 else f"{text[:57]}…"


@cache
def device_names() -> tuple[str, ...]:
    """Names of the devices of the catalogue."""
    return tuple(sorted(path.stem for path in FOLDER.glob("*.yaml")))


AnyDevice = TypeVar("AnyDevice", bound=DeviceConfig)


def read_device(name: str | Path, model: type[AnyDevice], folder: Path | None = None) -> AnyDevice:
    """A device of the catalogue by its name, or of a file by its path, which starts at `folder`.

    Raises `InputError` for a name that is neither, and for a file that is no device, with the key that is wrong.
    """
    check_path("name", name, f"one of {', '.join(device_names())}, or a device file (.yaml)")
    path = Path(name)
    if path.suffix not in (".yaml", ".yml"):
        if str(name) not in device_names():
            there = f"there are {', '.join(device_names())}; or name a device file (.yaml)"
            raise InputError(
                f"device {shown(str(name))} is not in the catalogue; {near_hint(str(name), device_names(), there)}"
            )
        path = FOLDER / f"{name}.yaml"
    elif folder is not None:
        path = folder / path
    values = read_yaml(path, f"name a device file, or one of {', '.join(device_names())}")
    return from_plain(model, values, str(path), path.parent)


def _read_map(path: Path, zones: int) -> tuple[list[float], Floats]:
    """Extent (left, right, bottom, top) and weights (zones, rows, columns) of a measured map.

    Raises `InputError` where it is none.
    """
    with one_line(f"zones.map: {path}: cannot be read", "an .npz with extent and weights is needed"):
        arrays, _ = read_npz(path, ("extent", "weights"))
        extent, weights = np.asarray(arrays["extent"], float), np.asarray(arrays["weights"], float)
    good = extent.shape == (4,) and extent[0] < extent[1] and extent[2] < extent[3] and weights.ndim == 3
    if not good or (zones > 1 and len(weights) != zones) or not (np.isfinite(weights) & (weights >= 0)).all():
        raise InputError(
            f"zones.map: {path}: extent {extent.tolist()}, weights {weights.shape}; (left, right, bottom, top) in "
            "tangents and finite weights ≥ 0 of (zones, rows, columns) are needed"
        )
    return extent.tolist(), weights
