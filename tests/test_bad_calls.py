"""Wrong types, units and shapes given to public functions: one `InputError` of one line that names the argument; what
is legal and absurd is warned of."""

from __future__ import annotations

import inspect
import math
import re
import warnings
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache, cached_property, partial
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import torch
import trimesh
from datasets import write_dataset
from pydantic import BaseModel

import datagen as dg
from datagen.config import config_from_mapping
from datagen.devices.zone_order import ORDERS, zones_listed
from datagen.scoring.predictions import read_predictions
from datagen.store import read_manifest
from datagen.transport.brdf import MODELS

CONFIG = Path(__file__).parents[1] / "configs" / "quickstart.yaml"
EYE = (2.0, -1.0, 1.0)
TIME = dg.TimeAxis(bins=64, width_s=4e-10, origin="wall")
LASER = dg.Laser(EYE, [(0, -0.2, 1)])
SENSOR = dg.Sensor.grid(EYE, (0, 0.2, 1), (0, 0.1, 0), (0, 0, 0.1), rows=1, columns=2)
CAPTURE = dg.Capture(LASER, SENSOR, TIME)
FEW = dg.Accuracy(samples=16)
SPAD, EXPOSURE = dg.Spad(), dg.Exposure()
WHITE = dg.Lambertian(0.8)
WAY = dg.Path((0, 1), [EYE, (2.0, 1.0, 1.0)], (0, 90))


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


FRAMES = np.zeros((2, 1, 2, 64))


def sequence_light(**other: Any) -> dg.SequenceLight:
    fields = {"time": TIME, "times_s": FRAMES[:, :, 0, 0], "static": FRAMES[0], "moving": FRAMES, "parts": {}}
    fields |= {"stderr": FRAMES, "change_stderr": FRAMES, "change_errors": np.zeros(2), "overflow": FRAMES[..., 0]}
    return dg.SequenceLight(**fields | {"laser_points": np.zeros((2, 1, 3)), "relative_error": np.zeros(2)} | other)


TRIANGLE = np.array([(0.0, 0, 0), (1, 0, 0), (0, 1, 0)])
MESH = wall().mesh
Arguments = dict[str, list[Any]]
WRONG: dict[str, Callable[[], tuple[Callable[..., object], dict[str, Any], Arguments]]] = {
    "Part": lambda: (dg.Part, {"name": "box", "mesh": MESH, "material": WHITE}, {
        "mesh": [None], "name": [3], "material": [0.8], "role": ["furniture"], "pose": ["upright"], "path": [[EYE]]}),
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


PLACE = {"wall_width_m": 2.0, "height_m": 2.0, "device_height_m": 1.0, "relay_distance_m": 3.0}
BOX = {"kind": "box", "width_m": 0.4, "depth_m": 0.3, "height_m": 0.5}


@cache
def tiny() -> dg.DatasetConfig:
    return config_from_mapping({
        "scenes": 1, "scene": {"layout": {"kind": "isolated_wall", **PLACE}, "contents": [BOX]},
        "capture": {"scan": {"rows": 2, "columns": 2}, "time": {"bins": 64, "bin_width_ps": 300}},
        "transport": {"samples": 32}, "labels": {"rows": 4, "columns": 4},
    })  # fmt: skip


@cache
def light() -> dg.Transient:
    return dg.simulate(room(), CAPTURE, FEW)


@cache
def frames() -> dg.Frames:
    poses, distances = np.stack([np.eye(4)] * 2), np.array([0.2, 0.3])
    return dg.Frames("frames", np.ones((2, 9, dg.device("tmf8820").time.bins)), poses, distances)


@dataclass(frozen=True)
class Made:
    """A folder with the dataset `set` of one scene, and `file`, which is none; and in the places that `hostile` names
    there is a file, too."""

    folder: Path

    @property
    def set(self) -> Path:
        return self.folder / "set"

    @property
    def file(self) -> Path:
        return self.folder / "file"

    @cached_property
    def data(self) -> dg.TransientDataset:
        return dg.TransientDataset(self.set)


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Made:
    found = Made(tmp_path_factory.mktemp("calls"))
    write_dataset(tiny(), found.set)
    for place in (found.file, found.folder / "nonsense", found.folder / "x"):
        place.write_text("mine")
    return found


Call = tuple[Callable[..., object], dict[str, Any]]
MATERIALS = ("Material", *(model.record.__name__ for model in MODELS))
POINTS = {"center": (0, 0, 1), "right": (0, 0.1, 0), "up": (0, 0, 0.1)}
WITH: dict[str, Callable[[Made], Call]] = {
    "Accuracy": lambda m: (dg.Accuracy, {}),
    "AsPrinted": lambda m: (dg.AsPrinted, {}),
    "BuildResult": lambda m: (dg.BuildResult, {
        "path": "x", "scenes": 1, "built": 1, "kept": 0, "complete": True, "seconds": 1.0}),
    "Calibration": lambda m: (dg.Calibration, {
        "device": dg.device("tmf8820"), "fitted": {}, "tested_m": LIGHT, "measured": LIGHT, "modelled": LIGHT,
        "held_out": True}),
    "Capture": lambda m: (dg.Capture, {"laser": LASER, "sensor": SENSOR, "time": TIME}),
    "Capture.excerpt": lambda m: (CAPTURE.excerpt, {"lasers": [0]}),
    "Clock": lambda m: (dg.Clock, {"frames": 2, "rate_hz": 10}),
    "Clock.middles": lambda m: (dg.Clock(2, 10).middles, {"points": 4, "exposure_s": 0.01}),
    "Clock.times": lambda m: (dg.Clock(2, 10).times, {"points": 4, "exposure_s": 0.01}),
    "Clock.turns": lambda m: (dg.Clock(2, 10).turns, {"points": 4}),
    "Comparison": lambda m: (dg.Comparison, {
        "source": "x", "simulated_as": "y", "fitted": {}, "steps": {}, "measured": LIGHT, "modelled": LIGHT}),
    "DatasetConfig": lambda m: (dg.DatasetConfig, {}),
    "DatasetConfig.with_scenes": lambda m: (tiny().with_scenes, {"scenes": 1}),
    "Decision": lambda m: (dg.Decision, {
        "effect": "gate", "setting": "auto", "simulated": True, "estimate": None, "kind": "detector",
        "allowance": 0.1, "reason": ""}),
    "Device": lambda m: (dg.Device, dict(dg.device("tmf8820"))),
    "Device.at": lambda m: (dg.device("tmf8820").at, {"position": (0, 0, 0), "toward": (1, 0, 0)}),
    "Device.at_pose": lambda m: (dg.device("tmf8820").at_pose, {"pose": np.eye(4)}),
    "Device.source_of": lambda m: (dg.device("tmf8820").source_of, {"section": "time", "key": "bins"}),
    "EffectDecisions": lambda m: (dg.EffectDecisions, {"decisions": (), "tolerance": 0.01}),
    "EffectDecisions.apply_detector": lambda m: (
        dg.EffectDecisions((), 0.01).apply_detector, {"spad": SPAD, "exposure": EXPOSURE}),
    "EffectDecisions.apply_transport": lambda m: (
        dg.EffectDecisions((), 0.01).apply_transport, {"scene": room(), "capture": CAPTURE, "accuracy": FEW}),
    "EffectDecisions.__getitem__": lambda m: (dg.EffectDecisions((), 0.01).__getitem__, {"effect": "gate"}),
    "EffectsConfig": lambda m: (dg.EffectsConfig, {}),
    "EffectsConfig.of": lambda m: (dg.EffectsConfig().of, {"effect": "gate"}),
    "EpochSampler": lambda m: (dg.EpochSampler, {"data": [1, 2]}),
    "EpochSampler.load_state_dict": lambda m: (
        dg.EpochSampler([1, 2]).load_state_dict, {"state": {"epoch": 0, "done": 1}}),
    "EpochSampler.set_epoch": lambda m: (dg.EpochSampler([1, 2]).set_epoch, {"epoch": 1}),
    "EpochSampler.state_dict": lambda m: (dg.EpochSampler([1, 2]).state_dict, {}),
    "Evidence": lambda m: (dg.Evidence, {"detections": 1.0, "brightest_bin": 1.0, "significance": 1.0}),
    "Exposure": lambda m: (dg.Exposure, {}),
    "Fitted": lambda m: (dg.Fitted, {"value": 1.0, "error": 0.1}),
    "Frames": lambda m: (dg.Frames, {"source": "x", "histograms": LIGHT}),
    "Frames.some": lambda m: (frames().some, {"rows": [0]}),
    "GeneratedDataset": lambda m: (dg.GeneratedDataset, {"config": tiny(), "ranks": 1}),
    "GeneratedDataset.sample": lambda m: (dg.GeneratedDataset(tiny()).sample, {"scene": 0}),
    "Laser": lambda m: (dg.Laser, {"position": EYE, "targets": [(0, 0, 1)]}),
    "Laser.flood": lambda m: (dg.Laser.flood, {"position": EYE, "rows": 1, "columns": 1, **POINTS}),
    "Laser.take": lambda m: (LASER.take, {"lasers": [0]}),
    **{name: lambda m, name=name: (getattr(dg, name), {"albedo": 0.5}) for name in MATERIALS},
    "Moves": lambda m: (dg.Moves, {"turns_rad": np.zeros(2), "shifts_m": np.zeros((2, 3))}),
    **{f"Moves.{name}": lambda m, name=name: (getattr(WAY.at([0, 1]), name), {"points": EYE})
       for name in ("apply", "undo")},
    **{f"Moves.{name}": lambda m, name=name: (getattr(WAY.at([0, 1]), name), {"vectors": EYE})
       for name in ("turn", "turn_back")},
    "Moves.since": lambda m: (WAY.at([0, 1]).since, {"start": WAY.at(0)}),
    "Part": lambda m: (dg.Part, {"name": "box", "mesh": MESH, "material": WHITE}),
    "Path": lambda m: (dg.Path, {"times_s": (0, 1), "places": [EYE, (2, 1, 1)], "headings_deg": (0, 90)}),
    "Path.at": lambda m: (WAY.at, {"times_s": 0.5}),
    "Path.turning": lambda m: (WAY.turning, {"times_s": 0.5}),
    "Path.velocity": lambda m: (WAY.velocity, {"times_s": 0.5, "at": EYE}),
    "Pose": lambda m: (dg.Pose, {"label": "box", "axes": np.eye(3)}),
    "Pose.upright": lambda m: (dg.Pose.upright, {"label": "box"}),
    "Presence": lambda m: (dg.Presence, {"detections": 1.0, "significance": 1.0, "floor": 0.1}),
    "Pulse": lambda m: (dg.Pulse, {"samples": (1.0, 2.0), "width_s": 1e-10}),
    "Rectangle": lambda m: (dg.Rectangle, POINTS),
    "Rectangle.of": lambda m: (dg.Rectangle.of, POINTS),
    "Sample": lambda m: (dg.Sample, {"index": 0, "arrays": {}, "parameters": {}, "seconds": {}}),
    "Scene": lambda m: (dg.Scene, dict(vars(room()))),
    "Scene.at": lambda m: (room().at, {"time_s": 0.5}),
    "Scene.faces_of": lambda m: (lambda part: room().faces_of(part), {"part": "box"}),
    "Scene.from_parts": lambda m: (dg.Scene.from_parts, {"parts": [wall()]}),
    "Scene.moves": lambda m: (room().moves, {"part": "box", "times_s": 0.5}),
    "Scene.pose_of": lambda m: (room().pose_of, {"part": "box"}),
    "Scene.without": lambda m: (lambda part: room().without(part), {"part": "box"}),
    "SceneConfig": lambda m: (dg.SceneConfig, {}),
    "Scores": lambda m: (dg.Scores, {
        "dataset": "x", "published": False, "split": "test", "scenes": 1, "scenes_with_evidence": 1, "all": {},
        "with_evidence": {}}),
    "Sensor": lambda m: (dg.Sensor, {"position": EYE, "pixels": SENSOR.pixels}),
    "Sensor.grid": lambda m: (dg.Sensor.grid, {"position": EYE, "rows": 1, "columns": 2, **POINTS}),
    "Sensor.take": lambda m: (SENSOR.take, {"pixels": [0]}),
    "Spad": lambda m: (dg.Spad, {}),
    "SuiteResult": lambda m: (dg.SuiteResult, {
        "name": "x", "path": m.set, "difference": 0.0, "allowed": 1.0, "splits": {}, "bytes": 1}),
    "TimeAxis": lambda m: (dg.TimeAxis, {"bins": 64, "width_s": 1e-10}),
    "TimeAxis.beyond_period": lambda m: (TIME.beyond_period, {"repetition_rate_hz": 1e6}),
    "TimeAxis.merged": lambda m: (TIME.merged, {"bins": 2}),
    "Transient": lambda m: (dg.Transient, {
        "time": TIME, "components": {"primary": LIGHT}, "parts": {}, "stderr": LIGHT, "overflow": LIGHT[..., 0],
        "laser_points": np.zeros((1, 3))}),
    "TransientDataset": lambda m: (dg.TransientDataset, {"path": m.set}),
    "TransientDataset.__getitem__": lambda m: (m.data.__getitem__, {"item": 0}),
    "TransientDataset.load_state_dict": lambda m: (m.data.load_state_dict, {"state": {}}),
    "TransientDataset.parameters": lambda m: (m.data.parameters, {"name": "attempts"}),
    "TransientDataset.set_epoch": lambda m: (m.data.set_epoch, {"epoch": 1}),
    "TransientDataset.shape": lambda m: (m.data.shape, {"field": "depth"}),
    "TransientDataset.time_of": lambda m: (m.data.time_of, {}),
    "build": lambda m: (dg.build, {"config": tiny(), "path": m.file}),
    "build_from": lambda m: (dg.build_from, {"scenes": [room()], "path": m.file, "capture": CAPTURE}),
    "build_suite": lambda m: (dg.build_suite, {"name": "letters-1", "path": m.file}),
    "calibrate": lambda m: (dg.calibrate, {"frames": frames(), "device": dg.device("tmf8820")}),
    "capture_for": lambda m: (dg.capture_for, {"config": tiny(), "scene": dg.scene_for(tiny(), 0)}),
    "collate": lambda m: (dg.collate, {"items": [m.data[0]]}),
    "compare": lambda m: (dg.compare, {
        "frames": frames(), "sensor": dg.device("tmf8820"), "parts": [box()], "fit": ()}),
    "compare_datasets": lambda m: (dg.compare_datasets, {"recorded": m.set, "simulated": m.set}),
    "dense": lambda m: (dg.dense, {
        "events": torch.zeros((1, 3), dtype=torch.int16), "counts": torch.ones(1), "shape": (1, 1, 1)}),
    "detect": lambda m: (dg.detect, {"transient": np.zeros(64), "time": TIME, "spad": SPAD, "exposure": EXPOSURE}),
    "device": lambda m: (dg.device, {"name": "tmf8820"}),
    "expected_histogram": lambda m: (dg.expected_histogram, {
        "transient": np.zeros(64), "time": TIME, "spad": SPAD, "exposure": EXPOSURE}),
    "generate_scene": lambda m: (dg.generate_scene, {"spec": tiny().scene, "seed": 0, "index": 0}),
    "import_captures": lambda m: (dg.import_captures, {"files": m.file, "path": m.file}),
    "load_config": lambda m: (dg.load_config, {"path": CONFIG}),
    "own_evidence": lambda m: (dg.own_evidence, {"transient": light(), "spad": SPAD, "exposure": EXPOSURE}),
    "plan_effects": lambda m: (dg.plan_effects, {
        "scene": room(), "capture": CAPTURE, "accuracy": FEW, "spad": SPAD, "exposure": EXPOSURE,
        "transient": light()}),
    "presence_evidence": lambda m: (dg.presence_evidence, {
        "scene": room(), "capture": CAPTURE, "accuracy": FEW, "spad": SPAD, "exposure": EXPOSURE, "parts": ()}),
    "read_frames": lambda m: (dg.read_frames, {"path": m.file}),
    "read_materials": lambda m: (dg.read_materials, {"path": m.file}),
    "read_parts": lambda m: (dg.read_parts, {"paths": [m.file]}),
    "replay": lambda m: (dg.replay, {"path": m.set, "scene": 0}),
    "scene_for": lambda m: (dg.scene_for, {"config": tiny(), "index": 0}),
    "score": lambda m: (dg.score, {"suite": m.set, "predictions": {}}),
    "SequenceLight": lambda m: (dg.SequenceLight, vars(sequence_light())),
    **{f"SequenceLight.{name}": lambda m, name=name: (getattr(sequence_light(), name), {"frame": 1})
       for name in ("change", "change_error", "frame", "total")},
    "simulate": lambda m: (dg.simulate, {"scene": room(), "capture": CAPTURE, "accuracy": FEW}),
    "simulate_sequence": lambda m: (dg.simulate_sequence, {
        "scene": room(), "capture": CAPTURE, "clock": dg.Clock(2, 10), "accuracy": FEW}),
    "simulate_as_printed": lambda m: (dg.simulate_as_printed, {"scene": room(), "capture": CAPTURE}),
    "with_exposure_found": lambda m: (dg.with_exposure_found, {"config": tiny()}),
    "write_materials": lambda m: (dg.write_materials, {"materials": {"box": WHITE}, "path": m.folder / "new.yaml"}),
    "write_device": lambda m: (dg.write_device, {
        "device": dg.device("tmf8820"), "path": m.folder / "new.yaml"}),
    "write_glb": lambda m: (dg.write_glb, {"scene": room(), "path": m.folder / "new.glb"}),
    "zone_depth": lambda m: (dg.zone_depth, {"scene": room(), "capture": CAPTURE}),
}  # fmt: skip
"""Every public function, class, and method that takes an argument → what is called, with arguments that are right.
A build into a file is refused, so that what gets past its first checks makes nothing."""
INHERITED = (BaseModel, torch.utils.data.Dataset, torch.utils.data.IterableDataset, torch.utils.data.Sampler)


def hostile() -> dict[str, Any]:
    """Values that some user gives some day where others are wanted."""
    return {
        "None": None, "a fraction": 0.5, "-1": -1, "infinity": math.inf, "a whole number of 5001 digits": 10**5000,
        "a text": "nonsense", "a long text": "x" * 300, "a null character": "no\0path", "bytes": b"x",
        "a path": Path("x"),
        "a slice": slice(1, 2), "a scene": room(), "a class": dg.Scene, "an object": object(), "a list": [],
        "a list of None": [None], "a mapping": {1: 2}, "texts": np.array(["a", "b"]), "a tensor": torch.zeros(2),
        "objects": np.array([None, {}], object), "no points": np.zeros((0, 3)), "complex numbers": np.ones(3) * 1j,
        "a matrix": np.zeros((3, 3)),
    }  # fmt: skip


UNSEEN = {
    # What is refused before, by design: see `WITH`.
    "import_captures", "build_suite", "score",
    # Under its new name.
    "Sensor.grid.cols",
}  # fmt: skip
"""Calls, or an argument of one, whose messages name something else than the argument at fault."""


def takers() -> set[str]:
    """Names of all that is public and takes arguments, methods after the name of their class."""
    found = {name for name in dg.__all__ if callable(getattr(dg, name)) and not _is_error(getattr(dg, name))}
    for owner in [name for name in found if inspect.isclass(getattr(dg, name))]:
        for name, member in inspect.getmembers(getattr(dg, owner), callable):
            is_own = not name.startswith("_") and not any(hasattr(kind, name) for kind in INHERITED)
            if is_own and [*inspect.signature(member).parameters] not in ([], ["self"]):
                found.add(f"{owner}.{name}")
    return found


def _is_error(thing: object) -> bool:
    return isinstance(thing, type) and issubclass(thing, Exception | Warning)


def test_every_public_call_is_tried() -> None:
    assert takers() <= {*WITH} and {name for name in WITH if "__" not in name} <= takers()


@pytest.mark.parametrize("name", sorted(WITH))
def test_whatever_is_given_only_our_errors_come_out(name: str, made: Made, monkeypatch: pytest.MonkeyPatch) -> None:
    """With the right argument's name; a call that accepts the value is fine, too."""
    monkeypatch.chdir(made.folder)
    function, right = WITH[name](made)
    is_model = isinstance(function, type) and issubclass(function, BaseModel)
    arguments = function.model_fields if is_model else inspect.signature(function).parameters  # type: ignore[attr-defined]
    for argument in arguments or right:
        for what, value in hostile().items():
            # What can be called is called, and then what comes out is the user's own.
            if what == "a class" and argument in ("capture", "input_check", "sample_function"):
                continue
            try:
                with warnings.catch_warnings():
                    warnings.simplefilter("ignore")
                    function(**right | {argument: value})
            except (dg.InputError, dg.CheckError) as error:
                message = str(error)
                assert "\n" not in message, (argument, what, message)
                if what == "an object" and not {name, f"{name}.{argument}"} & UNSEEN:
                    assert argument in message, (argument, what, message)
            except IndexError:
                # The end of what is read item by item, as Python has it.
                assert name.endswith("__getitem__"), (argument, what)
            except Exception as error:
                raise AssertionError(f"{argument} = {what}: {type(error).__name__}: {error}") from error


def refused(call: Callable[[], object], longest: int = 300) -> str:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        with pytest.raises(dg.InputError) as caught:
            call()
    message = str(caught.value)
    assert "\n" not in message and len(message) < longest, message
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


OF_ANOTHER_NAME: dict[str, Callable[[str, Path], object]] = {
    "tmf8820": lambda name, _: dg.device(name),
    "letters-1": lambda name, folder: dg.build_suite(name, folder / "new"),
    "pillar": lambda kind, _: config_from_mapping({"scene": {"contents": [{"kind": kind}]}}),
    "description": lambda key, _: config_from_mapping({key: 3}),
    "depth": lambda name, folder: read_predictions(
        {"scene": np.zeros(1), name: np.zeros(1)},
        SimpleNamespace(  # type: ignore[arg-type]
            manifest=read_manifest(folder / "set"), scenes=np.zeros(1, int), depth=np.zeros((1, 2, 2)),
            occupancy=None, span=np.ones(1), reach=np.ones(1),
        )),
    "rows from top left": lambda order, _: zones_listed("frames", order, dg.device("tmf8820").zones, 9),
}  # fmt: skip
"""A name that is known → a call with another."""


@pytest.mark.parametrize("known", OF_ANOTHER_NAME)
def test_an_unknown_name_brings_what_is_known_in_a_sentence_as_one_writes_it(known: str, made: Made) -> None:
    """With a capital only where a sentence begins, after the question whether another name is meant."""
    for name, is_near in ((known[:-1], True), ("quite?else", False)):
        message = refused(lambda name=name: OF_ANOTHER_NAME[known](name, made.folder), 2000)  # type: ignore[misc]
        assert ("did you mean" in message) is is_near and (known in message or known in ORDERS), message
        assert not re.search(r"[;:,] [A-Z][a-z]+ [a-z]", message) and not re.search(r"\? [a-z]", message), message


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
    with pytest.warns(FutureWarning, match="now called columns") as caught:
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
