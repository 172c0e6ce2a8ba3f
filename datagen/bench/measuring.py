"""What all benches share: the machine's name, processor seconds, tables in Markdown."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Sequence
from typing import TypeVar

from datagen.store.environment import cores, processor

T = TypeVar("T")


def machine() -> str:
    """The machine, for the head of a table."""
    return f"{processor()}, {cores()} cores"


def processor_seconds(call: Callable[[], T]) -> tuple[T, float]:
    """(result, processor seconds of all threads) of a call; other work of the machine hardly changes them."""
    began = time.process_time()
    result = call()
    return result, time.process_time() - began


def markdown(head: Sequence[str], rows: Iterable[Sequence[str]], words: int = 1) -> str:
    """A table, of which the first `words` columns are words, aligned left, and the others numbers."""
    rules = ["---" if k < words else "---:" for k in range(len(head))]
    return "\n".join(f"| {' | '.join(cells)} |" for cells in (head, rules, *rows))


def percent(share: float) -> str:
    """`12 %`, `3.4 %`, `0.56 %`."""
    return f"{100 * share:.0f} %" if share >= 0.0995 else f"{100 * share:.2g} %"
