"""Every hard case of `make hard-cases`: our error within its limit, the naive way's beyond it."""

from __future__ import annotations

from collections.abc import Callable

import pytest
from hard_case_cells import CELLS
from hard_case_counts import COUNTS
from hard_case_light import LIGHT
from measured import HardCase


# One of the cases is a poster in the plane of its wall.
@pytest.mark.filterwarnings("ignore:simulate. parts .* lie in one place:datagen.InputWarning")
@pytest.mark.parametrize("case", [*LIGHT, *CELLS, *COUNTS], ids=lambda case: case.__name__)
def test_hard_case(case: Callable[[], HardCase]) -> None:
    measured = case()
    assert measured.ours <= measured.allowed, f"{measured.name}: {measured.our_way}"
    assert measured.naive > 1.0 or measured.naive > 2 * measured.ours, "nothing is gained over the naive way"
