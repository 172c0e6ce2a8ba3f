"""What a worker does: the scenes of one shard one after the other, then the shard is written and committed."""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path

from datagen.config import DatasetConfig
from datagen.errors import CheckError, InputError
from datagen.records import Sample
from datagen.store import Schema, ShardRecord, committed, discard_shard, read_manifest, running_path, write_shard

LOCK_PATIENCE_S = 10.0
"""How long to wait for another writer of the same shard, such as an orphan of a killed build about to notice."""


@dataclass(frozen=True)
class ShardJob:
    """Everything a worker needs.

    Attributes
    ----------
    skip : scenes not to be tried, and why.
    handed_out : Unix time.
    """

    root: Path
    config: DatasetConfig
    schema: Schema
    fingerprint: str
    shard: int
    sample_function: Callable[[DatasetConfig, int], Sample]
    skip: Mapping[int, str]
    handed_out: float


def run_shard(job: ShardJob) -> dict[int, str]:
    """Make one shard and commit it; returns its failures, scene → reason."""
    path = running_path(job.root, job.shard)
    with _sole_writer(path, LOCK_PATIENCE_S) as running:
        record = _made_meanwhile(job)
        if record is None:
            record = write_shard(job.root, job.schema, job.shard, job.fingerprint, _samples(job, running))
        path.unlink(missing_ok=True)
    return record.failures


def _made_meanwhile(job: ShardJob) -> ShardRecord | None:
    """The shard, if it was committed in the meantime: by another build, or by this job before its result got lost."""
    manifest = read_manifest(job.root)
    for record in committed(job.root, manifest, [job.shard], hashes=True):
        if record.fingerprint == job.fingerprint and record.finished > job.handed_out:
            return record
    return None


def abandon_shard(root: Path, schema: Schema, shard: int) -> None:
    """Remove what a writer that is no more left of a shard; one that another writer is at is left alone."""
    path = running_path(root, shard)
    with suppress(CheckError), _sole_writer(path, patience_s=0.0):
        discard_shard(root, schema, shard)
        path.unlink(missing_ok=True)


def scene_at(root: Path, shard: int) -> int | None:
    """The scene that the writer of a shard is at, or was at when it died; None before the first one."""
    try:
        text = running_path(root, shard).read_text().strip()
    except OSError:
        return None
    return int(text) if text.isdigit() else None


def _samples(job: ShardJob, running: int) -> Iterator[tuple[int, Sample | str]]:
    for index in job.schema.scenes_of(job.shard):
        os.pwrite(running, f"{index:<20d}".encode(), 0)
        yield index, job.skip[index] if index in job.skip else _attempt(job, index)


def _attempt(job: ShardJob, index: int) -> Sample | str:
    """The sample, or in one line why there is none. Bad input stays bad; anything else gets a second chance."""
    reason = ""
    for _ in range(2):
        try:
            return job.sample_function(job.config, index)
        except InputError as error:
            return str(error)
        except Exception as error:
            text = " ".join(str(error).split())
            place = _last_line_of(error)
            reason = f"{type(error).__name__}: {text}{place}" if text else f"{type(error).__name__}{place}"
    return reason


def _last_line_of(error: Exception) -> str:
    """Where in the code it happened, for the person who has only the record."""
    trace = error.__traceback__
    while trace is not None and trace.tb_next is not None:
        trace = trace.tb_next
    return "" if trace is None else f" ({Path(trace.tb_frame.f_code.co_filename).name}:{trace.tb_lineno})"


@contextmanager
def _sole_writer(path: Path, patience_s: float) -> Iterator[int]:
    """Hold a lock that the kernel releases with the process: two writers in one shard would lose data silently."""
    deadline = time.monotonic() + patience_s
    while True:
        handle = os.open(path, os.O_RDWR | os.O_CREAT, 0o644)
        if _locked(handle) and os.fstat(handle).st_nlink > 0:
            break
        os.close(handle)
        if time.monotonic() > deadline:
            raise CheckError(f"{path}: another build is writing this shard; wait for it, or choose other --shards")
        time.sleep(0.05)
    try:
        os.ftruncate(handle, 0)
        yield handle
    finally:
        os.close(handle)


def _locked(handle: int) -> bool:
    try:
        import fcntl
    except ImportError:
        return True
    try:
        fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    except OSError:
        # A file system without locks: then the person at the keyboard is the only guard.
        return True
    return True
