"""Compiled kernels: `compiled` is `numba.njit` with the options that all kernels of this package share."""

from __future__ import annotations

import gc
from collections.abc import Callable
from typing import Any, TypeVar, cast

import numba
from numba.core import event
from numba.core.dispatcher import Dispatcher

F = TypeVar("F", bound=Callable[..., Any])


def compiled(**options: Any) -> Callable[[F], Dispatcher[F]]:
    """A decorator that compiles a function with `numba.njit`, caches it on disk, and divides by zero as numpy does.

    Without an error model of its own a kernel would take over that of whichever kernel called it first. A wrapper for
    callers in C is left out: nobody calls kernels from there, and it takes a tenth of the time of compiling.
    """
    # Its annotations lack what leaves the wrapper out.
    njit: Any = numba.njit
    own = {"cache": True, "error_model": "numpy", "no_cfunc_wrapper": True}
    return cast("Callable[[F], Dispatcher[F]]", njit(**own | options))


class _WithoutCollector(event.Listener):
    """Pauses Python's collector of circular garbage while a kernel is compiled: the compiler makes many objects and
    drops few, and looking through them all takes a tenth of the time of compiling."""

    depth = 0
    collecting = False

    def on_start(self, event: Any) -> None:
        if self.depth == 0:
            self.collecting = gc.isenabled()
        self.depth += 1
        gc.disable()

    def on_end(self, event: Any) -> None:
        self.depth -= 1
        if self.depth == 0 and self.collecting:
            gc.enable()


event.register("numba:compile", _WithoutCollector())  # type: ignore[no-untyped-call]


@compiled()
def _least(x):  # type: ignore[no-untyped-def]
    return x


def first_use() -> bool:
    """Whether no process has compiled kernels since the installation: not even the least one is cached."""
    _least(0)
    return bool(_least.stats.cache_misses)
