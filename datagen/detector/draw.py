"""The detector of one scene, drawn from the configuration."""

from __future__ import annotations

from typing import Any

from datagen.config.detector import DetectorConfig
from datagen.config.distributions import Distribution, draw
from datagen.detector.classes import DETECTOR_CLASSES, draw_class_parameters
from datagen.detector.spad import Exposure, Spad
from datagen.errors import InputError
from datagen.records import TimeAxis
from datagen.seeding import Purpose, generator

_PARAMETERS: dict[str, tuple[str, float, float]] = {
    "pde": ("pde", 1.0, 0.3), "dark_count_rate_hz": ("dark_count_rate_hz", 1.0, 100.0),
    "dead_time_s": ("dead_time_ns", 1e-9, 50e-9), "jitter_fwhm_s": ("jitter_fwhm_ps", 1e-12, 60e-12),
    "jitter_tail_s": ("jitter_tail_ps", 1e-12, 0.0), "jitter_tail_fraction": ("jitter_tail_fraction", 1.0, 0.2),
    "afterpulse_probability": ("afterpulse_probability", 1.0, 0.0),
    "afterpulse_time_s": ("afterpulse_time_ns", 1e-9, 50e-9),
    "crosstalk_probability": ("crosstalk_probability", 1.0, 0.0),
    "hot_pixel_fraction": ("hot_pixel_fraction", 1.0, 0.0), "hot_pixel_factor": ("hot_pixel_factor", 1.0, 100.0),
    "repetition_rate_hz": ("repetition_rate_mhz", 1e6, 10e6),
}  # fmt: skip
"""Parameter in SI units → key of the configuration, its unit, and what holds where neither the configuration nor a
class says otherwise: a silicon SPAD in a laboratory."""


def detector_for(
    config: DetectorConfig, seed: int, index: int, time: TimeAxis | None = None
) -> tuple[Spad, Exposure]:
    """Spad and exposure of scene `index`, from its stream for detector parameters.

    With `time`, a repetition rate drawn from a class's range is lowered where the time axis would not fit into the
    laser period, as an experimenter would; a rate that the configuration gives is kept.

    Raises `InputError` for a configuration whose exposure is yet to be found.
    """
    if config.exposure_for is not None:
        raise InputError(
            "detector.exposure_for: its exposure is not found yet; use dg.with_exposure_found(config), or set cycles"
        )
    rng = generator(seed, index, Purpose.DETECTOR_PARAMETERS)
    values: dict[str, Any] = {parameter: usual for parameter, (_, _, usual) in _PARAMETERS.items()}
    name = config.detector_class
    if name == "any":
        name = sorted(DETECTOR_CLASSES)[int(rng.integers(len(DETECTOR_CLASSES)))]  # type: ignore[assignment]
    if name is not None:
        values |= draw_class_parameters(name, rng)
        if time is not None:
            values["repetition_rate_hz"] = min(values["repetition_rate_hz"], 1.0 / (time.bins * time.width_s))
    for parameter, (key, unit, _) in _PARAMETERS.items():
        configured: Distribution | None = getattr(config, key)
        if configured is not None:
            values[parameter] = draw(configured, rng) * unit
    exposure = Exposure(
        repetition_rate_hz=values.pop("repetition_rate_hz"),
        cycles=max(round(draw(config.cycles, rng)), 1),
        photons_per_pulse=draw(config.photons_per_pulse, rng),
        ambient_rate_hz=draw(config.ambient_rate_hz, rng),
        pulse_fwhm_s=draw(config.pulse_fwhm_ps, rng) * 1e-12,
    )
    if config.gate is not None:
        for key, gate, unit in (
            ("start_s", "start_ns", 1e-9),
            ("width_s", "width_ns", 1e-9),
            ("rise_s", "rise_ps", 1e-12),
        ):
            values[f"gate_{key}"] = draw(getattr(config.gate, gate), rng) * unit
    spad = Spad(
        afterpulse_times_s=(values.pop("afterpulse_time_s"),), mode=config.mode, paralyzable=config.paralyzable,
        hot_pixel_seed=int(rng.integers(2**62)), array_columns=config.array_columns, counter_max=config.counter_max,
        **values,
    )  # fmt: skip
    return spad, exposure
