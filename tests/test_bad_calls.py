"""Wrong types, units and shapes given to public functions: one `InputError` of one line that names the argument; what
is legal and absurd is warned of."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from functools import cache
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
FEW = dg.Accuracy(lookins=16, fov_samples=1)
SPAD, EXPOSURE = dg.Spad(), dg.Exposure()
WHITE = dg.Lambertian(0.8)
NAN, HUGE = float("nan"), 10**400


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


def spend(**other: Any) -> dg.Spend:
    of = {"lookins": {"primary": 16.0}, "share": {"primary": 1.0}, "way": {"primary": "walk"}}
    rest = {"fov_samples": {"primary": 4}, "rounds": 1, "cost": 1e3, "outcome": "done"}
    return dg.Spend(**of | rest | other)


TRIANGLE = np.array([(0.0, 0, 0), (1, 0, 0), (0, 1, 0)])
BAD: dict[str, tuple[str, Callable[[], object]]] = {
    # Parts and scenes
    "part without a mesh": ("mesh", lambda: dg.Part("box", None, WHITE)),
    "part named by a number": ("name", lambda: dg.Part(3, wall().mesh, WHITE)),
    "part with an albedo": ("material", lambda: dg.Part("box", wall().mesh, 0.8)),
    "part of no role": ("role", lambda: dg.Part("box", wall().mesh, WHITE, "furniture")),
    "part with a pose of text": ("pose", lambda: dg.Part("box", wall().mesh, WHITE, pose="upright")),
    "skew pose": ("axes", lambda: dg.Pose("box", np.ones((3, 3)))),
    "pose of one axis": ("axes", lambda: dg.Pose("box", (0, 0, 1))),
    "pose turned by text": ("rotation_deg", lambda: dg.Pose.upright("box", "90°")),
    "no parts": ("no parts", lambda: dg.Scene.from_parts([])),
    "a part alone": ("parts", lambda: dg.Scene.from_parts(wall())),
    "a mesh among parts": ("parts[1]", lambda: dg.Scene.from_parts([wall(), wall().mesh])),
    "vertices of 1e30": ("vertices", lambda: meshed(TRIANGLE * 1e30)),
    "ragged vertices": ("vertices", lambda: meshed([(0, 0, 0), (1, 0), (0, 1, 0)])),
    "vertices in a plane": ("vertices", lambda: meshed(TRIANGLE[:, :2])),
    "faces of fractions": ("triangle", lambda: meshed(TRIANGLE, [(0.0, 1.0, 1.5)])),
    "faces out of range": ("indices", lambda: meshed(TRIANGLE, [(0, 1, 7)])),
    "ragged faces": ("triangle", lambda: meshed(TRIANGLE, [(0, 1, 2), (0, 1)])),
    "no area": ("area", lambda: meshed(np.zeros((3, 3)))),
    "bounds of one corner": ("hidden_bounds", lambda: dg.Scene.from_parts([wall()], hidden_bounds=(0, 0, 0))),
    "relay wall of corners": ("relay_wall", lambda: dg.Scene.from_parts([wall()], relay_wall=TRIANGLE)),
    "parameters in a list": ("parameters", lambda: dg.Scene.from_parts([wall()], parameters=[("a", 1)])),
    "attenuation of text": ("attenuation_per_m", lambda: dg.Scene.from_parts([wall()], attenuation_per_m="fog")),
    "scene of lists": ("vertices", lambda: scene_with(vertices=[(0, 0, 0)])),
    "scene of too few faces": ("face_part", lambda: scene_with(face_part=np.zeros(1, np.int32))),
    "scene of too few materials": ("materials", lambda: scene_with(materials=(WHITE,))),
    "unknown part": ("'chair'", lambda: room().faces_of("chair")),
    "skew rectangle": ("right and up", lambda: dg.Rectangle.of((0, 0, 0), (1, 0, 0), (1, 1, 0))),
    "rectangle without height": ("right and up", lambda: dg.Rectangle.of((0, 0, 0), (1, 0, 0), (0, 0, 0))),
    # Materials
    # Capture
    "ragged lasers": ("targets", lambda: dg.Laser(EYE, [(0, 0, 1), (0, 1)])),
    "one target": ("targets", lambda: dg.Laser(EYE, (0, 0, 1))),
    "target at the laser": ("targets", lambda: dg.Laser(EYE, [EYE])),
    "aperture with a unit": ("aperture_radius_m", lambda: dg.Sensor(EYE, SENSOR.pixels, "2cm")),
    "finite aperture of a number": ("finite_aperture", lambda: dg.Sensor(EYE, SENSOR.pixels, 0.02, 0.1)),
    "pixels without corners": ("pixels", lambda: dg.Sensor(EYE, [(0, 0, 1)])),
    "half a row": ("rows", lambda: dg.Sensor.grid(EYE, (0, 0, 1), (0, 1, 0), (0, 0, 1), 1.5, 2)),
    "no column": ("columns", lambda: dg.Sensor.grid(EYE, (0, 0, 1), (0, 1, 0), (0, 0, 1), 1, 0)),
    "a grid of no width": ("right = ", lambda: dg.Sensor.grid(EYE, (0, 0, 1), (0, 0, 0), (0, 0, 1), 1, 1)),
    "a grid along a line": ("and up = ", lambda: dg.Sensor.grid(EYE, (0, 0, 1), (0, 1, 0), (0, -2, 0), 1, 1)),
    "1e12 bins": ("bins", lambda: dg.TimeAxis(10**12, 1e-10)),
    "bins of a fraction": ("bins", lambda: dg.TimeAxis(64.0, 1e-10)),
    "width with a unit": ("width_s", lambda: dg.TimeAxis(64, "100ps")),
    "start of None": ("start_s", lambda: dg.TimeAxis(64, 1e-10, None)),
    "origin elsewhere": ("origin", lambda: dg.TimeAxis(64, 1e-10, origin="sensor")),
    "swapped capture": ("laser", lambda: dg.Capture(SENSOR, LASER, TIME)),
    "capture without time": ("time", lambda: dg.Capture(LASER, SENSOR, 64)),
    "capture of no pairing": ("pairing", lambda: dg.Capture(LASER, SENSOR, TIME, "both")),
    "confocal of two pixels": ("confocal", lambda: dg.Capture(LASER, SENSOR, TIME, "confocal")),
    "confocal flood": ("illumination", lambda: dg.Capture(LASER, SENSOR, TIME, "confocal", "flood")),
    # Accuracy and transport
    "faint part of text": ("faint_part", lambda: dg.Accuracy(target=0.02, faint_part="none")),
    "direct of text": ("direct", lambda: dg.Accuracy(direct="no")),
    "secondary of None": ("secondary", lambda: dg.Accuracy(secondary=None)),
    "accuracy of a number": ("accuracy", lambda: dg.simulate(room(), CAPTURE, 0.05)),
    "capture of None": ("capture", lambda: dg.simulate(room(), None, FEW)),
    "seed of 1.5": ("seed", lambda: dg.simulate(room(), CAPTURE, FEW, seed=1.5)),
    "as printed of nothing": ("scene", lambda: dg.simulate_as_printed(None, CAPTURE)),
    "as printed with an accuracy": ("settings", lambda: dg.simulate_as_printed(room(), CAPTURE, FEW)),
    "as printed of half a ray": ("rays", lambda: dg.AsPrinted(rays=1.5)),
    "as printed of a list": ("grid", lambda: dg.AsPrinted(grid=["angles"])),
    # Records that the stages hand on
    "transient of a time axis's bins": ("Transient.time", lambda: transient(time=64)),
    "components in a list": ("Transient.components", lambda: transient(components=[LIGHT])),
    "no components": ("Transient.components", lambda: transient(components={})),
    "components of lists": ("'primary'", lambda: transient(components={"primary": LIGHT.tolist()})),
    "components of other bins": ("'primary'", lambda: transient(components={"primary": LIGHT[..., 1:]})),
    "parts of another scan": ("Transient.parts['box']", lambda: transient(parts={"box": LIGHT[:, :1]})),
    "errors of None": ("Transient.stderr", lambda: transient(stderr=None)),
    "overflow of all bins": ("Transient.overflow", lambda: transient(overflow=LIGHT)),
    "laser points in a plane": ("Transient.laser_points", lambda: transient(laser_points=np.zeros((1, 2)))),
    "stages by text": ("Transient.seconds", lambda: transient(seconds={"trace": "1 s"})),
    "rays in a list": ("Transient.rays", lambda: transient(rays=[3])),
    "spend of a number": ("Transient.spend", lambda: transient(spend=3)),
    "bound of text": ("Transient.error_bound", lambda: transient(error_bound="1 %")),
    "met in words": ("Transient.met_target", lambda: transient(met_target="yes")),
    "lookins in a list": ("Spend.lookins", lambda: spend(lookins=[3])),
    "share of text": ("Spend.share", lambda: spend(share={"primary": "all"})),
    "way by number": ("Spend.way", lambda: spend(way={"primary": 3})),
    "ways of others": ("Spend.way", lambda: spend(way={"secondary": "walk"})),
    "half a round": ("Spend.rounds", lambda: spend(rounds=1.5)),
    "cost of text": ("Spend.cost", lambda: spend(cost="much")),
    "outcome of None": ("Spend.outcome", lambda: spend(outcome=None)),
    "sample of no number": ("Sample.index", lambda: dg.Sample("first", {}, {}, {})),
    "arrays in a list": ("Sample.arrays", lambda: dg.Sample(0, [LIGHT], {}, {})),
    "arrays of lists": ("Sample.arrays['depth']", lambda: dg.Sample(0, {"depth": [[1.0]]}, {}, {})),
    "parameters of None": ("Sample.parameters", lambda: dg.Sample(0, {}, None, {})),
    "a parameter in a list": ("parameter x", lambda: dg.Sample(0, {}, {"x": [1]}, {})),
    "stages in words": ("Sample.seconds", lambda: dg.Sample(0, {}, {}, {"scene": "long"})),
    # Configuration made in Python
    "a key of another section": ("SceneConfig: rows: unknown key", lambda: dg.SceneConfig(rows=3)),
    "an unknown layout": ("layout: kind = 'attic'", lambda: dg.SceneConfig(layout={"kind": "attic"})),
    "objects in a list": ("SceneConfig: contents", lambda: dg.SceneConfig(contents=[])),
    "scenes in words": ("DatasetConfig: scenes = 'many'", lambda: dg.DatasetConfig(scenes="many")),
    "a section of a number": ("DatasetConfig: capture = 3", lambda: dg.DatasetConfig(capture=3)),
    "a scan of no kind": (
        "DatasetConfig: capture.scan: kind = 'gird'", lambda: dg.DatasetConfig(capture={"scan": {"kind": "gird"}}),
    ),
    # Detector
    "weights of a number": ("afterpulse_weights", lambda: dg.Spad(afterpulse_weights="0.5")),
    "paralyzable of 1": ("paralyzable", lambda: dg.Spad(paralyzable=1)),
    "transient itself": ("transient", lambda: detected(SimpleNamespace(total=np.zeros(64)))),
    "ragged transient": ("transient", lambda: detected([[1.0], [1.0, 2.0]])),
    "time of a number": ("time", lambda: detected(time=1e-10)),
    "swapped spad and exposure": ("spad", lambda: detected(spad=EXPOSURE, exposure=SPAD)),
    "no exposure": ("exposure", lambda: detected(exposure=None)),
    "counts of text": ("dtype", lambda: detected(dtype="counts")),
    "mean without a time axis": ("time", lambda: dg.expected_histogram(np.zeros(64), None, SPAD, EXPOSURE)),
    # Configuration, scenes, effects
    "configuration of None": ("path", lambda: dg.load_config(None)),
    "configuration that is nowhere": ("no such file", lambda: dg.load_config("nowhere.yaml")),
    "scenes of a fraction": ("--scenes", lambda: config().with_scenes(2.5)),
    "a scene of the whole configuration": ("spec", lambda: dg.generate_scene(config(), 0, 0)),
    "scene -1": ("index", lambda: dg.generate_scene(config().scene, 0, -1)),
    "swapped capture_for": ("config", lambda: dg.capture_for(room(), config())),
    "capture_for without a scene": ("scene", lambda: dg.capture_for(config(), None)),
    "capture_for without a wall": ("relay wall", lambda: dg.capture_for(config(), room())),
    "effects of nothing": ("scene", lambda: dg.plan_effects(None, CAPTURE)),
    "effects of an exposure": ("spad", lambda: dg.plan_effects(room(), CAPTURE, FEW, EXPOSURE)),
    "effects of an array": (
        "transient", lambda: dg.plan_effects(room(), CAPTURE, FEW, SPAD, transient=np.zeros(64)),
    ),
    "effects set by text": ("settings", lambda: dg.plan_effects(room(), CAPTURE, settings="auto")),
    "effect of another name": ("'fog'", lambda: dg.EffectDecisions((), 0.01)["fog"]),
    # Building and loading
    "build of a path": ("config", lambda: dg.build("x.yaml", "out/x.zarr")),
    "build into None": ("path", lambda: dg.build(config(), None)),
    "half a worker": ("--workers", lambda: dg.build(config(), "out/x.zarr", workers=1.5)),
    "shards in a list": ("shards", lambda: dg.build(config(), "out/x.zarr", shards=[0, 1])),
    "seconds of text": ("scene_seconds", lambda: dg.build(config(), "out/x.zarr", scene_seconds="1 min")),
    "engine of None": ("--engine", lambda: dg.build(config(), "out/x.zarr", engine=None)),
    "dataset of None": ("path", lambda: dg.TransientDataset(None)),
    "dataset nowhere": ("no such dataset", lambda: dg.TransientDataset("nowhere.zarr")),
    "fields of a number": ("fields", lambda: dg.TransientDataset("nowhere.zarr", fields=3)),
    "fields in fields": ("fields = ['depth']", lambda: dg.TransientDataset("nowhere.zarr", fields=(["depth"],))),
    "evidence of text": (
        "evidence_at_least = '3'", lambda: dg.TransientDataset("nowhere.zarr", evidence_at_least="3"),
    ),
    "noise of text": ("redraw_noise", lambda: dg.TransientDataset("nowhere.zarr", redraw_noise="yes")),
    "sampler of nothing": ("data", lambda: dg.EpochSampler(None)),
    "rank beyond ranks": ("rank", lambda: dg.EpochSampler([1, 2], rank=2, ranks=2)),
    "empty batch": ("items", lambda: dg.collate([])),
    "batch of numbers": ("items", lambda: dg.collate([1, 2])),
    "events of an array": ("events", lambda: dg.dense(np.zeros((1, 3)), torch.zeros(1), (1, 1, 1))),
    "shape of a number": ("shape", lambda: dg.dense(torch.zeros((1, 3)), torch.zeros(1), 3)),
}  # fmt: skip


@pytest.mark.parametrize("what", BAD)
def test_it_is_refused_in_one_line_that_names_the_argument(what: str) -> None:
    name, call = BAD[what]
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        with pytest.raises(dg.InputError) as caught:
            call()
    message = str(caught.value)
    assert name in message and "\n" not in message and len(message) < 300, message


def lit(target: tuple[float, float, float]) -> dg.Transient:
    return dg.simulate(room(), dg.Capture(dg.Laser(EYE, [(0, -0.2, 1), target]), SENSOR, TIME), FEW)


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
        lambda: dg.simulate(
            dg.Scene.from_parts([wall(1000), box(1000)]),
            dg.Capture(
                dg.Laser((2000, -1000, 1000), [(0, -200, 1000)]),
                dg.Sensor.grid((2000, -1000, 1000), (0, 200, 1000), (0, 100, 0), (0, 0, 100), 1, 2),
                TIME,
            ),
            FEW,
        ),
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
    assert transient(spend=spend(), error_bound=np.float64(0.01), met_target=np.True_).total is LIGHT
    assert dg.SceneConfig(contents=()).contents == () and dg.EffectsConfig().tolerance > 0
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        found = dg.simulate(room(), CAPTURE, dg.Accuracy(lookins=1024), seed=np.int64(3))
        dg.Sensor(EYE, SENSOR.pixels.tolist(), np.float32(0.02))
        dg.TimeAxis(np.int32(64), 1e-10)
        dg.detect(torch.zeros(64), TIME, SPAD, EXPOSURE)
    assert found.total.any()
