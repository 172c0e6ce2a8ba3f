"""Building a dataset: workers make shards and commit each with a record. Building again resumes.

One job is one shard, or one scene of the last shards, which workers share. A shard has one writer; this process alone
writes metadata. A sample depends on (dataset seed, scene index) only, and the division into shards on the
configuration only: the bytes are the same for any number of workers, any engine, and any number of interruptions.
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
from datagen.store.location import Bucket, location_of
from datagen.store.manifest import MANIFEST, DamagedManifest
from datagen.store.summaries import placed_anew_lines

SampleFunction = Callable[[DatasetConfig, int], Sample]
Task = tuple[int, int | None]
"""A shard, and the one scene of it that is to be made; None: the whole shard."""

DEATHS_ALLOWED = 2
"""A scene over which this many worker processes died is given up. With one, a worker that the machine killed for
another's memory would cost its scene."""
TICK_S = 0.5
"""Seconds between two looks at how far workers are. With half as many the clock of the bar runs more smoothly."""
NOISY = 0.2
"""Median relative error of a dataset's transients from which on a build says that they are noise: of data that are a
fifth noise of the simulation, photon noise of an ordinary exposure is no longer the larger part. Half as much would
speak up about what many a quick trial is made with."""
HOPELESS = 8
"""A build whose first so many scenes all failed stops: the rest would fail likewise. Half as many could be chance
where rooms are hard to furnish."""


@dataclass(frozen=True)
class BuildResult:
    """The outcome of a build.

    Attributes
    ----------
    path : of the dataset: its folder, or its address in an object store.
    scenes : in the dataset.
    built, kept : shards made now, and found committed.
    complete : whether every shard is there.
    told : a sentence on scenes whose objects were placed anew for `evidence_at_least`; "" without that key.
    noisy : a sentence that the simulated light is more than a fifth noise, with a remedy; "" where it is not.
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
    """The outcome of building a dataset, or of going on with one. `TransientDataset` reads the dataset.

    Parameters
    ----------
    config, path : what to make, and the folder to make or to go on with, or `s3://bucket/name`: then shards are made
        in a local folder (below DATAGEN_STAGING, or ~/.cache) and put there one by one.
    workers : processes, one core each. The bytes do not depend on it.
    scenes : instead of `config.scenes`. An existing dataset may grow: its scenes stay as they are.
    shards : only these, such as `"0-99"` or `"3,7-9"`, for job arrays; several such builds may run side by side.
    engine : `local` processes, or `dask` with the address of a `scheduler` (none: a cluster on this machine).
    progress : report to standard error.
    sample_function, input_check : what makes a sample, and what examines the configuration before anything is
        created; left out, the whole simulation (`datagen.pipeline`). Must be importable by the workers.
    accept_mixed : go on with a dataset that was made with other versions of libraries, or on another architecture:
        the same seed may then give other bytes, which the card states.
    scene_seconds : a scene that takes longer is given up (local workers only); compiling counts.

    Raises
    ------
    InputError : the configuration cannot be simulated; the output is a file, unwritable, holds other files, another
        dataset, shards made with other versions, or fewer scenes are asked for than it holds. Nothing has been
        created or changed then.
    CheckError : scenes failed (all others are there), workers keep dying, or the disk refused.

    A script that calls it with local workers needs `if __name__ == "__main__":`, as with all of Python's pools.

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
    target = location_of(path)
    bucket = target if isinstance(target, Bucket) else None
    root = target if isinstance(target, Path) else upload.staging_of(target)
    if engine == "local":
        start_imports(__name__, "datagen.pipeline" if sample_function is None else sample_function.__module__)
    with closing(Progress(progress)) as shown:
        shown.doing("checking the configuration")
        if bucket is not None:
            upload.fetch(root, bucket)
        config = _with_exposure(root, config)
        plan = store.planned(root, config)
        store.check_writable(root)
        wanted = parse_shards(shards, plan.schema.shards)
        there = store.committed(root, plan, hashes=True)
        if not accept_mixed:
            _check_unmixed(root, there)
        is_simulated = sample_function is None
        if sample_function is None:
            from datagen import pipeline

            sample_function, input_check = pipeline.simulate_sample, input_check or pipeline.check_inputs
        if input_check is not None:
            input_check(config)
        try:
            with started(engine, workers, scheduler) as running:
                compiles = is_simulated and first_use()
                if compiles and workers == 1:
                    shown.say("the first scene compiles, once after an installation")
                elif compiles:
                    # One worker fills the cache of compiled kernels, or each would compile all of them. An error of
                    # this scene shows when the scene is built.
                    compiling = running.submit(sample_function, config, 0)
                    while not wait([compiling], TICK_S).done:
                        shown.doing("compiling, once after an installation")
                manifest = store.prepare(root, config)
                if bucket is not None:
                    upload.begin(root, bucket, manifest)
                state = _Build(config, root, manifest, running, sample_function, accept_mixed, scene_seconds, bucket)
                kept = state.run(wanted, there, shown)
            records = store.committed(root, manifest)
            complete = len(records) == manifest.schema.shards
            (store.finish if complete else store.write_card)(root, manifest, records)
            if bucket is not None:
                upload.finish_upload(root, bucket, records, complete)
        except OSError as error:
            reason = error.strerror or error
            raise CheckError(f"{error.filename or root}: {reason}; mend that and build again to resume") from None
    _check_no_failures(records, manifest.schema.scenes)
    noisy = _noise_line(config, records)
    if noisy:
        shown.say(noisy)
    return BuildResult(
        path=root if bucket is None else str(bucket), scenes=manifest.schema.scenes, built=len(wanted) - kept,
        kept=kept, complete=complete, seconds=time.monotonic() - began, noisy=noisy,
        told=" ".join(placed_anew_lines(scene.parameters for record in records for scene in record.scenes)),
    )  # fmt: skip


def _check_no_failures(records: Iterable[store.ShardRecord], scenes: int) -> None:
    failures = {scene: why for record in records for scene, why in record.failures.items()}
    if failures:
        scene, why = min(failures.items())
        raise CheckError(
            f"{len(failures)} of {scenes} scenes could not be made, the first is scene {scene}: {why}; "
            "all others are stored, and building again tries these anew"
        )


def _noise_line(config: DatasetConfig, records: Iterable[store.ShardRecord]) -> str:
    """A warning where the transients of the scenes are `NOISY` in the median; "" where they are not, or where their
    error is unknown."""
    stated = [scene.parameters.get("transient.relative_error") for of in records for scene in of.scenes]
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
    """The configuration with the exposure that reaches `detector.exposure_for`. An existing dataset keeps the one
    that it was begun with: another search could find another one."""
    goal = config.detector.exposure_for
    if goal is None or not (root / MANIFEST).is_file():
        return with_exposure_found(config)
    try:
        stored = store.read_manifest(root).config.get("detector", {})
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
    """Refuse to go on with shards that were made with what may give other bytes."""
    for record in records:
        for difference in mixed([record.environment, made_with()]):
            raise InputError(
                f"output {root}: shard {record.shard} and this machine differ in {difference}; the same bytes are "
                "promised for one architecture and one set of versions (constraints.txt): use those, "
                "name another folder, or accept it with --accept-mixed"
            )


@dataclass
class _Build:
    """The loop over shards, and its memory of workers that died."""

    config: DatasetConfig
    root: Path
    manifest: store.Manifest
    engine: Engine
    sample_function: SampleFunction
    accept_mixed: bool
    scene_seconds: float | None
    bucket: Bucket | None = None
    deaths: Counter[int] = field(default_factory=Counter)
    """Scene → workers that died over it; −1 → workers in a row that died before any scene."""
    given_up: dict[int, str] = field(default_factory=dict)
    shared: dict[int, dict[int, bytes | str]] = field(default_factory=dict)
    """Shard whose scenes come from several workers → those of its scenes that are there."""

    @property
    def schema(self) -> store.Schema:
        return self.manifest.schema

    def run(self, wanted: Sequence[int], there: Sequence[store.ShardRecord], progress: Progress) -> int:
        """The number of wanted shards that were there with all scenes; the other wanted ones are made."""
        kept = {record.shard for record in there if not record.failures}
        for shard in kept:
            store.running_path(self.root, shard).unlink(missing_ok=True)
        waiting = deque[Task]((shard, None) for shard in wanted if shard not in kept)
        if not waiting:
            return len(wanted)
        store.forget_complete(self.root)
        store.write_card(self.root, self.manifest, there)
        sizes = {shard: len(self.schema.scenes_of(shard)) for shard in wanted}
        finished = sum(sizes[shard] for shard in wanted if shard in kept)
        progress.begin(sum(sizes.values()), finished)
        if len(waiting) < len(wanted):
            progress.say(f"{len(wanted) - len(waiting)} of {len(wanted)} shards are there already")
        # In a shard that is there only scenes that failed are made.
        undivided = {record.shard for record in there} if self.engine.shares_shards else set(wanted)
        running: dict[Future[Any], tuple[ShardJob, int | None]] = {}
        # Ctrl-C may come after a shard was handed out and before its future is in `running`: this set has it then.
        begun: set[int] = set()
        made = failed = 0
        try:
            while waiting or running:
                while waiting and len(running) < self.engine.capacity:
                    shard, scene = waiting.popleft()
                    if shard not in undivided and len(waiting) < self.engine.capacity > 1:
                        # The last ones: workers would have nothing to do. A shard is written when all its scenes are
                        # there.
                        undivided.add(shard)
                        self.shared[shard] = {}
                        first, *others = self.schema.scenes_of(shard)
                        waiting.extendleft((shard, scene) for scene in reversed(others))
                        scene = first
                    begun.add(shard)
                    job = self._job(shard)
                    does = (run_shard, job) if scene is None else (make_scene, job, scene)
                    running[self.engine.submit(*does)] = job, scene
                done, _ = wait(running, timeout=TICK_S, return_when=FIRST_COMPLETED)
                ahead, in_work = self._under_way(running.values())
                progress.update(finished + ahead, in_work, failed)
                for future in done:
                    job, scene = running.pop(future)
                    shard = job.shard
                    if future.cancelled():
                        self.engine.restore(progress.say)
                        self._clear(shard)
                        waiting.appendleft((shard, scene))
                        continue
                    result = self._outcome(future, job, scene)
                    if result is None:
                        waiting.appendleft((shard, scene))
                        continue
                    # Workers do get to their first scene, so the others that died did so by chance.
                    self.deaths[-1] = 0
                    if scene is not None:
                        self.shared[shard][scene] = result
                        if len(self.shared[shard]) == sizes[shard]:
                            waiting.appendleft((shard, None))
                        continue
                    if self.bucket is not None:
                        for record in store.committed(self.root, self.manifest, [shard]):
                            upload.put_shard(self.root, self.bucket, record)
                    self.shared.pop(shard, None)
                    begun.discard(shard)
                    finished, made, failed = finished + sizes[shard], made + sizes[shard], failed + len(result)
                    if failed == made >= min(HOPELESS, self.schema.scenes):
                        scene, reason = min(result.items())
                        stops = f"all of the first {made} scenes failed, so the build stops"
                        raise CheckError(f"{stops}; scene {scene}: {reason}")
            progress.update(finished, (), failed)
        except BaseException:
            # The writers must be gone before their files are removed.
            self.engine.close(kill=True)
            for shard in begun:
                self._clear(shard)
            raise
        return sum(shard in kept for shard in wanted)

    def _job(self, shard: int) -> ShardJob:
        scenes = self.schema.scenes_of(shard)
        skip = {scene: self.given_up[scene] for scene in scenes if scene in self.given_up}
        root, fingerprint = self.root.resolve(), self.manifest.fingerprint
        made = None if self.accept_mixed else made_with()
        job = ShardJob(
            root, self.config, self.schema, fingerprint, shard, self.sample_function, skip, time.time(), made,
            self.scene_seconds,
        )  # fmt: skip
        given = self.shared.get(shard, {})
        if len(given) < len(scenes):
            return job
        return replace(job, given=given, begun=min(scenes_begun(job.root, self.schema, shard).values(), default=None))

    def _under_way(self, running: Iterable[tuple[ShardJob, int | None]]) -> tuple[int, list[int]]:
        """How many scenes of unfinished shards are made, and the scenes that workers are at."""
        made, in_work = sum(map(len, self.shared.values())), list[int]()
        for job, scene in running:
            if scene is not None:
                in_work.append(scene)
            elif job.given is None and (scenes := list(scenes_begun(self.root, self.schema, job.shard))):
                made += scenes[-1] - self.schema.scenes_of(job.shard).start
                in_work.append(scenes[-1])
        return made, in_work

    def _outcome(self, future: Future[Any], job: ShardJob, scene: int | None) -> Any:
        """The result of a finished job; None when its worker died and it must be done again."""
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
