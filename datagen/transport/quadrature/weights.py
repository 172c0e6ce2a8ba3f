"""Throughput of a surface element for one laser point and pixel, an estimate of its error, and upper bounds.

The *weight* w is the flux per hidden area at y, with x the laser point and z the middle of a footprint of the pixel
(docs/physics.md):

    w(y) = f₁ cosθ₁ cosθ₂ / R₁²  ·  f₂  ·  cosθ₂′ cosθ₃ / (R₂² + a/π)  ·  f₃ W,     arriving at (R₁ + R₂)/c,

with a the footprint's area, which keeps the light of a near element finite, and W the sensor's factor, its effective
aperture times the solid angle of the footprint. Each weight has the transmittance of air in it, exp(−κ (R₁ + R₂)),
because in dense fog it makes near elements brighter than far ones.
"""

from __future__ import annotations

import math

import numpy as np

from datagen.compiled import compiled
from datagen.transport.brdf import dot, evaluate, evaluate_at_most
from datagen.transport.geometry import distance, subtract, transmittance
from datagen.transport.quadrature.clusters import COARSEST

BLURRED = 0.25
"""Fraction of the error that an element may make that the size of its footprint may cause; less than half, because
this error is alike for many elements. Half of it quarters more footprints; without any limit, errors of large pixels
near steps of the signal stay at 1.6 %."""
AT_ONCE = 0.01
"""Size of a footprint, in bins, up to which its light is taken to arrive at one time. Half of it only takes time."""
OUTSIDE = 0.01
"""Error, relative to its light, that an element outside the window of time may always make: no bin holds this light,
so that only its energy matters. Half of it only takes time."""


@compiled()
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


@compiled()
def weight_at_most(  # type: ignore[no-untyped-def]
    y, n, kind2, values2, lit_from, seen_from, footprint, attenuation, h, size, tilt
):  # fmt: skip
    """Upper bound of the weight over an element around y, as far as BRDFs change over it; the other factors of the
    weight are taken at y.

    h : length of the element's longest side, metres. size : of the footprint, metres. tilt : angle by which normals
    of the element deviate from n, rad. The other arguments are those of `weight`.

    A lobe may cross an element between the points where its weight is known. Over the element, the directions to
    laser point and footprint turn by up to h/R₁ and (h + size)/R₂.
    """
    x, n1, to_laser, kind1, values1 = lit_from
    z, n3, to_sensor, kind3, values3 = seen_from
    d1, d3 = subtract(y, x), subtract(y, z)
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
    return w * transmittance(attenuation, r1 + r3)


@compiled()
def outside(paths, middle, legs, size, opens, closes):  # type: ignore[no-untyped-def]
    """Whether all of an element's light arrives before or after the window of time.

    paths, middle : lengths of the paths by way of the element's three vertices and by way of its middle, metres.
    legs : length of the legs from the laser and to the sensor, metres. size : of the footprint, metres.
    opens, closes : shortest and longest path within the window, metres.

    The path is a convex function of the place on the element: it is nowhere longer than at a vertex, and nowhere
    shorter than three times the path at the middle minus twice the path at the farthest vertex.
    """
    most = max(paths[0], paths[1], paths[2])
    return (most + legs + 2.0 * size < opens) | (3.0 * middle - 2.0 * most + legs - 2.0 * size > closes)


@compiled()
def verdict(paths, light, lengths, view, limits, air_and_bins, unseen):  # type: ignore[no-untyped-def]
    """Whether an element is halved, or its footprint quartered, before its light is added to the histogram.

    paths : lengths of the paths by way of the element's three vertices, metres.
    light : the element's area, m², and its largest weight.
    lengths : the element's longest side, and R₁ and R₂ at its middle, metres.
    view : photons per unit of weight and area; and the footprint's area, m², size, metres, and whether it has
    quarters.
    limits : 1/width² of the narrowest lobe on the path, 1 if all surfaces are matt; and the L2 error that the element
        may make, photons.
    air_and_bins : bins per metre of path, and attenuation of the air, 1/m.
    unseen : whether the element's light arrives `outside` the window.

    Returns whether the element is halved; whether the footprint is quartered first; the L2 norm of the element's
    light, photons (infinite where the element is too near to be judged); and how much longer the mean of the paths by
    way of its vertices is than the path by way of its middle, metres.
    """
    (at_a, at_b, at_c), (area, w), (h, r1, r3) = paths, light, lengths
    (gain, footprint, size, quarters), (sharpest, allowed) = view, limits
    per_metre, attenuation = air_and_bins
    # All conditions are computed and then combined, without branches, so that compilers make vector instructions of
    # loops over many elements. Outside the window times do not matter.
    per_metre = 0.0 if unseen else per_metre
    ratio1, ratio3, ratio_z = h / r1, h / math.sqrt(r3 * r3 + footprint / math.pi), size / r3
    patch_first = (ratio_z > COARSEST) & quarters & (size > 0.5 * h)
    near = (not patch_first) & (max(ratio1, ratio3) > COARSEST)
    # Light that arrives over several bins has an L2 norm that is smaller by the root of their number.
    bend = (at_a + at_b + at_c) / 3 - (r1 + r3)
    longer = max(at_a, at_b, at_c) - min(at_a, at_b, at_c)
    width, haze = max(1.0, longer * per_metre), attenuation * longer
    norm = gain * area * w / math.sqrt(width)
    allowed = max(allowed, OUTSIDE * norm) if unseen else allowed
    # The weight is of second degree up to terms of the angles squared, by which the element is seen; where a lobe is
    # narrow, of the angles relative to its width. An error by a lobe is at most all the light.
    across = ratio1 * ratio1 + ratio3 * ratio3 + haze * haze
    curved = min(sharpest * across, max(across, 1.0)) + bend * per_metre / width
    # Over a footprint the path has a standard deviation of 1/√12, about 0.3, of the footprint's size. Arrival times
    # of which only mean and variance are known err by at most a twentieth of the light.
    blur = 0.3 * size * per_metre / width
    seen_across = ratio_z * ratio_z
    blurred = min(sharpest * seen_across, max(seen_across, 1.0)) + min(blur * blur * (blur * blur), 0.05)
    judged = not (patch_first | near)
    quarter = patch_first | (judged & quarters & (norm * blurred > BLURRED * allowed))
    cut = near | (judged & (not quarter) & (norm * curved > allowed))
    return cut, quarter, norm if judged else np.inf, bend


@compiled()
def footprint_variance(d3, to_sensor, device, across, p, q):  # type: ignore[no-untyped-def]
    """Variance of the path over footprint q of row p, m².

    d3 : vector from the footprint to the element, metres. to_sensor : unit direction to the sensor. device : whether
    the leg to the sensor counts. across : (P, Q, 2, 3) sides of the footprints, metres.
    """
    one, two = path_changes(d3, to_sensor, device, across, p, q)
    return one * one / 12 + two * two / 12


@compiled()
def path_changes(d3, to_sensor, device, across, p, q):  # type: ignore[no-untyped-def]
    """Change of the path along the two sides of footprint q of row p, metres; arguments: `footprint_variance`."""
    towards = to_sensor if device else (0.0, 0.0, 0.0)
    sides = (across[p, q, 0, 0], across[p, q, 0, 1], across[p, q, 0, 2])
    others = (across[p, q, 1, 0], across[p, q, 1, 1], across[p, q, 1, 2])
    return _changes(d3, math.sqrt(dot(d3, d3)), towards, sides, others)


@compiled()
def path_variance(d3, r3, to_sensor, side, other):  # type: ignore[no-untyped-def]
    """Variance of the path over a footprint, m², if the path changes linearly over it.

    d3, r3 : vector from the footprint to the element, and its length, metres. to_sensor : unit direction to the
    sensor, zeros if that leg does not count. side, other : sides of the footprint, metres.
    """
    one, two = _changes(d3, r3, to_sensor, side, other)
    return one * one / 12 + two * two / 12


@compiled()
def _changes(d3, r3, to_sensor, side, other):  # type: ignore[no-untyped-def]
    """Change of the path along two sides of a footprint, metres; arguments as of `path_variance`."""
    per = 1.0 / r3
    g = (d3[0] * per + to_sensor[0], d3[1] * per + to_sensor[1], d3[2] * per + to_sensor[2])
    return dot(g, side), dot(g, other)


@compiled()
def light_at_most(m, radius, area, rise, height, x, z, size, attenuation):  # type: ignore[no-untyped-def]
    """Upper bound of the light of a box or element, lit from x and seen from any point within `size` of z: per photon
    at x, for BRDFs of 1/sr and a sensor's factor W of one.

    m, radius : bounding sphere of the box or element, metres. area : of its surface, m². rise : height of the box
    above the surface at x, metres. height : of x above the element's plane, metres, infinite for a box.
    """
    # A surface of some area cannot all be near: its light is at most that of a half sphere of the same area around x.
    far1, far3 = max(distance(m, x) - radius, 0.0), max(distance(m, z) - radius - size, 0.0)
    near1, near3 = max(far1, math.sqrt(area / (2 * math.pi))), max(far3, 0.25 * size)
    area *= transmittance(attenuation, far1 + far3)
    return area * min(1.0, rise / near1) * min(1.0, height / near1) / (near1 * near3) ** 2
