"""Building a dataset: workers make shards and commit each with a record. Building again resumes.

A job makes one shard, or one scene of a shard: several workers share each of the last shards, so that none is idle.
A shard has one writer; only this process writes metadata. A sample depends on (dataset seed, scene index) alone, and
the division into shards on the configuration alone. So the bytes are the same for any number of workers, any engine,
and any number of interruptions.
"""

from __future__ import annotations

import math
import os
import statistics
import time
from collections import Counter, deque
from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, wait
from contextlib import closing
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from datagen import store
from datagen.building.engines import Engine, check_engine, start_imports, started
from datagen.building.progress import Progress
from datagen.building.shard_job import (
    LONGEST_SCENE_S,
    ShardJob,
    abandon_shard,
    make_scene,
    overtime,
    run_shard,
    scenes_begun,
)
from datagen.compiled import first_use
from datagen.config import DatasetConfig
from datagen.design.exposure import with_exposure_found
from datagen.errors import CheckError, InputError
from datagen.records import Sample
from datagen.records.checks import check_kind, numbers_of
from datagen.store import upload
from datagen.store.environment import made_with, mixed
from datagen.store.location import Bucket
from datagen.store.manifest import MANIFEST, DamagedManifest
from datagen.store.summaries import placed_anew_lines

SampleFunction = Callable[[DatasetConfig, int], Sample]
Task = tuple[int, int | None]
"""A shard, and the scene of it that a job makes; None if the job makes the whole shard."""

DEATHS_ALLOWED = 2
"""Worker processes that may die while they make the same scene; then the build gives that scene up. With one, a scene
would be lost when the machine runs out of memory for another reason."""
TICK_S = 0.5
"""Seconds between two updates of the progress bar. Half as many would only make its clock run more smoothly."""
NOISY = 0.2
"""Median relative error of a dataset's transients above which a build warns. At this error the noise of the
simulation is no longer small beside the photon noise of an ordinary exposure. Half as much would warn about most
quick trials."""
HOPELESS = 8
"""A build stops if all of its first `HOPELESS` scenes fail, because the others would fail likewise. Half as many
failures could be chance where rooms are hard to furnish."""

COMPILED_ONCE = "once after an installation or a change of the sources"


@dataclass(frozen=True)
class BuildResult:
    """The outcome of a build.

    Attributes
    ----------
    path : the dataset's folder, or its address in an object store.
    scenes : number of scenes in the dataset.
    built, kept : number of shards that this build made, and that an earlier build had committed.
    complete : whether every shard is there.
    seconds : wall-clock time of this build.
    told : a sentence on scenes whose objects were placed anew for `evidence_at_least`; "" without that key.
    noisy : a warning that more than a fifth of the simulated light is noise, with a remedy; "" if it is not.
    """

    path: Path | str
    scenes: int
    built: int
    kept: int
    complete: bool
    seconds: float
    told: str = ""
    noisy: str = ""

    def summary(self) -> str:
        """One line for people."""
        shards = "1 shard" if self.built == 1 else f"{self.built} shards"
        did = f"{shards} built in {self.seconds:.1f} s" if self.built else "nothing left to build"
        found = f", {self.kept} were there" if self.kept else ""
        missing = "not complete yet: other shards are missing"
        state = f"complete with {self.scenes} scenes" if self.complete else missing
        return f"{self.path}: {did}{found}; {state}{self.told and f'; {self.told}'}"


def build(
    config: DatasetConfig, path: str | Path, workers: int = 1, *, scenes: int | None = None,
    shards: str | None = None, engine: str = "local", scheduler: str | None = None, progress: bool = True,
    sample_function: SampleFunction | None = None, input_check: Callable[[DatasetConfig], None] | None = None,
    accept_mixed: bool = False, scene_seconds: float | None = None,
) -> BuildResult:  # fmt: skip
    """Build a dataset, or resume building it; returns what was made. `TransientDataset` reads the dataset.

    Parameters
    ----------
    config : what to make.
    path : the folder of the dataset, new or to be resumed; or `s3://bucket/name`: then shards are made in a local
        folder (below DATAGEN_STAGING, or ~/.cache) and uploaded one by one.
    workers : number of processes, one core each. The bytes do not depend on it.
    scenes : number of scenes, instead of `config.scenes`. An existing dataset may grow: its scenes stay as they are.
    shards : make these shards only, such as `"0-99"` or `"3,7-9"`, for job arrays. Several such builds may run side
        by side.
    engine : `local` processes, or `dask` with the address of a `scheduler` (none: a cluster on this machine).
    progress : report to standard error.
    sample_function : makes a sample of (configuration, scene index); workers must be able to import it. Left out: the
        whole simulation (`datagen.pipeline`).
    input_check : examines the configuration before anything is created. Left out: the check of the simulation.
    accept_mixed : resume a dataset that was made with other versions of libraries, or on another architecture. The
        same seed may then give other bytes, which the card states.
    scene_seconds : a scene that takes longer is given up (local workers only); compiling counts.

    Raises
    ------
    InputError : the configuration cannot be simulated; the output is a file, unwritable, or holds other files,
        another dataset, more scenes, or shards made with other versions. Nothing has been created or changed then.
    CheckError : scenes failed (all others are there), workers keep dying, or the disk refused.

    A script that calls `build` with local workers needs `if __name__ == "__main__":`, as with all of Python's pools.

    Examples
    --------
    >>> import datagen as dg, tempfile
    >>> from datagen.config import config_from_mapping
    >>> config = config_from_mapping({
    ...     "scenes": 2, "transport": {"target": 0.1},
    ...     "capture": {"scan": {"rows": 2, "columns": 2}, "time": {"bins": 64, "bin_width_ps": 800}}})
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     result = dg.build(config, f"{folder}/small.zarr", workers=1, progress=False)
    ...     data = dg.TransientDataset(f"{folder}/small.zarr", fields=("histogram",))
    ...     result.complete, len(data), tuple(data[0]["histogram"].shape)
    (True, 2, (4, 1, 64))
    """
    began = time.monotonic()
    _check_arguments(config, path, scene_seconds, engine)
    check_engine(engine, workers, scheduler)
    if scenes is not None:
        config = config.with_scenes(scenes)
    output = upload.Output.at(path)
    root, is_simulated = output.folder, sample_function is None
    if engine == "local":
        start_imports(__name__, "datagen.pipeline" if sample_function is None else sample_function.__module__)
    with closing(Progress(progress)) as shown:
        shown.doing("checking the configuration")
        output.fetch()
        config = _with_exposure(root, config)
        plan = store.planned(root, config)
        store.check_writable(root)
        wanted = parse_shards(shards, plan.schema.shards)
        there = store.committed(root, plan, hashes=True)
        if not accept_mixed:
            _check_unmixed(root, there)
        if sample_function is None:
            from datagen.building.input_check import check_inputs
            from datagen.pipeline import simulate_sample

            sample_function, input_check = simulate_sample, input_check or check_inputs
        if input_check is not None:
            input_check(config)
        try:
            with started(engine, workers, scheduler) as running:
                if is_simulated and first_use():
                    _compile(running, workers, sample_function, config, shown)
                manifest = store.prepare(root, config)
                output.begin(manifest)
                jobs = _Jobs(config, output, manifest, running, sample_function, accept_mixed, scene_seconds, shown)
                kept = jobs.run(wanted, there)
            records = store.committed(root, manifest)
            complete = len(records) == manifest.schema.shards
            (store.finish if complete else store.write_card)(root, manifest, records)
            output.finish(records, complete)
        except OSError as error:
            reason = error.strerror or error
            raise CheckError(f"{error.filename or root}: {reason}; mend that and build again to resume") from None
    _check_no_failures(records, manifest.schema.scenes)
    noisy = _noise_line(config, records)
    if noisy:
        shown.say(noisy)
    return BuildResult(
        path=output.shown, scenes=manifest.schema.scenes, built=len(wanted) - kept,
        kept=kept, complete=complete, seconds=time.monotonic() - began, noisy=noisy,
        told=" ".join(placed_anew_lines(scene.parameters for record in records for scene in record.scenes)),
    )  # fmt: skip


def _compile(engine: Engine, workers: int, sample: SampleFunction, config: DatasetConfig, shown: Progress) -> None:
    """Let one worker fill the cache of compiled kernels, or each of several would compile all of them."""
    if workers == 1:
        shown.say(f"the first scene compiles, {COMPILED_ONCE}")
        return
    # An error of this scene shows when the scene is built.
    compiling = engine.submit(sample, config, 0)
    while not wait([compiling], TICK_S).done:
        shown.doing(f"compiling, {COMPILED_ONCE}")


def _check_no_failures(records: Iterable[store.ShardRecord], scenes: int) -> None:
    failures = {scene: why for record in records for scene, why in record.failures.items()}
    if failures:
        scene, why = min(failures.items())
        raise CheckError(
            f"{len(failures)} of {scenes} scenes could not be made, the first is scene {scene}: {why}; "
            "all others are stored, and building again tries these anew"
        )


def _noise_line(config: DatasetConfig, records: Iterable[store.ShardRecord]) -> str:
    """A warning if the median error of the transients exceeds `NOISY`; "" if it does not, or is unknown."""
    stated = [scene.parameters.get("transient.relative_error") for record in records for scene in record.scenes]
    errors = [float(error) for error in stated if isinstance(error, int | float) and math.isfinite(error)]
    if not errors or (median := statistics.median(errors)) <= NOISY:
        return ""
    accuracy = config.transport
    if accuracy.target is None:
        remedy = f"ask for an error, transport: {{target: 0.05}}, or raise transport.lookins ({accuracy.lookins})"
    else:
        remedy = f"lower transport.target ({accuracy.target:g})"
    scenes = "1 scene" if len(errors) == 1 else f"{len(errors)} scenes"
    return (
        f"noise: the simulated light is {median:.0%} off in the median of {scenes} (relative L2 over all bins), "
        f"photon noise apart; {remedy}"
    )


def _with_exposure(root: Path, config: DatasetConfig) -> DatasetConfig:
    """The configuration with the exposure that reaches `detector.exposure_for`. An existing dataset keeps the
    exposure that it was begun with, because another search could find another one."""
    goal = config.detector.exposure_for
    if goal is None or not (root / MANIFEST).is_file():
        return with_exposure_found(config)
    try:
        stored = store.read_manifest(root).config["detector"]
    except DamagedManifest:
        return with_exposure_found(config)
    if stored.get("found_for") != goal.model_dump(mode="json"):
        exposure = stored.get("found_for") or f"cycles = {stored.get('cycles')}"
        raise InputError(
            f"output {root}: holds a dataset whose exposure is {exposure}, not detector.exposure_for = "
            f"{goal.model_dump(mode='json')}; name another folder, or change it back to resume"
        )
    found = {"exposure_for": None, "found_for": goal, "cycles": stored["cycles"]}
    return config.model_copy(update={"detector": config.detector.model_copy(update=found)})


def _check_arguments(config: object, path: object, scene_seconds: float | None, engine: str) -> None:
    check_kind("config", config, DatasetConfig, remedy="such as load_config(path)")
    check_kind("path", path, str, os.PathLike, Bucket, remedy="name the folder to make")
    if str(path) == "":
        raise InputError("OUT = '': names no folder; name the one to make")
    if scene_seconds is None:
        return
    check_kind("build.scene_seconds", scene_seconds, int, float, remedy="seconds")
    if not 0 < scene_seconds <= LONGEST_SCENE_S:
        raise InputError(f"--scene-seconds {scene_seconds:g}: must be > 0 and ≤ {LONGEST_SCENE_S:g}")
    if engine != "local":
        raise InputError(f"--scene-seconds {scene_seconds:g}: only local workers have such a limit; leave it out")


def _check_unmixed(root: Path, records: Iterable[store.ShardRecord]) -> None:
    """Refuse to resume if shards were made with versions, or on an architecture, that may give other bytes."""
    for record in records:
        for difference in mixed([record.made_by, made_with()]):
            raise InputError(
                f"output {root}: shard {record.shard} and this machine differ in {difference}; the same bytes are "
                "promised for the same versions (constraints.txt) on the same kind of processor: use those, "
                "name another folder, or accept it with --accept-mixed"
            )


@dataclass
class _Jobs:
    """The loop that hands out jobs and takes in their results.

    waiting : jobs to hand out, the next one first.
    running : future → its job, and the scene that the job makes (None: the whole shard).
    begun : shards that were handed out and are not committed. An interruption (Ctrl-C) may come after a job was
        submitted and before its future is in `running`; the shard is in this set by then.
    undivided : shards whose scenes come from one worker.
    scenes_made : shard whose scenes come from several workers → the results of those scenes that are made.
    finished, made, failed : scenes of committed shards in all, made by this build, and failed in this build.
    deaths : scene → workers that died while they made it; −1 → workers in a row that died before any scene.
    given_up : scene → why it is not tried again.
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
    running: dict[Future[Any], tuple[ShardJob, int | None]] = field(default_factory=dict)
    begun: set[int] = field(default_factory=set)
    undivided: set[int] = field(default_factory=set)
    scenes_made: dict[int, dict[int, bytes | str]] = field(default_factory=dict)
    finished: int = 0
    made: int = 0
    failed: int = 0
    deaths: Counter[int] = field(default_factory=Counter)
    given_up: dict[int, str] = field(default_factory=dict)

    @property
    def root(self) -> Path:
        return self.output.folder

    @property
    def schema(self) -> store.Schema:
        return self.manifest.schema

    def run(self, wanted: Sequence[int], there: Sequence[store.ShardRecord]) -> int:
        """Make the wanted shards; returns how many of them were there before with all scenes."""
        whole = {record.shard for record in there if not record.failures}
        for shard in whole:
            store.running_path(self.root, shard).unlink(missing_ok=True)
        self.waiting.extend((shard, None) for shard in wanted if shard not in whole)
        kept = len(wanted) - len(self.waiting)
        if not self.waiting:
            return kept
        store.forget_complete(self.root)
        store.write_card(self.root, self.manifest, there)
        self.finished = sum(len(self.schema.scenes_of(shard)) for shard in wanted if shard in whole)
        self.progress.begin(sum(len(self.schema.scenes_of(shard)) for shard in wanted), self.finished)
        if kept:
            self.progress.say(f"{kept} of {len(wanted)} shards are there already")
        # In a committed shard only the failed scenes are made, so there is little to divide.
        self.undivided = {record.shard for record in there} if self.engine.shares_shards else set(wanted)
        try:
            while self.waiting or self.running:
                while self.waiting and len(self.running) < self.engine.capacity:
                    self._hand_out(*self.waiting.popleft())
                done, _ = wait(self.running, timeout=TICK_S, return_when=FIRST_COMPLETED)
                ahead, in_work = self._under_way()
                self.progress.update(self.finished + ahead, in_work, self.failed)
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

    def _hand_out(self, shard: int, scene: int | None) -> None:
        """Submit a job. One of the last shards is divided into its scenes, since workers would be idle otherwise."""
        if shard not in self.undivided and len(self.waiting) < self.engine.capacity > 1:
            self.undivided.add(shard)
            self.scenes_made[shard] = {}
            scene, *others = self.schema.scenes_of(shard)
            self.waiting.extendleft((shard, other) for other in reversed(others))
        self.begun.add(shard)
        job = self._job(shard)
        call = (run_shard, job) if scene is None else (make_scene, job, scene)
        self.running[self.engine.submit(*call)] = job, scene

    def _take_in(self, future: Future[Any]) -> None:
        """Take the result of a job in; a job that was cancelled or whose worker died is put back."""
        job, scene = self.running.pop(future)
        shard = job.shard
        if future.cancelled():
            self.engine.restore(self.progress.say)
            self._clear(shard)
            self.waiting.appendleft((shard, scene))
            return
        result = self._outcome(future, job, scene)
        if result is None:
            self.waiting.appendleft((shard, scene))
            return
        # A worker got as far as a scene: earlier deaths before the first scene were chance.
        self.deaths[-1] = 0
        size = len(self.schema.scenes_of(shard))
        if scene is not None:
            self.scenes_made[shard][scene] = result
            if len(self.scenes_made[shard]) == size:
                # All scenes of a divided shard are there: the next job writes the shard.
                self.waiting.appendleft((shard, None))
            return
        for record in store.committed(self.root, self.manifest, [shard]) if self.output.bucket else ():
            self.output.put_shard(record)
        self.scenes_made.pop(shard, None)
        self.begun.discard(shard)
        self.finished, self.made, self.failed = self.finished + size, self.made + size, self.failed + len(result)
        if self.failed == self.made >= min(HOPELESS, self.schema.scenes):
            scene, reason = min(result.items())
            stops = f"all of the first {self.made} scenes failed, so the build stops"
            raise CheckError(f"{stops}; scene {scene}: {reason}")

    def _job(self, shard: int) -> ShardJob:
        """The job of a shard. If all scenes of a divided shard are made, it contains them."""
        scenes = self.schema.scenes_of(shard)
        skip = {scene: self.given_up[scene] for scene in scenes if scene in self.given_up}
        root, fingerprint = self.root.resolve(), self.manifest.fingerprint
        made = None if self.accept_mixed else made_with()
        job = ShardJob(
            root, self.config, self.schema, fingerprint, shard, self.sample_function, skip, time.time(), made,
            self.scene_seconds,
        )  # fmt: skip
        given = self.scenes_made.get(shard, {})
        if len(given) < len(scenes):
            return job
        return replace(job, given=given, begun=min(scenes_begun(job.root, self.schema, shard).values(), default=None))

    def _under_way(self) -> tuple[int, list[int]]:
        """Number of scenes made in shards that are not committed, and the scenes that workers are making."""
        made, in_work = sum(map(len, self.scenes_made.values())), list[int]()
        for job, scene in self.running.values():
            if scene is not None:
                in_work.append(scene)
            elif job.given is None and (scenes := list(scenes_begun(self.root, self.schema, job.shard))):
                made += scenes[-1] - self.schema.scenes_of(job.shard).start
                in_work.append(scenes[-1])
        return made, in_work

    def _outcome(self, future: Future[Any], job: ShardJob, scene: int | None) -> Any:
        """The result of a finished job; None if its worker died, so that the job must be done again."""
        error = future.exception()
        if error is None:
            return future.result()
        if not isinstance(error, self.engine.deaths):
            self._clear(job.shard)
            raise error
        begun = scenes_begun(self.root, self.schema, job.shard)
        if scene is None:
            scene = max(begun, default=None)
            self._clear(job.shard)
        elif begun.get(scene, 0.0) < job.handed_out:
            scene = None
        self.deaths[-1 if scene is None else scene] += 1
        if scene is None and self.deaths[-1] > DEATHS_ALLOWED:
            raise CheckError(
                "worker processes die before their first scene; in a script, call build under "
                'if __name__ == "__main__": and see the messages above'
            )
        if scene is None:
            return None
        if self.scene_seconds is not None and time.time() - begun[scene] > self.scene_seconds:
            # No exception could reach the scene, so its worker ended itself.
            self.given_up[scene] = overtime(self.scene_seconds)
        elif self.deaths[scene] >= DEATHS_ALLOWED:
            self.given_up[scene] = f"{DEATHS_ALLOWED} worker processes died over it (killed, or out of memory)"
        return None

    def _clear(self, shard: int) -> None:
        """Remove the files of an unfinished shard, unless it was committed at the last moment."""
        if store.committed(self.root, self.manifest, [shard]):
            store.running_path(self.root, shard).unlink(missing_ok=True)
        else:
            abandon_shard(self.root, self.schema, shard)


def parse_shards(text: str | None, shards: int) -> list[int]:
    """Shard numbers, ascending, of a text such as `"0-99"` or `"3,7-9"`; all of them for None."""
    if text is None:
        return list(range(shards))
    check_kind("shards", text, str, remedy="such as '0-99'")
    return numbers_of("shards", text, shards)
