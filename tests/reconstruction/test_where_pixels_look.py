"""What pixels look at is stored for every kind of capture, and reconstructions that take it find what is there."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import scipy.io
import trimesh

import datagen as dg
from datagen.config import DatasetConfig, config_from_mapping
from datagen.formats import export
from datagen.formats.recording import recording_of
from datagen.labels.frame import ViewFrame
from datagen.labels.volumes import VoxelGrid
from datagen.pipeline import simulate_sample
from datagen.reconstruction.backprojection import reconstructed, scan_of
from datagen.records import Rectangle, Scene
from datagen.records.arrays import Floats
from datagen.store.scenes import Scenes

pytestmark = pytest.mark.usefixtures("builds_here")

CURVED = {"kind": "curved", "relief_m": 0.2}
FEW = {"samples": 16}


def before_a_wall(relay: dict[str, Any], capture: dict[str, Any], **more: Any) -> DatasetConfig:
    layout = {"kind": "isolated_wall", "place": "in_front", "relay_wall": relay}
    time = {} if "device" in capture else {"time": {"bins": 512, "bin_width_ps": 32}}
    scene = {"layout": layout, "contents": [{"kind": "box", "height_m": 0.5}]}
    return config_from_mapping({"seed": 5, "scenes": 2, "scene": scene, "capture": time | capture} | more)


@pytest.fixture(scope="module")
def box_before_a_curved_wall(tmp_path_factory: pytest.TempPathFactory) -> tuple[DatasetConfig, Path]:
    scan = {"rows": 12, "columns": 12, "width_m": 1.2, "height_m": 1.2}
    bright = {"mode": "ideal", "photons_per_pulse": 1e13, "cycles": 10**6}
    config = before_a_wall(
        CURVED, {"pairing": "confocal", "scan": scan}, transport={"samples": 2048},
        detector=bright, store={"fields": ["histogram", "transient", "depth"], "histogram_dtype": "uint32"},
    )  # fmt: skip
    root = tmp_path_factory.mktemp("curved") / "set"
    dg.build(config, root, 1)
    return config, root


@pytest.mark.parametrize("quantity", ["histogram", "transient"])
def test_the_box_before_a_curved_wall_is_found(
    quantity: str, box_before_a_curved_wall: tuple[DatasetConfig, Path]
) -> None:
    """By the same function as that of baselines and volumes. Points on the flat wall are a metre off these, and lead
    to a place a quarter of a metre beside the box."""
    config, root = box_before_a_curved_wall
    for index in range(2):
        content = Scenes(root).read(index)
        room, frame = dg.scene_for(config, index), ViewFrame.about(Rectangle(*content.arrays["hidden_view"]))
        corners = frame.to_view(room.corners[room.faces_of(room.objects[0])].reshape(-1, 3))
        # Voxels of 6 to 9 cm.
        grid = VoxelGrid.behind_images(frame, content.arrays["hidden_bounds"], (32, 32, 32))
        counts = content.arrays[quantity] / content.arrays[quantity].max() * 1e4
        volume = reconstructed(scan_of(counts, content.arrays, config.model_dump()["capture"], content.time), grid)
        at = grid.centers[np.unravel_index(volume.argmax(), volume.shape)]
        beyond = np.maximum(np.maximum(corners.min(axis=0) - at, at - corners.max(axis=0)), 0)
        assert (beyond <= (grid.high - grid.low) / np.array(grid.shape)[::-1]).all()


@pytest.mark.parametrize("form", ["tal", "mat"])
def test_exported_points_and_normals_come_back(
    form: str, box_before_a_curved_wall: tuple[DatasetConfig, Path], tmp_path: Path
) -> None:
    if form == "tal":
        pytest.importorskip("h5py")
    _, root = box_before_a_curved_wall
    files = export(root, tmp_path, form, "0")
    dg.import_captures(files, tmp_path / "back", progress=False)
    due, got = recording_of(Scenes(root).read(0)).on_wall(), Scenes(tmp_path / "back").read(0).arrays
    for name in ("laser", "sensor"):
        wanted = due.laser_points, due.laser_normals
        if name == "sensor":
            wanted = due.seen_points, due.seen_normals
        assert np.abs(wanted[0][:, 2]).max() > 0.1 and wanted[1][:, 2].min() < 0.99
        for field, values in zip(("points", "normals"), wanted, strict=True):
            order, other = (np.lexsort(of[:, :2].round(4).T) for of in (wanted[0], got[f"{name}_points"]))
            np.testing.assert_allclose(got[f"{name}_{field}"][other], values[order], atol=1e-5)


def test_an_imported_grid_without_normals_has_none(tmp_path: Path) -> None:
    """Counts of the light-cone transform lie on a flat wall by definition; listed points may lie anywhere."""
    scipy.io.savemat(tmp_path / "flat.mat", {"rect_data": np.ones((2, 3, 8)), "width": 0.4})
    dg.import_captures(tmp_path / "flat.mat", tmp_path / "flat", bin_width="4ps", progress=False)
    flat = Scenes(tmp_path / "flat").read(0).arrays
    assert (flat["sensor_normals"] == [0, 0, 1]).all() and np.array_equal(flat["sensor_points"], flat["laser_points"])
    points = np.random.default_rng(0).uniform(-1, 1, (6, 3))
    pairs = {"trans_data": np.ones((6, 8)), "camera_points": points, "laser_points": points}
    scipy.io.savemat(tmp_path / "pairs.mat", pairs)
    dg.import_captures(tmp_path / "pairs.mat", tmp_path / "pairs", bin_width="4ps", progress=False)
    listed = Scenes(tmp_path / "pairs").read(0).arrays
    np.testing.assert_allclose(np.sort(listed["sensor_points"], axis=0), np.sort(points, axis=0))
    assert np.isnan(listed["sensor_normals"]).all() and np.isnan(listed["laser_normals"]).all()


BUMPY = {"kind": "bumpy", "relief_m": 0.1, "length_m": 0.5, "clutter": {"count": 3, "width_m": 0.2}}
GRID = {"rows": 3, "columns": 2, "width_m": 0.8, "height_m": 0.6}
APART = {"sensor_offset_m": [0.0, 0.1, 0.05]}
VIEW = {"rows": 2, "columns": 4}
CAPTURES: dict[str, dict[str, Any]] = {
    "confocal": {"pairing": "confocal", "scan": GRID} | APART,
    "exhaustive": {"pairing": "exhaustive", "scan": GRID, "field_of_view": VIEW} | APART,
    "flood": {"pairing": "exhaustive", "illumination": "flood", "scan": GRID, "field_of_view": VIEW},
    "device": {"device": "vl53l8ch_4x4"},
    "device at objects": {"device": "vl53l8ch_4x4", "at_objects": {"share": 1.0, "distance_m": 0.9}},
}  # fmt: skip


def check_points(scene: Scene, capture: dg.Capture, arrays: Any) -> None:
    """The law: each point lies on the ray of its pixel or laser point and on a surface, the normal is that of the
    surface and faces the device, and nothing is met before it (a ray-triangle test in double precision)."""
    aims = {"laser": (capture.laser.position, capture.laser.targets),
            "sensor": (capture.sensor.position, capture.sensor.pixels.mean(axis=1))}  # fmt: skip
    for name, (device, aimed) in aims.items():
        points, normals = arrays[f"{name}_points"], arrays[f"{name}_normals"]
        for towards, point, normal in zip(aimed - device, points, normals, strict=True):
            far, face = first_triangle(scene.corners, device, towards)
            if not far < np.inf:
                assert np.isnan(point).all() and np.isnan(normal).all()
                continue
            np.testing.assert_allclose(point, device + far * towards, atol=1e-9)
            assert np.linalg.norm(np.cross(normal, face)) < 1e-9 * np.linalg.norm(face)
            assert np.linalg.norm(normal) == pytest.approx(1) and normal @ towards < 0


def first_triangle(corners: Floats, origin: Floats, towards: Floats) -> tuple[float, Floats]:
    """How far along a ray the first triangle is (infinite for none), and a normal of it (Möller & Trumbore 1997)."""
    a, b, c = corners.swapaxes(0, 1)
    across = np.cross(towards, c - a)
    with np.errstate(divide="ignore", invalid="ignore"):
        scale = 1 / np.einsum("fk,fk->f", b - a, across)
        # Triangles along the ray give NaN, which no comparison counts as met.
        u = scale * np.einsum("fk,fk->f", origin - a, across)
        turned = np.cross(origin - a, b - a)
        v, far = scale * (turned @ towards), scale * np.einsum("fk,fk->f", turned, c - a)
        met = (u >= 0) & (v >= 0) & (u + v <= 1) & (far > 0)
    first = int(np.where(met, far, np.inf).argmin())
    return (float(far[first]) if met.any() else np.inf), np.cross(b[first] - a[first], c[first] - a[first])


@pytest.mark.parametrize("kind", CAPTURES)
def test_points_are_where_rays_first_meet_the_scene(kind: str) -> None:
    config = before_a_wall(BUMPY, CAPTURES[kind], transport=FEW, store={"fields": ["histogram"]})
    sample = simulate_sample(config, 1)
    scene = dg.scene_for(config, 1)
    check_points(scene, dg.capture_for(config, scene, config.seed, 1), sample.arrays)
    assert np.isfinite(sample.arrays["sensor_points"]).any()


def test_points_of_scenes_made_in_python(tmp_path: Path) -> None:
    """A ball stands before the wall, so some pixels look at the ball, and one looks past everything. The transient is
    that of another simulator."""
    wall = trimesh.creation.box((0.1, 2, 2)).apply_translation((-0.05, 0, 0))
    ball = trimesh.creation.icosphere(2, 0.3).apply_translation((0.5, 0, 0))
    parts = [dg.Part("wall", wall, dg.Lambertian(0.8), "relay_wall"), dg.Part("ball", ball, dg.Lambertian(0.5))]
    scene = dg.Scene.from_parts(parts)
    laser = dg.Laser((3, -1, 0), [(0, 0, 0.2), (0, 0.7, 0.9), (3, 0, 9)])
    sensor = dg.Sensor.grid((3, -0.8, 0), (0, 0.4, 0), (0, 1.2, 0), (0, 0, 0.3), rows=1, columns=4)
    capture = dg.Capture(laser, sensor, dg.TimeAxis(8, 1e-9))
    light = np.full(capture.shape, 1e-12)
    dg.build_from(
        [(scene, capture), (scene, capture, light)], tmp_path / "set", settings={"transport": FEW}, progress=False
    )
    for index in range(2):
        arrays = Scenes(tmp_path / "set").read(index).arrays
        check_points(scene, capture, arrays)
        assert np.isnan(arrays["laser_points"][2]).all() and np.isnan(arrays["sensor_points"]).any()
