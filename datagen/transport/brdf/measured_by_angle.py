"""Reflectance by angle as measured (`records.MeasuredByAngle`).

Row: albedo, number of panels P, 1 / (g_max ḡ), g at the P + 1 nodes, whose cosines are 0, 1/P … 1, and for the panels
between them the running shares of the light that leaves in them.

    f = albedo / π · g(cosθ_in) g(cosθ_out) / (g_max ḡ),    ḡ = ∫ 2 c g(c) dc

g is the square root of the measured reflectance at the nodes, and linear between them. Of light at the incidence c
the share g(c) / g_max of the albedo leaves, at most all, and its exitance has the density 2 c g(c) / ḡ in the
cosine c.
"""

from __future__ import annotations

import math

import numpy as np

from datagen.compiled import compiled
from datagen.records.arrays import Floats
from datagen.records.materials import MeasuredByAngle
from datagen.transport.brdf.directions import Vector, around

FIRST_NODE = 3


def row(material: MeasuredByAngle) -> tuple[float, ...]:
    """The numbers of a material's row that follow the albedo."""
    g = _roots(material)
    panels = len(g) - 1
    c = np.linspace(0.0, 1.0, panels + 1)
    low, high, below, above = c[:-1], c[1:], g[:-1], g[1:]
    # ∫ 2 c g dc of each panel, in which g is linear.
    light = (high - low) / 3.0 * (below * (2.0 * low + high) + above * (low + 2.0 * high))
    shares = np.cumsum(light) / light.sum()
    return float(panels), 1.0 / float(light.sum()), *(float(v) for v in g), *(float(v) for v in shares)


def lobe_width_rad(material: MeasuredByAngle) -> float:
    """Infinite: there is no lobe."""
    return math.inf


def share(material: MeasuredByAngle, cosine: Floats, azimuth_rad: Floats) -> Floats:
    """Directional albedo of a material of albedo 1: g / g_max at the incidence."""
    g = _roots(material)
    return np.interp(cosine, np.linspace(0.0, 1.0, len(g)), g)


def _roots(material: MeasuredByAngle) -> Floats:
    """(P + 1,) g at the nodes, over its largest value."""
    g = np.sqrt(np.asarray(material.reflectance, np.float64) / max(material.reflectance))
    return np.asarray(g)


@compiled()
def _panel(values: Floats, cosine: float) -> int:
    """Number of the panel that holds a cosine."""
    return min(int(cosine * values[1]), int(values[1]) - 1)


@compiled()
def _root(values: Floats, cosine: float) -> float:
    """g / g_max at a cosine."""
    panel = _panel(values, cosine)
    within = cosine * values[1] - panel
    node = FIRST_NODE + panel
    return float(values[node] + within * (values[node + 1] - values[node]))


@compiled()
def evaluate(values: Floats, n: Vector, w_in: Vector, w_out: Vector, cos_in: float, cos_out: float) -> float:
    """The BRDF, 1/sr, of directions above the surface."""
    # A product of the same two numbers in either order, so that it is reciprocal to the last bit.
    return float(values[0] / math.pi * values[2] * (_root(values, cos_in) * _root(values, cos_out)))


@compiled()
def at_most(
    values: Floats, n: Vector, w_in: Vector, w_out: Vector, cos_in: float, cos_out: float, turn: float, tilt: float
) -> float:
    """`models.evaluate_at_most` for MeasuredByAngle, which has no lobe that could be missed."""
    return float(evaluate(values, n, w_in, w_out, cos_in, cos_out))


@compiled()
def widen(values: Floats, span: float) -> None:
    """`models.widen` for MeasuredByAngle: nothing to widen."""


@compiled()
def _first_share(values: Floats) -> int:
    """Where the running shares of the panels begin in a row."""
    return FIRST_NODE + int(values[1]) + 1


@compiled()
def pdf(values: Floats, n: Vector, w_in: Vector, w_out: Vector, cos_in: float, cos_out: float) -> float:
    """Density per solid angle of what `sample` draws, 1/sr: within a panel that of Lambert's law."""
    panel, first = _panel(values, cos_out), _first_share(values)
    below = values[first + panel - 1] if panel > 0 else 0.0
    # The share of a panel of Lambert's law is the difference of the squared cosines of its ends.
    lambertian = (2.0 * panel + 1.0) / (values[1] * values[1])
    return float((values[first + panel] - below) / lambertian * cos_out / math.pi)


@compiled()
def sample(values: Floats, n: Vector, w_in: Vector, cos_in: float, u: float, v: float) -> Vector:
    """A direction drawn with density `pdf` from (u, v) in the unit square."""
    panels, first = int(values[1]), _first_share(values)
    panel, below = 0, 0.0
    # The last panel with light takes what rounding leaves over.
    while panel < panels - 1 and u >= values[first + panel]:
        below = values[first + panel]
        panel += 1
    share = values[first + panel] - below
    within = min((u - below) / share, 1.0) if share > 0.0 else 0.5
    square = (panel * panel + within * (2.0 * panel + 1.0)) / (panels * panels)
    return around(n, 1.0 - math.sqrt(min(square, 1.0)), v)
