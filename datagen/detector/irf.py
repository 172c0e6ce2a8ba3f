"""Timing responses: bin-integrated kernels, and convolution with them."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
import scipy.fft
import scipy.special

from datagen.compiled import compiled
from datagen.detector.spad import Pulse
from datagen.errors import InputError
from datagen.records.arrays import Floats

FWHM_PER_SIGMA = 2.0 * np.sqrt(2.0 * np.log(2.0))
"""Full width at half maximum of a Gaussian of unit standard deviation."""
LONGEST_KERNEL = 4_000_000
"""Most taps of a response, 32 MB: a longer one is a mistake of units."""
LONGEST_DIRECT = 4096
"""Taps up to which a convolution is summed directly, exact to the last digit in every bin, however faint. An FFT is
faster beyond, but faint bins beside a bright one lose digits in it."""


@dataclass(frozen=True)
class Kernel:
    """Probabilities `weights[offset + before]`, which sum to 1, that light of one bin arrives `offset` bins later."""

    weights: Floats
    before: int

    @property
    def after(self) -> int:
        """Largest offset."""
        return len(self.weights) - 1 - self.before

    @property
    def is_identity(self) -> bool:
        """Whether all light stays in its bin."""
        return len(self.weights) == 1


IDENTITY = Kernel(np.ones(1), 0)


def response_cdf(t_s: Floats, sigma_s: float, tail_s: float = 0.0, tail_fraction: float = 1.0) -> Floats:
    """Probability that a photon is displaced by less than `t_s`: a Gaussian, of which a part is delayed further.

    With z = t/σ and Φ the normal distribution function,

        F(t) = Φ(z) − w · exp(σ²/2τ² − t/τ) Φ(z − σ/τ)

    (an exponentially modified Gaussian for the share w, a plain one for the rest). The product is computed from
    logarithms, because its first factor overflows where the second vanishes.
    """
    t = np.asarray(t_s, np.float64)
    if tail_s <= 0 or tail_fraction <= 0:
        return scipy.special.ndtr(t / sigma_s) if sigma_s > 0 else (t >= 0).astype(np.float64)
    if sigma_s <= 0:
        return np.where(t >= 0, 1.0 - tail_fraction * np.exp(-np.maximum(t, 0) / tail_s), 0.0)
    ratio = sigma_s / tail_s
    z = t / sigma_s
    log_delayed = 0.5 * ratio**2 - t / tail_s + scipy.special.log_ndtr(z - ratio)
    cdf: Floats = scipy.special.ndtr(z) - tail_fraction * np.exp(np.minimum(log_delayed, 0.0))
    return cdf


@lru_cache(maxsize=4)
def response_kernel(width_s: float, fwhm_s: float, tail_s: float = 0.0, tail_fraction: float = 1.0) -> Kernel:
    """The bin-integrated response to light at a bin's centre: w_j = F((j + ½)Δ) − F((j − ½)Δ), renormalised to 1.

    Differences of the distribution function conserve photons at any width; samples of the density at bin centres are
    wrong by up to a factor of four at σ = 0.1 bin. The kernel ends where less than 10⁻¹⁵ is left.
    """
    sigma = fwhm_s / FWHM_PER_SIGMA
    tail = tail_s if tail_fraction > 0 else 0.0
    if sigma < 1e-3 * width_s and tail < 1e-3 * width_s:
        return IDENTITY
    before = int(np.ceil(8.0 * sigma / width_s))
    after = int(np.ceil((8.0 * sigma + 35.0 * tail) / width_s))
    if before + after > LONGEST_KERNEL:
        raise InputError(
            f"timing response of {fwhm_s:g} s FWHM and {tail:g} s tail on bins of {width_s:g} s: longer than "
            f"{LONGEST_KERNEL} bins; check the units of jitter_fwhm_s, jitter_tail_s, pulse_fwhm_s and the bin width"
        )
    edges = (np.arange(-before, after + 2, dtype=np.float64) - 0.5) * width_s
    weights = np.maximum(np.diff(response_cdf(edges, sigma, tail, tail_fraction)), 0.0)
    weights /= weights.sum()
    # The result is cached and shared by later calls.
    weights.flags.writeable = False
    return Kernel(weights, before)


@lru_cache(maxsize=4)
def measured_kernel(width_s: float, pulse: Pulse, tail_s: float, tail_fraction: float) -> Kernel:
    """The response to light at a bin's centre of a measured pulse and of carrier diffusion, renormalised to 1.

    With F the running integral of the pulse, w_j = F((j + ½)Δ) − F((j − ½)Δ), as in `response_kernel`.
    """
    steps = pulse.start_s + pulse.width_s * np.arange(len(pulse.samples) + 1)
    before = max(math.ceil(-steps[0] / width_s + 0.5), 0)
    after = max(math.ceil(steps[-1] / width_s + 0.5), 0)
    if before + after > LONGEST_KERNEL:
        raise InputError(
            f"Pulse of {pulse.width_s * len(pulse.samples):g} s from {pulse.start_s:g} s on bins of {width_s:g} s: "
            f"longer than {LONGEST_KERNEL} bins; check the units of Pulse.width_s and start_s"
        )
    edges = (np.arange(-before, after + 2) - 0.5) * width_s
    weights = np.diff(np.interp(edges, steps, np.append(0.0, np.cumsum(pulse.samples))))
    diffusion = response_kernel(width_s, 0.0, tail_s, tail_fraction)
    weights = spread(weights[None], diffusion)[0]
    weights /= weights.sum()
    weights.flags.writeable = False
    return Kernel(weights, before + diffusion.before)


def spread(values: Floats, kernel: Kernel) -> Floats:
    """(…, n + taps − 1) convolution of values (…, n) with a kernel: `before` bins more at the front, `after` at the
    end.

    Kernels beyond a few thousand taps go through a float64 FFT. Its rounding is 10⁻¹⁶ of the brightest bin, so its
    negative values are set to 0, and the sum is restored.
    """
    if kernel.is_identity:
        return values
    length = values.shape[-1] + len(kernel.weights) - 1
    if len(kernel.weights) <= LONGEST_DIRECT:
        rows = np.ascontiguousarray(values.reshape(-1, values.shape[-1]))
        # Each numpy function that a kernel calls is compiled with it, so arrays are made here.
        beside, out = np.zeros(len(kernel.weights) + 6), np.zeros((len(rows), length))
        beside[3:-3] = kernel.weights
        _add_responses(rows, beside, out)
        return out.reshape(*values.shape[:-1], length)
    size = scipy.fft.next_fast_len(length, real=True)
    spectrum = scipy.fft.rfft(values, size) * scipy.fft.rfft(kernel.weights, size)
    full = np.maximum(scipy.fft.irfft(spectrum, size)[..., :length], 0.0)
    total, wanted = full.sum(-1, keepdims=True), values.sum(-1, keepdims=True)
    return np.asarray(full * np.divide(wanted, total, out=np.zeros_like(total), where=total > 0), np.float64)


@compiled(allocates=False)
def _add_responses(rows: Floats, beside: Floats, out: Floats) -> None:
    """Add the responses to rows (h, n) to `out` (h, n + k − 1); `beside` (k + 6,) holds the k taps, with three zeros
    on either side."""
    for r in range(len(rows)):
        _add_response(rows[r], beside, out[r])


@compiled(allocates=False)
def _add_response(row: Floats, beside: Floats, out: Floats) -> None:
    """Add the responses to a row of n bins to `out` of n + k − 1 bins.

    Four bins are added in one pass, which reads and writes `out` a quarter as often; four empty ones are skipped.
    """
    n, taps = len(row), len(beside) - 6
    for i in range(0, n, 4):
        a = row[i]
        b = row[i + 1] if i + 1 < n else 0.0
        c = row[i + 2] if i + 2 < n else 0.0
        d = row[i + 3] if i + 3 < n else 0.0
        if a == 0.0 and b == 0.0 and c == 0.0 and d == 0.0:
            continue
        here = out[i : i + taps + 3]
        for k in range(len(here)):
            here[k] += a * beside[k + 3] + b * beside[k + 2] + c * beside[k + 1] + d * beside[k]
