"""Small files that claim to be huge, or decode to what is: one line, before memory is taken for them."""

from __future__ import annotations

import gzip
import importlib
import io
import json
import struct
import sys
import tracemalloc
import zipfile
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import scipy.io
import yaml
import zarr
from limits import little_memory
from made_suite import made_suite
from numpy.lib import format as npy

import datagen as dg
from datagen.cli import run
from datagen.config.imported import ImportOptions
from datagen.errors import InputError
from datagen.formats.layouts import read_capture
from datagen.formats.recording import Stated
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


def mesh(name: str, content: Content) -> Callable[[Path], list[str]]:
    """`plan` of a configuration that names a mesh file."""

    def command(folder: Path) -> list[str]:
        item = f"{{kind: mesh, path: {written(folder / name, content).name}, height_m: 1.0}}"
        text = f"scenes: 1\nscene: {{contents: [{item}]}}\n"
        return ["plan", str(written(folder / "c.yaml", text.encode()))]

    return command


def glb(accessor: dict[str, Any], **other: Any) -> bytes:
    """A file of one triangle, at one point, whose accessor says other things too."""
    tree = {
        "asset": {"version": "2.0"}, "scenes": [{"nodes": [0]}], "nodes": [{"mesh": 0}],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0}}]}],
        "bufferViews": [{"buffer": 0, "byteLength": 36}],
        "accessors": [{"bufferView": 0, "componentType": 5126, "count": 3, "type": "VEC3"} | accessor],
        "buffers": [{"byteLength": 36}],
    }  # fmt: skip
    text = json.dumps(tree | other).encode()
    text += b" " * (-len(text) % 4)
    parts = struct.pack("<I4s", len(text), b"JSON") + text + struct.pack("<I4s", 36, b"BIN\0") + bytes(36)
    return b"glTF" + struct.pack("<II", 2, 12 + len(parts)) + parts


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


def tal_zeros(chunks: int, shape: tuple[int, ...], chunk: tuple[int, ...]) -> Callable[[Path], list[str]]:
    """An H of zeros in chunks that compress to a thousandth, each of which is written as it is stored."""

    def command(folder: Path) -> list[str]:
        arguments = tal()(folder)
        with importlib.import_module("h5py").File(folder / "capture.hdf5", "a") as file:
            del file["H"]
            limits = (None, *shape[1:])
            data = file.create_dataset("H", shape, "f4", chunks=chunk, maxshape=limits, compression="gzip")
            packed = zlib.compress(bytes(4 * int(np.prod(chunk))))
            for number in range(chunks):
                data.id.write_direct_chunk((number * chunk[0], 0, 0), packed)
        return arguments

    return command


def matlab(kind: int, shape: tuple[int, ...], name: bytes = b"rect_data") -> Callable[[Path], list[str]]:
    """A compressed array of zeros in a file of MATLAB, stored as numbers of one byte."""

    def element(of: int, content: bytes) -> bytes:
        return struct.pack("<II", of, len(content)) + content + bytes(-len(content) % 8)

    def command(folder: Path) -> list[str]:
        count = int(np.prod(shape))
        head = element(6, struct.pack("<II", kind, 0)) + element(5, struct.pack(f"<{len(shape)}i", *shape))
        head += element(1, name) + struct.pack("<II", 2, count)
        packer = zlib.compressobj()
        packed = packer.compress(struct.pack("<II", 14, len(head) + count) + head)
        packed += b"".join(packer.compress(bytes(2**20)) for _ in range(-(-count // 2**20))) + packer.flush()
        whole = bytes(124) + b"\x00\x01IM" + struct.pack("<II", 15, len(packed)) + packed
        return ["import", str(written(folder / "m.mat", whole)), str(folder / "out"), "--bin", "4ps", "--wall", "2m"]

    return command


def structure(count: int) -> Callable[[Path], list[str]]:
    """A file of MATLAB whose structure has a field of so many zeros, compressed."""

    def command(folder: Path) -> list[str]:
        fields = {"transient": np.zeros((8, 8, count // 64)), "l": np.ones((64, 3))}
        scipy.io.savemat(folder / "s.mat", {"NLOSDATA": fields}, do_compression=True)
        return ["import", str(folder / "s.mat"), str(folder / "out")]

    return command


def declared_structure(folder: Path) -> list[str]:
    """`import` of a file whose structure says that it has 200 MB, of which nothing is there."""
    scipy.io.savemat(folder / "s.mat", {"NLOSDATA": {"transient": np.ones((2, 2, 9)), "l": np.ones((4, 3))}})
    whole = (folder / "s.mat").read_bytes()
    element = struct.pack("<II", 14, 200_000_000) + whole[136:]
    packed = zlib.compress(element)
    path = written(folder / "d.mat", whole[:128] + struct.pack("<II", 15, len(packed)) + packed)
    return ["import", str(path), str(folder / "out")]


def array_alone(content: Content) -> Callable[[Path], list[str]]:
    """`import` of an array of NumPy as a grid of histograms."""
    asked = [
        "--axes",
        "yxt",
        "--bin",
        "4ps",
        "--tof",
        "none",
        "--start",
        "0ns",
        "--wall",
        "1m",
        "--laser",
        "confocal",
    ]
    return lambda folder: ["import", str(written(folder / "a.npy", content)), str(folder / "out"), *asked]


def consumer(**members: Content) -> Callable[[Path], list[str]]:
    return lambda folder: ["import", str(zipped(folder / "v.npz", **members)), str(folder / "out"), "--bin", "4ps"]


def places(text: bytes) -> Callable[[Path], list[str]]:
    """`import` of frames beside a compressed file of places."""

    def command(folder: Path) -> list[str]:
        path = folder / "A_4inch_3x3_lighton_NLOSdata" / "spad_histogram" / "001.npy"
        path.parent.mkdir(parents=True)
        np.save(path, np.ones((3, 3, 3, 128)))
        named = written(folder / "p.json.gz", gzip.compress(text))
        return ["import", str(path), str(folder / "out"), "--device", "tmf8820", "--places", str(named)]

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
    "frames: a frame of empty lists": frames(
        "a.json.gz", lambda: gzip.compress(b'[{"hists": [' + b"[]," * 2**23 + b"[]]}]")
    ),
    "frames: a frame of one list": frames(
        "a.json.gz", lambda: gzip.compress(b'[{"hists": [[' + b"0," * 2**23 + b"0]]}]")
    ),
    "frames: objects beside histograms": frames(
        "a.json.gz", lambda: gzip.compress(b'[{"more": [' + b"{}," * 2**21 + b'{}], "hists": [[1, 2]]}]')
    ),
    "edges: compressed commas": edges("a.csv.gz", gzip.compress(b"0" + b",0" * 20_000_000)),
    "edges: a long text": edges("a.csv", b"0," + b"0" * 10**6),
    "edges: a shape without values": edges("a.npz", edges_ps=declared((10**12,))),
    "map of zones: a shape without values": map_of_zones(extent=declared((4,), bytes(32)), weights=HUGE),
    "glb: more vertices than its bytes": mesh("a.glb", glb({"count": 3 * 10**6})),
    "glb: a wider type than its bytes": mesh("a.glb", glb({"count": 3 * 10**6, "type": "MAT4"})),
    "glb: sparse values beyond its bytes": mesh("a.glb", glb({"sparse": {
        "count": 10**9, "indices": {"bufferView": 0, "componentType": 5125}, "values": {"bufferView": 0},
    }})),
    "glb: a buffer without end": mesh("a.glb", glb({}, buffers=[{"byteLength": 36, "uri": "/dev/zero"}])),
    "glb: nested JSON": mesh("a.glb", b"glTF" + struct.pack("<3I4s", 2, 10**6 + 20, 10**6, b"JSON") + b"[" * 10**6),
    "ply: more than it has": mesh("a.ply", b"ply\nformat binary_little_endian 1.0\nelement vertex 1000000000\n"
        b"property float x\nproperty float y\nproperty float z\nelement face 1\n"
        b"property list uint int vertex_indices\nend_header\n"),
    "ply: a list longer than it": mesh("a.ply", b"ply\nformat binary_little_endian 1.0\nelement face 1\n"
        b"property list uint int vertex_indices\nend_header\n\xff\xff\xff\xff"),
    "obj: a face of 100 000 corners": mesh("a.obj", b"v 0 0 0\nv 1 0 0\nv 0 1 1\nf" + b" 1 2 3" * 33334),
    "stl: more than it has": mesh("a.stl", bytes(80) + b"\xff\xff\xff\xff"),
    "y-tal: aliases": tal(scene_info=f"{ALIASES}volume: {{center: *g, size: *g}}\n"),
    "y-tal: compressed zeros": tal_zeros(20, (20 * 2**20, 3, 3), (2**20, 3, 3)),
    "y-tal: a chunk larger than its array": tal_zeros(0, (8, 3, 3), (2**23, 3, 3)),
    "y-tal: many numbers for one": tal(delta_t=np.zeros(2**23)),
    "MATLAB: compressed zeros": matlab(9, (64, 64, 70_000)),
    "MATLAB: many numbers for one": matlab(6, (2**12, 2**12), b"width"),
    "MATLAB: a structure of zeros": structure(5 * 2**23),
    "MATLAB: a structure that is not there": declared_structure,
    "NumPy: a shape without values": array_alone(HUGE),
    "consumer: a shape without values": consumer(hists=HUGE, pt_cloud=declared((16, 3), bytes(16 * 3 * 8))),
    "consumer: compressed zeros": consumer(
        hists=lambda: declared((64, 64, 70_000), bytes(64 * 64 * 70_000), "u1"),
        pt_cloud=declared((16, 3), bytes(16 * 3 * 8)),
    ),
    "places: nested JSON": places(b"[" * 10**6),
    "places: compressed blanks": places(b" " * 2**28),
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


def test_frames_are_bounded_in_number(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """60 MB of empty objects took 1.7 GB and a minute."""
    monkeypatch.setattr("datagen.untrusted._MOST_OBJECTS", 3)
    frame = '{"hists": [[1, 2]]}'
    path = tmp_path / "a.json"
    path.write_text(f"[{frame}, {frame}, {frame}]")
    assert len(dg.read_frames(path)) == 3
    path.write_text(f"[{frame}, {{}}, {frame}, {{}}, ")
    with pytest.raises(InputError, match=r"a\.json: has more than 3 frames; cut it into smaller files"):
        dg.read_frames(path)


def test_a_bomb_of_predictions_is_one_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    suite = made_suite(tmp_path / "made.zarr")
    scene = declared((10,), np.arange(10).tobytes(), "<i8")
    refused(["score", str(suite), str(zipped(tmp_path / "a.npz", scene=scene, depth=HUGE))], capsys)
    chunk = zarr.create_group(tmp_path / "b.zarr")
    chunk.create_array("scene", data=np.arange(10))
    chunk.create_array("depth", shape=(10, 4, 4), chunks=(10, 1000, 1000), dtype="f4")[:] = 1.0
    refused(["score", str(suite), str(tmp_path / "b.zarr")], capsys)
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


def packed_tal(folder: Path) -> tuple[Path, int]:
    h5py = pytest.importorskip("h5py", reason="h5py is not installed (extra `export`)")
    tal()(folder)
    counts = np.random.default_rng(0).poisson(0.1, (2**17, 3, 3)).astype(np.float32)
    with h5py.File(folder / "capture.hdf5", "a") as file:
        del file["H"]
        file.create_dataset("H", data=counts, compression="gzip")
    return folder / "capture.hdf5", counts.nbytes


def packed_matlab(folder: Path) -> tuple[Path, int]:
    counts = np.random.default_rng(0).poisson(0.1, (16, 16, 2**13)).astype(np.float32) + 0.5
    scipy.io.savemat(folder / "m.mat", {"rect_data": counts, "width": 0.4}, do_compression=True)
    return folder / "m.mat", counts.nbytes


def packed_structure(folder: Path) -> tuple[Path, int]:
    counts = np.random.default_rng(0).poisson(0.1, (16, 16, 2**13)) + 0.5
    fields = {
        "l": np.ones((256, 3)),
        "times": 0.01 * np.arange(1, 2**13 + 1),
        "is_confocal": 1.0,
        "transient": counts,
    }
    scipy.io.savemat(folder / "s.mat", {"NLOSDATA": fields}, do_compression=True)
    return folder / "s.mat", counts.nbytes


def packed_volume(folder: Path) -> tuple[Path, int]:
    counts = np.random.default_rng(0).poisson(0.1, (256, 2**13)) + 0.5
    np.savez_compressed(folder / "v.npz", hists=counts, pt_cloud=np.ones((256, 3)))
    return folder / "v.npz", counts.nbytes


def decimals(folder: Path) -> tuple[Path, int]:
    counts = np.random.default_rng(0).poisson(50, (60, 9, 128)) + 0.1
    text = json.dumps([{"hists": frame.tolist(), "note": ["{", {"a": [1, "]"]}]} for frame in counts])
    np.testing.assert_array_equal(dg.read_frames(written(folder / "a.json", text.encode())).histograms, counts)
    return folder / "a.json", len(text) + counts.nbytes


def whole_numbers(folder: Path) -> tuple[Path, int]:
    counts = np.random.default_rng(0).poisson(50, (200, 9, 128)).astype(np.uint8)
    np.savez_compressed(folder / "a.npz", hists=counts, ambient=np.ones((200, 9)))
    return folder / "a.npz", 8 * counts.size


@pytest.mark.parametrize(
    "write", [packed_tal, packed_matlab, packed_structure, packed_volume, decimals, whole_numbers]
)
def test_reading_takes_twice_what_a_capture_of_that_shape_needs(
    write: Callable[[Path], tuple[Path, int]], tmp_path: Path
) -> None:
    """The array as the file has it, or for frames its text and the histograms in double precision."""
    path, needed = write(tmp_path)
    form = {".mat": "mat", ".hdf5": "tal"}.get(path.suffix, "numpy" if path.name == "v.npz" else "frames")
    options = ImportOptions(bin_width_ps=4.0 if path.name in ("m.mat", "v.npz") else None)
    tracemalloc.start()
    try:
        if form == "frames":
            dg.read_frames(path)
        else:
            read_capture(path, form, Stated(options))
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    # A piece that is decompressed, and the like.
    assert peak < 2 * needed + 4 * 2**20, f"{peak / 1e6:.1f} MB, {needed / 1e6:.1f} MB needed"
