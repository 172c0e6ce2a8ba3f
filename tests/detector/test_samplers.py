"""Every sampler against the photon-by-photon simulation: bins, totals, correlations."""

from __future__ import annotations

import numpy as np
import pytest
from photon_by_photon import Rule, simulate
from statistics_kit import mean_is, same_law

from datagen.detector import Spad
from datagen.detector.chain import draw_cycle_ensemble, draw_hazard_chain, draw_return_chain
from datagen.detector.dead_time import equilibrium, pieces_of
from datagen.detector.events import draw_avalanches, draw_free_running
from datagen.detector.expected import mean_detections
from datagen.detector.flux import Cycle
from datagen.detector.irf import IDENTITY
from datagen.detector.random_numbers import generator_of

FLUXES = (0.01, 0.1, 1.0, 4.0)
BINS, WIDTH = 20, 1e-9
EDGES = np.append(WIDTH * np.arange(BINS), 19.4e-9)  # the last bin is a part of one, as periods are seldom whole
EDGES.flags.writeable = False  # as those of a `Cycle` are, for which the kernels are compiled then
PERIOD = EDGES[-1]
DEAD_TIMES = {"shorter": 7.3e-9, "equal": PERIOD, "several": 2.71 * PERIOD}
REPLICATES = 250


def shape_of(flux: float) -> np.ndarray:
    """A bright return in one bin, a decaying tail, background and a bin in which nothing can happen."""
    lam = 0.02 + np.exp(-np.arange(BINS) / 6.0)
    lam[4] += 5.0
    lam[11] = 0.0
    return lam * flux / lam.sum()


def cycle_of_test(gate: np.ndarray | None = None) -> Cycle:
    gate = np.ones(BINS) if gate is None else gate
    gate.flags.writeable = False
    return Cycle(PERIOD, WIDTH, EDGES, gate, BINS, 0, BINS, IDENTITY, IDENTITY)


def cycles_for(flux: float) -> int:
    return round(700 / flux) if flux < 1 else 500


def truth(flux, rule, cycles, seed, burn_in=0, gate=None):
    return simulate(flux, EDGES, cycles, rule, np.random.default_rng(seed), REPLICATES, burn_in, gate)[:, 0]


def drawn(draw, seed):
    stream = generator_of(seed)
    return np.stack([draw(stream) for _ in range(REPLICATES)])


@pytest.mark.parametrize("flux", FLUXES)
@pytest.mark.parametrize("length", DEAD_TIMES)
def test_free_running_events(flux, length):
    lam, tau, cycles = shape_of(flux), DEAD_TIMES[length], cycles_for(flux)
    state = equilibrium(lam, EDGES, WIDTH, tau)
    cycle, spad = cycle_of_test(), Spad(dead_time_s=tau)
    got = drawn(lambda stream: draw_free_running(lam, cycle, spad, cycles, state, stream), 1)
    same_law(got, truth(lam, Rule(tau), cycles, 2, burn_in=60), f"free running, flux {flux}, dead time {length}")
    mean_is(got, cycles * state.mean, f"free running, flux {flux}, dead time {length}")


@pytest.mark.parametrize("flux", FLUXES)
@pytest.mark.parametrize("length", ["shorter", "equal"])
def test_synchronous_chains(flux, length):
    lam, tau, cycles = shape_of(flux), DEAD_TIMES[length], cycles_for(flux)
    if length == "equal":
        got = drawn(lambda stream: draw_hazard_chain(lam, cycles, stream), 3)
    else:
        pieces = pieces_of(lam, EDGES, WIDTH, tau, shorter_than_dead_time=True)
        got = drawn(lambda stream: draw_return_chain(pieces, BINS, cycles, stream), 3)
    same_law(got, truth(lam, Rule(tau, synchronous=True), cycles, 4), f"synchronous, flux {flux}, dead time {length}")
    spad = Spad(dead_time_s=tau, mode="synchronous")
    mean_is(got, cycles * mean_detections(lam[None], cycle_of_test(), spad)[0], f"synchronous, {flux}, {length}")


@pytest.mark.parametrize("flux", FLUXES[1::2])
@pytest.mark.parametrize("length", DEAD_TIMES)
@pytest.mark.parametrize("mode", ["free_running", "synchronous"])
def test_paralyzable(flux, length, mode):
    lam, tau, cycles = shape_of(flux), DEAD_TIMES[length], cycles_for(flux)
    synchronous = mode == "synchronous"
    spad = Spad(dead_time_s=tau, mode=mode, paralyzable=True)
    got = drawn(lambda stream: draw_avalanches(lam[None], cycle_of_test(), spad, cycles, stream)[0], 7)
    rule = Rule(tau, synchronous=synchronous, paralyzable=True)
    same_law(
        got, truth(lam, rule, cycles, 8, burn_in=0 if synchronous else 60), f"paralyzable {mode} {flux} {length}"
    )
    mean_is(got, cycles * mean_detections(lam[None], cycle_of_test(), spad)[0], f"paralyzable {mode} {flux} {length}")


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
def test_afterpulsing(flux, mode, length, times, weights):
    gate = np.ones(BINS)
    gate[13:16] = 0.0
    gate[16] = 0.4
    lam, tau, cycles = shape_of(flux) * gate, DEAD_TIMES[length], int(np.ceil(250 / min(flux, 1.0)))
    spad = Spad(dead_time_s=tau, mode=mode, afterpulse_probability=0.3, afterpulse_times_s=times,
                afterpulse_weights=weights)  # fmt: skip
    share = np.array(weights or [1.0]) / np.sum(weights or [1.0])
    rule = Rule(tau, synchronous=mode == "synchronous", loads=tuple(-np.log(0.7) * share), times=times)
    got = drawn(lambda stream: draw_avalanches(lam[None], cycle_of_test(gate), spad, cycles, stream)[0], 9)
    same_law(got, truth(lam, rule, cycles, 10, burn_in=80, gate=gate), f"afterpulsing, {mode}, {length}, flux {flux}")


@pytest.mark.parametrize(("mode", "length"), [("free_running", "several"), ("synchronous", "shorter")])
def test_crosstalk_couples_neighbours(mode, length):
    """A 2 × 3 array with a bright first pixel: all six histograms side by side, so that correlations count too."""
    tau, cycles, seeds = DEAD_TIMES[length], 300, (11, 12)
    lam = np.stack([shape_of(2.0 if p == 0 else 0.05 * p) for p in range(6)])
    spad = Spad(dead_time_s=tau, mode=mode, crosstalk_probability=0.15, array_columns=3)
    rule = Rule(tau, synchronous=mode == "synchronous", crosstalk=0.15, columns=3)
    stream = generator_of(seeds[0])
    got = np.stack([draw_avalanches(lam, cycle_of_test(), spad, cycles, stream) for _ in range(REPLICATES)])
    want = simulate(lam, EDGES, cycles, rule, np.random.default_rng(seeds[1]), REPLICATES, 40)
    # Five bins a histogram keep the 30 columns testable together.
    same_law(
        *(x.reshape(REPLICATES, 6, 5, 4).sum(3).reshape(REPLICATES, 30) for x in (got, want)), f"crosstalk {mode}"
    )


@pytest.mark.parametrize("length", DEAD_TIMES)
def test_cycle_ensemble_has_the_exact_mean_and_nearly_the_variance(length):
    lam, tau, cycles = shape_of(1.0), DEAD_TIMES[length], 100_003
    state = equilibrium(lam, EDGES, WIDTH, tau, shorter_than_dead_time=True)
    got = drawn(lambda stream: draw_cycle_ensemble(state, cycles, stream), 13)
    mean_is(got, cycles * state.mean, f"ensemble, {length}")
    # The variance of so many cycles grows with their number.
    few = cycles // 10
    cycle, spad = cycle_of_test(), Spad(dead_time_s=tau)
    exact = drawn(lambda stream: draw_free_running(lam, cycle, spad, few, state, stream), 14)
    ratio = got.sum(1).var() / (exact.sum(1).var() * cycles / few)
    assert 0.7 < ratio < 1.5  # 250 replicates: ± 13 % by chance
