"""How many cases the fuzzer tries.

`pytest tests/fuzz` tries a few hundred, the same ones each time. `make fuzz` sets DATAGEN_FUZZ=nightly: thousands of
new ones at each run, whose seed it prints (`make fuzz SEED=…` repeats a run), and what reproduces a failure.
"""

from __future__ import annotations

import os

from hypothesis import HealthCheck, settings

NIGHTLY = os.environ.get("DATAGEN_FUZZ") == "nightly"

# Scenes are large examples and simulations slow ones, by hypothesis' standards.
for _name, _derandomize in (("tests", True), ("nightly", False)):
    settings.register_profile(
        _name,
        derandomize=_derandomize,
        database=None,
        deadline=None,
        print_blob=True,
        suppress_health_check=list(HealthCheck),
    )


def cases_tried(few: int, nightly: int) -> settings:
    """Settings of a test: `few` cases in the ordinary tests, `nightly` under `make fuzz`."""
    name, count = ("nightly", nightly) if NIGHTLY else ("tests", few)
    return settings(settings.get_profile(name), max_examples=count)
