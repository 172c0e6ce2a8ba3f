"""Sensors that move: on ways that are smooth and free, and each frame is what a sensor that stands there measures."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import datagen as dg
from datagen.capture import SensorWay, capture_for, sensor_way
from datagen.capture.devices import has_elbow_room
from datagen.capture.in_sight import in_plain_sight
from datagen.config import DatasetConfig, config_from_mapping
from datagen.errors import InputError
from datagen.evidence.change import changes_of
from datagen.formats import export
from datagen.pipeline import Setup, sample_of_setup, simulate_sample, simulated_frames
from datagen.records.sample import OF_THE_DEVICE
from datagen.report.preview import preview
from datagen.report.replay import read_scene
from datagen.report.replay import replay as shown_again
from datagen.store import schema_of, verify
from datagen.store.info import info
from scene_library.sightlines import first_faces

FRAMES = 3
HAND = {"kind": "hand", "sway_mm": 20, "sway_deg": 2}
SCAN = {
    "scan": {"rows": 2, "columns": 2, "width_m": 0.3, "height_m": 0.3},
    "time": {"bins": 128, "bin_width_ps": 200},
}
ZONES = {"pairing": "exhaustive", "illumination": "flood", "scan": {"rows": 2, "columns": 2, "width_m": 0.3,
         "height_m": 0.3}, "field_of_view": {"rows": 2, "columns": 2, "width_m": 0.3, "height_m": 0.3},
         "time": {"bins": 128, "bin_width_ps": 200}}  # fmt: skip
BOX = {"kind": "box", "motion": {"kind": "straight", "speed_m_s": 0.2}}


def config_of(motion: dict[str, Any] | None, **sections: Any) -> DatasetConfig:
    capture = dict(sections.pop("capture", SCAN)) | ({} if motion is None else {"motion": motion})
    values: dict[str, Any] = {
        "scenes": 2, "seed": 3, "sequence": {"frames": FRAMES, "rate_hz": 5}, "transport": {"target": 0.2},
        "scene": {"contents": [{"kind": "box"}]}, "capture": capture,
        "detector": {"mode": "ideal", "cycles": 10**5, "photons_per_pulse": 1e9},
        "labels": {"rows": 6, "columns": 6, "voxels": [3, 3, 3]},
        "store": {"fields": ["histogram", "transient", "background_transient", "depth", "objects"]},
    }  # fmt: skip
    return config_from_mapping({**values, **sections})


def made(config: DatasetConfig, index: int = 0) -> tuple[dg.Scene, dg.Capture, SensorWay]:
    scene = dg.scene_for(config, index)
    capture = capture_for(config, scene, config.seed, index)
    way = sensor_way(config, scene, capture, index)
    assert way is not None
    return scene, capture, way


def setup_of(config: DatasetConfig, index: int = 0) -> Setup:
    scene = dg.scene_for(config, index)
    return Setup.of(config, index, scene, capture_for(config, scene, config.seed, index))


@pytest.mark.parametrize("index", range(6))
def test_a_hand_sways_smoothly_and_no_farther_than_asked(index: int) -> None:
    config = config_of({"kind": "hand", "sway_mm": 8, "sway_deg": 1, "fastest_hz": 2})
    _, _, way = made(config, index)
    times = np.linspace(0, 60, 60_001)
    shifts, turns = way.at(times)
    for sway, most in ((shifts, 8e-3), (turns, np.radians(1))):
        size = np.linalg.norm(sway, axis=1)
        assert 0.3 * most < size.max() <= most * (1 + 1e-9)
        # Of sines of 2 Hz at most each derivative is 2π · 2 Hz times the one before at most.
        for order in (1, 2, 3):
            rate = np.diff(sway, order, axis=0) / (times[1] - times[0]) ** order
            assert np.linalg.norm(rate, axis=1).max() <= (4 * np.pi) ** order * most * 1.01
    others = made(config, index + 1)[2].at(times)[0]
    assert abs(np.corrcoef(shifts[:, 0], others[:, 0])[0, 1]) < 0.99


@pytest.mark.parametrize("capture", [SCAN, ZONES, {"device": "vl53l8ch_4x4"}])
def test_laser_and_sensor_move_as_one_rigid_thing(capture: dict[str, Any]) -> None:
    config = config_of(HAND, capture=capture, detector={"cycles": 10})
    _, standing, way = made(config)
    times = np.linspace(0, 0.5, 5)
    shifts, turns = way.at(times)

    def points(of: dg.Capture) -> Any:
        cells = [] if of.laser.cells is None else [of.laser.cells.reshape(-1, 3)]
        places = [
            of.laser.position[None],
            of.laser.targets,
            of.sensor.position[None],
            of.sensor.pixels.reshape(-1, 3),
        ]
        return np.concatenate([*places, *cells])

    before = points(standing)
    for shift, turn, now in zip(shifts, turns, way.captures(standing, times), strict=True):
        np.testing.assert_allclose(now.sensor.position, standing.sensor.position + shift, atol=1e-12)
        after = points(now)
        apart = [np.linalg.norm(each[:, None] - each, axis=-1) for each in (before, after)]
        np.testing.assert_allclose(*apart, atol=1e-12)
        # Rodrigues' formula, about the place of the sensor.
        angle = np.linalg.norm(turn)
        axis, own = turn / angle, before - standing.sensor.position
        due = own * np.cos(angle) + np.cross(axis, own) * np.sin(angle)
        due += np.outer(own @ axis, axis) * (1 - np.cos(angle)) + now.sensor.position
        np.testing.assert_allclose(after, due, atol=1e-12)
        assert now.shape == standing.shape and now.time == standing.time
        assert now.sensor.aperture_radius_m == standing.sensor.aperture_radius_m


def test_a_motion_of_nothing_is_a_sensor_that_stands() -> None:
    still = simulate_sample(config_of(None), 0)
    for motion in ({"kind": "hand", "sway_mm": 0, "sway_deg": 0}, {"kind": "drive", "speed_m_s": 0}):
        sample = simulate_sample(config_of(motion), 0)
        for name, values in still.arrays.items():
            frames = values if name not in OF_THE_DEVICE else np.broadcast_to(values, (FRAMES, *values.shape))
            np.testing.assert_array_equal(sample.arrays[name], frames)
        drawn = {name: value for name, value in sample.parameters.items() if not name.startswith("capture.")}
        np.testing.assert_equal(drawn, dict(still.parameters))
        assert sample.parameters["capture.motion.kind"] == motion["kind"]


@pytest.mark.parametrize("capture", [SCAN, ZONES])
def test_a_frame_is_what_a_sensor_that_stands_there_measures(capture: dict[str, Any]) -> None:
    config = config_of(HAND, capture=capture, scene={"contents": [BOX]})
    setup = setup_of(config)
    sample, light = sample_of_setup(setup), simulated_frames(setup)
    assert setup.captures is not None and setup.times is not None
    effects = light.effects
    for frame, (one, middle) in enumerate(zip(setup.captures, setup.times.middles, strict=True)):
        scene = setup.scene.at(middle)
        lit, _ = effects.apply_transport(scene, one, light.lit.accuracy)
        due = dg.simulate(lit, one, light.lit.accuracy, light.lit.seed)
        np.testing.assert_allclose(
            sample.arrays["transient"][frame], due.total, rtol=1e-6, atol=1e-12 * due.total.max()
        )
        empty = dg.simulate(lit.without(*lit.objects), one, light.lit.accuracy, light.lit.seed)
        np.testing.assert_allclose(sample.arrays["background_transient"][frame], empty.total, rtol=1e-6)
        np.testing.assert_array_equal(sample.arrays["laser_points"][frame], due.laser_points)
        np.testing.assert_array_equal(sample.arrays["sensor_pixels"][frame], one.sensor.pixels)
        np.testing.assert_array_equal(sample.arrays["sensor_position"][frame], one.sensor.position)
        alone = sample_of_setup(replace(setup.at(frame), config=config_of(None, capture=capture), seconds={}))
        for name in ("depth", "laser_normals", "sensor_points"):
            np.testing.assert_array_equal(sample.arrays[name][frame], alone.arrays[name])
    assert np.abs(np.diff(sample.arrays["laser_points"], axis=0)).max() > 1e-3


def test_what_changes_by_an_object_is_its_own_light_where_the_sensor_moves() -> None:
    setup = setup_of(config_of(HAND, scene={"contents": [BOX]}))
    light, (name,) = simulated_frames(setup).frames, setup.scene.moving
    found = changes_of(setup.scene, light, setup.spad, setup.exposure, True)[name]
    whole = changes_of(setup.scene, light, setup.spad, setup.exposure)[name]
    for frame in range(1, FRAMES):
        own = [dg.expected_histogram(light.parts[name][f], light.time, setup.spad, setup.exposure)
               for f in (frame - 1, frame)]  # fmt: skip
        both = sum(
            dg.expected_histogram(light.total(f), light.time, setup.spad, setup.exposure) for f in (frame - 1, frame)
        )
        d = own[1] - own[0]
        due = np.sqrt(np.sum(np.divide(d * d, both, out=np.zeros_like(d), where=both > 0)))
        assert found[frame].significance == pytest.approx(due, rel=1e-3)
        assert found[frame].significance < whole[frame].significance


@pytest.mark.parametrize("kind", ["l_corridor", "corridor_room", "doorway_room", "t_corridor"])
def test_a_drive_is_straight_and_keeps_the_laws_of_rooms(kind: str) -> None:
    driving = {"kind": "drive", "speed_m_s": 0.7}
    config = config_of(
        driving, capture={"device": "tmf8828"}, detector={"cycles": 10}, sequence={"frames": 4, "rate_hz": 4},
        scene={"layout": {"kind": kind}, "contents": [{"kind": "library", "classes": ["mannequin"]}, BOX]},
    )  # fmt: skip
    for index in range(4):
        scene, standing, way = made(config, index)
        times = np.linspace(0, 1, 173)
        captures = way.captures(standing, times)
        places = np.array([one.sensor.position for one in captures])
        speed = np.diff(places, axis=0) / np.diff(times)[:, None]
        np.testing.assert_allclose(speed, np.broadcast_to(speed[0], speed.shape), atol=1e-9)
        assert np.linalg.norm(speed[0]) == pytest.approx(0.7) and abs(speed[0, 2]) < 1e-12
        bearing, wall = np.radians(float(way.parameters["bearing_deg"])), scene.relay_wall
        assert wall is not None
        right, inward = wall.right / np.linalg.norm(wall.right), np.cross(wall.right, wall.up)
        assert speed[0] @ right == pytest.approx(0.7 * np.cos(bearing), abs=1e-9)
        assert speed[0] @ inward / np.linalg.norm(inward) == pytest.approx(-0.7 * np.sin(bearing), abs=1e-9)
        np.testing.assert_array_equal(captures[0].sensor.position, standing.sensor.position)
        hidden = set(scene.objects) - set(in_plain_sight(scene.at(0), places[0], scene.objects))
        assert hidden == set(scene.objects)
        for time_s, place in zip(times[::8].tolist(), places[::8], strict=True):
            now = scene.at(time_s)
            assert has_elbow_room(now.corners, place)
            assert not in_plain_sight(now, place, scene.objects)
        room = scene.at(0).corners[np.array(scene.roles)[scene.face_part] != "object"]
        assert first_faces(room, places[0], places[-1:], slack=0.0)[0] == -1


@pytest.mark.parametrize("kind", ["l_corridor", "corridor_room", "isolated_wall"])
def test_points_count_as_those_of_objects_do(kind: str) -> None:
    """A sensor that is taken to where an object would stand, in rooms that turn left and right."""
    turns = set()
    for index in range(6):
        ways = [{"time_s": 0, "along": 0.4, "across": 0.3, "height_m": 0.9},
                {"time_s": 0.2, "distance_m": 1.0, "across": 0.5, "rotation_deg": 30}]  # fmt: skip
        layout = {"kind": kind, "room_length_m": 3} if kind == "l_corridor" else {"kind": kind}
        config = config_of(
            {"kind": "points", "points": ways}, capture={"device": "tmf8828"}, detector={"cycles": 10},
            scene={"layout": layout, "contents": []},
        )  # fmt: skip
        scene, standing, way = made(config, index)
        box = {"kind": "box", "along": 0.4, "across": 0.3, "width_m": 0.1, "depth_m": 0.1, "height_m": 0.1}
        with_box = config_of(None, scene={"layout": layout, "contents": [box], "minimum_seen": 0})
        there = dg.generate_scene(with_box.scene, with_box.seed, index, clock=with_box.clock)
        turns.add(there.parameters.get("layout.turn"))
        x, y = (there.parameters[f"box.{key}"] for key in ("x_m", "y_m"))
        if np.allclose(there.hidden_bounds, scene.hidden_bounds):
            np.testing.assert_allclose(standing.sensor.position + way.at(np.zeros(1))[0][0], (x, y, 0.9))
        shifts, turned = way.at(np.array([0.1, 0.2, 0.5]))
        np.testing.assert_allclose(turned[:, 2], np.radians([15, 30, 30]))
        np.testing.assert_allclose(shifts[1], shifts[2])
        wall = scene.relay_wall
        assert wall is not None
        end = standing.sensor.position + shifts[1]
        inward = np.cross(wall.right, wall.up)
        assert (end - wall.center) @ inward / np.linalg.norm(inward) == pytest.approx(1.0)
        assert end[2] == pytest.approx(0.9)
    assert kind == "isolated_wall" or turns == {"left", "right"}


@pytest.mark.parametrize(("motion", "more", "words"), [
    (HAND, {"sequence": None}, "capture.motion without sequence, .*: give sequence"),
    (HAND, {"scene": {"layout": {"kind": "given", "digest": "0" * 64, "classes": [], "most_objects": 1},
                      "contents": []}}, "capture.motion with scene.layout.kind = 'given': .*leave motion out"),
    ({"kind": "hand", "sway_mm": -1}, {}, "capture.motion.sway_mm: -1 given; must be ≥ 0"),
    ({"kind": "drive", "speed_m_s": 2000}, {}, "speed_m_s.*≤ 1000"),
    ({"kind": "fly"}, {}, "kind.*fly"),
    ({"kind": "points", "points": [{"time_s": 1, "along": 0.5, "across": 0}] * 2}, {},
     r"points\[1\].time_s = 1 after 1: times must increase"),
    ({"kind": "points", "points": [{"time_s": 1, "along": 0.5}]}, {}, "across, offset_m: one of them is needed"),
    ({"kind": "points", "points": [{"time_s": 1, "along": 0.5, "across": 0}]},
     {"capture": {"device": "tmf8828", "at_objects": {}}}, "at_objects beside motion.kind = 'points'"),
])  # fmt: skip
def test_bad_settings_are_refused_in_one_line(motion: dict[str, Any], more: dict[str, Any], words: str) -> None:
    with pytest.raises(InputError, match=words) as caught:
        config_of(motion, **more)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(("motion", "capture", "words"), [
    ({"kind": "drive", "speed_m_s": 1000}, {"device": "tmf8828"}, "all of 40 ways .*something stands in its way at"),
    ({"kind": "drive", "speed_m_s": 50, "bearing_deg": 90}, {"device": "tmf8828"}, "the way had to be refused"),
    ({"kind": "hand", "sway_deg": 45}, SCAN | {"scan": {"rows": 2, "columns": 2}},
     "all of 40 ways .*leave the relay wall at .*; lower sway_mm"),
    ({"kind": "points", "points": [{"time_s": 0, "distance_m": 60, "across": 0.5}]}, {"device": "tmf8828"},
     "the way had to be refused since its first place is outside of the room"),
    ({"kind": "points", "points": [{"time_s": 0, "along": 0.5, "across": 0.5}]}, SCAN,
     "the way .* since 'box', which has to stay hidden"),
])  # fmt: skip
def test_ways_that_break_a_law_are_refused(motion: dict[str, Any], capture: dict[str, Any], words: str) -> None:
    detector = {"cycles": 10_000}
    with pytest.raises(InputError, match=rf"^capture.motion.kind = '{motion['kind']}': in scene 0 {words}"):
        setup_of(config_of(motion, capture=capture, detector=detector))


def test_only_a_sensor_that_moves_has_frames_of_its_own() -> None:
    moving, still = config_of(HAND), config_of(None)
    assert "motion" not in still.model_dump(mode="json")["capture"]
    assert moving.fingerprint() != still.fingerprint()
    for config in (moving, still):
        schema = schema_of(config).by_name
        arrays = simulate_sample(config, 1).arrays
        for name, field in schema.items():
            assert arrays[name].shape == field.shape, name
        framed = {name for name in OF_THE_DEVICE if schema[name].dims[1] == "frame"}
        assert framed == (set(OF_THE_DEVICE) if config is moving else set())


def test_a_dataset_of_a_moving_sensor_opens_everywhere(tmp_path: Path) -> None:
    config = config_of(HAND)
    dg.build(config, tmp_path / "moving.zarr")
    sample = simulate_sample(config, 1)
    path = tmp_path / "moving.zarr"
    windows = dg.TransientDataset(path, ("histogram", "laser_points", "relay_wall"), frames=2, frame_step=1)
    item = windows[3]
    np.testing.assert_array_equal(item["laser_points"], sample.arrays["laser_points"][1:])
    assert item["relay_wall"].shape == (3, 3)
    volumes = dg.TransientDataset(path, "histogram", representation="volume", voxels=(4, 4, 4))[1]["volume"]
    assert volumes.shape == (FRAMES, 4, 4, 4) and np.isfinite(volumes.numpy()).all()
    assert dg.replay(path, 1).arrays["sensor_points"].shape == (FRAMES, 4, 3)
    with np.load(export(path, tmp_path / "npz", "npz", [1])[0]) as file:
        np.testing.assert_array_equal(file["laser_points"], sample.arrays["laser_points"])
    for kind in ("glb", "mat", "tal"):
        assert len(export(path, tmp_path / kind, kind, [1])) == FRAMES
    again = shown_again(read_scene(path, 1).at_frame(2))
    assert again.difference == pytest.approx(0, abs=1e-6) and again.moved_m < 1e-9
    assert "3 of each scene, 5 a second, laser points in the order raster; the sensor moves (hand)" in info(path)
    np.testing.assert_array_equal(again.capture.sensor.position, sample.arrays["sensor_position"][2])
    assert preview(path, tmp_path / "page.html", 1).exists()
    opened = pytest.importorskip("xarray").open_zarr(path / "data.zarr", chunks=None)
    np.testing.assert_array_equal(opened["laser_points"][1], sample.arrays["laser_points"])


def given(config: DatasetConfig, path: Path, scenes: list[Any]) -> Path:
    """A dataset of scenes that are given, with the sections of a configuration."""
    plain = config.model_dump(mode="json")
    settings = {name: plain[name] for name in ("transport", "detector", "labels")}
    fields = tuple(config.store.fields)
    dg.build_from(scenes, path, fields=fields, seed=config.seed, settings=settings, progress=False)
    return path


def test_captures_given_for_each_frame_are_as_those_of_a_sensor_that_is_drawn(tmp_path: Path) -> None:
    """Also beside one for all frames, whose light is then what it is alone."""
    config, still = config_of(HAND, scene={"contents": [BOX]}), config_of(None, scene={"contents": [BOX]})
    setups, clock = [setup_of(config, index) for index in (0, 1)], config.clock
    stands = setup_of(still, 1)
    scenes = [(one.scene, one.captures, clock) for one in setups]
    path = given(config, tmp_path / "moving", [*scenes[:1], (stands.scene, stands.capture, clock)])
    data = dg.TransientDataset(path, tuple(schema_of(config).by_name), counts="stored")
    for index, due in ((0, simulate_sample(config, 0).arrays), (1, simulate_sample(still, 1).arrays)):
        item = data[index]
        assert {*item} == {*due, "scene"}
        for name, values in due.items():
            found, of = item[name].numpy(), data.shape(name)
            assert found.shape == of, name
            np.testing.assert_array_equal(found, np.broadcast_to(values.astype(found.dtype), of), name)
    assert not np.array_equal(data[0]["laser_points"][0], data[0]["laser_points"][1])
    assert data.parameters("capture.motion.kind").tolist() == ["given", "given"]
    assert verify(path, deep=True).problems == () and preview(path, tmp_path / "page.html", 0).exists()
    with pytest.raises(InputError, match=r"scene\.layout\.digest"):
        given(config, path, [scenes[1], (stands.scene, stands.capture, clock)])


def test_wrong_captures_of_frames_are_one_line(tmp_path: Path) -> None:
    setup = setup_of(config_of(HAND))
    scene, clock, captures = setup.scene, config_of(HAND).clock, setup.captures
    assert captures is not None
    one = captures[0]
    bins = replace(one, time=replace(one.time, bins=64))
    fewer = one.excerpt(np.arange(3))
    flood = setup_of(config_of(HAND, capture=ZONES)).captures
    assert flood is not None
    lit = [*flood[:2], replace(flood[2], laser=flood[2].laser.take(np.arange(3)))]
    for given_captures, words in (
        (captures[:2], r"^scenes\[0\]: capture: 2 given for 3 frames; give one, or one for each frame"),
        ([], r"^scenes\[0\]: capture: 0 given for 3 frames"),
        ([one, one, bins], r"^scenes\[0\]: capture\[2\].shape = \(4, 1, 64\): that of .*\[0\] is \(4, 1, 128\)"),
        ([one, fewer, one], r"^scenes\[0\]: capture\[1\].shape = \(3, 1, 128\)"),
        ([one, replace(one, time=replace(one.time, start_s=1e-9)), one], r"^scenes\[0\]: capture\[1\].time = "),
        (lit, r"^scenes\[0\]: capture\[2\].laser.targets = 3: that of .* is 4"),
        ([one, None, one], r"^scenes\[0\]: capture\[1\] = None"),
    ):  # fmt: skip
        with pytest.raises(InputError, match=words) as caught:
            dg.build_from([(scene, given_captures, clock)], tmp_path / "no", progress=False)  # type: ignore[list-item]
        assert "\n" not in str(caught.value)
    with pytest.raises(InputError, match=r"^scenes\[0\]: 3 captures without a clock"):
        dg.build_from([(scene, captures)], tmp_path / "no", progress=False)  # type: ignore[list-item]
    with pytest.raises(InputError, match=r"capture.motion.kind = 'given': build_from writes it"):
        config_of({"kind": "given"})
    assert not (tmp_path / "no").exists()
