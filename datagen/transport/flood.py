"""Flood illumination: one wide beam as a sum over laser points.

A flood lights a whole field of view at once, so a pixel has one histogram: the mean over L laser points of the
transients that they would give if each got all of the light,

    transient(t) = (1/L) Σ_l transient_l(t),

which is a quadrature, with equal weights, of the integral over the lit patch of wall. If the laser points are the
middles of equal cells, its error is of second order in the size of a cell where the transient varies smoothly over
the patch, and of first order where it has steps (a zone that ends inside a cell, the edge of a shadow). With four
laser points in a zone 2 m away the first return is within 0.2 % of the integral (`tests/capture/test_flood.py` checks
the order).
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from datagen.records import Transient
from datagen.records.arrays import Floats


def flooded(transient: Transient) -> Transient:
    """The transient (1, P, T) of a flood, from the transient (L, P, T) of its laser points.

    `stderr` treats the errors of the laser points as independent. They are, except for the FoV points that the laser
    points share.
    """

    def mean(values: Floats) -> Floats:
        return np.asarray(values.mean(axis=0, keepdims=True))

    return replace(
        transient,
        components={name: mean(values) for name, values in transient.components.items()},
        parts={name: mean(values) for name, values in transient.parts.items()},
        stderr=np.sqrt(mean(transient.stderr**2) / len(transient.stderr)),
        overflow=mean(transient.overflow),
    )
