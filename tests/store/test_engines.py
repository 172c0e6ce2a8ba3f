"""What runs the jobs of a build ends with it, whenever that is."""

from __future__ import annotations

import multiprocessing
import time
from concurrent.futures import Future
from typing import Any

import pytest

from datagen.building import engines


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
