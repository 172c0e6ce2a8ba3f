"""How much one call of the light transport holds in memory."""

from __future__ import annotations

VALUES_AT_ONCE = 1 << 22
"""Numbers in the temporary arrays of one call: 32 MiB as float64. More work is done in several calls, each with as
many rays, paths or histogram bins as have room. Half as many numbers take half the memory and twice the calls; the
stored light then changes, for the calls' random numbers are drawn call by call."""
