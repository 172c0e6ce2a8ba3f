"""Throughput of a path of three bounces for each area at its hidden point.

With x the laser point, y the hidden point and z a point of the pixel (docs/physics.md) the *weight* is

    w(y) = f₁ cosθ₁ cosθ₂ / R₁²  ·  f₂  ·  cosθ₂′ cosθ₃ / (R₂² + a/π)  ·  f₃,     arriving at (R₁ + R₂)/c,

with a the area that z stands for, which keeps the light of near surfaces finite where z is the middle of a patch, and
0 where z is a point drawn from it; and with the transmittance of air on both legs, exp(−κ (R₁ + R₂)).
"""

from __future__ import annotations

import math

from datagen.compiled import compiled
from datagen.transport.brdf import dot, evaluate
from datagen.transport.geometry import subtract, transmittance


@compiled(forceinline=True, fastmath={"reassoc", "contract", "arcp", "nsz"})
def weight(y, n, kind2, values2, lit_from, seen_from, footprint, attenuation):  # type: ignore[no-untyped-def]
    """Weight w(y) without the laser's power and the sensor's factor W, 1/(m⁴ sr³); and distances R₁ and R₂, metres.

    y, n : point of the element, metres, and its unit normal. kind2, values2 : its BRDF. footprint : area, m².
    lit_from, seen_from : the other two vertices of the path, laser point and footprint: position, normal, direction
    to the device, and kind and values of the BRDF. attenuation : of the air, 1/m.
    """
    x, n1, to_laser, kind1, values1 = lit_from
    z, n3, to_sensor, kind3, values3 = seen_from
    d1, d3 = subtract(y, x), subtract(y, z)
    square1, square3 = dot(d1, d1), dot(d3, d3)
    r1, r3 = math.sqrt(square1), math.sqrt(square3)
    up1, up3 = dot(d1, n1), dot(d3, n3)
    in2, out2 = -dot(d1, n), -dot(d3, n)
    # One end faces away, or laser point and footprint lie on different sides of the element.
    if up1 <= 0.0 or up3 <= 0.0 or in2 * out2 <= 0.0:
        return 0.0, r1, r3
    # Surfaces scatter on both sides: the BRDF takes the normal of the lit side.
    if in2 < 0.0:
        n = (-n[0], -n[1], -n[2])
    per1, per3 = 1.0 / r1, 1.0 / r3
    w1, w3 = (d1[0] * per1, d1[1] * per1, d1[2] * per1), (d3[0] * per3, d3[1] * per3, d3[2] * per3)
    f1 = evaluate(kind1, values1, n1, to_laser, w1)
    f2 = evaluate(kind2, values2, n, (-w1[0], -w1[1], -w1[2]), (-w3[0], -w3[1], -w3[2]))
    f3 = evaluate(kind3, values3, n3, w3, to_sensor)
    w = f1 * f2 * f3 * (up1 * up3) * (in2 * out2) / (square1 * square1 * square3 * (square3 + footprint / math.pi))
    return w * transmittance(attenuation, r1 + r3), r1, r3
