"""Lines of sight through the corners of walls: the surface and the point met follow from geometry, not from
rounding."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray
from rooms import furnished_box, rectangle, square_pixels

from datagen import Lambertian, Part, Scene, Sensor
from datagen.transport.fields_of_view import PixelCones, PixelPatches
from datagen.transport.visibility.lines_of_sight import lines_of_sight
from datagen.transport.visibility.raycast import Raycaster

EYE = np.array([1.5, 0.1, 1.3])


def grid_of(corners: NDArray[np.float64], along: int) -> NDArray[np.float64]:
    """(P, along², 3) points of flat pixels (P, 4, 3)."""
    u, v = (k.ravel()[:, None] for k in np.meshgrid(*[np.linspace(0, 1, along)] * 2))
    a, b, c, d = (corners[:, None, k] for k in range(4))
    return np.asarray((1 - v) * ((1 - u) * a + u * b) + v * ((1 - u) * d + u * c))


@pytest.mark.parametrize("hair", [0.0, 1e-9, -1e-9, 1e-7, -1e-7])
@pytest.mark.parametrize("along", [3, 5])
def test_a_pixel_that_ends_where_walls_touch_ends_there_exactly(along: int, hair: float) -> None:
    """The pixels of the wall x = 0 reach from floor to ceiling and from side to side, or a hair more or less: every
    line of sight meets that wall, at the exact point to 10⁻¹² m."""
    scene = furnished_box()
    pixels = Sensor.grid(EYE, (0, 0, 1.25), (0, 1.5, 0), (0, 0, 1.25), 4, 4).pixels
    foot = np.array([0.0, EYE[1], EYE[2]])
    pixels = foot + (1 + hair) * (pixels - foot)
    lines = lines_of_sight(Raycaster(scene), Sensor(EYE, pixels), along)
    assert lines.valid.all()
    np.testing.assert_array_equal(lines.normal, np.broadcast_to([1.0, 0, 0], lines.normal.shape))
    np.testing.assert_allclose(lines.position, grid_of(pixels, along), rtol=0, atol=1e-12)


@pytest.mark.parametrize("half_side_m", [1e-6, 1e-4, 0.1])
@pytest.mark.parametrize("hair", [0.0, 1e-9, -1e-9, 1e-7, -1e-7])
def test_a_pixel_in_the_corner_of_three_walls(half_side_m: float, hair: float) -> None:
    """Pixels so small that single precision hardly distinguishes them from a point, and pixels moved a hair across
    the corner or away from it."""
    corner = np.array([[0.0, 1.5, 2.5]])
    pixels = square_pixels(corner + (hair - half_side_m) * np.array([0.0, 1.0, 1.0]), half_side_m)
    lines = lines_of_sight(Raycaster(furnished_box()), Sensor(EYE, pixels), 3)
    assert lines.valid.all()
    if abs(hair) < half_side_m / 20:
        np.testing.assert_array_equal(lines.normal, np.broadcast_to([1.0, 0, 0], lines.normal.shape))
        np.testing.assert_allclose(lines.position, grid_of(pixels, 3), rtol=0, atol=1e-12)


def test_a_line_past_the_end_of_a_wall_stays_near_what_its_pixel_sees() -> None:
    """A line that grazes a floor, tilted a little more, would meet the floor's plane kilometres away or behind the
    eye."""
    floor = Scene.from_parts([Part("floor", rectangle((0, 0, 0), (5, 0, 0), (0, 5, 0)), Lambertian(0.5))])
    eye = np.array([-4.0, 0.0, 1e-3])
    pixels = np.array([[[-3.0, -0.1, 0.0], [-3.0, 0.1, 0.0], [-3.0, 0.1, 1.01e-3], [-3.0, -0.1, 1.01e-3]]])
    lines = lines_of_sight(Raycaster(floor), Sensor(eye, pixels), 5)
    assert lines.valid.any() and not lines.valid.all()
    seen = lines.position[lines.valid]
    np.testing.assert_allclose(seen[:, 2], 0.0, atol=1e-12)
    assert np.linalg.norm(seen - eye, axis=1).max() < 20.0


def test_patches_are_the_same_wherever_rounding_falls() -> None:
    """The ball about the patch of a pixel that fills a wall does not change when its corners move by 10⁻⁹ of their
    distance."""
    caster, balls = Raycaster(furnished_box()), []
    sensor = Sensor.grid(EYE, (0, 0, 1.25), (0, 1.5, 0), (0, 0, 1.25), 1, 1)
    for hair in (0.0, 1e-9, -1e-9):
        moved = replace(sensor, pixels=EYE + (sensor.pixels - EYE) * (1 + hair))
        balls.append(PixelPatches.of(caster, moved, PixelCones.of(moved), 4))
    for ball in balls:
        np.testing.assert_allclose(ball.center, [[0, 0, 1.25]], atol=1e-9)
        np.testing.assert_allclose(ball.radius, np.hypot(1.5, 1.25) * 0.999, rtol=1e-6)
