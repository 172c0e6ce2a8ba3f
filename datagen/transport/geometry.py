"""Vectors, triangles and boxes as the compiled loops have them: three numbers, rows of arrays."""

from __future__ import annotations

import math

import numpy as np

from datagen.compiled import compiled
from datagen.transport.brdf import dot


@compiled()
def less(a, b):  # type: ignore[no-untyped-def]
    """a − b, of vectors."""
    return (a[0] - b[0], a[1] - b[1], a[2] - b[2])


@compiled()
def cross(a, b):  # type: ignore[no-untyped-def]
    """The vector product."""
    return (a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0])


@compiled()
def distance(a, b):  # type: ignore[no-untyped-def]
    """|a − b|, of points."""
    d = less(a, b)
    return np.sqrt(dot(d, d))


@compiled()
def air(attenuation, path):  # type: ignore[no-untyped-def]
    """What air leaves of light on a path."""
    return math.exp(-attenuation * path) if attenuation > 0.0 else 1.0


@compiled()
def unit(n):  # type: ignore[no-untyped-def]
    """The unit vector along n."""
    length = np.sqrt(dot(n, n))
    return (n[0] / length, n[1] / length, n[2] / length)


@compiled()
def half(a, b):  # type: ignore[no-untyped-def]
    """The point between two."""
    return (0.5 * (a[0] + b[0]), 0.5 * (a[1] + b[1]), 0.5 * (a[2] + b[2]))


@compiled()
def get(rows, k, j):  # type: ignore[no-untyped-def]
    """Three numbers of row k, from column j on."""
    return (rows[k, j], rows[k, j + 1], rows[k, j + 2])


@compiled()
def put(rows, k, j, v):  # type: ignore[no-untyped-def]
    """Put three numbers into row k, from column j on."""
    rows[k, j], rows[k, j + 1], rows[k, j + 2] = v[0], v[1], v[2]


@compiled()
def corner(corners, f, k):  # type: ignore[no-untyped-def]
    """Corner k of triangle f."""
    return (corners[f, k, 0], corners[f, k, 1], corners[f, k, 2])


@compiled()
def longest(a, b, c):  # type: ignore[no-untyped-def]
    """Which side of a triangle is its longest, and how long."""
    u, v, w = less(b, a), less(c, b), less(a, c)
    ab, bc, ca = dot(u, u), dot(v, v), dot(w, w)
    return 0 if ab >= bc and ab >= ca else 1 if bc >= ca else 2, math.sqrt(max(ab, bc, ca))


@compiled()
def ball(box, k):  # type: ignore[no-untyped-def]
    """Middle and radius of the ball round a box."""
    size = (box[k, 3] - box[k, 0], box[k, 4] - box[k, 1], box[k, 5] - box[k, 2])
    middle = (box[k, 0] + 0.5 * size[0], box[k, 1] + 0.5 * size[1], box[k, 2] + 0.5 * size[2])
    return middle, 0.5 * np.sqrt(dot(size, size))


@compiled()
def above(box, k, x, n):  # type: ignore[no-untyped-def]
    """How far the highest corner of a box lies above the plane through x with normal n."""
    height = 0.0
    for j in range(3):
        height += max(n[j] * (box[k, j] - x[j]), n[j] * (box[k, 3 + j] - x[j]))
    return height
