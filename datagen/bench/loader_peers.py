"""Other ways of keeping counts on disk, and how torch reads each of them: samples (laser, pixel, bin), uint16."""

from __future__ import annotations

import importlib.util
import io
import tarfile
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch.utils.data import Dataset

from datagen.store.arrays import BLOCK_BYTES

Counts = NDArray[np.uint16]
Shape = tuple[int, ...]
A_TAR = 32
"""Samples of a tar file, so that two workers have some each."""


@dataclass(frozen=True)
class Peer:
    """One of them.

    module : what it needs. write : samples into an empty folder; None: it reads the arrays that datagen wrote.
    read : (folder, (samples, laser, pixel, bin)) → a torch dataset.
    """

    name: str
    module: str
    write: Callable[[Path, Iterable[Counts]], None] | None
    read: Callable[[Path, Shape], Any]


def is_there(peer: Peer) -> bool:
    """Whether what it needs is installed."""
    return importlib.util.find_spec(peer.module) is not None


class _Rows(Dataset[torch.Tensor]):
    """Samples of whatever has rows; opened by each process for itself."""

    def __init__(self, opened: Callable[[Path], Any], path: Path, samples: int) -> None:
        self._opener, self._path, self._samples = opened, path, samples

    @cached_property
    def _opened(self) -> Any:
        return self._opener(self._path)

    def __len__(self) -> int:
        return self._samples

    def __getitem__(self, index: int) -> torch.Tensor:
        return torch.from_numpy(np.array(self._opened[index], dtype=np.uint16, copy=None))


def _zarr(path: Path) -> Any:
    import zarr

    return zarr.open_array(path, mode="r")


class _TensorStore:
    def __init__(self, path: Path) -> None:
        import tensorstore

        spec = {"driver": "zarr3", "kvstore": {"driver": "file", "path": f"{path}/"}}
        self._store = tensorstore.open(spec, read=True).result()

    def __getitem__(self, index: int) -> Any:
        return self._store[index].read().result()


def _write_raw(folder: Path, samples: Iterable[Counts]) -> None:
    with (folder / "counts").open("wb") as file:
        for counts in samples:
            file.write(counts.data)


def _read_raw(folder: Path, shape: Shape) -> Any:
    def opened(path: Path) -> Any:
        rows = np.memmap(path / "counts", np.uint16, "r", shape=shape)
        return _Copied(rows)

    return _Rows(opened, folder, shape[0])


class _Copied:
    """Rows of a memory map, each read into memory of its own."""

    def __init__(self, rows: Any) -> None:
        self._rows = rows

    def __getitem__(self, index: int) -> Counts:
        return np.array(self._rows[index])


def _write_hdf5(folder: Path, samples: Iterable[Counts]) -> None:
    import h5py

    with h5py.File(folder / "counts.h5", "w") as file:
        for index, counts in enumerate(samples):
            if not index:
                array = file.create_dataset(
                    "counts", (0, *counts.shape), np.uint16, maxshape=(None, *counts.shape),
                    chunks=(1, *counts.shape), compression="lzf", shuffle=True,
                )  # fmt: skip
            array.resize(index + 1, 0)
            array[index] = counts


def _hdf5(path: Path) -> Any:
    import h5py

    return h5py.File(path / "counts.h5", "r")["counts"]


def _codec() -> Any:
    """That of our chunks."""
    from numcodecs import Blosc

    return Blosc("zstd", 1, Blosc.BITSHUFFLE, BLOCK_BYTES, typesize=2)


def _write_tars(folder: Path, samples: Iterable[Counts], compressed: bool) -> None:
    tar, encode = None, _codec().encode
    for index, counts in enumerate(samples):
        if index % A_TAR == 0:
            if tar is not None:
                tar.close()
            tar = tarfile.open(folder / f"{index // A_TAR:06d}.tar", "w")  # noqa: SIM115 - several samples go into it
        assert tar is not None
        content = bytes(encode(counts)) if compressed else counts.tobytes()
        member = tarfile.TarInfo(f"{index:08d}.{'blosc' if compressed else 'raw'}")
        member.size = len(content)
        tar.addfile(member, io.BytesIO(content))
    if tar is not None:
        tar.close()


def _read_tars(folder: Path, shape: Shape, compressed: bool) -> Any:
    import webdataset

    decode, key = _codec().decode, "blosc" if compressed else "raw"

    def sample(item: dict[str, Any]) -> torch.Tensor:
        values = np.empty(shape[1:], np.uint16)
        if compressed:
            decode(item[key], values)
        else:
            values[...] = np.frombuffer(item[key], np.uint16).reshape(shape[1:])
        return torch.from_numpy(values)

    files = sorted(str(path) for path in folder.glob("*.tar"))
    return webdataset.WebDataset(files, shardshuffle=False, empty_check=False).map(sample)


def _write_mds(folder: Path, samples: Iterable[Counts]) -> None:
    from streaming import MDSWriter

    # Its own compression is of whole files, which are unpacked when they are first read, and kept so.
    with MDSWriter(out=str(folder), columns={"counts": "bytes"}) as out:
        for counts in samples:
            out.write({"counts": bytes(_codec().encode(counts))})


def _read_mds(folder: Path, shape: Shape) -> Any:
    from streaming import StreamingDataset

    decode = _codec().decode

    class Read(StreamingDataset):  # type: ignore[misc]
        def __getitem__(self, index: int) -> torch.Tensor:
            content = super().__getitem__(index)["counts"]
            values = np.empty(shape[1:], np.uint16)
            decode(content, values)
            return torch.from_numpy(values)

    return Read(local=str(folder), batch_size=8, shuffle=False)


PEERS = (
    Peer("zarr", "zarr", None, lambda path, shape: _Rows(_zarr, path, shape[0])),
    Peer("tensorstore", "tensorstore", None, lambda path, shape: _Rows(_TensorStore, path, shape[0])),
    Peer("WebDataset, our codec", "webdataset", lambda path, samples: _write_tars(path, samples, True),
         lambda path, shape: _read_tars(path, shape, True)),
    Peer("MosaicML streaming, our codec", "streaming", _write_mds, _read_mds),
    Peer("HDF5, lzf", "h5py", _write_hdf5, lambda path, shape: _Rows(_hdf5, path, shape[0])),
    Peer("WebDataset, uncompressed", "webdataset", lambda path, samples: _write_tars(path, samples, False),
         lambda path, shape: _read_tars(path, shape, False)),
    Peer("np.memmap, uncompressed", "numpy", _write_raw, _read_raw),
)  # fmt: skip
