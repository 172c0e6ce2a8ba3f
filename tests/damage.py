"""A small dataset, ways to harm a file of it, and everything a user reads of it."""

from __future__ import annotations

import copy
import functools
import json
import random
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from datasets import write_dataset

from datagen.config import DatasetConfig, config_from_mapping
from datagen.errors import CheckError, InputError
from datagen.loader import TransientDataset
from datagen.records import Sample
from datagen.store import reader, schema_of
from datagen.store.files import sealed_bytes

FIELDS = ("histogram", "depth", "object_class", "laser_points")
COLUMNS = ("scene", "failure", "width_m", "kind")
SCENES = 5
Changes = dict[Path, bytes | None]
"""What files hold once one of them was harmed; None: it is gone."""


def sample(config: DatasetConfig, index: int) -> Sample:
    rng = np.random.default_rng(index)
    arrays = {f.name: rng.integers(0, 9, f.shape).astype(f.dtype) for f in schema_of(config).fields}
    return Sample(index, arrays, {"width_m": index / 7, "kind": f"k{index}"}, {"scene": 0.5})


def small_dataset(root: Path, frames: int | None = None) -> DatasetConfig:
    """Write one of five scenes in three shards, with sharded fields and small ones; returns its configuration.

    frames : of each scene, if they are sequences.
    """
    sequence = {"sequence": {"frames": frames, "rate_hz": 10}, "detector": {"cycles": 1000}} if frames else {}
    config = config_from_mapping({
        **sequence,
        "scenes": SCENES, "name": "fuzzed", "labels": {"rows": 2, "columns": 2},
        "capture": {"scan": {"rows": 1, "columns": 2}, "time": {"bins": 8}},
        "store": {"fields": ["histogram", "depth", "objects"], "scenes_per_shard": 2},
    })  # fmt: skip
    write_dataset(config, root, sample)
    return config


def reseal(path: Path, change: Callable[[Any], object]) -> None:
    """Change what a sealed JSON file says, and its checksum with it."""
    values = json.loads(path.read_text())
    del values["checksum"]
    change(values)
    path.write_bytes(sealed_bytes(values))


def files_of(root: Path) -> list[Path]:
    """What a dataset consists of."""
    return sorted(path.relative_to(root) for path in root.rglob("*") if path.is_file())


def read(root: Path, memory: int, fields: tuple[str, ...] = FIELDS) -> dict[str, Any]:
    """Scene and field → values that a user reads, from memory of so many bytes, or (0) from files. Raises if the
    dataset is not complete."""
    before, reader.MEMORY_BYTES = reader.MEMORY_BYTES, memory
    try:
        data = TransientDataset(root, fields)
        found: dict[str, Any] = {}
        for item in [data[i] for i in range(len(data))]:
            found |= {f"{int(item['scene'])} {name}": item[name].numpy().tobytes() for name in fields}
    finally:
        reader.MEMORY_BYTES = before
    return found


def told(call: Callable[[], Any]) -> Any:
    """What a call gives; None where it says in one line why not. Whatever else is raised is raised."""
    try:
        return call()
    except (InputError, CheckError) as error:
        assert str(error) and "\n" not in str(error), f"not one line: {error}"
        return None


def flipped(data: bytearray, place: int) -> None:
    data[place // 8 % len(data)] ^= 1 << place % 8


def cut(data: bytearray, place: int) -> None:
    del data[place % len(data) :]


def inserted(data: bytearray, place: int) -> None:
    data[place % len(data) : place % len(data)] = random.Random(place).randbytes(1 + place % 9)


def appended(data: bytearray, place: int) -> None:
    data += random.Random(place).randbytes(1 + place % 9)


def zeroed(data: bytearray, place: int) -> None:
    """As a file system leaves what it had promised to write and did not."""
    first = place % len(data)
    data[first:] = bytes(len(data) - first)


HARMS = {"flip": flipped, "cut": cut, "insert": inserted, "append": appended, "zeros": zeroed}
"""Ways to harm one file's bytes."""


def damaged(root: Path, name: Path, kind: str, place: int) -> Changes | None:
    """One file harmed in one of `HARMS`, `remove`d, or `exchange`d for another; None where that changes nothing."""
    path = root / name
    data = path.read_bytes()
    if kind == "remove":
        return {path: None}
    if kind == "exchange":
        names = files_of(root)
        alike = [one for one in names if one.suffix == name.suffix and one != name]
        # Another shard of the same field, another record; else whatever is of a kind.
        others = [one for one in alike if one.parts[:2] == name.parts[:2]] or alike or names
        other = root / others[place % len(others)]
        return {path: other.read_bytes(), other: data} if other.read_bytes() != data else None
    changed = bytearray(data)
    HARMS[kind](changed, place)
    return {path: bytes(changed)} if changed != data else None


def restated(root: Path, name: Path, place: int, value: Any, remade: bool) -> Changes | None:
    """One value of a JSON file exchanged; with `remade` its checksum fits again. None where nothing changes."""
    path = root / name
    stated = json.loads(path.read_bytes())
    had_checksum = stated.pop("checksum", None) is not None
    *way, last = _places(stated)[place % len(_places(stated))]
    parent = functools.reduce(lambda within, key: within[key], way, stated)
    parent[last] = copy.deepcopy(value)
    made = sealed_bytes(stated) if remade and had_checksum else json.dumps(stated, indent=2).encode()
    return {path: made} if made.strip() != path.read_bytes().strip() else None


def _places(value: Any, at: tuple[Any, ...] = ()) -> list[tuple[Any, ...]]:
    items = value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else ()
    return [p for k, v in items for p in ((*at, k), *_places(v, (*at, k)))]


@contextmanager
def harmed(changes: Changes) -> Iterator[None]:
    """While files are as stated; afterwards they are as they were."""
    before = {path: path.read_bytes() for path in changes}
    try:
        for path, data in changes.items():
            path.unlink() if data is None else path.write_bytes(data)
        yield
    finally:
        for path, data in before.items():
            path.write_bytes(data)
