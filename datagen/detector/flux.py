"""The flux of a transient: expected avalanche-capable events per laser cycle, over the whole laser period,

    λ_i = gate_i · [PDE · (signal_i + ambient · w_i) + dark · w_i],    w_i the width of bin i.

Bins outside the recorded window count too, because an event there keeps the detector dead inside. Far from the
window, where there is only background, they are merged into long bins.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from typing import TypeVar

import numpy as np
from numpy.random import Generator
from numpy.typing import NDArray

from datagen.detector.irf import Kernel, measured_kernel, response_kernel, spread
from datagen.detector.spad import Exposure, Spad
from datagen.errors import InputError
from datagen.records import TimeAxis
from datagen.records.arrays import Bools, Floats, Ints

N = TypeVar("N", bound=np.generic)

_MAX_PERIOD_BINS = 8_000_000
"""Most bins of a laser period: 64 MB for each array."""
_RAMP_PIECES = 16
"""Pieces of a ramp of the gate beyond the window, in which background is taken as even."""


@dataclass(frozen=True)
class Cycle:
    """One laser period cut into n bins; phase 0 is the start of the time axis.

    period_s, width_s : the laser period; the width of a recorded bin.
    edges_s : (n + 1,) bin edges from 0 to the period. The first `front` bins are the recorded window and a margin, on
        the lattice of the TDC (multiples of the bin width). Then come long background bins, if any. The last `back`
        bins are on the lattice before phase 0.
    gate : (n,) mean sensitivity of each bin, 0 … 1.
    bins : number of recorded bins, those of the time axis.
    before_avalanche, after_avalanche : displacement of photons (pulse, carrier diffusion) and of records (TDC).
    """

    period_s: float
    width_s: float
    edges_s: Floats
    gate: Floats
    front: int
    back: int
    bins: int
    before_avalanche: Kernel
    after_avalanche: Kernel

    @cached_property
    def widths_s(self) -> Floats:
        """(n,) bin widths in seconds."""
        return np.diff(self.edges_s)

    @cached_property
    def has_short_bin(self) -> bool:
        """Whether a period that is no whole number of bins ends in a shorter one."""
        return self.front == len(self.gate) and float(self.widths_s[-1]) < self.width_s * (1 - 1e-6)

    def parts(self, pieces: int) -> Ints:
        """(n,) number of pieces of each bin if those of full width on the lattice are cut into `pieces`."""
        parts = np.ones(len(self.gate), np.int64)
        parts[: self.front - self.has_short_bin] = pieces
        parts[len(parts) - self.back :] = pieces
        return parts

    def cut(self, pieces: int) -> Cycle:
        """The cycle with the bins of the lattice cut into `pieces` equal bins."""
        parts = self.parts(pieces)
        return replace(
            self, width_s=self.width_s / pieces, edges_s=cut_edges(self.edges_s, parts),
            gate=np.repeat(self.gate, parts), front=int(parts[: self.front].sum()), back=self.back * pieces,
            bins=int(parts[: self.bins].sum()),
        )  # fmt: skip

    @cached_property
    def light_fold(self) -> Fold:
        """The bins of the period into which light falls once pulse and diffusion have displaced it."""
        response = self.before_avalanche
        count = self.bins + len(response.weights) - 1
        return fold_of(-response.before, count, self.width_s, self.edges_s)


@lru_cache(maxsize=1)
def cycle_of(time: TimeAxis, spad: Spad, exposure: Exposure) -> Cycle:
    """The laser period cut into bins for a time axis. The last result is cached, as scenes often share a detector.

    The TDC measures times since the last pulse, whatever the detector's mode: photons and records that are displaced
    beyond an end of the period appear at its other end.

    Raises `InputError` for a time axis longer than the period and for a gate that is not within the period.
    """
    width, bins, period = time.width_s, time.bins, exposure.period_s
    pulse = photon_kernel(width, spad, exposure)
    jitter = response_kernel(width, spad.jitter_fwhm_s)
    # Light and records are displaced by so many bins: the window needs that margin on either side.
    after, before = pulse.after + jitter.before, pulse.before + jitter.after
    if beyond := time.beyond_period(exposure.repetition_rate_hz):
        raise InputError(f"Exposure.repetition_rate_hz = {exposure.repetition_rate_hz:g}: {beyond}")
    whole = max(int(np.floor(period / width * (1 + 1e-12) + 1e-9)), bins)
    lattice = width * np.arange(min(whole, bins + after) + 1)
    if whole > bins + after + before + 1:
        start, stop = lattice[-1], period - before * width
        knots = _gate_knots(time, spad, period)
        tail = period - width * np.arange(before, -1, -1)
        edges = np.concatenate([lattice, knots[(start < knots) & (knots < stop)], tail])
        front, back = bins + after, before
    else:
        lattice = width * np.arange(whole + 1)
        rest = period - whole * width
        edges = np.append(lattice, period) if rest > 1e-6 * width else lattice
        edges[-1] = period
        front, back = len(edges) - 1, 0
    if len(edges) > _MAX_PERIOD_BINS:
        raise InputError(
            f"laser period {period:g} s in bins of {width:g} s: {len(edges)} bins, at most {_MAX_PERIOD_BINS} are "
            "handled; check repetition_rate_hz, the bin width and the jitter"
        )
    gate = _gate(edges, time, spad, period)
    edges.flags.writeable = gate.flags.writeable = False
    return Cycle(period, width, edges, gate, front, back, bins, pulse, jitter)


def photon_kernel(width_s: float, spad: Spad, exposure: Exposure) -> Kernel:
    """The response to a photon before the avalanche, on bins of a width: laser pulse and carrier diffusion."""
    tail = spad.jitter_tail_s, spad.jitter_tail_fraction
    if exposure.pulse is None:
        return response_kernel(width_s, exposure.pulse_fwhm_s, *tail)
    return measured_kernel(width_s, exposure.pulse, *tail)


def _gate_span(time: TimeAxis, spad: Spad, period_s: float) -> tuple[float, float] | None:
    """Phases at which the gate opens and closes, seconds; None without a gate."""
    if spad.gate_start_s is None or spad.gate_width_s is None:
        return None
    start = spad.gate_start_s - time.start_s
    stop = start + spad.gate_width_s
    slack = 1e-9 * period_s
    if start < -slack or stop > period_s + slack:
        low, high = time.start_s, time.start_s + period_s
        raise InputError(
            f"Spad.gate_start_s = {spad.gate_start_s:g}, gate_width_s = {spad.gate_width_s:g}: the gate must lie in "
            f"the laser period, {low:g} … {high:g} s on the time axis; move or narrow it"
        )
    return max(start, 0.0), min(stop, period_s)


def _gate_knots(time: TimeAxis, spad: Spad, period_s: float) -> Floats:
    """Phases, ascending, between which the gate's sensitivity is nearly constant: its ramps are cut into pieces."""
    span = _gate_span(time, spad, period_s)
    if span is None:
        return np.empty(0)
    ramp = spad.gate_rise_s * np.linspace(0, 1, _RAMP_PIECES + 1)
    knots = np.unique(np.concatenate([span[0] + ramp, span[1] - ramp]))
    return np.asarray(knots[np.append(True, np.diff(knots) > 1e-12 * period_s)], np.float64)


def _gate(edges_s: Floats, time: TimeAxis, spad: Spad, period_s: float) -> Floats:
    """(n,) mean sensitivity of each bin: the mean of a trapezoid 0 → 1 → 0."""
    span = _gate_span(time, spad, period_s)
    if span is None:
        return np.ones(len(edges_s) - 1)
    start, stop = span
    rise = spad.gate_rise_s

    def ramp_integral(t: Floats) -> Floats:
        """∫ from 0 to t of a ramp that is 0 at 0, 1 at `rise`, and 1 ever after."""
        return np.where(t < rise, 0.5 * t**2 / rise if rise > 0 else 0.0, t - 0.5 * rise) * (t > 0)

    opened = ramp_integral(edges_s - start) - ramp_integral(edges_s - (stop - rise))
    gate = np.diff(opened) / np.diff(edges_s)
    # Rounding of the difference must not leave a trace of light behind a shut gate.
    gate = np.where(np.abs(gate - 1) < 1e-6, 1.0, np.where(np.abs(gate) < 1e-9, 0.0, gate))
    return np.clip(gate, 0.0, 1.0)


@dataclass(frozen=True)
class Fold:
    """The bins of the period in which bins of the lattice lie: most coincide with one, a few are split over several.

    first : number of the first bin of the lattice.
    bins : number of bins of the period.
    aligned : numbers of the lattice bins that are copied whole, bin k of the lattice to bin k of the period.
    rows, columns, shares : (e,) of the other ones: position on the lattice, bin of the period, share; ordered by row.
    """

    first: int
    bins: int
    aligned: range
    rows: Ints
    columns: Ints
    shares: Floats

    def with_row(self, row: int, columns: Ints, shares: Floats) -> Fold:
        """The fold with one more position, behind all others, which is split over some bins."""
        rows = np.append(self.rows, np.full(len(columns), row))
        return replace(
            self, rows=rows, columns=np.append(self.columns, columns), shares=np.append(self.shares, shares)
        )

    def aligned_of(self, values: NDArray[N]) -> NDArray[N]:
        """(…, bins) those of the values (…, lattice) that are copied whole."""
        out = np.zeros((*values.shape[:-1], self.bins), values.dtype)
        low, high = self.aligned.start, self.aligned.stop
        out[..., low:high] = values[..., low - self.first : high - self.first]
        return out

    def draw(self, counts: Ints, rng: Generator) -> Ints:
        """(h, bins) counts (h, lattice) in the bins of the period: those of a bin that is split are multinomial."""
        out = self.aligned_of(counts)
        rows, starts = np.unique(self.rows, return_index=True)
        for row, start, stop in zip(rows, starts, np.append(starts, len(self.rows))[1:], strict=True):
            split = rng.multinomial(counts[:, row], self.shares[start:stop])
            np.add.at(out.T, self.columns[start:stop], split.T)
        return out

    def __call__(self, values: Floats) -> Floats:
        """(…, bins) values in the bins of the period, from values (…, lattice)."""
        out = self.aligned_of(values)
        for row, column, share in zip(self.rows, self.columns, self.shares, strict=True):
            out[..., column] += values[..., row] * share
        return out


def cut_edges(edges_s: Floats, parts: Ints) -> Floats:
    """(m + 1,) edges of bins with edges (n + 1,) once bin i is cut into `parts[i]` equal bins."""
    bin_of = np.repeat(np.arange(len(parts)), parts)
    number = np.arange(len(bin_of)) - (np.cumsum(parts) - parts)[bin_of]
    return np.append(edges_s[bin_of] + number * (np.diff(edges_s) / parts)[bin_of], edges_s[-1])


def on_lattice(values: NDArray[N], back: int, front: int) -> NDArray[N]:
    """(…, back + front) values of the last `back` bins of the period, then of its first `front`, from (…, n)."""
    n = values.shape[-1]
    if back == 0:
        return values[..., :front]
    return np.concatenate([values[..., n - back :], values[..., :front]], axis=-1)


def fold_of(first: int, count: int, width_s: float, edges_s: Floats) -> Fold:
    """The `Fold` of lattice bins `first … first + count − 1` into the bins of the period, modulo its length."""
    period, bins = float(edges_s[-1]), len(edges_s) - 1
    # Bins of the period whose edges lie on multiples of the width are bins of the lattice themselves.
    on_lattice = np.abs(edges_s - width_s * np.arange(bins + 1)) < 1e-6 * width_s
    last = bins if on_lattice.all() else int(np.argmin(on_lattice)) - 1
    aligned = range(max(first, 0), max(min(first + count, last), 0))
    rows, columns, shares = [], [], []
    for number in (*range(first, aligned.start), *range(aligned.stop, first + count)):
        start = number * width_s % period
        # A bin that the end of the period cuts goes on at its start.
        pieces = [(start, min(start + width_s, period))]
        if start + width_s > period:
            pieces.append((0.0, start + width_s - period))
        for low, high in pieces:
            left = max(int(np.searchsorted(edges_s, low, side="right")) - 1, 0)
            right = min(int(np.searchsorted(edges_s, high, side="left")), bins)
            for column in range(left, right):
                share = (min(high, edges_s[column + 1]) - max(low, edges_s[column])) / width_s
                if share > 1e-6:
                    rows.append(number - first)
                    columns.append(column)
                    shares.append(share)
    row = np.array(rows, np.int64)
    share_of = np.array(shares, np.float64)
    # The slivers left out above are given to the other shares of their bin, so that nothing is lost.
    share_of /= np.bincount(row, share_of, count)[row] if len(row) else 1.0
    return Fold(first, bins, aligned, row, np.array(columns, np.int64), share_of)


def flux_per_cycle(transient: Floats, cycle: Cycle, spad: Spad, exposure: Exposure, first_pixel: int = 0) -> Floats:
    """(laser, pixel, n) λ, the expected avalanche-capable events per cycle in each bin of the period.

    transient : (laser, pixel, bin). first_pixel : number of its first pixel, on which hot pixels depend.
    """
    flux = arrivals(transient, cycle)
    flux *= spad.pde * exposure.photons_per_pulse
    background = spad.pde * exposure.ambient_rate_hz + dark_count_rates(spad, transient.shape[1], first_pixel)
    flux += background[:, None] * cycle.widths_s
    flux *= cycle.gate
    return flux


def arrivals(light: Floats, cycle: Cycle) -> Floats:
    """(laser, pixel, n) photons of `light` (laser, pixel, bin) in each bin of the period, displaced by the laser
    pulse and by carrier diffusion; a new array."""
    return cycle.light_fold(spread(light, cycle.before_avalanche))


def dark_count_rates(spad: Spad, pixels: int, first_pixel: int = 0) -> Floats:
    """(pixels,) dark counts per second of the pixels from number `first_pixel` on, some of which are hot.

    Raises `InputError` if factors are given for fewer pixels.
    """
    rates = np.full(pixels, float(spad.dark_count_rate_hz))
    if factors := spad.dark_count_factors:
        if len(factors) < first_pixel + pixels:
            raise InputError(
                f"Spad.dark_count_factors: {len(factors)} numbers, and pixels {first_pixel} … "
                f"{first_pixel + pixels - 1} are measured; give one for each pixel, or none"
            )
        rates *= factors[first_pixel : first_pixel + pixels]
    if spad.hot_pixel_fraction > 0:
        rates[hot_pixels(spad, pixels, first_pixel)] *= spad.hot_pixel_factor
    return rates


def hot_pixels(spad: Spad, pixels: int, first_pixel: int = 0) -> Bools:
    """(pixels,) whether a pixel is hot: a property of the array, the same for every laser point and block."""
    return uniform_of_pixels(spad.hot_pixel_seed, 1, pixels, first_pixel)[:, 0] < spad.hot_pixel_fraction


def uniform_of_pixels(seed: int, numbers: int, pixels: int, first_pixel: int) -> Floats:
    """(pixels, numbers) uniform numbers in 0 … 1 that belong to the pixels from number `first_pixel` on."""
    # A counter-based generator gives each pixel its own words, so that a block needs no words of other pixels.
    key = np.random.SeedSequence(seed).generate_state(2, np.uint64)
    first, count = first_pixel * numbers, pixels * numbers
    bits = np.random.Philox(key=key, counter=first // 4)
    words = bits.random_raw(count + first % 4)[first % 4 :]
    return np.asarray((words >> np.uint64(11)) * 2.0**-53, np.float64).reshape(pixels, numbers)
