"""Replicates that are traced in one call equal replicates traced one by one."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh
from rooms import bins_of_path, rectangle, square_pixels

from datagen import Accuracy, Capture, Lambertian, Laser, Part, Scene, Sensor, simulate
from datagen.records import Transient
from datagen.transport.path_tracing import averages

AXIS = bins_of_path(60, 0.1, 0.0)
DEVICE = np.array([2.0, 0.0, 1.2])
TARGETS = np.array([[0.0, -0.4, 1.0], [0.0, 0.2, 1.3], [2.0, 0.0, 50.0], [0.0, 0.5, 0.6]])
"""Three on the relay wall; the third ray meets nothing."""


def _open_room() -> Scene:
    box = trimesh.creation.box((0.6, 0.5, 0.8))
    box.apply_translation((1.5, -0.6, 0.4))
    wall, floor = rectangle((0, 0, 1), (0, 1.5, 0), (0, 0, 1)), rectangle((2, 0, 0), (2, 0, 0), (0, 1.5, 0))
    return Scene.from_parts(
        [
            Part("relay_wall", wall, Lambertian(0.8), "relay_wall"),
            Part("floor", floor, Lambertian(0.6), "structure"),
            Part("box", box, Lambertian(0.9)),
        ]
    )


def _capture(pairing: str) -> Capture:
    pixels = square_pixels(TARGETS[[0, 1, 3, 3]] + [[0.0, 0.0, 0.1]], 0.2)
    if pairing == "exhaustive":
        pixels = pixels[:3]
    return Capture(Laser(DEVICE, TARGETS), Sensor(DEVICE, pixels, 0.01), AXIS, pairing)  # type: ignore[arg-type]


def _run(pairing: str, bounces: int | None, together: int, monkeypatch: pytest.MonkeyPatch) -> Transient:
    monkeypatch.setattr(averages, "LOOKINS_TOGETHER", together)
    accuracy = Accuracy(lookins=90, fov_samples=3, replicates=8, max_bounces=bounces, direct=True)
    return simulate(_open_room(), _capture(pairing), accuracy, seed=5)


@pytest.mark.parametrize("pairing", ["confocal", "exhaustive"])
@pytest.mark.parametrize("bounces", [3, 5, None])
def test_together_or_one_by_one(pairing: str, bounces: int | None, monkeypatch: pytest.MonkeyPatch) -> None:
    """All replicates at once, in threes, and one by one, of 4 laser points and 12 hidden vertices; and 90 hidden
    vertices, which 8 does not divide."""
    apart = _run(pairing, bounces, 1, monkeypatch)
    assert apart.total[[0, 1, 3]].any(axis=(1, 2)).all() and not apart.total[2].any()
    assert apart.overflow.any()
    for together in (3 * 4 * 12, 1 << 14):
        joint = _run(pairing, bounces, together, monkeypatch)
        scale = apart.total.max()
        np.testing.assert_allclose(joint.total, apart.total, rtol=1e-12, atol=1e-14 * scale)
        # The spread is a difference of large numbers, so rounding shows in it.
        np.testing.assert_allclose(joint.stderr, apart.stderr, rtol=1e-6, atol=1e-9 * scale)
        np.testing.assert_allclose(joint.overflow, apart.overflow, rtol=1e-12)
        for name, part in apart.parts.items():
            np.testing.assert_allclose(joint.parts[name], part, rtol=1e-12, atol=1e-14 * scale)
