"""The promised error of transients to a target, of the whole and of each object, in ready configurations.

As `tests/benchmarks/promise.py`: a scan is run to its target, compared with independent paths. Each error is within
the error asked with a probability of 95 %; the numbers of misses, of the whole and of objects, are compared with a
binomial distribution at 10⁻³.
"""

from __future__ import annotations

from pathlib import Path

import pytest
from benchmarks.promise import TARGETS, WHOLE, case_of, checks_of
from scipy import stats

from datagen import load_config

CONFIGS = Path(__file__).parents[2] / "configs"
LEVEL = 1e-3
DAILY = ["confocal_scan", "quickstart", "shapes_behind_a_partition", "own_mesh", "letters_on_a_bench"]
ALL = sorted(path.stem for path in CONFIGS.glob("*.yaml"))


@pytest.mark.parametrize(
    ("names", "scenes", "target"),
    [(DAILY, 1, 0.05), *(pytest.param(ALL, 8, target, marks=pytest.mark.nightly) for target in TARGETS)],
    ids=["by day", *map(str, TARGETS)],
)
def test_ready_configurations_keep_their_promise(names: list[str], scenes: int, target: float) -> None:
    """On scenes that no figure of the pages uses."""
    configs = [config for name in names if (config := load_config(CONFIGS / f"{name}.yaml")).transport.target]
    cases = [case_of(config, index) for config in configs for index in range(100, 100 + scenes)]
    found = [one for case in cases for one in checks_of(case, [target]) if one.promised and one.decided]
    for some in ([one for one in found if (one.what == WHOLE) == whole] for whole in (True, False)):
        misses = sum(not one.within for one in some)
        assert len(some) >= 0.8 * len(cases)
        assert misses <= stats.binom.isf(LEVEL, len(some), 0.05), (misses, len(some))
