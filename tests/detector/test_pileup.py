"""The bias of Poisson counting, as the benchmark measures it, against closed forms."""

from __future__ import annotations

import numpy as np
import pytest
from benchmarks.pileup import pileup_rows, room_channel

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
