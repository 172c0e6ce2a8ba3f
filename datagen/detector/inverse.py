"""The way back: what flux a histogram tells of."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from datagen.errors import InputError
from datagen.records import TimeAxis

Array = NDArray[np.float64]


def coates_correction(histogram: ArrayLike, cycles: int) -> Array:
    """Flux per cycle and bin from counts of a synchronous detector with one detection in a cycle.

        λ̂_i = −log(1 − n_i / (N − Σ_{k<i} n_k))

    Exact on an expected histogram, the maximum-likelihood estimate on counts (P. B. Coates, J. Phys. E 1, 878, 1968).

    Parameters
    ----------
    histogram : (…, bin) counts, or their mean, of all bins from the start of the cycle.
    cycles : laser cycles N of the exposure.

    Returns
    -------
    (…, bin) events per cycle; infinite where every cycle left ended in that bin, NaN where none was left.
    """
    counts = _checked(histogram, cycles)
    left = cycles - (np.cumsum(counts, axis=-1) - counts)
    if (counts.sum(axis=-1) > cycles * (1 + 1e-12)).any():
        raise InputError(
            f"coates_correction: a histogram holds {counts.sum(axis=-1).max():g} counts for {cycles} cycles, "
            "more than one detection in a cycle; use dead_time_correction for other detectors"
        )
    with np.errstate(divide="ignore", invalid="ignore"):
        share = np.where(left > 0, counts / left, np.nan)
        return -np.log1p(-np.minimum(share, 1.0))


def dead_time_correction(
    histogram: ArrayLike, time: TimeAxis, dead_time_s: float, repetition_rate_hz: float, cycles: int
) -> Array:
    """Flux per cycle and bin from counts of a free-running detector with non-paralyzable dead time.

        λ̂(t) = D(t) / (1 − ∫_{t−τ}^{t} D(s) ds)

    with D the detections per cycle, periodic: a bin counts only for the cycles in which the detector was armed. The
    dead share comes from the histogram itself. Exact on the expected histogram up to the slope of D within a bin and,
    where the flux of one bin is not ≪ 1, of the bin's own events (both are accounted for to second order).

    Parameters
    ----------
    histogram : (…, bin) counts or their mean. The time axis must span the laser period; what a shorter one does not
        show is taken as free of detections.
    dead_time_s, repetition_rate_hz, cycles : of the detector and the exposure.
    """
    counts = _checked(histogram, cycles)
    if counts.shape[-1] != time.bins:
        raise InputError(f"dead_time_correction: {counts.shape[-1]} bins with a time axis of {time.bins}")
    if not 0 <= dead_time_s < np.inf or not 0 < repetition_rate_hz < np.inf:
        raise InputError(
            f"dead_time_correction: dead_time_s = {dead_time_s}, repetition_rate_hz = {repetition_rate_hz}: the dead "
            "time must be ≥ 0 and the rate > 0, both finite"
        )
    period, width = 1.0 / repetition_rate_hz, time.width_s
    detections = counts / cycles
    window = min(time.bins, int(np.floor(period / width * (1 + 1e-12) + 1e-9)))
    shown = detections[..., :window]
    armed = 1.0 - _dead_share(_integral(shown), window, width, period, dead_time_s)
    flux = np.zeros_like(detections)
    with np.errstate(divide="ignore", invalid="ignore"):
        flux[..., :window] = np.where(shown > 0, np.where(armed > 0, shown / armed, np.inf), 0.0)
    return flux


def _integral(values: Array) -> Array:
    """(…, n) → (…, n + 1) sums of the first 0, 1, … n."""
    return np.concatenate([np.zeros((*values.shape[:-1], 1)), np.cumsum(values, axis=-1)], axis=-1)


def _dead_share(cumulative: Array, window: int, width: float, period: float, dead_time: float) -> Array:
    """(…, window) mean over each bin of ∫_{t−τ}^{t} D, the probability to be dead."""
    edges = width * np.arange(window + 1, dtype=np.float64)
    total = cumulative[..., -1:]
    # ∫_{bin} C(t − τ) dt from the integral of the piecewise linear C, extended periodically.
    integral = _integral(0.5 * (cumulative[..., 1:] + cumulative[..., :-1]) * width)
    over_period = integral[..., -1:] + total * (period - edges[-1])

    def primitive(t: NDArray[np.float64]) -> Array:
        """∫_0^t C for any t, C(t + T) = C(t) + total."""
        laps = np.floor(t / period)
        phase = t - laps * period
        j = np.clip(np.floor(phase / width).astype(np.int64), 0, window)
        inside = phase - edges[j]
        slope = np.append(1.0 / width * np.ones(window), 0.0)[j]
        step = np.take(np.diff(cumulative, axis=-1, append=total), j, axis=-1)
        within = np.take(cumulative, j, axis=-1) * inside + 0.5 * step * slope * inside**2
        whole = laps * over_period + total * period * 0.5 * laps * (laps - 1)
        value: Array = np.take(integral, j, axis=-1) + within + whole + total * laps * phase
        return value

    now = np.diff(integral, axis=-1) / width
    before = (primitive(edges[1:] - dead_time) - primitive(edges[:-1] - dead_time)) / width
    return np.clip(now - before, 0.0, 1.0)


def _checked(histogram: ArrayLike, cycles: int) -> Array:
    counts = np.asarray(histogram, np.float64)
    if counts.ndim == 0 or counts.shape[-1] == 0 or not (np.isfinite(counts).all() and (counts >= 0).all()):
        raise InputError("histogram: finite counts ≥ 0 are needed, with the bins as the last axis")
    if not isinstance(cycles, (int, np.integer)) or cycles < 1:
        raise InputError(f"cycles = {cycles!r}: must be an integer ≥ 1")
    return counts
