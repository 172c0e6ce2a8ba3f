"""Metrics against values worked out by hand, or by the definition written out."""

from __future__ import annotations

import math

import numpy as np
import pytest

from datagen.labels.frame import image_points
from datagen.scoring.metrics import center_distances, chamfer_distance, intersection_over_union, ssim


def test_overlap_of_sets() -> None:
    found, true = np.array([1, 1, 0, 0, 1], bool), np.array([1, 0, 1, 0, 1], bool)
    assert intersection_over_union(found, true) == 2 / 4
    assert intersection_over_union(found, found) == 1
    assert intersection_over_union(found, ~found) == 0
    assert math.isnan(intersection_over_union(np.zeros(3, bool), np.zeros(3, bool)))


def test_chamfer_distance_is_half_of_there_and_back() -> None:
    found, true = np.array([[0.0, 0, 0], [1, 0, 0]]), np.array([[0.0, 0, 0], [0, 2, 0], [1, 0, 3]])
    # There: 0 and 1 (to the origin). Back: 0, 2 and 3.
    assert chamfer_distance(found, true) == pytest.approx((0.5 + 5 / 3) / 2)
    assert chamfer_distance(true, found) == chamfer_distance(found, true)
    assert chamfer_distance(true, true[::-1]) == 0


def test_centres_are_matched_for_the_least_sum() -> None:
    true = np.array([[0.0, 0, 0], [1, 0, 0], [10, 0, 0]])
    # The nearest of both 0 and 1 is 0.6, but it cannot be both.
    found = np.array([[0.6, 0, 0], [-2, 0, 0]])
    assert center_distances(found, true, 7.0) == pytest.approx([2.0, 0.4, 7.0])
    assert center_distances(np.zeros((0, 3)), true, 7.0).tolist() == [7, 7, 7]
    # What is found beyond what is there costs nothing; the best is taken.
    assert center_distances(np.array([[5.0, 0, 0], [0, 0, 0.5]]), true[:1], 7.0) == pytest.approx([0.5])


def test_points_of_an_image_lie_at_its_pixels() -> None:
    depth, mask = np.array([[1.0, 2.0], [3.0, 4.0]]), np.array([[1, 0], [0, 1]], bool)
    assert image_points(depth, mask, 2.0, 1.0).tolist() == [[-1.0, 0.5, 1.0], [1.0, -0.5, 4.0]]


def plain_ssim(x: np.ndarray, y: np.ndarray) -> float:
    """The definition, pixel by pixel, under the window written out."""
    offset = np.arange(-5, 6)
    row = np.exp(-(offset**2) / (2 * 1.5**2))
    window = np.outer(row, row) / row.sum() ** 2
    padded = [np.pad(image, 5, mode="symmetric") for image in (x, y)]
    each = []
    for i in range(x.shape[0]):
        for j in range(x.shape[1]):
            a, b = (image[i : i + 11, j : j + 11] for image in padded)
            ma, mb = (window * a).sum(), (window * b).sum()
            va, vb = (window * (a - ma) ** 2).sum(), (window * (b - mb) ** 2).sum()
            vab = (window * (a - ma) * (b - mb)).sum()
            each.append((2 * ma * mb + 1e-4) * (2 * vab + 9e-4) / ((ma**2 + mb**2 + 1e-4) * (va + vb + 9e-4)))
    return float(np.mean(each))


def test_structural_similarity_is_that_of_the_definition() -> None:
    rng = np.random.default_rng(0)
    x = rng.random((16, 13))
    y = np.clip(x + rng.normal(0, 0.2, x.shape), 0, 1)
    assert ssim(x, y) == pytest.approx(plain_ssim(x, y), rel=1e-9)
    assert ssim(x, x) == pytest.approx(1.0)
    # Of two even images only the means count: (2 a b + c1) / (a² + b² + c1).
    even = ssim(np.full((8, 8), 0.2), np.full((8, 8), 0.6))
    assert even == pytest.approx((2 * 0.12 + 1e-4) / (0.04 + 0.36 + 1e-4))
