"""The connected surfaces of an object, each of them closed or open.

Vertices at the same place are merged. A surface is closed if every edge belongs to an even number of triangles; a
point is inside if a ray from it crosses the surface an odd number of times, whatever the winding of the triangles.
Meshes from scanners have small holes: a fan of triangles bridges each rim to its centroid, and the surface counts as
closed if the fans are at most 5 % of its area. A sheet, or a box without its lid, stays open and encloses nothing.
Closed surfaces that overlap enclose the union of their solids; a surface inside another one adds nothing, as no light
reaches a sealed cavity.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from datagen.records.arrays import Floats, Ints

LARGEST_HOLE_SHARE = 0.05
"""Largest area of a closed surface's bridged holes, in units of its own; those of the Stanford bunny have 0.022."""
_LATTICE = 2**20
"""Cells across an object within which vertices count as the same: 1 µm in an object of 1 m."""


@dataclass(frozen=True)
class ConnectedSurface:
    """One connected surface.

    corners : (F, 3, 3) corners of its triangles, without those that bridge holes.
    lid : (B, 3, 3) corners of the triangles that bridge its holes.
    closed : whether it encloses a volume, with its lid.
    """

    corners: Floats
    lid: Floats
    closed: bool

    @property
    def mean_thickness_m(self) -> float:
        """2 · volume / area, which is the thickness of a sheet; 0 for an open surface."""
        if not self.closed:
            return 0.0
        whole = np.concatenate([self.corners, self.lid])
        whole = whole - whole.mean(axis=(0, 1))
        volume = abs(float(np.einsum("fi,fi->", whole[:, 0], np.cross(whole[:, 1], whole[:, 2])))) / 6
        return 2 * volume / float(_areas(whole).sum())


def connected_surfaces(corners: Floats) -> list[ConnectedSurface]:
    """The connected surfaces of triangles (F, 3, 3), metres."""
    if len(corners) == 0:
        return []
    triangles, count = _merged_vertices(corners)
    links = np.concatenate([triangles[:, [0, 1]], triangles[:, [1, 2]]])
    label = connected_sets(links, count)[1][triangles[:, 0]]
    order = np.argsort(label, kind="stable")
    cuts = np.flatnonzero(np.diff(label[order])) + 1
    return [_surface(corners[faces], triangles[faces]) for faces in np.split(order, cuts)]


def open_share(corners: Floats) -> float:
    """Share of the area of triangles (F, 3, 3) in open surfaces, except flat ones, which nobody takes for solids."""
    opened = [surface.corners for surface in connected_surfaces(corners) if not surface.closed]
    return sum(float(_areas(one).sum()) for one in opened if not _is_flat(one)) / float(_areas(corners).sum())


def _is_flat(corners: Floats) -> bool:
    """Whether all corners (F, 3, 3) lie in one plane."""
    points = corners.reshape(-1, 3)
    widths = np.linalg.svd(points - points.mean(axis=0), compute_uv=False)
    return bool(widths[2] <= 1e-6 * widths[0])


def connected_sets(links: Ints, count: int) -> tuple[int, Ints]:
    """Number of connected sets into which `links` (n, 2) join `count` vertices, and (count,) each vertex's set."""
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    graph = coo_array((np.ones(len(links), np.int8), (links[:, 0], links[:, 1])), shape=(count, count))
    sets, label = connected_components(graph, directed=False)
    return sets, label


def _merged_vertices(corners: Floats) -> tuple[Ints, int]:
    """(F, 3) numbers of the vertices, the same for corners at the same place, and the number of vertices."""
    points = corners.reshape(-1, 3)
    low = points.min(axis=0)
    step = max(float((points.max(axis=0) - low).max()) / _LATTICE, np.finfo(np.float64).tiny)
    cell = np.round((points - low) / step).astype(np.int64)
    # Three numbers of 21 bits are packed into one, because sorting numbers is five times as fast as sorting rows.
    places, number = np.unique((cell[:, 0] << 42) | (cell[:, 1] << 21) | cell[:, 2], return_inverse=True)
    return number.reshape(-1, 3), len(places)


def _surface(corners: Floats, triangles: Ints) -> ConnectedSurface:
    """The surface of connected triangles with corners (F, 3, 3) and vertex numbers (F, 3)."""
    edges = np.sort(triangles[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
    ends = corners[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2, 3)
    key = edges[:, 0] * (int(edges.max()) + 1) + edges[:, 1]
    _, first, uses = np.unique(key, return_index=True, return_counts=True)
    rim = first[uses % 2 == 1]
    if len(rim) == 0:
        return ConnectedSurface(corners, np.empty((0, 3, 3)), True)
    lid = _fans(edges[rim], ends[rim])
    return ConnectedSurface(
        corners, lid, float(_areas(lid).sum()) <= LARGEST_HOLE_SHARE * float(_areas(corners).sum())
    )


def _fans(edges: Ints, ends: Floats) -> Floats:
    """(E, 3, 3) a triangle for each edge (E, 2) of a rim, from its `ends` (E, 2, 3) to the centroid of the rim."""
    _, nodes = np.unique(edges, return_inverse=True)
    nodes = nodes.reshape(-1, 2)
    rims, label = connected_sets(nodes, int(nodes.max()) + 1)
    label = label[nodes[:, 0]]
    total = np.zeros((rims, 3))
    np.add.at(total, label, ends.mean(axis=1))
    centers = total / np.bincount(label, minlength=rims)[:, None]
    # The edge is reversed against the surface's own triangle, so that a consistent winding stays consistent.
    return np.concatenate([ends[:, ::-1], centers[label][:, None]], axis=1)


def _areas(corners: Floats) -> Floats:
    """(F,) areas of triangles (F, 3, 3)."""
    sides = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    return np.asarray(0.5 * np.linalg.norm(sides, axis=1))
