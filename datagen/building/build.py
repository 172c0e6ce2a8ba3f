"""Building a dataset: workers make shards and commit each with a record. Building again resumes.

A shard has one writer; only this process writes metadata. A sample depends on (dataset seed, scene index) alone, and
the division into shards on the configuration alone. So the bytes are the same for any number of workers, any engine,
and any number of interruptions.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from concurrent.futures import wait
from contextlib import closing, contextmanager
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from datagen import store
from datagen.building.engines import Engine, check_engine, running_engine, start_imports
from datagen.building.jobs import TICK_S, Jobs
from datagen.building.progress import Progress
from datagen.building.shard_job import LONGEST_SCENE_S, Recipe, SampleFunction, scenes_missing
from datagen.compiled import first_use
from datagen.config import DatasetConfig
from datagen.design.exposure import with_exposure_found
from datagen.errors import CheckError, InputError
from datagen.records.checks import as_given, check_callable, check_flag, check_kind, check_path, numbers_of
from datagen.store import upload
from datagen.store.environment import environment_differences, made_with
from datagen.store.location import Bucket
from datagen.store.manifest import MANIFEST, DamagedManifest
from datagen.store.summaries import clipped_lines, missed_lines, placed_anew_lines

NOISY = 0.2
"""Median relative error of a dataset's transients above which a build warns: about where the noise of the simulation
is no longer small beside the photon noise of an ordinary exposure."""


@dataclass(frozen=True)
class BuildResult:
    """The outcome of a build.

    Attributes
    ----------
    path : the dataset's folder, or its address in an object store.
    scenes : number of scenes in the dataset.
    built, kept : number of shards that this build made, and that other builds had committed, earlier or meanwhile.
    complete : whether every shard is there.
    seconds : wall-clock time of this build.
    placed_anew : a sentence on scenes whose objects were placed anew for `evidence_at_least`; "" without that key.
    growth : words on the larger dataset that a complete one grows into, as long as that is not complete.
    noisy : a warning that more than a fifth of the simulated light is noise, with a remedy; "" if it is not.
    """

    path: Path | str
    scenes: int
    built: int
    kept: int
    complete: bool
    seconds: float
    placed_anew: str = ""
    noisy: str = ""
    growth: str = ""

    def summary(self) -> str:
        """One line for people."""
        shards = "1 shard" if self.built == 1 else f"{self.built} shards"
        did = f"{shards} built in {self.seconds:.1f} s" if self.built else "nothing left to build"
        found = f", {self.kept} were there" if self.kept else ""
        missing = self.growth or "not complete yet: other shards are missing"
        state = f"complete with {self.scenes} scenes" if self.complete else missing
        more = [sentence for sentence in (self.complete and self.growth, self.placed_anew) if sentence]
        return "; ".join([f"{self.path}: {did}{found}", state, *more])


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
    for name, flag in (("progress", progress), ("accept_mixed", accept_mixed)):
        check_flag(name, flag)
    if shards is not None:
        check_kind("shards", shards, str, remedy="such as '0-99' or '3,7-9'")
    check_callable("sample_function", sample_function, "it gets configuration and scene index, and returns a sample")
    check_callable("input_check", input_check, "it gets the configuration")
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
        is_new = store.is_fresh(root)
        config = _with_exposure(root, config)
        with _first_there(root, is_new):
            plan = store.planned_manifest(root, config)
        for folder in store.build_folders(root, plan):
            store.check_writable(folder)
        wanted = parse_shards(shards, plan.schema.shards)
        there = dict[int, list[int]]()
        # The bytes of shards that are not wanted stay as they are, so nothing is gained by reading them.
        for record in store.each_committed(root, plan, hashes={*wanted}, partly=True):
            if not accept_mixed:
                _check_unmixed(root, record)
            there[record.shard] = scenes_missing(plan, record)
        if sample_function is None:
            from datagen.building.input_check import check_inputs
            from datagen.pipeline import simulate_sample

            sample_function, input_check = simulate_sample, input_check or check_inputs
        if input_check is not None:
            input_check(config)
        try:
            with running_engine(engine, workers, scheduler) as running:
                if is_simulated and first_use():
                    _compile(running, workers, sample_function, config, shown)
                with _first_there(root, is_new):
                    manifest = store.prepare(root, config)
                output.begin(manifest)
                made_by = None if accept_mixed else made_with()
                standing = store.standing_shards(root, manifest)
                recipe = Recipe(root.resolve(), config, manifest, sample_function, made_by, scene_seconds, standing)
                kept = Jobs(recipe, output, running, shown).run(wanted, there)
            dataset = store.finish(root, manifest)
            output.finish(store.each_committed(root, manifest), manifest, dataset.is_whole)
        except OSError as error:
            reason = error.strerror or error
            raise CheckError(f"{error.filename or root}: {reason}; mend that and build again to resume") from None
    _check_no_failures(dataset)
    noisy = _noise_line(config, dataset)
    if noisy:
        shown.say(noisy)
    for line in missed_lines(dataset.parameters):
        shown.say(f"window: {line}")
    for line in clipped_lines(dataset.parameters):
        shown.say(f"shadows: {line}")
    return BuildResult(
        path=output.shown, scenes=manifest.schema.scenes, built=len(wanted) - kept,
        kept=kept, complete=dataset.is_whole, seconds=time.monotonic() - began, noisy=noisy,
        placed_anew=" ".join(placed_anew_lines(dataset.parameters)),
        growth=store.growth_line(root, store.read_manifest(root)),
    )  # fmt: skip


@contextmanager
def _first_there(root: Path, is_new: bool) -> Iterator[None]:
    """A context in which `InputError` becomes `CheckError` if nothing was in the folder when this build began, and
    another build has begun there since: the call was right."""
    try:
        yield
    except InputError as error:
        if not is_new or store.is_fresh(root):
            raise
        raise CheckError(f"{error}; another build began there first, and this one wrote nothing") from None


def _compile(engine: Engine, workers: int, sample: SampleFunction, config: DatasetConfig, shown: Progress) -> None:
    """Let one worker fill the cache of compiled kernels, or each of several would compile all of them."""
    once = "once after an installation or a change of the sources"
    if workers == 1:
        shown.say(f"the first scene compiles, {once}")
        return
    # An error of this scene shows when the scene is built.
    compiling = engine.submit(sample, config, 0)
    while not wait([compiling], TICK_S).done:
        shown.doing(f"compiling, {once}")


def _check_no_failures(dataset: store.Description) -> None:
    if dataset.failures:
        scene, why = min(dataset.failures.items())
        raise CheckError(
            f"{len(dataset.failures)} of {dataset.manifest.schema.scenes} scenes could not be made, the first is "
            f"scene {scene}: {why}; all others are stored, and building again tries these anew"
        )


def _noise_line(config: DatasetConfig, dataset: store.Description) -> str:
    """A warning if the median error of the transients exceeds `NOISY`; "" if it does not, or is unknown."""
    stated = dataset.parameters.get("transient.relative_error")
    errors = np.empty(0) if stated is None or stated.is_text else stated.numbers[np.isfinite(stated.numbers)]
    if not len(errors) or (median := np.median(errors)) <= NOISY:
        return ""
    accuracy = config.transport.accuracy()
    if accuracy.samples is not None:
        remedy = f"ask for an error, transport: {{target: 0.05}}, or raise transport.samples ({accuracy.samples})"
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
    assert isinstance(config, DatasetConfig)
    if not isinstance(path, Bucket):
        check_path("path", path, "name the folder to make")
    if str(path) == "":
        raise InputError(f"{as_given('path', str(path))}: names no folder; name the one to make")
    if scene_seconds is None:
        return
    check_kind("build.scene_seconds", scene_seconds, int, float, remedy="seconds")
    if not 0 < scene_seconds <= LONGEST_SCENE_S:
        raise InputError(f"{as_given('scene_seconds', scene_seconds)}: must be > 0 and ≤ {LONGEST_SCENE_S:g}")
    if engine != "local":
        raise InputError(
            f"{as_given('scene_seconds', scene_seconds)}: only local workers have such a limit; leave it out"
        )


def _check_unmixed(root: Path, record: store.ShardRecord) -> None:
    """Refuse to resume if a shard was made with versions, or on an architecture, that may give other bytes."""
    for difference in environment_differences([record.made_by, made_with()]):
        raise InputError(
            f"output {root}: shard {record.shard} and this machine differ in {difference}; the same bytes are "
            "promised for the same versions (constraints.txt) on the same kind of processor: use those, "
            f"name another folder, or accept it with {as_given('accept_mixed', True)}"
        )


def parse_shards(text: str | None, shards: int) -> list[int]:
    """Shard numbers, ascending, of a text such as `"0-99"` or `"3,7-9"`; all of them for None."""
    if text is None:
        return list(range(shards))
    check_kind("shards", text, str, remedy="such as '0-99'")
    return numbers_of("shards", text, shards)
