"""The section `detector`: which SPAD, and the conditions of the exposure."""

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import Field, SerializerFunctionWrapHandler, model_serializer

from datagen.config.base import Settings, without_unset
from datagen.config.device import DeviceConfig
from datagen.config.distributions import Distribution, Fraction, NotNegative, support, within
from datagen.config.tdc_edges import MeasuredEdges

DetectorClass = Literal["lab_si", "si_array", "ingaas", "consumer_dtof", "any"]

USUAL_REPETITION_RATE_HZ = 10e6
"""Laser pulses in a second where neither the configuration nor a class of detectors says it."""


class GateConfig(Settings):
    """The detector is on only within a gate; times on the histogram's time axis."""

    start_ns: Distribution
    """When the gate begins to open."""
    width_ns: Annotated[Distribution, within(0, open_low=True)]
    """From the start of opening to the end of closing."""
    rise_ps: NotNegative = 0.0
    """The sensitivity climbs and falls linearly within this time at either end."""

    def _check(self) -> None:
        rise, width = support(self.rise_ps)[1], support(self.width_ns)[0]
        if 2e-3 * rise > width:
            raise ValueError(f"rise_ps = {rise:g}: must be at most half of width_ns = {width:g} ns")


class ExposureFor(Settings):
    """How significant objects must be in the data: the exposure is the shortest with which they are."""

    evidence: Annotated[float, Field(gt=0, le=1e6)] | None = None
    """Significance of an object's own light, standard deviations of a matched filter."""
    change: Annotated[float, Field(gt=0, le=1e6)] | None = None
    """In place of `evidence`, of a sequence: σ of the change from one frame to the next by an object that
    moves."""
    quantile: Annotated[float, Field(ge=0, lt=1)] = 0.5
    """Share of the objects that may have less: with 0.5 half of the objects reach it, with 0.1 nine in ten."""
    longest_s: Annotated[float, Field(gt=0, le=1e6)] = 10.0
    """Longest exposure of one histogram, seconds; where it is not enough, the configuration is refused. Of a sequence
    all exposures of a frame must fit into it, too."""

    @model_serializer(mode="wrap")
    def _plain(self, plain: SerializerFunctionWrapHandler) -> dict[str, Any]:
        return without_unset(self, plain, "evidence", "change")

    def _check(self) -> None:
        if (self.evidence is None) == (self.change is None):
            raise ValueError("evidence, change: one of them is needed, such as evidence: 5")

    @property
    def of(self) -> str:
        """Name of what is asked for."""
        return "evidence" if self.change is None else "change"

    @property
    def least(self) -> float:
        """The σ that is asked for."""
        return float(self.evidence if self.change is None else self.change)  # type: ignore[arg-type]


class MeasuredPulse(Settings):
    """The laser pulse, or a whole timing response, as it was measured."""

    samples: Annotated[tuple[Annotated[float, Field(ge=0)], ...], Field(min_length=1)]
    """Light in equal steps of time, in any unit."""
    sample_ps: Annotated[float, Field(gt=0)]
    """Length of a step."""
    start_ps: float = 0.0
    """Start of the first step, after the moment that counts as emission."""


class DetectorConfig(Settings):
    """A SPAD and its exposure. Each number may be a distribution, drawn anew for every scene.

    With `detector_class` the numbers left out are drawn from that class's ranges, which keeps them correlated;
    without it they are those of a silicon SPAD in a laboratory. With `capture.device` they are the device's.
    """

    detector_class: DetectorClass | None = None
    """Draw what is left out from a class of real detectors; `any` draws the class too, for every scene."""
    mode: Literal["ideal", "synchronous", "free_running"] = "ideal"
    """`ideal`: every event is counted; `synchronous`: armed at each laser pulse; `free_running`: dead time only."""
    pde: Fraction | None = None
    """Photon detection efficiency × fill factor. Left out: 0.3."""
    dark_count_rate_hz: NotNegative | None = None
    """Left out: 100."""
    dark_count_factors: tuple[Annotated[float, Field(ge=0)], ...] = ()
    """Dark counts of each pixel over that rate. Left out: all pixels are alike."""
    dead_time_ns: NotNegative | None = None
    """Left out: 50."""
    paralyzable: bool = False
    """A photon within the dead time restarts it."""
    jitter_fwhm_ps: NotNegative | None = None
    """Gaussian jitter of avalanche build-up and TDC. Left out: 60."""
    jitter_tail_ps: NotNegative | None = None
    """Exponential delay of carriers that diffuse to the junction. Left out: none."""
    jitter_tail_fraction: Fraction | None = None
    """Share of the photons that is so delayed. Left out: 0.2."""
    afterpulse_probability: Annotated[Distribution, within(0, 0.5)] | None = None
    """Left out: none."""
    afterpulse_time_ns: Annotated[Distribution, within(0, open_low=True)] | None = None
    """Release time of the traps. Left out: 50."""
    crosstalk_probability: Annotated[Distribution, within(0, 0.2)] | None = None
    """Chance that an avalanche sets off one given nearest neighbour. Left out: none."""
    array_columns: Annotated[int, Field(ge=1, le=65536)] | None = None
    """Pixels in a row of the array, for crosstalk. Left out: one row."""
    hot_pixel_fraction: Fraction | None = None
    """Share of pixels with far more dark counts. Left out: none."""
    hot_pixel_factor: Annotated[Distribution, within(1)] | None = None
    """Dark counts of a hot pixel over those of the others. Left out: 100."""
    tdc_dnl: Annotated[Distribution, within(0, 2)] | None = None
    """Differential nonlinearity: how much the widths of the TDC's bins scatter, over their mean; 0.9 for an FPGA.
    Left out: all bins are equal."""
    tdc_period_bins: Annotated[int, Field(ge=8, le=65536)] = 140
    """Bins after which the drawn widths repeat."""
    tdc_edges_ps: MeasuredEdges | None = None
    """Instead of `tdc_dnl`: measured edges of the TDC's bins over one period, which starts at 0; one row a pixel, or
    one for all. Numbers, or a file (.csv, .csv.gz, .npz) relative to the configuration's folder. A dataset stores the
    numbers."""
    gate: GateConfig | None = None
    """Left out: always on."""
    repetition_rate_mhz: Annotated[Distribution, within(0, open_low=True)] | None = None
    """Laser pulses per microsecond; the time axis must fit between two. Left out: 10, or as many as it leaves room
    for."""
    cycles: Annotated[Distribution, within(1, 2**40)] = 1e6
    """Laser pulses in one exposure; rounded to a whole number."""
    exposure_for: ExposureFor | None = None
    """Instead of `cycles`: one number of cycles for the whole dataset, found by pilot scenes."""
    found_for: ExposureFor | None = None
    """The `exposure_for` for which `cycles` was found. Written by datagen into a dataset's own configuration."""
    photons_per_pulse: NotNegative = 1e7
    """Photons that leave the laser in one pulse; the default, 4 pJ in the green, fills 16-bit bins of a confocal scan
    of a room to some percent of their range."""
    pulse_fwhm_ps: NotNegative = 50.0
    """Width of the laser pulse."""
    pulse: MeasuredPulse | None = None
    """A measured pulse, in place of `pulse_fwhm_ps`."""
    ambient_rate_hz: NotNegative = 0.0
    """Background photons per second at one pixel's aperture."""
    counter_max: Annotated[int, Field(ge=1, le=2**62)] | None = None
    """Counts at which a bin's counter stays. Left out: counters do not saturate."""
    bins_merged: Annotated[int, Field(ge=1, le=2**20)] = 1
    """Bins of `capture.time` that the sensor adds up to one bin of its histogram: light is then known within it."""
    tolerance: Annotated[float, Field(ge=0, le=1)] = 1e-3
    """Relative bias that a cheaper sampler may cause; 0 demands the exact one."""
    approximate: bool = False
    """Allow approximations where the exact sampler or mean cannot be had."""

    def _check(self) -> None:
        self._only_one_of("exposure_for", "cycles")
        if self.found_for is not None and (self.exposure_for is not None or "cycles" not in self.model_fields_set):
            raise ValueError("found_for: tells for what given cycles were found; to have them found set exposure_for")
        self._only_one_of("pulse", "pulse_fwhm_ps")
        self._only_one_of("tdc_edges_ps", "tdc_dnl", "tdc_period_bins")

    def of_device(self, device: DeviceConfig) -> DetectorConfig:
        """These settings, with the device's numbers for all that is not given.

        Raises `ValueError` for `detector_class`, and another number of `bins_merged`.
        """
        given = {name: getattr(self, name) for name in self.model_fields_set}
        for name, value in (("detector_class", None), ("bins_merged", device.time.steps)):
            if given.get(name, value) != value:
                raise ValueError(
                    f"detector.{name} = {given[name]!r} beside capture.device: follows from the device "
                    f"{device.name!r}; leave it out"
                )
        counting, pulse = device.counting, device.pulse
        own: dict[str, Any] = {
            name: getattr(counting, name) for name in type(counting).model_fields if name in type(self).model_fields
        }
        own["cycles"] = float(counting.cycles)
        own["bins_merged"] = device.time.steps
        gate, axis = counting.gate_ns, device.axis
        if gate == "histogram":
            gate = axis.start_s * 1e9, (axis.stop_s - axis.start_s) * 1e9
        if gate is not None:
            own["gate"] = GateConfig(start_ns=gate[0], width_ns=gate[1])
        if device.zones.dark_count_factors:
            own["dark_count_factors"] = device.zones.dark_count_factors
        if counting.crosstalk_probability > 0:
            own["array_columns"] = device.zones.columns
        if pulse.sample_ps is not None:
            own["pulse"] = MeasuredPulse(samples=pulse.samples, sample_ps=pulse.sample_ps, start_ps=pulse.start_ps)
        else:
            own["pulse_fwhm_ps"] = pulse.fwhm_ps
        for key, other in (("exposure_for", "cycles"), ("pulse", "pulse_fwhm_ps"), ("pulse_fwhm_ps", "pulse")):
            if given.get(key) is not None:
                own.pop(other, None)
        return DetectorConfig(**(own | given))
