"""The outcome of kills and damage: whether data were lost, read wrong without an error, or a traceback was shown."""

from __future__ import annotations

import random
import shutil
import traceback
import warnings
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from functools import cache, partial
from pathlib import Path

import kills
import pytest
from damage import COLUMNS, HARMS, damaged, files_of, harmed, read, sample, small_dataset, told
from fake_samples import build_fakes, fails_at_5, sequence_config, small_config
from here_and_now import one_worker_here

from datagen.building.build import build
from datagen.config import DatasetConfig
from datagen.errors import CheckError, InputError
from datagen.store import committed_records, read_manifest, verify
from datagen.store.info import info
from datagen.store.table import read_table
from datagen.store.verify import dataset_digest

SHORT = small_config(scenes=6, store={"fields": ["histogram"], "scenes_per_shard": 4})
"""The configuration of the builds that are killed at every step."""
SHORT_SEQUENCES = sequence_config(scenes=6, store={"fields": ["histogram"], "scenes_per_shard": 4})
"""The same of sequences."""
MEMORIES = (0, 2**28)
"""Memory of a reader in bytes. With 0 every field is read from files, with more all fields stay in memory."""
CORRUPTED = {
    "dataset.json": "dataset.json",
    "commit record": "build/shard-*.json",
    "samples.parquet": "samples.parquet",
    "croissant.json": "croissant.json",
    "README.md": "README.md",
    "zarr.json": "data.zarr/**/zarr.json",
    "coordinate": "data.zarr/[bf]*/c/*",
    "sharded field": "data.zarr/[hd]*/c/*/**/*",
    "small field": "data.zarr/[lor]*/c/*/**/*",
}
"""Kind of file → where it lies."""
WAYS = (*HARMS, "remove", "exchange")


@contextmanager
def quietly() -> Iterator[None]:
    """A context in which builds of one worker run in this process, and warnings about failed scenes are hidden."""
    with ExitStack() as stack:
        stack.enter_context(one_worker_here())
        stack.enter_context(warnings.catch_warnings())
        warnings.simplefilter("ignore", UserWarning)
        patch = stack.enter_context(pytest.MonkeyPatch.context())
        # A child cannot wait for its parent's server.
        patch.setattr("datagen.building.build.start_imports", lambda *_: None)
        yield


def intact(root: Path) -> dict[int, bytes]:
    """Shard → its record, of committed shards with all their scenes. A kill must lose none of them."""
    with suppress(InputError):
        there = committed_records(root, read_manifest(root), hashes=True)
        return {record.shard: record.to_bytes() for record in there if not record.failures}
    return {}


Outcome = Counter[str]
"""Counts: `harmed`, `found` (reported before a repair), `lost`, `silent` (read wrong without an error),
`traceback`."""


def after_a_kill(root: Path, resume: Callable[[], object], due: Path, harms: int, said: str = "") -> Outcome:
    """The outcome of a kill: what readers get from the dataset, and whether building again completes it."""
    kept, (digest, expected), told_so = intact(root), _of_whole(due), Outcome(harmed=harms)
    told_so["traceback"] += "Traceback" in said
    try:
        for memory in MEMORIES:
            got = told(partial(read, root, memory, ("histogram",)))
            told_so["silent"] += got is not None and not got.items() <= expected.items()
        found = told(lambda: verify(root, deep=True))
        told_so["found"] += found is None or bool(found.problems)
        resume()
        whole = verify(root, deep=True).problems == () and dataset_digest(root) == digest
        left = [
            path
            for path in root.rglob("*")
            if path.suffix in (".running", ".writing", ".partial") or path.name[0] == "."
        ]
        told_so["lost"] += not whole or bool(left) or not kept.items() <= intact(root).items()
    except Exception:
        told_so["traceback"] += 1
        traceback.print_exc()
    return told_so


@cache
def _of_whole(due: Path) -> tuple[str, dict[str, bytes]]:
    """Digest and values of a dataset that nothing happens to."""
    return dataset_digest(due), read(due, 0, ("histogram",))


def kills_between_steps(number: int | None, folder: Path, mending: bool, config: DatasetConfig = SHORT) -> Outcome:
    """A build, or (`mending`) one that tries a scene anew, makes a damaged shard again and restores dataset.json,
    is gone at so many of its steps, spread evenly, or at every one."""
    due, harmed_one, outcome = folder / "due", folder / "harmed", Outcome()
    build_fakes(config, due)
    if mending:
        with suppress(CheckError):
            build(config, harmed_one, progress=False, sample_function=fails_at_5)
        (harmed_one / "dataset.json").unlink()
        next(path for path in (harmed_one / "data.zarr/histogram/c/0").rglob("0") if path.is_file()).write_bytes(b"")
    root = folder / "set"
    resume = partial(build_fakes, config, root)

    def afresh() -> None:
        shutil.rmtree(root, ignore_errors=True)
        if mending:
            shutil.copytree(harmed_one, root)

    afresh()
    steps = kills.steps_of(resume)
    number = steps if number is None else number
    for step in ((2 * n + 1) * steps // (2 * number) for n in range(number)):
        afresh()
        assert kills.killed_at(step, resume), f"step {step} of {steps} was not reached"
        outcome += after_a_kill(root, resume, due, 1)
    return outcome


def kills_of_processes(what: str, number: int, folder: Path, rng: random.Random) -> Outcome:
    """One of `kills.KILLED`, at random moments. A build that lost workers goes on; one that is gone is run again."""
    due, config, outcome = folder / "due", kills.many_shards(), Outcome()
    build_fakes(config, due)
    for done, running in kills.killed_builds(what, number, folder, rng):
        status, said = running.ended()
        if what.endswith("worker") and status != 0 and "worker processes died over it" not in said:
            # A scene over which two workers died is given up, told, and tried anew by the next build.
            print(f"{what} killed, and the build ended: {said.strip()}")
            outcome["lost"] += done
        resume = partial(build_fakes, config, running.root)
        outcome += after_a_kill(running.root, resume, due, done, said)
    return outcome


def corruptions(kind: str, number: int, folder: Path, rng: random.Random, frames: int | None = None) -> Outcome:
    """Files of a kind of `CORRUPTED` harmed one at a time: verified, loaded in both sizes, and built again. frames :
    of each scene, if they are sequences."""
    root, outcome = folder / "set", Outcome()
    config = small_dataset(root, frames)
    digest, expected, table = dataset_digest(root), read(root, 0), read_table(root, COLUMNS, 5).to_pydict()
    names = [name for name in files_of(root) if (root / name) in set(root.glob(CORRUPTED[kind]))]
    assert names, f"no {kind} in {files_of(root)}"
    while outcome["harmed"] < number:
        changes = damaged(root, rng.choice(names), rng.choice(WAYS), rng.randrange(10**6))
        if changes is None:
            continue
        outcome["harmed"] += 1
        before = {path.relative_to(root): path.read_bytes() for path in root.rglob("*") if path.is_file()}
        with harmed(changes):
            try:
                outcome += _of_a_corruption(root, expected, table)
                result = build(config, root, progress=False, sample_function=sample)
                mended = verify(root, deep=True).problems == () and dataset_digest(root) == digest
                # A file costs its own shard, and no more.
                outcome["lost"] += not mended or result.built > len(changes)
            except Exception:
                outcome["traceback"] += 1
                traceback.print_exc()
        shutil.rmtree(root)
        for name, data in before.items():
            (root / name).parent.mkdir(parents=True, exist_ok=True)
            (root / name).write_bytes(data)
    return outcome


def _of_a_corruption(root: Path, expected: dict[str, bytes], table: dict[str, list[object]]) -> Outcome:
    found = told(lambda: verify(root))
    loaded = [told(partial(read, root, memory)) for memory in MEMORIES]
    columns = told(lambda: read_table(root, COLUMNS, 5).to_pydict())
    told(lambda: info(root))
    wrong = any(got not in (None, expected) for got in loaded) or columns not in (None, table)
    unseen = found is not None and not found.problems
    return Outcome(found=not unseen, silent=wrong or unseen, refused=loaded.count(None))
