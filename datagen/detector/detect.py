"""Transient → counts, their exact mean, and the plan by which they are drawn."""

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
from datagen.detector.plan import DEFAULT_TOLERANCE, Choice, DetectorPlan, Sampler, choose, summarise
from datagen.detector.poisson import draw_poisson
from datagen.detector.renewal import pieces_of
from datagen.detector.spad import Exposure, Spad, check_integer, check_number
from datagen.detector.streams import Streams
from datagen.detector.tdc import Tdc
from datagen.errors import InputError
from datagen.records import TimeAxis

Array = NDArray[np.float64]

_BLOCK_VALUES = 4_000_000
"""Flux values held at a time: laser points are worked through in blocks of about 32 MB."""


def detect(
    transient: ArrayLike,
    time: TimeAxis,
    spad: Spad,
    exposure: Exposure,
    seed: int = 0,
    *,
    tolerance: float = DEFAULT_TOLERANCE,
    approximate: bool = False,
    first_laser: int = 0,
    first_pixel: int = 0,
    dtype: DTypeLike = np.int64,
) -> NDArray[np.integer]:
    """Counts after an exposure, the shape of `transient`.

    Photons are displaced by pulse and carrier diffusion, thinned by gate and PDE, joined by background; what the dead
    time leaves of them is displaced by the TDC's jitter and counted. Every histogram is drawn by the cheapest sampler
    that is exact, or biased by no more than `tolerance` and a tenth of a standard deviation (`plan_detector` tells).

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
    check_number("detect", "tolerance", tolerance, 0.0, 1.0, "a relative bias, such as 1e-3")
    kind = np.dtype(dtype)
    if kind.kind not in "iu":
        raise InputError(f"detect: dtype {kind} given; counts need an integer type such as int64 or uint16")
    streams = Streams(seed)
    setup = _Setup.of(transient, time, spad, exposure, first_laser, first_pixel)
    counts = np.empty(setup.transient.shape, kind)
    limit = np.iinfo(kind).max
    for laser, flux in setup.blocks():
        drawn = _draw_laser(setup, flux, laser, streams, tolerance, approximate)
        if kind != np.int64 and drawn.max() > limit:
            pixel, bin_ = (int(i) for i in np.unravel_index(int(drawn.argmax()), drawn.shape))
            raise InputError(
                f"{setup.where(laser, pixel)}, bin {bin_}: {drawn.max()} counts do not fit {kind} (at most {limit}); "
                "lower cycles or photons_per_pulse, set counter_max, or use a wider dtype"
            )
        counts[laser] = drawn
    return counts.reshape(np.shape(transient))


def expected_histogram(
    transient: ArrayLike,
    time: TimeAxis,
    spad: Spad,
    exposure: Exposure,
    *,
    approximate: bool = False,
    first_pixel: int = 0,
) -> Array:
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
    for laser, flux in setup.blocks():
        mean = setup.tdc.mean(exposure.cycles * mean_detections(flux, setup.cycle, spad))
        out[laser] = _saturate_mean(mean, spad, exposure, approximate)
    return out.reshape(np.shape(transient))


def plan_detector(
    transient: ArrayLike,
    time: TimeAxis,
    spad: Spad,
    exposure: Exposure,
    *,
    tolerance: float = DEFAULT_TOLERANCE,
    approximate: bool = False,
    first_pixel: int = 0,
) -> DetectorPlan:
    """How `detect` would draw the counts, and why; raises `InputError` where it would refuse."""
    setup = _Setup.of(transient, time, spad, exposure, 0, first_pixel)
    choices = [
        choice for laser, flux in setup.blocks() for choice in _choices(setup, flux, laser, tolerance, approximate)
    ]
    return summarise(choices, tolerance)


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
        coupled = spad.crosstalk_probability > 0 and spad.mode != "ideal"
        if coupled and (first_pixel != 0 or pixels % (spad.array_columns or 1) != 0):
            raise InputError(
                f"crosstalk_probability = {spad.crosstalk_probability:g}, array_columns = {spad.array_columns}, with "
                f"{pixels} pixels from number {first_pixel}: crosstalk needs whole rows of all pixels from number 0"
            )
        cycle = cycle_of(time, spad, exposure)
        return cls(values, cycle, Tdc(cycle), spad, exposure, first_laser, first_pixel)

    @property
    def coupled(self) -> bool:
        """Whether crosstalk makes the pixels of a laser point one system."""
        return self.spad.crosstalk_probability > 0 and self.spad.mode != "ideal" and self.transient.shape[1] > 1

    def where(self, laser: int, pixel: int) -> str:
        return f"laser {self.first_laser + laser}, pixel {self.first_pixel + pixel}"

    def blocks(self) -> Iterator[tuple[int, Array]]:
        """Laser point after laser point: its number and the (pixel, n) flux per cycle."""
        lasers, pixels, _ = self.transient.shape
        step = max(_BLOCK_VALUES // (pixels * len(self.cycle.gate)), 1)
        for start in range(0, lasers, step):
            block = self.transient[start : start + step]
            flux = flux_per_cycle(block, self.cycle, self.spad, self.exposure, self.first_pixel)
            yield from ((start + i, np.ascontiguousarray(f)) for i, f in enumerate(flux))


def _choices(setup: _Setup, flux: Array, laser: int, tolerance: float, approximate: bool) -> list[Choice]:
    """One choice for each pixel; all the same where crosstalk couples them."""
    cycle, spad, exposure = setup.cycle, setup.spad, setup.exposure
    if setup.coupled:
        where = f"laser {setup.first_laser + laser}"
        return [choose(flux.sum(axis=0), cycle, spad, exposure, tolerance, approximate, where)] * len(flux)
    alone = spad if spad.crosstalk_probability == 0 else _without_crosstalk(spad)
    return [
        choose(f, cycle, alone, exposure, tolerance, approximate, setup.where(laser, pixel))
        for pixel, f in enumerate(flux)
    ]


def _without_crosstalk(spad: Spad) -> Spad:
    """A single pixel has no neighbours."""
    return replace(spad, crosstalk_probability=0.0)


def _draw_laser(
    setup: _Setup, flux: Array, laser: int, streams: Streams, tolerance: float, approximate: bool
) -> NDArray[np.int64]:
    """(pixel, bin) counts of one laser point."""
    cycle, spad, cycles = setup.cycle, setup.spad, setup.exposure.cycles
    choices = _choices(setup, flux, laser, tolerance, approximate)
    out = np.empty((len(flux), cycle.bins), np.int64)
    together: NDArray[np.int64] | None = None
    for pixel, (choice, f) in enumerate(zip(choices, flux, strict=True)):
        rng = streams.at(setup.first_laser + laser, setup.first_pixel + pixel)
        sampler = choice.sampler
        if sampler is Sampler.POISSON:
            # Poisson events displaced independently are Poisson: the mean is displaced instead of every event.
            drawn = draw_poisson(setup.tdc.mean(cycles * f), rng, setup.where(laser, pixel))
        elif sampler is Sampler.AVALANCHES and setup.coupled:
            if together is None:
                together = draw_avalanches(flux, cycle, spad, cycles, rng)
                # The joint draw used pixel 0's stream; its jitter goes on from there.
            drawn = setup.tdc.draw(together[pixel], rng)
        else:
            drawn = setup.tdc.draw(_draw_one(setup, f, sampler, rng), rng)
        out[pixel] = drawn if spad.counter_max is None else np.minimum(drawn, spad.counter_max)
    return out


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
        return draw_avalanches(flux[None, :], cycle, spad, cycles, rng)[0]
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
