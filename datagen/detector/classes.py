"""The detector of one scene, drawn from its configuration and, where that names one, from a class of real detectors.

The class is drawn before its parameters, which therefore stay correlated. Every range states its source, or
`estimate` where there is none.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields
from functools import lru_cache
from types import MappingProxyType
from typing import Any

import numpy as np

from datagen.config.detector import DetectorConfig, MeasuredPulse
from datagen.config.distributions import draw
from datagen.detector.spad import Exposure, Pulse, Spad
from datagen.errors import InputError
from datagen.records import TimeAxis
from datagen.seeding import Purpose, generator


@dataclass(frozen=True)
class Range:
    """The range low … high of one parameter, uniform (in the logarithm if `log`), and the source of its ends."""

    low: float
    high: float
    source: str
    log: bool = False

    def at(self, u: float) -> float:
        """The quantile of `u`, a number in 0 … 1."""
        return self.low * (self.high / self.low) ** u if self.log else self.low + (self.high - self.low) * u


ESTIMATE = "estimate"
_CMOS_TAILS = "61 and 129 ps fitted to a published 20 µm CMOS response"
_RATES = "WISC single-photon 3D data: 10 MHz; Instruments 4, 14: 40 MHz"

_CLASSES: dict[str, dict[str, Range]] = {
    "lab_si": {
        "pde": Range(0.2, 0.5, "SwissSPAD3: 50 % peak PDP; SPAD512S: 50 % at 520 nm"),
        "dark_count_rate_hz": Range(
            10, 500, "SwissSPAD3: under 10 Hz; SPAD512S: under 25 Hz; upper end estimate", True
        ),
        "dead_time_s": Range(20e-9, 100e-9, "Straka et al., JLT 2020: 24 ns; PicoHarp 300: 95 ns"),
        "jitter_fwhm_s": Range(25e-12, 80e-12, "Instruments 4, 14: under 50 ps; ends estimate"),
        "jitter_tail_s": Range(50e-12, 150e-12, _CMOS_TAILS),
        "jitter_tail_fraction": Range(0.05, 0.3, ESTIMATE),
        "afterpulse_probability": Range(0.001, 0.03, "Straka et al., JLT 2020: 1.71 %; ends estimate", True),
        "afterpulse_times_s": Range(20e-9, 200e-9, ESTIMATE, True),
        "repetition_rate_hz": Range(1e6, 40e6, _RATES, True),
    },
    "si_array": {
        "pde": Range(0.02, 0.5, "8 µm pixel, TED 2015: 39.5 % at 480 nm; SwissSPAD3: 50 %; lower end estimate", True),
        "dark_count_rate_hz": Range(
            1, 1e4, "8 µm pixel, TED 2015: 47 Hz; SPAD512S: under 25 Hz; ends estimate", True
        ),
        "dead_time_s": Range(5e-9, 150e-9, "WISC single-photon 3D data: 50 ns; ends estimate", True),
        "jitter_fwhm_s": Range(50e-12, 150e-12, "Instruments 4, 14: under 50 ps (16×1 array); upper end estimate"),
        "jitter_tail_s": Range(50e-12, 300e-12, f"{_CMOS_TAILS}; end estimate"),
        "jitter_tail_fraction": Range(0.05, 0.3, ESTIMATE),
        "afterpulse_probability": Range(1e-4, 0.02, ESTIMATE, True),
        "afterpulse_times_s": Range(10e-9, 200e-9, ESTIMATE, True),
        "hot_pixel_fraction": Range(0.01, 0.01, ESTIMATE),
        "hot_pixel_factor": Range(30, 300, ESTIMATE, True),
        "crosstalk_probability": Range(1e-4, 0.01, ESTIMATE, True),
        "repetition_rate_hz": Range(10e6, 40e6, _RATES, True),
    },
    "ingaas": {
        "pde": Range(0.1, 0.3, "arXiv 1204.4594: 10 %; Photonics 2025, 12, 534: 30 %"),
        "dark_count_rate_hz": Range(500, 1e4, "arXiv 1204.4594: 600 Hz at 10 %; upper end estimate", True),
        "dead_time_s": Range(0.2e-6, 10e-6, ESTIMATE, True),
        "jitter_fwhm_s": Range(150e-12, 300e-12, ESTIMATE),
        "jitter_tail_s": Range(100e-12, 500e-12, ESTIMATE),
        "jitter_tail_fraction": Range(0.05, 0.3, ESTIMATE),
        "afterpulse_probability": Range(0.01, 0.1, ESTIMATE, True),
        "afterpulse_times_s": Range(1.1e-6, 2.4e-6, "arXiv 2106.05599: decay of 1.1–2.4 µs"),
        "repetition_rate_hz": Range(0.5e6, 5e6, ESTIMATE, True),
    },
    "consumer_dtof": {
        "pde": Range(0.02, 0.05, ESTIMATE),
        "dark_count_rate_hz": Range(1e3, 3e4, ESTIMATE, True),
        "dead_time_s": Range(5e-9, 20e-9, ESTIMATE),
        "jitter_fwhm_s": Range(100e-12, 300e-12, ESTIMATE),
        "afterpulse_probability": Range(1e-4, 0.02, ESTIMATE, True),
        "afterpulse_times_s": Range(10e-9, 100e-9, ESTIMATE, True),
        "repetition_rate_hz": Range(5e6, 20e6, ESTIMATE, True),
    },
}

DETECTOR_CLASSES: Mapping[str, Mapping[str, Range]] = MappingProxyType(
    {name: MappingProxyType(ranges) for name, ranges in _CLASSES.items()}
)
"""Class name → parameter name (those of `Spad` and `Exposure`, SI units) → range with its source."""

_RISES_WITH_OVERVOLTAGE = frozenset({"pde", "dark_count_rate_hz", "afterpulse_probability", "crosstalk_probability"})
"""A higher overvoltage raises all of these, so that within a class they are correlated."""


def draw_class_parameters(name: str, rng: np.random.Generator) -> dict[str, float]:
    """Parameter name → value in SI units, of one detector drawn from a class.

    A common random number, the overvoltage, makes half of the place of PDE, dark counts, afterpulses and crosstalk in
    their ranges; the other half is each parameter's own. Afterpulses also fall with the dead time, whose longer
    hold-off lets the traps empty. Every value stays in its range.
    """
    ranges = DETECTOR_CLASSES[name]
    overvoltage = rng.random()
    place = {key: rng.random() for key in ranges}
    for key in ranges:
        if key in _RISES_WITH_OVERVOLTAGE:
            place[key] = 0.5 * (place[key] + overvoltage)
    place["afterpulse_probability"] = 0.5 * (place["afterpulse_probability"] + 1.0 - place["dead_time_s"])
    return {key: r.at(place[key]) for key, r in ranges.items()}


_LABORATORY: dict[str, Any] = {
    "pde": 0.3, "dark_count_rate_hz": 100.0, "dead_time_s": 50e-9, "jitter_fwhm_s": 60e-12,
    "jitter_tail_fraction": 0.2,
}  # fmt: skip
"""A silicon SPAD in a laboratory: what neither configuration nor class gives. All else is left to the defaults of
`Spad` and `Exposure`."""
_UNITS = {
    "afterpulse_time_ns": ("afterpulse_times_s", 1e-9),
    "_ns": ("_s", 1e-9), "_ps": ("_s", 1e-12), "_mhz": ("_hz", 1e6),
}  # fmt: skip
"""End of a key of the configuration → that of its name in SI units, and the unit."""
_FIELDS = {kind: {f.name for f in fields(kind)} for kind in (Spad, Exposure)}


def detector_for(
    config: DetectorConfig, seed: int, index: int, time: TimeAxis | None = None
) -> tuple[Spad, Exposure]:
    """Spad and exposure of scene `index`, drawn from the scene's own random stream.

    A key of the configuration sets the field of `Spad` or `Exposure` whose name it is in SI units; a key of `gate`
    sets `gate_…`. Distributions are drawn in the order of the keys. With `time`, a repetition rate that the
    configuration does not give is lowered where the time axis would not fit into the laser period, as an experimenter
    would do.

    Raises `InputError` for a configuration that names no exposure but what it shall reach (`exposure_for`).
    """
    if config.exposure_for is not None:
        raise InputError(
            "detector.exposure_for: its exposure is not found yet; use dg.with_exposure_found(config), or set cycles"
        )
    rng = generator(seed, index, Purpose.DETECTOR_PARAMETERS)
    values = dict(_LABORATORY)
    name: str | None = config.detector_class
    if name == "any":
        name = sorted(DETECTOR_CLASSES)[int(rng.integers(len(DETECTOR_CLASSES)))]
    if name is not None:
        values |= draw_class_parameters(name, rng)
    if time is not None:
        usual = values.get("repetition_rate_hz", Exposure.repetition_rate_hz)
        values["repetition_rate_hz"] = min(usual, 1.0 / (time.bins * time.width_s))
    gate = () if config.gate is None else ((f"gate_{key}", value) for key, value in config.gate)
    for key, given in (*config, *gate):
        field, unit = _in_si(key)
        if given is not None and any(field in names for names in _FIELDS.values()):
            values[field] = _value(given, unit, rng)
    values["cycles"] = max(round(values["cycles"]), 1)
    if config.pulse is not None:
        del values["pulse_fwhm_s"]
    values["hot_pixel_seed"] = int(rng.integers(2**62))
    if values.get("tdc_dnl", 0.0) > 0:
        values["tdc_seed"] = int(rng.integers(2**62))
    spad, exposure = ({key: values[key] for key in names & values.keys()} for names in _FIELDS.values())
    return Spad(**spad), Exposure(**exposure)


def _in_si(key: str) -> tuple[str, float]:
    """The name in SI units of a key of the configuration, and the key's unit."""
    for ending, (si, unit) in _UNITS.items():
        if key.endswith(ending):
            return key.removesuffix(ending) + si, unit
    return key, 1.0


def _value(given: Any, unit: float, rng: np.random.Generator) -> Any:
    """A value of the configuration in SI units; numbers are drawn if they are distributions."""
    if isinstance(given, MeasuredPulse):
        return Pulse(given.samples, given.sample_ps * 1e-12, given.start_ps * 1e-12)
    if isinstance(given, tuple):
        return given if unit == 1.0 else _in_seconds(given)
    # Flags, names and whole numbers are not drawn.
    return given if isinstance(given, (int, str)) else draw(given, rng) * unit


@lru_cache(maxsize=1)
def _in_seconds(edges_ps: tuple[tuple[float, ...], ...]) -> tuple[tuple[float, ...], ...]:
    """Edges in seconds, which all scenes of a configuration share: there may be a hundred thousand."""
    return tuple(tuple(row) for row in (np.array(edges_ps) * 1e-12).tolist())
