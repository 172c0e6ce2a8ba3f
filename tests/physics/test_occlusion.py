"""The option `occlusion`: which connections cast shadow rays."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from rooms import bins_of_path, furnished_box, one_point_capture, rectangle, square_pixels

from datagen import Accuracy, Capture, Lambertian, Laser, Part, Scene, Sensor, simulate
from datagen.errors import InputError


def test_without_occlusion_nothing_is_asked_and_light_is_only_added() -> None:
    """Without occlusion no connection casts a ray: the light is exact where nothing stands in the way, and too much
    elsewhere."""
    axis = bins_of_path(64, 0.3, 0.0)
    wall, plate = rectangle((0, 0, 0), (0, 1, 0), (0, 0, 1)), rectangle((1, 0, 0), (0, -0.3, 0), (0, 0, 0.3))
    bare = Scene.from_parts([Part("wall", wall, Lambertian(0.8), "structure"), Part("plate", plate, Lambertian(0.6))])
    sensor = Sensor((2.0, 0, 1.5), square_pixels([[0, 0.2, 0.6]], 0.1))
    capture = Capture(Laser((2.0, 0, 1.5), [[0, -0.4, 0.5]]), sensor, axis, "exhaustive")
    accuracy = Accuracy(2048, 4, 3, 2)
    on, off = (simulate(bare, capture, replace(accuracy, occlusion=o), seed=1) for o in ("on", "off"))  # type: ignore[arg-type]
    np.testing.assert_allclose(off.total, on.total, rtol=1e-12)
    assert on.total.sum() > 0
    assert off.rays["asked"] == 0 and off.rays["assumed"] == on.rays["asked"] > 0
    room, capture = furnished_box(), one_point_capture(time=axis)
    on, off = (simulate(room, capture, replace(accuracy, occlusion=o), seed=1) for o in ("on", "off"))  # type: ignore[arg-type]
    assert (off.total >= on.total * (1 - 1e-12)).all()
    assert off.total.sum() > 1.001 * on.total.sum()


def test_an_unknown_way_with_occlusion_is_refused() -> None:
    with pytest.raises(InputError, match="occlusion = 'maybe': must be one of auto"):
        Accuracy(occlusion="maybe")  # type: ignore[arg-type]
