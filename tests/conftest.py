"""How the tests run: one thread each, the long files first, and builds of one worker in the test's own process."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from concurrent.futures import Future
from contextlib import contextmanager
from typing import Any

import pytest

# Test processes are the parallelism, as workers are in a build; read when numpy is loaded, which is later.
for _library in ("OMP", "OPENBLAS", "MKL"):
    os.environ.setdefault(f"{_library}_NUM_THREADS", "1")

FIRST = (
    "equivalence/test_secondary.py",
    "detector/test_laws.py",
    "detector/test_samplers.py",
    "detector/test_numerics.py",
    "detector/test_interface.py",
    "physics/test_primary_truths.py",
    "effects/test_switchboard.py",
    "physics/test_accuracy_target.py",
    "equivalence/test_clear_sight.py",
    "physics/test_all_bounces.py",
    "report/test_show_pictures.py",
    "store/test_build.py",
    "capture/test_configs_built.py",
    "report/test_datasets_shown.py",
    "report/test_reproduce.py",
)
"""A file goes to one process as a whole. While the first one compiles the transport's kernels, the second compiles
those of the detector, and not both the same; and a long file begun last would leave the other process idle.
"""


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    def rank(item: pytest.Item) -> int:
        file = item.nodeid.partition("::")[0].removeprefix("tests/")
        return FIRST.index(file) if file in FIRST else len(FIRST)

    items.sort(key=rank)


class HereAndNow:
    """An engine that runs each job in this process."""

    capacity = 1
    deaths = ()

    def submit(self, function: Callable[..., Any], *arguments: Any) -> Future[Any]:
        done: Future[Any] = Future()
        try:
            done.set_result(function(*arguments))
        except Exception as error:
            done.set_exception(error)
        return done

    def close(self, kill: bool) -> None:
        pass


@pytest.fixture(scope="session", autouse=True)
def one_worker_builds_here() -> Iterator[None]:
    """Starting a process takes longer than most builds of the tests. Two workers are two processes, and builds by
    another process are as they always are: both are held to the same bytes.
    """
    from datagen.building import build, engines

    @contextmanager
    def started(engine: str, workers: int, scheduler: str | None) -> Iterator[engines.Engine]:
        if engine == "local" and workers == 1:
            yield HereAndNow()
        else:
            with engines.started(engine, workers, scheduler) as running:
                yield running

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(build, "started", started)
        yield
