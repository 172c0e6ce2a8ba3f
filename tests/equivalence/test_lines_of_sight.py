"""Lines of sight through the corners of walls: what a pixel sees follows from geometry, not from rounding."""

from __future__ import annotations

import numpy as np
import pytest
from rooms import bins_of_path, furnished_box, one_point_capture, square_pixels

from datagen import Accuracy, Capture, Sensor, simulate

EYE = np.array([1.5, 0.1, 1.3])
WAYS = {"paths": Accuracy(samples=1024, max_bounces=4), "cuts": Accuracy(target=0.02, max_bounces=3)}
ALLOWED = {"paths": 1e-3, "cuts": 0.02}
"""Change for a hair: it may decide of an element or two whether they are cut."""
HAIRS = (0.0, 1e-9, -1e-9, 1e-7, -1e-7)


def light(pixels: np.ndarray, way: str) -> np.ndarray:
    capture = Capture(one_point_capture().laser, Sensor(EYE, pixels), bins_of_path(64, 0.3, 0.0), "exhaustive")
    return simulate(furnished_box(), capture, WAYS[way], seed=1).total


@pytest.mark.parametrize("way", WAYS)
def test_a_pixel_that_ends_where_walls_touch_ends_there_exactly(way: str) -> None:
    """The pixels of the wall x = 0 reach from floor to ceiling and from side to side, or a hair more or less."""
    pixels = Sensor.grid(EYE, (0, 0, 1.25), (0, 1.5, 0), (0, 0, 1.25), 4, 4).pixels
    foot = np.array([0.0, EYE[1], EYE[2]])
    exact, *others = (light(foot + (1 + hair) * (pixels - foot), way) for hair in HAIRS)
    assert (exact.sum(axis=(0, 2)) > 0).all()
    for other in others:
        assert np.linalg.norm(other - exact) < ALLOWED[way] * np.linalg.norm(exact)


@pytest.mark.parametrize("way", WAYS)
@pytest.mark.parametrize("half_side_m", [1e-5, 0.1])
def test_a_pixel_in_the_corner_of_three_walls(half_side_m: float, way: str) -> None:
    """Its light does not change when it moves a hair across the corner or away from it."""
    corner, aside = np.array([[0.0, 1.5, 2.5]]), np.array([0.0, 1.0, 1.0])
    exact, *others = (light(square_pixels(corner + (h - half_side_m) * aside, half_side_m), way) for h in HAIRS[:3])
    assert exact.any()
    for other in others:
        assert np.linalg.norm(other - exact) < ALLOWED[way] * np.linalg.norm(exact)
