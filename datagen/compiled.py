"""Compiled kernels: `compiled` is `numba.njit` with the options that all kernels of this package share.

numba caches a kernel on disk and sees when its own file changes, not when a function that it calls from another file
does: the kernel would go on computing what it computed before. So the files of the cache carry a digest of all
sources in their names, and after any change of the sources kernels are compiled anew.

The cache lies beside the sources, in the user's cache folder where that cannot be written, in a private folder below
the temporary one where that cannot be written either, and nowhere if nothing can be written.
"""

from __future__ import annotations

import errno
import os
import re
import stat
import tempfile
from collections.abc import Callable
from contextlib import suppress
from functools import cache
from hashlib import sha256
from pathlib import Path
from typing import Any, TypeVar, cast
from warnings import warn

import numba
from numba.core import caching
from numba.core.caching import CompileResultCacheImpl, FunctionCache
from numba.core.dispatcher import Dispatcher
from numba.misc.appdirs import AppDirs

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


SAID = "DATAGEN_SAID_OF_CACHE"
"""Environment variable that is set once a process has warned about the cache: the processes that it starts inherit
the variable, and do not repeat the line."""
_REMEDY = "let the environment variable NUMBA_CACHE_DIR name a folder that you may write to"


class CacheWarning(UserWarning):
    """Compiled kernels are kept in a temporary folder, or not at all."""


def _say(line: str) -> None:
    """Warn about the cache, once."""
    if SAID not in os.environ:
        os.environ[SAID] = "1"
        warn(line, CacheWarning, stacklevel=3)


def _make_private(folder: Path) -> None:
    """Make a folder that only this user may enter, if it is not there. Raises `OSError` if others may have files in
    it: numba unpickles what it finds in a cache, and so executes it."""
    with suppress(FileExistsError):
        folder.mkdir(0o700)
    own, above = folder.lstat(), folder.parent.stat()
    is_private = stat.S_ISDIR(own.st_mode) and own.st_uid == os.geteuid() and not own.st_mode & 0o077
    # Unless a folder that all may write to is sticky, others may rename what lies in it.
    if not is_private or above.st_mode & (stat.S_IWOTH | stat.S_ISVTX) == stat.S_IWOTH:
        raise PermissionError(errno.EACCES, "other users may write there", str(folder))


class _InTemporaryFolder(caching._SourceFileBackedLocatorMixin, caching._CacheLocator):
    """The place of a function's cache in a private folder below the temporary one. Processes of one user find the
    same folder, so that workers share what one of them compiled."""

    def __init__(self, function: Callable[..., Any], file: str) -> None:
        self._py_file, self._lineno = file, function.__code__.co_firstlineno

    def get_cache_path(self) -> str:
        """The folder. Raises `OSError` if there is no temporary folder."""
        return str(self._private() / self.get_suitable_cache_subpath(self._py_file))  # type: ignore[no-untyped-call]

    def ensure_cache_path(self) -> None:
        """Make the folder. Raises `OSError` if it cannot be made, or is not private."""
        _make_private(self._private())
        super().ensure_cache_path()  # type: ignore[no-untyped-call]

    @staticmethod
    def _private() -> Path:
        return Path(tempfile.gettempdir(), f"datagen-{os.geteuid()}")

    @classmethod
    def say_stored(cls) -> None:
        """Warn that a kernel was stored there."""
        _say(
            f"compiled kernels are kept in {cls._private()}, as neither {ROOT} nor a cache folder of this user "
            f"can be written; to keep them elsewhere {_REMEDY}"
        )


def _places() -> list[Any]:
    """Where a cache may lie, the best place first: numba's own places, and the temporary folder."""
    # Without a home numba would make a folder of the name ~ wherever a process happens to start, and trust what is
    # there.
    has_home = os.path.isabs(AppDirs("numba", False).user_cache_dir)  # type: ignore[no-untyped-call]
    places = [
        place for place in CompileResultCacheImpl._locator_classes if has_home or "UserWide" not in place.__name__
    ]
    return [*places, _InTemporaryFolder]


class _NamedBySources(CompileResultCacheImpl):
    """What numba stores of a kernel, under a name that ends with the digest of the sources.

    A digest in numba's stamp of the source, inside of the file, would not do: processes of two versions, such as a
    long build and one begun after an upgrade, would then read and replace files of the same name.
    """

    _locator_classes = _places()

    def get_filename_base(self, fullname: str, abiflags: str) -> str:
        """Beginning of the names of a kernel's files."""
        name = super().get_filename_base(fullname, abiflags)  # type: ignore[no-untyped-call]
        return f"{name}-{SOURCES}"


class _Cache(FunctionCache):
    """numba's cache of one function. What cannot be read there is compiled, what cannot be stored is not stored."""

    _impl_class = _NamedBySources

    def load_overload(self, sig: object, target_context: object) -> object:
        """What was compiled for a signature; None if it is not there, or damaged."""
        try:
            return super().load_overload(sig, target_context)  # type: ignore[no-untyped-call]
        except OSError:
            return None
        except Exception:
            # A file that a power cut or a full disk left: pickle and LLVM have errors of any kind for it.
            with suppress(OSError):
                self.flush()  # type: ignore[no-untyped-call]
            return None

    def save_overload(self, sig: object, data: object) -> None:
        """Store what was compiled for a signature, unless the sources have changed since this process began: some may
        have been imported after the change."""
        if digest_of_sources(ROOT) != SOURCES:
            return
        try:
            _drop_others(self.cache_path)
            super().save_overload(sig, data)  # type: ignore[no-untyped-call]
        except OSError as error:
            _say_not_stored(f"{self.cache_path}: {error.strerror or error}")
        else:
            # A folder that can be made may be on a full disk.
            if isinstance(self._impl.locator, _InTemporaryFolder):
                self._impl.locator.say_stored()


def _say_not_stored(why: str) -> None:
    _say(f"compiled kernels cannot be stored ({why}), so each process compiles them anew, for a minute; {_REMEDY}")


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
            try:
                kernel._cache = _Cache(function)  # type: ignore[attr-defined, no-untyped-call]
            except RuntimeError:
                _say_not_stored("no folder for them can be written")
        return cast("Dispatcher[F]", kernel)

    return decorated


@compiled()
def _smallest_kernel(x):  # type: ignore[no-untyped-def]
    return x


def first_use() -> bool:
    """Whether no process has compiled kernels from these sources: not even the smallest one is cached. False if
    nothing can be cached, as no process then compiles for others."""
    _smallest_kernel(0)
    return bool(_smallest_kernel.stats.cache_misses and _smallest_kernel.stats.cache_path)
