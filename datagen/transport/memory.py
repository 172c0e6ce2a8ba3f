"""How much one call of the light transport holds in memory."""

from __future__ import annotations

from collections.abc import Iterator

VALUES_AT_ONCE = 1 << 22
"""Numbers in the temporary arrays of one call: 32 MiB as float64. More work is done in several calls, each with as
many rays, paths or histogram bins as have room. With another number the stored light changes, for the calls' random
numbers are drawn call by call."""


def in_calls(count: int, numbers: int) -> Iterator[slice]:
    """Slices that divide `count` things into calls, where each takes so many numbers of memory."""
    at_once = max(VALUES_AT_ONCE // max(numbers, 1), 1)
    return (slice(start, min(start + at_once, count)) for start in range(0, count, at_once))
