"""What the steps of a quadrature cost, in units of one connection with its shadow ray.

Decisions about effort rest on these constants and on counts alone, never on a clock, so that they are the same on
every machine. They were measured on one core in furnished rooms of some thousand triangles, where a connection takes
about 0.1 µs; only their ratios matter, and a factor of two in one of them changes the total by a few per cent.
"""

from __future__ import annotations

CELL, CELL_RAY = 2.0, 3.0
"""Cost of a surface element whose light is spread over its arrival times, and of one of its shadow rays in the
BVH."""
SAMPLE = 20.0
"""Cost of a path of `paths.py`, with all its ways of finding one."""
