"""Wrong types, units and shapes given to public functions: one `InputError` of one line that names the argument; what
is legal and absurd is warned of."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from functools import cache, partial
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import torch
import trimesh

import datagen as dg

CONFIG = Path(__file__).parents[1] / "configs" / "quickstart.yaml"
EYE = (2.0, -1.0, 1.0)
TIME = dg.TimeAxis(bins=64, width_s=4e-10, origin="wall")
LASER = dg.Laser(EYE, [(0, -0.2, 1)])
SENSOR = dg.Sensor.grid(EYE, (0, 0.2, 1), (0, 0.1, 0), (0, 0, 0.1), rows=1, columns=2)
CAPTURE = dg.Capture(LASER, SENSOR, TIME)
FEW = dg.Accuracy(samples=16)
SPAD, EXPOSURE = dg.Spad(), dg.Exposure()
WHITE = dg.Lambertian(0.8)


def wall(scale: float = 1.0) -> dg.Part:
    corners = np.array([(0.0, -1, 0), (0, 1, 0), (0, 1, 2), (0, -1, 2)]) * scale
    return dg.Part("relay_wall", trimesh.Trimesh(corners, [(0, 1, 2), (0, 2, 3)]), WHITE, "relay_wall")


def box(scale: float = 1.0) -> dg.Part:
    bounds = scale * np.array([(1, 0.3, 0.5), (1.5, 0.8, 1)])
    return dg.Part("box", trimesh.creation.box(bounds=bounds), WHITE)


@cache
def room() -> dg.Scene:
    return dg.Scene.from_parts([wall(), box()])


@cache
def config() -> dg.DatasetConfig:
    return dg.load_config(CONFIG)


def meshed(vertices: Any, faces: Any = ((0, 1, 2),)) -> dg.Scene:
    return dg.Scene.from_parts([dg.Part("box", SimpleNamespace(vertices=vertices, faces=faces), WHITE)])


def scene_with(**other: Any) -> dg.Scene:
    fields = dict(vars(room())) | other
    return dg.Scene(**fields)


def detected(transient: Any = None, time: Any = TIME, spad: Any = SPAD, exposure: Any = EXPOSURE, **rest: Any) -> Any:
    return dg.detect(np.zeros(64) if transient is None else transient, time, spad, exposure, **rest)


LIGHT = np.zeros((1, 2, 64))


def transient(**other: Any) -> dg.Transient:
    fields = {"time": TIME, "components": {"primary": LIGHT}, "parts": {}, "stderr": LIGHT, "overflow": LIGHT[..., 0]}
    return dg.Transient(**fields | {"laser_points": np.zeros((1, 3))} | other)


TRIANGLE = np.array([(0.0, 0, 0), (1, 0, 0), (0, 1, 0)])
MESH = wall().mesh
Arguments = dict[str, list[Any]]
WRONG: dict[str, Callable[[], tuple[Callable[..., object], dict[str, Any], Arguments]]] = {
    "Part": lambda: (dg.Part, {"name": "box", "mesh": MESH, "material": WHITE}, {
        "mesh": [None], "name": [3], "material": [0.8], "role": ["furniture"], "pose": ["upright"]}),
    "Pose": lambda: (dg.Pose, {"label": "box", "axes": np.eye(3)}, {"axes": [np.ones((3, 3)), (0, 0, 1)]}),
    "Scene.from_parts": lambda: (dg.Scene.from_parts, {"parts": [wall()]}, {
        "parts": [[], wall(), [wall(), MESH]], "hidden_bounds": [(0, 0, 0)], "relay_wall": [TRIANGLE],
        "parameters": [[("a", 1)]], "attenuation_per_m": ["fog"]}),
    "mesh": lambda: (meshed, {"vertices": TRIANGLE}, {"vertices": [TRIANGLE * 1e30, [(0, 0, 0), (1, 0), (0, 1, 0)],
        TRIANGLE[:, :2]], "area": [np.zeros((3, 3))]}),
    "faces": lambda: (meshed, {"vertices": TRIANGLE}, {"triangle": [[(0.0, 1.0, 1.5)], [(0, 1, 2), (0, 1)]],
        "indices": [[(0, 1, 7)]]}),
    "Scene": lambda: (scene_with, {}, {
        "vertices": [[(0, 0, 0)]], "face_part": [np.zeros(1, np.int32)], "materials": [(WHITE,)]}),
    "Laser": lambda: (dg.Laser, {"position": EYE}, {"targets": [[(0, 0, 1), (0, 1)], (0, 0, 1), [EYE]]}),
    "Sensor": lambda: (dg.Sensor, {"position": EYE, "pixels": SENSOR.pixels, "aperture_radius_m": 0.02}, {
        "aperture_radius_m": ["2cm"], "finite_aperture": [0.1], "pixels": [[(0, 0, 1)]]}),
    "Sensor.grid": lambda: (dg.Sensor.grid, {
        "position": EYE, "center": (0, 0, 1), "right": (0, 1, 0), "up": (0, 0, 1), "rows": 1, "columns": 2}, {
        "rows": [1.5], "columns": [0], "right": [(0, 0, 0)], "up": [(0, -2, 0)]}),
    "TimeAxis": lambda: (dg.TimeAxis, {"bins": 64, "width_s": 1e-10}, {
        "bins": [10**12, 64.0], "width_s": ["100ps"], "start_s": [None], "origin": ["sensor"]}),
    "Capture": lambda: (dg.Capture, {"laser": LASER, "sensor": SENSOR, "time": TIME}, {
        "laser": [SENSOR], "time": [64], "pairing": ["both"]}),
    "Accuracy": lambda: (dg.Accuracy, {}, {"faint_part": ["none"], "direct": ["no"], "secondary": [None]}),
    "simulate": lambda: (dg.simulate, {"scene": room(), "capture": CAPTURE, "accuracy": FEW}, {
        "accuracy": [0.05], "capture": [None], "seed": [1.5]}),
    "simulate_as_printed": lambda: (dg.simulate_as_printed, {"scene": room(), "capture": CAPTURE}, {
        "scene": [None], "settings": [FEW]}),
    "AsPrinted": lambda: (dg.AsPrinted, {}, {"rays": [1.5], "grid": [["angles"]]}),
    "Transient": lambda: (transient, {}, {
        "time": [64], "components": [[LIGHT], {}, {"primary": LIGHT.tolist()}, {"primary": LIGHT[..., 1:]}],
        "parts": [{"box": LIGHT[:, :1]}], "stderr": [None], "overflow": [LIGHT], "laser_points": [np.zeros((1, 2))],
        "seconds": [{"trace": "1 s"}], "rays": [[3]], "samplers": [{"primary": 3}],
        "claimed_error": ["1 %"], "met_target": ["yes"]}),
    "Sample": lambda: (dg.Sample, {"index": 0, "arrays": {}, "parameters": {}, "seconds": {}}, {
        "index": ["first"], "arrays": [[LIGHT], {"depth": [[1.0]]}], "parameter": [None, {"x": [1]}],
        "seconds": [{"scene": "long"}]}),
    "SceneConfig": lambda: (dg.SceneConfig, {}, {"rows": [3], "layout": [{"kind": "attic"}], "contents": [[]]}),
    "DatasetConfig": lambda: (dg.DatasetConfig, {}, {"scenes": ["many"], "capture": [3, {"scan": {"kind": "gird"}}]}),
    "Spad": lambda: (dg.Spad, {}, {"afterpulse_weights": ["0.5"], "paralyzable": [1]}),
    "detect": lambda: (detected, {}, {
        "transient": [SimpleNamespace(total=np.zeros(64)), [[1.0], [1.0, 2.0]]], "time": [1e-10], "spad": [EXPOSURE],
        "exposure": [None], "dtype": ["counts"]}),
    "generate_scene": lambda: (dg.generate_scene, {"spec": config().scene, "seed": 0, "index": 0}, {
        "spec": [config()], "index": [-1]}),
    "capture_for": lambda: (dg.capture_for, {"config": config(), "scene": room()}, {
        "config": [room()], "scene": [None]}),
    "plan_effects": lambda: (dg.plan_effects, {"scene": room(), "capture": CAPTURE, "accuracy": FEW}, {
        "scene": [None], "spad": [EXPOSURE], "transient": [np.zeros(64)], "settings": ["auto"]}),
    "build": lambda: (dg.build, {"config": config(), "path": "out/x.zarr"}, {
        "config": ["x.yaml"], "path": [None], "workers": [1.5], "shards": [[0, 1]], "scene_seconds": ["1 min"],
        "engine": [None]}),
    "TransientDataset": lambda: (dg.TransientDataset, {"path": "nowhere.zarr"}, {
        "path": [None], "no such dataset": ["nowhere.zarr"], "fields": [3, (["depth"],)], "evidence_at_least": ["3"],
        "redraw_noise": ["yes"]}),
    "EpochSampler": lambda: (dg.EpochSampler, {"data": [1, 2]}, {"data": [None], "rank": [2]}),
    "collate": lambda: (dg.collate, {}, {"items": [[], [1, 2]]}),
    "dense": lambda: (dg.dense, {"events": torch.zeros((1, 3)), "counts": torch.zeros(1), "shape": (1, 1, 1)}, {
        "events": [np.zeros((1, 3))], "shape": [3]}),
    "pose turned": lambda: (dg.Pose.upright, {"label": "box"}, {"rotation_deg": ["90°"]}),
}  # fmt: skip
"""Function, arguments that are right, and wrong values of some by name."""
SAYS = {
    "indices": "faces", "triangle": "faces", "area": "vertices", "parameter": "parameters", "no such dataset": "path",
}  # fmt: skip
"""What a message says instead of the argument's name."""
ALONE: dict[str, tuple[str, Callable[[], object]]] = {
    "unknown part": ("'chair'", lambda: room().faces_of("chair")),
    "skew rectangle": ("right and up", lambda: dg.Rectangle.of((0, 0, 0), (1, 0, 0), (1, 1, 0))),
    "rectangle without height": ("right and up", lambda: dg.Rectangle.of((0, 0, 0), (1, 0, 0), (0, 0, 0))),
    "confocal of two pixels": ("confocal", lambda: dg.Capture(LASER, SENSOR, TIME, "confocal")),
    "confocal flood": ("illumination", lambda: dg.Capture(LASER, SENSOR, TIME, "confocal", "flood")),
    "mean without a time axis": ("time", lambda: dg.expected_histogram(np.zeros(64), None, SPAD, EXPOSURE)),
    "configuration of None": ("path", lambda: dg.load_config(None)),
    "scenes of a fraction": ("scenes = 2.5", lambda: config().with_scenes(2.5)),
    "capture_for without a wall": ("relay wall", lambda: dg.capture_for(config(), room())),
    "effect of another name": ("'fog'", lambda: dg.EffectDecisions((), 0.01)["fog"]),
}


def refused(call: Callable[[], object]) -> str:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        with pytest.raises(dg.InputError) as caught:
            call()
    message = str(caught.value)
    assert "\n" not in message and len(message) < 300, message
    return message


@pytest.mark.parametrize("what", WRONG)
def test_wrong_arguments_are_refused_in_one_line_that_names_them(what: str) -> None:
    function, right, wrong = WRONG[what]()
    for name, values in wrong.items():
        for value in values:
            given = right | {SAYS.get(name, name): value}
            message = refused(partial(function, **given))
            assert name in message, (name, value, message)


@pytest.mark.parametrize("what", ALONE)
def test_wrong_calls_are_refused_in_one_line(what: str) -> None:
    name, call = ALONE[what]
    assert name in refused(call)


def lit(target: tuple[float, float, float]) -> dg.Transient:
    return dg.simulate(room(), dg.Capture(dg.Laser(EYE, [(0, -0.2, 1), target]), SENSOR, TIME), FEW)


def in_millimetres() -> dg.Capture:
    place = (2000, -1000, 1000)
    sensor = dg.Sensor.grid(place, (0, 200, 1000), (0, 100, 0), (0, 0, 100), 1, 2)
    return dg.Capture(dg.Laser(place, [(0, -200, 1000)]), sensor, TIME)


ABSURD: dict[str, tuple[str, Callable[[], object]]] = {
    "aperture of 20 m": ("aperture_radius_m = 20", lambda: dg.Sensor(EYE, SENSOR.pixels, 20)),
    "bins of 100 s": ("width_s = 100", lambda: dg.TimeAxis(64, 100)),
    "a laser past everything": (
        "1 of 2 laser rays, the first to Laser.targets\\[1\\], meet nothing",
        lambda: lit((3, 0, 1)),
    ),
    "a laser on an object": (
        "1 of 2 laser points, the first Laser.targets\\[1\\], lie on the object 'box'",
        lambda: lit((1.2, 0.5, 0.9)),
    ),
    "a scene in millimetres": (
        "outside the time axis",
        lambda: dg.simulate(dg.Scene.from_parts([wall(1000), box(1000)]), in_millimetres(), FEW),
    ),
}


@pytest.mark.parametrize("what", ABSURD)
def test_what_is_legal_and_absurd_is_warned_of(what: str) -> None:
    name, call = ABSURD[what]
    with pytest.warns(dg.InputWarning, match=name) as caught:
        call()
    assert len(caught) == 1 and caught[0].filename == __file__


def test_a_keyword_that_was_renamed_is_read() -> None:
    with pytest.warns(DeprecationWarning, match="now called columns") as caught:
        former = dg.Sensor.grid(EYE, (0, 0.2, 1), (0, 0.1, 0), (0, 0, 0.1), rows=1, cols=2)
    assert np.array_equal(former.pixels, SENSOR.pixels) and caught[0].filename == __file__


def test_what_is_usual_is_not() -> None:
    assert (
        transient(samplers={"primary": "paths"}, claimed_error=np.float64(0.01), met_target=np.True_).total is LIGHT
    )
    assert "2 pixels" in repr(transient()) and "\n" not in repr(transient())
    assert dg.SceneConfig(contents=()).contents == () and dg.EffectsConfig().tolerance > 0
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        found = dg.simulate(room(), CAPTURE, dg.Accuracy(samples=1024), seed=np.int64(3))
        dg.Sensor(EYE, SENSOR.pixels.tolist(), np.float32(0.02))
        dg.TimeAxis(np.int32(64), 1e-10)
        dg.detect(torch.zeros(64), TIME, SPAD, EXPOSURE)
    assert found.total.any()
