"""What runs the jobs of a build ends with it, whenever that is."""

from __future__ import annotations

import multiprocessing
import signal
import tempfile
import time
from collections.abc import Callable
from concurrent.futures import Future
from pathlib import Path
from typing import Any

import pytest
from fake_samples import fake_sample, small_config
from here_and_now import HereAndNow, jobs_go_to
from interrupts import LATEST_S, interruptions

from datagen.building import engines
from datagen.building.build import build
from datagen.building.shard_job import ShardJob
from datagen.store import running_path


def test_ctrl_c_while_a_job_is_handed_over_leaves_no_worker(monkeypatch: pytest.MonkeyPatch) -> None:
    """It is held back while a worker starts, and comes when that is done: the worker is on no list of busy ones."""
    submit = engines._Process.submit

    def interrupted(self: engines._Process, *job: Any) -> Future[Any]:
        submit(self, *job)
        raise KeyboardInterrupt

    monkeypatch.setattr(engines._Process, "submit", interrupted)
    before = set(multiprocessing.active_children())
    with pytest.raises(KeyboardInterrupt), engines.started("local", 1, None) as engine:
        engine.submit(time.sleep, 3600)
    assert set(multiprocessing.active_children()) <= before


def test_ctrl_c_while_a_shard_is_handed_out_leaves_nothing_of_it(tmp_path: Path) -> None:
    """Its worker had begun, and nobody had noted whose future it was."""

    class Interrupted(HereAndNow):
        def submit(self, function: Callable[..., Any], *arguments: Any) -> Future[Any]:
            job: ShardJob = arguments[0]
            running_path(job.root, job.shard).write_text("0")
            raise KeyboardInterrupt

    with jobs_go_to(Interrupted()), pytest.raises(KeyboardInterrupt):
        build(small_config(), tmp_path / "set", sample_function=fake_sample, progress=False)
    assert list((tmp_path / "set/build").iterdir()) == []


@pytest.mark.parametrize(
    ("tries", "latest_s"), [(2, 2.0), pytest.param(50, LATEST_S, marks=pytest.mark.nightly)], ids=["two", "fifty"]
)
@pytest.mark.parametrize("kind", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_at_any_moment_ends_a_build_in_one_line(kind: signal.Signals, tries: int, latest_s: float) -> None:
    # Names of sockets are short, and a folder of pytest is not.
    with tempfile.TemporaryDirectory() as folder:
        counted = interruptions(kind, tries, Path(folder), kind.value, latest_s, resume=tries > 2)
    assert counted["ended"] == tries and counted["wrong"] == 0
