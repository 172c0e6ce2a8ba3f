"""The detector of a measurement (`Spad`) and the conditions under which it works (`Exposure`)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import lru_cache
from typing import Any, Literal, cast, get_args

import numpy as np
from numpy.typing import ArrayLike

from datagen.errors import InputError, shown
from datagen.records.checks import (
    as_tdc_edges,
    as_weights,
    check_choice,
    check_flag,
    check_integer,
    check_kind,
    check_number,
)

Mode = Literal["ideal", "synchronous", "free_running"]
"""`ideal`: every avalanche-capable event is counted. `synchronous`: armed afresh at the start of each laser cycle.
`free_running`: armed whenever the dead time is over, whatever the laser does."""

MAX_CYCLES = 2**40
"""Most laser cycles of an exposure, a day at 10 MHz: numpy's binomial numbers take a probability below 1e-16 for 0,
which costs such an exposure less than 1e-4 counts a bin."""


@dataclass(frozen=True)
class Spad:
    """A single-photon avalanche diode, or an array of equal ones, with its time-to-digital converter (TDC).

    Times are on the axis of the `TimeAxis` that goes with the transient; its bin width is the TDC's.

    Attributes
    ----------
    pde : photon detection efficiency × fill factor, 0 … 1.
    dark_count_rate_hz : thermally generated avalanches per second of a pixel that is not hot.
    dark_count_factors : dark counts of each pixel, in units of `dark_count_rate_hz` and the order of the pixel axis;
        ≥ 0, empty if all are alike.
    hot_pixel_fraction : share of hot pixels, 0 … 1; which pixels are hot depends on `hot_pixel_seed` only.
    hot_pixel_factor : dark-count rate of a hot pixel, in units of `dark_count_rate_hz`; ≥ 1.
    hot_pixel_seed : seed that decides which pixels of the array are hot; ≥ 0.
    dead_time_s : time after an avalanche during which no other can start; ≥ 0, may exceed the laser period.
    paralyzable : a photon that falls into the dead time restarts it (a passively quenched diode).
    gate_start_s, gate_width_s : the diode is on in `[start, start + width]` of every laser period; if both are None,
        always.
    gate_rise_s : time within which the sensitivity rises from 0 to 1 after the gate's start, and falls to 0 before
        its end; 0 … width / 2.
    jitter_fwhm_s : Gaussian timing jitter of avalanche build-up and TDC. It displaces *recorded events*.
    jitter_tail_s : mean delay of carriers that diffuse to the junction. It displaces photons *before* the avalanche.
    jitter_tail_fraction : share of the photons with that delay, 0 … 1.
    afterpulse_probability : probability that an avalanche is followed by an afterpulse once the diode is armed again.
    afterpulse_times_s : release times of the traps; one number or several.
    afterpulse_weights : each trap's share of the afterpulses; if empty, the shares are equal.
    crosstalk_probability : probability that an avalanche sets off one in a given nearest neighbour (up to four).
    array_columns : pixels in a row of the array (the pixel axis is row-major); None for one row, as in a line sensor.
    counter_max : count at which a bin's counter stays; None for counters that never saturate.
    tdc_dnl : differential nonlinearity of the TDC: standard deviation of the widths of its bins over their mean,
        0 … 2; 0 for equal bins. Widths are gamma-distributed, different in each pixel, and add up to a period.
    tdc_period_bins : number of bins after which the widths repeat, as those of a fine TDC do at each tick of the
        clock; 8 … 65536. The first period starts with the time axis, to whose start the clock is locked.
    tdc_seed : seed that decides the widths of each pixel's bins; ≥ 0.
    tdc_edges_s : in place of `tdc_dnl`: measured edges of the bins of one period, ascending from 0 to the number of
        bins × the width of the time axis's bins; (pixel, edge), or (edge,) for all pixels alike. Equal neighbours
        are the edges of a bin that records nothing.
    bins_merged : bins of the time axis that the sensor adds up to one bin of its histogram, ≥ 1; the time axis must
        have a multiple of them. With more than one, light is known within a bin of the histogram.
    mode : see `Mode`; `ideal` counts every event, without dead time, afterpulsing or crosstalk.

    Examples
    --------
    >>> import datagen as dg
    >>> spad = dg.Spad(pde=0.4, dark_count_rate_hz=100, dead_time_s=50e-9, jitter_fwhm_s=60e-12)
    >>> spad.mode
    'free_running'
    >>> dg.Spad(pde=1.4)  # doctest: +ELLIPSIS
    Traceback (most recent call last):
        ...
    datagen.errors.InputError: Spad.pde = 1.4: ...
    """

    pde: float = 0.3
    dark_count_rate_hz: float = 0.0
    dead_time_s: float = 0.0
    jitter_fwhm_s: float = 0.0
    jitter_tail_s: float = 0.0
    jitter_tail_fraction: float = 1.0
    afterpulse_probability: float = 0.0
    afterpulse_times_s: tuple[float, ...] = (50e-9,)
    afterpulse_weights: tuple[float, ...] = ()
    mode: Mode = "free_running"
    paralyzable: bool = False
    gate_start_s: float | None = None
    gate_width_s: float | None = None
    gate_rise_s: float = 0.0
    hot_pixel_fraction: float = 0.0
    hot_pixel_factor: float = 100.0
    hot_pixel_seed: int = 0
    crosstalk_probability: float = 0.0
    array_columns: int | None = None
    counter_max: int | None = None
    tdc_dnl: float = 0.0
    tdc_period_bins: int = 140
    tdc_seed: int = 0
    # Without its thousands of numbers a hash takes a microsecond.
    tdc_edges_s: tuple[tuple[float, ...], ...] | None = field(default=None, hash=False)
    bins_merged: int = 1
    dark_count_factors: tuple[float, ...] = ()

    def __post_init__(self) -> None:
        for name in ("afterpulse_times_s", "afterpulse_weights"):
            given = getattr(self, name)
            values = tuple(given) if isinstance(given, (tuple, list, np.ndarray)) else (given,)
            object.__setattr__(self, name, values)
        for name, low, high, remedy in (
            ("pde", 0.0, 1.0, "it is a probability; give 0.3 for 30 %"),
            ("dark_count_rate_hz", 0.0, 1e12, "counts per second"),
            ("dead_time_s", 0.0, 1.0, "seconds; 50 ns is 50e-9, 0 switches dead time off"),
            ("jitter_fwhm_s", 0.0, 1.0, "seconds; 60 ps is 60e-12, 0 switches jitter off"),
            ("jitter_tail_s", 0.0, 1.0, "seconds; 0 switches the tail off"),
            ("jitter_tail_fraction", 0.0, 1.0, "it is the share of delayed photons"),
            ("afterpulse_probability", 0.0, 0.5, "above it afterpulses would run away"),
            ("gate_rise_s", 0.0, 1.0, "seconds"),
            ("hot_pixel_fraction", 0.0, 1.0, "it is a share of the pixels"),
            ("hot_pixel_factor", 1.0, 1e9, "a hot pixel has more dark counts than others"),
            ("crosstalk_probability", 0.0, 0.2, "per neighbour; above it avalanches would run away"),
            ("tdc_dnl", 0.0, 2.0, "0.9 for widths that scatter by 90 % of their mean, 0 for equal ones"),
        ):
            check_number("Spad", name, getattr(self, name), low, high, remedy)
        for name in ("hot_pixel_seed", "tdc_seed"):
            check_integer("Spad", name, getattr(self, name), 0, 2**63 - 1)
        check_integer("Spad", "tdc_period_bins", self.tdc_period_bins, 8, 65536)
        for name in ("array_columns", "counter_max"):
            if getattr(self, name) is not None:
                check_integer("Spad", name, getattr(self, name), 1, 2**62)
        check_integer("Spad", "bins_merged", self.bins_merged, 1, 2**20)
        if self.bins_merged > 1 and self.counter_max is not None:
            raise InputError(
                f"Spad.bins_merged = {self.bins_merged} with counter_max = {self.counter_max}: merged counters that "
                "saturate are not modelled; leave one out"
            )
        check_choice("Spad.mode", self.mode, get_args(Mode))
        check_flag("Spad.paralyzable", self.paralyzable)
        if self.paralyzable and (self.afterpulse_probability > 0 or self.crosstalk_probability > 0):
            raise InputError(
                "Spad.paralyzable = True with afterpulsing or crosstalk: the three together are not modelled; "
                "set afterpulse_probability and crosstalk_probability to 0"
            )
        if not isinstance(self.dark_count_factors, Sequence) or self.dark_count_factors:
            factors = as_weights("Spad.dark_count_factors", self.dark_count_factors, (None,))
            object.__setattr__(self, "dark_count_factors", tuple(factors.tolist()))
        self._check_traps()
        self._check_gate()
        if self.tdc_edges_s is not None:
            self._check_tdc_edges(self.tdc_edges_s)

    def _check_traps(self) -> None:
        times, weights = self.afterpulse_times_s, self.afterpulse_weights
        if not times:
            raise InputError("Spad.afterpulse_times_s = (): at least one release time in seconds is needed")
        for value in times:
            check_number("Spad", "afterpulse_times_s", value, 1e-15, 1.0, "release times in seconds, such as 50e-9")
        for value in weights:
            check_number("Spad", "afterpulse_weights", value, 0.0, 1e12, "relative shares of the traps")
        if weights and (len(weights) != len(times) or sum(weights) <= 0):
            raise InputError(
                f"Spad.afterpulse_weights = {shown(weights)}: {len(times)} weights with a positive sum are needed, "
                "one for each of afterpulse_times_s; leave them out for equal shares"
            )

    def _check_gate(self) -> None:
        start, width = self.gate_start_s, self.gate_width_s
        if (start is None) != (width is None):
            raise InputError(
                f"Spad.gate_start_s = {shown(start)}, gate_width_s = {shown(width)}: give both, or leave "
                "both out for no gate"
            )
        if start is None or width is None:
            return
        check_number("Spad", "gate_start_s", start, -1.0, 1.0, "seconds on the time axis")
        check_number("Spad", "gate_width_s", width, 1e-15, 1.0, "seconds; a gate needs a positive width")
        if 2 * self.gate_rise_s > width:
            raise InputError(
                f"Spad.gate_rise_s = {self.gate_rise_s:g}: must be at most half of gate_width_s = {width:g}; "
                "rise and fall lie within the gate"
            )

    def _check_tdc_edges(self, given: ArrayLike) -> None:
        if self.tdc_dnl > 0:
            raise InputError(
                f"Spad.tdc_dnl = {self.tdc_dnl:g} with tdc_edges_s: both set the widths of bins; leave one out"
            )
        try:
            rows = _checked_edges(cast(Any, given))
        except TypeError:
            # Lists and arrays have no hash.
            rows = _checked_edges.__wrapped__(given)
        object.__setattr__(self, "tdc_edges_s", rows)

    @property
    def tdc_bins_are_equal(self) -> bool:
        """Whether all bins of the TDC have the width of the time axis's bins."""
        return self.tdc_dnl == 0 and self.tdc_edges_s is None

    @property
    def trap_loads(self) -> tuple[float, ...]:
        """Expected releases that an avalanche leaves in each trap: w_k μ with μ = −ln(1 − p_ap)."""
        weights = np.asarray(self.afterpulse_weights or np.ones(len(self.afterpulse_times_s)))
        return tuple(float(w) for w in -np.log1p(-self.afterpulse_probability) * weights / weights.sum())


@lru_cache(maxsize=1)
def _checked_edges(given: ArrayLike) -> tuple[tuple[float, ...], ...]:
    """The edges of a TDC's bins as numbers; the detectors of all scenes share those that were checked last."""
    return tuple(tuple(row) for row in as_tdc_edges("Spad.tdc_edges_s", given).tolist())


@dataclass(frozen=True)
class Pulse:
    """A laser pulse (or a whole timing response) as it was measured: its light in equal steps of time.

    Attributes
    ----------
    samples : light in each step, ≥ 0, in any unit; their sum is scaled to 1.
    width_s : seconds of a step, within which the light is even.
    start_s : start of the first step, seconds after the moment that counts as emission (may be negative).

    Raises
    ------
    InputError : no samples, samples that are negative, not finite or all 0, or a width that is not positive.

    Examples
    --------
    >>> import datagen as dg
    >>> dg.Pulse([1, 3, 1], width_s=50e-12, start_s=-75e-12).samples
    (0.2, 0.6, 0.2)
    """

    samples: tuple[float, ...]
    width_s: float
    start_s: float = 0.0

    def __post_init__(self) -> None:
        values = as_weights("Pulse.samples", self.samples, (None,))
        if values.sum() <= 0:
            raise InputError("Pulse.samples: all are 0; give the light of the pulse in equal steps of time")
        object.__setattr__(self, "samples", tuple((values / values.sum()).tolist()))
        check_number("Pulse", "width_s", self.width_s, 1e-18, 1.0, "seconds; 50 ps is 50e-12")
        check_number("Pulse", "start_s", self.start_s, -1.0, 1.0, "seconds; 50 ps is 50e-12")


@dataclass(frozen=True)
class Exposure:
    """The conditions of a measurement: its duration, the light, and the laser's pulses.

    Attributes
    ----------
    repetition_rate_hz : laser pulses per second; the laser period is its inverse.
    cycles : number of laser pulses in the exposure.
    photons_per_pulse : photons that leave the laser in one pulse; signal per cycle = transient × photons_per_pulse.
    ambient_rate_hz : background photons per second at one pixel's aperture, before the PDE.
    pulse_fwhm_s : width of the Gaussian laser pulse; it displaces photons before the avalanche.
    pulse : the laser pulse as it was measured, in place of a Gaussian one.

    Examples
    --------
    One second of a 10 MHz laser.

    >>> import datagen as dg
    >>> dg.Exposure(repetition_rate_hz=10e6, cycles=10**7, photons_per_pulse=1e9).period_s
    1e-07
    """

    repetition_rate_hz: float = 10e6
    cycles: int = 10**6
    photons_per_pulse: float = 1e9
    ambient_rate_hz: float = 0.0
    pulse_fwhm_s: float = 0.0
    pulse: Pulse | None = None

    def __post_init__(self) -> None:
        check_number("Exposure", "repetition_rate_hz", self.repetition_rate_hz, 1e-3, 1e13, "pulses per second")
        check_integer("Exposure", "cycles", self.cycles, 1, MAX_CYCLES)
        check_number("Exposure", "photons_per_pulse", self.photons_per_pulse, 0.0, 1e30, "photons")
        check_number("Exposure", "ambient_rate_hz", self.ambient_rate_hz, 0.0, 1e15, "photons per second")
        check_number("Exposure", "pulse_fwhm_s", self.pulse_fwhm_s, 0.0, 1.0, "seconds; 50 ps is 50e-12")
        if self.pulse is not None:
            check_kind("Exposure.pulse", self.pulse, Pulse)
            if self.pulse_fwhm_s:
                raise InputError(
                    f"Exposure.pulse_fwhm_s = {self.pulse_fwhm_s:g} with a measured pulse: both state the pulse; "
                    "leave one out"
                )

    @property
    def period_s(self) -> float:
        """Seconds from one laser pulse to the next."""
        return 1.0 / self.repetition_rate_hz
