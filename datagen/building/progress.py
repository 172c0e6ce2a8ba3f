"""Progress of a build: a bar on a terminal, plain lines elsewhere."""

from __future__ import annotations

import os
import sys
import time
from typing import Any


class Progress:
    """Counts scenes: one tqdm when standard error is a terminal, else a line for every shard; nothing if not `shown`.

    total, done : scenes of this build, and those found finished when it began.
    """

    def __init__(self, total: int, done: int, shown: bool) -> None:
        self._total, self._done, self._shown = total, done, shown
        self._at_start, self._started, self._failures = done, time.monotonic(), 0
        self._bar: Any = None
        if shown and sys.stderr.isatty():
            from tqdm import tqdm

            # A terminal may say that it has no size (containers do); tqdm would then show nothing.
            sized = min(os.get_terminal_size(sys.stderr.fileno())) > 1
            size = {"dynamic_ncols": True} if sized else {"ncols": 80, "nrows": 24}
            self._bar = tqdm(total=total, initial=done, unit="scene", **size)

    def under_way(self, scenes: int) -> None:
        """Show the number of scenes that are finished in unfinished shards."""
        if self._bar is not None:
            self._advance(self._done + scenes)
            self._bar.refresh()

    def shard_done(self, shard: int, scenes: int, failures: int) -> None:
        """Count a finished shard of so many scenes, of which `failures` failed."""
        self._done += scenes
        self._failures += failures
        if self._bar is not None:
            self._advance(self._done)
            self._bar.set_postfix(failed=self._failures) if self._failures else self._bar.refresh()
            return
        rate = (self._done - self._at_start) / max(time.monotonic() - self._started, 1e-9)
        failed = f", {self._failures} failed" if self._failures else ""
        left = (self._total - self._done) / rate
        self.say(
            f"shard {shard}: {self._done} of {self._total} scenes{failed}, {rate:.2f} scenes/s, {left:.0f} s left"
        )

    def _advance(self, scenes: int) -> None:
        """Move the bar, never backwards: the count drops for a moment when a shard ends, and when a worker dies."""
        self._bar.n = max(self._bar.n, min(self._total, scenes))

    def say(self, line: str) -> None:
        """Print a line of text, above the bar where there is one."""
        if self._bar is not None:
            self._bar.write(line, file=sys.stderr)
        elif self._shown:
            print(line, file=sys.stderr, flush=True)

    def close(self) -> None:
        """End the bar."""
        if self._bar is not None:
            self._bar.close()
