"""Frames that are simulated by themselves: what sequences are where nothing can be shared, and their record."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import datagen as dg
from datagen.errors import InputError
from datagen.transport.sequences import light_of_frames, times_of
from tests.sequences.rooms_that_move import DEVICE, box, capture, room

PATH = dg.Path((0.0, 1.0), [(1.5, 0.3, 1.2), (1.6, -0.5, 1.2)], (0, 40))
SCENE = room(dg.Part("box", box(), dg.Lambertian(0.4), path=PATH))
CLOCK = dg.Clock(frames=3, rate_hz=3)
SHORT_S = 1e-6
"""An exposure in which nothing moves."""


@pytest.mark.parametrize("accuracy", [dg.Accuracy(target=0.05), dg.Accuracy(samples=512, direct=True)])
def test_a_frame_is_the_scene_of_its_middle(accuracy: dg.Accuracy) -> None:
    scan = capture()
    times, _ = times_of(scan, CLOCK, None)
    light = light_of_frames(SCENE, [scan] * 3, times, SHORT_S, accuracy, 5)
    for f in range(3):
        due, found = dg.simulate(SCENE.at(times[f].mean()), scan, accuracy, 5), light.frame(f)
        np.testing.assert_array_equal(light.total(f), due.total)
        np.testing.assert_array_equal(found.parts["box"], due.parts["box"])
        np.testing.assert_array_equal(found.stderr, due.stderr)
        assert found.relative_error == pytest.approx(due.relative_error) and found.met_target == due.met_target
    assert not light.static.any() and all(way.startswith("frames: ") for way in light.samplers.values())
    assert light.frames == 3 and light.times_s.shape == (3, 9)


def test_a_sensor_that_moves_has_a_capture_for_each_frame() -> None:
    scan = capture()
    shifted = [replace(scan, sensor=dg.Sensor(np.add(DEVICE, (0.1 * f, 0, 0)), scan.sensor.pixels)) for f in range(3)]
    light = dg.simulate_sequence(SCENE, shifted, CLOCK, dg.Accuracy(target=0.05), 1, exposure_s=SHORT_S)
    times, _ = times_of(scan, CLOCK, SHORT_S)
    due = dg.simulate(SCENE.at(times[2].mean()), shifted[2], dg.Accuracy(target=0.05), 1)
    np.testing.assert_array_equal(light.total(2), due.total)


def test_what_cannot_be_simulated_is_refused_in_a_line() -> None:
    scan = capture()
    with pytest.raises(InputError, match="2 given for 3 frames"):
        dg.simulate_sequence(SCENE, [scan] * 2, CLOCK)
    with pytest.raises(InputError, match=r"capture\[1\].shape"):
        dg.simulate_sequence(SCENE, [scan, capture(side=2), scan], CLOCK)
    with pytest.raises(InputError, match=r"Clock.rate_hz = 3.*fits"):
        dg.simulate_sequence(SCENE, scan, CLOCK, exposure_s=0.1)
    light = dg.simulate_sequence(SCENE, scan, CLOCK, dg.Accuracy(target=0.2))
    with pytest.raises(InputError, match="frame = 3"):
        light.total(3)
    with pytest.raises(InputError, match="frame = 0"):
        light.change(0)
