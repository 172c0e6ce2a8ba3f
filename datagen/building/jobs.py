"""The loop of a build: it hands jobs to the workers, takes their results in, and does again what a dead worker left.

A shard is divided into its scenes, each a job of its own. So a shard employs all workers, and a worker that dies
costs one scene. Samples come back here, pickled, and wait in `Jobs.known`; with the last one a further job gets all
of them and writes the shard. In a cluster, where all samples would pass through the scheduler, a job makes a whole
shard and writes it; only a shard whose worker died is divided.
"""

from __future__ import annotations

import time
from collections import Counter, deque
from collections.abc import Callable, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, wait
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from datagen import store
from datagen.building.engines import Engine, WorkerDied
from datagen.building.progress import Progress
from datagen.building.shard_job import ShardJob, abandon_shard, make_scene, overtime, run_shard
from datagen.config import DatasetConfig
from datagen.errors import CheckError
from datagen.records import Sample
from datagen.store import upload
from datagen.store.environment import made_with

SampleFunction = Callable[[DatasetConfig, int], Sample]

DEATHS_ALLOWED = 2
"""Worker processes that may die while they make the same scene before the build gives that scene up. One may die for
another reason, such as memory that another program took."""
TICK_S = 0.5
"""Seconds between two updates of the progress bar."""
HOPELESS = 8
"""A build stops if all of its first `HOPELESS` scenes fail: the others would fail likewise."""


@dataclass(frozen=True)
class Task:
    """What a job makes: a whole shard, or one scene of it."""

    shard: int
    scene: int | None = None


@dataclass
class Jobs:
    """The jobs of a build.

    waiting : what is to be made, the next one first.
    running : future → what its job makes.
    begun : shards that were handed out and are not committed. An interruption (Ctrl-C) may come after a job was
        submitted and before its future is in `running`; the shard is in this set by then.
    retried : committed shard → its scenes that failed, which alone are made.
    known : divided shard → scene → pickled sample, or why there is none.
    started : divided shard → Unix time at which its first scene was handed out.
    finished, made, failed : scenes of committed shards in all, made by this build, and failed in this build.
    deaths : scene → workers that died while they made it.
    deaths_between : workers in a row that died otherwise.
    """

    config: DatasetConfig
    output: upload.Output
    manifest: store.Manifest
    engine: Engine
    sample_function: SampleFunction
    accept_mixed: bool
    scene_seconds: float | None
    progress: Progress
    waiting: deque[Task] = field(default_factory=deque)
    running: dict[Future[Any], Task] = field(default_factory=dict)
    begun: set[int] = field(default_factory=set)
    retried: dict[int, list[int]] = field(default_factory=dict)
    known: dict[int, dict[int, bytes | str]] = field(default_factory=dict)
    started: dict[int, float] = field(default_factory=dict)
    finished: int = 0
    made: int = 0
    failed: int = 0
    deaths: Counter[int] = field(default_factory=Counter)
    deaths_between: int = 0

    @property
    def root(self) -> Path:
        """The dataset's folder."""
        return self.output.folder

    @property
    def schema(self) -> store.Schema:
        """Shape and division of the dataset."""
        return self.manifest.schema

    def run(self, wanted: Sequence[int], there: Sequence[store.ShardRecord]) -> int:
        """Make the wanted shards; returns how many of them were there before with all scenes."""
        whole = {record.shard for record in there if not record.failures}
        for shard in whole:
            store.running_path(self.root, shard).unlink(missing_ok=True)
        self.waiting.extend(Task(shard) for shard in wanted if shard not in whole)
        kept = len(wanted) - len(self.waiting)
        if not self.waiting:
            return kept
        store.forget_complete(self.root)
        store.write_card(self.root, self.manifest, there)
        self.finished = sum(len(self.schema.scenes_of(shard)) for shard in wanted if shard in whole)
        self.progress.begin(sum(len(self.schema.scenes_of(shard)) for shard in wanted), self.finished)
        if kept:
            self.progress.say(f"{kept} of {len(wanted)} shards are there already")
        self.retried = {record.shard: sorted(record.failures) for record in there if record.failures}
        try:
            while self.waiting or self.running:
                while self.waiting and len(self.running) < self.engine.capacity:
                    self._hand_out()
                done, _ = wait(self.running, timeout=TICK_S, return_when=FIRST_COMPLETED)
                self._show()
                for future in done:
                    self._take_in(future)
            self.progress.update(self.finished, (), self.failed)
        except BaseException:
            # The writers must be gone before their files are removed.
            self.engine.close(kill=True)
            for shard in self.begun:
                self._clear(shard)
            raise
        return kept

    def _scenes(self, shard: int) -> Sequence[int]:
        """The scenes that are made before a shard is written."""
        return self.retried.get(shard) or self.schema.scenes_of(shard)

    def _divide(self, shard: int) -> None:
        """Let the scenes of a shard be the next jobs."""
        self.known[shard], self.started[shard] = {}, time.time()
        self.waiting.extendleft(Task(shard, scene) for scene in reversed(self._scenes(shard)))

    def _hand_out(self) -> None:
        """Submit the next job."""
        task = self.waiting.popleft()
        if task.scene is None and task.shard not in self.known and self.engine.shares_shards:
            self._divide(task.shard)
            task = self.waiting.popleft()
        shard = task.shard
        self.begun.add(shard)
        job = ShardJob(
            self.root.resolve(), self.config, self.schema, self.manifest.fingerprint, shard, self.sample_function,
            submitted=time.time(), known=self.known.get(shard, {}) if task.scene is None else {},
            started=self.started.get(shard), made_with=None if self.accept_mixed else made_with(),
            scene_seconds=self.scene_seconds,
        )  # fmt: skip
        call = (run_shard, job) if task.scene is None else (make_scene, job, task.scene)
        self.running[self.engine.submit(*call)] = task

    def _take_in(self, future: Future[Any]) -> None:
        """Take the result of a job in; a job that was cancelled or whose worker died is put back."""
        task = self.running.pop(future)
        if future.cancelled():
            self.engine.restore(self.progress.say)
            self._clear(task.shard)
            self.waiting.appendleft(task)
        elif isinstance(future.exception(), self.engine.deaths):
            self._after_death(task, future.exception())
        elif task.scene is None:
            self._take_shard(task.shard, future.result())
        else:
            self._take_scene(task.shard, task.scene, future.result())

    def _take_scene(self, shard: int, scene: int, outcome: bytes | str) -> None:
        """A scene is made, or given up. After the last one of a shard the shard can be written."""
        self.deaths_between = 0
        self.known[shard][scene] = outcome
        if len(self.known[shard]) == len(self._scenes(shard)):
            self.waiting.appendleft(Task(shard))

    def _take_shard(self, shard: int, failures: dict[int, str]) -> None:
        """A shard is committed. Raises `CheckError` if no scene of the build could be made so far."""
        self.deaths_between = 0
        for record in store.committed(self.root, self.manifest, [shard]) if self.output.bucket else ():
            self.output.put_shard(record)
        self.known.pop(shard, None)
        self.begun.discard(shard)
        size = len(self.schema.scenes_of(shard))
        self.finished, self.made, self.failed = self.finished + size, self.made + size, self.failed + len(failures)
        if self.failed == self.made >= min(HOPELESS, self.schema.scenes):
            scene, reason = min(failures.items())
            stops = f"all of the first {self.made} scenes failed, so the build stops"
            raise CheckError(f"{stops}; scene {scene}: {reason}")

    def _after_death(self, task: Task, error: BaseException | None) -> None:
        """Put the job of a dead worker back, unless its scene is given up. Raises `CheckError` if workers keep dying
        without making a scene."""
        if task.scene is None:
            self._clear(task.shard)
            if task.shard not in self.known:
                # Which scene was the cause shows when they are made one by one.
                self._divide(task.shard)
                return
        seconds = error.seconds if isinstance(error, WorkerDied) else 0.0
        if task.scene is None or seconds is None:
            self.deaths_between += 1
            if self.deaths_between > DEATHS_ALLOWED:
                raise CheckError(
                    "worker processes die before their first scene, or as they write a shard; in a script, call "
                    'build under if __name__ == "__main__": and see the messages above'
                )
            self.waiting.appendleft(task)
            return
        self.deaths[task.scene] += 1
        if self.scene_seconds is not None and seconds > self.scene_seconds:
            # No exception could reach the scene, so its worker ended itself.
            self._take_scene(task.shard, task.scene, overtime(self.scene_seconds))
        elif self.deaths[task.scene] >= DEATHS_ALLOWED:
            why = f"{DEATHS_ALLOWED} worker processes died over it (killed, or out of memory)"
            self._take_scene(task.shard, task.scene, why)
        else:
            self.waiting.appendleft(task)

    def _show(self) -> None:
        """Show how many scenes are made, and which ones are in work."""
        in_work = [task.scene for task in self.running.values() if task.scene is not None]
        self.progress.update(self.finished + sum(map(len, self.known.values())), in_work, self.failed)

    def _clear(self, shard: int) -> None:
        """Remove the files of an unfinished shard, unless it was committed at the last moment."""
        if store.committed(self.root, self.manifest, [shard]):
            store.running_path(self.root, shard).unlink(missing_ok=True)
        else:
            abandon_shard(self.root, self.schema, shard)
