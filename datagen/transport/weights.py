"""Throughput of a path of three bounces for each area at its hidden point.

With x the laser point, y the hidden point and z a point of the pixel (docs/physics.md) the *weight* is

    w(y) = f₁ cosθ₁ cosθ₂ / R₁²  ·  f₂  ·  cosθ₂′ cosθ₃ / (R₂² + a/π)  ·  f₃,     arriving at (R₁ + R₂)/c,

with a the area that z stands for, which keeps the light of near surfaces finite where z is the middle of a patch, and
0 where z is a point drawn from it; and with the transmittance of air on both legs, exp(−κ (R₁ + R₂)).
"""

from __future__ import annotations

import math
from typing import NamedTuple

from datagen.compiled import compiled
from datagen.transport.brdf import LAMBERTIAN, Vector, dot, evaluate
from datagen.transport.geometry import subtract, transmittance


class Brdf(NamedTuple):
    """The BRDF of a part: its kind and albedo, and the row of its other numbers in a table of materials.

    Without arrays, as numba counts references to each one that a record holds.
    """

    kind: int
    albedo: float
    row: int


class End(NamedTuple):
    """A laser point or FoV point: place, metres, unit normal, unit direction to the device, and BRDF there."""

    point: Vector
    normal: Vector
    back: Vector
    brdf: Brdf


@compiled(forceinline=True, allocates=False)
def brdf_of(scene, k):  # type: ignore[no-untyped-def]
    """The BRDF of part k. scene : `SceneNumbers`."""
    return Brdf(scene.kind[k], scene.values[k, 0], k)


@compiled(forceinline=True, allocates=False)
def value_of(brdf, values, n, a, b):  # type: ignore[no-untyped-def]
    """The value of a BRDF for two directions above the surface, 1/sr. values : the table of materials."""
    return brdf.albedo / math.pi if brdf.kind == LAMBERTIAN else evaluate(brdf.kind, values[brdf.row], n, a, b)


@compiled(forceinline=True, allocates=False)
def weight(y, n, brdf, lit, seen, values, footprint, attenuation):  # type: ignore[no-untyped-def]
    """Weight w(y) without the laser's power and the sensor's factor W, 1/(m⁴ sr³); and distances R₁ and R₂, metres.

    y, n, brdf : point of the element, metres, its unit normal, and `Brdf`. lit, seen : laser point, and FoV point or
    middle of a footprint, each an `End`. values : of the table of materials. footprint : area, m². attenuation : of
    the air, 1/m.
    """
    d1, d3 = subtract(y, lit.point), subtract(y, seen.point)
    square1, square3 = dot(d1, d1), dot(d3, d3)
    r1, r3 = math.sqrt(square1), math.sqrt(square3)
    up1, up3 = dot(d1, lit.normal), dot(d3, seen.normal)
    in2, out2 = -dot(d1, n), -dot(d3, n)
    # One end faces away, or laser point and footprint lie on different sides of the element.
    if up1 <= 0.0 or up3 <= 0.0 or in2 * out2 <= 0.0:
        return 0.0, r1, r3
    # Surfaces scatter on both sides: the BRDF takes the normal of the lit side.
    if in2 < 0.0:
        n = (-n[0], -n[1], -n[2])
    per1, per3 = 1.0 / r1, 1.0 / r3
    w1, w3 = (d1[0] * per1, d1[1] * per1, d1[2] * per1), (d3[0] * per3, d3[1] * per3, d3[2] * per3)
    f1 = value_of(lit.brdf, values, lit.normal, lit.back, w1)
    f2 = value_of(brdf, values, n, (-w1[0], -w1[1], -w1[2]), (-w3[0], -w3[1], -w3[2]))
    f3 = value_of(seen.brdf, values, seen.normal, w3, seen.back)
    w = f1 * f2 * f3 * (up1 * up3) * (in2 * out2) / (square1 * square1 * square3 * (square3 + footprint / math.pi))
    return w * transmittance(attenuation, r1 + r3), r1, r3
