"""Datasets whose files were damaged, exchanged or made up: what is read is what was written, or told in one line."""

from __future__ import annotations

import functools
import tempfile
import time
from pathlib import Path
from typing import Any

from damage import COLUMNS, HARMS, SCENES, damaged, files_of, harmed, read, restated, small_dataset, told
from fuzz_profile import assume, fuzzed, st

from datagen.store import ShardRecord, committed_records, read_manifest, verify
from datagen.store.info import info
from datagen.store.table import read_table

SECONDS = 20.0
"""Processor seconds in which every case must end; they take a hundredth of it."""


@functools.cache
def pristine() -> tuple[tempfile.TemporaryDirectory[str], Path]:
    folder = tempfile.TemporaryDirectory()
    root = Path(folder.name) / "set"
    small_dataset(root)
    return folder, root


@functools.cache
def files() -> list[Path]:
    """What a dataset consists of; metadata comes up three times as often as data."""
    names = files_of(pristine()[1])
    metadata = [name for name in names if name.name != "zarr.json" and "c" not in name.parts]
    return names + metadata * (3 * len(names) // len(metadata))


@functools.cache
def due() -> tuple[dict[str, Any], dict[str, Any], list[ShardRecord]]:
    root = pristine()[1]
    return read(root, 0), read_table(root, COLUMNS, SCENES).to_pydict(), committed_records(root, read_manifest(root))


numbers = [0, -1, 1, 3, 2**31, 2**63, 10**12, 10**300, 0.5, float("nan"), float("inf"), -1e308]
texts = ["", "x", "../../x", "/etc/passwd", "\x1b[31m", "\u202e", "0" * 64, "object", "float32", "1e999"]
values = st.sampled_from([*numbers, *texts, None, True, [], {}, [[]], {"a": 1}, ["scene"] * 3])
kinds = ["flip", "flip", *HARMS, "remove", "exchange", "value", "value", "remade", "remade", "remade"]


@st.composite
def damages(draw: st.DrawFn) -> tuple[int, str, int, Any]:
    return draw(st.integers(0, 10**6)), draw(st.sampled_from(kinds)), draw(st.integers(0, 10**6)), draw(values)


@fuzzed(60, 2000, damages())
def test_no_damage_is_silent(how: tuple[int, str, int, Any]) -> None:
    number, kind, place, value = how
    root, (expected, table, records) = pristine()[1], due()
    name = files()[number % len(files())]
    stated = kind in ("value", "remade")
    assume(not stated or name.suffix == ".json")
    # A file without a checksum of its own is vouched for by others, whatever was done to it.
    remade = kind == "remade" and (name.name == "dataset.json" or name.parts[0] == "build")
    changes = restated(root, name, place, value, remade) if stated else damaged(root, name, kind, place)
    assume(changes is not None)
    assert changes is not None
    began = time.process_time()
    with harmed(changes):
        found = told(lambda: verify(root, deep=True))
        for memory in (0, 2**28):
            loaded = told(lambda memory=memory: read(root, memory))
            assert loaded is None or loaded.items() <= expected.items(), "other values were read"
        columns = told(lambda: read_table(root, COLUMNS, SCENES).to_pydict())
        assert columns in (None, table), "other columns were read"
        text = told(lambda: info(root))
        assert text is None or all(c == "\n" or c.isprintable() for c in text)
        believed = told(lambda: committed_records(root, read_manifest(root), hashes=True)) or []
        assert remade or all(record in records for record in believed), "a build would believe a damaged record"
        # What is remade, checksums and all, may state other seconds or another processor; nobody can tell.
        assert remade or found is None or found.problems, "verify is content with it"
        assert not (root.parent / "x").exists() and sorted(root.parent.iterdir()) == [root]
    assert time.process_time() - began < SECONDS
