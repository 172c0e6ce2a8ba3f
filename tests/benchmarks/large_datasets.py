"""What opening, checking and resuming a large dataset costs: seconds and memory against the number of scenes.

`python tests/benchmarks/large_datasets.py [SCENES …]` prints the figures of docs/figures.md. Eight scenes of
`configs/quickstart.yaml` are simulated, and the dataset of many is made of them without another simulation: each
shard has a commit record of its own, with other parameters, and its files are links to those of the first shard.
Each step runs in a process of its own, after the same step with eight scenes; files are in the page cache.
"""

from __future__ import annotations

import json
import os
import re
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from datagen.bench.measuring import machine, markdown
from datagen.building import build
from datagen.config import DatasetConfig, load_config
from datagen.records import Sample
from datagen.store import finish, prepare, read_manifest, write_shard
from datagen.store.manifest import Manifest
from datagen.store.record import SceneRecord, ShardRecord, record_path
from datagen.store.scenes import Scenes

SIZES = (2_000, 20_000, 200_000)
SIMULATED = 8
BATCH = 16
CONFIG = Path("configs/quickstart.yaml")
FEW = "DATAGEN_FEW"
"""Environment variable with the path of the eight scenes, for the workers of a build."""


def copied(config: DatasetConfig, few: Path, root: Path) -> None:
    """Write a dataset of `config.scenes` scenes, which repeat those of the dataset `few`."""
    manifest = prepare(root, config)
    content = Scenes(few)
    samples = [content.read(index, "scene") for index in range(SIMULATED)]
    first = write_shard(
        root, manifest.schema, 0, manifest.fingerprint,
        ((index, Sample(index, samples[index % SIMULATED].arrays, samples[index % SIMULATED].parameters, {}))
         for index in manifest.schema.scenes_of(0)),
    )  # fmt: skip
    for shard in range(manifest.schema.shards):
        _record(root, manifest, first, shard)
    finish(root, manifest)


def _record(root: Path, manifest: Manifest, first: ShardRecord, shard: int) -> None:
    """Commit a shard whose values are those of the first one."""
    scenes = manifest.schema.scenes_of(shard)
    files = {}
    for name, file in first.files.items():
        field, places = re.fullmatch(r"(.*/c)/0((?:/0)*)", name).groups()  # type: ignore[union-attr]
        files[own := f"{field}/{shard}{places}"] = file
        if shard:
            (root / own).parent.mkdir(parents=True, exist_ok=True)
            os.link(root / name, root / own)
    record = replace(
        first, shard=shard, first_scene=scenes.start, last_scene=scenes.stop - 1, files=files,
        scenes=tuple(_scene(first.scenes[index - scenes.start], index) for index in scenes),
    )  # fmt: skip
    record_path(root, shard).write_bytes(record.to_bytes())


def _scene(scene: SceneRecord, index: int) -> SceneRecord:
    """Another room with the same values."""
    parameters = {
        name: value * (1 + 1e-9 * index) if isinstance(value, float) else value
        for name, value in scene.parameters.items()
    }
    return replace(scene, index=index, parameters=parameters)


def opened(path: str) -> Any:
    import datagen as dg

    return dg.TransientDataset(path)


def split_opened(path: str) -> Any:
    import datagen as dg

    return dg.TransientDataset(path, split="train")


def statistics_of(path: str) -> Any:
    return opened(path).stats


def info_of(path: str) -> Any:
    from datagen.store.info import info

    return info(path)


def one_of_every_shard(path: str) -> Any:
    """What a worker has read after many epochs."""
    data = opened(path)
    return [int(data[scene]["scene"]) for scene in range(0, len(data), data._schema.scenes_per_shard)]


def first_batch(path: str) -> Any:
    """From a worker, which says how much memory it takes."""
    from torch.utils.data import DataLoader, RandomSampler

    data = opened(path)
    loader = DataLoader(data, BATCH, sampler=RandomSampler(data), num_workers=1, collate_fn=_with_memory)
    return max(next(iter(loader)))


def _with_memory(items: Any) -> list[float]:
    return [own_mb()]


def verified(path: str) -> Any:
    from datagen.store import verify

    found = verify(path)
    assert not found.problems, found.problems[:3]


def resumed(path: str) -> Any:
    """A build that finds all shards."""
    config = load_config(CONFIG).with_scenes(read_manifest(path).schema.scenes)
    build.build(config, path, sample_function=simulated_before, progress=False)


def resumed_without_one(path: str) -> Any:
    """A build that makes the first shard."""
    record_path(Path(path), 0).unlink()
    resumed(path)


def simulated_before(config: DatasetConfig, index: int) -> Sample:
    """One of the eight scenes, which takes no time to make."""
    found = Scenes(os.environ[FEW]).read(index % SIMULATED)
    return Sample(index, found.arrays, found.parameters, {})


def previewed(path: str) -> Any:
    from datagen.report.preview import preview

    return preview(path, scenes=0)


def own_mb() -> float:
    """Largest resident memory of this process so far, MB."""
    return int(re.search(r"VmHWM:\s+(\d+)", Path("/proc/self/status").read_text())[1]) / 1e3  # type: ignore[index]


STEPS: dict[str, Callable[[str], Any]] = {
    "open": opened, "open a split": split_opened, "stats": statistics_of, "first batch of a worker": first_batch,
    "a scene of every shard": one_of_every_shard, "info": info_of, "preview": previewed, "verify": verified,
    "build, nothing left": resumed, "build, one shard left": resumed_without_one,
}  # fmt: skip


def step(name: str, few: str, path: str) -> None:
    """Print seconds and memory of a step as JSON: before it, after it, and in a worker."""
    with tempfile.TemporaryDirectory() as folder:
        os.environ[FEW] = few
        STEPS[name](str(shutil.copytree(few, Path(folder) / "warm")))
    before = own_mb()
    began = time.perf_counter()
    answer = STEPS[name](path)
    seconds = time.perf_counter() - began
    print(json.dumps([seconds, before, own_mb(), answer if name == "first batch of a worker" else 0.0]))


def measured(few: Path, root: Path) -> dict[str, str]:
    """Step → its seconds and memory, as text."""
    found = {}
    for name in STEPS:
        command = [sys.executable, __file__, "--step", name, str(few), str(root)]
        done = subprocess.run(command, capture_output=True, text=True, check=True)
        seconds, before, after, worker = json.loads(done.stdout.splitlines()[-1])
        memory = f"{worker:.0f} MB in all" if worker else f"+{after - before:.0f} MB"
        found[name] = f"{seconds:.2f} s, {memory}"
    return found


def main(sizes: Sequence[int]) -> None:
    """Print a row for each step and a column for each size."""
    with tempfile.TemporaryDirectory() as folder:
        few = Path(folder) / "few"
        build.build(load_config(CONFIG), few, scenes=SIMULATED, progress=False)
        columns = []
        for size in sizes:
            root = Path(folder) / str(size)
            copied(load_config(CONFIG).with_scenes(size), few, root)
            columns.append(measured(few, root))
            shutil.rmtree(root)
    print(f"Seconds, and memory beyond what eight scenes take; {machine()}\n")
    rows = [[name, *(found[name] for found in columns)] for name in STEPS]
    print(markdown(["", *(f"{size} scenes" for size in sizes)], rows))


if __name__ == "__main__":
    if sys.argv[1:2] == ["--step"]:
        step(*sys.argv[2:])
    else:
        main([int(size) for size in sys.argv[1:]] or SIZES)
