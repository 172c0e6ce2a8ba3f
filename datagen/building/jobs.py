"""The loop of a build: it hands jobs to the workers, takes their results in, and does again what a dead worker left.

A shard is divided into its scenes, each a job of its own. So a shard employs all workers, and a worker that dies
costs one scene. Samples come back here, pickled, and wait in `Jobs.known`; with the last one a further job gets all
of them and writes the shard. In a cluster, where all samples would pass through the scheduler, a job makes a whole
shard and writes it; only a shard whose worker died is divided.

Several builds of one dataset share the work. Whoever makes a shard has locked it: this process where its scenes are
made one by one, until it is committed, else the worker. A shard that another process has locked is left for later,
and taken as it is once that has committed it. A build waits for such shards last, as long as their makers give signs
of life.
"""

from __future__ import annotations

import os
import time
from collections import Counter, deque
from collections.abc import Mapping, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, wait
from dataclasses import dataclass, field
from typing import Any

from datagen import store
from datagen.building.engines import Engine, WorkerDied
from datagen.building.progress import Progress
from datagen.building.shard_job import (
    Recipe,
    ShardHeld,
    abandon_shard,
    clear_writer,
    make_scene,
    overtime,
    run_shard,
)
from datagen.errors import CheckError
from datagen.locks import PULSE_S, give_sign, holder_of, lock_file, sign_of_life
from datagen.records.checks import as_given
from datagen.store import upload
from datagen.store.environment import environment_differences

DEATHS_ALLOWED = 2
"""Worker processes that may die while they make the same scene before the build gives that scene up. One may die for
another reason, such as memory that another program took."""
TICK_S = 0.5
"""Seconds between two updates of the progress bar."""
LOOK_S = 2.0
"""Seconds between two looks at shards that other processes make."""
SILENCE_S = 60.0
"""Seconds without a sign of life after which a build waits no more for a process that has locked a shard. Signs come
every `PULSE_S`, and compiled code holds one back for some seconds at most."""
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
    apart : shards that are divided because a worker died over them.
    locks : shard whose scenes are made one by one, and that is not committed yet → handle of its lock.
    held : shard that another process has locked → the last sign of life of that process.
    heard : monotonic time of the last one of all these signs, and of the last result of a job.
    looks, pulse : monotonic times of the next look at `held`, and of the next sign of life of this process.
    waits : whether a line has said that this build waits for another one.
    by_others : shards that other builds have made in the meantime.
    began : Unix time of the beginning.
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
    apart: set[int] = field(default_factory=set)
    locks: dict[int, int] = field(default_factory=dict)
    held: dict[int, int] = field(default_factory=dict)
    heard: float = field(default_factory=time.monotonic)
    looks: float = 0.0
    pulse: float = 0.0
    waits: bool = False
    by_others: int = 0
    began: float = field(default_factory=time.time)
    finished: int = 0
    made: int = 0
    failed: int = 0
    deaths: Counter[int] = field(default_factory=Counter)
    deaths_between: int = 0

    def run(self, wanted: Sequence[int], there: Mapping[int, Sequence[int]]) -> int:
        """Make the wanted shards; returns how many of them were there before with all scenes, or made by others.

        Raises `CheckError` if workers keep dying, and for shards that another process has locked and does not make.

        there : shard that is committed → its scenes that failed, or that it does not have yet.
        """
        root, size = self.recipe.root, self._size
        whole = {shard for shard, failed in there.items() if not failed}
        for shard in whole:
            clear_writer(self.recipe, shard)
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
            while self.waiting or self.running or self.held:
                while self.waiting and len(self.running) < self.engine.capacity:
                    self._hand_out()
                self._give_signs()
                if not self.running and self.held:
                    time.sleep(TICK_S)
                done, _ = wait(self.running, timeout=TICK_S, return_when=FIRST_COMPLETED)
                self._show()
                for future in done:
                    self._take_in(future)
                if self.held and not self.waiting:
                    self._look_at_held()
            self.progress.update(self.finished, (), self.failed)
        except BaseException:
            # The writers must be gone before their files are removed.
            self.engine.close(kill=True)
            for handle in self.locks.values():
                os.close(handle)
            for shard in self.started:
                abandon_shard(self.recipe, shard, is_ours=False)
            raise
        return kept + self.by_others

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
        """Submit the next job, unless it is one of a shard that another process makes, or has made."""
        task = self.waiting.popleft()
        now = time.time()
        if task.scene is None:
            if not self._is_ours(task.shard):
                return
            if task.shard in self.locks and task.shard not in self.known:
                self._divide(task.shard)
                task = self.waiting.popleft()
        shard = task.shard
        self.started.setdefault(shard, now)
        if task.scene is not None:
            future = self.engine.submit(make_scene, self.recipe, task.scene)
        else:
            # Of a shard that is not divided the worker notes itself when it begins.
            divided = (self.known[shard], self.started[shard]) if shard in self.known else ()
            future = self.engine.submit(run_shard, self.recipe, shard, now, *divided)
        self.running[future] = task

    def _is_ours(self, shard: int) -> bool:
        """Whether a shard is to be made, or written, now. One whose scenes are made one by one is then locked; any
        other is locked by its worker."""
        root, manifest = self.recipe.root, self.recipe.manifest
        path = store.running_path(root, shard)
        # Noted first, so that an interruption removes the file of the lock.
        self.started.setdefault(shard, time.time())
        handle = self.locks.pop(shard, None)
        if handle is None and clear_writer(self.recipe, shard):
            handle = lock_file(path)
        if handle is None:
            self._leave_for_later(shard)
            return False
        self.locks[shard] = handle
        self.held.pop(shard, None)
        record = next(iter(store.committed_records(root, manifest, [shard], hashes=True)), None)
        # A shard of which scenes failed before this build began is one to be mended.
        is_made = record is not None and not (record.failures and record.finished <= self.began)
        if is_made:
            path.unlink(missing_ok=True)
        if is_made or not (self.engine.shares_shards or shard in self.apart):
            self._unlock(shard)
        if record is not None and is_made:
            self._take_from_others(record)
        return not is_made

    def _leave_for_later(self, shard: int) -> None:
        """Another process makes this shard, or writes it still for a build that is gone."""
        self._unlock(shard)
        self.held.setdefault(shard, 0)
        if shard not in self.known:
            self.started.pop(shard, None)

    def _unlock(self, shard: int) -> None:
        """Let others have a shard, if this process has locked it."""
        if shard in self.locks:
            os.close(self.locks.pop(shard))

    def _take_from_others(self, record: store.ShardRecord) -> None:
        """A shard that another build has made is there. Raises `CheckError` if it was made with other versions."""
        for difference in (
            [] if self.recipe.made_with is None else environment_differences([self.recipe.made_with, record.made_by])
        ):
            raise CheckError(
                f"another build has made shard {record.shard} meanwhile, and differs in {difference}; use the same "
                f"there, or build with {as_given('accept_mixed', True)}"
            )
        if self.output.bucket:
            self.output.put_shard(record, self.recipe.manifest)
        self.known.pop(record.shard, None)
        self.started.pop(record.shard, None)
        self.finished, self.by_others = self.finished + self._size(record.shard), self.by_others + 1

    def _look_at_held(self) -> None:
        """Let the shards that others make be tried once more, now and then. Raises `CheckError` if nobody stirs."""
        now = time.monotonic()
        if now < self.looks:
            return
        root = self.recipe.root
        locked = {shard: (store.running_path(root, shard), store.writing_path(root, shard)) for shard in self.held}
        signs = {shard: sum(map(sign_of_life, paths)) for shard, paths in locked.items()}
        if self.running or signs != self.held:
            self.heard = now
        who = ", ".join(f"shard {shard} ({holder_of(*paths)})" for shard, paths in list(locked.items())[:8])
        who += f" and {len(locked) - 8} more" if len(locked) > 8 else ""
        if now > self.heard + SILENCE_S:
            raise CheckError(
                f"{root}: another build is writing {who}, and has not stirred for {SILENCE_S:g} s; all "
                "other shards are made; when that process has gone on or ended, run the same command again"
            )
        if not self.running and not self.waits:
            self.progress.say(f"waiting for another build, which is making {who}")
            self.waits = True
        self.looks, self.held = now + LOOK_S, signs
        self.waiting.extend(map(Task, signs))

    def _give_signs(self) -> None:
        """Let others see that this process is at work on the shards that it has locked."""
        if time.monotonic() < self.pulse:
            return
        self.pulse = time.monotonic() + PULSE_S
        for handle in self.locks.values():
            give_sign(handle)

    def _take_in(self, future: Future[Any]) -> None:
        """Take the result of a job in; a job that was cancelled or whose worker died is put back."""
        task, self.heard = self.running.pop(future), time.monotonic()
        if future.cancelled():
            self.engine.restore(self.progress.say)
            abandon_shard(self.recipe, task.shard, is_ours=task.shard in self.locks)
            self.waiting.appendleft(task)
        elif isinstance(future.exception(), self.engine.deaths):
            self._after_death(task, future.exception())
        elif isinstance(future.exception(), ShardHeld):
            self._leave_for_later(task.shard)
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
        for record in store.committed_records(of.root, of.manifest, [shard]) if self.output.bucket else ():
            self.output.put_shard(record, of.manifest)
        self.known.pop(shard, None)
        self.started.pop(shard, None)
        if shard in self.locks:
            store.running_path(of.root, shard).unlink(missing_ok=True)
            self._unlock(shard)
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
            abandon_shard(self.recipe, task.shard, is_ours=task.shard in self.locks)
            if task.shard not in self.known:
                # Which scene was the cause shows when they are made one by one.
                self.apart.add(task.shard)
                self.waiting.appendleft(task)
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
