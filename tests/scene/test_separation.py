"""The compiled test of what stays apart equals the plain one, and the plain one the distance where that is exact."""

from __future__ import annotations

import numpy as np
import pytest

from scene_library.polygons import boundary_distance, convex_hull, segments_of
from scene_library.separation import gap_between, stays_clear

PAIRS = 200


def convex_gap(a: np.ndarray, b: np.ndarray) -> float:
    """The plain form of `gap_between`: the largest gap along a normal of an edge of either polygon."""
    edges = np.concatenate([np.roll(polygon, -1, axis=0) - polygon for polygon in (a, b)])
    edges = edges[np.linalg.norm(edges, axis=1) > 0]
    normals = np.stack([edges[:, 1], -edges[:, 0]], axis=1) / np.linalg.norm(edges, axis=1)[:, None]
    pa, pb = normals @ a.T, normals @ b.T
    return float(np.maximum(pb.min(axis=1) - pa.max(axis=1), pa.min(axis=1) - pb.max(axis=1)).max())


def drawn_polygon(rng: np.random.Generator, corners: int) -> np.ndarray:
    return np.ascontiguousarray(convex_hull(rng.normal(size=(corners, 2)) + 4 * rng.random(2)))


def test_gaps_equal_those_of_the_plain_form() -> None:
    """Of polygons one of whose edges has no length, too."""
    rng = np.random.default_rng(3)
    for pair in range(PAIRS):
        a, b = (drawn_polygon(rng, count) for count in ((3, 3), (4, 7), (12, 3))[pair % 3])
        a = np.concatenate([a[:1], a]) if pair % 5 == 0 else a
        gap = gap_between(a, b)
        assert gap == pytest.approx(convex_gap(a, b), abs=1e-12) == gap_between(b, a)
        # Never more than the true distance, and negative only where they meet.
        apart = boundary_distance(a, segments_of(b))
        assert gap <= apart + 1e-12


@pytest.mark.parametrize("margin_m", [0.0, 0.05, 0.5])
def test_clear_of_a_fan_means_clear_of_each_triangle(margin_m: float) -> None:
    rng = np.random.default_rng(7)
    clear = 0
    for _ in range(PAIRS):
        footprint = drawn_polygon(rng, 6)
        fan = np.array([drawn_polygon(rng, 3) for _ in range(rng.integers(1, 4))]) + 2 * rng.normal(size=2)
        expected = all(
            convex_gap(footprint, triangle) >= margin_m for triangle in fan if near(footprint, triangle, margin_m)
        )
        assert stays_clear(footprint, fan, margin_m) == expected
        clear += expected
    assert 0.1 * PAIRS < clear < 0.9 * PAIRS


def near(a: np.ndarray, b: np.ndarray, margin_m: float) -> bool:
    return bool(((b.max(axis=0) >= a.min(axis=0) - margin_m) & (b.min(axis=0) <= a.max(axis=0) + margin_m)).all())
