"""Compiled kernels: `compiled` is `numba.njit` with the options that all kernels of this package share, `subroutine`
the same for functions that only kernels call."""

from __future__ import annotations

import gc
from collections.abc import Callable
from typing import Any, NoReturn, TypeVar, cast

import numba
from numba.core import event
from numba.core.dispatcher import Dispatcher
from numba.core.registry import CPUDispatcher

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


class _Subroutine(CPUDispatcher):
    """A compiled function that Python cannot call: without its wrapper the process would crash."""

    def __call__(self, *args: object, **named: object) -> NoReturn:
        """Raise `TypeError`."""
        raise TypeError(f"only compiled functions can call {self.py_func.__name__}; decorate it with `compiled`")


def subroutine(**options: Any) -> Callable[[F], Dispatcher[F]]:
    """`compiled` for functions that only compiled functions call. They have no wrapper for callers in Python, which
    saves a sixth of the time of compiling; called from Python they raise `TypeError`."""
    decorate = compiled(no_cpython_wrapper=True, **options)

    def decorated(function: F) -> Dispatcher[F]:
        dispatcher = decorate(function)
        # numba has no option for the class of a dispatcher. With NUMBA_DISABLE_JIT the function comes back as it is.
        if isinstance(dispatcher, CPUDispatcher):
            dispatcher.__class__ = _Subroutine
        return dispatcher

    return decorated


class _NoCollection(event.Listener):
    """Stops the garbage collector while kernels are compiled: numba's trees live until a kernel is done, and to look
    through them again and again takes a tenth of the time of compiling."""

    depth, was_enabled = 0, False

    def on_start(self, event: event.Event) -> None:
        """Stop the collector where the first of nested compilations begins."""
        if self.depth == 0:
            self.was_enabled = gc.isenabled()
            gc.disable()
        self.depth += 1

    def on_end(self, event: event.Event) -> None:
        """Start the collector again, where it ran before, when the last of nested compilations ends."""
        self.depth -= 1
        if self.depth == 0 and self.was_enabled:
            gc.enable()


event.register("numba:compile", _NoCollection())  # type: ignore[no-untyped-call]


@compiled()
def _smallest_kernel(x):  # type: ignore[no-untyped-def]
    return x


def first_use() -> bool:
    """Whether no process has compiled kernels since the installation: not even the smallest one is cached."""
    _smallest_kernel(0)
    return bool(_smallest_kernel.stats.cache_misses)
