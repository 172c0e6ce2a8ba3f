"""Unequal bins of the TDC: they sort records by their true time, and change nothing that happens before."""

from __future__ import annotations

import csv
import gzip
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import scipy.stats
from photon_by_photon import Rule, simulate
from statistics_kit import accept, mean_is, same_law

from datagen.config.detector import DetectorConfig
from datagen.detector import Exposure, Spad, detect, detector_for, expected_histogram
from datagen.detector.tdc import tdc_widths
from datagen.records import TimeAxis

REAL = Path(__file__).parents[3] / "shared" / "real" / "linospad2_tdc.csv.gz"
BINS, WIDTH_S, PERIOD = 90, 1e-9, 20
TIME = TimeAxis(BINS, WIDTH_S)
EXPOSURE = Exposure(repetition_rate_hz=1e7, cycles=20_000, photons_per_pulse=1.0)
UNEQUAL = {"tdc_dnl": 0.7, "tdc_period_bins": PERIOD, "tdc_seed": 4}
SPADS = {
    "ideal": Spad(1.0, mode="ideal"),
    "jitter": Spad(1.0, mode="ideal", jitter_fwhm_s=2e-9),
    "one a cycle": Spad(1.0, dead_time_s=1e-6, mode="synchronous"),
    "several a cycle": Spad(1.0, dead_time_s=13.3e-9, mode="synchronous"),
    "several a cycle, jitter": Spad(1.0, dead_time_s=13.3e-9, mode="synchronous", jitter_fwhm_s=2e-9),
    "several a cycle, narrow jitter": Spad(1.0, dead_time_s=13.3e-9, mode="synchronous", jitter_fwhm_s=0.5e-9),
    "free running": Spad(1.0, dead_time_s=130e-9),
    "free running, jitter": Spad(1.0, dead_time_s=130e-9, jitter_fwhm_s=2e-9),
    "gate": Spad(1.0, dead_time_s=13.3e-9, gate_start_s=5.5e-9, gate_width_s=60e-9),
    "traps": Spad(1.0, afterpulse_probability=0.1, afterpulse_times_s=(20e-9,)),
    "paralyzable": Spad(1.0, dead_time_s=13.3e-9, paralyzable=True),
}


def unequal(spad: Spad) -> Spad:
    return replace(spad, **UNEQUAL)  # type: ignore[arg-type]


def lit(flux: float) -> np.ndarray:
    """(1, 2, bin) expected events per cycle: a return of two bins, a bump, a floor; another in each pixel."""
    i = np.arange(BINS)
    lam = np.stack([0.1 + 3 * np.exp(-(((i - 40) / 7.0) ** 2)) + 20 * ((i == k) | (i == k + 1)) for k in (9, 30)])
    return (lam * flux / lam.sum(axis=1, keepdims=True))[None]


@pytest.mark.parametrize("dnl", [1e-3, 0.5, 2.0])
def test_drawn_widths_have_the_mean_and_the_deviation_asked_for(dnl: float) -> None:
    """Each period has its nominal length. 4000 pixels give the deviation to a few per cent, heavy tails included."""
    spad = Spad(tdc_dnl=dnl, tdc_period_bins=PERIOD, tdc_seed=3)
    widths = tdc_widths(spad, 4000)
    assert widths.shape == (4000, PERIOD) and (widths >= 0).all()
    assert widths.sum(axis=1) == pytest.approx(PERIOD)
    squares = np.square(widths - 1).mean(axis=1)
    accept(float(2 * scipy.stats.norm.sf(abs(squares.mean() - dnl**2) / scipy.stats.sem(squares))), f"dnl {dnl}")
    assert len(np.unique(widths, axis=0)) == 4000
    assert (tdc_widths(replace(spad, tdc_seed=4), 9) != widths[:9]).any(axis=1).all()


@pytest.mark.parametrize("name", SPADS)
def test_records_are_sorted_and_neither_lost_nor_made(name: str) -> None:
    """The record of 90 bins ends in the middle of a TDC period of 20. Edges at equal distances change nothing."""
    lam, spad = lit(1.5), SPADS[name]
    plain, uneven, even = (
        expected_histogram(lam, TIME, of, EXPOSURE, approximate=True)
        for of in (spad, unequal(spad), replace(spad, tdc_edges_s=WIDTH_S * np.arange(PERIOD + 1)))
    )
    # The pieces of bins solve the renewal equation with other steps.
    rel = 1e-4 if spad.dead_time_s > 0 and spad.jitter_fwhm_s < WIDTH_S else 1e-12
    assert uneven.sum(axis=-1) == pytest.approx(plain.sum(axis=-1), rel=rel)
    assert np.linalg.norm(uneven - plain) > 0.2 * np.linalg.norm(plain)
    assert even == pytest.approx(plain, rel=rel)


@pytest.mark.parametrize("name", ["free running, jitter", "several a cycle, jitter"])
def test_dead_time_knows_nothing_of_the_bins(name: str) -> None:
    """With the same numbers the same detections are drawn; the bins only sort their records."""
    lam, spad = np.tile(lit(1.5), (5, 1, 1)), SPADS[name]
    plain = detect(lam, TIME, spad, EXPOSURE, seed=3, tolerance=0.0)
    sorted_anew = detect(lam, TIME, unequal(spad), EXPOSURE, seed=3, tolerance=0.0)
    np.testing.assert_array_equal(plain.sum(axis=-1), sorted_anew.sum(axis=-1))
    assert (plain != sorted_anew).any()


@pytest.mark.parametrize(
    "name", ["several a cycle, jitter", "several a cycle, narrow jitter", "free running, jitter", "gate", "traps"]
)
def test_expected_is_the_mean_of_detect(name: str) -> None:
    lam, spad = lit(0.8), unequal(SPADS[name])
    exposure = replace(EXPOSURE, cycles=2000)
    mean = expected_histogram(lam, TIME, spad, exposure)
    counts = detect(np.tile(lam, (250, 1, 1)), TIME, spad, exposure, tolerance=0.0)
    for pixel in range(2):
        # Neighbours are added up so that bins have the counts that the test's normal law needs.
        threes = counts[:, pixel].reshape(len(counts), BINS // 3, 3).sum(axis=2)
        mean_is(threes, mean[0, pixel].reshape(-1, 3).sum(axis=1), f"unequal bins, {name}, pixel {pixel}")


@pytest.mark.parametrize("mode", ["synchronous", "free_running"])
def test_detections_within_a_bin_are_in_true_time(mode: str) -> None:
    """A flash of 1.5 events per cycle and bin, against photons that are drawn, timed and sorted one by one. Records
    that are taken as uniform within a bin of the time axis fail by twenty standard deviations."""
    bins, cycles, replicates = 12, 4000, 300
    time = TimeAxis(bins, WIDTH_S)
    exposure = Exposure(1 / (bins * WIDTH_S), cycles, 1.0)
    lam = np.full(bins, 0.05)
    lam[3:5] = 1.5
    spad = Spad(1.0, dead_time_s=3.4e-9, mode=mode, tdc_dnl=0.6, tdc_period_bins=bins, tdc_seed=2)  # type: ignore[arg-type]
    inner = np.append(0.0, np.cumsum(tdc_widths(spad, 1)[0])) * WIDTH_S
    edges = np.unique(np.concatenate([np.arange(bins + 1) * WIDTH_S, inner[1:-1]]))
    middle = (edges[1:] + edges[:-1]) / 2
    fine = lam[(middle / WIDTH_S).astype(int)] * np.diff(edges) / WIDTH_S
    rule = Rule(3.4e-9, mode == "synchronous")
    photons = simulate(fine, edges, cycles, rule, np.random.default_rng(5), replicates, burn_in=50)[:, 0]
    code = np.searchsorted(inner, middle, side="right") - 1
    true = np.stack([np.bincount(code, weights=row, minlength=bins) for row in photons])
    drawn = detect(np.tile(lam, (replicates, 1, 1)), time, spad, exposure, seed=4, tolerance=0.0)[:, 0]
    same_law(drawn, true, f"unequal bins, photon by photon, {mode}")
    mean_is(true, expected_histogram(lam, time, spad, exposure), f"photons in unequal bins, {mode}")


def test_the_record_ends_with_the_time_axis() -> None:
    """In a period of 29.4 bins: the last one of the TDC is cut off at the end of the axis, or extended to it."""
    time, exposure = TimeAxis(29, WIDTH_S), Exposure(1 / (29.4 * WIDTH_S), 10**6, 1.0)
    dark = np.zeros((1, 3, 29))
    slow = Spad(dark_count_rate_hz=1e6, dead_time_s=10e-9)
    for spad in (Spad(dark_count_rate_hz=1e6), slow, replace(slow, jitter_fwhm_s=0.5e-9)):
        mean = expected_histogram(dark, time, unequal(spad), exposure)
        assert mean.sum(axis=2) == pytest.approx(expected_histogram(dark, time, spad, exposure).sum(axis=2), rel=1e-6)
        assert len(np.unique(mean.round(6))) > 60
        counts = detect(dark, time, unequal(spad), exposure, seed=2)
        accept(float(scipy.stats.chi2(87).sf((np.square(counts - mean)[mean > 0] / mean[mean > 0]).sum())), "window")


@pytest.mark.parametrize("dead_time_s", [0.0, 50e-9])
def test_code_density(dead_time_s: float) -> None:
    """Constant light gives each bin counts in proportion to its width."""
    spad = unequal(Spad(1.0, dead_time_s=dead_time_s, jitter_fwhm_s=1e-10))
    time = TimeAxis(5 * PERIOD, WIDTH_S)
    code_density(spad, time, Exposure(1e7, 400_000, 1.0, ambient_rate_hz=4e6), np.zeros((1, 3, time.bins)))


def code_density(spad: Spad, time: TimeAxis, exposure: Exposure, dark: np.ndarray) -> None:
    """Assert the law for a time axis of whole TDC periods which fills the laser period."""
    widths = tdc_widths(spad, dark.shape[1])
    counts = detect(dark, time, spad, exposure, seed=6, tolerance=0.0)[0]
    for pixel, (row, w) in enumerate(zip(counts, widths, strict=True)):
        in_code = row.reshape(-1, len(w)).sum(axis=0)
        assert (in_code[w == 0] == 0).all()
        mean = in_code.sum() * w / len(w)
        use = mean >= 10
        # Given their sum, the counts of a stationary process in bins far shorter than its dead time scatter at most
        # as multinomial ones do.
        chi2 = float((np.square(in_code - mean)[use] / mean[use]).sum())
        accept(float(scipy.stats.chi2(int(use.sum()) - 1).sf(chi2)), f"code density, pixel {pixel}")
        flat = in_code.sum() / len(w)
        assert np.square(in_code - flat).sum() / flat > 20 * len(w)


@pytest.mark.skipif(not REAL.is_file(), reason="the measured edges of a LinoSPAD2's TDCs stay out of the repository")
def test_a_measured_tdc() -> None:
    """256 TDCs of a LinoSPAD2, 140 codes in 2.5 ns; three of them have no calibration."""
    with gzip.open(REAL, "rt") as file:
        table = np.array([row[1:] for row in csv.reader(file)][1:])
    upper = np.array([row for row in table if all(row)], float) * 1e-12
    edges = np.concatenate([np.zeros((len(upper), 1)), upper], axis=1)
    time = TimeAxis(4 * 140, 2.5e-9 / 140)
    spad = Spad(1.0, dead_time_s=40e-9, tdc_edges_s=edges)  # type: ignore[arg-type]
    widths = tdc_widths(spad, len(edges))
    assert len(edges) == 253 and widths.shape == (253, 140)
    picoseconds = widths * time.width_s * 1e12
    assert picoseconds.mean() == pytest.approx(17.857, abs=1e-3)
    assert np.percentile(picoseconds, [5, 95]) == pytest.approx([0.0, 49.6], abs=0.1)
    deviation = widths.std(axis=1).mean()
    assert deviation == pytest.approx(0.938, abs=1e-3)
    code_density(spad, time, Exposure(1e8, 10**6, 1.0, ambient_rate_hz=2e6), np.zeros((1, 253, time.bins)))
    # Widths drawn with this deviation scatter as far: 0 … 50 ps from the 5th to the 95th percentile.
    drawn = tdc_widths(Spad(tdc_dnl=float(deviation)), 253) * time.width_s * 1e12
    assert np.percentile(drawn, [5, 95]) == pytest.approx([0.9, 51.5], abs=3)


def test_drawn_from_a_configuration() -> None:
    """Numbers of other parameters are those without nonlinearity."""
    plain, _ = detector_for(DetectorConfig(detector_class="si_array"), 1, 2)
    assert plain.tdc_bins_are_equal and plain.tdc_seed == 0
    settings = {"detector_class": "si_array", "tdc_dnl": {"uniform": (0.2, 0.4)}, "tdc_period_bins": 64}
    spads = [detector_for(DetectorConfig.model_validate(settings), 1, i)[0] for i in range(3)]
    assert len({spad.tdc_dnl for spad in spads}) == 3 and all(0.2 <= spad.tdc_dnl <= 0.4 for spad in spads)
    assert len({spad.tdc_seed for spad in spads}) == 3 and {spad.tdc_period_bins for spad in spads} == {64}
    at_two = detector_for(DetectorConfig(detector_class="si_array", tdc_dnl=0.3), 1, 2)[0]
    assert replace(at_two, tdc_dnl=0.0, tdc_seed=0) == plain
