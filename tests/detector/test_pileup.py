"""The bias of Poisson counting, as a benchmark tells it, against closed forms."""

from __future__ import annotations

import numpy as np
import pytest
from benchmarks.pileup import DETECTORS, pileup_rows, room_channel

from datagen.config import config_from_mapping
from datagen.records import TimeAxis

ONE = "synchronous, one a cycle"


def test_a_single_bin_after_the_direct_return_has_the_closed_form() -> None:
    """One detection a cycle: a bin of λ behind a direct return of D is seen with (1 − e^−λ) e^−D."""
    time = TimeAxis(64, 1e-9)
    transient = np.zeros(64)
    transient[10], transient[30] = 0.9, 0.1
    rows = list(pileup_rows(transient, time, 20e-9, fluxes=(0.5, 2.0)))
    for row in rows:
        if row.detector != ONE:
            continue
        signal, direct = 0.1 * row.flux, 0.0 if row.gated else 0.9 * row.flux
        seen = -np.expm1(-signal) * np.exp(-direct)
        assert row.signal_bias == pytest.approx(signal / seen - 1, rel=1e-9)
        assert row.worst_bias == pytest.approx(row.signal_bias)
        assert row.delay_ps == pytest.approx(0, abs=1e-6)


def synthetic_corner() -> tuple[np.ndarray, TimeAxis, float]:
    """(bin,) transient, its time axis, the end of the direct return, which carries 80 % of the light; two objects
    before a wall and their decaying interreflection send the rest."""
    time = TimeAxis(768, 100e-12)
    t = time.centers_s * 1e9
    hidden = np.exp(-0.5 * ((t - 21) / 0.8) ** 2) + 0.5 * np.exp(-0.5 * ((t - 27) / 1.5) ** 2)
    hidden += 0.25 * np.exp(-(t - 20) / 9.0) * (t > 20) / (1 + np.exp(-(t - 22) / 0.5))
    direct = np.exp(-0.5 * ((t - 8) / 0.1) ** 2)
    return 0.8 * direct / direct.sum() + 0.2 * hidden / hidden.sum(), time, 12e-9


def test_bias_grows_with_flux_and_the_gate_lowers_it() -> None:
    transient, time, direct_until_s = synthetic_corner()
    rows = list(pileup_rows(transient, time, direct_until_s))
    for name in DETECTORS:
        bias = {gated: [r.signal_bias for r in rows if r.detector == name and r.gated is gated] for gated in (0, 1)}
        assert np.all(np.diff(bias[0]) > 0) and np.all(np.diff(bias[1]) > 0)
        assert np.all(np.array(bias[1]) <= np.array(bias[0]) * (1 + 1e-9))
    free = [r for r in rows if r.detector == ONE and not r.gated]
    # 80 % of the light comes first: to first order Poisson is too high by that and by half of the signal.
    assert free[0].signal_bias == pytest.approx(0.9 * free[0].flux, rel=0.01)
    assert all(r.delay_ps > 0 for r in free)


def _room(**time: float) -> tuple[np.ndarray, TimeAxis, float]:
    config = {
        "name": "room",
        "seed": 5,
        "scenes": 1,
        "capture": {"scan": {"rows": 1, "columns": 1}, "time": {"bins": 256, "bin_width_ps": 200, **time}},
        "transport": {"lookins": 256, "replicates": 1},
    }
    return room_channel(config_from_mapping(config))


def test_a_room_has_its_direct_return_before_everything_else() -> None:
    transient, time, until = _room()
    before = time.edges_s[:-1] < until
    assert transient[before].sum() > 10 * transient[~before].sum() > 0
    rows = list(pileup_rows(transient, time, until, fluxes=(0.1,)))
    in_view, gated = (r for r in rows if r.detector == ONE)
    assert in_view.signal_bias == pytest.approx(np.expm1(0.1), rel=0.1)
    assert 0 < gated.signal_bias < 0.02
