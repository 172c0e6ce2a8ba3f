"""Faint boxes of small triangles: upper bounds of their light, and the random point that stands for all of a box."""

from __future__ import annotations

import math

import numpy as np

from datagen.compiled import compiled
from datagen.transport.brdf import dot
from datagen.transport.geometry import bounding_sphere, corner, distance, subtract, transmittance
from datagen.transport.sampling import mix
from datagen.transport.bvh import triangle_by_area

COARSEST = 0.8
"""Largest size of an element or footprint, relative to its distance; larger ones are divided whatever their light.
Half of it makes four times as many elements near a laser point or a pixel."""


@compiled()
def is_small(boxes, at, x, z, most, allowed, attenuation):  # type: ignore[no-untyped-def]
    """Whether a box is so small and faint that one point may stand for all of it; and its distance from z, metres.

    boxes, at : (N, 6) boxes, and index of this one. x, z : laser point and footprint. most : photons that the box
    would bring from a distance of 1 m to both, facing them. allowed : L2 error that it may make, photons.
    """
    centre, radius = bounding_sphere(boxes, at)
    near1, near3 = distance(centre, x) - radius, distance(centre, z) - radius
    if min(near1, near3) <= 0.0 or 2 * radius > COARSEST * min(near1, near3):
        return False, near3
    # One point errs by at most all of the light, and on average by half of that bound.
    most *= transmittance(attenuation, near1 + near3)
    return 0.5 * most / (near1 * near1 * near3 * near3) <= allowed, near3


@compiled()
def facing_at_most(m, radius, axis, cosine, sine, x, rise):  # type: ignore[no-untyped-def]
    """Upper bound of the product of the cosines at x and at a box's surface, on any line between them.

    m, radius : bounding sphere of the box, metres. axis, cosine, sine : cone of the box's normals. rise : height of
    the box above the surface at x, metres.

    A normal within an angle α of the axis has a component of at most |axis · d| + |d × axis| sin α along d.
    """
    d = subtract(m, x)
    square, along = dot(d, d), abs(dot(d, axis))
    near = math.sqrt(square) - radius
    # Inside the sphere every direction is possible.
    if near <= 0.0:
        return 1.0
    across = math.sqrt(max(square - along * along, 0.0)) * (sine if cosine > 0.0 else 1.0)
    return min(1.0, rise / near) * min(1.0, (along + across + radius) / near)


@compiled()
def point_on_triangles(first, last, area_before, corners, word):  # type: ignore[no-untyped-def]
    """Index of one of the triangles first … last − 1 and a point on it, drawn uniformly by area.

    area_before : (F + 1,) running sum of areas, m². corners : (F, 3, 3) metres. word : random word.
    """
    f = triangle_by_area(first, last, area_before, word)
    return f, point_on_triangle(corner(corners, f, 0), corner(corners, f, 1), corner(corners, f, 2), word)


@compiled()
def point_on_triangle(a, b, c, word):  # type: ignore[no-untyped-def]
    """A point drawn uniformly by area on the triangle a, b, c; word : random word."""
    u = math.sqrt((np.float64(mix(word, np.uint64(1))) + 0.5) * 2.0**-32)
    v = (np.float64(mix(word, np.uint64(2))) + 0.5) * 2.0**-32
    r, s, t = 1 - u, u * (1 - v), u * v
    return (r * a[0] + s * b[0] + t * c[0], r * a[1] + s * b[1] + t * c[1], r * a[2] + s * b[2] + t * c[2])


@compiled()
def side_turned(d, radius, axis, cosine, sine):  # type: ignore[no-untyped-def]
    """Side that all surface within a sphere turns to a point: 1 if it is the side of the surface's normals, −1 if it
    is the other side, 0 if this is not proven.

    d : vector from the sphere's middle to the point, metres. cosine, sine : of the largest angle between a normal and
    the axis.
    """
    free = dot(d, d) - radius * radius
    if not (free > 0.0 and cosine > 0.0):
        return 0
    tangent, across = math.sqrt(free), dot(d, axis)
    # The cone of normals, widened by the cone of lines from the point to the sphere, must lie on one side of a right
    # angle to d.
    if cosine * tangent <= sine * radius or abs(across) <= radius * cosine + tangent * sine:
        return 0
    return 1 if across > 0.0 else -1
