"""Arrays from untrusted files of HDF5, MATLAB and NumPy: no code is run, no link is followed, all sizes are
checked."""

from __future__ import annotations

import importlib
import importlib.util
import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from datagen.errors import InputError, TooLargeError, printable
from datagen.formats.matlab5 import read_matlab5
from datagen.records.arrays import Floats
from datagen.untrusted import CAPTURE_BYTES, DEFLATE_REACHES, check_expansion, one_line, opened, read_npy, read_npz

LARGEST_BYTES = 2**33
"""Largest size of a variable in memory."""
ONE = 1
"""Most numbers of a variable that is a single one."""
POINTS = 3 * 2**22
"""Most numbers of a variable of points or normals: three for each of as many points as a scan may have."""
VALUES = LARGEST_BYTES
"""Most numbers of a variable of counts or light."""
ALONE = "array"
"""What the array of an `.npy` file is called, which has no name."""
LONGEST_TEXT = 2**20
FACING = np.array([0.0, 0.0, 1.0])
"""Normal of a relay wall in the plane of x and y."""


def h5py() -> Any:
    """The package h5py, which belongs to the extra `export`; raises `InputError` if it is not installed."""
    if importlib.util.find_spec("h5py") is None:
        raise InputError("this format is HDF5, and h5py is not installed; pip install nlos-datagen[export]")
    return importlib.import_module("h5py")


@dataclass(frozen=True)
class Content:
    """Variables of a file.

    arrays, texts : name → value of the requested variables that are numbers, or text. shapes : name → shape of every
        variable; None where it has none (a structure, a group), or only reading it would tell it.
    """

    path: Path
    arrays: Mapping[str, NDArray[Any]]
    texts: Mapping[str, str]
    shapes: Mapping[str, tuple[int, ...] | None]

    @property
    def names(self) -> tuple[str, ...]:
        """The names of all variables."""
        return tuple(self.shapes)

    @property
    def listed(self) -> str:
        """The variables with their shapes, as text that is safe to print."""
        some = (
            " ".join(printable(name[:40]).split()) + ("" if shape is None else f" {shape}")
            for name, shape in list(self.shapes.items())[:8]
        )
        more = ", …" if len(self.shapes) > 8 else ""
        return (", ".join(some) or "nothing") + more

    def array(self, name: str) -> NDArray[Any]:
        """A variable; raises `InputError` where it is missing."""
        if name not in self.arrays:
            raise InputError(f"{self.path}: {name}: missing; the file has {self.listed}")
        return self.arrays[name]

    def number(self, name: str) -> float:
        """The value of a variable that is one finite number; raises `InputError` for any other."""
        value = self.array(name)
        if value.size != 1 or value.dtype.kind not in "fiub" or not math.isfinite(float(value.reshape(-1)[0])):
            raise InputError(
                f"{self.path}: {name}: shape {value.shape} of {value.dtype}, one finite number is needed"
            )
        return float(value.reshape(-1)[0])

    def points(self, name: str) -> Floats:
        """(…, 3) a variable that holds points, metres; raises `InputError` for any other."""
        value = self.array(name)
        if value.ndim < 1 or value.shape[-1] != 3 or value.size == 0:
            raise InputError(f"{self.path}: {name}: shape {value.shape}, (…, 3) needed: points in metres")
        points = value.astype(np.float64)
        if not np.isfinite(points).all() or abs(points).max() > 1e6:
            raise InputError(f"{self.path}: {name}: holds coordinates that are NaN, infinite or beyond 1000 km")
        return points

    def normals(self, name: str, points: Floats) -> Floats:
        """(n, 3) unit normals at (…, 3) points, from a variable with one for each or one for all; NaN if the file has
        no such variable, or one of another shape or of other values."""
        value, n = self.arrays.get(name, np.zeros(0)), points.size // 3
        if value.ndim and value.shape[-1] == 3 and value.size in (3, 3 * n) and np.isfinite(value).all():
            found = value.reshape(-1, 3).astype(np.float64)
            length = np.linalg.norm(found, axis=1, keepdims=True)
            if (length > 0.1).all():
                return np.array(np.broadcast_to(found / length, (n, 3)))
        return np.full((n, 3), np.nan)


def wall_normal(normals: Floats) -> Floats:
    """(3,) unit normal of a relay wall whose surface has the normals (n, 3) here and there; along z if they are
    unknown, or of no common side."""
    mean = normals.mean(axis=0)
    return np.asarray(mean / np.linalg.norm(mean)) if np.linalg.norm(mean) > 0.1 else FACING


def is_hdf5(path: Path) -> bool:
    """Whether a file is HDF5, or of MATLAB's version 7.3, which is HDF5 after 512 bytes."""
    signature = b"\x89HDF\r\n\x1a\n"
    with opened(path) as (_, file):
        head = file.read(1024)
    return head.startswith(signature) or head[512:520] == signature


def hdf5_content(path: Path, wanted: Mapping[str, int], matlab: bool = False) -> Content:
    """The variables `wanted` at the root of an HDF5 file.

    wanted : name → the most numbers that a variable of this name has: `ONE`, `POINTS` or `VALUES`.
    matlab : the file is MATLAB's, which stores axes in reverse order; they are turned back.

    Raises `InputError` for a file that cannot be read, and for variables that are no numbers, lie in another file,
    have more numbers than is `wanted`, are larger than `LARGEST_BYTES` or than the file can hold, or are together
    more than `check_expansion` lets pass.
    """
    kind = "MATLAB 7.3" if matlab else "HDF5"
    arrays, texts = dict[str, NDArray[Any]](), dict[str, str]()
    with one_line(f"{path}: cannot be read as {kind}"), h5py().File(path, "r") as file:
        # h5py returns a name that is not UTF-8 as bytes.
        names = tuple(name.decode("utf-8", "replace") if isinstance(name, bytes) else name for name in file)
        shapes = {name: _hdf5_shape(file, name, matlab) for name in names}
        numbers = dict[str, Any]()
        for name in (name for name in wanted if _is_there(file, name, names)):
            data = _hdf5_data(path, file, name)
            if isinstance(data, str):
                texts[name] = data
            elif data is not None:
                numbers[name] = data
        _check_hdf5_sizes(path, numbers, wanted)
        for name, data in numbers.items():
            found = np.zeros(0) if data.attrs.get("MATLAB_empty") else np.asarray(data[()])
            arrays[name] = found.T if matlab else found
    return Content(path, arrays, texts, shapes)


def _hdf5_shape(file: Any, name: str, matlab: bool) -> tuple[int, ...] | None:
    """Shape of a variable that lies in the file itself; None for a group, a link and an empty dataset."""
    lib = h5py()
    if not isinstance(file.get(name, getlink=True), lib.HardLink) or not isinstance(file[name], lib.Dataset):
        return None
    shape = file[name].shape
    return None if shape is None else tuple(map(int, shape[::-1] if matlab else shape))


def _is_there(file: Any, name: str, names: tuple[str, ...]) -> bool:
    """Whether a file has a variable, or, of `structure.field`, a group with this field."""
    group, _, field = name.partition(".")
    if not field:
        return name in names
    is_own = group in names and isinstance(file.get(group, getlink=True), h5py().HardLink)
    return is_own and isinstance(file[group], h5py().Group) and field in file[group]


def _check_hdf5_sizes(path: Path, numbers: Mapping[str, Any], wanted: Mapping[str, int]) -> None:
    """Raise as `hdf5_content` does for datasets of h5py (name → dataset) that are too large, before any is read."""
    declared = stored = 0
    # Chunks of a damaged file may share their bytes, so what they store is compared with the file, too.
    file_bytes = path.stat().st_size
    for name, data in numbers.items():
        size, count = data.size * data.dtype.itemsize, wanted[name]
        if data.size > count:
            raise InputError(f"{path}: {name}: shape {data.shape}; at most {count} numbers are read")
        if size > LARGEST_BYTES:
            raise InputError(f"{path}: {name}: shape {data.shape}, {size} bytes; at most {LARGEST_BYTES} are read")
        there = min(data.id.get_storage_size(), file_bytes)
        if size > 0 and DEFLATE_REACHES * there < size:
            raise InputError(
                f"{path}: {name}: {size} bytes declared ({data.shape}) and {there} there; write the file anew"
            )
        # A chunk is decoded as a whole, and may be larger than the array.
        declared += max(size, math.prod(data.chunks or ()) * data.dtype.itemsize)
        stored += there
    check_expansion(str(path), declared, min(stored, file_bytes), CAPTURE_BYTES)


def _hdf5_data(path: Path, file: Any, name: str) -> Any | str | None:
    """A variable of an open file: a dataset of h5py that holds numbers, or text; None if it is empty. Raises as
    `hdf5_content` does."""
    lib, at = h5py(), name.replace(".", "/")
    if not isinstance(file.get(at, getlink=True), lib.HardLink):
        raise InputError(f"{path}: {name}: is a link to somewhere else; copy what it stands for into the file")
    data = file[at]
    if not isinstance(data, lib.Dataset):
        raise InputError(f"{path}: {name}: is a group, an array is needed")
    if data.shape is None:
        return None
    if data.is_virtual or data.external:
        raise InputError(f"{path}: {name}: its values lie in another file; copy them into this one")
    if data.dtype.kind in "OSU":
        if lib.check_string_dtype(data.dtype) is None or data.shape not in ((), (1,)):
            raise InputError(f"{path}: {name}: holds {data.dtype}, not numbers")
        if data.dtype.itemsize > LONGEST_TEXT:
            raise TooLargeError(
                f"{path}: {name}: text of {data.dtype.itemsize} bytes; at most {LONGEST_TEXT} are read"
            )
        text = data.asstr(errors="replace")[()]
        return str(text if data.shape == () else text[0])
    if data.dtype.kind not in "fiub":
        raise InputError(f"{path}: {name}: holds {data.dtype}, real numbers are needed")
    return data


def matlab_content(path: Path, wanted: Mapping[str, int]) -> Content:
    """The variables `wanted` of a MATLAB file of any version, axes in MATLAB's order; takes and raises what
    `hdf5_content` does."""
    if is_hdf5(path):
        return hdf5_content(path, wanted, matlab=True)
    with one_line(f"{path}: cannot be read as MATLAB"):
        arrays, shapes = read_matlab5(path, {name: min(count, LARGEST_BYTES // 8) for name, count in wanted.items()})
    return Content(path, arrays, {}, shapes)


def numpy_content(path: Path, wanted: Mapping[str, int]) -> Content:
    """The arrays `wanted` of a file of NumPy; that of an `.npy` file, which has no name, is called `ALONE`. Takes and
    raises what `hdf5_content` does."""
    with one_line(f"{path}: cannot be read as NumPy"):
        if path.suffix.lower() == ".npy":
            arrays = {ALONE: read_npy(path)} if ALONE in wanted else {}
            names = [ALONE]
        else:
            arrays, names = read_npz(path, wanted, CAPTURE_BYTES)
    for name, array in arrays.items():
        if array.dtype.kind not in "fiub":
            raise InputError(f"{path}: {name}: holds {array.dtype}, real numbers are needed")
        if array.size > wanted[name]:
            raise InputError(f"{path}: {name}: shape {array.shape}; at most {wanted[name]} numbers are read")
    return Content(path, arrays, {}, {name: arrays[name].shape if name in arrays else None for name in names})
