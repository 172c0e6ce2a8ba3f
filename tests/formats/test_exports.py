"""Exported scenes, read by other readers: light that was reflected by one point must lead back to this point."""

from __future__ import annotations

import io
import json
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow.parquet as pq
import pytest
import scipy.io
import trimesh
import yaml
from point_target import LIGHT, SCANS, config_of, hidden_point

import datagen as dg
from datagen.errors import InputError
from datagen.formats import export
from datagen.formats.recording import Recording, WallFrame, recording_of
from datagen.loader import TransientDataset
from datagen.scene import generate_scene
from datagen.store import verify
from datagen.store.scenes import Scenes


def in_wall_frame(dataset: Path, index: int, points: np.ndarray) -> np.ndarray:
    """Independent of the exporter but for where the frame's origin is: relay wall and its normal from the scene."""
    scene = generate_scene(Scenes(dataset).manifest.parsed_config().scene, 0, index)
    wall = scene.relay_wall
    assert wall is not None
    right, up = wall.right / np.linalg.norm(wall.right), wall.up / np.linalg.norm(wall.up)
    return (points - wall.center) @ np.stack([right, up, np.cross(right, up)]).T


def tal_content(path: Path) -> dict[str, Any]:
    h5py = pytest.importorskip("h5py")
    with h5py.File(path) as file:
        return {name: of[()] for name, of in file.items()}


@pytest.mark.parametrize(
    ("bins", "lead", "due"),
    [(1, 0, 1), (2, 0, 2), (3, 0, 4), (64, 0, 64), (65, 0, 128), (60, 4, 64), (64, 1, 128), (1024, 0, 1024)],
)
def test_time_is_padded_to_the_next_power_of_two_and_no_further(bins: int, lead: int, due: int) -> None:
    values, point, place = np.arange(1.0, bins + 1)[None, None], np.zeros((1, 3)), np.zeros(3)
    time = dg.TimeAxis(bins=bins, width_s=5e-11, start_s=lead * 5e-11, origin="wall")
    frame = WallFrame(place, np.eye(3))
    padded = Recording(values, True, point, point, point, point, time, place, place, frame).from_time_zero()
    assert padded.values.shape == (1, 1, due) and padded.time.bins == due and padded.time.start_s == 0.0
    assert np.array_equal(padded.values[0, 0, lead : lead + bins], values[0, 0])
    assert padded.values.sum() == values.sum()


@pytest.mark.parametrize(
    ("scan", "origin"), [("confocal", "wall"), ("exhaustive", "wall"), *((scan, "source") for scan in SCANS)]
)
def test_tal_counts_lie_where_its_own_coordinates_and_times_say(
    scan: str, origin: str, made: Any, tmp_path: Path
) -> None:
    pytest.importorskip("h5py")
    (path,) = export(made(scan, origin), tmp_path, "tal", "1")
    got = tal_content(path)
    form = int(got["H_format"][0])
    assert form == {"confocal": 1, "single": 1, "exhaustive": 2, "circle": 3, "irregular": 4}[scan]
    h, lit, seen = got["H"], got["laser_grid_xyz"].astype(float), got["sensor_grid_xyz"].astype(float)
    assert h.dtype == np.float32
    assert h.shape[0] & (h.shape[0] - 1) == 0
    assert 0 <= got["t_start"] < got["delta_t"]
    assert int(got["laser_grid_format"][0]) == int(got["sensor_grid_format"][0]) == (lit.ndim == 3) + 1
    for points in (lit, seen):
        np.testing.assert_allclose(points[..., 2], 0, atol=1e-6)
    if lit.ndim == 3:
        assert (np.diff(seen[..., 0], axis=0) > 0).all() and (np.diff(seen[..., 1], axis=1) > 0).all()
    # The target, from what the file says of its frame.
    info = yaml.safe_load(got["scene_info"])
    config = config_of(scan, origin)
    frame = WallFrame(np.array(info["datagen"]["origin_m"]), np.array(info["datagen"]["axes"]))
    point = frame.to_wall(hidden_point(config, 1))
    there = in_wall_frame(made(scan, origin), 1, hidden_point(config, 1))
    np.testing.assert_allclose(point[2], there[2], atol=1e-12)
    assert point[2] > 0
    low = np.array(info["volume"]["center"]) - np.array(info["volume"]["size"]) / 2
    np.testing.assert_allclose(point, low + np.array(info["volume"]["size"]) * _share(frame), atol=1e-9)
    # Every histogram's one bin, from the file's points alone.
    paired = scan in ("confocal", "circle")
    lit = lit if paired else lit.reshape(*lit.shape[:-1], *[1] * (seen.ndim - 1), 3)
    lit = lit.reshape(1, 1, 3) if scan == "single" else lit
    way = np.linalg.norm(lit - point, axis=-1) + np.linalg.norm(seen - point, axis=-1)
    if got["t_accounts_first_and_last_bounces"]:
        way = (
            way + np.linalg.norm(lit - got["laser_xyz"], axis=-1) + np.linalg.norm(seen - got["sensor_xyz"], axis=-1)
        )
    assert bool(got["t_accounts_first_and_last_bounces"]) == (origin == "source")
    position = (way - got["t_start"]) / got["delta_t"]
    clear = abs(position - np.round(position)) > 1e-3
    assert clear.mean() > 0.9
    np.testing.assert_array_equal(h.argmax(axis=0)[clear], np.floor(position)[clear])
    np.testing.assert_array_equal(h.sum(axis=0), 7)


def _share(frame: WallFrame) -> np.ndarray:
    """(0.3, 0.6, 0.7) of a box of the scene along the axes of the wall, which are those of the scene but turned."""
    turned = frame.axes @ np.array([0.3, 0.6, 0.7])
    return np.where(frame.axes.sum(axis=1) > 0, turned, 1 + turned)


@pytest.mark.parametrize("origin", ["wall", "source"])
def test_stanford_mat_shifted_by_its_tofgrid_counts_from_the_wall(origin: str, made: Any, tmp_path: Path) -> None:
    (path,) = export(made("confocal", origin), tmp_path, "mat", "1")
    got = scipy.io.loadmat(path)
    assert (got["meas"].dtype, got["tofgrid"].dtype) == (np.uint16, np.float64)
    meas, step = got["meas"], float(got["bin_resolution"][0, 0])
    assert meas.shape == (4, 5, 2048 if origin == "wall" else 4096)
    assert got["tofgrid"].shape == (4, 5)
    np.testing.assert_allclose(got["wall_size"], [[0.8, 0.6]])
    stored = Scenes(made("confocal", origin)).read(1)
    np.testing.assert_array_equal(meas.sum(axis=2), stored.arrays["histogram"].sum(axis=(1, 2)).reshape(4, 5))
    points, frame = got["grid_points"].transpose(0, 1, 2), recording_of(stored).frame
    assert (points[0, :, 1] > points[-1, :, 1]).all() and (points[:, 0, 0] < points[:, -1, 0]).all()
    point = frame.to_wall(hidden_point(config_of("confocal", origin), 1))
    way = 2 * np.linalg.norm(points - point, axis=-1)
    delays = np.floor(got["tofgrid"] * 1e-12 / step).astype(int)
    assert (delays > 0).all() == (origin == "source")
    found = np.array([[np.roll(meas[y, x], -delays[y, x]).argmax() for x in range(5)] for y in range(4)])
    # The file has the delay in whole bins, and time may begin a part of a bin after 0.
    assert (abs(found - way / LIGHT / step) <= 1.51).all()


@pytest.mark.parametrize(
    ("scan", "origin"), [("exhaustive", "wall"), ("single", "source"), ("circle", "source"), ("irregular", "source")]
)
def test_lists_of_pairs_count_from_the_wall(scan: str, origin: str, made: Any, tmp_path: Path) -> None:
    (path,) = export(made(scan, origin), tmp_path, "mat", "0", "transient")
    got = scipy.io.loadmat(path)
    config = config_of(scan, origin)
    rows = int(np.prod(config.capture.shape[:2]))
    assert got["trans_data"].shape[0] == rows
    for name in ("camera_points", "laser_points", "camera_normals", "laser_normals"):
        assert got[name].shape == (rows, 3)
    assert (got["camera_normals"] == [0, 0, 1]).all()
    np.testing.assert_allclose(got["trans_data"].sum(axis=1), 7e-9, rtol=1e-5)
    point = recording_of(Scenes(made(scan, origin)).read(0)).frame.to_wall(hidden_point(config, 0))
    way = sum(np.linalg.norm(got[name] - point, axis=1) for name in ("laser_points", "camera_points"))
    found = got["trans_data"].argmax(axis=1)
    assert (abs(found - way / LIGHT / float(got["bin_resolution"][0, 0])) <= 1.51).all()


def test_scans_too_large_for_matlab_are_refused_in_a_line(
    made: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("datagen.formats.matlab._LARGEST_BYTES", 1000)
    with pytest.raises(InputError, match=r"^scene 1: meas would have .* take format h5 or npz$"):
        export(made("confocal"), tmp_path / "files", "mat", "1")
    assert list((tmp_path / "files").iterdir()) == []


def test_plain_files_hold_every_field_as_stored(made: Any, tmp_path: Path) -> None:
    stored = Scenes(made("exhaustive")).read(1)
    (path,) = export(made("exhaustive"), tmp_path, "npz", "1")
    with np.load(path) as got:
        assert set(got) == {*stored.arrays, "info", "bin_edges_s"}
        for name, value in stored.arrays.items():
            np.testing.assert_array_equal(got[name], value)
            assert got[name].dtype == value.dtype
        np.testing.assert_allclose(got["bin_edges_s"][[0, -1]], [2.025e-9, 2.025e-9 + 1500 * 50e-12])
        info = json.loads(str(got["info"]))
    assert (info["scene"], info["pairing"], info["parameters"]) == (1, "exhaustive", dict(stored.parameters))
    h5py = pytest.importorskip("h5py")
    (path,) = export(made("exhaustive"), tmp_path, "h5", "1")
    with h5py.File(path) as file:
        for field in stored.manifest.schema.fields:
            np.testing.assert_array_equal(file[field.name][()], stored.arrays[field.name])
            assert file[field.name].attrs["units"] == field.unit
        assert [of.label for of in file["histogram"].dims] == ["laser", "pixel", "bin"]
        assert dict(file["parameters"].attrs) == dict(stored.parameters)


PLACED = ("laser", "sensor", "laser_points", "sensor_points", "sensor_pixels")


def test_glb_holds_parts_device_and_scan(made: Any, tmp_path: Path) -> None:
    (path,) = export(made("confocal"), tmp_path, "glb", "1")
    room, got = generate_scene(config_of("confocal", "wall").scene, 0, 1), trimesh.load(path)
    assert isinstance(got, trimesh.Scene)
    assert {*room.part_names, *PLACED} <= set(got.graph.nodes)

    def placed(name: str) -> np.ndarray:
        transform, geometry = got.graph[name]
        # glTF's +Y is up.
        points = trimesh.transform_points(got.geometry[geometry].vertices, transform)
        return np.stack([points[:, 0], -points[:, 2], points[:, 1]], axis=1)

    for number, name in enumerate(room.part_names):
        corners = room.vertices[room.triangles[room.face_part == number]].reshape(-1, 3)
        shown = placed(name)
        np.testing.assert_allclose([shown.min(0), shown.max(0)], [corners.min(0), corners.max(0)], atol=1e-5)
        material = got.geometry[got.graph[name][1]].visual.material
        assert material.baseColorFactor is not None and material.name.startswith(
            type(room.materials[number]).__name__
        )
    stored = Scenes(made("confocal")).read(1).arrays
    np.testing.assert_allclose(placed("laser").mean(axis=0), stored["laser_position"], atol=1e-4)
    for name in ("laser_points", "sensor_points"):
        np.testing.assert_allclose(placed(name), stored[name], atol=1e-5)


def test_glb_of_a_scene_made_in_python(tmp_path: Path) -> None:
    wall = dg.Part("wall", trimesh.creation.box((0.1, 4, 3)), dg.Lambertian(0.8), "relay_wall")
    ball = trimesh.creation.icosphere(1, 0.3).apply_translation((1, 1.5, 0))
    scene = dg.Scene.from_parts([wall, dg.Part("ball", ball, dg.Phong(0.5))])
    laser = dg.Laser((3, -1, 0), [(0, 0, 0.2), (3, 0, 9)])
    sensor = dg.Sensor.grid((3, -1, 0), (0.05, 0, 0), (0, 0.3, 0), (0, 0, 0.3), rows=1, columns=2)
    dg.write_glb(scene, tmp_path / "parts.glb")
    dg.write_glb(scene, str(tmp_path / "all.glb"), dg.Capture(laser, sensor, dg.TimeAxis(8, 1e-9)))
    parts, all_of_it = (trimesh.load(tmp_path / f"{name}.glb") for name in ("parts", "all"))
    assert set(parts.geometry) == {"wall", "ball"}
    assert set(all_of_it.geometry) == {"wall", "ball", *PLACED}
    # The first laser ray meets the wall, the second nothing; the node turns what is up to +Y.
    lit = all_of_it.geometry["laser_points"].vertices
    np.testing.assert_allclose(lit, [[0.05, -1 / 60, 0.2 * 2.95 / 3]], atol=1e-6)
    with pytest.raises(InputError, match=r"^path = .*: cannot be written \(No such file or directory\)$"):
        dg.write_glb(scene, tmp_path / "nowhere" / "parts.glb")


def test_hub_folder_is_the_dataset_with_rows_to_look_at(made: Any, tmp_path: Path) -> None:
    from matplotlib.image import imread

    written = export(made("confocal"), tmp_path / "hub", "hub")
    assert export(made("confocal"), tmp_path / "hub", "hub") == written
    assert not verify(tmp_path / "hub/dataset", deep=True).problems
    assert len(TransientDataset(tmp_path / "hub/dataset")) == 2
    front = yaml.safe_load((tmp_path / "hub/README.md").read_text().split("---")[1])
    rows = 0
    for part in front["configs"][0]["data_files"]:
        table = pq.read_table(tmp_path / "hub" / part["path"])
        assert set(table["split"].to_pylist()) == {part["split"]}
        features = json.loads(table.schema.metadata[b"huggingface"])["info"]["features"]
        assert list(features) == table.column_names
        assert features["thumbnail"] == {"_type": "Image"}
        for name in ("thumbnail", "depth"):
            pictures = [imread(io.BytesIO(of["bytes"])) for of in table[name].to_pylist()]
            assert {of.shape[2] for of in pictures} == {4}
            assert all(of[..., :3].std() > 0.05 for of in pictures)
        rows += table.num_rows
    assert rows == 2
    assert (made("confocal") / "README.md").read_text() != (tmp_path / "hub/README.md").read_text()


READ_BY_DATASETS = """
import sys
try:
    import datasets
except ImportError:
    sys.exit(77)
rows = datasets.load_dataset(sys.argv[1], cache_dir=sys.argv[2])
print(sum(len(part) for part in rows.values()), min(part[0]["thumbnail"].size[0] for part in rows.values()))
"""


@pytest.mark.nightly
def test_hub_folder_is_read_by_datasets(made: Any, tmp_path: Path) -> None:
    """Another process reads it, because a module of these tests is called `datasets`, too."""
    export(made("confocal"), tmp_path / "hub", "hub")
    offline = os.environ | {"HF_HUB_OFFLINE": "1", "HF_HOME": str(tmp_path)}
    command = [sys.executable, "-c", READ_BY_DATASETS, tmp_path / "hub", tmp_path / "cache"]
    done = subprocess.run(command, cwd=tmp_path, env=offline, capture_output=True, text=True, check=False)
    if done.returncode == 77:
        pytest.skip("the package datasets (Hugging Face) is not installed")
    assert done.returncode == 0, done.stderr
    rows, width = map(int, done.stdout.split())
    assert rows == 2
    assert width >= 100


def test_bad_requests_are_refused_in_a_line(made: Any, tmp_path: Path) -> None:
    for options, piece in (
        ({"format": "doc"}, "format = 'doc'"),
        ({"format": "npz", "scenes": "0-5"}, "scenes = '0-5'"),
        ({"format": "npz", "scenes": "x"}, "scenes = 'x'"),
        ({"format": "npz", "field": "transient"}, "field = 'transient'"),
        ({"format": "hub", "scenes": "0"}, "^scenes: "),
    ):
        with pytest.raises(InputError, match=piece) as error:
            export(made("confocal"), tmp_path / "out", **options)  # type: ignore[arg-type]
        assert "\n" not in str(error.value)
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine/letter.txt").touch()
    with pytest.raises(InputError, match="holds other files"):
        export(made("confocal"), tmp_path / "mine", "hub")
    assert not list(tmp_path.rglob("*.npz"))
