"""Cases that the fuzzer found, kept as they are."""

from __future__ import annotations

import pytest
from rooms import bins_of_path, furnished_box, one_point_capture, rectangle, square_pixels

from datagen import Accuracy, Capture, Lambertian, Laser, Part, Scene, Sensor, simulate
from datagen.errors import InputError


def test_a_laser_that_meets_nothing_has_no_shares_of_work() -> None:
    """No work was done, and the shares of it were divided by zero."""
    floor = Scene.from_parts([Part("floor", rectangle((0, 0, -1.5), (1.5, 0, 0), (0, 1.5, 0)), Lambertian(0.5))])
    capture = Capture(Laser((0, 0, 0.0), [[0.2, 0.2, 0.2]]), Sensor((1.0, 0, 0), square_pixels([[0, 0, 0]], 0.1)),
                      bins_of_path(4, 1.0, 0.0))  # fmt: skip
    result = simulate(floor, capture, Accuracy(1, 1, 3, 1), seed=0)
    assert not result.total.any() and not result.overflow.any()


def test_a_pixel_around_the_sensor_is_refused() -> None:
    """Seen from within its own plane a pixel covered half of all directions, and the middle one was 0/0."""
    capture = one_point_capture(fov_center=(1.5, 0.17, 1.33))
    with pytest.raises(InputError, match=r"pixels\[0\].*within the pixel"):
        simulate(furnished_box(), capture, Accuracy(1, 1, 3, 1))
