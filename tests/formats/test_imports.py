"""Imports: exported scenes come back bit for bit, and files of other programs are read as these programs read
them."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import scipy.io
import torch
from foreign_files import grid, stanford, tal
from point_target import LIGHT, SCANS

import datagen as dg
from datagen.cli import run
from datagen.config.imported import ImportOptions
from datagen.formats import export
from datagen.formats.containers import VALUES, matlab_content
from datagen.formats.layouts import read_capture
from datagen.formats.recording import Recording, Stated, recording_of
from datagen.store import read_manifest, verify
from datagen.store.info import info
from datagen.store.scenes import SceneContent, Scenes
from datagen.store.verify import dataset_digest

pytestmark = pytest.mark.usefixtures("builds_here")

h5py = pytest.importorskip("h5py", reason="h5py is not installed (extra `export`)")


def brought_back(dataset: Path, folder: Path, format: str, scenes: str = "1", **options: Any) -> Path:
    files = export(dataset, folder / "files", format, scenes, options.pop("light", None))
    dg.import_captures(files, folder / "back.zarr", progress=False, **options)
    return folder / "back.zarr"


def check_geometry(back: SceneContent, m: Recording) -> None:
    """Compare positions up to the float32 of the format, in the frame of the wall."""
    seen, lit = back.arrays["sensor_pixels"], back.arrays["laser_points"]
    np.testing.assert_allclose(lit, m.laser_points, atol=1e-6)
    np.testing.assert_allclose(seen, np.repeat(m.seen_points[:, None], 4, axis=1), atol=1e-6)
    again = recording_of(back).on_wall()
    np.testing.assert_allclose(again.laser_points, m.laser_points, atol=1e-6)
    np.testing.assert_allclose(again.seen_points, m.seen_points, atol=1e-6)
    assert again.paired == m.paired
    right, up = back.arrays["relay_wall"][1:]
    assert right[0] > 0 and up[1] > 0 and right @ up == 0
    corners = back.arrays["relay_wall"][0] + [[-1, -1], [1, 1]] @ back.arrays["relay_wall"][1:]
    both = np.concatenate([lit, seen[:, 0]])[:, :2]
    assert (corners[0, :2] <= both + 1e-9).all() and (both <= corners[1, :2] + 1e-9).all()


CASES = [("confocal", "wall"), ("exhaustive", "wall"), *((scan, "source") for scan in SCANS)]


@pytest.mark.parametrize(("scan", "origin"), CASES)
def test_y_tal_comes_back_bit_for_bit(scan: str, origin: str, made: Any, tmp_path: Path) -> None:
    back = Scenes(brought_back(made(scan, origin), tmp_path, "tal"))
    config = back.manifest.parsed_config()
    m, got = recording_of(Scenes(made(scan, origin)).read(1)).on_wall().from_time_zero(), back.read(0)
    assert got.arrays["histogram"].dtype == np.uint16
    np.testing.assert_array_equal(got.arrays["histogram"], m.values)
    assert config.capture.time.axis() == got.time and got.time.origin == origin
    np.testing.assert_allclose([got.time.width_s, got.time.start_s], [m.time.width_s, m.time.start_s], atol=1e-22)
    check_geometry(got, m)
    np.testing.assert_allclose(got.arrays["laser_position"], m.laser_position, atol=1e-6)
    np.testing.assert_allclose(got.arrays["sensor_position"], m.sensor_position, atol=1e-6)
    assert m.hidden is not None
    np.testing.assert_allclose(got.arrays["hidden_bounds"], m.hidden, atol=1e-9)


@pytest.mark.parametrize(("scan", "origin"), CASES[1:])
def test_matlab_comes_back_bit_for_bit_from_the_wall_on(scan: str, origin: str, made: Any, tmp_path: Path) -> None:
    back = Scenes(brought_back(made(scan, origin), tmp_path, "mat"))
    m, got = recording_of(Scenes(made(scan, origin)).read(1)).on_wall().from_time_zero(), back.read(0)
    values = got.arrays["histogram"]
    shape, bins = m.values.shape[:2], values.shape[-1]
    ways = np.zeros(shape)
    if origin == "source":
        ways = np.linalg.norm(m.laser_points - m.laser_position, axis=-1)[:, None]
        seen = np.linalg.norm(m.seen_points - m.sensor_position, axis=-1)
        ways = ways + (seen[:, None] if m.paired else seen)
    shifts = np.floor(ways / LIGHT / m.time.width_s).astype(int)
    due = np.zeros((*shape, bins))
    for at, shift in np.ndenumerate(shifts):
        there = m.values[at][shift : shift + bins]
        due[at][: len(there)] = there
    np.testing.assert_array_equal(values, due)
    assert values.sum() == m.values.sum() and got.time.origin == "wall"
    np.testing.assert_allclose(got.time.width_s, m.time.width_s, rtol=1e-11)
    check_geometry(got, m)
    assert np.isnan(got.arrays["laser_position"]).all() and np.isnan(got.arrays["hidden_bounds"]).all()


@pytest.mark.parametrize("format", ["tal", "mat"])
def test_light_comes_back_as_light(format: str, made: Any, tmp_path: Path) -> None:
    """And goes through one loader with simulated scenes."""
    simulated = made("confocal")
    back = brought_back(simulated, tmp_path, format, light="transient", bins=1500)
    m = recording_of(Scenes(simulated).read(1), "transient").from_time_zero()
    fields = ("transient", "laser_points")
    (alone,) = dg.TransientDataset(back, fields)  # type: ignore[misc]
    np.testing.assert_array_equal(alone["transient"].numpy(), m.values[..., :1500])
    assert read_manifest(back).schema.by_name["transient"].unit == "as in the file"
    both = torch.utils.data.ConcatDataset([dg.TransientDataset(path, fields) for path in (simulated, back)])
    (batch,) = torch.utils.data.DataLoader(both, batch_size=3, collate_fn=dg.collate)
    # The simulated one begins 40 whole bins after 0, which a file does.
    assert torch.equal(batch["transient"][1, ..., :1460], batch["transient"][2, ..., 40:])


@pytest.mark.parametrize("axes", ["xyt", "yxt", "txy", "tyx"])
def test_light_cone_transform_data(axes: str, tmp_path: Path) -> None:
    path, counts = stanford(tmp_path, axes)
    dg.import_captures(path, tmp_path / "set", bin_width=4e-12, axes=axes, progress=False)
    got = Scenes(tmp_path / "set").read(0)
    np.testing.assert_array_equal(got.arrays["histogram"].reshape(5, 6, 40), counts)
    points = got.arrays["laser_points"].reshape(5, 6, 3)
    # `width` is half of the wall; the first row is the top one.
    np.testing.assert_allclose(points[0, 0], [-0.4, 0.4, 0], atol=1e-12)
    np.testing.assert_allclose(points[-1, -1], [0.4, -0.4, 0], atol=1e-12)
    assert got.time == dg.TimeAxis(40, 4e-12, 0.0, "wall")


def test_time_comes_first_where_the_other_axes_are_alike(tmp_path: Path) -> None:
    counts = np.arange(40 * 9).reshape(40, 3, 3)
    scipy.io.savemat(tmp_path / "cube.mat", {"rect_data": counts, "width": 1})
    dg.import_captures(tmp_path / "cube.mat", tmp_path / "set", bin_width="4ps", progress=False)
    got = Scenes(tmp_path / "set").read(0).arrays["histogram"]
    np.testing.assert_array_equal(got.reshape(3, 3, 40), counts.transpose(2, 1, 0))


def test_f_k_migration_data_with_their_own_file_of_delays(tmp_path: Path) -> None:
    """Version 7.3 with the arrays of MATLAB, as the published ones; shifted as their demonstration shifts them."""
    random = np.random.default_rng(2)
    meas, tof = random.poisson(0.5, (4, 6, 64)).astype(np.uint16), random.uniform(320, 640, (4, 6))
    for name, key, value in (("meas_10min.mat", "meas", meas), ("tof.mat", "tofgrid", tof)):
        with h5py.File(tmp_path / name, "w", userblock_size=512) as file:
            file.create_dataset(key, data=value.T)
    dg.import_captures(
        tmp_path / "meas_10min.mat", tmp_path / "set", bin_width="32ps", wall="2m x 1m", tof=tmp_path / "tof.mat",
        license="CC-BY-4.0", description="A letter.", name="letter", progress=False,
    )  # fmt: skip
    got = Scenes(tmp_path / "set").read(0)
    values = got.arrays["histogram"].reshape(4, 6, -1)
    kept = 64 - int(np.floor(tof / 32).max())
    assert values.shape[-1] == kept == got.time.bins
    for at in np.ndindex(4, 6):
        rolled = np.roll(meas[at], -int(np.floor(tof[at] / 32)))
        np.testing.assert_array_equal(values[at], rolled[:kept])
    np.testing.assert_allclose(np.ptp(got.arrays["laser_points"], axis=0), [2, 1, 0])
    stated = json.loads((tmp_path / "set/dataset.json").read_text())["config"]
    assert (stated["name"], stated["license"], stated["description"]) == ("letter", "CC-BY-4.0", "A letter.")
    options = stated["scene"]["layout"]["options"]
    assert (options["bin_width_ps"], options["wall_m"], options["delays"]["name"]) == (32.0, [2.0, 1.0], "tof.mat")


def light_at(path: Path) -> dict[tuple[float, ...], np.ndarray]:
    """(x, y of laser point, x, y of pixel) → histogram."""
    got = Scenes(path).read(0).arrays
    lit, seen = got["laser_points"][:, :2].round(5), got["sensor_pixels"][:, 0, :2].round(5)
    values = got["histogram"] if "histogram" in got else got["transient"]
    paired = values.shape[1] != len(seen)
    found = {}
    for laser, pixel in np.ndindex(values.shape[:2]):
        place = seen[laser] if paired else seen[pixel]
        found[*(lit[laser] + 0.0).tolist(), *(place + 0.0).tolist()] = values[laser, pixel]
    return found


@pytest.mark.parametrize("mirrored", [False, True])
@pytest.mark.parametrize("form", [1, 2, 3, 4])
def test_every_layout_of_y_tal(form: int, mirrored: bool, tmp_path: Path) -> None:
    """Each histogram stays with its points, whichever way the axes of their grid run."""
    seen, lit = grid(4, 3, mirrored), grid(2, 3)
    if form > 2:
        seen, lit = seen.reshape(-1, 3), lit.reshape(-1, 3)
    alone = form in (1, 3)
    lit = lit.reshape(-1, 3)[1:2].reshape(lit.shape[:0] + ((1, 1, 3) if form == 1 else (1, 3))) if alone else lit
    shape = (16, *(() if alone else lit.shape[:-1]), *seen.shape[:-1])
    h = np.random.default_rng(form).poisson(2.0, shape).astype(np.float32)
    path = tal(tmp_path / "capture.hdf5", h, form, lit, seen)
    dg.import_captures(path, tmp_path / "set", progress=False)
    found = light_at(tmp_path / "set")
    assert len(found) == h[0].size
    for at in np.ndindex(h.shape[1:]):
        laser = lit.reshape(-1, 3)[0] if alone else lit[at[: lit.ndim - 1]]
        pixel = seen[at if alone else at[lit.ndim - 1 :]]
        key = (*laser[:2].astype(float).round(5).tolist(), *pixel[:2].astype(float).round(5).tolist())
        np.testing.assert_array_equal(found[key], h[:, *at])
    order = Scenes(tmp_path / "set").read(0).arrays["sensor_pixels"][:, 0].reshape(3, 4, 3)
    assert (np.diff(order[..., 0], axis=1) > 0).all() and (np.diff(order[..., 1], axis=0) < 0).all()


def test_pixels_and_laser_points_one_for_one_at_other_places(tmp_path: Path) -> None:
    seen = grid(3, 3)
    h = np.random.default_rng(0).random((8, 3, 3)).astype(np.float32)
    tal(tmp_path / "c.hdf5", h, 1, seen + np.float32([0.1, 0, 0]), seen)
    dg.import_captures(tmp_path / "c.hdf5", tmp_path / "set", progress=False)
    got = Scenes(tmp_path / "set")
    assert got.manifest.config["capture"]["pairing"] == "confocal"
    arrays = got.read(0).arrays
    np.testing.assert_allclose(arrays["laser_points"] - arrays["sensor_pixels"][:, 0], [[0.1, 0, 0]] * 9, atol=1e-6)


def test_a_list_that_is_every_pixel_for_every_laser_point(tmp_path: Path) -> None:
    """In any other list each row is a laser point and its pixel."""
    random = np.random.default_rng(3)
    lit, seen = random.normal(size=(3, 3)), random.normal(size=(5, 3))
    rows = random.poisson(3.0, (15, 12))
    pairs = {"laser_points": np.repeat(lit, 5, axis=0), "camera_points": np.tile(seen, (3, 1)), "trans_data": rows}
    for keep, shape in ((15, (3, 5, 12)), (14, (14, 1, 12))):
        scipy.io.savemat(tmp_path / "pairs.mat", {name: of[:keep] for name, of in pairs.items()})
        dg.import_captures(tmp_path / "pairs.mat", tmp_path / f"{keep}", bin_width="8 ps", progress=False)
        got = Scenes(tmp_path / f"{keep}").read(0).arrays
        np.testing.assert_array_equal(got["histogram"], rows[:keep].reshape(shape))


def test_an_imported_dataset_is_like_any_other(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    seen = grid(3, 3)
    h = np.random.default_rng(0).poisson(1.0, (2, 8, 3, 3)).astype(np.float32)
    files = [tal(tmp_path / f"{k}.hdf5", h[k], 1, seen, seen, scene_info="volume: !!python/none x") for k in (0, 1)]
    out = tmp_path / "set"
    assert run(["import", *map(str, files), str(out), "--quiet", "--name", "two"]) == 0
    assert "complete with 2 scenes" in capsys.readouterr().out
    assert run(["import", *map(str, files), str(out), "--quiet", "--name", "two"]) == 0
    assert "nothing left to build" in capsys.readouterr().out
    assert not verify(out, deep=True).problems and len(dataset_digest(out)) == 64
    text = info(out)
    assert "imported     from 2 files (tal): 0.hdf5, 1.hdf5" in text and "read" in text
    text = (out / "README.md").read_text()
    assert "nothing was simulated" in text and "nothing here was measured" not in text and "synthetic" not in text
    assert read_manifest(out).imported[1].sha256 in text
    card = json.loads((out / "croissant.json").read_text())
    assert "Imported" in card["rai:dataCollection"] and "Imported" in card["description"]
    assert dg.TransientDataset(out, "histogram").parameters("capture.file").tolist() == ["0.hdf5", "1.hdf5"]
    for format in ("tal", "mat", "npz", "h5", "hub"):
        assert export(out, tmp_path / format, format)


def test_one_capture_under_two_names_is_in_one_split(tmp_path: Path) -> None:
    seen, files = grid(2, 2), []
    for number in range(20):
        h = np.full((4, 2, 2), number // 2, np.float32)
        files.append(tal(tmp_path / f"{number:02}.hdf5", h, 1, seen, seen))
    dg.import_captures(files, tmp_path / "set", progress=False)
    data = dg.TransientDataset(tmp_path / "set", "histogram")
    splits = data.parameters("split").reshape(-1, 2)
    assert (splits[:, 0] == splits[:, 1]).all() and len(set(splits[:, 0])) > 1


def test_noise_is_drawn_anew_where_the_detector_is_known(tmp_path: Path) -> None:
    seen = grid(2, 2)
    path = tal(tmp_path / "c.hdf5", np.full((8, 2, 2), 1.5e-9, np.float32), 1, seen, seen, delta_t=3.0)
    dg.import_captures(path, tmp_path / "bare", progress=False)
    with pytest.raises(dg.InputError, match="detector"):
        dg.TransientDataset(tmp_path / "bare", "histogram", redraw_noise=True)
    detector = {"detector": {"mode": "ideal", "photons_per_pulse": 1e10, "cycles": 1000}}
    dg.import_captures(path, tmp_path / "set", settings=detector, progress=False)
    data = dg.TransientDataset(tmp_path / "set", "histogram", redraw_noise=True)
    first, second = data[0]["histogram"], data[0]["histogram"]
    assert not torch.equal(first, second)
    # 1.5e-9 · 1e10 · 1000 photons, of which 0.3 are detected.
    assert abs(float(first.mean()) / 4500 - 1) < 0.02


@pytest.mark.parametrize("packed", [False, True])
def test_matlab_arrays_are_read_as_scipy_reads_them(packed: bool, tmp_path: Path) -> None:
    random = np.random.default_rng(4)
    kinds = ("i1", "u1", "i2", "u2", "i4", "u4", "f4", "f8", "i8", "u8")
    variables: dict[str, Any] = {f"of_{kind}": random.integers(0, 99, (3, 4, 5)).astype(kind) for kind in kinds}
    variables |= {"a": 3.5, "tiny": np.uint8([[1, 2]]), "none": np.zeros((0, 3)), "on": np.array([[True, False]])}
    scipy.io.savemat(tmp_path / "m.mat", {"text": "left out", **variables, "cell": np.array([1, "x"], object)},
                     do_compression=packed)  # fmt: skip
    content = matlab_content(tmp_path / "m.mat", dict.fromkeys((*variables, "missing"), VALUES))
    assert content.names == ("text", *variables, "cell") and set(content.arrays) == set(variables)
    for name, due in scipy.io.loadmat(tmp_path / "m.mat", variable_names=list(variables)).items():
        if name in variables:
            np.testing.assert_array_equal(content.arrays[name], due)
    for name, piece in (("text", "text"), ("cell", "cell array")):
        with pytest.raises(dg.InputError, match=piece):
            matlab_content(tmp_path / "m.mat", {name: VALUES})


@pytest.mark.parametrize("name", ["c.hdf5", "plain.mat", "packed.mat"])
def test_no_damage_ends_in_anything_but_a_line(name: str, tmp_path: Path) -> None:
    """Whatever bytes are changed or cut, the file is read or refused in one line."""
    random, path = np.random.default_rng(5), tmp_path / name
    if name == "c.hdf5":
        tal(path, random.poisson(1.0, (8, 2, 2)).astype(np.float32), 1, grid(2, 2), grid(2, 2))
    else:
        variables = {"rect_data": np.ones((2, 2, 9)), "width": 1.0}
        scipy.io.savemat(path, variables, do_compression=name == "packed.mat")
    whole, refused = path.read_bytes(), 0
    for _ in range(40):
        harmed = bytearray(whole[: random.integers(1, len(whole))] if random.random() < 0.2 else whole)
        reach = min(len(harmed), int(random.choice([256, 2048, len(harmed)])))
        for place in random.integers(0, reach, random.integers(1, 12)):
            harmed[place] = random.integers(256)
        path.write_bytes(harmed)
        try:
            options = ImportOptions(bin_width_ps=None if name == "c.hdf5" else 4.0)
            form = "tal" if name == "c.hdf5" else "mat"
            read = read_capture(path, form, Stated(options))[0].first
            assert read.in_order().geometry()["laser_points"].shape[1] == 3
        except dg.InputError as error:
            refused += 1
            assert "\n" not in str(error) and len(str(error)) < 900
    assert refused > 10
