"""The bench of the detector in small: its naive simulation is right, and its table holds what was measured."""

from __future__ import annotations

import numpy as np
import pytest

from datagen.bench import detector as bench


@pytest.fixture
def small(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(bench, "CYCLES", 2000)
    monkeypatch.setattr(bench, "_SECONDS", 1e-3)
    monkeypatch.setattr(bench, "BLOCK", 2)


def test_the_naive_rule_keeps_the_photons_that_a_dead_time_leaves() -> None:
    photons = [1.0, 2.0, 3.5, 9.0, 10.5, 12.0, 31.0]
    for rule in (bench._rule, bench._rule_compiled):
        arrivals = photons if rule is bench._rule else np.array(photons)
        assert list(rule(arrivals, 10.0, 2.5, False)) == [1.0, 3.5, 9.0, 12.0, 31.0]
        assert list(rule(arrivals, 10.0, 2.5, True)) == [1.0, 3.5, 9.0, 10.5, 31.0]
        assert list(rule(arrivals, 10.0, 0.0, True)) == photons


@pytest.mark.usefixtures("small")
def test_every_case_is_measured_with_its_sampler() -> None:
    rows = bench.measure(fluxes=(0.5,))
    samplers = {row.case[:2]: row.sampler for row in rows if "ensemble" not in row.case}
    assert samplers["a."] == "poisson" and samplers["b."] == "hazard_chain"
    assert samplers["d."] in ("return_chain", "avalanches")
    assert samplers["c."] == "free_running_events" and samplers["e."] == "avalanches"
    assert all(row.ms > 0 and row.mean_ms > 0 and row.plain_ms > 0 and row.compiled_ms > 0 for row in rows)
    lines = bench.table(rows).splitlines()
    assert len(lines) == 2 + len(rows)
    assert all(line.count("|") == lines[0].count("|") for line in lines)
    first = rows[0]
    assert f"{first.plain_ms / first.ms:.0f}×" in lines[2]


def test_the_demonstration_shape_is_half_direct_return() -> None:
    shape = bench.demonstration_shape()
    assert shape.sum() == pytest.approx(1) and shape[120] > 0.5 and np.all(shape > 0)
