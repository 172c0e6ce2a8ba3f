"""Laser and sensor anywhere but where the scene puts them: accepted only where they still look around the corner."""

from __future__ import annotations

import numpy as np
from crossing_counts import crossing_counts
from room_laws import assert_hidden_from, without_clutter

from datagen.capture import capture_for
from datagen.config import config_from_mapping
from datagen.errors import InputError
from datagen.records import Scene

REFUSALS = ("behind the plane of the relay wall", "hides", "in plain sight", "outside the room")


def assert_moved_devices(scene: Scene, rng: np.random.Generator) -> bool:
    """Fit a capture whose laser and sensor stand off the scene's device; whether it was accepted.

    Accepted, every laser point and every pixel's middle is in free sight and no object is; refused, it says why.
    """
    reach = float(rng.choice([0.05, 0.3, 1.0]))
    laser, sensor = (rng.uniform(-reach, reach, 3) * [1.0, 1.0, 0.5] for _ in range(2))
    capture = {
        "scan": {"rows": 3, "columns": 3},
        "laser_offset_m": [float(x) for x in laser],
        "sensor_offset_m": [float(x) for x in sensor],
    }
    config = config_from_mapping({"capture": capture})
    try:
        fitted = capture_for(config, scene)
    except InputError as error:
        assert any(reason in str(error) for reason in REFUSALS), error
        assert "_offset_m" in str(error), error
        assert "\n" not in str(error)
        return False
    for eye, points in (
        (fitted.laser.position, fitted.laser.targets),
        (fitted.sensor.position, fitted.sensor.pixels.mean(axis=1)),
    ):
        before = points + 1e-3 * (eye - points)
        assert not crossing_counts(without_clutter(scene), eye, before).any(), (
            "a point of the capture is out of sight"
        )
        assert_hidden_from(scene, eye, rng)
    return True
