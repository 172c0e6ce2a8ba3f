"""Datasets of scenes made in Python: read, verified, resumed and exported like any other."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import trimesh
from rooms import rectangle

import datagen as dg
from datagen.config import config_from_mapping
from datagen.errors import InputWarning
from datagen.formats import export
from datagen.pipeline import SceneLight, Setup, sample_from, simulated_light
from datagen.store import verify
from datagen.store.info import info

pytestmark = pytest.mark.usefixtures("builds_here")

QUICK = {"transport": {"samples": 64}, "labels": {"rows": 8, "columns": 8}}
TIME = dg.TimeAxis(bins=64, width_s=4e-10, origin="wall")


def room_of(*parts: dg.Part, **parameters: float) -> dg.Scene:
    """A relay wall x = 0, and parts before it."""
    wall = trimesh.creation.box((0.1, 4, 3)).apply_translation((-0.05, 0, 0))
    front = dg.Rectangle.of((0, 0, 0), (0, 1, 0), (0, 0, 1))
    view = dg.Rectangle.of((0, 1, 0), (0, 0.5, 0), (0, 0, 0.5))
    whole = [dg.Part("wall", wall, dg.Lambertian(0.8), "relay_wall"), *parts]
    return dg.Scene.from_parts(whole, relay_wall=front, hidden_view=view, parameters=parameters)


def room(x: float) -> dg.Scene:
    ball = trimesh.creation.icosphere(2, 0.3).apply_translation((x, 1, 0))
    return room_of(dg.Part("ball", ball, dg.Lambertian(0.6), pose=dg.Pose.upright("sphere")), x_m=x)


def capture(time: dg.TimeAxis = TIME) -> dg.Capture:
    laser = dg.Laser((3, -1, 0), [(0, 0, 0.2), (0, 0, -0.2)])
    sensor = dg.Sensor.grid((3, -1, 0), (0, 0, 0), (0, 0.3, 0), (0, 0, 0.3), rows=1, columns=3)
    return dg.Capture(laser, sensor, time)


def test_own_scenes_become_a_dataset_with_labels(tmp_path: Path) -> None:
    fields = ("histogram", "transient", "depth", "objects")
    made, places = tmp_path / "set", (1.0, 1.5, 1.0)

    def built(places: tuple[float, ...]) -> dg.BuildResult:
        return dg.build_from(map(room, places), made, capture(), fields=fields, settings=QUICK, progress=False)

    assert built(places).complete and not verify(made, deep=True).problems
    data = dg.TransientDataset(made, ("transient", "histogram", "depth", "objects"))
    assert data.classes == ("sphere",)
    assert data.parameters("x_m").tolist() == [*places]
    # One room is in one split.
    split = data.parameters("split")
    assert split[0] == split[2]
    for item, x in zip(data, places, strict=False):
        depth = item["depth"].numpy()
        assert depth[4, 4] == pytest.approx(x - 0.3, abs=0.02)
        assert float(item["transient"].sum()) > 0
        np.testing.assert_allclose(item["object_box_center"][0], [0, 0, x], atol=0.02)
    assert built(places).built == 0
    with pytest.raises(dg.InputError, match="digest"):
        built((1.0, 1.5, 1.1))
    with pytest.raises(dg.InputError, match="made in Python"):
        export(made, tmp_path / "glb", "glb", "1")


def test_light_of_another_simulator_is_stored_and_detected(tmp_path: Path) -> None:
    theirs = np.zeros((2, 3, 64))
    theirs[1, 2, 40] = 1e-12
    own = dg.TimeAxis(bins=64, width_s=4e-10, start_s=1e-9, origin="wall")
    bright = {"detector": {"mode": "ideal", "photons_per_pulse": 1e9, "cycles": 10**6}}
    dg.build_from([(room(1.2), capture(own), theirs)], tmp_path / "theirs", settings=bright, progress=False)
    for redraw_noise in (False, True):
        data = dg.TransientDataset(tmp_path / "theirs", ("transient", "histogram"), redraw_noise=redraw_noise)
        np.testing.assert_allclose(data[0]["transient"], theirs, rtol=1e-6)
        counts = data[0]["histogram"]
        assert int(counts.argmax()) == int(theirs.argmax()) and counts[1, 2, 40] > 100


def test_light_that_enters_as_a_record_is_counted_and_labelled_as_our_own() -> None:
    time = {"bins": 64, "bin_width_ps": 400, "origin": "wall"}
    shape = {"capture": {"scan": {"rows": 2, "columns": 1}, "time": time}}
    config = config_from_mapping(QUICK | shape | {"store": {"fields": ["histogram", "transient", "depth"]}})
    setup = Setup.of(config, 0, room(1.2), capture())
    ours = simulated_light(setup)
    own = sample_from(setup, ours)
    entered = sample_from(setup, SceneLight(ours.transient, ours.effects))
    assert own.arrays.keys() == entered.arrays.keys() and own.parameters.items() == entered.parameters.items()
    for name in own.arrays:
        np.testing.assert_array_equal(own.arrays[name], entered.arrays[name])
    unsplit = sample_from(setup, SceneLight(replace(ours.transient, parts={})))
    assert np.isnan(unsplit.parameters["evidence.ball.significance"])
    assert np.array_equal(unsplit.arrays["depth"], own.arrays["depth"])


def test_scenes_that_form_no_dataset_are_refused(tmp_path: Path) -> None:
    other = capture(dg.TimeAxis(bins=32, width_s=4e-10))
    for scenes, given, settings, piece in (
        ([], capture(), {}, "none given"),
        ([room(1.0)], None, {}, "capture = None: a Capture is needed"),
        ([3], capture(), {}, "a Scene is needed"),
        ([room(1.0), (room(1.0), other)], capture(), {}, "one shape"),
        ([(room(1.0), capture(), np.zeros((2, 3, 5)))], None, {}, "transient"),
        ([room(1.0)], capture(), {"scene": {}}, "leave it out"),
    ):
        with pytest.raises(dg.InputError, match=piece):
            dg.build_from(scenes, tmp_path / "no", given, settings=settings, progress=False)  # type: ignore[arg-type]
    assert not (tmp_path / "no").exists()


def test_a_laser_that_meets_nothing_fails_its_scene(tmp_path: Path) -> None:
    past = dg.Laser((3, -1, 0), [(0, 0, 50), (0, 0, 60)])
    scenes = [room(1.0), (room(1.5), dg.Capture(past, capture().sensor, TIME))]
    with pytest.raises(dg.CheckError, match="1 of 2 scenes"):
        dg.build_from(scenes, tmp_path / "past", capture(), settings=QUICK, progress=False)
    assert "meet no surface" in info(tmp_path / "past")


def test_a_sheet_on_a_wall_is_labelled_whole_and_brings_a_line(tmp_path: Path) -> None:
    """An object in the very plane of a hidden wall: its label has no speckles, and a warning names it."""
    far = trimesh.creation.box((0.1, 1.5, 3)).apply_translation((1.55, 1.2, 0))
    sheet = rectangle((1.5, 1, 0), (0, 0.3, 0), (0, 0, 0.3))
    scene = room_of(dg.Part("sheet", sheet, dg.Lambertian(0.1)), dg.Part("far", far, dg.Lambertian(0.8), "structure"))
    line = r"scene 0: parts 'sheet' and 'far' lie in one place: 'sheet' is taken to lie on 'far'"
    settings = {"transport": {"samples": 256}, "labels": {"rows": 20, "columns": 20}}
    with pytest.warns(InputWarning, match=line):
        dg.build_from(
            [scene], tmp_path / "sheet", capture(), fields=("transient", "depth", "part_id"), settings=settings,
            progress=False,
        )  # fmt: skip
    item = dg.TransientDataset(tmp_path / "sheet", ("transient", "depth", "part_id"))[0]
    # Pixels of 5 cm; the sheet is 60 cm wide and high and in the middle of the view.
    inside = np.zeros((20, 20), bool)
    inside[4:16, 4:16] = True
    np.testing.assert_array_equal(item["part_id"].numpy() == 1, inside)
    assert item["depth"].numpy()[inside] == pytest.approx(1.5, abs=1e-3)
