"""A transient under a detector and an exposure: its check, and its flux, one block of laser points after another."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray

from datagen.detector.flux import Cycle, N, cycle_of, flux_per_cycle
from datagen.detector.spad import Exposure, Spad
from datagen.detector.tdc import Tdc, TdcBins, pieces_for
from datagen.errors import InputError
from datagen.records import TimeAxis
from datagen.records.arrays import Floats
from datagen.records.checks import as_reals, check_integer, check_kind

_BLOCK_VALUES = 1 << 16
"""Most flux values of a block of laser points: 0.5 MB, which caches hold."""


@dataclass(frozen=True)
class Measurement:
    """The arguments of a call, checked, and what all its histograms share.

    transient : (laser, pixel, bin) expected photons at the aperture per emitted photon.
    cycle, tdc : the laser period, and the converter of detections to records.
    first_pixel : number of the first pixel.
    """

    transient: Floats
    cycle: Cycle
    tdc: Tdc
    spad: Spad
    exposure: Exposure
    first_pixel: int = 0

    @classmethod
    def of(
        cls, transient: ArrayLike, time: TimeAxis, spad: Spad, exposure: Exposure, first_pixel: int = 0
    ) -> Measurement:
        """The measurement described by the arguments of a call; raises `InputError` where they are wrong."""
        check_kind("time", time, TimeAxis)
        check_kind("spad", spad, Spad)
        check_kind("exposure", exposure, Exposure)
        check_integer("detect", "first_pixel", first_pixel, 0, 2**62)
        values = _checked_transient(transient, time, exposure.photons_per_pulse)
        pixels = values.shape[1]
        if time.bins % spad.bins_merged:
            raise InputError(
                f"Spad.bins_merged = {spad.bins_merged} with a time axis of {time.bins} bins: the bins must be a "
                "multiple of it; change one of them"
            )
        if _has_crosstalk(spad) and (first_pixel != 0 or pixels % (spad.array_columns or 1) != 0):
            raise InputError(
                f"crosstalk_probability = {spad.crosstalk_probability:g}, array_columns = {spad.array_columns}, with "
                f"{pixels} pixels from number {first_pixel}: crosstalk needs whole rows of all pixels from number 0"
            )
        cycle = cycle_of(time, spad, exposure)
        unequal = None if spad.tdc_bins_are_equal else TdcBins.of(cycle, 1, spad, pixels, first_pixel)
        return cls(values, cycle, Tdc(cycle, unequal), spad, exposure, first_pixel)

    @cached_property
    def finer(self) -> tuple[Cycle, Tdc]:
        """`cycle` and `tdc` for detections that depend on one another: with bins cut into pieces where the place of
        such a detection within its bin matters, otherwise as they are."""
        pieces = pieces_for(self.cycle, self.spad)
        if pieces == 1:
            return self.cycle, self.tdc
        unequal = TdcBins.of(self.cycle, pieces, self.spad, self.transient.shape[1], self.first_pixel)
        return self.cycle.cut(pieces), Tdc(self.cycle, unequal)

    def flux_in_finer(self, flux: Floats) -> Floats:
        """(…, m) flux in the bins of `finer`, from flux (…, n)."""
        pieces = pieces_for(self.cycle, self.spad)
        if pieces == 1:
            return flux
        parts = self.cycle.parts(pieces)
        return np.repeat(flux / parts, parts, axis=-1)

    @property
    def is_coupled(self) -> bool:
        """Whether crosstalk makes the pixels of a laser point one system."""
        return _has_crosstalk(self.spad) and self.transient.shape[1] > 1

    def where(self, histogram: int) -> str:
        """The name of a histogram for messages, by its number in the order of laser points and their pixels."""
        laser, pixel = divmod(int(histogram), self.transient.shape[1])
        return f"laser {laser}, pixel {self.first_pixel + pixel}"

    def fluxes(self) -> Iterator[tuple[int, Floats]]:
        """For each block of laser points, the number of its first one and its flux per cycle (laser, pixel, n)."""
        lasers, pixels, _ = self.transient.shape
        step = max(_BLOCK_VALUES // (pixels * len(self.cycle.gate)), 1)
        for start in range(0, lasers, step):
            block = self.transient[start : start + step]
            yield start, flux_per_cycle(block, self.cycle, self.spad, self.exposure, self.first_pixel)


def with_bins_merged(values: NDArray[N], spad: Spad) -> NDArray[N]:
    """Values (…, bins) with each run of `Spad.bins_merged` bins added up to one."""
    if spad.bins_merged == 1:
        return values
    return np.asarray(values.reshape(*values.shape[:-1], -1, spad.bins_merged).sum(axis=-1))


def _has_crosstalk(spad: Spad) -> bool:
    """Whether avalanches may set off others in neighbouring pixels."""
    return spad.crosstalk_probability > 0 and spad.mode != "ideal"


def _checked_transient(transient: ArrayLike, time: TimeAxis, photons_per_pulse: float) -> Floats:
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
