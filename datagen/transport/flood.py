"""Flood illumination: one wide beam as a sum over laser points.

A flood lights a whole field of view at once, so a pixel gets one histogram: the mean over the L laser points of what
each would give with all of the light,

    transient(t) = (1/L) Σ_l transient_l(t),

which is the quadrature, with equal weights, of the integral over the lit patch of wall. Midpoints of equal cells make
it exact to second order in the cells' size wherever the transient varies smoothly over the patch; steps (a zone that
ends inside a cell, a shadow's edge) cost first order. The first return of a zone, four points of which are lit 2 m
away, is within 0.2 % of its integral (`tests/capture/test_flood.py` holds the order).
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from datagen.records import Transient
from datagen.records.arrays import Floats


def flooded(transient: Transient) -> Transient:
    """The transient (1, P, T) of a flood from that (L, P, T) of its laser points.

    `stderr` takes the laser points' errors as independent, which they are but for the FoV points they share.
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
