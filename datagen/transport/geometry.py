"""Vectors, triangles and boxes for compiled loops: a vector is a tuple of three numbers, a box a row of six."""

from __future__ import annotations

import math

import numpy as np

from datagen.compiled import compiled
from datagen.transport.brdf import dot

TINY = 1e-200
"""Distances, areas and densities below this are 0: far less than any that light has, and still safe to divide by."""


@compiled()
def subtract(a, b):  # type: ignore[no-untyped-def]
    """The difference a − b of two vectors."""
    return (a[0] - b[0], a[1] - b[1], a[2] - b[2])


@compiled()
def cross(a, b):  # type: ignore[no-untyped-def]
    """The vector product a × b."""
    return (a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0])


@compiled()
def distance(a, b):  # type: ignore[no-untyped-def]
    """The distance |a − b| of two points."""
    d = subtract(a, b)
    return np.sqrt(dot(d, d))


@compiled()
def transmittance(attenuation, path):  # type: ignore[no-untyped-def]
    """Transmittance of air on a path of some metres, 0 … 1; `attenuation` in 1/m."""
    # Most scenes have clear air: testing for it is cheaper than an exponential.
    return math.exp(-attenuation * path) if attenuation > 0.0 else 1.0


@compiled()
def get(rows, k, j):  # type: ignore[no-untyped-def]
    """The vector in columns j, j + 1 and j + 2 of row k."""
    return (rows[k, j], rows[k, j + 1], rows[k, j + 2])


@compiled()
def put(rows, k, j, v):  # type: ignore[no-untyped-def]
    """Write the vector v to columns j, j + 1 and j + 2 of row k."""
    rows[k, j], rows[k, j + 1], rows[k, j + 2] = v[0], v[1], v[2]


@compiled()
def corner(corners, f, k):  # type: ignore[no-untyped-def]
    """Corner k of triangle f, of corners (F, 3, 3)."""
    return (corners[f, k, 0], corners[f, k, 1], corners[f, k, 2])


@compiled()
def longest(a, b, c):  # type: ignore[no-untyped-def]
    """Number (0 for ab, 1 for bc, 2 for ca) and length of the longest side of a triangle."""
    # Squares compare as lengths do, so one root is enough.
    u, v, w = subtract(b, a), subtract(c, b), subtract(a, c)
    ab, bc, ca = dot(u, u), dot(v, v), dot(w, w)
    return 0 if ab >= bc and ab >= ca else 1 if bc >= ca else 2, math.sqrt(max(ab, bc, ca))


@compiled()
def bounding_sphere(box, k):  # type: ignore[no-untyped-def]
    """Centre and radius of the bounding sphere of box k; a box is its lowest and its highest corner."""
    size = (box[k, 3] - box[k, 0], box[k, 4] - box[k, 1], box[k, 5] - box[k, 2])
    middle = (box[k, 0] + 0.5 * size[0], box[k, 1] + 0.5 * size[1], box[k, 2] + 0.5 * size[2])
    return middle, 0.5 * np.sqrt(dot(size, size))


@compiled()
def above(box, k, x, n):  # type: ignore[no-untyped-def]
    """Signed height of the highest corner of box k above the plane through x with unit normal n."""
    # The highest corner takes, axis by axis, the side of the box that lies further along n.
    height = 0.0
    for j in range(3):
        height += max(n[j] * (box[k, j] - x[j]), n[j] * (box[k, 3 + j] - x[j]))
    return height
