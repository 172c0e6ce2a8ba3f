"""Transient → counts, and their exact mean."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from datagen.detector.flux import checked_transient, cycle_of, flux_per_cycle
from datagen.detector.poisson import draw_poisson
from datagen.detector.spad import Exposure, Spad
from datagen.detector.streams import Streams
from datagen.detector.tdc import Tdc
from datagen.errors import InputError
from datagen.records import TimeAxis


def detect(
    transient: ArrayLike,
    time: TimeAxis,
    spad: Spad,
    exposure: Exposure,
    seed: int = 0,
    *,
    first_laser: int = 0,
    first_pixel: int = 0,
) -> NDArray[np.int64]:
    """Counts after an exposure, the shape of `transient`.

    Parameters
    ----------
    transient : (laser, pixel, bin) or (bin,); expected photons at the aperture per emitted photon and bin.
    seed : together with the laser point's and pixel's number it fixes every count.
    first_laser, first_pixel : numbers of the first laser point and pixel when `transient` is a block of a larger one;
        the counts are then those of that block.
    """
    values = checked_transient(transient, time, exposure.photons_per_pulse)
    cycle = cycle_of(time, spad, exposure)
    tdc = Tdc(cycle)
    streams = Streams(seed)
    _refuse_dead_time(spad)
    mean = tdc.mean(exposure.cycles * flux_per_cycle(values, cycle, spad, exposure, first_pixel))
    counts = np.empty(values.shape, np.int64)
    for laser, pixel in np.ndindex(values.shape[:2]):
        rng = streams.at(first_laser + laser, first_pixel + pixel)
        where = f"laser {first_laser + laser}, pixel {first_pixel + pixel}"
        counts[laser, pixel] = draw_poisson(mean[laser, pixel], rng, where)
    return counts.reshape(np.shape(transient))


def expected_histogram(
    transient: ArrayLike, time: TimeAxis, spad: Spad, exposure: Exposure, *, first_pixel: int = 0
) -> NDArray[np.float64]:
    """Exact mean of `detect`, the shape of `transient`."""
    values = checked_transient(transient, time, exposure.photons_per_pulse)
    cycle = cycle_of(time, spad, exposure)
    _refuse_dead_time(spad)
    flux = flux_per_cycle(values, cycle, spad, exposure, first_pixel)
    return Tdc(cycle).mean(exposure.cycles * flux).reshape(np.shape(transient))


def _refuse_dead_time(spad: Spad) -> None:
    if spad.mode != "ideal" and (spad.dead_time_s > 0 or spad.afterpulse_probability or spad.crosstalk_probability):
        raise InputError(f"Spad.mode = {spad.mode!r}: only 'ideal' is available")
