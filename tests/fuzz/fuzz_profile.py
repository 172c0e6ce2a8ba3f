"""How many random cases are tried, and by which seed.

`pytest tests/fuzz` tries a few hundred, the same at each run: hypothesis takes its seed from the test itself. `make
fuzz` sets DATAGEN_FUZZ=nightly: thousands, new ones at each run, whose seed it prints (`make fuzz SEED=…` repeats a
run). A case that fails is made smaller.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from typing import Any

import hypothesis
from hypothesis import assume, strategies

__all__ = ["NIGHTLY", "assume", "fuzzed", "st"]

NIGHTLY = os.environ.get("DATAGEN_FUZZ") == "nightly"
st: Any = strategies


def fuzzed(few: int, nightly: int, *given: Any) -> Callable[[Callable[..., None]], Callable[[], None]]:
    """Run a test with values drawn from `given`: `few` cases in the ordinary tests, `nightly` under `make fuzz`."""
    # Scenes are large examples and simulations slow ones, by hypothesis' standards.
    profile = hypothesis.settings(
        max_examples=nightly if NIGHTLY else few, derandomize=not NIGHTLY, database=None, deadline=None,
        print_blob=True, suppress_health_check=list(hypothesis.HealthCheck),
    )  # fmt: skip
    return lambda test: profile(hypothesis.given(*given)(test))
