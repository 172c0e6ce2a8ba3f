"""Samples a second of torch loaders, on the same counts: ours, and what others keep such data in.

`python tests/benchmarks/loaders.py` prints the figures of docs/figures.md. Counts are Poisson with 97 % of bins
empty, uint16. Each way hands over batches of a shuffled epoch (WebDataset: in order, as it must), by torch's own
`DataLoader` and nothing tuned, in this process and from two workers that live on. All ways take turns, epoch by
epoch, so that a busy machine disturbs all alike. Files are in the page cache. The first epoch opens files, and ours
compares every value with its digest, once. `pip install 'nlos-datagen[loaders]'` brings the others.
"""

from __future__ import annotations

import importlib.util
import io
import itertools
import math
import re
import statistics
import tarfile
import tempfile
import time
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from torch.utils.data import DataLoader, Dataset, IterableDataset

from datagen.bench.measuring import machine, markdown
from datagen.config import DatasetConfig, config_from_mapping
from datagen.loader import TransientDataset, collate
from datagen.records import Sample
from datagen.store import finish, prepare, schema_of, write_shard
from datagen.store.arrays import BLOCK_BYTES
from datagen.store.files import bytes_below

SIZES = ((32, 32, 512), (64, 64, 1024))
"""Rows, columns, bins."""
DECODED_BYTES, EPOCHS, BATCH = 3e8, 5, 8
FILLED = 0.03
WORKERS = (0, 2)
SAMPLES_OF_A_TAR = 32
"""So that two workers have some files each."""
OURS: dict[str, dict[str, Any]] = {
    "datagen, events": {"counts": "stored", "representation": "events"},
    "datagen, counts as stored": {"counts": "stored"},
    "datagen, float32": {},
}
Counts = NDArray[np.uint16]
Shape = tuple[int, ...]


class Rows(Dataset[torch.Tensor]):
    """Samples of whatever has rows; opened by each process for itself."""

    def __init__(self, opened: Callable[[Path], Any], path: Path, samples: int) -> None:
        self.opened, self.path, self.samples, self.rows = opened, path, samples, None

    def __len__(self) -> int:
        return self.samples

    def __getitem__(self, index: int) -> torch.Tensor:
        self.rows = self.opened(self.path) if self.rows is None else self.rows
        row = self.rows[index]
        values = np.asarray(row.read().result() if hasattr(row, "read") else row)
        # A row of a memory map is read into memory of its own, as the others' are.
        return torch.from_numpy(values if values.flags.writeable else values.copy())


def open_zarr(path: Path) -> Any:
    import zarr

    return zarr.open_array(path, mode="r")


def open_tensorstore(path: Path) -> Any:
    import tensorstore

    spec = {"driver": "zarr3", "kvstore": {"driver": "file", "path": f"{path}/"}}
    return tensorstore.open(spec, read=True).result()


def open_hdf5(path: Path) -> Any:
    import h5py

    return h5py.File(path / "counts.h5", "r")["counts"]


def write_hdf5(folder: Path, samples: Iterable[Counts], shape: Shape) -> None:
    import h5py

    with h5py.File(folder / "counts.h5", "w") as file:
        array = file.create_dataset(
            "counts", shape, np.uint16, chunks=(1, *shape[1:]), compression="lzf", shuffle=True
        )
        for index, counts in enumerate(samples):
            array[index] = counts


def write_raw(folder: Path, samples: Iterable[Counts], shape: Shape) -> None:
    with (folder / "counts").open("wb") as file:
        for counts in samples:
            file.write(counts.data)


def our_codec() -> Any:
    """That of our chunks."""
    from numcodecs import Blosc

    return Blosc("zstd", 1, Blosc.BITSHUFFLE, BLOCK_BYTES, typesize=2)


def decoded(content: bytes, shape: Shape) -> torch.Tensor:
    values = np.empty(shape[1:], np.uint16)
    our_codec().decode(content, values)
    return torch.from_numpy(values)


def write_tars(folder: Path, samples: Iterable[Counts], shape: Shape) -> None:
    for number, some in itertools.groupby(enumerate(samples), lambda of: of[0] // SAMPLES_OF_A_TAR):
        with tarfile.open(folder / f"{number:06d}.tar", "w") as tar:
            for index, counts in some:
                content = bytes(our_codec().encode(counts))
                member = tarfile.TarInfo(f"{index:08d}.counts")
                member.size = len(content)
                tar.addfile(member, io.BytesIO(content))


def read_tars(folder: Path, shape: Shape) -> Any:
    import webdataset

    files = sorted(str(path) for path in folder.glob("*.tar"))
    data = webdataset.WebDataset(files, shardshuffle=False, empty_check=False)
    return data.map(lambda item: decoded(item["counts"], shape))


def write_mds(folder: Path, samples: Iterable[Counts], shape: Shape) -> None:
    from streaming import MDSWriter

    # Its own compression is of whole files, which are unpacked when they are first read, and kept so.
    with MDSWriter(out=str(folder), columns={"counts": "bytes"}) as out:
        for counts in samples:
            out.write({"counts": bytes(our_codec().encode(counts))})


def read_mds(folder: Path, shape: Shape) -> Any:
    from streaming import StreamingDataset

    class Read(StreamingDataset):  # type: ignore[misc]
        def __getitem__(self, index: int) -> torch.Tensor:
            return decoded(super().__getitem__(index)["counts"], shape)

    return Read(local=str(folder), batch_size=BATCH, shuffle=False)


class Peer(NamedTuple):
    """One of the others. module : what it needs. read : (folder, (samples, laser, pixel, bin)) → a torch dataset.
    write : (folder, samples, that shape); None: it reads the arrays that datagen wrote."""

    module: str
    read: Callable[[Path, Shape], Any]
    write: Callable[[Path, Iterable[Counts], Shape], None] | None = None


PEERS = {
    "zarr": Peer("zarr", lambda path, shape: Rows(open_zarr, path, shape[0])),
    "tensorstore": Peer("tensorstore", lambda path, shape: Rows(open_tensorstore, path, shape[0])),
    "WebDataset, our codec": Peer("webdataset", read_tars, write_tars),
    "MosaicML streaming, our codec": Peer("streaming", read_mds, write_mds),
    "HDF5, lzf": Peer("h5py", lambda path, shape: Rows(open_hdf5, path, shape[0]), write_hdf5),
    "np.memmap, uncompressed": Peer(
        "numpy",
        lambda path, shape: Rows(lambda at: np.memmap(at / "counts", np.uint16, "r", shape=shape), path, shape[0]),
        write_raw,
    ),
}


def config_of(shape: Shape, samples: int) -> DatasetConfig:
    """A dataset of nothing but histograms of (rows, columns, bins)."""
    rows, columns, bins = shape
    return config_from_mapping({
        "name": "loaders", "scenes": samples, "store": {"fields": ["histogram"]},
        "capture": {"scan": {"rows": rows, "columns": columns}, "time": {"bins": bins}},
    })  # fmt: skip


def counts_of(config: DatasetConfig, index: int) -> Counts:
    """(laser, pixel, bin) of a sample."""
    rng = np.random.default_rng(index)
    return rng.poisson(-math.log1p(-FILLED), config.capture.shape).astype(np.uint16)


def write_ours(config: DatasetConfig, root: Path) -> None:
    """The dataset, in this process."""
    manifest = prepare(root, config)
    empty = {of.name: np.zeros(of.shape) for of in schema_of(config).fields if of.name != "histogram"}
    for shard in range(manifest.schema.shards):
        samples = (
            (index, Sample(index, empty | {"histogram": counts_of(config, index)}, {"index": index}, {}))
            for index in manifest.schema.scenes_of(shard)
        )
        write_shard(root, manifest.schema, shard, manifest.fingerprint, samples)
    finish(root, manifest)


def read_by(peer: Peer, folder: Path, root: Path, config: DatasetConfig) -> tuple[int, Any]:
    """Bytes on disk and torch dataset of one of the others; folder : to write into; root : our dataset."""
    shape = (config.scenes, *config.capture.shape)
    own = root / "data.zarr/histogram"
    if peer.write is not None:
        (own := folder).mkdir()
        peer.write(own, (counts_of(config, index) for index in range(config.scenes)), shape)
    return bytes_below(own), peer.read(own, shape)


class Way:
    """A loader that is measured, and the seconds of each epoch so far, by number of workers."""

    def __init__(self, name: str, disk_bytes: int, data: Any, joined: Callable[[Any], Any] | None = None) -> None:
        shuffle = not isinstance(data, IterableDataset)
        self.name, self.disk_bytes = name, disk_bytes
        self.seconds: dict[int, list[float]] = {n: [] for n in WORKERS}
        self.loaders = {
            n: DataLoader(data, BATCH, shuffle, num_workers=n, collate_fn=joined, persistent_workers=n > 0)
            for n in WORKERS
        }

    def epoch(self, workers: int) -> None:
        """Run through the data once more."""
        batches = iter(self.loaders[workers])  # which starts the workers
        began = time.perf_counter()
        for _ in batches:
            pass
        self.seconds[workers].append(time.perf_counter() - began)


def ways(folder: Path, shape: Shape, samples: int) -> list[Way]:
    """Every loader that is installed, its data written into an empty folder."""
    config, root = config_of(shape, samples), folder / "ours.zarr"
    write_ours(config, root)
    ours = bytes_below(root / "data.zarr/histogram")
    found = [
        Way(name, ours, TransientDataset(root, ("histogram",), **options), collate) for name, options in OURS.items()
    ]
    for name, peer in PEERS.items():
        if importlib.util.find_spec(peer.module) is None:
            print(f"left out: {name}, not installed (pip install 'nlos-datagen[loaders]')")
        else:
            found.append(Way(name, *read_by(peer, folder / re.sub(r"\W+", "_", name), root, config)))
    return found


def table(found: Sequence[Way], shape: Shape, samples: int) -> str:
    """Markdown: bytes on disk, and the median samples/s after the first epoch."""
    rows = []
    for way in found:
        rates = [f"{samples / statistics.median(way.seconds[workers][1:]):.0f}" for workers in WORKERS]
        rows.append([way.name, f"{way.disk_bytes / samples / 1e3:.0f}", *rates])
    head = [f"{n} workers: samples/s" for n in WORKERS]
    return markdown(["×".join(map(str, shape)), "kB on disk", *head], rows)


def main() -> None:
    """Print a table for each size."""
    print(f"Medians of {EPOCHS} epochs in turn, batches of {BATCH}, {FILLED:.0%} of bins filled; {machine()}")
    with tempfile.TemporaryDirectory() as folder:
        tables = []
        for shape in SIZES:
            samples = max(BATCH, int(DECODED_BYTES / (2 * math.prod(shape))))
            (own := Path(folder) / str(shape)).mkdir()
            tables.append((ways(own, shape, samples), shape, samples))
        # Epochs with workers begin: no process can be forked any more once tensorstore runs in this one.
        for _ in range(1 + EPOCHS):
            for workers, (found, *_) in itertools.product(reversed(WORKERS), tables):
                for way in found:
                    way.epoch(workers)
        for of in tables:
            print(f"\n{table(*of)}")


if __name__ == "__main__":
    main()
