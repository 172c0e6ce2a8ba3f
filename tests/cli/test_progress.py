"""The progress bar of a build never runs backwards."""

from __future__ import annotations

from typing import Any

from datagen.building.progress import Progress


class Bar:
    """What tqdm shows, kept."""

    def __init__(self) -> None:
        self.n = 0
        self.shown: list[int] = []

    def refresh(self) -> None:
        self.shown.append(self.n)

    def set_postfix(self, **_: Any) -> None:
        self.refresh()


def test_it_never_runs_backwards() -> None:
    """Two shards under way: one ends; then the worker of the other dies, and it begins anew."""
    progress, bar = Progress(16, 0, shown=False), Bar()
    progress._bar = bar
    progress.under_way(13)
    progress.shard_done(0, 8, failures=1)
    progress.under_way(6)
    progress.under_way(0)
    progress.shard_done(1, 8, failures=0)
    assert bar.shown == sorted(bar.shown) and bar.shown[-1] == 16
