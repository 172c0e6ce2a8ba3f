"""Small files that claim to be huge, or decode to what is: one line, before memory is taken for them."""

from __future__ import annotations

import gzip
import importlib
import io
import sys
import tracemalloc
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
import zarr
from limits import little_memory
from made_suite import made_suite
from numpy.lib import format as npy

import datagen as dg
from datagen.cli import run
from datagen.untrusted import read_npy, read_npz

pytestmark = [
    pytest.mark.usefixtures("builds_here"), pytest.mark.skipif(sys.platform != "linux", reason="needs /proc"),
]  # fmt: skip

MOST_BYTES = 200 * 10**6
Content = bytes | Callable[[], bytes]
"""Large content is made when it is written."""


def words() -> bytes:
    """Text of 25 MB, which compresses to 24 kB and would take 800 MB as Python's dictionaries."""
    return gzip.compress(b"[" + b"{}," * 2**23 + b"{}]")


ALIASES = "a: &a [1, 1, 1, 1, 1, 1, 1, 1, 1, 1]\n" + "".join(
    f"{name}: &{name} [{', '.join(['*' + below] * 10)}]\n" for below, name in zip("abcdef", "bcdefg", strict=True)
)
"""YAML of 400 characters that stands for ten million numbers."""


def declared(shape: tuple[int, ...], values: bytes = b"", dtype: str = "<f8") -> bytes:
    """An array in numpy's format whose head declares a shape, and that has other values."""
    whole = io.BytesIO()
    npy.write_array_header_1_0(whole, {"descr": dtype, "fortran_order": False, "shape": shape})
    return whole.getvalue() + values


def zeros() -> bytes:
    """An array of 115 MB of zeros, which compress to a thousandth and are eight times as many as numbers."""
    return declared((100_000, 9, 128), bytes(100_000 * 9 * 128), "u1")


def long_head() -> bytes:
    return b"\x93NUMPY\x02\x00" + (2**28).to_bytes(4, "little") + b" " * 2**28


def made(content: Content) -> bytes:
    return content if isinstance(content, bytes) else content()


def zipped(path: Path, method: int = zipfile.ZIP_DEFLATED, **members: Content) -> Path:
    with zipfile.ZipFile(path, "w", method) as archive:
        for name, content in members.items():
            archive.writestr(f"{name}.npy", made(content))
    return path


def written(path: Path, content: Content) -> Path:
    path.write_bytes(made(content))
    return path


def frames(name: str, content: Content) -> Callable[[Path], list[str]]:
    return lambda folder: ["import", str(written(folder / name, content)), str(folder / "out"), "--device", "tmf8820"]


def zipped_frames(method: int = zipfile.ZIP_DEFLATED, **members: Content) -> Callable[[Path], list[str]]:
    def command(folder: Path) -> list[str]:
        path = zipped(folder / "frames.npz", method, **members)
        return ["import", str(path), str(folder / "out"), "--device", "tmf8820"]

    return command


def edges(name: str, content: Content | None = None, **members: Content) -> Callable[[Path], list[str]]:
    """`plan` of a configuration that names a file of a TDC's edges."""

    def command(folder: Path) -> list[str]:
        written(folder / name, content) if content is not None else zipped(folder / name, **members)
        text = f"scenes: 1\ndetector: {{mode: free_running, tdc_edges_ps: {name}}}\n"
        return ["plan", str(written(folder / "c.yaml", text.encode()))]

    return command


def map_of_zones(**members: Content) -> Callable[[Path], list[str]]:
    """`plan` with a device that names a measured map of the zones' fields of view."""

    def command(folder: Path) -> list[str]:
        path = folder / "mine.yaml"
        dg.write_device(dg.device("tmf8820"), path)
        values = yaml.safe_load(path.read_text())
        values["zones"] = {"rows": 3, "columns": 3, "map": zipped(folder / "map.npz", **members).name}
        path.write_text(yaml.safe_dump(values))
        return ["plan", str(written(folder / "c.yaml", b"scenes: 1\ncapture: {device: mine.yaml}\n"))]

    return command


def tal(**other: Any) -> Callable[[Path], list[str]]:
    def command(folder: Path) -> list[str]:
        lib = pytest.importorskip("h5py", reason="h5py is not installed (extra `export`)")
        points = np.stack([*np.meshgrid(np.arange(3.0), np.arange(3.0)), np.zeros((3, 3))], axis=-1)
        content = {
            "H": np.ones((8, 3, 3)), "H_format": 1, "sensor_grid_xyz": points, "laser_grid_xyz": points,
            "sensor_xyz": np.ones(3), "laser_xyz": np.ones(3), "delta_t": 0.003, "t_start": 0.0,
            "t_accounts_first_and_last_bounces": True,
        } | other  # fmt: skip
        with lib.File(folder / "capture.hdf5", "w") as file:
            for name, value in content.items():
                packed = {"compression": "gzip"} if isinstance(value, np.ndarray) and value.dtype.kind == "S" else {}
                file.create_dataset(name, data=value, **packed)
        return ["import", str(folder / "capture.hdf5"), str(folder / "out")]

    return command


HUGE = declared((10**9, 9, 128))
BOMBS: dict[str, Callable[[Path], list[str]]] = {
    "frames: compressed JSON": frames("a.json.gz", words),
    "frames: nested JSON": frames("a.json", b"[" * 10**6),
    "frames: a shape without values": zipped_frames(hists=HUGE),
    "frames: a shape without values, .npy": frames("a.npy", HUGE),
    "frames: compressed zeros": zipped_frames(hists=zeros),
    "frames: a long head": zipped_frames(hists=long_head),
    "frames: another method": zipped_frames(zipfile.ZIP_LZMA, hists=declared((1, 9, 128), bytes(9 * 128 * 8))),
    "edges: compressed commas": edges("a.csv.gz", gzip.compress(b"0" + b",0" * 20_000_000)),
    "edges: a long text": edges("a.csv", b"0," + b"0" * 10**6),
    "edges: a shape without values": edges("a.npz", edges_ps=declared((10**12,))),
    "map of zones: a shape without values": map_of_zones(extent=declared((4,), bytes(32)), weights=HUGE),
    "y-tal: aliases": tal(scene_info=f"{ALIASES}volume: {{center: *g, size: *g}}\n"),
    "y-tal: compressed text": tal(scene_info=np.array([b"x" * 2**28])),
}  # fmt: skip
"""Name → what writes the file into a folder and returns the command that reads it."""


def refused(command: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    capsys.readouterr()
    tracemalloc.start()
    try:
        # A reader that takes much more gets a `MemoryError`, for the sake of the machine.
        with little_memory(10 * MOST_BYTES):
            status = run(command)
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    out, err = capsys.readouterr()
    assert (status, out, err.count("\n")) == (2, "", 1), err
    assert "memory" not in err and len(err) < 1000
    assert peak < MOST_BYTES, f"{peak / 1e6:.0f} MB"


@pytest.fixture(scope="module", autouse=True)
def imported() -> None:
    """Modules that commands import when they run are imported before memory is measured."""
    for name in ("datagen.formats", "datagen.devices", "datagen.scoring", "datagen.report"):
        importlib.import_module(name)


@pytest.mark.parametrize("name", BOMBS)
def test_a_bomb_is_one_line(name: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    refused(BOMBS[name](tmp_path), capsys)
    assert not (tmp_path / "out").exists()


def test_a_bomb_of_predictions_is_one_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    suite = made_suite(tmp_path / "made.zarr")
    scene = declared((10,), np.arange(10).tobytes(), "<i8")
    refused(["score", str(suite), str(zipped(tmp_path / "a.npz", scene=scene, depth=HUGE))], capsys)
    group = zarr.create_group(tmp_path / "c.zarr")
    group.create_array("scene", data=np.arange(10))
    group.create_array("depth", shape=(10, 10**6, 10**6), chunks=(1, 1000, 1000), dtype="f4")
    refused(["score", str(suite), str(tmp_path / "c.zarr")], capsys)


@pytest.mark.parametrize("dtype", ["u1", ">f4", "?"])
def test_what_numpy_writes_is_read_as_numpy_reads_it(tmp_path: Path, dtype: str) -> None:
    """Also by columns, empty, of no axes, and a file of zeros that is small for what it holds."""
    value = np.random.default_rng(0).integers(0, 9, (3, 4, 5)).astype(dtype)
    arrays = {
        "rows": value, "columns": np.asfortranarray(value), "empty": value[:0], "number": value[0, 0, 0],
        "zeros": np.zeros((300, 1000), dtype),
    }  # fmt: skip
    for write in (np.savez, np.savez_compressed):
        write(tmp_path / "a.npz", **arrays)
        found, names = read_npz(tmp_path / "a.npz", ["zeros", "none", "empty", "columns", "rows", "number"])
        assert names == list(arrays) and found.keys() == arrays.keys()
        for name, array in arrays.items():
            np.testing.assert_array_equal(found[name], array, strict=True)
    np.save(tmp_path / "a.npy", value)
    np.testing.assert_array_equal(read_npy(tmp_path / "a.npy"), value, strict=True)
