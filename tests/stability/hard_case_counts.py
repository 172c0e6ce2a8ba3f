"""The hard cases of the detector and of time bins: the obvious formula, ours, and the truth."""

from __future__ import annotations

from itertools import pairwise

import mpmath
import numpy as np
from measured import HardCase
from scipy import stats

from datagen import Exposure, Spad, TimeAxis, detect, expected_histogram
from datagen.detector.dead_time import equilibrium
from datagen.detector.expected import one_per_cycle_mean
from datagen.detector.irf import response_kernel, spread
from datagen.records.arrays import Floats
from datagen.transport.binning import add_to_bin

TIME = TimeAxis(100, 1e-9)
mpmath.mp.dps = 60


def tiny_flux() -> HardCase:
    """One detection in a cycle, flux of 1e-16 … 1e4 a bin."""
    flux = np.array([1e-16, 3e-13, 1e-5, 0.3, 20.0, 1e4, 1.0])
    # float64 sums of what lies before; the truth of them in 60 digits.
    before = [mpmath.fsum(mpmath.mpf(float(x)) for x in flux[:i]) for i in range(len(flux))]
    truth = np.array([
        float(-mpmath.expm1(-mpmath.mpf(float(x))) * mpmath.exp(-b)) for x, b in zip(flux, before, strict=True)
    ])  # fmt: skip
    reached = truth > 0
    naive = np.exp(-(np.cumsum(flux) - flux)) - np.exp(-np.cumsum(flux))
    return HardCase(
        "Flux of 1e-16 to 1e4 per bin, one detection a cycle",
        "exp(−Λ) differences, 1 − e^(−λ): largest relative error",
        float(np.abs(naive / np.where(reached, truth, 1.0) - 1)[reached].max()),
        "−expm1(−λ) e^(−Λ): largest relative error",
        float(np.abs(one_per_cycle_mean(flux) / np.where(reached, truth, 1.0) - 1)[reached].max()),
        "mpmath, 60 digits",
        allowed=1e-12,
    )


def narrow_response() -> HardCase:
    """A response far narrower than the bins."""
    sigma = 0.1
    kernel = response_kernel(1.0, sigma * 2 * np.sqrt(2 * np.log(2)))
    k = np.arange(-kernel.before, kernel.after + 1)
    truth = np.array([float(mpmath.ncdf((i + 0.5) / sigma) - mpmath.ncdf((i - 0.5) / sigma)) for i in k])
    sampled = np.exp(-0.5 * (k / sigma) ** 2) / (sigma * np.sqrt(2 * np.pi))
    return HardCase(
        "Response of σ = 0.1 bin",
        "the density at the bin's centre: photons out for one in",
        float(sampled.sum()),
        "differences of the distribution function: largest error of a weight",
        float(np.abs(kernel.weights - truth).max()),
        "mpmath",
        allowed=1e-14,
    )


def wide_tail() -> HardCase:
    """A tail of two and a half laser periods."""
    tail, pulses = 2.5e-7, 1e-3
    transient = np.zeros(100)
    transient[0] = pulses
    exposure = Exposure(1e7, 10**6, 1.0)
    running = Spad(pde=1.0, jitter_tail_s=tail, mode="free_running")
    mean = expected_histogram(transient, TIME, running, exposure)
    # Light at the centre of bin 0, delayed exponentially, folded: a geometric series of every later pulse.
    t = [mpmath.mpf(max(k - 0.5, 0.0)) * 1e-9 for k in range(101)]
    lap = 1 - mpmath.exp(-mpmath.mpf(1e-7) / tail)
    left = [mpmath.exp(-x / tail) / lap for x in t]
    share = [float(a - b) for a, b in pairwise(left)]
    # The half bin before the centre is reached only by the lap before.
    share[0] += float(left[-1] - (1 - lap) / lap)
    truth = 1e6 * pulses * np.array(share)
    return HardCase(
        "Response 2.5 laser periods long",
        "cut at the end of the window: share of the photons lost",
        1 - float(1 - mpmath.exp(-mpmath.mpf(0.995e-7) / tail)),
        "folded modulo the period: largest relative error of a bin",
        float(np.abs(mean / truth - 1).max()),
        "geometric series in mpmath",
        allowed=1e-9,
    )


def contrast() -> HardCase:
    """A signal ten orders below the direct return, and a response to convolve both with."""
    signal = np.full(4096, 1e-10)
    signal[100] = 1.0
    kernel = response_kernel(1e-11, 3e-10, 1e-10)
    ours = spread(signal, kernel)[kernel.before : kernel.before + 4096]
    single = np.fft.irfft(
        np.fft.rfft(signal.astype(np.float32), 8192).astype(np.complex64)
        * np.fft.rfft(kernel.weights.astype(np.float32), 8192).astype(np.complex64)
    )
    return HardCase(
        "Signal 10¹⁰ below the direct return",
        "float32 FFT convolution: largest relative error far from the peak",
        float(np.abs(single[3000:4000] / 1e-10 - 1).max()),
        "direct sum in float64 (a float64 FFT beyond 4096 taps): the same",
        float(np.abs(ours[1500:4000] / 1e-10 - 1).max()),
        "the constant itself",
        allowed=1e-12,
    )


def long_dead_time() -> HardCase:
    """A flux of ten thousand photons per cycle, dead for seven cycles after each."""
    flux = np.random.default_rng(0).random(100) ** 3
    flux *= 1e4 / flux.sum()
    mean = equilibrium(flux, np.linspace(0, 1e-7, 101), 1e-9, 7e-7).mean
    truth = flux / (1 + 7 * 1e4)
    return HardCase(
        "1e4 photons per cycle, dead time of seven cycles",
        "Poisson counts of the flux: factor too many",
        float(flux.sum() / truth.sum()),
        "the renewal equations: largest relative error of a bin",
        float(np.abs(mean / truth - 1).max()),
        "λ/(1 + 7Λ), exact for whole periods",
        allowed=1e-9,
    )


def many_cycles() -> HardCase:
    """2³¹ cycles and more: counts beyond float32 and int32."""
    cycles, repeats = 2**40, 400
    counts = detect(
        np.full((repeats, 1, 100), 0.004), TIME, Spad(1.0, dead_time_s=2e-7, mode="synchronous"),
        Exposure(1e7, cycles, 1.0), seed=2, tolerance=0.0,
    )  # fmt: skip
    p = one_per_cycle_mean(np.full(100, 0.004))
    z = (counts[:, 0].mean(axis=0) - cycles * p) / np.sqrt(cycles * p * (1 - p) / repeats)
    single = np.float32(cycles * p.sum()) + np.float32(1000.0)
    return HardCase(
        "2⁴⁰ cycles",
        "counts in float32: of a thousand more, how many are lost",
        float(1000.0 - (np.float64(single) - np.float64(np.float32(cycles * p.sum())))),
        "int64 and binomials exact at any size: χ² of 100 means over its 10⁻³ limit",
        float((z**2).sum() / stats.chi2(100).isf(1e-3)),
        "the binomial law",
        allowed=1.0,
    )


def arrival_time() -> HardCase:
    """Paths at random places of 1 ps bins, and of bins four times as wide."""
    bins, rng = 1024, np.random.default_rng(1)
    positions = rng.uniform(4, bins - 4, 2000)
    narrow, wide = np.zeros(bins), np.zeros(bins // 4)
    for x in positions:
        add_to_bin(narrow, float(x), 1.0)
        add_to_bin(wide, float(x) / 4, 1.0)
    split = [_shared(positions, bins).reshape(-1, 4).sum(axis=1), _shared(positions / 4, bins // 4)]
    return HardCase(
        "Paths in bins of 1 ps, added up to bins of 4 ps",
        "a path shared by the two nearest bins: photons in another bin than in bins of 4 ps at once",
        float(np.abs(split[0] - split[1]).sum() / 2 / len(positions)),
        "a path put into the bin that holds it: the same",
        float(np.abs(narrow.reshape(-1, 4).sum(axis=1) - wide).sum() / 2 / len(positions)),
        "bins are integrals: narrow ones add up to wide ones",
        allowed=1e-12,
    )


def _shared(positions: Floats, bins: int) -> Floats:
    """Paths shared linearly by the two bins whose centres are nearest."""
    lower = np.floor(positions - 0.5).astype(int)
    share = positions - 0.5 - lower
    return np.asarray(np.bincount(lower, 1 - share, bins) + np.bincount(lower + 1, share, bins))


COUNTS = (
    arrival_time, narrow_response, wide_tail, contrast, tiny_flux, long_dead_time, many_cycles
)  # fmt: skip
