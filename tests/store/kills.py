"""Ways to kill a build: between any two steps of writing, or one of its processes at a random moment."""

from __future__ import annotations

import contextlib
import itertools
import os
import random
import signal
import subprocess
import sys
import time
import warnings
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from fake_samples import fake_sample, small_config

from datagen.config import DatasetConfig
from datagen.records import Sample

STEPS = ("fsync", "replace", "rename", "unlink", "mkdir", "rmdir", "write", "link")
"""Calls of the operating system that change files or make changes permanent."""
PIDS = "DATAGEN_TEST_PIDS"
"""Variable that names the folder in which workers leave their numbers."""
KILLED = ("worker", "parent", "group", "dask worker")
PATIENCE_S = 300.0
CHILD = """
import os, sys
from kills import many_shards, tells_pid
from datagen.building.build import build
from datagen.errors import CheckError
if __name__ == "__main__":
    os.environ["DASK_DISTRIBUTED__WORKER__MULTIPROCESSING_METHOD"] = "forkserver"
    os.environ["DASK_DISTRIBUTED__LOGGING__DISTRIBUTED"] = "critical"
    try:
        build(many_shards(), sys.argv[1], 2, engine=sys.argv[2], sample_function=tells_pid, progress=False)
    except CheckError as error:
        sys.exit(f"datagen: {error}")
"""


def many_shards() -> DatasetConfig:
    """48 scenes of a millisecond, each a shard, so that kills meet every stage of a commit."""
    return small_config(scenes=48, store={"fields": ["histogram", "depth"], "scenes_per_shard": 1})


def tells_pid(config: DatasetConfig, index: int) -> Sample:
    """A sample of a worker that leaves its process id, so that it can be killed."""
    Path(os.environ[PIDS], str(os.getpid())).touch()
    return fake_sample(config, index)


def in_a_child(call: Callable[[], object]) -> int:
    """The exit status of a forked process that runs `call` and ends without any cleanup."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DeprecationWarning)
        child = os.fork()
    if child == 0:
        try:
            call()
            os._exit(0)
        finally:
            os._exit(1)
    return os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])


@contextlib.contextmanager
def before_each_step(do: Callable[[], None]) -> Iterator[None]:
    """While `do` is called before each of `STEPS`."""

    def watched(change: Callable[..., Any]) -> Callable[..., Any]:
        def changed(*args: Any, **options: Any) -> Any:
            do()
            return change(*args, **options)

        return changed

    with pytest.MonkeyPatch.context() as patch:
        for name in STEPS:
            patch.setattr(os, name, watched(getattr(os, name)))
        yield


def steps_of(call: Callable[[], object]) -> int:
    """How many steps `call` takes."""
    steps: list[None] = []
    with before_each_step(lambda: steps.append(None)):
        call()
    return len(steps)


def killed_at(step: int, call: Callable[[], object]) -> bool:
    """Whether `call` reaches a step. It runs in a process that ends at that step."""

    def dying() -> None:
        left = itertools.repeat(None, step)
        with before_each_step(lambda: os._exit(9) if next(left, 9) else None):
            call()

    status = in_a_child(dying)
    assert status in (0, 9), f"the build ended with {status} before step {step}"
    return status == 9


class RunningBuild:
    """A build in processes of its own that can be killed."""

    def __init__(self, root: Path, engine: str) -> None:
        self.root, self._pids = root, root.with_name(f"{root.name}.pids")
        self._pids.mkdir(parents=True)
        here = Path(__file__).parent
        path = os.pathsep.join([str(here), str(here.parent), *filter(None, sys.path)])
        self.process = subprocess.Popen(
            [sys.executable, "-c", CHILD, str(root), engine],
            env=os.environ | {"PYTHONPATH": path, PIDS: str(self._pids)},
            stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, start_new_session=True,
        )  # fmt: skip

    def workers(self) -> list[int]:
        """Process ids of living workers that have made a scene."""
        return [pid for pid in (int(path.name) for path in self._pids.iterdir()) if Path(f"/proc/{pid}").is_dir()]

    def running(self) -> bool:
        return self.process.poll() is None

    def reaches(self, shards: int) -> bool:
        """Wait until so many more shards are committed; False where the build ended first."""
        wanted = len(self.committed()) + shards
        deadline = time.monotonic() + PATIENCE_S
        while self.running() and len(self.committed()) < wanted:
            assert time.monotonic() < deadline, "the build did not get going"
            time.sleep(0.001)
        return self.running()

    def committed(self) -> list[Path]:
        return list(self.root.glob("build/shard-*.json"))

    def kill(self, what: str, rng: random.Random) -> bool:
        """Kill a worker, the parent alone, or every process; False where nothing was there to be killed."""
        time.sleep(rng.uniform(0.0, 0.03))
        alive = self.workers()
        if not self.running() or not alive:
            return False
        with contextlib.suppress(ProcessLookupError):
            if what == "parent":
                os.kill(self.process.pid, signal.SIGKILL)
            elif what == "group":
                os.killpg(self.process.pid, signal.SIGKILL)
            else:
                os.kill(rng.choice(alive), signal.SIGKILL)
            return True
        return False

    def ended(self) -> tuple[int, str]:
        """Exit status and what was said, once all its processes are gone."""
        _, said = self.process.communicate(timeout=PATIENCE_S)
        deadline = time.monotonic() + PATIENCE_S
        while self.workers():
            assert time.monotonic() < deadline, "workers outlive their build"
            time.sleep(0.01)
        return self.process.returncode, said.decode(errors="replace")


def killed_builds(what: str, kills: int, folder: Path, rng: random.Random) -> Iterator[tuple[int, RunningBuild]]:
    """Builds of which processes were killed, and how many; in all as many as asked for.

    Workers are replaced, and several can be killed in one build; a parent only once.
    """
    number = done = 0
    while done < kills:
        running = RunningBuild(folder / f"{what} {number}", "dask" if what == "dask worker" else "local")
        number += 1
        in_this, most = 0, min(kills - done, 3) if what.endswith("worker") else 1
        while in_this < most and running.reaches(rng.randint(1, 12)):
            in_this += running.kill(what, rng)
        if in_this:
            done += in_this
            yield in_this, running
        else:
            running.ended()
