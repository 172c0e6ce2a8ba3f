"""Captures held against their simulation: what was displaced is found, and real captures agree as far as stated."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import trimesh
import yaml
from click.testing import CliRunner
from damage import small_dataset
from rooms import ONE_BOUNCE
from scipy.spatial.transform import Rotation

import datagen as dg
from datagen.cli import cli
from datagen.config import config_from_mapping
from datagen.devices import Comparison, Fitted
from datagen.devices.zone_order import zones_listed
from datagen.errors import InputError
from datagen.records.arrays import Floats
from datagen.store.scenes import Scenes

pytestmark = pytest.mark.usefixtures("builds_here")

REAL = Path(__file__).resolve().parents[3] / "shared" / "real"
CAPTURES, MESH = REAL / "tmf8820_pyramid.json.gz", REAL / "tmf8820_pyramid.stl"
real = pytest.mark.skipif(
    not CAPTURES.is_file(), reason=f"needs captures of a real sensor, {CAPTURES.name}: not here"
)
ALBEDOS = {"table": 0.6, "thing": 0.3}


def bodies() -> dict[str, trimesh.Trimesh]:
    """A table 1 m wide, and a prism that stands on it."""
    table = trimesh.creation.box((1, 1, 0.1), trimesh.transformations.translation_matrix((0, 0, -0.05)))
    thing = trimesh.creation.box((0.12, 0.07, 0.15), trimesh.transformations.rotation_matrix(0.4, (0, 0, 1)))
    return {"table": table, "thing": thing.apply_translation((0.02, 0.01, 0.075))}


def pose(position: Floats, toward: Floats) -> Floats:
    """(4, 4) pose whose third column looks from a position toward a point."""
    forward = (toward - position) / np.linalg.norm(toward - position)
    left = np.cross((0, 0, 1.0), forward)
    left /= np.linalg.norm(left)
    made = np.eye(4)
    made[:3, :3], made[:3, 3] = np.stack([left, np.cross(forward, left), forward], axis=1), position
    return made


@pytest.fixture(scope="module")
def session() -> dg.Frames:
    """16 noisy frames around a thing on a table, whose true poses differ by a turned mount from those stated."""
    device, rng = dg.device("tmf8820"), np.random.default_rng(1)
    shapes = bodies()
    parts = [dg.Part(name, shapes[name], dg.Lambertian(ALBEDOS[name])) for name in shapes]
    scene = dg.Scene.from_parts([replace(parts[0], role="relay_wall"), parts[1]])
    mount = np.eye(4)
    mount[:3, :3] = Rotation.from_rotvec((0.02, -0.03, 0.01)).as_matrix()
    mount[:3, 3] = (0.004, -0.003, 0.006)
    poses, histograms = [], []
    for angle in np.linspace(0, 2 * np.pi, 16, endpoint=False):
        place = np.array([0.25 * np.cos(angle), 0.25 * np.sin(angle), rng.uniform(0.12, 0.3)])
        poses.append(pose(place, np.array([0.0, 0.0, 0.05])))
        capture, spad, exposure = device.at_pose(poses[-1] @ mount)
        light = dg.simulate(scene, capture, ONE_BOUNCE)
        histograms.append(rng.poisson(dg.expected_histogram(light.total, capture.time, spad, exposure)[0]))
    return dg.Frames("simulated", np.array(histograms, float), np.array(poses))


def around(materials: dict[str, dg.Material], bounces: int, frames: int = 24) -> dg.Frames:
    """Frames without noise around the thing on the table, from where their poses say, with light of more bounces."""
    device, shapes, rng = dg.device("tmf8820"), bodies(), np.random.default_rng(4)
    parts = [dg.Part(name, shapes[name], materials[name]) for name in shapes]
    scene = dg.Scene.from_parts([replace(parts[0], role="relay_wall"), parts[1]])
    accuracy = dg.Accuracy(samples=64, max_bounces=bounces, direct=True)
    poses, histograms = [], []
    for number, angle in enumerate(rng.permutation(frames) * 2 * np.pi / frames):
        place = np.array([0.2 * np.cos(angle), 0.2 * np.sin(angle), rng.uniform(0.05, 0.3)])
        poses.append(pose(place, np.array([*rng.uniform(-0.04, 0.04, 2), 0.04])))
        capture, spad, exposure = device.at_pose(poses[-1])
        light = dg.simulate(scene, capture, accuracy, seed=number)
        histograms.append(dg.expected_histogram(light.total, capture.time, spad, exposure)[0])
    return dg.Frames("simulated", np.array(histograms), np.array(poses))


def test_two_bounces_are_found_as_products_of_albedos(tmp_path: Path) -> None:
    """What paths of two bounces light, which the fit has from the rays of its beam. Without them the table is too
    bright, and late light is left."""
    frames, parts = around({"table": dg.Lambertian(0.8), "thing": dg.Lambertian(0.7)}, 2, 16), parts_of(tmp_path)
    found = dg.compare(frames, alone(), parts, fit=("bounces",))
    for pair in ("table then thing", "thing then table"):
        factor = found.fitted[f"two bounces, {pair}"]
        assert abs(factor.value / 0.56 - 1) < 0.1 and factor.error < 0.05
    assert "two bounces, table then table" not in found.fitted
    before, after = found.steps["albedos, floor"], found.steps["+ bounces"]
    assert after[0] < 0.01 and after[1] < 0.5 * before[1]
    assert abs(found.fitted["albedo of table"].value / 0.8 - 1) < 0.01


def test_a_reflectance_by_angle_is_found_and_lights_scenes_as_it_was(tmp_path: Path) -> None:
    """The material of a table that is darker aslant, and brighter along the normal, comes back from frames, through a
    file, and into a configuration; a matt thing stays matt."""
    table = dg.MeasuredByAngle(0.5, reflectance=(0.3, 0.35, 0.45, 0.55, 0.8))
    frames, parts = around({"table": table, "thing": dg.Lambertian(0.4)}, 1), parts_of(tmp_path)
    found = dg.compare(frames, alone(), parts, fit=("angles",))
    assert found.steps["albedos, floor"][0] > 3 * found.steps["+ angles"][0] and found.steps["+ angles"][0] < 0.01
    # π f of the table back to where light comes from, at the cosines that frames show.
    level = 0.5 * np.sqrt(0.8) / (2 * np.trapezoid(_roots(table) * FINE, FINE)) / 0.8
    np.testing.assert_allclose(found.reflectances["table"][1:], level * np.array(table.reflectance[1:]), rtol=0.04)
    np.testing.assert_allclose(found.reflectances["thing"][1:], 0.4, rtol=0.04)
    dg.write_materials(found.materials, tmp_path / "surfaces.yaml")
    read = dg.read_materials(tmp_path / "surfaces.yaml")
    assert set(read) == {"table", "thing"} and abs(read["table"].albedo / 0.5 - 1) < 0.05
    values = yaml.safe_load((tmp_path / "surfaces.yaml").read_text())["table"]
    config = config_from_mapping({"name": "x", "scene": {"materials": {"floor": values}}})
    room = dg.generate_scene(config.scene, seed=1, index=0)
    assert dict(zip(room.part_names, room.materials, strict=True))["floor"] == read["table"]
    again = around(read, 1, frames=4)
    original = around({"table": table, "thing": dg.Lambertian(0.4)}, 1, frames=4)
    error = np.linalg.norm(again.histograms - original.histograms, axis=2)
    assert np.median(error / np.linalg.norm(original.histograms, axis=2)) < 0.02


FINE = np.linspace(0, 1, 20_001)


def _roots(material: dg.MeasuredByAngle) -> Floats:
    """√reflectance at `FINE`, linear between nodes."""
    return np.asarray(np.interp(FINE, np.linspace(0, 1, len(material.reflectance)), np.sqrt(material.reflectance)))


def test_a_surface_that_would_create_light_is_refused_in_a_line(tmp_path: Path) -> None:
    found = Comparison("a", "b", {}, {}, np.ones((1, 1, 1)), np.ones((1, 1, 1)), reflectances={"plate": (1.2,)})
    with pytest.raises(InputError, match=r"plate: 1\.20 of the light would leave it; .* raise counting.photons_per"):
        _ = found.materials
    for reflectance, material in (((0.4,), dg.Lambertian(0.4)), ((0.0, 0.0), dg.Lambertian(0.0))):
        assert replace(found, reflectances={"plate": reflectance}).materials == {"plate": material}
    with pytest.raises(InputError, match=r"materials: a: Phong; give Lambertian or MeasuredByAngle"):
        dg.write_materials({"a": dg.Phong(0.5)}, tmp_path / "a.yaml")
    (tmp_path / "bad.yaml").write_text("table: {albedo: 2}")
    with pytest.raises(InputError, match=r"a.txt: a file of materials ends in .yaml"):
        command = ["compare", "none.npz", "--device", "tmf8820", "--mesh", "none.stl", "--materials", "a.txt"]
        CliRunner().invoke(cli, command, catch_exceptions=False)
    with pytest.raises(InputError, match=r"bad.yaml: table: albedo"):
        dg.read_materials(tmp_path / "bad.yaml")


def parts_of(folder: Path) -> list[dg.Part]:
    for name, mesh in bodies().items():
        mesh.export(folder / f"{name}.stl")
    return dg.read_parts([folder / "table.stl", folder / "thing.stl"])


def alone() -> dg.Device:
    """The sensor in one mode, which halves the time of a comparison."""
    return dg.device("tmf8820").model_copy(update={"name": "mine"})


@pytest.fixture(scope="module")
def found(session: dg.Frames, tmp_path_factory: pytest.TempPathFactory) -> Comparison:
    return dg.compare(session, alone(), parts_of(tmp_path_factory.mktemp("parts")), fit=("hand",))


def test_a_turned_mount_and_albedos_are_found(found: Comparison) -> None:
    """From the poses as stated histograms are 20 % off; with the mount fitted noise is left."""
    before, after = found.steps["albedos, floor"][0], found.steps["+ hand"][0]
    assert before > 0.1 and after < 0.02
    assert np.median(found.relative_l2) < 0.02 and len(found.measured) == 8
    for name, albedo in ALBEDOS.items():
        assert abs(found.fitted[f"albedo of {name}"].value / albedo - 1) < 0.03
    assert abs(found.fitted["hand: turn y (degrees)"].value - np.degrees(-0.03)) < 0.2
    assert abs(found.fitted["hand: shift z (mm)"].value - 6) < 0.5
    assert max(found.residual_sd) < 5


def test_frames_that_test_change_neither_the_fit_nor_the_mode(
    session: dg.Frames, found: Comparison, tmp_path: Path
) -> None:
    """The second and fourth quarter are replaced by other zones' histograms, half as bright: the fit is the same to
    the bit, and its errors tell of the replacement."""
    replaced = np.array(session.histograms)
    replaced[4:8] = replaced[12:] = 0.5 * np.roll(replaced[4:8], 3, axis=1)
    other, parts = replace(session, histograms=replaced), parts_of(tmp_path)
    after = dg.compare(other, alone(), parts, fit=("hand",))
    assert found.held_out and after.fitted == found.fitted
    assert found.steps["+ hand"][0] < 0.03 and after.steps["+ hand"][0] > 0.5
    both = [dg.compare(frames, dg.device("tmf8820"), parts, fit=()) for frames in (session, other)]
    assert [each.simulated_as for each in both] == ["tmf8820"] * 2 and both[0].fitted == both[1].fitted


def test_few_frames_are_all_fitted_and_the_table_says_so(session: dg.Frames, tmp_path: Path) -> None:
    few = dg.compare(session.some(np.arange(6)), alone(), parts_of(tmp_path), fit=())
    assert len(few.measured) == 6 and not few.held_out
    assert "6 frames tested, which were fitted, too" in few.text()


@pytest.mark.parametrize("order", ["rows from top left", "columns from top left, pairs exchanged"])
def test_zones_in_another_order_are_refused_unless_the_file_states_it(
    order: str, session: dg.Frames, tmp_path: Path
) -> None:
    """The device lists its nine zones by columns from the top left; what was recorded tells the order it is in."""
    listed, parts = zones_listed("", order, alone().zones, 9), parts_of(tmp_path)
    other = replace(session, histograms=session.histograms[:, listed])
    with pytest.raises(InputError, match=f"if zones are listed as '{order}': state zone_order in the file"):
        dg.compare(other, alone(), parts, fit=())
    stated = dg.compare(replace(other, zone_order=order), alone(), parts, fit=())
    np.testing.assert_array_equal(stated.measured, dg.compare(session, alone(), parts, fit=()).measured)


def test_a_mesh_is_divided_where_things_touch(tmp_path: Path) -> None:
    """A pyramid that shares vertices with its table; and a ball, which is one part however coarse."""
    corners = [(-1, -1, 0), (1, -1, 0), (1, 1, 0), (-1, 1, 0), (-0.1, -0.1, 0), (0.1, -0.1, 0), (0.1, 0.1, 0),
               (-0.1, 0.1, 0), (0, 0, 0.2)]  # fmt: skip
    around = [(i, (i + 1) % 4, 4 + (i + 1) % 4) for i in range(4)] + [(i, 4 + (i + 1) % 4, 4 + i) for i in range(4)]
    sides = [(4 + i, 4 + (i + 1) % 4, 8) for i in range(4)]
    trimesh.Trimesh(corners, around + sides, process=False).export(tmp_path / "pyramid.obj")
    trimesh.creation.icosphere(1).export(tmp_path / "ball.stl")
    parts = dg.read_parts([tmp_path / "pyramid.obj", tmp_path / "ball.stl"])
    assert [(part.name, len(part.mesh.faces)) for part in parts] == [("pyramid 0", 8), ("pyramid 1", 4), ("ball", 80)]


def test_what_is_left_is_named() -> None:
    """Of a model that is too bright, too late, too narrow or lacks late light, that effect explains most."""
    bins = np.arange(128.0)
    shape = 1e4 * np.exp(-0.5 * ((bins - 40) / 3) ** 2)
    wider = 1e4 * np.exp(-0.5 * ((bins - 40) / 3.2) ** 2) * 3 / 3.2
    late = np.convolve(shape, np.exp(-bins / 8) / 8)[:128]
    for name, measured in (
        ("brightness", 1.1 * shape),
        ("time", 1e4 * np.exp(-0.5 * ((bins - 40.2) / 3) ** 2)),
        ("width", wider),
        ("late light", shape + 0.1 * late),
    ):
        left = Comparison("a", "b", {}, {}, measured[None, None], shape[None, None]).left
        assert max(left, key=left.__getitem__) == name and left[name] > 0.9


def test_wrong_captures_are_refused_in_a_line(session: dg.Frames, tmp_path: Path) -> None:
    device, parts = dg.device("tmf8820"), parts_of(tmp_path)
    away = np.array(session.poses)
    away[:, :3, [0, 2]] *= -1
    few = device.model_copy(update={"counting": device.counting.model_copy(update={"cycles": 1000})})
    for frames, sensor, named in (
        (replace(session, poses=None), device, "no poses"),
        (replace(session, histograms=session.histograms[:, :4]), device, "4 zones"),
        (replace(session, poses=away), device, "does the sensor's axis meet"),
        (session, few, "raise cycles"),
        (replace(session, histograms=session.histograms * (np.arange(9) != 2)[:, None]), device, "16 histograms are"),
    ):
        with pytest.raises(InputError, match=named):
            dg.compare(frames, sensor, parts)
    (tmp_path / "bad.stl").write_text("nothing")
    for paths in (["none.stl"], [tmp_path / "bad.stl"], [tmp_path / "table.stl"] * 2):
        with pytest.raises(InputError):
            dg.read_parts(paths)
    result = CliRunner().invoke(cli, ["compare", str(tmp_path / "frames.npz")])
    assert isinstance(result.exception, InputError) and "REAL SIMULATED" in str(result.exception)


def test_the_command_writes_numbers_picture_and_device(
    session: dg.Frames, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert session.poses is not None
    np.savez(tmp_path / "frames.npz", hists=session.histograms[::2], pose=session.poses[::2])
    parts_of(tmp_path)
    command = ["compare", str(tmp_path / "frames.npz"), "--device", "tmf8820", "--fixed", "--json"]
    command += ["--mesh", str(tmp_path / "table.stl"), "--mesh", str(tmp_path / "thing.stl")]
    command += ["--picture", str(tmp_path / "fit.png"), "--out", str(tmp_path / "mine.yaml")]
    command += ["--materials", str(tmp_path / "surfaces.yaml")]
    monkeypatch.setattr("datagen.building.progress.LINE_S", 0.0)
    result = CliRunner().invoke(cli, command)
    assert result.exit_code == 0, result.exception
    found = json.loads(result.stdout)
    # There is no terminal here; lines go to standard error.
    assert result.stderr == "8 frames are simulated after a fit of albedos, floor\n"
    assert 0.05 < found["median_relative_l2"] < found["p90_relative_l2"] and found["tested_frames"] == 8
    assert set(found["fitted"]) == {"albedo of table", "albedo of thing", "floor (counts a bin)"}
    assert (tmp_path / "fit.png").stat().st_size > 10_000 and dg.device(tmp_path / "mine.yaml").time.bins == 128
    surfaces = dg.read_materials(tmp_path / "surfaces.yaml")
    assert surfaces["table"].albedo == pytest.approx(found["fitted"]["albedo of table"]["value"], rel=1e-3)


def test_two_datasets_are_compared(tmp_path: Path) -> None:
    """The same scenes with other noise differ by the noise, and the scale is 1."""
    config = config_from_mapping({
        "name": "pair", "scenes": 3, "transport": {"samples": 4},
        "capture": {"scan": {"rows": 2, "columns": 2}, "time": {"bins": 64, "bin_width_ps": 400}},
        "detector": {"cycles": 10**6}, "store": {"fields": ["histogram"]},
    })  # fmt: skip
    other = config.model_copy(update={"detector": config.detector.model_copy(update={"cycles": 3 * 10**6})})
    for name, settings in (("one", config), ("three", other)):
        dg.build(settings, tmp_path / name, progress=False)
    found = dg.compare_datasets(tmp_path / "three", tmp_path / "one")
    scale: Fitted = found.fitted["scale"]
    assert abs(scale.value - 3) < 5 * scale.error + 0.05
    both = [str(tmp_path / "three"), str(tmp_path / "one")]
    result = CliRunner().invoke(cli, ["compare-datasets", *both])
    assert result.exit_code == 0 and "scale" in result.stdout and result.stderr == ""
    # As in 1.1, and with a word.
    before = CliRunner().invoke(cli, ["compare", *both])
    assert before.exit_code == 0 and before.stdout == result.stdout and "compare-datasets" in before.stderr
    with pytest.raises(InputError, match="--out: is not for two datasets"):
        CliRunner().invoke(cli, ["compare", *both, "--out", "x.yaml"], catch_exceptions=False)


def test_each_frame_of_sequences_is_compared(tmp_path: Path) -> None:
    """Of a dataset with itself nothing is left, and nothing that would explain it."""
    small_dataset(tmp_path / "three", frames=3)
    small_dataset(tmp_path / "two", frames=2)
    small_dataset(tmp_path / "still")
    found = dg.compare_datasets(tmp_path / "three", tmp_path / "three")
    assert found.measured.shape == found.modelled.shape == (5 * 3, 2, 8)
    assert found.fitted["scale"].value == pytest.approx(1) and found.relative_l2.max() < 1e-12
    stored = Scenes(tmp_path / "three").read(1).arrays["histogram"][2, :, 0]
    np.testing.assert_array_equal(found.measured[5], stored)
    same = replace(found, modelled=found.measured)
    assert same.left == dict.fromkeys(found.left, 0.0) and "15 frames" in found.text()
    for other, words in (("two", r"\(frame, laser, pixel, bin\) \(3, 2, 1, 8\) and .* \(2, 2, 1, 8\)"),
                         ("still", r"\(3, 2, 1, 8\) and \(laser, pixel, bin\) \(2, 1, 8\)")):  # fmt: skip
        with pytest.raises(InputError, match=f"histograms of .*{words}; they must be alike"):
            dg.compare_datasets(tmp_path / "three", tmp_path / other)


@real
@pytest.mark.parametrize(
    ("step", "median", "ninth"), [(8, 0.1, 0.2), pytest.param(1, 0.067, 0.135, marks=pytest.mark.nightly)]
)
def test_the_real_pyramid_agrees_as_far_as_stated(step: int, median: float, ninth: float) -> None:
    """The catalogue has zones fitted to the first and third quarter. By night: all frames, in every mode."""
    frames, parts = dg.read_frames(CAPTURES).some(np.arange(step // 4, 128, step)), dg.read_parts([MESH])
    if step > 1:
        found = dg.compare(frames, alone(), parts, fit=("hand",))
    else:
        found = dg.compare(frames, dg.device("tmf8820"), parts)
        assert found.simulated_as == "tmf8820"
    assert np.median(found.relative_l2) < median and np.percentile(found.relative_l2, 90) < ninth
