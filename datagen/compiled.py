"""Compiled kernels: `compiled` makes a function ready for all that call it, and its cache on disk is kept true to its
sources.

numba recompiles a cached function when its own file changes, but not when a function it calls from another file does.
So each package of kernels drops, when it is imported, caches older than the newest of its sources: the first call
of a kernel, which loads them, comes later. Nor does it know of other processes that are compiling the same: of those
that start together one compiles a kernel, and the others read it from the cache.
"""

from __future__ import annotations

import gc
import os
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from functools import cached_property
from pathlib import Path
from types import FunctionType
from typing import Any, TypeVar, cast

from numba import types
from numba.core import config
from numba.core.compiler_lock import global_compiler_lock
from numba.core.dispatcher import Dispatcher
from numba.core.registry import CPUDispatcher
from numba.core.typing.templates import make_concrete_template

from datagen.locks import locked, unlock

F = TypeVar("F", bound=Callable[..., Any])

PATIENCE_S, LOOK_S = 120.0, 0.02
"""How long a process waits for another one to compile a kernel before it does so itself, and how often it looks."""


class InnerKernel(CPUDispatcher):
    """A function that kernels call."""

    def compile(self, sig: Any) -> Any:
        """Compile for a list of types, or load what was."""
        # The lock of this process's threads first: they wait for one another in the same order.
        with global_compiler_lock, _alone(self.py_func.__code__.co_filename):
            return super().compile(sig)


class Kernel(InnerKernel):
    """A function that Python and other kernels call. For each of them it is compiled apart, and only where called:
    Python needs a wrapper that takes its objects apart, of which kernels have no use. For kernels it is compiled once
    for each list of types, not once more for each number that stands in a call: of `corner(a, f, 0)` and
    `corner(a, f, 1)` the optimiser makes two where that pays.
    """

    def compile(self, sig: Any) -> Any:
        """A compiler makes many objects and leaves few: looking for circles among them is a twelfth of its time."""
        collecting = gc.isenabled()
        gc.disable()
        try:
            return super().compile(sig)
        finally:
            if collecting:
                gc.enable()

    def get_call_template(self, args: Any, kws: Any) -> Any:
        """What numba asks where another kernel calls this one."""
        signature, args = self.fold_argument_types(args, kws)
        args = tuple(map(types.unliteral, args))
        twin, name = self.called_by_kernels, self.py_func.__name__
        twin.compile(args)
        template: Any = make_concrete_template
        return template(name, key=name, signatures=[twin.overloads[args].signature]), signature, args, {}

    def get_overload(self, sig: Any) -> Any:
        """What numba asks next: the function that the other kernel is linked with."""
        return self.called_by_kernels.get_overload(sig)

    @cached_property
    def called_by_kernels(self) -> Any:
        """The same function for kernels to call. Calling it from Python is an error that ends the process."""
        function = self.py_func
        twin = FunctionType(
            function.__code__, function.__globals__, function.__name__, function.__defaults__, function.__closure__
        )
        # Its cache is a file of its own: numba names the file so.
        twin.__qualname__ = f"{function.__qualname__}.called_by_kernels"
        return _compiler(twin, InnerKernel, {**self.targetoptions, "no_cpython_wrapper": True})


_files: set[str] = set()
"""Whose kernels this process is compiling, one within another."""


@contextmanager
def _alone(source: str) -> Iterator[None]:
    """Wait until no other process compiles a kernel of this file. Kernels of several files are compiled one within
    another only as the files import each other, which is never in a circle: no two processes wait for each other."""
    if source in _files:
        yield
        return
    try:
        handle = os.open(source, os.O_RDONLY)
    except OSError:
        yield
        return
    _files.add(source)
    try:
        until = time.monotonic() + PATIENCE_S
        while not locked(handle, otherwise=True) and time.monotonic() < until:
            time.sleep(LOOK_S)
        yield
    finally:
        _files.remove(source)
        unlock(handle)
        os.close(handle)


def compiled(**options: Any) -> Callable[[F], Dispatcher[F]]:
    """Compile a function with `numba.njit`'s options, and cache it. Division by zero is numpy's, unless they say
    otherwise: where nothing is said a kernel would take that over from whichever kernel called it first.
    """

    def decorated(function: F) -> Dispatcher[F]:
        if config.DISABLE_JIT:  # type: ignore[attr-defined]
            return cast("Dispatcher[F]", function)
        own = {"nopython": True, "boundscheck": None, "error_model": "numpy"}
        return cast("Dispatcher[F]", _compiler(function, Kernel, own | options))

    return decorated


def _compiler(function: Any, kind: type[InnerKernel], options: dict[str, Any]) -> InnerKernel:
    compiler = kind(function, targetoptions={**options, "no_cfunc_wrapper": True})
    compiler.enable_caching()
    return compiler


def drop_stale_kernels(package: Path, *called: Path) -> int:
    """Delete a package's cache files of numba (`.nbi`, `.nbc`) that are older than its newest source, or than that of
    the packages whose kernels it calls; return how many.

    Where they cannot be deleted (a read-only installation) nothing is done: such sources do not change either.
    """
    newest = max(map(_newest_source, (package, *called)))
    dropped = 0
    for cache in [*package.rglob("*.nbi"), *package.rglob("*.nbc")]:
        # Another process may be quicker, or the folder read-only.
        with suppress(OSError):
            if cache.stat().st_mtime < newest:
                cache.unlink()
                dropped += 1
    return dropped


def _newest_source(package: Path) -> float:
    return max((path.stat().st_mtime for path in package.rglob("*.py")), default=0.0)
