"""What an element gives to one laser point and pixel, how wrong that may be, and how much it is at most.

Flux per hidden area at y, with x the laser point and z the middle of a footprint of the pixel (docs/physics.md):

    w(y) = f₁ cosθ₁ cosθ₂ / R₁²  ·  f₂  ·  cosθ₂′ cosθ₃ / (R₂² + a/π)  ·  f₃ W,     arriving at (R₁ + R₂)/c,

a the footprint's area, which bounds what a near element can give it, and W the sensor's share. What air leaves of it,
exp(−κ (R₁ + R₂)), is put to each point's w: in dense fog nothing else tells a near element from a far one.
"""

from __future__ import annotations

import math

import numpy as np

from datagen.compiled import compiled
from datagen.transport.brdf import dot, evaluate, evaluate_at_most
from datagen.transport.geometry import air, distance, less
from datagen.transport.quadrature.clusters import UNLIKE

SMEARED = 0.3
"""Of a footprint, the share that its arrival times spread over."""
BLURRED = 0.25
"""Of the error that an element may make, the share that may come of the footprint that sees it, as it does for many
alike."""
AT_ONCE = 0.01
"""Size of a footprint, in bins, up to which all of it is reached at once."""
OUTSIDE = 0.01
"""Error of an element whose light comes outside the window, relative to it, that it may always make: no bin has it,
and when exactly it comes does not matter."""


@compiled()
def weight(y, n, kind2, values2, lit_from, seen_from, footprint, attenuation):  # type: ignore[no-untyped-def]
    """w(y) but for power and sensor, and R₁ and R₂; `lit_from` and `seen_from` are the other two vertices of the
    path: a point, its normal, the direction on to the device, and the BRDF's kind and values."""
    x, n1, to_laser, kind1, values1 = lit_from
    z, n3, to_sensor, kind3, values3 = seen_from
    d1, d3 = less(y, x), less(y, z)
    square1, square3 = dot(d1, d1), dot(d3, d3)
    r1, r3 = math.sqrt(square1), math.sqrt(square3)
    up1, up3 = dot(d1, n1), dot(d3, n3)
    in2, out2 = -dot(d1, n), -dot(d3, n)
    if up1 <= 0.0 or up3 <= 0.0 or in2 * out2 <= 0.0:
        return 0.0, r1, r3
    if in2 < 0.0:
        n = (-n[0], -n[1], -n[2])
    per1, per3 = 1.0 / r1, 1.0 / r3
    w1, w3 = (d1[0] * per1, d1[1] * per1, d1[2] * per1), (d3[0] * per3, d3[1] * per3, d3[2] * per3)
    f1 = evaluate(kind1, values1, n1, to_laser, w1)
    f2 = evaluate(kind2, values2, n, (-w1[0], -w1[1], -w1[2]), (-w3[0], -w3[1], -w3[2]))
    f3 = evaluate(kind3, values3, n3, w3, to_sensor)
    w = f1 * f2 * f3 * (up1 * up3) * (in2 * out2) / (square1 * square1 * square3 * (square3 + footprint / math.pi))
    return w * air(attenuation, r1 + r3), r1, r3


@compiled()
def weight_at_most(  # type: ignore[no-untyped-def]
    y, n, kind2, values2, lit_from, seen_from, footprint, attenuation, h, size, tilt
):  # fmt: skip
    """The largest w that the BRDFs allow within an element about y that is h long, seen from a footprint of some
    size.

    Lobes that none of the element's points meets may still cross it: the directions to its ends turn by h/R₁ and
    (h + size)/R₂ over it, and its normals deviate from n by up to `tilt`, rad. All else of w is that of y.
    """
    x, n1, to_laser, kind1, values1 = lit_from
    z, n3, to_sensor, kind3, values3 = seen_from
    d1, d3 = less(y, x), less(y, z)
    square1, square3 = dot(d1, d1), dot(d3, d3)
    r1, r3 = math.sqrt(square1), math.sqrt(square3)
    up1, up3 = dot(d1, n1), dot(d3, n3)
    in2, out2 = -dot(d1, n), -dot(d3, n)
    if up1 <= 0.0 or up3 <= 0.0 or in2 * out2 <= 0.0:
        return 0.0
    if in2 < 0.0:
        n = (-n[0], -n[1], -n[2])
    per1, per3 = 1.0 / r1, 1.0 / r3
    w1, w3 = (d1[0] * per1, d1[1] * per1, d1[2] * per1), (d3[0] * per3, d3[1] * per3, d3[2] * per3)
    turn1, turn3 = h * per1, (h + size) * per3
    f1 = evaluate_at_most(kind1, values1, n1, to_laser, w1, turn1, 0.0)
    f2 = evaluate_at_most(
        kind2, values2, n, (-w1[0], -w1[1], -w1[2]), (-w3[0], -w3[1], -w3[2]), turn1 + turn3, tilt
    )  # fmt: skip
    f3 = evaluate_at_most(kind3, values3, n3, w3, to_sensor, turn3, 0.0)
    w = f1 * f2 * f3 * (up1 * up3) * (in2 * out2) / (square1 * square1 * square3 * (square3 + footprint / math.pi))
    return w * air(attenuation, r1 + r3)


@compiled()
def outside(paths, middle, legs, size, opens, closes):  # type: ignore[no-untyped-def]
    """Whether all of an element's light comes before a window or after it.

    paths, middle : m by way of its vertices and its middle. legs : to the device, m. size : of the footprint, m.
    opens, closes : the window, m of path.

    Paths are convex: within the triangle none is longer than by way of a vertex, or shorter than three times that of
    the middle less twice that.
    """
    most = max(paths[0], paths[1], paths[2])
    return (most + legs + 2.0 * size < opens) | (3.0 * middle - 2.0 * most + legs - 2.0 * size > closes)


@compiled()
def verdict(paths, light, lengths, view, limits, air_and_bins, unseen):  # type: ignore[no-untyped-def]
    """What becomes of an element, seen from a footprint.

    paths : m by way of its vertices. light : its area, and its largest `weight`. lengths : its longest side, R₁ and
        R₂ by way of its middle, m. view : photons per unit of weight and area, and area, size and whether there are
        quarters of the footprint.
    limits : largest element, relative to its distance; 1/width² of the narrowest lobe on the path, 1 if all its
        surfaces are matt; and the L2 error that it may make. What a lobe makes of an element is never more wrong than
        all its light.
    air_and_bins : bins per m of path, and attenuation, 1/m. unseen : whether it is `outside` the window.

    Returns whether it is cut; whether the footprint is quartered first; the L2 error if its light should be missing
    (infinite where that was not asked); and how far its arrival times are bent.
    """
    (at_a, at_b, at_c), (area, w), (h, r1, r3) = paths, light, lengths
    (gain, footprint, size, quarters), (limit, keen, allowed) = view, limits
    per_metre, attenuation = air_and_bins
    # What the footprint itself cannot tell apart needs no cutting. All is worked out before it is asked, so that
    # loops over many elements need no branches.
    per_metre = 0.0 if unseen else per_metre
    ratio1, ratio3, ratio_z = h / r1, h / math.sqrt(r3 * r3 + footprint / math.pi), size / r3
    patch_first = (ratio_z > limit) & quarters & (size > 0.5 * h)
    near = (not patch_first) & (max(ratio1, ratio3) > limit)
    bend = (at_a + at_b + at_c) / 3 - (r1 + r3)
    longer = max(at_a, at_b, at_c) - min(at_a, at_b, at_c)
    width, haze = max(1.0, longer * per_metre), attenuation * longer
    over = gain * area * w / math.sqrt(width)
    allowed = max(allowed, OUTSIDE * over) if unseen else allowed
    across = ratio1 * ratio1 + ratio3 * ratio3 + haze * haze
    curved = min(keen * across, max(across, 1.0)) + bend * per_metre / width
    blurred = SMEARED * size * per_metre / width
    seen_across = ratio_z * ratio_z
    smeared = min(keen * seen_across, max(seen_across, 1.0)) + min(blurred * blurred * (blurred * blurred), UNLIKE)
    asked = not (patch_first | near)
    quarter = patch_first | (asked & quarters & (over * smeared > BLURRED * allowed))
    cut = near | (asked & (not quarter) & (over * curved > allowed))
    return cut, quarter, over if asked else np.inf, bend


@compiled()
def smear(d3, to_sensor, device, across, p, q):  # type: ignore[no-untyped-def]
    """`smeared` by footprint q of row p, whose direction to the sensor counts if `device`."""
    towards = to_sensor if device else (0.0, 0.0, 0.0)
    sides = (across[p, q, 0, 0], across[p, q, 0, 1], across[p, q, 0, 2])
    others = (across[p, q, 1, 0], across[p, q, 1, 1], across[p, q, 1, 2])
    return smeared(d3, math.sqrt(dot(d3, d3)), towards, sides, others)


@compiled()
def smeared(d3, r3, to_sensor, side, other):  # type: ignore[no-untyped-def]
    """Variance of the path by way of a footprint, from one side of it to the other, m²; d3 from it to the element, R₃
    long, and what the direction to the sensor adds."""
    per = 1.0 / r3
    g = (d3[0] * per + to_sensor[0], d3[1] * per + to_sensor[1], d3[2] * per + to_sensor[2])
    one, two = dot(g, side), dot(g, other)
    return one * one / 12 + two * two / 12


@compiled()
def brightest(m, radius, area, rise, height, x, z, size, attenuation):  # type: ignore[no-untyped-def]
    """What a box or element about m may bring at most for every photon, BRDF and solid angle of one, if x lights it
    and something within `size` of z is seen by it; `rise` it has above the plane of x, `height` x above its own."""
    far1, far3 = max(distance(m, x) - radius, 0.0), max(distance(m, z) - radius - size, 0.0)
    near1, near3 = max(far1, math.sqrt(area / (2 * math.pi))), max(far3, 0.25 * size)
    area *= air(attenuation, far1 + far3)
    return area * min(1.0, rise / near1) * min(1.0, height / near1) / (near1 * near3) ** 2
