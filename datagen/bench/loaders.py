"""Samples a second of torch loaders, on the same counts: ours, and what others keep such data in.

Counts are Poisson with 97 % of bins empty, uint16. Each way hands over batches of a shuffled epoch (WebDataset: in
order, as it must), by torch's own `DataLoader` and nothing tuned, in this process and from two workers that live on.
All ways take turns, epoch by epoch, so that a busy machine disturbs all alike. Files are in the page cache. The first
epoch opens files, and ours compares every value with its digest, once.
"""

from __future__ import annotations

import itertools
import math
import re
import shutil
import statistics
import sys
import tempfile
import time
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from multiprocessing import active_children
from pathlib import Path
from typing import Any

import click
import numpy as np
from numpy.typing import NDArray

from datagen.bench.loader_peers import PEERS, Peer, is_there
from datagen.bench.measuring import machine, markdown
from datagen.config import DatasetConfig, config_from_mapping
from datagen.records import Sample
from datagen.store import committed, finish, prepare, schema_of, write_shard
from datagen.store.files import bytes_below

FILLED = 0.03
BATCH = 8
WORKERS = (0, 2)
OURS: dict[str, dict[str, Any]] = {
    "datagen, events": {"counts": "stored", "representation": "events"},
    "datagen, counts as stored": {"counts": "stored"},
    "datagen, float32": {},
}


def config_of(shape: tuple[int, int, int], samples: int) -> DatasetConfig:
    """A dataset of nothing but histograms of (rows, columns, bins)."""
    rows, columns, bins = shape
    return config_from_mapping({
        "name": "loaders", "scenes": samples, "store": {"fields": ["histogram"]},
        "capture": {"scan": {"rows": rows, "columns": columns}, "time": {"bins": bins}},
    })  # fmt: skip


def counts_of(config: DatasetConfig, index: int) -> NDArray[np.uint16]:
    """(laser, pixel, bin) of a sample."""
    rng = np.random.default_rng(index)
    return rng.poisson(-math.log1p(-FILLED), config.capture.shape).astype(np.uint16)


def write_ours(config: DatasetConfig, root: Path) -> None:
    """The dataset, in this process."""
    manifest = prepare(root, config)
    small = {field.name: field.shape for field in schema_of(config).fields if field.name != "histogram"}
    for shard in range(manifest.schema.shards):
        samples = (
            (index, Sample(index, {name: np.zeros(of) for name, of in small.items()}
             | {"histogram": counts_of(config, index)}, {"index": index}, {}))
            for index in manifest.schema.scenes_of(shard)
        )  # fmt: skip
        write_shard(root, manifest.schema, shard, manifest.fingerprint, samples)
    finish(root, manifest, committed(root, manifest))


@dataclass
class Way:
    """A loader that is measured; of each epoch so far seconds, and those of the processor, by number of workers."""

    name: str
    disk_bytes: int
    loaders: dict[int, Iterable[Any]]
    seconds: dict[int, list[tuple[float, float]]]

    def epoch(self, workers: int) -> None:
        """Run through the data once more."""
        batches = iter(self.loaders[workers])  # which starts the workers
        began = time.perf_counter(), processor_s()
        for _ in batches:
            pass
        self.seconds[workers].append((time.perf_counter() - began[0], processor_s() - began[1]))

    def later(self, workers: int) -> tuple[float, float]:
        """Medians of all epochs but the first."""
        wall, processor = (statistics.median(of) for of in zip(*self.seconds[workers][1:], strict=True))
        return wall, processor


def processor_s() -> float:
    """Of this process and its workers, all that are alive; elsewhere than on Linux of this one alone."""
    used = time.process_time()
    if sys.platform == "linux":
        # The clock of another process (clock_getcpuclockid).
        used += sum(time.clock_gettime((~child.pid << 3) | 2) for child in active_children() if child.pid)
    return used


def _way(name: str, disk_bytes: int, data: Callable[[], Any], collate: Callable[[Any], Any] | None) -> Way:
    from torch.utils.data import DataLoader, IterableDataset

    def loader(workers: int) -> Iterable[Any]:
        source = data()
        shuffle = not isinstance(source, IterableDataset)
        return DataLoader(
            source, BATCH, shuffle=shuffle, num_workers=workers, collate_fn=collate, persistent_workers=workers > 0
        )

    return Way(name, disk_bytes, {n: loader(n) for n in WORKERS}, {n: [] for n in WORKERS})


def ways(folder: Path, shape: tuple[int, int, int], samples: int, only: str) -> tuple[list[Way], list[str]]:
    """Every loader, its data written; and those left out, since they are not installed."""
    from datagen.loader import TransientDataset, collate

    config, root, found, missing = config_of(shape, samples), folder / "ours.zarr", list[Way](), list[str]()
    write_ours(config, root)
    of_arrays = bytes_below(root / "data.zarr/histogram")
    for name, options in OURS.items():
        if only in name:
            found.append(
                _way(name, of_arrays, lambda o=options: TransientDataset(root, ("histogram",), **o), collate)  # type: ignore[misc]
            )
    for peer in PEERS:
        if only not in peer.name:
            continue
        if not is_there(peer):
            missing.append(peer.name)
            continue
        found.append(_peer_way(peer, folder, root, config))
    return found, missing


def _peer_way(peer: Peer, folder: Path, root: Path, config: DatasetConfig) -> Way:
    own = root / "data.zarr/histogram"
    if peer.write is not None:
        own = folder / re.sub(r"\W+", "_", peer.name)
        own.mkdir()
        peer.write(own, (counts_of(config, index) for index in range(config.scenes)))
    shape = (config.scenes, *config.capture.shape)
    return _way(peer.name, bytes_below(own), lambda: peer.read(own, shape), None)


def measure(found: Sequence[Way], repeats: int) -> None:
    """One first epoch of each, then `repeats` of each in turn.

    Those of workers begin: no process can be forked any more once tensorstore runs in this one.
    """
    for _ in range(1 + repeats):
        for workers, way in itertools.product(reversed(WORKERS), found):
            way.epoch(workers)


def table(found: Sequence[Way], shape: tuple[int, int, int], samples: int) -> str:
    """Markdown: bytes on disk; samples/s in the first epoch and, median, later; MB/s and processor ms of these."""
    mega, rows = 2 * math.prod(shape) / 1e6, list[list[str]]()
    for way in found:
        row = [way.name, f"{way.disk_bytes / samples / 1e3:.0f}"]
        for workers in WORKERS:
            wall, processor = way.later(workers)
            row += [f"{samples / way.seconds[workers][0][0]:.0f}", f"{samples / wall:.0f}"]
            row += [f"{mega * samples / wall:.0f}", f"{1e3 * processor / samples:.2f}"]
        rows.append(row)
    of_workers = ("first epoch", "samples/s", "MB/s", "processor ms")
    head = [f"{n} workers: {of}" if of == of_workers[0] else of for n in WORKERS for of in of_workers]
    return markdown(["×".join(map(str, shape)), "kB on disk", *head], rows)


def _shape(text: str) -> tuple[int, int, int]:
    if not re.fullmatch(r"[1-9]\d{0,3}x[1-9]\d{0,3}x[1-9]\d{0,4}", text):
        raise click.UsageError(f"--size {text}: must be ROWSxCOLUMNSxBINS, such as 32x32x512")
    rows, columns, bins = map(int, text.split("x"))
    return rows, columns, bins


@click.command()
@click.option(
    "--size",
    "sizes",
    multiple=True,
    default=("32x32x512", "64x64x1024"),
    show_default=True,
    help="ROWSxCOLUMNSxBINS.",
)
@click.option(
    "--megabytes",
    default=300.0,
    show_default=True,
    type=click.FloatRange(0, 1e5, min_open=True),
    help="Decoded counts of each size.",
)
@click.option("--repeats", default=5, show_default=True, type=click.IntRange(1), help="Epochs behind each median.")
@click.option("--only", default="", help="Only the loaders whose name contains this.")
def main(sizes: Sequence[str], megabytes: float, repeats: int, only: str) -> None:
    """Print samples a second of our loader and of others on the same counts, and what these take on disk."""
    shapes = [_shape(size) for size in sizes]
    names = [*OURS, *(peer.name for peer in PEERS)]
    if not any(only in name for name in names):
        raise click.UsageError(f"--only {only}: the loaders are {'; '.join(names)}")
    click.echo(f"Medians of {repeats} epochs in turn, batches of {BATCH}, {FILLED:.0%} of bins filled; {machine()}")
    folder = Path(tempfile.mkdtemp())
    try:
        tables, missing = dict[tuple[int, int, int], tuple[int, list[Way]]](), list[str]()
        for number, shape in enumerate(shapes):
            samples = max(BATCH, int(megabytes * 1e6 / (2 * math.prod(shape))))
            (own := folder / str(number)).mkdir()
            found, missing = ways(own, shape, samples, only)
            tables[shape] = samples, found
        measure([way for _, found in tables.values() for way in found], repeats)
        for shape, (samples, found) in tables.items():
            click.echo(f"\n{table(found, shape, samples)}")
    finally:
        shutil.rmtree(folder, ignore_errors=True)
    for name in missing:
        click.echo(f"\nleft out: {name}, not installed (pip install 'nlos-datagen[loaders]')")
