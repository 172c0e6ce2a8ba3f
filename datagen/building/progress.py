"""Progress of a build: a bar on a terminal, elsewhere a line from time to time, where something has changed."""

from __future__ import annotations

import os
import sys
import time
from collections.abc import Sequence
from typing import Any

from datagen.errors import as_line

LINE_S = 10.0
"""Seconds between the first lines; later lines come after a twentieth of the time since the build began."""


class Progress:
    """Reports on standard error how many scenes are made, and what a command does before the first scene or without
    any; reports nothing if not `shown`."""

    def __init__(self, shown: bool) -> None:
        self._shown, self._began = shown, time.monotonic()
        self._total = self._done = self._at_start = 0
        # No line before `LINE_S`: bad input is refused sooner than that, and its error shall be the only line.
        self._line_due = self._began + LINE_S
        # What was said already. A line for which nothing has changed would only lengthen a log.
        self._said = set[object]()
        self._bar: Any = None
        # A dumb terminal would print the characters that move the bar.
        if shown and sys.stderr.isatty() and os.environ.get("TERM") != "dumb":
            from tqdm import tqdm

            # Terminals in containers may report a size of 0; tqdm would then show nothing.
            sized = min(os.get_terminal_size(sys.stderr.fileno())) > 1
            size = {"dynamic_ncols": True} if sized else {"ncols": 80, "nrows": 24}
            # Before scenes are counted the bar is what is done, and for how long.
            self._bar = tqdm(unit="scene", leave=False, bar_format="{desc} [{elapsed}]", **size)

    def doing(self, what: str) -> None:
        """Show what the command does, before the first scene or without any: a line once, or the bar, whose clock
        repeated calls keep running."""
        if self._bar is not None:
            self._bar.set_description_str(as_line(what))
        elif time.monotonic() >= self._line_due:
            self._line(what, what)

    def begin(self, total: int, done: int) -> None:
        """Begin to count scenes: `total` in all, `done` of which an earlier build finished."""
        self._total, self._done, self._at_start, self._began = total, done, done, time.monotonic()
        self._line_due = self._began
        if self._bar is not None:
            self._bar.set_description_str("", refresh=False)
            self._bar.bar_format = None
            self._bar.reset(total)
            self._bar.n, self._bar.initial, self._bar.leave = done, done, True

    def update(self, done: int, in_work: Sequence[int], failures: int) -> None:
        """Show how many scenes are finished, which scenes workers are making, and how many failed."""
        # The count never goes back, although a shard begins again when its worker dies.
        before, self._done = self._done, max(self._done, min(self._total, done))
        others = f" and {len(in_work) - 1} more" if len(in_work) > 1 else ""
        at = f"scene {min(in_work)}{others}" if in_work else ""
        if self._bar is not None:
            self._bar.n = self._done
            self._bar.set_description_str(at, refresh=False)
            self._bar.set_postfix(failed=failures) if failures else self._bar.refresh()
        elif time.monotonic() >= self._line_due or before < self._done == self._total:
            rate = (self._done - self._at_start) / max(time.monotonic() - self._began, 1e-9)
            speed = f", {rate:.2g} scenes/s, {(self._total - self._done) / rate:.0f} s left" if rate else ""
            failed = f", {failures} failed" if failures else ""
            at = f"; {at} in work" if at and self._done < self._total else ""
            self._line(f"{self._done} of {self._total} scenes{failed}{speed}{at}", (self._done, failures, at))

    def _line(self, line: str, state: object) -> None:
        """Print a line on a state that no line was on, and set the time at which the next one is due."""
        if state in self._said:
            return
        self._said.add(state)
        self.say(line)
        now = time.monotonic()
        self._line_due = now + max(LINE_S, (now - self._began) / 20)

    def say(self, line: str) -> None:
        """Print a line of text, above the bar where there is one."""
        line = as_line(line)
        if self._bar is not None:
            self._bar.write(line, file=sys.stderr)
        elif self._shown:
            print(line, file=sys.stderr, flush=True)

    def close(self) -> None:
        """End the bar."""
        if self._bar is not None:
            self._bar.close()
