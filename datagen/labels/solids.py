"""Which surfaces enclose a volume: objects taken apart into connected surfaces, each closed or open.

A surface is closed when every edge belongs to an even number of triangles, after vertices at the same place are
merged; the inside is then where a ray crosses it an odd number of times, however its triangles are wound. Scans have
small holes: each rim is bridged by a fan of triangles to its centroid, and the surface counts as closed when those
fans are at most 5 % of its area. A sheet, or a box without its lid, stays open and encloses nothing. Where closed
surfaces overlap, the solids are united; a surface inside another adds nothing (no light reaches a sealed cavity).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from datagen.records.arrays import Floats, Ints

LARGEST_HOLE_SHARE = 0.05
"""Area of the bridged holes over area of the surface, up to which a surface counts as closed."""
_LATTICE = 2**20  # cells across a part: 1 µm in an object of 1 m


@dataclass(frozen=True)
class ConnectedSurface:
    """One connected surface.

    Attributes
    ----------
    corners : (F, 3, 3) its triangles, without any that bridge holes.
    lid : (B, 3, 3) the triangles that bridge its holes; with `corners` they make a closed surface.
    closed : whether it encloses a volume.
    """

    corners: Floats
    lid: Floats
    closed: bool

    @property
    def mean_thickness_m(self) -> float:
        """2 · volume / area: the thickness of a sheet; 0 for an open surface."""
        if not self.closed:
            return 0.0
        whole = np.concatenate([self.corners, self.lid])
        whole = whole - whole.mean(axis=(0, 1))
        volume = abs(float(np.einsum("fi,fi->", whole[:, 0], np.cross(whole[:, 1], whole[:, 2])))) / 6
        return 2 * volume / float(_areas(whole).sum())


def connected_surfaces(corners: Floats) -> list[ConnectedSurface]:
    """Take triangles (F, 3, 3), metres, apart into connected surfaces."""
    if len(corners) == 0:
        return []
    triangles, count = _merged(corners)
    links = np.concatenate([triangles[:, [0, 1]], triangles[:, [1, 2]]])
    label = _connected(links, count)[1][triangles[:, 0]]
    order = np.argsort(label, kind="stable")
    cuts = np.flatnonzero(np.diff(label[order])) + 1
    return [_surface(corners[faces], triangles[faces]) for faces in np.split(order, cuts)]


def open_share(corners: Floats) -> float:
    """Share of the area of triangles (F, 3, 3) in open surfaces; flat ones, which nobody takes for solids, apart."""
    found = [surface.corners for surface in connected_surfaces(corners) if not surface.closed]
    return sum(float(_areas(one).sum()) for one in found if not _is_flat(one)) / float(_areas(corners).sum())


def _is_flat(corners: Floats) -> bool:
    points = corners.reshape(-1, 3)
    widths = np.linalg.svd(points - points.mean(axis=0), compute_uv=False)
    return bool(widths[2] <= 1e-6 * widths[0])


def _connected(links: Ints, count: int) -> tuple[int, Ints]:
    """How many connected sets `links` (n, 2) make of `count` vertices, and the set of each."""
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    graph = coo_array((np.ones(len(links), np.int8), (links[:, 0], links[:, 1])), shape=(count, count))
    sets, label = connected_components(graph, directed=False)
    return sets, label


def _merged(corners: Floats) -> tuple[Ints, int]:
    """(F, 3) vertex numbers, the same for corners at the same place, and how many there are."""
    points = corners.reshape(-1, 3)
    low = points.min(axis=0)
    step = max(float((points.max(axis=0) - low).max()) / _LATTICE, np.finfo(np.float64).tiny)
    cell = np.round((points - low) / step).astype(np.int64)
    # Three numbers of 21 bits in one: sorting those is five times as fast as sorting rows.
    places, number = np.unique((cell[:, 0] << 42) | (cell[:, 1] << 21) | cell[:, 2], return_inverse=True)
    return number.reshape(-1, 3), len(places)


def _surface(corners: Floats, triangles: Ints) -> ConnectedSurface:
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
    """One triangle for each edge (E, 2) of a rim, from the edge's `ends` (E, 2, 3) to the centroid of its rim."""
    _, nodes = np.unique(edges, return_inverse=True)
    nodes = nodes.reshape(-1, 2)
    rims, label = _connected(nodes, int(nodes.max()) + 1)
    label = label[nodes[:, 0]]
    total = np.zeros((rims, 3))
    np.add.at(total, label, ends.mean(axis=1))
    centers = total / np.bincount(label, minlength=rims)[:, None]
    # Against the direction of the rim's own triangles, so that winding stays consistent where it was.
    return np.concatenate([ends[:, ::-1], centers[label][:, None]], axis=1)


def _areas(corners: Floats) -> Floats:
    sides = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    return np.asarray(0.5 * np.linalg.norm(sides, axis=1))
