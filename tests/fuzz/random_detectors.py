"""Random detectors, exposures and transients for the fuzzer: every field, at its usual values and at its ends."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from fuzz_profile import st
from numpy.typing import NDArray

from datagen import Exposure, Spad, TimeAxis
from datagen.errors import InputError

MOST_EVENTS = 1e5
"""Events of a case, roughly: what takes longer to draw is left to the tests of speed."""


@dataclass(frozen=True)
class Measurement:
    """Something to detect; `transient` is (laser, pixel, bin)."""

    transient: NDArray[np.float64]
    time: TimeAxis
    spad: Spad
    exposure: Exposure
    seed: int


def _spad(values: dict[str, Any]) -> Spad | None:
    try:
        return Spad(**values)
    except InputError:
        # Fields that exclude one another; each refusal has its own test.
        return None


@st.composite
def spads(draw: st.DrawFn, window_s: float, period_s: float) -> Spad:
    """Times relative to the window and the period, from far below a bin to far beyond a period."""
    gate = draw(st.sampled_from([None, None, (0.0, 1.0), (0.25, 0.1), (0.5, 1e-6), (0.1, 0.9)]))
    values: dict[str, Any] = {
        "pde": draw(st.sampled_from([0.0, 1e-12, 0.3, 1.0])),
        "dark_count_rate_hz": draw(st.sampled_from([0.0, 0.0, 100.0, 1e6, 1e9])),
        "dead_time_s": draw(st.sampled_from([0.0, 1e-15, 0.01, 0.37, 1.0, 1.63, 3.0, 40.2])) * period_s,
        "jitter_fwhm_s": draw(st.sampled_from([0.0, 1e-15, 0.01, 0.3, 2.5])) * window_s,
        "jitter_tail_s": draw(st.sampled_from([0.0, 0.01, 0.3, 2.5])) * window_s,
        "jitter_tail_fraction": draw(st.sampled_from([0.0, 0.4, 1.0])),
        "afterpulse_probability": draw(st.sampled_from([0.0, 0.0, 1e-9, 0.05, 0.5])),
        "afterpulse_times_s": draw(st.sampled_from([(50e-9,), (1e-9, 1e-6), (1e-15,), (1e-5,)])),
        "mode": draw(st.sampled_from(["ideal", "synchronous", "free_running"])),
        "paralyzable": draw(st.sampled_from([False, False, True])),
        "hot_pixel_fraction": draw(st.sampled_from([0.0, 0.5, 1.0])),
        "hot_pixel_factor": draw(st.sampled_from([1.0, 50.0])),
        "hot_pixel_seed": draw(st.integers(0, 2**63 - 1)),
        "crosstalk_probability": draw(st.sampled_from([0.0, 0.0, 0.0, 0.03, 0.2])),
        "array_columns": draw(st.sampled_from([None, 1])),
        "counter_max": draw(st.sampled_from([None, None, 1, 7, 1000])),
        "tdc_dnl": draw(st.sampled_from([0.0, 0.0, 1e-9, 0.3, 2.0])),
        "tdc_period_bins": draw(st.sampled_from([8, 140])),
    }
    if gate is not None:
        values["gate_start_s"], values["gate_width_s"] = gate[0] * period_s, gate[1] * period_s * (1 - 1e-9)
        values["gate_rise_s"] = draw(st.sampled_from([0.0, 0.1, 0.5])) * values["gate_width_s"] * (1 - 1e-9)
    if values["paralyzable"]:
        values["afterpulse_probability"] = values["crosstalk_probability"] = 0.0
    spad = _spad(values)
    return spad if spad is not None else Spad()


@st.composite
def shapes(draw: st.DrawFn, bins: int) -> NDArray[np.float64]:
    """(bins,) of unit sum, or zeros: a floor, lone peaks, a steep decay, something far below all else."""
    kind = draw(st.sampled_from(["flat", "peaks", "decay", "contrast", "nothing"]))
    if kind == "nothing":
        return np.zeros(bins)
    values = np.ones(bins)
    if kind == "peaks":
        values[:] = 0.0
        values[draw(st.lists(st.integers(0, bins - 1), min_size=1, max_size=3))] = 1.0
    elif kind == "decay":
        values = np.exp(-40.0 * np.arange(bins) / bins)
    elif kind == "contrast":
        values *= 1e-14
        values[draw(st.integers(0, bins - 1))] = 1.0
    return np.asarray(values / values.sum())


@st.composite
def measurements(draw: st.DrawFn) -> Measurement:
    """Windows as long as the laser period and shorter; flux from 1e-12 to 1e4 photons per cycle."""
    bins = draw(st.sampled_from([1, 2, 33, 200]))
    width = draw(st.sampled_from([1e-12, 1e-10, 1e-9]))
    window = bins * width
    period = window * draw(st.sampled_from([1.0, 1.0, 1.37, 9.0]))
    spad = draw(spads(window, period))
    flux = draw(st.sampled_from([1e-12, 1e-4, 0.03, 1.0, 30.0, 1e4]))
    ambient = draw(st.sampled_from([0.0, 0.0, 1e5, 1e8]))
    background = (ambient + spad.dark_count_rate_hz * spad.hot_pixel_factor) * period
    cycles = draw(st.sampled_from([1, 2, 1000, 10**6, 2**31, 2**40]))
    alone = spad.afterpulse_probability == 0 and spad.crosstalk_probability == 0
    exact = spad.mode == "ideal" or (spad.dead_time_s == 0 and alone)
    if not exact or cycles * (flux + background) > 1e15:
        cycles = max(int(min(cycles, MOST_EVENTS / (flux + background + 1e-9))), 1)
    shape = draw(st.sampled_from([(1, 1), (2, 3)]))
    transient = np.empty((*shape, bins))
    for laser in range(shape[0]):
        for pixel in range(shape[1]):
            transient[laser, pixel] = draw(shapes(bins))
    photons = draw(st.sampled_from([1.0, 1e9]))
    exposure = Exposure(1 / period, cycles, photons, ambient, draw(st.sampled_from([0.0, 1e-15, 0.05, 2.0])) * window)
    start = draw(st.sampled_from([0.0, 0.0, -3e-9, 1e-6])) if spad.gate_start_s is None else 0.0
    axis = TimeAxis(bins, width, start)
    return Measurement(transient * flux / photons, axis, spad, exposure, draw(st.integers(0, 2**32 - 1)))
