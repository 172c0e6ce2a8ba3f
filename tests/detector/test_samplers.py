"""Counts against the photon-by-photon simulation (bins, totals, correlations) and their expected histogram."""

from __future__ import annotations

import numpy as np
import pytest
from photon_by_photon import Rule, simulate
from statistics_kit import mean_is, same_law

from datagen.detector import Exposure, Spad, choose_sampler, detect, expected_histogram
from datagen.records import TimeAxis

FLUXES = (0.01, 0.1, 1.0, 4.0)
BINS, WIDTH = 19, 1e-9
TIME = TimeAxis(BINS, WIDTH)
EDGES = np.append(WIDTH * np.arange(BINS + 1), 19.4e-9)
"""Edges of the bins, and of the rest of the period, which is seldom a whole number of bins."""
PERIOD = EDGES[-1]
DEAD_TIMES = {"shorter": 7.3e-9, "equal": PERIOD, "several": 2.71 * PERIOD}
BACKGROUND_HZ = 2e6
REPLICATES = 250


def shape_of(flux: float) -> np.ndarray:
    """(19,) a bright return in one bin, a decaying tail, and a bin without light."""
    lam = np.exp(-np.arange(BINS) / 6.0)
    lam[4] += 5.0
    lam[11] = 0.0
    return lam * flux / lam.sum()


def gate_of(spad: Spad) -> np.ndarray:
    """(20,) share of each bin within the gate."""
    if spad.gate_start_s is None:
        return np.ones(BINS + 1)
    low, high = spad.gate_start_s, spad.gate_start_s + spad.gate_width_s
    return np.clip(np.minimum(EDGES[1:], high) - np.maximum(EDGES[:-1], low), 0.0, None) / np.diff(EDGES)


def check(spad: Spad, light: np.ndarray, cycles: int, sampler: str, what: str, *, exact_mean: bool = True) -> None:
    """Assert that counts of light (pixel, 19) have the law of single photons, and the expected mean."""
    exposure = Exposure(1 / PERIOD, cycles, 1.0, ambient_rate_hz=BACKGROUND_HZ * min(light.sum(), 1.0))
    pixels = len(light)
    chosen = choose_sampler(light[None], TIME, spad, exposure, tolerance=0.0)
    assert chosen.histograms == {sampler: pixels}
    got = detect(np.tile(light, (REPLICATES, 1, 1)), TIME, spad, exposure, seed=1, tolerance=0.0)
    flux = np.concatenate([light, np.zeros((pixels, 1))], axis=1) + exposure.ambient_rate_hz * np.diff(EDGES)
    gate, loads = gate_of(spad), spad.trap_loads if spad.afterpulse_probability > 0 else ()
    times = spad.afterpulse_times_s if loads else ()
    rule = Rule(spad.dead_time_s, spad.mode == "synchronous", spad.paralyzable, loads, times,
                spad.crosstalk_probability, spad.array_columns or 1)  # fmt: skip
    burn_in = 0 if spad.mode == "synchronous" and not loads else 80
    rng = np.random.default_rng(2)
    want = simulate(flux * gate, EDGES, cycles, rule, rng, REPLICATES, burn_in, gate)[..., :BINS]
    # The first bin apart, few enough columns of an array's pixels stay testable together.
    step = 1 if pixels == 1 else 6
    columns = [x[..., 1:].reshape(REPLICATES, -1, step).sum(axis=2) for x in (got, want)]
    same_law(*columns, what)
    if exact_mean:
        mean_is(got[:, 0], expected_histogram(light[None], TIME, spad, exposure)[0, 0], what)


@pytest.mark.parametrize("flux", FLUXES)
@pytest.mark.parametrize(
    ("mode", "length", "sampler"),
    [
        ("free_running", "shorter", "events"),
        ("free_running", "equal", "events"),
        ("free_running", "several", "events"),
        ("synchronous", "shorter", "chain"),
        ("synchronous", "equal", "chain"),
    ],
)
def test_dead_time(flux: float, mode: str, length: str, sampler: str) -> None:
    spad = Spad(pde=1.0, dead_time_s=DEAD_TIMES[length], mode=mode)
    cycles = round(700 / flux) if flux < 1 else 500
    check(spad, shape_of(flux)[None], cycles, sampler, f"{mode}, flux {flux}, dead time {length}")


@pytest.mark.parametrize("flux", FLUXES[1::2])
@pytest.mark.parametrize("length", DEAD_TIMES)
@pytest.mark.parametrize("mode", ["free_running", "synchronous"])
def test_paralyzable(flux: float, length: str, mode: str) -> None:
    spad = Spad(pde=1.0, dead_time_s=DEAD_TIMES[length], mode=mode, paralyzable=True)
    sampler = "chain" if mode == "synchronous" and length != "shorter" else "events"
    cycles = round(700 / flux) if flux < 1 else 500
    check(spad, shape_of(flux)[None], cycles, sampler, f"paralyzable {mode} {flux} {length}")


@pytest.mark.parametrize("flux", [0.1, 1.0, 4.0])
@pytest.mark.parametrize(
    ("mode", "length", "times", "weights"),
    [
        ("free_running", "shorter", (11e-9,), ()),
        ("free_running", "several", (20e-9, 150e-9), (3.0, 1.0)),
        ("synchronous", "shorter", (11e-9,), ()),
        ("synchronous", "equal", (40e-9,), ()),
    ],
)
def test_afterpulsing_behind_a_gate(flux: float, mode: str, length: str, times: tuple, weights: tuple) -> None:
    gate = {"gate_start_s": 2.6e-9, "gate_width_s": 11.8e-9}
    spad = Spad(pde=1.0, dead_time_s=DEAD_TIMES[length], mode=mode, afterpulse_probability=0.3,
                afterpulse_times_s=times, afterpulse_weights=weights, **gate)  # fmt: skip
    cycles = int(np.ceil(250 / min(flux, 1.0)))
    check(spad, shape_of(flux)[None], cycles, "events", f"afterpulsing, {mode}, {length}, {flux}", exact_mean=False)


@pytest.mark.parametrize(("mode", "length"), [("free_running", "several"), ("synchronous", "shorter")])
def test_crosstalk_couples_neighbours(mode: str, length: str) -> None:
    """A 2 × 3 array with a bright first pixel: all six histograms side by side, so that correlations count too."""
    light = np.stack([shape_of(2.0 if p == 0 else 0.05 * p) for p in range(6)])
    spad = Spad(pde=1.0, dead_time_s=DEAD_TIMES[length], mode=mode, crosstalk_probability=0.15, array_columns=3)
    check(spad, light, 300, "events", f"crosstalk {mode}", exact_mean=False)


@pytest.mark.parametrize("length", DEAD_TIMES)
def test_more_events_than_can_be_drawn_have_the_exact_mean_and_nearly_the_variance(length: str) -> None:
    spad, cycles = Spad(pde=1.0, dead_time_s=DEAD_TIMES[length]), 10**8
    light = np.tile(shape_of(1.0), (REPLICATES, 1, 1))
    exposure = Exposure(1 / PERIOD, cycles, 1.0)
    assert choose_sampler(light, TIME, spad, exposure, approximate=True).histograms == {"multinomial": REPLICATES}
    counts = detect(light, TIME, spad, exposure, seed=3, approximate=True)[:, 0]
    mean_is(counts, expected_histogram(light[0, 0], TIME, spad, exposure), f"many events, dead time {length}")
    # The variance of so many cycles grows with their number.
    few = 2_000
    exact = detect(light, TIME, spad, Exposure(1 / PERIOD, few, 1.0), seed=4, tolerance=0.0)[:, 0]
    for each in (np.s_[:], np.s_[4:5]):
        ratio = counts[:, each].sum(axis=1).var() / (exact[:, each].sum(axis=1).var() * cycles / few)
        assert 0.6 < ratio < 1.6  # 250 replicates: ± 13 % by chance
