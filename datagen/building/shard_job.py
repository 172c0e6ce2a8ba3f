"""The jobs of a worker: make one scene, or write and commit a shard, with scenes that are made already or here."""

from __future__ import annotations

import faulthandler
import os
import pickle
import signal
import threading
import time
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import AbstractContextManager, contextmanager, nullcontext, suppress
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType

from datagen.config import DatasetConfig
from datagen.errors import CheckError, InputError
from datagen.exit_status import Ended
from datagen.locks import holder_of, lock_file, signs_of_life
from datagen.records import Sample
from datagen.records.checks import as_given
from datagen.store import (
    DatasetReader,
    Manifest,
    ShardRecord,
    committed_records,
    discard_shard,
    each_committed,
    running_path,
    write_shard,
    writing_path,
)
from datagen.store.environment import environment_differences, joined_environment, made_with
from datagen.store.record import GROWTH

GRACE_S = 10.0
"""Seconds beyond the time limit of a scene (at most the limit itself) after which its process ends, because the
exception did not reach it: time for a library call to return."""
LONGEST_SCENE_S = 30 * 86400.0
LOCK_PATIENCE_S = 1.0
"""Seconds that a worker waits for another maker or writer of the same shard before it takes another shard."""

Known = Mapping[int, bytes | str]
"""Scene → what `make_scene` returned for it, or why it is given up."""
Samples = Iterable[tuple[int, Sample | str]]
"""Index of a scene and its sample, or one line on why there is none; of some scenes."""
SampleFunction = Callable[[DatasetConfig, int], Sample]


@dataclass(frozen=True)
class Recipe:
    """What the jobs of a build have in common, as it is sent to workers.

    root : the dataset's folder.
    made_with : the environment of the other shards; None if any mixture is accepted.
    scene_seconds : time limit of a scene; None: no limit.
    standing : number of shards of the smaller dataset that grows. They stay until the larger one is complete, so
        what takes their place waits.
    """

    root: Path
    config: DatasetConfig
    manifest: Manifest
    sample_function: SampleFunction
    made_with: Mapping[str, str] | None = None
    scene_seconds: float | None = None
    standing: int = 0

    def home(self, shard: int) -> Path:
        """The folder in which a shard is written."""
        return self.root / GROWTH if shard < self.standing else self.root


class ShardHeld(CheckError):
    """Another process is making or writing the shard."""


def make_scene(recipe: Recipe, index: int) -> bytes | str:
    """One scene as a pickled sample, or one line on why there is none."""
    _check_environment(recipe)
    sample = attempt(recipe.sample_function, recipe.config, index, recipe.scene_seconds)
    try:
        return sample if isinstance(sample, str) else pickle.dumps(sample)
    except Exception as error:
        return f"not a sample: {type(error).__name__}: {' '.join(str(error).split())}"


def run_shard(
    recipe: Recipe, shard: int, submitted: float, known: Known = MappingProxyType({}), started: float | None = None
) -> dict[int, str]:
    """Make the scenes of a shard that are not known, and commit it; returns scene → reason for those that failed.

    In a shard that is committed already only the failed scenes are tried again, and those made that it had not when
    its dataset had fewer scenes.

    submitted : Unix time at which the job was submitted.
    known : scenes that are made, or given up, already.
    started : Unix time at which the first of the known scenes was begun, by a build that has locked the shard; None
        if this job is to lock it and to make all scenes.

    Raises `ShardHeld` if another process is making or writing the shard.
    """
    root, manifest = recipe.root, recipe.manifest
    _check_environment(recipe)
    # A build that made the scenes keeps its lock while this process writes them, which may outlive it by a moment.
    with _sole_maker(recipe, shard) if started is None else nullcontext(), _sole_writer(recipe, shard):
        record = next(iter(committed_records(root, manifest, [shard], hashes=True)), None)
        # A record that is newer than the job was committed by another build, or by this job before its result got
        # lost.
        if record is None or (record.failures and record.finished <= submitted):
            samples: Samples | None = _samples(recipe, manifest.schema.scenes_of(shard), known)
            made_by = made_with()
            begun = next(each_committed(root, manifest, [shard], hashes=True, partly=True), None)
            if begun is not None:
                samples, made_by = (
                    _with_missing_made(recipe, begun, known),
                    joined_environment(begun.made_by, made_by),
                )
            if samples is not None:
                home = recipe.home(shard)
                record = write_shard(home, manifest.schema, shard, manifest.fingerprint, samples, made_by, started)
    assert record is not None
    return record.failures


def _check_environment(recipe: Recipe) -> None:
    """Raise `CheckError` if the environment of this worker may give other bytes than that of the other shards."""
    differing = [] if recipe.made_with is None else environment_differences([recipe.made_with, made_with()])
    if differing:
        raise CheckError(
            f"a worker differs in {differing[0]}; use the same there, or build with {as_given('accept_mixed', True)}"
        )


def scenes_missing(manifest: Manifest, record: ShardRecord) -> list[int]:
    """The scenes of a shard that its record does not have, or that could not be made."""
    made = {scene.index for scene in record.scenes if scene.failure is None}
    return [scene for scene in manifest.schema.scenes_of(record.shard) if scene not in made]


def _with_missing_made(recipe: Recipe, record: ShardRecord, known: Known) -> Samples | None:
    """(index, sample) of all scenes of a shard: the missing ones made, the others as stored. None if the record has
    all scenes, and all that had failed failed again."""
    due = recipe.manifest.schema.scenes_of(record.shard)
    anew = dict(_samples(recipe, scenes_missing(recipe.manifest, record), known))
    if len(record.scenes) == len(due) and not any(isinstance(sample, Sample) for sample in anew.values()):
        return None
    names = recipe.manifest.schema.by_name
    # A record that waits has its files beside it until they take their places, all before the next shard is made.
    waits = record.problem(recipe.root / GROWTH, hashes=False) is None
    place = recipe.root / GROWTH if waits else recipe.root
    reader = DatasetReader(place, recipe.manifest, names)
    for scene in record.scenes:
        if scene.failure is None:
            arrays = {name: reader.read(name, [scene.index])[0] for name in names}
            anew[scene.index] = Sample(scene.index, arrays, scene.parameters, scene.seconds)
    return sorted(anew.items())


def abandon_shard(recipe: Recipe, shard: int, is_ours: bool) -> None:
    """Remove the files of a shard whose writer died, unless it was committed at the last moment, or another process
    has locked the shard. is_ours : whether this process has, and goes on with it."""
    maker = nullcontext() if is_ours else _sole_maker(recipe, shard, patience_s=0.0)
    with suppress(CheckError), maker, _sole_writer(recipe, shard, patience_s=0.0):
        if not committed_records(recipe.root, recipe.manifest, [shard]):
            discard_shard(recipe.home(shard), recipe.manifest.schema, shard)


def clear_writer(recipe: Recipe, shard: int) -> bool:
    """Whether no process writes a shard; removes the file that a killed one had locked."""
    path = writing_path(recipe.root, shard)
    try:
        with _hold_lock(path, patience_s=0.0) if os.path.lexists(path) else nullcontext():
            return True
    except ShardHeld:
        return False


def _samples(recipe: Recipe, scenes: Iterable[int], known: Known) -> Samples:
    """(index, sample or reason) of some scenes of a shard, one after the other: those not known are made here."""
    for index in scenes:
        outcome = known.get(index)
        if outcome is None:
            yield index, attempt(recipe.sample_function, recipe.config, index, recipe.scene_seconds)
        else:
            yield index, outcome if isinstance(outcome, str) else pickle.loads(outcome)


def attempt(
    sample_function: SampleFunction, config: DatasetConfig, index: int, seconds: float | None = None
) -> Sample | str:
    """The sample, or one line on why there is none. After an error the scene is tried once more, except for bad input
    and a scene that took longer than `seconds`."""
    reason = ""
    for _ in range(2):
        try:
            with time_limit(seconds):
                return sample_function(config, index)
        except (InputError, Overtime) as error:
            return str(error)
        except Ended:
            raise
        except (Exception, SystemExit) as error:
            text = " ".join(str(error).split())
            place = _last_line_of(error)
            reason = f"{type(error).__name__}: {text}{place}" if text else f"{type(error).__name__}{place}"
    return reason


def _last_line_of(error: BaseException) -> str:
    """The file and line that raised an error, as text for the record."""
    trace = error.__traceback__
    while trace is not None and trace.tb_next is not None:
        trace = trace.tb_next
    return "" if trace is None else f" ({Path(trace.tb_frame.f_code.co_filename).name}:{trace.tb_lineno})"


def _sole_maker(recipe: Recipe, shard: int, patience_s: float | None = None) -> AbstractContextManager[None]:
    """A context in which no other process makes a shard, for that would be in vain."""
    return _hold_lock(running_path(recipe.root, shard), patience_s)


def _sole_writer(recipe: Recipe, shard: int, patience_s: float | None = None) -> AbstractContextManager[None]:
    """A context in which no other process writes a shard, for two writers would lose data silently."""
    return _hold_lock(writing_path(recipe.root, shard), patience_s)


@contextmanager
def _hold_lock(path: Path, patience_s: float | None) -> Iterator[None]:
    """A context in which this process has locked a file, which is there for this alone. The system unlocks it when
    the process ends. Raises `ShardHeld` if another process has it for longer than `patience_s`, by default
    `LOCK_PATIENCE_S`."""
    deadline = time.monotonic() + (LOCK_PATIENCE_S if patience_s is None else patience_s)
    while (handle := lock_file(path)) is None:
        if time.monotonic() > deadline:
            raise ShardHeld(
                f"{path}: another build is writing this shard ({holder_of(path)}); wait for it, or choose other "
                "shards"
            )
        time.sleep(0.05)
    try:
        with signs_of_life(handle):
            yield
        path.unlink(missing_ok=True)
    finally:
        os.close(handle)


class Overtime(BaseException):
    """Raised if a scene takes too long. It is no `Exception`, so that the sample function does not catch it."""


def overtime(seconds: float) -> str:
    """The reason that is recorded for a scene that took too long."""
    return f"took longer than {seconds:g} s (scene_seconds)"


@contextmanager
def time_limit(seconds: float | None) -> Iterator[None]:
    """Raise `Overtime` if the block takes longer than `seconds` (None: no limit). If no exception can reach the
    block, such as in compiled code that never returns, this process ends. In other threads than the main one there is
    no limit."""
    if seconds is None or threading.current_thread() is not threading.main_thread():
        yield
        return

    def ring(*_: object) -> None:
        raise Overtime(overtime(seconds))

    with open(os.devnull, "w") as nowhere:
        before = signal.signal(signal.SIGALRM, ring)
        # This timer runs in a thread outside of Python, so it needs no lock that the block may hold.
        faulthandler.dump_traceback_later(seconds + min(GRACE_S, seconds), exit=True, file=nowhere)
        signal.setitimer(signal.ITIMER_REAL, seconds)
        try:
            yield
        finally:
            signal.setitimer(signal.ITIMER_REAL, 0.0)
            faulthandler.cancel_dump_traceback_later()
            signal.signal(signal.SIGALRM, before)
