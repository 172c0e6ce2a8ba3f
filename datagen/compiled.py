"""Compiled kernels: `compiled` is `numba.njit` with the options that all kernels of this package share.

numba caches a kernel on disk and sees when its own file changes, not when a function that it calls from another file
does: the kernel would go on computing what it computed before. So the files of the cache carry a digest of all
sources in their names, and after any change of the sources kernels are compiled anew.
"""

from __future__ import annotations

import os
import re
from collections.abc import Callable
from contextlib import suppress
from functools import cache
from hashlib import sha256
from pathlib import Path
from typing import Any, TypeVar, cast

import numba
from numba.core.caching import CompileResultCacheImpl, FunctionCache
from numba.core.dispatcher import Dispatcher

F = TypeVar("F", bound=Callable[..., Any])


def digest_of_sources(root: Path) -> str:
    """16 hex digits that another text or name of any Python file of the two packages in `root` changes.

    Of contents, as times prove nothing: installers may set the same for all versions.
    """
    digest = sha256()
    for package in ("datagen", "scene_library"):
        for folder, inner, files in os.walk(root / package):
            # Caches hold a thousand files and no source.
            inner[:] = sorted(set(inner) - {"__pycache__"})
            for path in (Path(folder, name) for name in sorted(files) if name.endswith(".py")):
                digest.update(path.relative_to(root).as_posix().encode())
                digest.update(sha256(path.read_bytes()).digest())
    return digest.hexdigest()[:16]


ROOT = Path(__file__).parents[1]
SOURCES = digest_of_sources(ROOT)
_CACHED = re.compile(r"-([0-9a-f]{16})(\.\d+)?\.nb[ic]")
"""End of the name of a file of the cache: the digest, the number of the overload, numba's suffix."""


class _NamedBySources(CompileResultCacheImpl):
    """What numba stores of a kernel, under a name that ends with the digest of the sources.

    A digest in numba's stamp of the source, inside of the file, would not do: processes of two versions, such as a
    long build and one begun after an upgrade, would then read and replace files of the same name.
    """

    def get_filename_base(self, fullname: str, abiflags: str) -> str:
        """Beginning of the names of a kernel's files."""
        name = super().get_filename_base(fullname, abiflags)  # type: ignore[no-untyped-call]
        return f"{name}-{SOURCES}"


class _Cache(FunctionCache):
    """numba's cache of one function, beside its source, or in the user's cache folder where that is not writable."""

    _impl_class = _NamedBySources

    def save_overload(self, sig: object, data: object) -> None:
        """Store what was compiled for a signature, unless the sources have changed since this process began: some may
        have been imported after the change."""
        if digest_of_sources(ROOT) != SOURCES:
            return
        _drop_others(self.cache_path)
        super().save_overload(sig, data)  # type: ignore[no-untyped-call]


@cache
def _drop_others(folder: str) -> None:
    """Delete the kernels in a folder that were compiled from other sources, once in a process.

    numba copes with files that vanish: a process that still runs such sources compiles again.
    """
    for path in Path(folder).iterdir():
        named = _CACHED.search(path.name)
        if named and named[1] != SOURCES:
            # Another process may be quicker.
            with suppress(OSError):
                path.unlink()


def compiled(
    *, allocates: bool = True, inline: str = "never", forceinline: bool = False, nogil: bool = False
) -> Callable[[F], Dispatcher[F]]:
    """A decorator that compiles a function with `numba.njit`, caches it on disk, and divides by zero as numpy does.

    allocates : whether the function makes arrays. For one that does not, numba counts no references to those that it
        is given, which takes half of the time of small functions that are handed records of arrays.
    inline, forceinline, nogil : as those of `numba.njit`.

    `fastmath` is no option: each kernel brings copies of the functions that it calls, and which of them runs hangs on
    the order in which kernels were compiled. Where sums may be taken in another order, copies round differently, and
    bytes hang on what ran before (8 % of the time of three bounces).

    Without an error model of its own a kernel would take over that of whichever kernel called it first. A wrapper for
    callers in C is left out: nobody calls kernels from there, and it takes a tenth of the time of compiling.
    """
    # numba's type annotations do not know `no_cfunc_wrapper`.
    njit: Any = numba.njit
    options = {"error_model": "numpy", "no_cfunc_wrapper": True, "_nrt": allocates}
    options |= {"inline": inline, "forceinline": forceinline, "nogil": nogil}

    def decorated(function: F) -> Dispatcher[F]:
        kernel: Any = njit(**options)(function)
        # As `cache=True` does, with our names. With NUMBA_DISABLE_JIT the function comes back as it is.
        if isinstance(kernel, Dispatcher):
            kernel._cache = _Cache(function)  # type: ignore[attr-defined, no-untyped-call]
        return cast("Dispatcher[F]", kernel)

    return decorated


@compiled()
def _smallest_kernel(x):  # type: ignore[no-untyped-def]
    return x


def first_use() -> bool:
    """Whether no process has compiled kernels from these sources: not even the smallest one is cached."""
    _smallest_kernel(0)
    return bool(_smallest_kernel.stats.cache_misses)
