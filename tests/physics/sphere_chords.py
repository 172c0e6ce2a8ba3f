"""The inside of a sphere of radius 1 m: shares of the light by path length, from chains of uniform points.

`python tests/tools/make_sphere_chords.py` computes `data/sphere_chords.npz` anew (half a minute); a nightly test does
so with other chains. After any bounce the next vertex is uniform on a Lambertian sphere (docs/physics.md).
"""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

import numpy as np
import trimesh
from numpy.typing import NDArray

STORED = Path(__file__).parent / "data" / "sphere_chords.npz"
ORDERS = (3, 4, 5, 6)
BINS, WIDTH_M = 96, 0.1
QUAD = np.array([[[0.1, -0.5, -1], [0.5, 0.3, -1], [0, 0.5, -1], [-0.4, -0.2, -1.0]]])
"""The pixel, seen from the middle."""
SPOT = np.array([1.0, 0.1, 0.2])
"""The direction of the laser point."""


class Chords(NamedTuple):
    """Fractions of each order's energy by bin (4, BINS), without paths that are too long, and their standard
    errors."""

    share: NDArray[np.float64]
    error: NDArray[np.float64]

    def of(self, order: int) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        return self.share[ORDERS.index(order)], self.error[ORDERS.index(order)]


def unit_ball(subdivisions: int) -> trimesh.Trimesh:
    """A polyhedron of the unit sphere's area: its energy is right to second order."""
    mesh = trimesh.creation.icosphere(subdivisions=subdivisions)
    mesh.apply_scale(np.sqrt(4 * np.pi / mesh.area))
    return mesh


def chords(chunks: int, chains: int, seed: int) -> Chords:
    """The fractions from `chunks` independent sets of `chains` chains each; the standard error is from their
    spread."""
    rng = np.random.default_rng(seed)
    found = np.array([_shares(rng, chains) for _ in range(chunks)])
    return Chords(found.mean(axis=0), found.std(axis=0, ddof=1) / np.sqrt(chunks))


def stored() -> Chords:
    with np.load(STORED) as arrays:
        return Chords(arrays["share"], arrays["error"])


def _shares(rng: np.random.Generator, chains: int) -> NDArray[np.float64]:
    u, v = rng.random((2, chains, 1))
    a, b, c, d = QUAD[0]
    end = (1 - v) * ((1 - u) * a + u * b) + v * ((1 - u) * d + u * c)
    along_u, along_v = (1 - v) * (b - a) + v * (c - d), (1 - u) * (d - a) + u * (c - b)
    weight = np.abs(np.einsum("ij,ij->i", end, np.cross(along_u, along_v))) / np.linalg.norm(end, axis=1) ** 3
    weight /= weight.sum()
    end /= np.linalg.norm(end, axis=1, keepdims=True)
    previous, path = SPOT / np.linalg.norm(SPOT), np.zeros(chains)
    shares = np.zeros((len(ORDERS), BINS))
    for row in shares:
        point = rng.normal(size=(chains, 3))
        point /= np.linalg.norm(point, axis=1, keepdims=True)
        path = path + np.linalg.norm(point - previous, axis=1)
        previous = point
        position = (path + np.linalg.norm(end - point, axis=1)) / WIDTH_M
        row[:] = np.bincount(np.floor(position).astype(int), weight, BINS + 20)[:BINS]
    return shares
