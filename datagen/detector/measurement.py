"""A transient under a detector and an exposure: its check, and its flux, one block of laser points after another."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from datagen.detector.flux import Cycle, cycle_of, flux_per_cycle
from datagen.detector.spad import Exposure, Spad
from datagen.detector.tdc import Tdc
from datagen.detector.tdc_bins import PIECES, TdcBins, pieces_for
from datagen.errors import InputError
from datagen.records import TimeAxis
from datagen.records.checks import as_reals, check_integer, check_kind

Array = NDArray[np.float64]

_BLOCK_VALUES = 1 << 16
"""Most flux values of a block of laser points: 0.5 MB, which caches hold. Halved, the overhead of numpy's calls takes
a larger share of the time."""


@dataclass(frozen=True)
class Measurement:
    """The arguments of a call, checked, and what all its histograms share.

    Attributes
    ----------
    transient : (laser, pixel, bin) expected photons at the aperture per emitted photon.
    cycle, tdc : the laser period, and the converter of detections to records.
    light_cycle, pieces : the laser period in the bins of the time axis; in `cycle` each is cut into `pieces`.
    first_laser, first_pixel : numbers of the first laser point and pixel.
    """

    transient: Array
    cycle: Cycle
    tdc: Tdc
    light_cycle: Cycle
    pieces: int
    spad: Spad
    exposure: Exposure
    first_laser: int = 0
    first_pixel: int = 0

    @classmethod
    def of(
        cls, transient: ArrayLike, time: TimeAxis, spad: Spad, exposure: Exposure, first_laser: int = 0,
        first_pixel: int = 0, most_pieces: int = PIECES,
    ) -> Measurement:  # fmt: skip
        """The measurement described by the arguments of a call; raises `InputError` where they are wrong.

        most_pieces : most pieces of a bin where the TDC's bins are unequal; with 1 detections count as uniform in
            each bin of the time axis.
        """
        check_kind("time", time, TimeAxis)
        check_kind("spad", spad, Spad)
        check_kind("exposure", exposure, Exposure)
        for name, value in (("first_laser", first_laser), ("first_pixel", first_pixel)):
            check_integer("detect", name, value, 0, 2**62)
        values = _checked_transient(transient, time, exposure.photons_per_pulse)
        pixels = values.shape[1]
        if _has_crosstalk(spad) and (first_pixel != 0 or pixels % (spad.array_columns or 1) != 0):
            raise InputError(
                f"crosstalk_probability = {spad.crosstalk_probability:g}, array_columns = {spad.array_columns}, with "
                f"{pixels} pixels from number {first_pixel}: crosstalk needs whole rows of all pixels from number 0"
            )
        cycle = light_cycle = cycle_of(time, spad, exposure)
        unequal, pieces = None, 1
        if not spad.tdc_bins_are_equal:
            pieces = min(pieces_for(cycle, spad), most_pieces)
            unequal = TdcBins.of(cycle, pieces, spad, pixels, first_pixel)
            cycle = cycle if pieces == 1 else cycle.cut(pieces)
        tdc = Tdc(light_cycle, unequal)
        return cls(values, cycle, tdc, light_cycle, pieces, spad, exposure, first_laser, first_pixel)

    @property
    def coupled(self) -> bool:
        """Whether crosstalk makes the pixels of a laser point one system."""
        return _has_crosstalk(self.spad) and self.transient.shape[1] > 1

    def where(self, histogram: int) -> str:
        """The name of a histogram for messages, by its number in the order of laser points and their pixels."""
        laser, pixel = divmod(int(histogram), self.transient.shape[1])
        return f"laser {self.first_laser + laser}, pixel {self.first_pixel + pixel}"

    def fluxes(self) -> Iterator[tuple[int, Array]]:
        """For each block of laser points, the number of its first one and its flux per cycle (laser, pixel, n)."""
        lasers, pixels, _ = self.transient.shape
        step = max(_BLOCK_VALUES // (pixels * len(self.cycle.gate)), 1)
        for start in range(0, lasers, step):
            block = self.transient[start : start + step]
            flux = flux_per_cycle(block, self.light_cycle, self.spad, self.exposure, self.first_pixel)
            if self.pieces > 1:
                parts = self.light_cycle.parts(self.pieces)
                flux = np.repeat(flux / parts, parts, axis=2)
            yield start, flux


def _has_crosstalk(spad: Spad) -> bool:
    """Whether avalanches may set off others in neighbouring pixels."""
    return spad.crosstalk_probability > 0 and spad.mode != "ideal"


def _checked_transient(transient: ArrayLike, time: TimeAxis, photons_per_pulse: float) -> Array:
    """(laser, pixel, bin) float64 view of a transient; raises `InputError` that names the first wrong entry."""
    values = as_reals("transient", transient)
    if values.ndim not in (1, 3):
        raise InputError(f"transient: shape {values.shape} given; (laser, pixel, bin) or (bin,) is needed")
    if values.shape[-1] != time.bins or values.size == 0:
        raise InputError(
            f"transient: shape {values.shape} with a time axis of {time.bins} bins; the last axis must be the bins "
            "and no axis may be empty"
        )
    values = values.reshape((1, 1, -1)) if values.ndim == 1 else values
    # Two passes suffice if all entries are right; a NaN fails both comparisons.
    if not (values.min() >= 0 and values.max() * max(photons_per_pulse, 1.0) < 1e300):
        bad = ~((values >= 0) & (values * max(photons_per_pulse, 1.0) < 1e300))
        laser, pixel, bin_ = (int(i) for i in np.argwhere(bad)[0])
        raise InputError(
            f"transient[laser {laser}, pixel {pixel}, bin {bin_}] = {values[laser, pixel, bin_]:g}: must be a finite "
            f"number ≥ 0 ({np.count_nonzero(bad)} such entries)"
        )
    return values
