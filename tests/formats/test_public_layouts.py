"""Layouts of public data sets: small files of each, written here, come in with their geometry and their times, so
that the light of a hidden point lands in its bin."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import scipy.io

import datagen as dg
from datagen.cli import run
from datagen.formats.containers import hdf5_content, matlab_content, numpy_content
from datagen.formats.layouts import LAYOUTS
from datagen.store import read_manifest
from datagen.store.info import info
from datagen.store.scenes import Scenes

pytestmark = pytest.mark.usefixtures("builds_here")

h5py = pytest.importorskip("h5py", reason="h5py is not installed (extra `export`)")

BIN_M, BINS = 0.02, 400
BIN = {"bin_width": "20mm"}
POINT = np.array([0.21, -0.13, 0.7])
"""A hidden point before a wall z = 0, off all axes of symmetry, so that no exchange of axes leaves its light
alone."""
MOVED = np.add(POINT, [[0, 0, 0], [0.1, 0.1, 0.2], [0, -0.2, -0.3]])
"""The hidden point in the frames of a file."""
DEVICE = np.array([-0.5, 0.2, 1.1])


def wall(rows: int = 4, columns: int = 5, width: float = 0.8, height: float = 0.6) -> np.ndarray:
    """(row, column, 3) points of a wall z = 0 from the top left."""
    x, y = np.meshgrid(np.linspace(-width / 2, width / 2, columns), np.linspace(height / 2, -height / 2, rows))
    return np.stack([x, y, 0 * x], axis=-1)


def light(lit: np.ndarray, seen: np.ndarray, point: np.ndarray = POINT, legs: bool = False) -> np.ndarray:
    """(…, bin) counts: a hundred in the bin of the way from (…, 3) laser points over the hidden point to what is
    seen."""
    lit, seen = np.broadcast_arrays(lit, seen)
    way = np.linalg.norm(lit - point, axis=-1) + np.linalg.norm(seen - point, axis=-1)
    if legs:
        way = way + np.linalg.norm(lit - DEVICE, axis=-1) + np.linalg.norm(seen - DEVICE, axis=-1)
    counts = np.zeros((*way.shape, BINS), np.uint16)
    np.put_along_axis(counts, np.floor(way / BIN_M).astype(int)[..., None], 100, axis=-1)
    return counts


def along(point: Any, *axes: int) -> np.ndarray:
    """A point, or points, with its coordinates in another order."""
    return np.asarray(point)[..., list(axes)]


@dataclass
class Kind:
    """A file, the options that it needs, the hidden point in its frame, words of what was taken, and what else is
    true.

    shape : (lasers, pixels) of a scene.
    """

    file: Path
    shape: tuple[int, int]
    said: tuple[str, ...]
    options: dict[str, Any] = field(default_factory=dict)
    point: np.ndarray = field(default_factory=lambda: POINT)
    scenes: int = 1


def mat(path: Path, **variables: Any) -> Path:
    scipy.io.savemat(path, variables)
    return path


def mat73(path: Path, structure: str | None = None, **variables: Any) -> Path:
    """A file of MATLAB 7.3: axes the other way round, and a structure is a group."""
    with h5py.File(path, "w", userblock_size=512) as file:
        target = file if structure is None else file.create_group(structure)
        for name, value in variables.items():
            target.create_dataset(name, data=np.atleast_2d(value).T)
    return path


def fk_frames(folder: Path) -> Kind:
    """f-k migration's interactive captures: (frame, y, x, time), with a file of delays."""
    seen = wall()
    leg = 2 * np.linalg.norm(seen - DEVICE, axis=-1)
    whole = np.floor(leg / BIN_M).astype(int)
    meas = np.stack([light(seen, seen, at) for at in MOVED])
    late = np.zeros((*meas.shape[:3], BINS + 300), np.uint16)
    for row, column in np.ndindex(whole.shape):
        late[:, row, column, whole[row, column] : whole[row, column] + BINS] = meas[:, row, column]
    tof = mat(folder / "tof_32.mat", tofgrid=1e12 * whole * BIN_M / 299792458 + 1e-6)
    return Kind(
        mat(folder / "meas_32.mat", meas=late), (20, 1), ("meas (frame, y, x, time)", "3 frames", "tofgrid"),
        BIN | {"tof": tof, "wall": "80cm x 60cm"}, scenes=3,
    )  # fmt: skip


def fk_uneven(folder: Path) -> Kind:
    seen = wall(4, 4, 0.8, 0.8)
    seen[..., 2] = np.random.default_rng(0).uniform(0, 0.1, (4, 4))
    places = mat(folder / "calibration.mat", z_offset=seen[..., 2], width=0.8)
    return Kind(
        mat(folder / "meas_150sec.mat", meas=light(seen, seen)), (16, 1), ("z_offset", "m deep", "from the wall"),
        BIN | {"tof": "none", "points": places},
    )  # fmt: skip


def fk_positions(folder: Path) -> Kind:
    """Points that count from the scanner, which stands at their origin."""
    seen = wall()
    places = mat(folder / "tof.mat", pos=seen - DEVICE)
    options = BIN | {"tof": "none", "points": places}
    return Kind(
        mat(folder / "meas.mat", meas=light(seen, seen)), (20, 1), ("points of pos",), options, POINT - DEVICE
    )


def one_laser_point(folder: Path) -> Kind:
    """`rect_data` beside variables that the light-cone transform does not have."""
    seen, lit = wall(5, 5, 1.0, 1.0), np.array([0.1, 0.05, 0.0])
    rect = light(lit, seen).swapaxes(0, 1)
    file = mat(folder / "pf.mat", rect_data=rect, laserPos=lit, ts=16e-12, width=0.5)
    return Kind(
        file, (1, 25), ("1 laser points × 25 pixels", "laser point at 0.1, 0.05, 0 m"), BIN | {"laser": "0.1,0.05,0"}
    )


def zaragoza(folder: Path, lit: np.ndarray, confocal: bool, matlab: bool = False, side: float = 1.0) -> Kind:
    """Wall in the plane of x and z, hidden part at y > 0; six bounces, of which the third has the light."""
    seen = along(wall(), 0, 2, 1)
    lit = along(lit, 0, 2, 1)
    point, device = along(POINT, 0, 2, 1), along(DEVICE, 0, 2, 1)
    pairs = (seen, seen) if confocal else (lit[None, None], seen[:, :, None, None])
    counts = np.moveaxis(light(*(along(of, 0, 2, 1) for of in pairs), legs=True), -1, 0)
    data = np.zeros((1, BINS, 6, *counts.shape[1:]), np.float32)
    data[0, :, 2] = counts
    normals = [np.broadcast_to([0.0, side, 0.0], of.shape) for of in (seen, lit)]
    content = {
        "data": data, "cameraGridPositions": np.moveaxis(seen, -1, 0), "laserGridPositions": np.moveaxis(lit, -1, 0),
        "cameraGridNormals": np.moveaxis(normals[0], -1, 0), "laserGridNormals": np.moveaxis(normals[1], -1, 0),
        "cameraPosition": device[:, None], "laserPosition": device[:, None], "deltaT": BIN_M, "t0": 0.0,
        "isConfocal": int(confocal), "hiddenVolumePosition": point, "hiddenVolumeSize": 0.4,
        "hiddenVolumeRotation": np.zeros(3), "t": BINS,
    }  # fmt: skip
    said = ("Zaragoza NLOS dataset", "counted from the laser", "bounces added up")
    if side < 0:
        said = (*said, "the hidden volume lies behind the normals")
    lasers = 20 if confocal else lit.size // 3
    shape = (20, 1) if confocal else (lasers, 20)
    if matlab:
        return Kind(
            mat(folder / "z.mat", **{k: np.asarray(v).T for k, v in content.items()}), shape, said, point=point
        )
    with h5py.File(folder / "z.hdf5", "w") as file:
        for name, value in content.items():
            file[name] = value
    return Kind(folder / "z.hdf5", shape, said, point=point)


def netf_made_over(folder: Path) -> Kind:
    seen = along(wall(), 0, 2, 1)
    point = along(POINT, 0, 2, 1)
    data = np.moveaxis(light(wall(), wall()), -1, 0).astype(np.float64)
    file = mat(
        folder / "zaragoza.mat", data=data, cameraGridPositions=seen.reshape(-1, 3).T, cameraGridPoints=[[5, 4]],
        deltaT=BIN_M, hiddenVolumePosition=point, hiddenVolumeSize=0.4,
    )  # fmt: skip
    return Kind(file, (20, 1), ("as NeTF makes it over", "last axis fastest"), point=point)


def netf_measured(folder: Path) -> Kind:
    """Rows ascend, over the wall y = 0."""
    data = np.moveaxis(light(wall(4, 5, 0.8, 0.8), wall(4, 5, 0.8, 0.8))[::-1], -1, 0)
    file = mat(folder / "real.mat", data=data, wall_size=0.8, time_bin=BIN_M / 299792458, speed_light=3e8)
    return Kind(
        file, (20, 1), ("NeTF, measured", "data (time, y, x)", "hidden part at y > 0"), point=along(POINT, 0, 2, 1)
    )


def netf_simulated(folder: Path) -> Kind:
    data = light(wall(4, 5, 0.8, 0.8), wall(4, 5, 0.8, 0.8))[::-1].swapaxes(0, 1)
    file = mat(folder / "sim.mat", data=data, wall_size=0.8, deltaT=BIN_M)
    return Kind(file, (20, 1), ("NeTF, simulated", "data (x, y, time)"), point=along(POINT, 0, 2, 1))


def of_nlosdata(confocal: bool = True) -> dict[str, Any]:
    return {
        "transient": light(wall(), wall()).astype(np.float64), "l": wall().reshape(-1, 3), "s": wall().reshape(-1, 3),
        "times": BIN_M * np.arange(1, BINS + 1), "is_confocal": float(confocal), "delta": BIN_M,
    }  # fmt: skip


def convolutional(folder: Path) -> Kind:
    file = mat(folder / "soap.mat", NLOSDATA={"obj_name": "soap", **of_nlosdata()})
    return Kind(file, (20, 1), ("convolutional", "NLOSDATA.transient (a, b, time)"))


def convolutional_73(folder: Path) -> Kind:
    return Kind(mat73(folder / "bunny.mat", "NLOSDATA", **of_nlosdata()), (20, 1), ("convolutional",))


def fermat(folder: Path, lit: np.ndarray | None, **other: Any) -> Kind:
    seen = wall().reshape(-1, 3)
    file = mat(
        folder / "plane.mat", transients=light(seen if lit is None else lit, seen), detLocs=100 * seen,
        detGridSize=[5, 4], temporalBinCenters=100 * BIN_M * (np.arange(BINS) + 0.5),
        srcLoc=np.zeros((0, 0)) if lit is None else 100 * lit, **other,
    )  # fmt: skip
    return Kind(file, (20, 1) if lit is None else (1, 20), ("Fermat paths", "lengths in cm", "from 0 ns"))


def consumer(folder: Path) -> Kind:
    seen = wall(4, 4).reshape(-1, 3)
    np.savez(folder / "volume_000000.npz", hists=light(seen, seen) / 100.0, pt_cloud=seen)
    return Kind(
        folder / "volume_000000.npz", (16, 1), ("consumer NLOS", "each zone is taken to light what it sees"), BIN
    )


def mitransient(folder: Path) -> Kind:
    """(y, x, time, channel), times from the wall, one laser point."""
    lit = np.array([-0.1, 0.1, 0.0])
    np.save(folder / "transient.npy", np.stack([light(lit, wall())] * 3, axis=-1).astype(np.float32))
    options = BIN | {"axes": "yxtc", "tof": "none", "start": "0ns", "wall": "80cm x 60cm", "laser": tuple(lit)}
    return Kind(folder / "transient.npy", (1, 20), ("array (y, x, time, channel)",), options)


def any_array(folder: Path) -> Kind:
    file = mat(folder / "lab.mat", final_meas=np.moveaxis(light(wall(), wall()), -1, 0), notes=np.ones(3))
    options = {"axes": "tyx", "tof": "none", "start": "0ns", "wall": "80cm x 60cm", "laser": "confocal"}
    return Kind(file, (20, 1), ("an array", "final_meas (time, y, x)"), BIN | options | {"variable": "final_meas"})


def one_of_npz(folder: Path) -> Kind:
    """Frames, of which each is a scene, in a file with other arrays."""
    np.savez(folder / "lab.npz", counts=np.stack([light(wall(), wall())] * 2), exposure_s=np.ones(2))
    options = {"axes": "fyxt", "tof": "none", "start": 0.0, "wall": (0.8, 0.6), "laser": "confocal"}
    said = ("counts (frame, y, x, time)", "2 frames")
    return Kind(folder / "lab.npz", (20, 1), said, BIN | options | {"variable": "counts"}, scenes=2)


def array_in_hdf5(folder: Path) -> Kind:
    """With bins that begin later than the light leaves the wall."""
    with h5py.File(folder / "d.h5", "w") as file:
        file["data_t"] = light(wall(), wall())[..., 20:]
    options = {"axes": "yxt", "tof": "none", "start": "0.4m", "wall": "80cm x 60cm", "laser": "confocal"}
    return Kind(folder / "d.h5", (20, 1), ("from 1.334",), BIN | options | {"variable": "data_t"})


KINDS: dict[str, Callable[[Path], Kind]] = {
    "f-k, interactive": fk_frames, "f-k, uneven wall": fk_uneven, "f-k, positions": fk_positions,
    "rect_data of one laser point": one_laser_point,
    "Zaragoza, confocal": lambda folder: zaragoza(folder, wall(), True),
    "Zaragoza, single": lambda folder: zaragoza(folder, np.array([[[0.1, 0.07, 0.0]]]), False),
    "Zaragoza, exhaustive": lambda folder: zaragoza(folder, wall(2, 3), False),
    "Zaragoza, exhaustive, by MATLAB": lambda folder: zaragoza(folder, wall(2, 3), False, matlab=True),
    "Zaragoza, normals from the hidden part": lambda folder: zaragoza(folder, wall(), True, side=-1.0),
    "NeTF, Zaragoza": netf_made_over, "NeTF, measured": netf_measured, "NeTF, simulated": netf_simulated,
    "convolutional": convolutional, "convolutional, 7.3": convolutional_73,
    "Fermat, confocal": lambda folder: fermat(folder, None),
    "Fermat, one laser point": lambda folder: fermat(folder, np.array([0.1, 0.2, 0.0]), whetherConfocal=False),
    "consumer": consumer, "mitransient": mitransient, "any array": any_array, "any array, HDF5": array_in_hdf5,
    "any array, npz": one_of_npz,
}  # fmt: skip


def check_point(path: Path, scene: int, point: np.ndarray) -> None:
    """Check that each histogram has all its light in the bin of the way over a hidden point, as positions and times
    of the dataset say."""
    got = Scenes(path).read(scene)
    values = got.arrays["histogram" if "histogram" in got.arrays else "transient"]
    lit, seen = got.arrays["laser_points"], got.arrays["sensor_pixels"][:, 0]
    if values.shape[1] == 1 and len(seen) == len(lit):
        pairs = lit[:, None], seen[:, None]
    else:
        pairs = lit[:, None], seen[None]
    way = sum(np.linalg.norm(of - point, axis=-1) for of in pairs)
    if got.time.origin == "source":
        way = way + np.linalg.norm(pairs[0] - got.arrays["laser_position"], axis=-1)
        way = way + np.linalg.norm(pairs[1] - got.arrays["sensor_position"], axis=-1)
    due = np.floor((way / 299792458 - got.time.start_s) / got.time.width_s + 1e-6)
    share = np.take_along_axis(values, due.astype(int)[..., None], axis=-1)[..., 0] / values.sum(axis=-1)
    assert (share == 1).all(), share
    # What is hidden lies before the wall.
    wall_of = got.arrays["relay_wall"]
    assert np.cross(wall_of[1], wall_of[2]) @ (point - wall_of[0]) > 0
    assert values.dtype == (np.float32 if "transient" in got.arrays else np.uint16)


@pytest.mark.parametrize("name", KINDS)
def test_the_light_of_a_hidden_point_lands_in_its_bin(
    name: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    kind = KINDS[name](tmp_path)
    result = dg.import_captures(kind.file, tmp_path / "set", **kind.options)
    assert result.scenes == kind.scenes
    lines = [line for line in capsys.readouterr().err.splitlines() if line.startswith("taken: ")]
    assert len(lines) == 1 and all(piece in lines[0] for piece in kind.said), lines
    stated = read_manifest(tmp_path / "set")
    assert lines[0] == f"taken: {stated.imported[0].taken}" and stated.imported[0].taken in info(tmp_path / "set")
    got = Scenes(tmp_path / "set").read(0)
    values = got.arrays["histogram" if "histogram" in got.arrays else "transient"]
    assert values.shape[:2] == kind.shape and got.time.width_s == pytest.approx(BIN_M / 299792458, rel=1e-6)
    check_point(tmp_path / "set", 0, kind.point)


def test_frames_of_one_file_are_scenes(tmp_path: Path) -> None:
    kind = fk_frames(tmp_path)
    dg.import_captures(kind.file, tmp_path / "set", progress=False, **kind.options)
    for scene, point in enumerate(MOVED):
        check_point(tmp_path / "set", scene, point)
        assert Scenes(tmp_path / "set").read(scene).parameters["capture.frame"] == scene


LIT = np.array([0.1, 0.2, 0.0])
SPARE = {"rect_data": light(wall(), wall()), "width": 0.4}
GRID = {"axes": "yxt", "tof": "none", "start": "0ns", "wall": "1m", "laser": "confocal"} | BIN
REFUSED: dict[str, tuple[Callable[[Path], tuple[Path, dict[str, Any]]], str]] = {
    "rect_data that may be of one laser point": (
        lambda f: (mat(f / "a.mat", laserPos=LIT, **SPARE), BIN), "laser = 'confocal'"),
    "meas that may be of one laser point": (
        lambda f: (mat(f / "a.mat", meas=SPARE["rect_data"], cameraPos=LIT), BIN | {"tof": "none"}),
        "has meas (4, 5, 400), cameraPos (1, 3)"),
    "an array that says nothing": (
        lambda f: (any_array(f).file, {"variable": "final_meas"}),
        "the width of its bins (bin_width = '32ps'), when its first bin begins (start = '0ns'), whether times count"),
    "an array without a name": (
        lambda f: (mitransient(f).file, BIN), "device = 'tmf8820'"),
    "a variable that is not there": (
        lambda f: (any_array(f).file, GRID | {"variable": "meas"}), "has final_meas (400, 4, 5)"),
    "no known layout": (lambda f: (any_array(f).file, {}), "variable = 'final_meas'"),
    "other axes": (
        lambda f: (any_array(f).file, GRID | {"variable": "final_meas", "axes": "yxtc"}),
        "(y, x, time, channel) is needed"),
    "an axis twice": (
        lambda f: (any_array(f).file, GRID | {"variable": "final_meas", "axes": "yyxt"}), "yyxt"),
    "a laser that is no place": (
        lambda f: (any_array(f).file, GRID | {"variable": "final_meas", "laser": "0.1,0"}), "x,y,z"),
    "a wall for a layout that has one": (
        lambda f: (fermat(f, None).file, {"wall": "2m"}), "says it itself (Fermat paths)"),
    "consumer NLOS without the width of a bin": (
        lambda f: (consumer(f).file, {}), "the width of its bins: missing"),
    "points of another shape": (
        lambda f: (mat(f / "m.mat", meas=SPARE["rect_data"]),
                       BIN | {"tof": "none", "points": mat(f / "p.mat", scan_grid=np.ones((3, 20)))}),
        "scan_grid (3, 20)"),
    "Zaragoza of other lasers": (
        lambda f: (without(zaragoza(f, wall(), True).file, "laserGridPositions", np.ones((3, 2, 2))), {}),
        "4 laser points and 20 of the camera"),
    "NeTF of one laser point": (
        lambda f: (mat(f / "n.mat", data=np.ones((9, 2, 2)), cameraGridPositions=np.ones((3, 4)), deltaT=0.01,
                           isConfocal=0.0), {}), "isConfocal = 0"),
    "convolutional, not confocal": (
        lambda f: (mat(f / "c.mat", NLOSDATA=of_nlosdata(False)), {}), "trans_data (N, T)"),
    "convolutional that does not say its laser": (
        lambda f: (mat(f / "c.mat", NLOSDATA={"transient": np.ones((2, 2, 9)), "l": np.ones((4, 3))}), {}),
        "no NLOSDATA.is_confocal; say laser = 'confocal'"),
    "a structure without the fields": (
        lambda f: (mat(f / "c.mat", NLOSDATA={"times": np.ones(3)}), {}), "NLOSDATA.transient: missing"),
    "Fermat of uneven bins": (
        lambda f: (mat(f / "u.mat", transients=np.ones((4, 3)), detLocs=np.ones((4, 3)), srcLoc=LIT,
                           temporalBinCenters=[1.0, 2.0, 4.0]), {}), "evenly spaced"),
    "Fermat that does not say its laser": (
        lambda f: (mat(f / "u.mat", transients=np.ones((4, 3)), detLocs=np.ones((4, 3)),
                           temporalBinCenters=[1.0, 2.0, 3.0]), {}), "no whetherConfocal and srcLoc; say laser"),
    "Fermat of another laser": (lambda f: (fermat(f, None).file, {"laser": "0.1,0,0"}), "says confocal"),
    "Fermat of two laser points": (
        lambda f: (fermat(f, LIT).file, {"laser": "0.1,0,0"}), "has srcLoc; leave laser out"),
    "fields of frequencies": (
        lambda f: (mat73(f / "rsd.mat", u_total=np.ones((4, 4, 3)), omega_space=np.ones(3)), {}),
        "cannot be had"),
    "NLOS-DIRAC": (
        lambda f: (hdf5(f / "d.hdf5", data_t=np.ones((9, 2, 2)), offset_laser=0.0, offset_camera=1.0), {}),
        "variable = 'data_t'"),
    "negative light": (
        lambda f: (mat(f / "n.mat", rect_data=-1.0 * light(wall(), wall()), width=0.4), BIN), "negative"),
    "objects in NumPy": (
        lambda f: (npy(f / "o.npy", np.array([1, "x"], object)), GRID), "cannot be read"),
    "texts in NumPy": (
        lambda f: (npy(f / "o.npy", np.array([["x"]])), GRID), "real numbers are needed"),
}  # fmt: skip
"""Kind → what writes the file with the options, and a piece of the refusal."""


def hdf5(path: Path, **content: Any) -> Path:
    with h5py.File(path, "w") as file:
        for name, value in content.items():
            file[name] = value
    return path


def without(path: Path, name: str, value: np.ndarray) -> Path:
    with h5py.File(path, "a") as file:
        del file[name]
        file[name] = value
    return path


def npy(path: Path, value: np.ndarray) -> Path:
    np.save(path, value, allow_pickle=True)
    return path


@pytest.mark.parametrize("name", REFUSED)
def test_what_is_not_known_is_asked_for_in_a_line(name: str, tmp_path: Path) -> None:
    write, piece = REFUSED[name]
    file, options = write(tmp_path)
    with pytest.raises(dg.InputError) as refused:
        dg.import_captures(file, tmp_path / "set", progress=False, **options)
    message = str(refused.value)
    assert "\n" not in message and len(message) < 700 and piece in message, message
    assert not (tmp_path / "set").exists()


def test_every_layout_is_written_here_or_in_the_other_tests_of_imports(tmp_path: Path) -> None:
    """A row of the table that no test reads would be a claim."""
    written, elsewhere = set[str](), {"y-tal", "pairs of points"}
    for number, write in enumerate([*KINDS.values(), *(write for write, _ in REFUSED.values())]):
        (folder := tmp_path / str(number)).mkdir()
        kind = write(folder)
        file = kind.file if isinstance(kind, Kind) else kind[0]
        container = {".mat": matlab_content, ".hdf5": hdf5_content, ".h5": hdf5_content}.get(
            file.suffix, numpy_content
        )
        if file.stem != "o":
            content = container(file, {})
            written |= {next((layout.name for layout in LAYOUTS if layout.fits(content)), "")}
    assert {layout.name for layout in LAYOUTS} - elsewhere == written - {""}


def denali(
    folder: Path, place: int, size: int = 3, name: str = "A_4inch_3x3_lighton_NLOSdata"
) -> tuple[Path, np.ndarray]:
    counts = np.random.default_rng(place).poisson(20.0, (3, size, size, 128))
    path = folder / name / "spad_histogram" / f"{place:03d}.npy"
    path.parent.mkdir(parents=True, exist_ok=True)
    np.save(path, counts)
    return path, counts


def test_denali_with_its_labels(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Repeats are scenes; places, classes and sizes are parameters of scenes."""
    places = tmp_path / "tag1_positions.json"
    places.write_text(json.dumps({f"frame{k}_tag1": [k / 10, -k / 10, 1.0] for k in (7, 17)}))
    (first, counts), (second, _) = denali(tmp_path, 7), denali(tmp_path, 17, name="bowl_8inch_3x3_lightoff_NLOSdata")
    out = tmp_path / "set"
    arguments = ["import", str(first), str(second), str(out), "--device", "tmf8820", "--places", str(places)]
    assert run(arguments) == 0
    assert "zones in rows from top left" in capsys.readouterr().err
    data = dg.TransientDataset(out, "histogram")
    assert len(data) == 6
    # The device lists columns from the top left.
    due = counts.swapaxes(1, 2).reshape(3, 9, 128)
    for repeat in range(3):
        np.testing.assert_array_equal(data[repeat]["histogram"].numpy().reshape(9, 128), due[repeat])
    of = Scenes(out).read(4).parameters
    assert (of["hidden.class"], of["hidden.size_m"], of["hidden.light"], of["hidden.place"]) == (
        "bowl",
        0.2032,
        "off",
        17,
    )
    assert (of["hidden.x_m"], of["hidden.y_m"], of["hidden.z_m"], of["capture.frame"]) == (1.7, -1.7, 1.0, 1)


def test_denali_of_eight_rows_needs_no_order(tmp_path: Path) -> None:
    path, counts = denali(tmp_path, 3, 8, "A_4inch_8x8_lighton_NLOSdata")
    dg.import_captures(path, tmp_path / "set", device="tmf8828", progress=False)
    got = Scenes(tmp_path / "set").read(2).arrays["histogram"]
    np.testing.assert_array_equal(got.reshape(8, 8, 128), counts[2])


def test_places_that_are_none(tmp_path: Path) -> None:
    path, _ = denali(tmp_path, 3)
    other = tmp_path / "frames.npy"
    np.save(other, np.ones((1, 3, 3, 128)))
    places = tmp_path / "p.json"
    for text, file, piece in (
        ('{"frame3_tag1": [1, 2]}', path, "holds no places of DENALI"), ("[1, 2]", path, "three numbers"),
        ('{"frame4_tag1": [1, 2, 3]}', path, "frame3_tag1"), ('{"other": 1}', path, "no frame"),
        ('{"frame3_tag1": [1, 2, NaN]}', path, "finite"), ('{"frame3_tag1": [1, 2, 3]}', other, "spad_histogram"),
    ):  # fmt: skip
        places.write_text(text)
        with pytest.raises(dg.InputError, match=piece):
            dg.import_captures(file, tmp_path / "set", device="tmf8820", places=places, progress=False)
    with pytest.raises(dg.InputError, match="no such file"):
        dg.import_captures(path, tmp_path / "set", device="tmf8820", places=tmp_path / "none.json", progress=False)
    with pytest.raises(dg.InputError, match="holds no frames of a sensor"):
        dg.import_captures(fermat(tmp_path, None).file, tmp_path / "set", places=places, progress=False)


@pytest.mark.parametrize(
    "name", ["convolutional", "convolutional, 7.3", "Zaragoza, single", "consumer", "mitransient"]
)
def test_no_damage_ends_in_anything_but_a_line(name: str, tmp_path: Path) -> None:
    """Whatever bytes are changed or cut, a file of a public layout is read or refused in one line."""
    from datagen.formats.imports import _format_of, _stated_by
    from datagen.formats.layouts import read_capture

    kind, random = KINDS[name](tmp_path), np.random.default_rng(6)
    asked = ("bin_width", "wall", "tof", "axes", "bins", "variable", "laser", "points", "start")
    stated = _stated_by(*(kind.options.get(argument) for argument in asked))
    whole, refused = kind.file.read_bytes(), 0
    for _ in range(40):
        harmed = bytearray(whole[: random.integers(1, len(whole))] if random.random() < 0.2 else whole)
        reach = min(len(harmed), int(random.choice([256, 2048, len(harmed)])))
        for place in random.integers(0, reach, random.integers(1, 12)):
            harmed[place] = random.integers(256)
        kind.file.write_bytes(harmed)
        try:
            read = read_capture(kind.file, _format_of(kind.file, None, None), stated)[0].first
            assert read.in_order().geometry()["laser_points"].shape[1] == 3
        except dg.InputError as error:
            refused += 1
            assert "\n" not in str(error) and len(str(error)) < 1200
    assert refused > 5
