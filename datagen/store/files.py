"""Files that are either wholly there or not at all."""

from __future__ import annotations

import contextlib
import hashlib
import json
import math
import os
import tempfile
from pathlib import Path
from typing import Any

from datagen.errors import InputError

PARTIAL = ".partial"
"""Suffix of a file that is still being written; whatever bears it may be deleted."""


def write_atomically(path: Path, content: bytes) -> None:
    """Write beside `path`, fsync, rename: a reader sees the old content or the new one, whenever we are killed."""
    partial = path.with_name(f"{path.name}.{os.getpid()}{PARTIAL}")
    try:
        with partial.open("wb") as file:
            file.write(content)
            file.flush()
            os.fsync(file.fileno())
        partial.replace(path)
    except BaseException:
        partial.unlink(missing_ok=True)
        raise
    sync_folder(path.parent)


def write_if_changed(path: Path, content: bytes) -> None:
    """`write_atomically`, unless the file holds just that already."""
    if not path.is_file() or path.read_bytes() != content:
        write_atomically(path, content)


def json_bytes(value: Any) -> bytes:
    """JSON as every file of a dataset holds it: keys in the order given, floats that round-trip, a final newline."""
    return (json.dumps(value, indent=2, ensure_ascii=False) + "\n").encode()


def finite(value: Any) -> Any:
    """Nested mappings, lists and tuples with None in place of NaN and infinities, which JSON has not."""
    if isinstance(value, dict):
        return {key: finite(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [finite(item) for item in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


def read_json(path: Path) -> Any:
    """The value a JSON file holds; raises `InputError` naming the file when it is no JSON."""
    try:
        return json.loads(path.read_bytes())
    except (OSError, ValueError) as error:
        raise InputError(f"{path}: cannot be read as JSON ({error})") from None


def sync_folder(path: Path) -> None:
    """Have the disk hold the names in a folder; file systems that cannot are left to themselves."""
    with contextlib.suppress(OSError):
        handle = os.open(path, os.O_RDONLY)
        try:
            os.fsync(handle)
        finally:
            os.close(handle)


def sha256_of(path: Path) -> str:
    """Hex SHA-256 of a file's bytes."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def check_writable(path: Path) -> None:
    """Raise `InputError` unless the folder `path` exists or can be made, and files can be made in it.

    A folder is made and removed again to find out: permission bits do not tell on every file system.
    """
    existing = path
    while not os.path.lexists(existing) and existing != existing.parent:
        existing = existing.parent
    if not existing.is_dir():
        what = "is a file" if existing == path else f"cannot be made: {existing} is a file"
        raise InputError(f"output {path}: {what}, not a folder; name a new folder, or a dataset to resume")
    try:
        os.rmdir(tempfile.mkdtemp(prefix=".datagen-", dir=existing))
    except OSError as error:
        reason = error.strerror or type(error).__name__
        raise InputError(
            f"output {path}: {existing} cannot be written ({reason}); name a folder that you may write to"
        ) from None
