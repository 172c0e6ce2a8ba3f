"""Faint boxes of small triangles: bounds on their light, and random points that stand for all of it."""

from __future__ import annotations

import math

import numpy as np

from datagen.compiled import compiled
from datagen.transport.brdf import dot
from datagen.transport.geometry import bounding_sphere, corner, distance, subtract, transmittance
from datagen.transport.sampling import mix
from datagen.transport.visibility.bvh import one_of

COARSEST = 0.8
"""Largest element or footprint, relative to its distance."""
UNLIKE = 0.05
"""Error of arrival times, relative to the light, if they are known by their mean and variance alone."""


@compiled()
def is_small(around, at, x, z, most, allowed, attenuation):  # type: ignore[no-untyped-def]
    """Whether a box is so small and faint that one point may stand for all of it; and its distance from z, metres.

    most : photons that it would bring at distance 1 m from both ends, facing them. allowed : L2 error, photons.
    """
    centre, radius = bounding_sphere(around, at)
    near1, near3 = distance(centre, x) - radius, distance(centre, z) - radius
    if min(near1, near3) <= 0.0 or 2 * radius > COARSEST * min(near1, near3):
        return False, near3
    most *= transmittance(attenuation, near1 + near3)
    return 0.5 * most / (near1 * near1 * near3 * near3) <= allowed, near3


@compiled()
def facing_at_most(m, radius, axis, cosine, sine, x, rise):  # type: ignore[no-untyped-def]
    """Upper bound of the product of cosines at x and at a box's surface, on any line between them.

    m, radius : bounding sphere of the box. axis, cosine, sine : cone of its normals. rise : height of the box above
    the surface at x. A normal within an angle α of the axis has at most |axis · d| + |d × axis| sin α along d.
    """
    d = subtract(m, x)
    square, along = dot(d, d), abs(dot(d, axis))
    near = math.sqrt(square) - radius
    if near <= 0.0:
        return 1.0
    across = math.sqrt(max(square - along * along, 0.0)) * (sine if cosine > 0.0 else 1.0)
    return min(1.0, rise / near) * min(1.0, (along + across + radius) / near)


@compiled()
def anywhere(first, last, area_before, corners, word):  # type: ignore[no-untyped-def]
    """Number of a triangle among first … last, and a point on it, drawn uniformly by area."""
    f = one_of(first, last, area_before, word)
    return f, somewhere(corner(corners, f, 0), corner(corners, f, 1), corner(corners, f, 2), word)


@compiled()
def somewhere(a, b, c, word):  # type: ignore[no-untyped-def]
    """A point drawn uniformly on the triangle a, b, c."""
    u = math.sqrt((np.float64(mix(word, np.uint64(1))) + 0.5) * 2.0**-32)
    v = (np.float64(mix(word, np.uint64(2))) + 0.5) * 2.0**-32
    r, s, t = 1 - u, u * (1 - v), u * v
    return (r * a[0] + s * b[0] + t * c[0], r * a[1] + s * b[1] + t * c[1], r * a[2] + s * b[2] + t * c[2])


@compiled()
def side_turned(d, radius, axis, cosine, sine):  # type: ignore[no-untyped-def]
    """Side that all surface within a sphere turns to a point: 1 the side of its normals, −1 the other, 0 either.

    d : vector from the sphere's middle to the point. cosine, sine : of the largest angle between a normal and the
    axis.
    """
    free = dot(d, d) - radius * radius
    if not (free > 0.0 and cosine > 0.0):
        return 0
    tangent, across = math.sqrt(free), dot(d, axis)
    # The cone of the normals, widened by that of the lines to the ball, on one side of a right angle.
    if cosine * tangent <= sine * radius or abs(across) <= radius * cosine + tangent * sine:
        return 0
    return 1 if across > 0.0 else -1
