"""Mirror facets with the GGX distribution (`records.GGX`).

Row: albedo, α, f0, Ē, E at `NODES` angles of incidence, and for `PANELS` panels between them the running shares of
the light of multiple scattering that leaves in them.

With S(c) = √(α² + (1 − α²) c²) the Smith terms need no division by a cosine (Heitz, JCGT 3(2) (2014)):

    G₂ / (4 cosθ_in cosθ_out) = 1 / (2 (cosθ_out S(cosθ_in) + cosθ_in S(cosθ_out)))
    G₁ / cosθ = 2 / (cosθ + S(cosθ))

`sample` draws facets in proportion to their visible area (Heitz, JCGT 7(4) (2018)). The light that single scattering
loses is added by the separable term of Kulla & Conty (SIGGRAPH 2017 course), (1 − E(θ_in)) (1 − E(θ_out)) /
(π (1 − Ē)), with a table of the directional albedo E of white facets. `sample` draws its directions from this table,
too, as on a smooth surface they are grazing.
"""

from __future__ import annotations

import math
from functools import lru_cache

import numpy as np

from datagen.compiled import compiled
from datagen.records.arrays import Floats
from datagen.records.materials import GGX
from datagen.transport.brdf.directions import Vector, around, dot, in_frame_of, unit_gauss

PANELS = 32
"""Panels of the table, with a parabola in each; half as many make interpolation about eight times less precise."""
NODES = 2 * PANELS + 1
FIRST_NODE = 4
FIRST_SHARE = FIRST_NODE + NODES
MARGIN = 1e-4
"""Added to the tabulated E, more than interpolation can miss, so that the albedo never exceeds 1."""

HALF_WIDTH = 1.3
"""Half width at half maximum of the lobe at normal incidence, rad, over α."""


def row(material: GGX) -> tuple[float, ...]:
    """The numbers of a material's row that follow the albedo."""
    alpha = float(material.roughness) ** 2
    return alpha, material.f0, *white_table(alpha)


def lobe_width_rad(material: GGX) -> float:
    """Half width at half maximum of the lobe at normal incidence."""
    return HALF_WIDTH * float(material.roughness) ** 2


def share(material: GGX, cosine: Floats, azimuth_rad: Floats) -> Floats:
    """Directional albedo of a material of albedo 1: single scattering by quadrature, multiple scattering from its
    table."""
    values = np.array([1.0, *row(material)])
    gauss = unit_gauss(64)
    single = [single_albedo(values[1], values[2], c, gauss) for c in cosine.ravel()]
    lost = np.array([1 - albedo_in_table(values, c) for c in cosine.ravel()])
    return np.asarray((single + multiple_share(values[2], values[3]) * lost).reshape(cosine.shape))


@compiled()
def widen(values: Floats, span: float) -> None:
    """`models.widen` for GGX: rougher facets."""
    values[1] = min(max(values[1], 0.5 * span), 1.0)


@compiled()
def _smith_root(alpha: float, cosine: float) -> float:
    """S(c) of the module's docstring."""
    return math.sqrt(alpha * alpha + (1.0 - alpha * alpha) * cosine * cosine)


@compiled()
def _schlick(f0: float, cosine: float) -> float:
    """Schlick's approximation to Fresnel reflectance; `cosine` is that between light and facet normal."""
    away = 1.0 - min(max(cosine, 0.0), 1.0)
    return f0 + (1.0 - f0) * away * away * away * away * away


@compiled()
def _visible_facet(alpha: float, w: Vector, u: float, v: float) -> Vector:
    """Facet normal drawn in proportion to its area seen from `w`; both in the surface's frame, w[2] ≥ 0."""
    # Stretched to α = 1, the facets are those of a hemisphere, whose projection along `w` is easily drawn from.
    stretched = (alpha * w[0], alpha * w[1], w[2])
    length = math.sqrt(dot(stretched, stretched))
    h = (stretched[0] / length, stretched[1] / length, stretched[2] / length)
    across = math.sqrt(h[0] * h[0] + h[1] * h[1])
    t = (-h[1] / across, h[0] / across, 0.0) if across > 0.0 else (1.0, 0.0, 0.0)
    b = (h[1] * t[2] - h[2] * t[1], h[2] * t[0] - h[0] * t[2], h[0] * t[1] - h[1] * t[0])
    # A point uniform on the disk, squeezed to the visible part of the hemisphere's projection.
    radius, angle = math.sqrt(u), 2.0 * math.pi * v
    p, q = radius * math.cos(angle), radius * math.sin(angle)
    lit = 0.5 * (1.0 + h[2])
    q = (1.0 - lit) * math.sqrt(max(1.0 - p * p, 0.0)) + lit * q
    # Back onto the hemisphere, and from the hemisphere to the facets.
    r = math.sqrt(max(1.0 - p * p - q * q, 0.0))
    x, y = alpha * (p * t[0] + q * b[0] + r * h[0]), alpha * (p * t[1] + q * b[1] + r * h[1])
    z = max(p * t[2] + q * b[2] + r * h[2], 1e-30)
    length = math.sqrt(x * x + y * y + z * z)
    return (x / length, y / length, z / length)


@compiled()
def _facet_and_density(
    alpha: float, w_in: Vector, w_out: Vector, cos_in: float, cos_out: float
) -> tuple[float, float]:
    """Cosine between the light and the normal of the facet that mirrors it, and the density D of these facets."""
    h = (w_in[0] + w_out[0], w_in[1] + w_out[1], w_in[2] + w_out[2])
    length = math.sqrt(dot(h, h))
    if length == 0.0:
        return 0.0, 0.0
    # The half vector makes the same angle with both directions; half its length before scaling is the cosine, which
    # is the same to the last bit if the two directions change places.
    to_facet = 0.5 * length
    facet_cos = min((cos_in + cos_out) / length, 1.0)
    spread = facet_cos * facet_cos * (alpha * alpha - 1.0) + 1.0
    return to_facet, alpha * alpha / (math.pi * spread * spread)


@compiled()
def place(alpha: float, cosine: float) -> float:
    """Coordinate of the table, 0 … `PANELS`, for a cosine of incidence."""
    # It spreads the cosines below α, where E rises steeply from grazing incidence.
    return math.sqrt(min(cosine * (1.0 + alpha) / (cosine + alpha), 1.0)) * PANELS


@compiled()
def _cosine_at(alpha: float, place: float) -> float:
    """The cosine of incidence at a coordinate of the table, the inverse of `place`."""
    square = (place / PANELS) * (place / PANELS)
    return min(alpha * square / (1.0 + alpha - square), 1.0)


@compiled()
def albedo_in_table(values: Floats, cosine: float) -> float:
    """E at a cosine of incidence, interpolated by a parabola through the three nodes of each panel."""
    position = place(values[1], cosine)
    panel = min(int(position), PANELS - 1)
    t, node = position - panel, FIRST_NODE + 2 * panel
    middle = 4.0 * t * (1.0 - t) * values[node + 1]
    return float(
        min(values[node] * (1.0 - t) * (1.0 - 2.0 * t) + middle + values[node + 2] * t * (2.0 * t - 1.0), 1.0)
    )


@compiled()
def _multiple_pdf(values: Floats, cos_out: float) -> float:
    """Density of directions drawn for multiple scattering, 1/sr: within a panel uniform in the table's coordinate."""
    alpha = values[1]
    position = place(alpha, cos_out)
    panel = min(int(position), PANELS - 1)
    below = values[FIRST_SHARE + panel - 1] if panel > 0 else 0.0
    # From a density in the coordinate to one in the cosine c: with x = place / PANELS, dx/dc = α (1 + α) / (2 x (c +
    # α)²).
    slope = 0.5 * alpha * (1.0 + alpha) * PANELS * PANELS / (position * (cos_out + alpha) * (cos_out + alpha))
    return float((values[FIRST_SHARE + panel] - below) * slope / (2.0 * math.pi))


@compiled()
def _multiple_cosine(values: Floats, u: float) -> float:
    """Cosine of a direction of multiple scattering, drawn by a number u in 0 … 1."""
    panel, below = 0, 0.0
    while panel < PANELS - 1 and u >= values[FIRST_SHARE + panel]:
        below = values[FIRST_SHARE + panel]
        panel += 1
    share = values[FIRST_SHARE + panel] - below
    return _cosine_at(values[1], panel + (min((u - below) / share, 1.0) if share > 0.0 else 0.5))


@compiled()
def multiple_share(f0: float, mean: float) -> float:
    """Share of the light lost to single scattering that leaves after further reflections, 0 … 1.

    `mean` is Ē. At each reflection the mean Fresnel reflectance is kept and Ē of it leaves: a geometric series.
    """
    # The cosine-weighted mean of Schlick's approximation.
    fresnel = (1.0 + 20.0 * f0) / 21.0
    return fresnel * fresnel * mean / (1.0 - fresnel * (1.0 - mean))


@compiled()
def evaluate(values: Floats, n: Vector, w_in: Vector, w_out: Vector, cos_in: float, cos_out: float) -> float:
    """The BRDF, 1/sr, of directions above the surface."""
    to_facet, facets = _facet_and_density(values[1], w_in, w_out, cos_in, cos_out)
    return _of_facets(values, to_facet, facets, cos_in, cos_out)


@compiled()
def _of_facets(values: Floats, to_facet: float, facets: float, cos_in: float, cos_out: float) -> float:
    """The BRDF, 1/sr, where facets of density `facets` mirror the light at an angle whose cosine is `to_facet`."""
    alpha, f0, mean = values[1], values[2], values[3]
    masking = 0.5 / (cos_out * _smith_root(alpha, cos_in) + cos_in * _smith_root(alpha, cos_out))
    lost = (1.0 - albedo_in_table(values, cos_in)) * (1.0 - albedo_in_table(values, cos_out))
    multiple = multiple_share(f0, mean) * lost / (math.pi * (1.0 - mean)) if mean < 1.0 else 0.0
    return float(values[0] * (_schlick(f0, to_facet) * facets * masking + multiple))


@compiled()
def at_most(
    values: Floats, n: Vector, w_in: Vector, w_out: Vector, cos_in: float, cos_out: float, turn: float, tilt: float
) -> float:
    """`models.evaluate_at_most` for GGX."""
    # The half vector turns by at most `turn`, the sum of the two directions' turns, over the length of their sum.
    alpha = values[1]
    sum_length = math.sqrt(max(2.0 + 2.0 * dot(w_in, w_out), 1e-12))
    facet_angle = math.acos(min((cos_in + cos_out) / sum_length, 1.0)) - turn / sum_length - tilt
    facet_cos = math.cos(min(max(facet_angle, 0.0), 0.5 * math.pi))
    spread = facet_cos * facet_cos * (alpha * alpha - 1.0) + 1.0
    facets = alpha * alpha / (math.pi * spread * spread)
    return _of_facets(values, 0.5 * sum_length - 0.5 * turn, facets, cos_in, cos_out)


@compiled()
def _facet_share(values: Floats, cos_in: float) -> float:
    """Share of directions that `sample` draws by a facet; the others are directions of multiple scattering."""
    # In proportion to the light of each. The Fresnel factor of single scattering is only estimated: any share is
    # valid.
    f0, once = values[2], albedo_in_table(values, cos_in)
    single = max(_schlick(f0, cos_in), (1.0 + 20.0 * f0) / 21.0) * once
    return float(single / (single + multiple_share(f0, values[3]) * (1.0 - once)))


@compiled()
def pdf(values: Floats, n: Vector, w_in: Vector, w_out: Vector, cos_in: float, cos_out: float) -> float:
    """Density per solid angle of what `sample` draws, 1/sr."""
    alpha, share = values[1], _facet_share(values, cos_in)
    _, facets = _facet_and_density(alpha, w_in, w_out, cos_in, cos_out)
    single = 0.5 * facets / (cos_in + _smith_root(alpha, cos_in))
    return share * single + (1.0 - share) * _multiple_pdf(values, cos_out)


@compiled()
def sample(values: Floats, n: Vector, w_in: Vector, cos_in: float, u: float, v: float) -> Vector:
    """A direction drawn with density `pdf` from (u, v) in the unit square."""
    share = _facet_share(values, cos_in)
    if u >= share and share < 1.0:
        return around(n, 1.0 - _multiple_cosine(values, (u - share) / (1.0 - share)), v)
    # The azimuth of the surface's frame is arbitrary, as facets have no preferred azimuth.
    across, along = in_frame_of(n, 1.0, 0.0, 0.0), in_frame_of(n, 0.0, 1.0, 0.0)
    local = (dot(across, w_in), dot(along, w_in), cos_in)
    h = _visible_facet(values[1], local, u / share, v)
    twice = 2.0 * dot(local, h)
    return in_frame_of(n, twice * h[0] - local[0], twice * h[1] - local[1], twice * h[2] - local[2])


@compiled()
def single_albedo(alpha: float, f0: float, cos_in: float, gauss: Floats) -> float:
    """Directional albedo of single scattering, ∫ F D G₂ / (4 cosθ_in) dω_out.

    The integral runs over facets rather than directions. Facets of slope t = tanθ_h have the weight
    D cosθ_h dω = du dφ/(2π) with u = t²/(α² + t²). They send light above the surface at an interval of azimuths about
    that of the light: at all azimuths up to θ_h = (π/2 − θ_in)/2, at none from (π/2 + θ_in)/2 on. So the integrals
    over both pieces in between are smooth. gauss : (2, k) nodes in 0 … 1, and weights that sum to 1.
    """
    theta_in = math.acos(min(cos_in, 1.0))
    sin_in, root_in = math.sin(theta_in), _smith_root(alpha, cos_in)
    total, start = 0.0, 0.0
    for piece in range(2):
        end = math.atan(math.tan(0.5 * (0.5 * math.pi + (2 * piece - 1) * theta_in)) / alpha)
        if not end > start:
            continue
        for i in range(gauss.shape[1]):
            # u = sin²y. Easing moves nodes towards both ends of the piece, where the interval of azimuths opens like
            # a square root.
            z = gauss[0, i]
            y = start + (end - start) * z * z * (3.0 - 2.0 * z)
            weight = gauss[1, i] * (end - start) * 6.0 * z * (1.0 - z) * 2.0 * math.sin(y) * math.cos(y)
            slope = alpha * math.tan(y)
            cos_facet = 1.0 / math.sqrt(1.0 + slope * slope)
            sin_facet, opening = slope * cos_facet, math.pi
            # Only azimuths about the light's send it above the surface.
            if piece == 1:
                least = cos_in * (1.0 - 2.0 * cos_facet * cos_facet)
                opening = math.acos(min(max(least / (2.0 * cos_facet * sin_facet * sin_in), -1.0), 1.0))
            for k in range(gauss.shape[1]):
                to_facet = sin_in * sin_facet * math.cos(opening * gauss[0, k]) + cos_in * cos_facet
                cos_out = max(2.0 * to_facet * cos_facet - cos_in, 0.0)
                # Rounding at the end of the interval may leave nothing.
                if cos_out > 0.0:
                    masking = 2.0 * cos_out / (cos_out * root_in + cos_in * _smith_root(alpha, cos_out))
                    share = weight * gauss[1, k] * opening / (math.pi * cos_facet)
                    total += share * _schlick(f0, to_facet) * to_facet * masking
        start = end
    return total


@lru_cache(maxsize=256)
def white_table(alpha: float) -> tuple[float, ...]:
    """The numbers of a row from the fourth on: Ē, E at the nodes, and running shares of the light that E loses."""
    gauss = unit_gauss(32)
    places = np.linspace(0.0, PANELS, NODES)
    table = [single_albedo(alpha, 1.0, _cosine_at(alpha, p), gauss) + MARGIN for p in places]
    white = np.array([1.0, alpha, 1.0, 0.0, *table])
    # Ē = ∫ 2c E dc is taken of the interpolated E, so that both terms of the BRDF add up to albedo 1. Quadrature runs
    # panel by panel in the table's coordinate.
    x, weight = unit_gauss(8)
    within = (np.arange(PANELS)[:, None] + x) / PANELS
    cosines = alpha * within**2 / (1.0 + alpha - within**2)
    cells = 2.0 * cosines * weight * 2.0 * alpha * (1.0 + alpha) * within / (1.0 + alpha - within**2) ** 2 / PANELS
    lost = np.array([[1.0 - albedo_in_table(white, c) for c in panel] for panel in cosines]) * cells
    shares = np.cumsum(lost.sum(axis=1)) / lost.sum()
    return (1.0 - float(lost.sum()), *(float(v) for v in table), *(float(v) for v in shares))
