"""Datasets whose files were damaged, exchanged or made up: what is read is what was written, or told in one line."""

from __future__ import annotations

import copy
import functools
import json
import random
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from datasets import write_dataset
from fuzz_profile import assume, fuzzed, st

from datagen.config import DatasetConfig, config_from_mapping
from datagen.errors import CheckError, InputError
from datagen.loader import TransientDataset
from datagen.records import Sample
from datagen.store import ShardRecord, committed, read_manifest, reader, schema_of, verify
from datagen.store.files import sealed
from datagen.store.info import info
from datagen.store.table import read_table

FIELDS = ("histogram", "depth", "object_class", "laser_points")
COLUMNS = ("scene", "failure", "width_m", "kind")
SECONDS = 20.0
"""Processor seconds in which every case must end; they take a hundredth of it."""


def sample(config: DatasetConfig, index: int) -> Sample:
    rng = np.random.default_rng(index)
    arrays = {f.name: rng.integers(0, 9, f.shape).astype(f.dtype) for f in schema_of(config).fields}
    return Sample(index, arrays, {"width_m": index / 7, "kind": f"k{index}"}, {"scene": 0.5})


@functools.cache
def pristine() -> tuple[tempfile.TemporaryDirectory[str], Path]:
    folder = tempfile.TemporaryDirectory()
    config = config_from_mapping({
        "scenes": 5, "name": "fuzzed", "labels": {"rows": 2, "columns": 2},
        "capture": {"scan": {"rows": 1, "columns": 2}, "time": {"bins": 8}},
        "store": {"fields": ["histogram", "depth", "objects"], "scenes_per_shard": 2},
    })  # fmt: skip
    return folder, write_dataset(config, Path(folder.name) / "set", sample)


@functools.cache
def files() -> list[Path]:
    """What a dataset consists of; metadata comes up three times as often as data."""
    root = pristine()[1]
    names = sorted(path.relative_to(root) for path in root.rglob("*") if path.is_file())
    metadata = [name for name in names if name.name != "zarr.json" and "c" not in name.parts]
    return names + metadata * (3 * len(names) // len(metadata))


def read(root: Path, memory: int) -> dict[str, Any]:
    """Everything that a user reads; scene → field → values."""
    before, reader.MEMORY_BYTES = reader.MEMORY_BYTES, memory
    try:
        data = TransientDataset(root, FIELDS)
        read: dict[str, Any] = {}
        for item in [data[i] for i in range(len(data))]:
            read |= {f"{int(item['scene'])} {name}": item[name].numpy().tobytes() for name in FIELDS}
    finally:
        reader.MEMORY_BYTES = before
    return read


@functools.cache
def due() -> tuple[dict[str, Any], dict[str, Any], list[ShardRecord]]:
    root = pristine()[1]
    return read(root, 0), read_table(root, COLUMNS, 5).to_pydict(), committed(root, read_manifest(root))


numbers = [0, -1, 1, 3, 2**31, 2**63, 10**12, 10**300, 0.5, float("nan"), float("inf"), -1e308]
texts = ["", "x", "../../x", "/etc/passwd", "\x1b[31m", "\u202e", "0" * 64, "object", "float32", "1e999"]
values = st.sampled_from([*numbers, *texts, None, True, [], {}, [[]], {"a": 1}, ["scene"] * 3])
kinds = [
    "flip",
    "flip",
    "flip",
    "cut",
    "insert",
    "remove",
    "exchange",
    "value",
    "value",
    "remade",
    "remade",
    "remade",
]


@st.composite
def damages(draw: st.DrawFn) -> tuple[int, str, int, Any]:
    return draw(st.integers(0, 10**6)), draw(st.sampled_from(kinds)), draw(st.integers(0, 10**6)), draw(values)


def places(value: Any, at: tuple[Any, ...] = ()) -> list[tuple[Any, ...]]:
    items = value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else ()
    return [p for k, v in items for p in ((*at, k), *places(v, (*at, k)))]


def damage(root: Path, number: int, kind: str, place: int, value: Any) -> tuple[dict[Path, bytes | None], bool]:
    """What files hold once one of them was harmed, None: nothing; and whether its checksum was made to fit."""
    name = files()[number % len(files())]
    path = root / name
    data = bytearray(path.read_bytes())
    if kind in ("value", "remade"):
        assume(path.suffix == ".json")
        stated = json.loads(data)
        had_checksum = stated.pop("checksum", None) is not None
        *way, last = places(stated)[place % len(places(stated))]
        parent = functools.reduce(lambda within, key: within[key], way, stated)
        parent[last] = copy.deepcopy(value)
        remade = kind == "remade" and had_checksum
        made = sealed(stated) if remade else json.dumps(stated, indent=2).encode()
        assume(made.strip() != data.strip())
        return {path: made}, remade
    if kind == "remove":
        return {path: None}, False
    if kind == "exchange":
        alike = [one for one in dict.fromkeys(files()) if one.suffix == name.suffix and one != name]
        # Another shard of the same field, another record; else whatever is of a kind.
        others = [one for one in alike if one.parts[:2] == name.parts[:2]] or alike
        assume(bool(others))
        other = root / others[place % len(others)]
        assume(other.read_bytes() != data)
        return {path: other.read_bytes(), other: bytes(data)}, False
    if kind == "flip":
        data[place // 8 % len(data)] ^= 1 << place % 8
    elif kind == "cut":
        del data[place % len(data) :]
    else:
        data[place % len(data) : place % len(data)] = random.Random(place).randbytes(1 + place % 9)
    return {path: bytes(data)}, False


@contextmanager
def harmed(*how: Any) -> Iterator[tuple[Path, bool]]:
    """The dataset while it is harmed; afterwards it is as it was."""
    root = pristine()[1]
    changed, remade = damage(root, *how)
    before = {path: path.read_bytes() for path in changed}
    try:
        for path, data in changed.items():
            path.unlink() if data is None else path.write_bytes(data)
        yield root, remade
    finally:
        for path, data in before.items():
            path.write_bytes(data)


def told(call: Callable[[], Any]) -> Any:
    """What a call gives; None where it says in one line why not. Whatever else is raised fails the test."""
    try:
        return call()
    except (InputError, CheckError) as error:
        assert str(error) and "\n" not in str(error), f"not one line: {error}"
        return None


@fuzzed(60, 2000, damages())
def test_no_damage_is_silent(how: tuple[int, str, int, Any]) -> None:
    expected, table, records = due()
    began = time.process_time()
    with harmed(*how) as (root, remade):
        found = told(lambda: verify(root, deep=True))
        for memory in (0, 2**28):
            loaded = told(lambda memory=memory: read(root, memory))
            assert loaded is None or loaded.items() <= expected.items(), "other values were read"
        columns = told(lambda: read_table(root, COLUMNS, 5).to_pydict())
        assert columns in (None, table), "other columns were read"
        text = told(lambda: info(root))
        assert text is None or all(c == "\n" or c.isprintable() for c in text)
        believed = told(lambda: committed(root, read_manifest(root), hashes=True)) or []
        assert remade or all(record in records for record in believed), "a build would believe a damaged record"
        # What is remade, checksums and all, may state other seconds or another processor; nobody can tell.
        assert remade or found is None or found.problems, "verify is content with it"
        assert not (root.parent / "x").exists() and sorted(root.parent.iterdir()) == [root]
    assert time.process_time() - began < SECONDS
