"""Every way of computing light equals the definition (`transport/reference.py`), for every BRDF, shape and capture.

`benchmarks/ways.py` has the cases, says what is compared, and prints the same comparisons as a table. A case is
judged at the level `LEVEL / len(CASES)`, divided by the numbers that are compared in it.
"""

from __future__ import annotations

import numpy as np
import pytest
from benchmarks.ways import CAPTURES, CASES, DEFINITION, SHAPES, Case, Row, compared, pooled
from every_brdf import BROAD
from scipy import stats

LEVEL = 1e-3
"""Chance that any z of an ordinary run exceeds its limit."""
TRUE_BY_CLAIM = 1.5
"""True over claimed error that is allowed; 5 % of wholes and objects may have more, but not this few runs' mean."""
POOLED = 0.01
"""What the energy of all cases may be off by, beyond noise."""


def by_night() -> list[object]:
    """Each material with each capture, and with each shape twice or more."""
    every = [
        Case(material, list(SHAPES)[(k + j) % len(SHAPES)], capture)
        for k, material in enumerate(BROAD)
        for j, capture in enumerate(CAPTURES)
    ]
    return [pytest.param(case, marks=pytest.mark.nightly) for case in every if case not in CASES]


def limit(rows: list[Row]) -> float:
    """Largest |z| that is allowed in a case."""
    return float(stats.norm.isf(LEVEL / 2 / len(CASES) / sum(len(row.z) for row in rows)))


@pytest.mark.parametrize("case", [*CASES, *by_night()], ids=", ".join)
def test_all_ways(case: Case) -> None:
    rows = compared(case)
    most = limit(rows)
    assert not [row.cells() for row in rows if max(row.z.values(), default=0.0) > most], most
    # In squares, of which the noise is known.
    judged = [(row, row.found) for row in rows if row.claimed is not None and row.found is not None]
    wrong = [
        row.cells() for row, found in judged if found.square > (TRUE_BY_CLAIM * row.claimed) ** 2 + 4 * found.noise
    ]
    assert not wrong
    # The comparison means something only where the light is known well.
    assert all(row.noise < 0.03 for row in rows if row.light == "primary" and row.against != DEFINITION)


def test_all_cases_together() -> None:
    """A small loss that all cases share is lost in the noise of each."""
    means = pooled([row for case in CASES for row in compared(case)])
    assert {light for light, *_ in means} >= {"primary", "secondary", "higher", "whole"}
    wrong = {key: of for key, of in means.items() if abs(of[0] - 1) > POOLED + 4 * of[1]}
    assert not wrong
    assert np.isfinite([noise for _, noise in means.values()]).all()
