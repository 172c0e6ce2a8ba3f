"""How random cases are drawn and how many are tried.

`pytest tests/fuzz` tries a few hundred from the explicit seeds 0, 1, 2 …: the same on every machine and with every
version of every library, as they rest on `random.Random.random` alone, whose sequence Python guarantees.
`make fuzz` sets DATAGEN_FUZZ=nightly: thousands drawn by hypothesis, new ones at each run, whose seed it prints
(`make fuzz SEED=…` repeats a run), made smaller where one fails.

Both read the same strategies: a module writes `from fuzz_profile import st` for either's vocabulary.
"""

from __future__ import annotations

import functools
import os
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from random import Random
from types import SimpleNamespace
from typing import Any

import hypothesis
from hypothesis import strategies

NIGHTLY = os.environ.get("DATAGEN_FUZZ") == "nightly"
TRIES_PER_CASE = 20
"""Seeds tried, at most, for each case wanted; some draws are refused as no case."""


class Unsuitable(Exception):
    """A draw that is no case of what is tested."""


@dataclass(frozen=True)
class Seeded:
    """A strategy as hypothesis has it, its value a function of a `Random`."""

    value: Callable[[Random], Any]

    def map(self, function: Callable[[Any], Any]) -> Seeded:
        return Seeded(lambda r: function(self.value(r)))


def _below(r: Random, count: int) -> int:
    return min(int(r.random() * count), count - 1)


def _lists(of: Seeded, *, min_size: int = 0, max_size: int) -> Seeded:
    return Seeded(lambda r: [of.value(r) for _ in range(min_size + _below(r, max_size - min_size + 1))])


def _permutation(r: Random, items: Sequence[Any]) -> list[Any]:
    return sorted(items, key=dict(zip(items, [r.random() for _ in items], strict=True)).__getitem__)


def _sets(of: Seeded, *, min_size: int, max_size: int) -> Seeded:
    """Of integers few enough that all of them turn up."""

    def value(r: Random) -> set[Any]:
        size, found = min_size + _below(r, max_size - min_size + 1), set()
        while len(found) < size:
            found.add(of.value(r))
        return found

    return Seeded(value)


def _composite(build: Callable[..., Any]) -> Callable[..., Seeded]:
    @functools.wraps(build)
    def strategy(*args: Any, **kwargs: Any) -> Seeded:
        return Seeded(lambda r: build(lambda of: of.value(r), *args, **kwargs))

    return strategy


def _one_of(*of: Seeded) -> Seeded:
    return Seeded(lambda r: of[_below(r, len(of))].value(r))


_seeded = SimpleNamespace(
    DrawFn=Any,
    none=lambda: Seeded(lambda r: None),
    booleans=lambda: Seeded(lambda r: r.random() < 0.5),
    integers=lambda low, high: Seeded(lambda r: low + _below(r, high - low + 1)),
    sampled_from=lambda items: Seeded(lambda r: items[_below(r, len(items))]),
    tuples=lambda *of: Seeded(lambda r: tuple(s.value(r) for s in of)),
    permutations=lambda items: Seeded(lambda r: _permutation(r, items)),
    lists=_lists,
    sets=_sets,
    one_of=_one_of,
    composite=_composite,
)
st: Any = strategies if NIGHTLY else _seeded


def assume(condition: bool) -> None:
    """Leave a case out unless the condition holds."""
    if NIGHTLY:
        hypothesis.assume(condition)
    elif not condition:
        raise Unsuitable


def fuzzed(few: int, nightly: int, *given: Any) -> Callable[[Callable[..., None]], Callable[[], None]]:
    """Run a test with values drawn from `given`: `few` cases in the ordinary tests, `nightly` under `make fuzz`."""
    return _by_hypothesis(nightly, given) if NIGHTLY else _by_seeds(few, given)


def _by_seeds(cases: int, given: Sequence[Seeded]) -> Callable[[Callable[..., None]], Callable[[], None]]:
    def decorate(test: Callable[..., None]) -> Callable[[], None]:
        def tried() -> None:
            left = cases
            for seed in range(TRIES_PER_CASE * cases):
                r = Random(seed)
                values = [strategy.value(r) for strategy in given]
                try:
                    test(*values)
                except Unsuitable:
                    continue
                except BaseException as error:
                    error.add_note(f"case of seed {seed}: {values!r}")
                    raise
                left -= 1
                if left == 0:
                    return
            raise AssertionError(f"only {cases - left} of {cases} cases suit the test")

        tried.__name__, tried.__doc__, tried.__module__ = test.__name__, test.__doc__, test.__module__
        return tried

    return decorate


def _by_hypothesis(cases: int, given: Sequence[Any]) -> Callable[[Callable[..., None]], Callable[[], None]]:
    # Scenes are large examples and simulations slow ones, by hypothesis' standards.
    quiet = hypothesis.settings(
        max_examples=cases,
        database=None,
        deadline=None,
        print_blob=True,
        suppress_health_check=list(hypothesis.HealthCheck),
    )
    return lambda test: quiet(hypothesis.given(*given)(test))
