"""Laser and sensor at the scene's own place and elsewhere, and places that are refused."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from test_scans import SQUARE_ROOM, configured

import datagen as dg
from datagen.building.input_check import check_inputs
from datagen.config import config_from_mapping
from datagen.errors import InputError
from datagen.records import Capture, Scene

BOX = {"kind": "box", "width_m": 0.4, "depth_m": 0.4, "height_m": 1.0, "along": 0.6, "across": 0.5, "rotation_deg": 0}
"""A box 4.8 m ahead and 2.5 m to the left of the device, behind the inner corner 3 m ahead and 1 m to the left."""
PATCH = {"pairing": "exhaustive", "field_of_view": {"rows": 2, "columns": 2, "width_m": 1.5, "height_m": 1.5}}


def furnished() -> Scene:
    spec = {"scene": {**SQUARE_ROOM, "contents": [BOX]}}
    return dg.generate_scene(config_from_mapping(spec).scene, seed=5, index=0)


def fitted(scene: Scene, **capture: Any) -> Capture:
    return dg.capture_for(configured({"rows": 2, "columns": 2, "width_m": 1.5}, **capture), scene)


@pytest.mark.parametrize("pairing", [{}, PATCH], ids=["confocal", "exhaustive"])
def test_laser_and_sensor_stand_where_they_are_put(pairing: dict[str, Any]) -> None:
    scene = furnished()
    device = scene.device_position
    assert device is not None
    own = fitted(scene, **pairing)
    np.testing.assert_array_equal([own.laser.position, own.sensor.position], [device, device])
    apart = fitted(scene, laser_offset_m=[-0.5, 0.3, 0.2], sensor_position_m=[0.4, -0.2, 1.5], **pairing)
    np.testing.assert_allclose(apart.laser.position, device + np.array([-0.5, 0.3, 0.2]))
    np.testing.assert_array_equal(apart.sensor.position, [0.4, -0.2, 1.5])
    np.testing.assert_array_equal(apart.laser.targets, own.laser.targets)
    np.testing.assert_array_equal(apart.sensor.pixels, own.sensor.pixels)


@pytest.mark.parametrize("device", ["laser", "sensor"])
@pytest.mark.parametrize(
    ("offset", "words"),
    [
        ([7.0, 0.0, 0.0], "behind the plane of the relay wall"),
        ([0.0, 3.0, 0.0], "the part 'walls' hides"),
        ([0.0, 0.0, 5.0], "the part 'ceiling' hides"),
        ([2.9, 0.8, 0.0], "the object 'box' is in plain sight"),
    ],
)
def test_impossible_places_are_refused(device: str, offset: list[float], words: str) -> None:
    scene = furnished()
    assert scene.device_position is not None
    place = (scene.device_position + offset).tolist()
    for key, value, pairing in ((f"{device}_offset_m", offset, {}), (f"{device}_position_m", place, PATCH)):
        with pytest.raises(InputError) as caught:
            fitted(scene, **{key: value}, **pairing)
        assert str(caught.value).startswith(f"capture.{key}: ")
        assert words in str(caught.value)
        assert "\n" not in str(caught.value)


def test_one_place_for_each_device() -> None:
    for device in ("laser", "sensor"):
        with pytest.raises(InputError, match=f"{device}_position_m.*{device}_offset_m"):
            configured({}, **{f"{device}_position_m": [0, 0, 1], f"{device}_offset_m": [0, 0, 0]})


def test_a_listed_point_may_be_on_another_surface_but_not_behind_one() -> None:
    scene = furnished()
    capture = dg.capture_for(configured({"kind": "points", "points_m": [[4, 0, 0], [0, 0]]}), scene)
    transient = dg.simulate(scene, capture, dg.Accuracy(samples=16))
    np.testing.assert_allclose(transient.laser_points[0], [4, 0, 0], atol=1e-9)
    for behind in ([4, 0, -0.5], [5.0, 2.5, 1.2]):
        with pytest.raises(InputError, match=r"capture\.scan\.points_m: .* hides 1 of 1 laser points"):
            dg.capture_for(configured({"kind": "points", "points_m": [behind]}), scene)


def test_a_scene_without_a_place_for_the_device_needs_one() -> None:
    scene = furnished()
    bare = Scene(**{**scene.__dict__, "device_position": None})
    with pytest.raises(InputError, match=r"capture\.laser_position_m: missing"):
        fitted(bare)
    assert fitted(bare, laser_position_m=[0, 0, 1], sensor_position_m=[0, 0, 1]).shape[0] == 4


def test_a_later_scene_that_does_not_fit_is_refused_before_a_build() -> None:
    """With the laser 0.55 m to the side, the objects of the first scenes are hidden, and one of a later scene is
    not."""
    capture = {"scan": {"rows": 2, "columns": 2}, "laser_offset_m": [0.0, 0.55, 0.0]}
    settings = {"seed": 3, "scene": {"layout": {"kind": "l_corridor"}}, "capture": capture}
    config = config_from_mapping({**settings, "scenes": 12})

    def fits(index: int) -> bool:
        try:
            dg.capture_for(config, dg.generate_scene(config.scene, config.seed, index), index=index)
        except InputError:
            return False
        return True

    first = [fits(index) for index in range(12)].index(False)
    assert first > 0
    check_inputs(config_from_mapping({**settings, "scenes": first}))
    with pytest.raises(
        InputError, match=rf"^scene {first} \(seed 3\): capture\.laser_offset_m: from .* in plain sight; "
    ):
        check_inputs(config_from_mapping({**settings, "scenes": 12}))


def test_an_object_with_a_visible_corner_is_in_plain_sight() -> None:
    """Random points on the surface would miss so small a part."""
    scene = furnished()
    corner = np.array([3.0, 1.0])
    # The corner of the box that becomes visible first, seen a millimetre past the edge of the wall.
    box = scene.corners[scene.faces_of("box")].reshape(-1, 3)
    bearing = (box[:, 1] - corner[1]) / (box[:, 0] - corner[0])
    first = box[np.argmin(bearing)]
    slope = (first[1] - corner[1]) / (first[0] - corner[0])
    for past, seen in ((-1e-3, False), (1e-3, True)):
        eye = [0.5, float(corner[1] - slope * (corner[0] - 0.5) - past), 1.0]
        if seen:
            with pytest.raises(InputError, match="plain sight"):
                fitted(scene, sensor_position_m=eye)
        else:
            fitted(scene, sensor_position_m=eye)
