"""What the steps of a transport cost, in units of one connection with its shadow ray.

Decisions about samples rest on these constants and on counts alone, never on a clock, so that they are the same on
every machine. They were measured on one core in furnished rooms of some thousand triangles, where a connection takes
about 0.1 µs; only their ratios matter, and a factor of two in one of them changes the total by a few per cent.
"""

from __future__ import annotations

import math
from dataclasses import astuple, dataclass

RAY = 4.0
"""A vertex of a path, or a FoV point: its random numbers, ray and refined hit."""
BIN = 0.06
"""An entry of a histogram: cleared, summed, squared and added up, once for each replicate."""
CALL = 15_000.0
"""One call of the tracing code for a run of laser points, whatever their number."""
ORDER_CALL = 0.2
"""A call's share that each bounce order beyond the first adds."""
OBSERVED_RAY = 1.7
"""A ray from a hidden vertex to a second one, or a shadow ray from there to a laser point."""
CELL, CELL_RAY = 2.0, 3.0
"""A cell spread over its arrival times, and a ray of it in the hierarchy."""
CELL_PAIR, PAIR_RAY = 2.3, 2.0
"""A pair of cells, looked at, cut or spread over its arrival times, and the ray between two cells."""
SAMPLE = 20.0
"""A path of the reference, by all its ways of finding one."""
TERM, TERM_EACH = 0.001, 0.03
"""A bin of what arrives, multiplied with one path that leaves, and beginning with it."""
SPECTRUM, BUTTERFLY = 0.01, 0.0055
"""A product of two spectra and a step of a transform, for each bin of twice the window."""


@dataclass(frozen=True)
class Work:
    """What a piece of the transport did; entries and calls do not grow with the number of samples.

    Attributes
    ----------
    rays : followed, or FoV points drawn.
    connections : of a vertex with a FoV point.
    entries : of histograms cleared, squared and added up.
    calls : of the tracing code.
    bright : those of the connections that could carry energy, each of which sent a shadow ray where occlusion counts.
    """

    rays: float = 0.0
    connections: float = 0.0
    entries: float = 0.0
    calls: float = 1.0
    bright: float = 0.0

    def __add__(self, other: Work) -> Work:
        return Work(*(a + b for a, b in zip(astuple(self), astuple(other), strict=True)))

    @property
    def growing(self) -> float:
        """The cost that is proportional to the number of samples."""
        return RAY * self.rays + self.connections

    @property
    def standing(self) -> float:
        """The cost that each replicate has, whatever its number of samples."""
        return BIN * self.entries + CALL * self.calls

    @property
    def cost(self) -> float:
        """All of it, in connections with their shadow rays."""
        return self.growing + self.standing


def factorised_work(
    lookins: int, observed: int, lasers: int, pixels: int, fov_samples: int, bins: int, replicates: int
) -> Work:
    """The work of the factorised secondary: second hidden vertices shared by all lasers, their shadow rays, what
    leaves towards the pixels, the paths near the laser points, and the convolution in time."""
    rays = lookins * (1.0 + OBSERVED_RAY / RAY * observed * (1 + lasers) + 4.0 * lasers)
    direct = fov_samples * (TERM_EACH + TERM * bins)
    spectral = 2 * bins * (SPECTRUM + BUTTERFLY * math.log2(2 * bins) * (1 / lasers + 1 / pixels))
    convolutions = lookins * lasers * pixels * min(direct, spectral)
    return Work(rays, lookins * pixels * fov_samples + convolutions, 0.0, float(replicates))
