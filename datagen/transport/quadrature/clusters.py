"""Small triangles taken together: the light of all that a box holds from moments of its surface.

A mesh far away costs as much as its detail there, whatever the number of its triangles (`Hierarchy.moment`).
"""

from __future__ import annotations

import math

import numpy as np

from datagen.compiled import compiled
from datagen.transport.brdf import dot
from datagen.transport.geometry import air, ball, corner, distance, get, less, unit
from datagen.transport.sampling import mix
from datagen.transport.visibility.bvh import one_of

COARSEST = 0.8
"""Largest element or footprint, relative to its distance."""
CLUTTERED = 0.5
"""Error of a cluster whose normals go everywhere, relative to its light: of that much it may hide itself."""
PLACES, NORMALS, ALONG_X, ALONG_Y, ALONG_Z = map(np.int64, (3, 9, 20, 26, 32))
"""Columns of `Hierarchy.moment` where a symmetric matrix begins: covariance of the places, moment of the normals, and
how that changes along x, y and z. As np.int64, because numba compiles a function anew for each plain int."""
DRAWS = 8
"""Points drawn at most for one that is bright. With half as many meshes lose half as much light again."""
UNLIKE = 0.05
"""Error of arrival times, relative to the light, if they are known by their mean and variance alone."""


@compiled()
def is_small(around, at, x, z, most, allowed, attenuation):  # type: ignore[no-untyped-def]
    """Whether a box is so small and faint that one point may stand for all of it, and how near it comes to z.

    most : photons if all of it were at distance 1 and faced both.
    """
    centre, radius = ball(around, at)
    near1, near3 = distance(centre, x) - radius, distance(centre, z) - radius
    if min(near1, near3) <= 0.0 or 2 * radius > COARSEST * min(near1, near3):
        return False, near3
    most *= air(attenuation, near1 + near3)
    return 0.5 * most / (near1 * near1 * near3 * near3) <= allowed, near3


@compiled()
def facing_at_most(m, radius, axis, cosine, sine, x, rise):  # type: ignore[no-untyped-def]
    """Product of the cosines at x and at a box's surface on any line between them, at most.

    m, radius : of the ball round the box. axis, cosine, sine : the cone of its normals. rise : of the box above the
    plane through x. Normals within an angle α of the axis have at most |axis · d| + |d × axis| sin α along d.
    """
    d = less(m, x)
    square, along = dot(d, d), abs(dot(d, axis))
    near = math.sqrt(square) - radius
    if near <= 0.0:
        return 1.0
    across = math.sqrt(max(square - along * along, 0.0)) * (sine if cosine > 0.0 else 1.0)
    return min(1.0, rise / near) * min(1.0, (along + across + radius) / near)


@compiled()
def as_one(moment, k, x, z, sides, diffuse, keen, per_metre):  # type: ignore[no-untyped-def]
    """A cluster as one element, all of it at the middle of its light.

    keen : 1/width² of the narrowest lobe on the path. per_metre : bins.

    Returns that place; a normal there, and what to multiply its light with; the error that this has beside that of a
    triangle's element, relative to the light; the size that a triangle's longest side would have; by how much the
    mean path is longer than by way of the place; and half of how far the paths spread, as those of a triangle with
    their variance.

    For points y = c + δ with normals n the light goes with (n·d₁)(n·d₃), d₁ = y − x, d₃ = y − z. To first order in δ
    its mean is d₁ᵀ⟨n nᵀ⟩d₃ + ⟨(n·δ)(n·(d₁ + d₃))⟩ with d₁, d₃ those of c, and its middle d₁ᵀ⟨n nᵀ δ⟩d₃ beside c. That
    holds where all normals have the same side towards both ends. Otherwise faces between two outlines count against
    it, and the mean of the positive part is at most (d₁ᵀM d₃ + √(d₁ᵀM d₁ · d₃ᵀM d₃)) / 2 with M = ⟨n nᵀ⟩, by Cauchy
    and Schwarz.
    """
    c = get(moment, k, 0)
    d1, d3 = less(c, x), less(c, z)
    facing, doubt = _quadratic(moment, k, NORMALS, d1, d3), 0.0
    if sides == 0:
        most = 0.5 * (
            facing + math.sqrt(_quadratic(moment, k, NORMALS, d1, d1) * _quadratic(moment, k, NORMALS, d3, d3))
        )
        least = max(facing, 0.0)
        facing = 0.5 * (least + most)
        doubt = 0.5 * (most - least) / facing if facing > 0.0 else 0.0
    both = (d1[0] + d3[0], d1[1] + d3[1], d1[2] + d3[2])
    nearer = (
        _quadratic(moment, k, ALONG_X, both, (1.0, 0.0, 0.0))
        + _quadratic(moment, k, ALONG_Y, both, (0.0, 1.0, 0.0))
        + _quadratic(moment, k, ALONG_Z, both, (0.0, 0.0, 1.0))
    )
    trace = moment[k, 3] + moment[k, 4] + moment[k, 5]
    # Seen from its edge a cluster may change by more than it is, and the first order says nothing.
    near = facing * facing > 4.0 * trace * dot(both, both)
    per = 1.0 / facing if near else 0.0
    place = (
        c[0] + per * _quadratic(moment, k, ALONG_X, d1, d3),
        c[1] + per * _quadratic(moment, k, ALONG_Y, d1, d3),
        c[2] + per * _quadratic(moment, k, ALONG_Z, d1, d3),
    )
    d1, d3 = less(place, x), less(place, z)
    r1, r3 = math.sqrt(dot(d1, d1)), math.sqrt(dot(d3, d3))
    g = (d1[0] / r1 + d3[0] / r3, d1[1] / r1 + d3[1] / r3, d1[2] / r1 + d3[2] / r3)
    n = unit(g) if diffuse else get(moment, k, 15)
    across1 = trace - _quadratic(moment, k, PLACES, d1, d1) / (r1 * r1)
    across3 = trace - _quadratic(moment, k, PLACES, d3, d3) / (r3 * r3)
    longer, variance = 0.5 * (across1 / r1 + across3 / r3), max(_quadratic(moment, k, PLACES, g, g), 0.0)
    tilt = (facing + nearer if near else facing) / (dot(d1, n) * dot(d3, n))
    h, apart = math.sqrt(18.0 * trace), math.sqrt(6.0 * variance)
    # Normals go with place; light need not come as a triangle's; and what is not diffuse changes with the normal.
    lacking, wide = moment[k, 19], 2.0 * apart * per_metre
    turned = math.sqrt(lacking) * (h / r1 + h / r3)
    lobe = 0.0 if diffuse else min(keen * lacking, 1.0)
    unlike = (
        doubt + min(keen * turned, max(turned, 1.0)) + UNLIKE * min(1.0, wide * wide) + CLUTTERED * lacking + lobe
    )
    return place, n, tilt, unlike, h, longer, apart


@compiled()
def _quadratic(moment, k, j, u, v):  # type: ignore[no-untyped-def]
    """uᵀ A v, of the symmetric matrix that stands in row k from column j on."""
    return (
        u[0] * (moment[k, j] * v[0] + moment[k, j + 3] * v[1] + moment[k, j + 4] * v[2])
        + u[1] * (moment[k, j + 3] * v[0] + moment[k, j + 1] * v[1] + moment[k, j + 5] * v[2])
        + u[2] * (moment[k, j + 4] * v[0] + moment[k, j + 5] * v[1] + moment[k, j + 2] * v[2])
    )


@compiled()
def facing(first, last, area_before, corners, normal, x, z, word):  # type: ignore[no-untyped-def]
    """A point on the triangles first … last, and which it lies on, drawn by the light that x and z make of it.

    What faces away, or is seen from its edge, is hidden more often than what is bright, and stands for less.
    """
    for turn in range(DRAWS):
        f, y = anywhere(first, last, area_before, corners, word)
        n, d1, d3 = get(normal, f, 0), less(y, x), less(y, z)
        chance = (np.float64(mix(word, np.uint64(3))) + 0.5) * 2.0**-32
        if dot(n, d1) * dot(n, d3) > chance * math.sqrt(dot(d1, d1) * dot(d3, d3)):
            break
        word = mix(word, np.uint64(4 + turn))
    return f, y


@compiled()
def anywhere(first, last, area_before, corners, word):  # type: ignore[no-untyped-def]
    """A point drawn uniformly on the triangles first … last, and which it lies on."""
    f = one_of(first, last, area_before, word)
    return f, somewhere(corner(corners, f, 0), corner(corners, f, 1), corner(corners, f, 2), word)


@compiled()
def somewhere(a, b, c, word):  # type: ignore[no-untyped-def]
    """A point drawn uniformly on a triangle."""
    u = math.sqrt((np.float64(mix(word, np.uint64(1))) + 0.5) * 2.0**-32)
    v = (np.float64(mix(word, np.uint64(2))) + 0.5) * 2.0**-32
    r, s, t = 1 - u, u * (1 - v), u * v
    return (r * a[0] + s * b[0] + t * c[0], r * a[1] + s * b[1] + t * c[1], r * a[2] + s * b[2] + t * c[2])
