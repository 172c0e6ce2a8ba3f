"""Compiled kernels: `compiled` is `numba.njit` with the options that all kernels of this package share."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeVar, cast

import numba
from numba.core.dispatcher import Dispatcher

F = TypeVar("F", bound=Callable[..., Any])


def compiled(**options: Any) -> Callable[[F], Dispatcher[F]]:
    """A decorator that compiles a function with `numba.njit`, caches it on disk, and divides by zero as numpy does.

    Without an error model of its own a kernel would take over that of whichever kernel called it first. A wrapper for
    callers in C is left out: nobody calls kernels from there, and it takes a tenth of the time of compiling.
    """
    # numba's type annotations do not know `no_cfunc_wrapper`.
    njit: Any = numba.njit
    shared = {"cache": True, "error_model": "numpy", "no_cfunc_wrapper": True}
    return cast("Callable[[F], Dispatcher[F]]", njit(**shared | options))


@compiled()
def _smallest_kernel(x):  # type: ignore[no-untyped-def]
    return x


def first_use() -> bool:
    """Whether no process has compiled kernels since the installation: not even the smallest one is cached."""
    _smallest_kernel(0)
    return bool(_smallest_kernel.stats.cache_misses)
