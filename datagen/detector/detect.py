"""Counts of a transient under a detector, their exact expected values, and the choice of the sampler."""

from __future__ import annotations

from dataclasses import fields, replace

import numpy as np
from numpy.random import Generator
from numpy.typing import ArrayLike, DTypeLike, NDArray

from datagen.detector.chain import draw_chain
from datagen.detector.events import draw_events
from datagen.detector.expected import (
    counts_are_binomial,
    counts_are_poisson,
    has_exact_mean,
    mean_detections,
    saturated_mean,
)
from datagen.detector.flux import Cycle
from datagen.detector.measurement import Measurement, with_bins_merged
from datagen.detector.random_numbers import draw_poisson, generator_of
from datagen.detector.sampler_choice import DEFAULT_TOLERANCE, Choices, Sampler, SamplerChoice, choose, summarise
from datagen.detector.spad import Exposure, Spad
from datagen.errors import InputError, shown
from datagen.records import TimeAxis
from datagen.records.arrays import Floats, Ints
from datagen.records.checks import check_flag, check_number

Counts = NDArray[np.integer]


def detect(
    transient: ArrayLike, time: TimeAxis, spad: Spad, exposure: Exposure, seed: int = 0, *,
    tolerance: float = DEFAULT_TOLERANCE, approximate: bool = False, first_pixel: int = 0,
    dtype: DTypeLike = np.int64,
) -> Counts:  # fmt: skip
    """Counts after an exposure, the shape of `transient` (with `Spad.bins_merged` bins added up to one).

    Laser pulse and carrier diffusion displace photons, gate and PDE thin them, and background joins them. The dead
    time removes events; the TDC's jitter displaces the records of those that are left, and its bins, equal or not,
    count them. Every histogram is drawn by the cheapest sampler that is exact, or whose bias is at most `tolerance`
    and a tenth of a standard deviation (see `choose_sampler`).

    Parameters
    ----------
    transient : (laser, pixel, bin) or (bin,); expected photons at the aperture per emitted photon and bin. Light
        outside the time axis is not modelled: a direct return before its start causes no dead time.
    seed : fixes every count of the call.
    tolerance : relative bias that a cheaper sampler may have; with 0 every sampler is exact.
    approximate : whether a sampler whose mean alone is exact may be taken where the exact one would take too long.
    first_pixel : number of the first pixel, where `transient` has some of an array's pixels, each with its own dark
        counts and TDC bins. Crosstalk needs all pixels of the array at once.
    dtype : integer type of the counts; one too small for them raises.

    Raises
    ------
    InputError
        NaN, infinite or negative flux; a gate outside the laser period; more counts than `dtype` holds; more events
        than an exact sampler can draw.

    Examples
    --------
    >>> import datagen as dg
    >>> exposure = dg.Exposure(repetition_rate_hz=10e6, cycles=10**6, photons_per_pulse=1e9)
    >>> time = dg.TimeAxis(bins=4, width_s=1e-9)
    >>> counts = dg.detect([0, 1e-12, 2e-12, 0], time, dg.Spad(pde=0.5), exposure, seed=0)
    >>> counts.shape, counts.dtype.name, bool(900 < counts.sum() < 2100)
    ((4,), 'int64', True)
    """
    return detect_and_choice(
        transient, time, spad, exposure, seed, tolerance=tolerance, approximate=approximate,
        first_pixel=first_pixel, dtype=dtype,
    )[0]  # fmt: skip


def detect_and_choice(
    transient: ArrayLike, time: TimeAxis, spad: Spad, exposure: Exposure, seed: int = 0, *,
    tolerance: float = DEFAULT_TOLERANCE, approximate: bool = False, first_pixel: int = 0,
    dtype: DTypeLike = np.int64,
) -> tuple[Counts, SamplerChoice]:  # fmt: skip
    """The results of `detect` and of `choose_sampler`, for which the flux is computed once."""
    check_flag("approximate", approximate)
    check_number("detect", "tolerance", tolerance, 0.0, 1.0, "a relative bias, such as 1e-3")
    try:
        kind = np.dtype(dtype)
    except (TypeError, ValueError):
        raise InputError(
            f"detect: dtype = {shown(dtype)}: an integer type such as int64 or uint16 is needed"
        ) from None
    if kind.kind not in "iu":
        raise InputError(f"detect: dtype {kind} given; counts need an integer type such as int64 or uint16")
    measured = Measurement.of(transient, time, spad, exposure, first_pixel)
    lasers, pixels, bins = measured.transient.shape
    rng = generator_of(seed)
    counts = np.empty((lasers * pixels, bins // spad.bins_merged), kind)
    limit = np.iinfo(kind).max
    choices: list[Choices] = []
    for first, flux in measured.fluxes():
        rows = slice(first * pixels, (first + len(flux)) * pixels)
        chosen = _choose_block(measured, first, flux, tolerance, approximate)
        drawn = with_bins_merged(_draw_block(measured, first, flux, chosen, rng), spad)
        if kind != np.int64 and drawn.max() > limit:
            row, bin_ = (int(i) for i in np.unravel_index(int(drawn.argmax()), drawn.shape))
            raise InputError(
                f"{measured.where(rows.start + row)}, bin {bin_}: {drawn.max()} counts do not fit "
                f"{kind} (at most {limit}); lower cycles or photons_per_pulse, set counter_max, or use a wider dtype"
            )
        counts[rows] = drawn
        choices.append(chosen)
    return counts.reshape(*np.shape(transient)[:-1], -1), summarise(choices, spad, tolerance)


def expected_histogram(
    transient: ArrayLike, time: TimeAxis, spad: Spad, exposure: Exposure, *, approximate: bool = False,
    first_pixel: int = 0,
) -> Floats:  # fmt: skip
    """Expected counts per bin after an exposure: the exact mean of `detect` over all seeds.

    The mean under a dead time is the solution of a renewal equation, bin after bin (`datagen.detector.dead_time`); no
    number is drawn.

    Parameters
    ----------
    transient, time, spad, exposure, first_pixel : as of `detect`.
    approximate : whether a self-consistent mean may be given where no exact one is known in closed form. Its error is
        of second order in the probabilities. This concerns afterpulsing or crosstalk together with a dead time, and
        saturating counters where detections depend on one another (except the binomial counts of a synchronous
        detector whose bin counts a cycle at most once).

    Returns
    -------
    float64, the shape of `transient` (with `Spad.bins_merged` bins added up to one): counts, of all
    `exposure.cycles` together.

    Raises
    ------
    InputError
        No exact mean and not `approximate`; a transient or a gate that `detect` refuses.

    Examples
    --------
    10⁶ cycles of 10⁹ photons, half of which are detected; after a detection the diode is blind for its dead time.

    >>> import datagen as dg
    >>> exposure, time = dg.Exposure(cycles=10**6, photons_per_pulse=1e9), dg.TimeAxis(bins=4, width_s=1e-9)
    >>> transient = [0, 1e-10, 2e-10, 0]
    >>> for spad in (dg.Spad(pde=0.5, mode="ideal"), dg.Spad(pde=0.5, mode="synchronous", dead_time_s=50e-9)):
    ...     print(dg.expected_histogram(transient, time, spad, exposure).round().tolist())
    [0.0, 50000.0, 100000.0, 0.0]
    [0.0, 48771.0, 90521.0, 0.0]
    """
    check_flag("approximate", approximate)
    measured = Measurement.of(transient, time, spad, exposure, first_pixel)
    if not approximate and not has_exact_mean(spad, measured.transient.shape[1]):
        raise InputError(
            "expected_histogram: afterpulsing or crosstalk together with a dead time has no exact mean in closed "
            "form; pass approximate=True for one of second-order error, or average detect over seeds"
        )
    out = np.empty(measured.transient.shape)
    for first, flux in measured.fluxes():
        cycle, tdc = measured.finer
        detections = np.stack([mean_detections(values, cycle, spad) for values in measured.flux_in_finer(flux)])
        mean = tdc.mean(exposure.cycles * detections)
        out[first : first + len(mean)] = _saturate_mean(mean, flux, measured, approximate)
    return with_bins_merged(out, spad).reshape(*np.shape(transient)[:-1], -1)


def choose_sampler(
    transient: ArrayLike, time: TimeAxis, spad: Spad, exposure: Exposure, *, tolerance: float = DEFAULT_TOLERANCE,
    approximate: bool = False, first_pixel: int = 0,
) -> SamplerChoice:  # fmt: skip
    """How `detect` would draw the counts, and why, without drawing them; parameters as of `detect`.

    Raises `InputError` where `detect` would refuse.
    """
    measured = Measurement.of(transient, time, spad, exposure, first_pixel)
    blocks = [_choose_block(measured, *block, tolerance, approximate) for block in measured.fluxes()]
    return summarise(blocks, spad, tolerance)


def _choose_block(
    measured: Measurement, first_laser: int, flux: Floats, tolerance: float, approximate: bool
) -> Choices:
    """How each histogram of a block of flux (laser, pixel, n) is drawn; where crosstalk couples the pixels of a laser
    point, all of them are drawn alike."""
    _, pixels, n = flux.shape
    spad, others = measured.spad, (measured.exposure, tolerance, approximate)
    if measured.is_coupled:
        of_array = flux.sum(axis=1)
        chosen = choose(of_array, measured.cycle, spad, *others, lambda row: f"laser {first_laser + row}")
        return Choices(*(np.repeat(getattr(chosen, f.name), pixels) for f in fields(chosen)))
    # A single pixel has no neighbours.
    alone = spad if spad.crosstalk_probability == 0 else replace(spad, crosstalk_probability=0.0)
    first = first_laser * pixels
    return choose(flux.reshape(-1, n), measured.cycle, alone, *others, lambda row: measured.where(first + row))


def _draw_block(measured: Measurement, first_laser: int, flux: Floats, choices: Choices, rng: Generator) -> Ints:
    """(h, bin) counts of the h histograms of a block of flux (laser, pixel, n)."""
    spad, cycles, pixels = measured.spad, measured.exposure.cycles, flux.shape[1]
    values = flux.reshape(-1, flux.shape[2])
    out = np.empty((len(values), measured.cycle.bins), np.int64)
    poisson = choices.sampler == Sampler.POISSON
    if len(rows := np.flatnonzero(poisson)):
        # Poisson events that are displaced independently stay Poisson, so the mean is displaced, not every event.
        mean, numbers = measured.tdc.mean(cycles * values[rows], rows % pixels), first_laser * pixels + rows
        out[rows] = draw_poisson(mean, rng, lambda row: measured.where(numbers[row]))
    if len(rows := np.flatnonzero(~poisson)):
        cycle, tdc = measured.finer
        step = pixels if measured.is_coupled else 1
        groups = measured.flux_in_finer(values[rows]).reshape(-1, step, len(cycle.gate))
        each = zip(groups, choices.sampler[rows[::step]], strict=True)
        drawn = [_draw(own, cycle, spad, cycles, Sampler(code), rng) for own, code in each]
        out[rows] = tdc.draw(np.concatenate(drawn), rng, rows % pixels)
    return out if spad.counter_max is None else np.minimum(out, spad.counter_max)


def _draw(flux: Floats, cycle: Cycle, spad: Spad, cycles: int, sampler: Sampler, rng: Generator) -> Ints:
    """(pixel, n) detections of one pixel, or of those that crosstalk couples, with flux (pixel, n); not by Poisson's
    sampler."""
    if sampler == Sampler.CHAIN:
        return draw_chain(flux[0], cycle, spad.dead_time_s, cycles, rng)[None]
    if sampler == Sampler.EVENTS:
        return draw_events(flux, cycle, spad, cycles, rng)
    detections = mean_detections(flux, cycle, spad)
    total, events = detections.sum(axis=1), flux.sum(axis=1)
    # What thins events evens them out, too: at a constant rate by the Fano factor 1 / (1 + λτ)² of renewal theory,
    # which is the square of the share that is detected.
    share = np.divide(total, events, out=np.zeros_like(total), where=events > 0)
    drawn = np.maximum(np.rint(rng.normal(cycles * total, share * np.sqrt(cycles * total))), 0.0).astype(np.int64)
    shape = np.divide(detections, total[:, None], out=np.zeros_like(detections), where=total[:, None] > 0)
    return np.asarray(rng.multinomial(drawn, shape))


def _saturate_mean(mean: Floats, flux: Floats, measured: Measurement, approximate: bool) -> Floats:
    """(laser, pixel, bin) mean counts of counters that stay at their maximum, from the mean counts without one.

    flux : (laser, pixel, n). Raises `InputError` where the law of the counts is unknown, unless `approximate`.
    """
    spad, exposure = measured.spad, measured.exposure
    if spad.counter_max is None:
        return mean
    # Eight standard deviations below the maximum a counter never fills.
    reach = mean + 8 * np.sqrt(mean) + 8 > spad.counter_max
    if not reach.any():
        return mean
    poisson = counts_are_poisson(spad, mean.shape[1])
    if not (poisson or approximate or counts_are_binomial(flux, measured.cycle, spad, mean.shape[1])):
        raise InputError(
            f"expected_histogram: counter_max = {spad.counter_max} is reached where counts are neither Poisson nor "
            f"binomial (mode {spad.mode!r} with detections that depend on one another), and the law of a bin's count "
            "has no closed form; pass approximate=True, or leave counter_max out"
        )
    return np.where(reach, saturated_mean(mean, exposure.cycles, spad.counter_max, not poisson), mean)
