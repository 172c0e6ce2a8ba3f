"""The loop of a build: it hands jobs to the workers, takes their results in, and does again what a dead worker left.

A shard is divided into its scenes, each a job of its own. So a shard employs all workers, and a worker that dies
costs one scene. Samples come back here, pickled, and wait in `Jobs.known`; with the last one a further job gets all
of them and writes the shard. In a cluster, where all samples would pass through the scheduler, a job makes a whole
shard and writes it; only a shard whose worker died is divided.
"""

from __future__ import annotations

import time
from collections import Counter, deque
from collections.abc import Mapping, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, wait
from dataclasses import dataclass, field
from typing import Any

from datagen import store
from datagen.building.engines import Engine, WorkerDied
from datagen.building.progress import Progress
from datagen.building.shard_job import Recipe, abandon_shard, make_scene, overtime, run_shard
from datagen.errors import CheckError
from datagen.store import upload

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
    started : shard that was handed out and is not committed → Unix time of that. An interruption (Ctrl-C) may come
        after a job was submitted and before its future is in `running`; the shard is here by then.
    retried : committed shard → its scenes that failed or were not there when the dataset was smaller, which alone are
        made.
    known : divided shard → scene → pickled sample, or why there is none.
    finished, made, failed : scenes of committed shards in all, made by this build, and failed in this build.
    deaths : scene → workers that died while they made it.
    deaths_between : workers in a row that died otherwise.
    """

    recipe: Recipe
    output: upload.Output
    engine: Engine
    progress: Progress
    waiting: deque[Task] = field(default_factory=deque)
    running: dict[Future[Any], Task] = field(default_factory=dict)
    started: dict[int, float] = field(default_factory=dict)
    retried: dict[int, Sequence[int]] = field(default_factory=dict)
    known: dict[int, dict[int, bytes | str]] = field(default_factory=dict)
    finished: int = 0
    made: int = 0
    failed: int = 0
    deaths: Counter[int] = field(default_factory=Counter)
    deaths_between: int = 0

    def run(self, wanted: Sequence[int], there: Mapping[int, Sequence[int]]) -> int:
        """Make the wanted shards; returns how many of them were there before with all scenes.

        there : shard that is committed → its scenes that failed, or that it does not have yet.
        """
        root, size = self.recipe.root, self._size
        whole = {shard for shard, failed in there.items() if not failed}
        for shard in whole:
            store.running_path(root, shard).unlink(missing_ok=True)
        self.waiting.extend(Task(shard) for shard in wanted if shard not in whole)
        kept = len(wanted) - len(self.waiting)
        if not self.waiting:
            return kept
        manifest = self.recipe.manifest
        if not self.recipe.standing:
            store.forget_complete(root)
            store.write_card(root, store.Description(manifest, store.each_committed(root, manifest, there)))
        self.finished = sum(size(shard) for shard in wanted if shard in whole)
        self.progress.begin(sum(map(size, wanted)), self.finished)
        if kept:
            self.progress.say(f"{kept} of {len(wanted)} shards are there already")
        self.retried = {shard: failed for shard, failed in there.items() if failed}
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
            for shard in self.started:
                abandon_shard(self.recipe, shard)
            raise
        return kept

    def _scenes(self, shard: int) -> Sequence[int]:
        """The scenes that are made before a shard is written."""
        return self.retried.get(shard) or self.recipe.manifest.schema.scenes_of(shard)

    def _size(self, shard: int) -> int:
        return len(self.recipe.manifest.schema.scenes_of(shard))

    def _divide(self, shard: int) -> None:
        """Let the scenes of a shard be the next jobs."""
        self.known[shard] = {}
        self.waiting.extendleft(Task(shard, scene) for scene in reversed(self._scenes(shard)))

    def _hand_out(self) -> None:
        """Submit the next job."""
        task = self.waiting.popleft()
        if task.scene is None and task.shard not in self.known and self.engine.shares_shards:
            self._divide(task.shard)
            task = self.waiting.popleft()
        shard = task.shard
        now = time.time()
        self.started.setdefault(shard, now)
        if task.scene is not None:
            future = self.engine.submit(make_scene, self.recipe, task.scene)
        else:
            # Of a shard that is not divided the worker notes itself when it begins.
            divided = (self.known[shard], self.started[shard]) if shard in self.known else ()
            future = self.engine.submit(run_shard, self.recipe, shard, now, *divided)
        self.running[future] = task

    def _take_in(self, future: Future[Any]) -> None:
        """Take the result of a job in; a job that was cancelled or whose worker died is put back."""
        task = self.running.pop(future)
        if future.cancelled():
            self.engine.restore(self.progress.say)
            abandon_shard(self.recipe, task.shard)
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
        of = self.recipe
        for record in store.committed(of.root, of.manifest, [shard]) if self.output.bucket else ():
            self.output.put_shard(record, of.manifest)
        self.known.pop(shard, None)
        del self.started[shard]
        size = self._size(shard)
        self.finished, self.made, self.failed = self.finished + size, self.made + size, self.failed + len(failures)
        if self.failed == self.made >= min(HOPELESS, of.manifest.schema.scenes):
            scene, reason = min(failures.items())
            stops = f"all of the first {self.made} scenes failed, so the build stops"
            raise CheckError(f"{stops}; scene {scene}: {reason}")

    def _after_death(self, task: Task, error: BaseException | None) -> None:
        """Put the job of a dead worker back, unless its scene is given up. Raises `CheckError` if workers keep dying
        without making a scene."""
        if task.scene is None:
            abandon_shard(self.recipe, task.shard)
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
        limit = self.recipe.scene_seconds
        if limit is not None and seconds > limit:
            # No exception could reach the scene, so its worker ended itself.
            self._take_scene(task.shard, task.scene, overtime(limit))
        elif self.deaths[task.scene] >= DEATHS_ALLOWED:
            why = f"{DEATHS_ALLOWED} worker processes died over it (killed, or out of memory)"
            self._take_scene(task.shard, task.scene, why)
        else:
            self.waiting.appendleft(task)

    def _show(self) -> None:
        """Show how many scenes are made, and which ones are in work."""
        in_work = [task.scene for task in self.running.values() if task.scene is not None]
        self.progress.update(self.finished + sum(map(len, self.known.values())), in_work, self.failed)
