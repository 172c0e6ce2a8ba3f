"""Builds without processes."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from concurrent.futures import Future
from contextlib import contextmanager, nullcontext
from typing import Any

import pytest


class HereAndNow:
    """An engine that runs each job in this process."""

    capacity = 1
    deaths = ()
    shares_shards = True

    def submit(self, function: Callable[..., Any], *arguments: Any) -> Future[Any]:
        done: Future[Any] = Future()
        try:
            done.set_result(function(*arguments))
        except Exception as error:
            done.set_exception(error)
        return done

    def restore(self, say: Callable[[str], None]) -> None:
        pass

    def close(self, kill: bool) -> None:
        pass


@contextmanager
def jobs_go_to(engine: Any) -> Iterator[None]:
    """Whatever a build asks for."""
    from datagen.building import build

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(build, "running_engine", lambda *_: nullcontext(engine))
        yield


@contextmanager
def one_worker_here() -> Iterator[None]:
    """A context in which builds of one worker, and scenes made again, run in this process, for samples that no other
    process can make."""
    from datagen.building import build, engines, replay, resimulate

    @contextmanager
    def started(engine: str, workers: int, scheduler: str | None) -> Iterator[engines.Engine]:
        if engine == "local" and workers == 1:
            yield HereAndNow()
        else:
            with engines.running_engine(engine, workers, scheduler) as running:
                yield running

    with pytest.MonkeyPatch.context() as patch:
        for module in (build, replay, resimulate):
            patch.setattr(module, "running_engine", started)
        yield
