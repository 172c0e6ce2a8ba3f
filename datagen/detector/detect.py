"""Transient → counts, their exact mean, and the samplers by which they are drawn."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, DTypeLike, NDArray

from datagen.detector.avalanches import draw_avalanches
from datagen.detector.chain import draw_cycle_ensemble, draw_hazard_chain, draw_return_chain
from datagen.detector.equilibrium import FOR_A_START, equilibrium
from datagen.detector.events import draw_free_running
from datagen.detector.expected import has_exact_mean, mean_detections, saturated_mean
from datagen.detector.flux import Cycle, checked_transient, cycle_of, flux_per_cycle
from datagen.detector.poisson import draw_poisson
from datagen.detector.renewal import pieces_of
from datagen.detector.sampler_choice import DEFAULT_TOLERANCE, Choice, Sampler, SamplerChoice, choose, summarise
from datagen.detector.spad import Exposure, Spad, check_integer, check_number
from datagen.detector.streams import Streams
from datagen.detector.tdc import Tdc
from datagen.errors import InputError
from datagen.records import TimeAxis

Array = NDArray[np.float64]
Counts = NDArray[np.integer]

_BLOCK_VALUES = 4_000_000
"""Flux values held at a time: laser points are worked through in blocks of about 32 MB."""


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
    kind = np.dtype(dtype)
    if kind.kind not in "iu":
        raise InputError(f"detect: dtype {kind} given; counts need an integer type such as int64 or uint16")
    streams = Streams(seed)
    setup = _Setup.of(transient, time, spad, exposure, first_laser, first_pixel)
    counts = np.empty(setup.transient.shape, kind)
    limit = np.iinfo(kind).max
    choices: list[Choice] = []
    for flux in setup.fluxes():
        for laser, chosen, drawn in _drawn(setup, flux, streams, tolerance, approximate):
            choices += chosen
            if kind != np.int64 and drawn.max() > limit:
                pixel, bin_ = (int(i) for i in np.unravel_index(int(drawn.argmax()), drawn.shape))
                raise InputError(
                    f"{setup.where(laser, pixel)}, bin {bin_}: {drawn.max()} counts do not fit {kind} (at most "
                    f"{limit}); lower cycles or photons_per_pulse, set counter_max, or use a wider dtype"
                )
            counts[laser] = drawn
    return counts.reshape(np.shape(transient)), summarise(choices, tolerance)


def expected_histogram(
    transient: ArrayLike, time: TimeAxis, spad: Spad, exposure: Exposure, *, approximate: bool = False,
    first_pixel: int = 0,
) -> Array:  # fmt: skip
    """Exact mean of `detect`, float64, the shape of `transient`.

    There is none in closed form for afterpulsing or crosstalk together with a dead time, nor for counters that
    saturate under a dead time: these raise `InputError` unless `approximate`, which gives a self-consistent mean
    whose error is of second order in the probabilities.

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
        for laser, values in enumerate(flux.values, flux.first):
            mean = setup.tdc.mean(exposure.cycles * mean_detections(values, setup.cycle, spad))
            out[laser] = _saturate_mean(mean, spad, exposure, approximate)
    return out.reshape(np.shape(transient))


def choose_sampler(
    transient: ArrayLike, time: TimeAxis, spad: Spad, exposure: Exposure, *, tolerance: float = DEFAULT_TOLERANCE,
    approximate: bool = False, first_pixel: int = 0,
) -> SamplerChoice:  # fmt: skip
    """How `detect` would draw the counts, and why; raises `InputError` where it would refuse."""
    setup = _Setup.of(transient, time, spad, exposure, 0, first_pixel)
    choices = [
        choice
        for flux in setup.fluxes()
        for laser in range(len(flux.values))
        for choice in _choices(setup, flux, laser, tolerance, approximate)
    ]
    return summarise(choices, tolerance)


@dataclass(frozen=True)
class _Flux:
    """The flux per cycle of laser points `first`, …: (laser, pixel, n), and its sums Λ (laser, pixel)."""

    first: int
    values: Array
    totals: Array


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

    def where(self, laser: int, pixel: int) -> str:
        return f"laser {self.first_laser + laser}, pixel {self.first_pixel + pixel}"

    def fluxes(self) -> Iterator[_Flux]:
        """Flux of one block of laser points after the other."""
        lasers, pixels, _ = self.transient.shape
        step = max(_BLOCK_VALUES // (pixels * len(self.cycle.gate)), 1)
        for start in range(0, lasers, step):
            block = self.transient[start : start + step]
            flux = np.ascontiguousarray(flux_per_cycle(block, self.cycle, self.spad, self.exposure, self.first_pixel))
            yield _Flux(start, flux, flux.sum(axis=2))


def _has_crosstalk(spad: Spad) -> bool:
    return spad.crosstalk_probability > 0 and spad.mode != "ideal"


def _choices(setup: _Setup, flux: _Flux, laser: int, tolerance: float, approximate: bool) -> list[Choice]:
    """One choice for each pixel of laser point `laser` of the block; all the same where crosstalk couples them."""
    cycle, spad, exposure = setup.cycle, setup.spad, setup.exposure
    values, totals, number = flux.values[laser], flux.totals[laser], flux.first + laser
    if setup.coupled:
        where = f"laser {setup.first_laser + number}"
        together = values.sum(axis=0)
        total = float(together.sum())
        return [choose(together, total, cycle, spad, exposure, tolerance, approximate, where)] * len(values)
    # A single pixel has no neighbours.
    alone = spad if spad.crosstalk_probability == 0 else replace(spad, crosstalk_probability=0.0)
    return [
        choose(f, float(total), cycle, alone, exposure, tolerance, approximate, setup.where(number, pixel))
        for pixel, (f, total) in enumerate(zip(values, totals, strict=True))
    ]


def _drawn(
    setup: _Setup, flux: _Flux, streams: Streams, tolerance: float, approximate: bool
) -> Iterator[tuple[int, list[Choice], NDArray[np.int64]]]:
    """Number, choices and (pixel, bin) counts of each laser point of a block."""
    cycle, spad, cycles = setup.cycle, setup.spad, setup.exposure.cycles
    chosen = [_choices(setup, flux, laser, tolerance, approximate) for laser in range(len(flux.values))]
    # Poisson events displaced independently are Poisson: the mean is displaced instead of every event.
    poisson = any(choice.sampler is Sampler.POISSON for choices in chosen for choice in choices)
    means = setup.tdc.mean(cycles * flux.values) if poisson else None
    for laser, choices in enumerate(chosen):
        number, values = flux.first + laser, flux.values[laser]
        out = np.empty((len(values), cycle.bins), np.int64)
        together: NDArray[np.int64] | None = None
        for pixel, choice in enumerate(choices):
            rng = streams.at(setup.first_laser + number, setup.first_pixel + pixel)
            if choice.sampler is Sampler.POISSON and means is not None:
                out[pixel] = draw_poisson(means[laser, pixel], rng, setup.where(number, pixel))
            elif choice.sampler is Sampler.AVALANCHES and setup.coupled:
                if together is None:
                    together = draw_avalanches(values, cycle, spad, cycles, rng)
                    # The joint draw used pixel 0's stream; its jitter goes on from there.
                out[pixel] = setup.tdc.draw(together[pixel], rng)
            else:
                out[pixel] = setup.tdc.draw(_draw_one(setup, values[pixel], choice.sampler, rng), rng)
        yield number, choices, out if spad.counter_max is None else np.minimum(out, spad.counter_max)


def _draw_one(setup: _Setup, flux: Array, sampler: Sampler, rng: np.random.Generator) -> NDArray[np.int64]:
    """(n,) detections of one pixel by a sampler other than Poisson's."""
    cycle, spad, cycles = setup.cycle, setup.spad, setup.exposure.cycles
    edges, width, dead_time, bins = cycle.edges_s, cycle.width_s, spad.dead_time_s, len(flux)
    if sampler is Sampler.HAZARD_CHAIN:
        return draw_hazard_chain(flux, cycles, rng)
    if sampler is Sampler.RETURN_CHAIN:
        pieces = pieces_of(flux, edges, width, dead_time, shorter_than_dead_time=True)
        return draw_return_chain(pieces, bins, cycles, rng)
    if sampler is Sampler.AVALANCHES:
        (counts,) = draw_avalanches(flux[None, :], cycle, spad, cycles, rng)
        return np.asarray(counts, np.int64)
    if sampler is Sampler.CYCLE_ENSEMBLE:
        return draw_cycle_ensemble(
            equilibrium(flux, edges, width, dead_time, shorter_than_dead_time=True), bins, cycles, rng
        )
    state = equilibrium(flux, edges, width, dead_time, settled=FOR_A_START)
    front = cycle.front if cycle.front < bins else bins - 1
    return draw_free_running(flux, edges, width, front, dead_time, cycles, state, rng)


def _saturate_mean(mean: Array, spad: Spad, exposure: Exposure, approximate: bool) -> Array:
    if spad.counter_max is None:
        return mean
    poisson = spad.mode == "ideal" or (spad.dead_time_s == 0 and has_exact_mean(spad, 1))
    reach = mean + 8 * np.sqrt(mean) + 8 > spad.counter_max
    if not reach.any():
        return mean
    if not (poisson or spad.mode == "synchronous" or approximate):
        raise InputError(
            f"expected_histogram: counter_max = {spad.counter_max} is reached under a dead time (mode "
            f"{spad.mode!r}), where the law of a bin's count has no closed form; pass approximate=True, or leave "
            "counter_max out"
        )
    return np.where(reach, saturated_mean(mean, exposure.cycles, spad.counter_max, not poisson), mean)
