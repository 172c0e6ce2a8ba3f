"""What the steps of a transport cost, in units of one connection with its shadow ray.

Decisions about samples rest on these constants and on counts alone, never on a clock, so that they are the same on
every machine. They were measured on one core in furnished rooms of some thousand triangles, where a connection takes
about 0.1 µs; only their ratios matter, and a factor of two in one of them changes the total by a few per cent.
"""

from __future__ import annotations

import math
from dataclasses import astuple, dataclass

RAY = 4.0
"""Cost of a vertex of a path, or of a FoV point: its random numbers, its ray and the hit refined in double
precision."""
BIN = 0.06
"""Cost of an entry of a histogram: cleared, summed, squared and added up, once for each replicate."""
CALL = 15_000.0
"""Cost of one call of the tracing code for a run of laser points, whatever their number."""
ORDER_CALL = 0.2
"""Cost that each bounce order beyond the first adds to a call, relative to `CALL`."""
OBSERVED_RAY = 1.7
"""Cost of a ray from a hidden vertex to a second one, or of a shadow ray from there to a laser point."""
CELL, CELL_RAY = 2.0, 3.0
"""Cost of a surface element whose light is spread over its arrival times, and of one of its shadow rays in the
BVH."""
CELL_PAIR, PAIR_RAY = 2.3, 2.0
"""Cost of a pair of elements that is looked at (then halved, or its light spread over its arrival times), and of the
shadow ray between two elements."""
SAMPLE = 20.0
"""Cost of a path of `paths.py`, with all its ways of finding one."""
TERM, TERM_EACH = 0.001, 0.03
"""Cost of the factorised form's direct sum: a bin of the arriving light times one path that leaves, and the start of
each such product."""
SPECTRUM, BUTTERFLY = 0.01, 0.0055
"""Cost of the factorised form's convolution by Fourier transforms, for each bin of twice the window: a product of two
spectra, and one of the log₂ steps of a transform."""


@dataclass(frozen=True)
class Work:
    """Numbers of the steps that a piece of the transport took; entries and calls do not grow with the samples.

    Attributes
    ----------
    rays : rays followed and FoV points drawn.
    connections : connections of a vertex with a FoV point.
    entries : entries of histograms that were cleared, squared and added up.
    calls : calls of the tracing code.
    bright : connections that could carry energy; each sent a shadow ray where occlusion counts.
    """

    rays: float = 0.0
    connections: float = 0.0
    entries: float = 0.0
    calls: float = 1.0
    bright: float = 0.0

    def __add__(self, other: Work) -> Work:
        return Work(*(a + b for a, b in zip(astuple(self), astuple(other), strict=True)))

    @property
    def marginal_cost(self) -> float:
        """The part of the cost that is proportional to the number of samples."""
        return RAY * self.rays + self.connections

    @property
    def fixed_cost(self) -> float:
        """The part of the cost that does not depend on the number of samples of each replicate."""
        return BIN * self.entries + CALL * self.calls

    @property
    def cost(self) -> float:
        """The whole cost, in units of one connection with its shadow ray."""
        return self.marginal_cost + self.fixed_cost


def factorised_work(
    lookins: int, observed: int, lasers: int, pixels: int, fov_samples: int, bins: int, replicates: int
) -> Work:
    """Work that the factorised secondary takes: second hidden vertices that all laser points share, their shadow
    rays, the half paths towards the pixels, the half paths near the laser points, and the convolution in time.

    lookins, observed : hidden vertices, and second hidden vertices for each of them.
    """
    rays = lookins * (1.0 + OBSERVED_RAY / RAY * observed * (1 + lasers) + 4.0 * lasers)
    direct = fov_samples * (TERM_EACH + TERM * bins)
    spectral = 2 * bins * (SPECTRUM + BUTTERFLY * math.log2(2 * bins) * (1 / lasers + 1 / pixels))
    convolutions = lookins * lasers * pixels * min(direct, spectral)
    return Work(rays, lookins * pixels * fov_samples + convolutions, 0.0, float(replicates))
