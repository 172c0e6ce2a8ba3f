"""Transient → counts, their exact mean, and the samplers by which they are drawn."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, fields, replace
from functools import partial

import numpy as np
from numpy.typing import ArrayLike, DTypeLike, NDArray

from datagen.detector.avalanches import draw_avalanches
from datagen.detector.chain import draw_cycle_ensemble, draw_hazard_chain, draw_in_order, draw_return_chain
from datagen.detector.equilibrium import FOR_A_START, equilibrium
from datagen.detector.events import draw_free_running
from datagen.detector.expected import (
    counts_are_binomial,
    counts_are_poisson,
    has_exact_mean,
    mean_detections,
    saturated_mean,
)
from datagen.detector.flux import Cycle, checked_transient, cycle_of, flux_per_cycle
from datagen.detector.poisson import draw_poisson
from datagen.detector.renewal import pieces_of
from datagen.detector.sampler_choice import DEFAULT_TOLERANCE, Choices, Sampler, SamplerChoice, choose, summarise
from datagen.detector.spad import Exposure, Spad
from datagen.detector.streams import Stream, streams_of
from datagen.detector.tdc import Tdc
from datagen.errors import InputError
from datagen.records import TimeAxis
from datagen.records.checks import check_integer, check_kind, check_number, shown

Array = NDArray[np.float64]
Counts = NDArray[np.integer]

_BLOCK_VALUES = 1 << 16
"""Flux values held at a time: laser points are worked through in blocks of 0.5 MB, which caches hold."""


def detect(
    transient: ArrayLike, time: TimeAxis, spad: Spad, exposure: Exposure, seed: int = 0, *,
    tolerance: float = DEFAULT_TOLERANCE, approximate: bool = False, first_laser: int = 0, first_pixel: int = 0,
    dtype: DTypeLike = np.int64,
) -> Counts:  # fmt: skip
    """Counts after an exposure, the shape of `transient`.

    Photons are displaced by pulse and carrier diffusion, thinned by gate and PDE, joined by background; what the dead
    time leaves of them is displaced by the TDC's jitter and counted. Every histogram is drawn by the cheapest sampler
    that is exact, or biased by no more than `tolerance` and a tenth of a standard deviation (see `choose_sampler`).

    Parameters
    ----------
    transient : (laser, pixel, bin) or (bin,); expected photons at the aperture per emitted photon and bin. A detector
        knows only of light within the time axis: a direct return before its start causes no dead time.
    seed : together with the laser point's and pixel's number it fixes every count.
    tolerance : relative bias allowed to a cheaper sampler; 0: always the exact one.
    approximate : allow a sampler that is exact in the mean only where the exact one would take too long.
    first_laser, first_pixel : numbers of the first laser point and pixel when `transient` is a block of a larger one;
        the counts are then those of that block. Crosstalk needs all pixels of the array at once.
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
    counts, _ = detect_and_choice(
        transient, time, spad, exposure, seed, tolerance=tolerance, approximate=approximate, first_laser=first_laser,
        first_pixel=first_pixel, dtype=dtype,
    )  # fmt: skip
    return counts


def detect_and_choice(
    transient: ArrayLike, time: TimeAxis, spad: Spad, exposure: Exposure, seed: int = 0, *,
    tolerance: float = DEFAULT_TOLERANCE, approximate: bool = False, first_laser: int = 0, first_pixel: int = 0,
    dtype: DTypeLike = np.int64,
) -> tuple[Counts, SamplerChoice]:  # fmt: skip
    """`detect` and `choose_sampler` in one pass, for which the flux is worked out once."""
    check_number("detect", "tolerance", tolerance, 0.0, 1.0, "a relative bias, such as 1e-3")
    try:
        kind = np.dtype(dtype)
    except TypeError:
        raise InputError(
            f"detect: dtype = {shown(dtype)}: an integer type such as int64 or uint16 is needed"
        ) from None
    if kind.kind not in "iu":
        raise InputError(f"detect: dtype {kind} given; counts need an integer type such as int64 or uint16")
    setup = _Setup.of(transient, time, spad, exposure, first_laser, first_pixel)
    lasers, pixels, bins = setup.transient.shape
    streams = streams_of(seed, first_laser + np.arange(lasers)[:, None], first_pixel + np.arange(pixels))
    counts = np.empty((lasers * pixels, bins), kind)
    limit = np.iinfo(kind).max
    choices: list[Choices] = []
    for flux in setup.fluxes():
        rows = slice(flux.first * pixels, (flux.first + len(flux.values)) * pixels)
        chosen = _choices(setup, flux, tolerance, approximate)
        drawn = _drawn(setup, flux, chosen, streams.reshape(-1, 4)[rows])
        if kind != np.int64 and drawn.max() > limit:
            row, bin_ = (int(i) for i in np.unravel_index(int(drawn.argmax()), drawn.shape))
            raise InputError(
                f"{setup.where(np.arange(rows.start, rows.stop), row)}, bin {bin_}: {drawn.max()} counts do not fit "
                f"{kind} (at most {limit}); lower cycles or photons_per_pulse, set counter_max, or use a wider dtype"
            )
        counts[rows] = drawn
        choices.append(chosen)
    return counts.reshape(np.shape(transient)), summarise(choices, spad, tolerance)


def expected_histogram(
    transient: ArrayLike, time: TimeAxis, spad: Spad, exposure: Exposure, *, approximate: bool = False,
    first_pixel: int = 0,
) -> Array:  # fmt: skip
    """Expected counts per bin after an exposure: the exact mean of `detect` over all seeds.

    Dead time in the mean is a renewal equation, solved bin after bin (`renewal`, `equilibrium`); no number is drawn.

    Parameters
    ----------
    transient, time, spad, exposure, first_pixel : as of `detect`.
    approximate : allow a self-consistent mean, whose error is of second order in the probabilities, where there is
        no exact one in closed form: afterpulsing or crosstalk together with a dead time, and counters that saturate
        where detections depend on one another (but for the binomial counts of a synchronous detector whose bin
        counts a cycle at most once).

    Returns
    -------
    float64, the shape of `transient`: counts, of all `exposure.cycles` together.

    Raises
    ------
    InputError
        No exact mean and not `approximate`; a transient or a gate that `detect` refuses.

    Examples
    --------
    10⁶ cycles of 10⁹ photons, of which half are detected; after a detection the diode is blind for its dead time.

    >>> import datagen as dg
    >>> exposure, time = dg.Exposure(cycles=10**6, photons_per_pulse=1e9), dg.TimeAxis(bins=4, width_s=1e-9)
    >>> transient = [0, 1e-10, 2e-10, 0]
    >>> for spad in (dg.Spad(pde=0.5, mode="ideal"), dg.Spad(pde=0.5, mode="synchronous", dead_time_s=50e-9)):
    ...     print(dg.expected_histogram(transient, time, spad, exposure).round().tolist())
    [0.0, 50000.0, 100000.0, 0.0]
    [0.0, 48771.0, 90521.0, 0.0]
    """
    setup = _Setup.of(transient, time, spad, exposure, 0, first_pixel)
    if not approximate and not has_exact_mean(spad, setup.transient.shape[1]):
        raise InputError(
            "expected_histogram: afterpulsing or crosstalk together with a dead time has no exact mean in closed "
            "form; pass approximate=True for one of second-order error, or average detect over seeds"
        )
    out = np.empty(setup.transient.shape)
    for flux in setup.fluxes():
        detections = np.stack([mean_detections(values, setup.cycle, spad) for values in flux.values])
        mean = setup.tdc.mean(exposure.cycles * detections)
        out[flux.first : flux.first + len(mean)] = _saturate_mean(mean, flux.values, setup, approximate)
    return out.reshape(np.shape(transient))


def choose_sampler(
    transient: ArrayLike, time: TimeAxis, spad: Spad, exposure: Exposure, *, tolerance: float = DEFAULT_TOLERANCE,
    approximate: bool = False, first_pixel: int = 0,
) -> SamplerChoice:  # fmt: skip
    """How `detect` would draw the counts, and why, without drawing them; parameters as of `detect`.

    Raises `InputError` where `detect` would refuse.
    """
    setup = _Setup.of(transient, time, spad, exposure, 0, first_pixel)
    return summarise([_choices(setup, flux, tolerance, approximate) for flux in setup.fluxes()], spad, tolerance)


@dataclass(frozen=True)
class _Flux:
    """The flux per cycle of laser points `first`, …: (laser, pixel, n)."""

    first: int
    values: Array


@dataclass(frozen=True)
class _Setup:
    """What all histograms of a call share."""

    transient: Array
    cycle: Cycle
    tdc: Tdc
    spad: Spad
    exposure: Exposure
    first_laser: int
    first_pixel: int

    @classmethod
    def of(
        cls, transient: ArrayLike, time: TimeAxis, spad: Spad, exposure: Exposure, first_laser: int, first_pixel: int
    ) -> _Setup:
        """Check the arguments of a call; raises `InputError`."""
        check_kind("time", time, TimeAxis)
        check_kind("spad", spad, Spad)
        check_kind("exposure", exposure, Exposure)
        for name, value in (("first_laser", first_laser), ("first_pixel", first_pixel)):
            check_integer("detect", name, value, 0, 2**62)
        values = checked_transient(transient, time, exposure.photons_per_pulse)
        pixels = values.shape[1]
        if _has_crosstalk(spad) and (first_pixel != 0 or pixels % (spad.array_columns or 1) != 0):
            raise InputError(
                f"crosstalk_probability = {spad.crosstalk_probability:g}, array_columns = {spad.array_columns}, with "
                f"{pixels} pixels from number {first_pixel}: crosstalk needs whole rows of all pixels from number 0"
            )
        cycle = cycle_of(time, spad, exposure)
        return cls(values, cycle, Tdc(cycle), spad, exposure, first_laser, first_pixel)

    @property
    def coupled(self) -> bool:
        """Whether crosstalk makes the pixels of a laser point one system."""
        return _has_crosstalk(self.spad) and self.transient.shape[1] > 1

    def where(self, numbers: NDArray[np.int64], row: int) -> str:
        """Words for histogram `numbers[row]` of the call."""
        laser, pixel = divmod(int(numbers[row]), self.transient.shape[1])
        return f"laser {self.first_laser + laser}, pixel {self.first_pixel + pixel}"

    def fluxes(self) -> Iterator[_Flux]:
        """Flux of one block of laser points after the other."""
        lasers, pixels, _ = self.transient.shape
        step = max(_BLOCK_VALUES // (pixels * len(self.cycle.gate)), 1)
        for start in range(0, lasers, step):
            block = self.transient[start : start + step]
            yield _Flux(start, flux_per_cycle(block, self.cycle, self.spad, self.exposure, self.first_pixel))


def _has_crosstalk(spad: Spad) -> bool:
    return spad.crosstalk_probability > 0 and spad.mode != "ideal"


def _choices(setup: _Setup, flux: _Flux, tolerance: float, approximate: bool) -> Choices:
    """For each histogram of the block; the same for all pixels of a laser point where crosstalk couples them."""
    cycle, spad, exposure = setup.cycle, setup.spad, setup.exposure
    lasers, pixels, n = flux.values.shape
    if setup.coupled:
        number, together = setup.first_laser + flux.first, flux.values.sum(axis=1)
        chosen = choose(together, cycle, spad, exposure, tolerance, approximate, lambda row: f"laser {number + row}")
        return Choices(*(np.repeat(getattr(chosen, f.name), pixels) for f in fields(chosen)))
    # A single pixel has no neighbours.
    alone = spad if spad.crosstalk_probability == 0 else replace(spad, crosstalk_probability=0.0)
    numbers = flux.first * pixels + np.arange(lasers * pixels)
    rows = flux.values.reshape(lasers * pixels, n)
    return choose(rows, cycle, alone, exposure, tolerance, approximate, partial(setup.where, numbers))


def _drawn(setup: _Setup, flux: _Flux, choices: Choices, streams: Stream) -> NDArray[np.int64]:
    """(h, bin) counts of the histograms of a block, from as many streams."""
    cycle, spad, cycles = setup.cycle, setup.spad, setup.exposure.cycles
    _, pixels, n = flux.values.shape
    values = flux.values.reshape(-1, n)
    out = np.empty((len(values), cycle.bins), np.int64)
    poisson = choices.sampler == Sampler.POISSON
    for rows in _rows(poisson):
        # Poisson events displaced independently are Poisson: the mean is displaced instead of every event.
        numbers = flux.first * pixels + np.arange(len(values))[rows]
        mean = setup.tdc.mean(cycles * values[rows])
        out[rows] = draw_poisson(mean, streams[rows], partial(setup.where, numbers))
    for rows in _rows(~poisson & choices.few):
        own = streams[rows]
        out[rows] = setup.tdc.draw(draw_in_order(values[rows], cycle.edges_s, spad.dead_time_s, cycles, own), own)
    for rows in _rows(~poisson & ~choices.few):
        own = streams[rows]
        if setup.coupled:
            # A laser point's joint draw uses its first pixel's stream, whose jitter goes on from there.
            detections = np.concatenate(
                [
                    draw_avalanches(values[rows][k : k + pixels], cycle, spad, cycles, own[k])
                    for k in range(0, len(own), pixels)
                ]
            )
        else:
            each = zip(values[rows], choices.sampler[rows], own, strict=True)
            detections = np.stack([_draw_one(setup, f, Sampler(code), stream) for f, code, stream in each])
        out[rows] = setup.tdc.draw(detections, own)
    return out if spad.counter_max is None else np.minimum(out, spad.counter_max)


def _rows(wanted: NDArray[np.bool_]) -> Iterator[NDArray[np.int64] | slice]:
    """What picks the rows that are wanted, if there are any; all of them without a copy."""
    if wanted.all():
        yield slice(None)
    elif wanted.any():
        yield np.flatnonzero(wanted)


def _draw_one(setup: _Setup, flux: Array, sampler: Sampler, stream: Stream) -> NDArray[np.int64]:
    """(n,) detections of one pixel by a sampler other than Poisson's."""
    cycle, spad, cycles = setup.cycle, setup.spad, setup.exposure.cycles
    edges, width, dead_time, bins = cycle.edges_s, cycle.width_s, spad.dead_time_s, len(flux)
    if sampler is Sampler.HAZARD_CHAIN:
        return draw_hazard_chain(flux, cycles, stream)
    if sampler is Sampler.RETURN_CHAIN:
        pieces = pieces_of(flux, edges, width, dead_time, shorter_than_dead_time=True)
        return draw_return_chain(pieces, bins, cycles, stream)
    if sampler is Sampler.AVALANCHES:
        return np.asarray(draw_avalanches(flux[None, :], cycle, spad, cycles, stream)[0])
    if sampler is Sampler.CYCLE_ENSEMBLE:
        return draw_cycle_ensemble(
            equilibrium(flux, edges, width, dead_time, shorter_than_dead_time=True), bins, cycles, stream
        )
    state = equilibrium(flux, edges, width, dead_time, settled=FOR_A_START)
    front = cycle.front if cycle.front < bins else bins - 1
    return draw_free_running(flux, edges, width, front, dead_time, cycles, state, stream)


def _saturate_mean(mean: Array, flux: Array, setup: _Setup, approximate: bool) -> Array:
    """(laser, pixel, bin) mean counts, of flux (laser, pixel, n), once counters have stayed at their maximum."""
    spad, exposure = setup.spad, setup.exposure
    if spad.counter_max is None:
        return mean
    reach = mean + 8 * np.sqrt(mean) + 8 > spad.counter_max
    if not reach.any():
        return mean
    poisson = counts_are_poisson(spad, mean.shape[1])
    if not (poisson or approximate or counts_are_binomial(flux, setup.cycle, spad, mean.shape[1])):
        raise InputError(
            f"expected_histogram: counter_max = {spad.counter_max} is reached where counts are neither Poisson nor "
            f"binomial (mode {spad.mode!r} with detections that depend on one another), and the law of a bin's count "
            "has no closed form; pass approximate=True, or leave counter_max out"
        )
    return np.where(reach, saturated_mean(mean, exposure.cycles, spad.counter_max, not poisson), mean)
