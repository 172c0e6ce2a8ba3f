"""Worker processes end with their build, whenever a signal ends it."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import tempfile
import threading
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


def test_ctrl_c_while_a_shard_is_handed_out_leaves_nothing_of_it(tmp_path: Path) -> None:
    """Ctrl-C comes when the worker has begun and the build has not yet noted the job's future."""

    class Interrupted(HereAndNow):
        def submit(self, function: Callable[..., Any], *arguments: Any) -> Future[Any]:
            job: ShardJob = arguments[0]
            running_path(job.root, job.shard).write_text("0")
            raise KeyboardInterrupt

    with jobs_go_to(Interrupted()), pytest.raises(KeyboardInterrupt):
        build(small_config(), tmp_path / "set", sample_function=fake_sample, progress=False)
    assert list((tmp_path / "set/build").iterdir()) == []


@pytest.mark.parametrize(
    ("tries", "latest_s"), [(1, 2.0), pytest.param(50, LATEST_S, marks=pytest.mark.nightly)], ids=["one", "fifty"]
)
@pytest.mark.parametrize("kind", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_at_any_moment_ends_a_build_in_one_line(kind: signal.Signals, tries: int, latest_s: float) -> None:
    # Names of sockets are short, and a folder of pytest is not.
    with tempfile.TemporaryDirectory() as folder:
        counted = interruptions(kind, tries, Path(folder), kind.value, latest_s, resume=tries > 1)
    assert counted["ended"] == tries and counted["wrong"] == 0


def test_a_signal_that_another_thread_takes_waits_until_a_worker_is_started() -> None:
    """Python runs the handler in the main thread whichever thread took the signal, whatever the main one's mask."""
    begun, reached = threading.Event(), False

    def interrupt_oneself() -> None:
        begun.wait()
        signal.pthread_kill(threading.get_ident(), signal.SIGINT)

    taker = threading.Thread(target=interrupt_oneself, daemon=True)
    taker.start()
    # A shell starts what it puts into the background with this signal ignored.
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    try:
        with pytest.raises(KeyboardInterrupt), engines._signals_deferred():
            begun.set()
            taker.join()
            reached = True
    finally:
        signal.signal(signal.SIGINT, before)
    assert reached


def test_an_error_of_a_job_names_the_line_of_the_worker() -> None:
    with engines.started("local", 1, None) as running:
        error = running.submit(int, "two").exception()
    assert isinstance(error, ValueError) and "engines.py" in "".join(error.__notes__)


def test_a_temporary_folder_with_a_long_path_is_refused_with_the_remedy(tmp_path: Path) -> None:
    folder = tmp_path / ("long" * 30)
    folder.mkdir()
    code = "from datagen.building.engines import started\nwith started('local', 1, None) as e: e.submit(abs, 1)"
    env = os.environ | {"TMPDIR": str(folder), "PYTHONPATH": os.pathsep.join(filter(None, sys.path))}
    done = subprocess.run([sys.executable, "-c", code], env=env, capture_output=True, text=True, check=False)
    assert f"InputError: TMPDIR: workers cannot be started, since their socket lies in {folder}" in done.stderr
    assert "set TMPDIR to a shorter path" in done.stderr
