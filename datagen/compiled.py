"""Compiled kernels: `compiled` is `numba.njit` with the options that all kernels of this package share.

numba caches a kernel on disk and sees when its own file changes, not when a function that it calls from another file
does: the kernel would go on computing what it computed before. So the files of the cache carry a digest of all
sources in their names, and after any change of the sources kernels are compiled anew.

A kernel that other kernels call is not compiled on its own: they take over its code, and it is optimised and made
machine code as a part of them. Only what Python calls is a function of its own, and is cached.

The cache lies beside the sources, in the user's cache folder where that cannot be written, in a private folder below
the temporary one where that cannot be written either, and nowhere if nothing can be written.
"""

from __future__ import annotations

import errno
import gc
import os
import re
import stat
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from functools import cache
from hashlib import sha256
from pathlib import Path
from typing import Any, TypeVar, cast
from warnings import warn

from llvmlite.binding import Linkage
from numba.core import caching, config, types
from numba.core.caching import CompileResultCacheImpl, FunctionCache
from numba.core.codegen import JITCodeLibrary
from numba.core.compiler import Flags, compile_extra
from numba.core.compiler_lock import global_compiler_lock
from numba.core.dispatcher import Dispatcher
from numba.core.registry import CPUDispatcher
from numba.core.sigutils import normalize_signature
from numba.core.typing.templates import make_concrete_template
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
        return str(self._private() / self.get_suitable_cache_subpath(self._py_file))

    def ensure_cache_path(self) -> None:
        """Make the folder. Raises `OSError` if it cannot be made, or is not private."""
        _make_private(self._private())
        super().ensure_cache_path()

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
    has_home = os.path.isabs(AppDirs("numba", False).user_cache_dir)
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
        name = super().get_filename_base(fullname, abiflags)
        return f"{name}-{SOURCES}"


class _Cache(FunctionCache):
    """numba's cache of one function. What cannot be read there is compiled, what cannot be stored is not stored."""

    _impl_class = _NamedBySources

    def load_overload(self, sig: object, target_context: object) -> object:
        """What was compiled for a signature; None if it is not there, or damaged."""
        try:
            return super().load_overload(sig, target_context)
        except OSError:
            return None
        except Exception:
            # A file that a power cut or a full disk left: pickle and LLVM have errors of any kind for it.
            with suppress(OSError):
                self.flush()
            return None

    def save_overload(self, sig: object, data: object) -> None:
        """Store what was compiled for a signature, unless the sources have changed since this process began: some may
        have been imported after the change."""
        if digest_of_sources(ROOT) != SOURCES:
            return
        try:
            _drop_others(self.cache_path)
            super().save_overload(sig, data)
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


@contextmanager
def _no_collection_of_garbage() -> Iterator[None]:
    """A compiler makes millions of objects and keeps them: looking through them for garbage, again and again, would
    take an eighth of its time, and once more at the end, if they did not count as old."""
    collects = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if collects:
            # What others have frozen stays so.
            if not gc.get_freeze_count():
                gc.freeze()
                gc.unfreeze()
            gc.enable()


class _InnerCode(JITCodeLibrary):
    """The code of a kernel for kernels that call it: as it was written, with that of all kernels that it calls."""

    def _optimize_functions(self, ll_module: Any) -> None:
        ll_module.data_layout = self._codegen._data_layout

    def finalize(self) -> None:
        """Take over the code of the kernels that are called."""
        for library in dict.fromkeys(self._linking_libraries):
            self._final_module.link_in(library._get_module_for_linking(), preserve=True)
        for function in self._final_module.functions:
            # Several callers of one caller bring it along, which counts as one; it goes where it was inlined.
            if not function.is_declaration and function.linkage == Linkage.external:
                function.linkage = Linkage.linkonce_odr
        self._shared_module, self._finalized = self._final_module, True


class _Flags(Flags):
    """Options of a kernel, equal to others under which numba compiles functions of its own to the same code.

    numba looks such functions up by the options of the kernel that calls them, some thousand times for a kernel.
    """

    def __hash__(self) -> int:
        return hash(self._inherited())

    def __eq__(self, other: object) -> bool:
        return self._inherited() == other._inherited() if isinstance(other, _Flags) else NotImplemented

    def _inherited(self) -> tuple[object, ...]:
        values: Any = self._values
        return tuple(values.get(name) for name in ("nrt", "error_model", "forceinline"))


class _Kernel(CPUDispatcher):
    """A kernel: for Python numba's dispatcher; for other kernels it has the types of what comes back, and its code.

    Whole numbers that stand in a call are numbers of any value to a kernel, or it would be compiled for each of them.
    """

    # numba's type annotations leave these out.
    targetctx: Any
    _cache: Any
    _compiler: Any

    def __init__(self, function: Callable[..., Any], locals: Any = None, targetoptions: Any = None) -> None:
        super().__init__(function, locals or {}, targetoptions)
        self._compiler._customize_flags = _Flags
        self._inner = dict[tuple[Any, ...], Any]()

    def compile(self, sig: Any) -> Any:
        """The function of Python for a signature."""
        args, _ = normalize_signature(sig)
        if tuple(args) in self.overloads:
            return super().compile(sig)
        with _no_collection_of_garbage():
            compiled = super().compile(sig)
        # The environments of kernels whose code was taken over.
        codegen = self.targetctx.codegen()
        for environment in self.overloads[tuple(args)]._find_referenced_environments():
            codegen.set_env(environment.env_name, environment)
        return compiled

    def get_call_template(self, args: Any, kws: Any) -> Any:
        """What a call in another kernel gives: a template of it with its signature, the function's own signature, and
        the types of all arguments."""
        function, args = self._compiler.fold_argument_types(args, kws)
        args, name = tuple(types.unliteral(arg) for arg in args), self.py_func.__name__
        signatures = [self._for_kernels(args).signature]
        template = make_concrete_template(f"CallTemplate({name})", key=name, signatures=signatures)
        return template, function, args, {}

    def get_overload(self, sig: Any) -> Any:
        """The name of the code for a signature under which `targetctx` has it."""
        args, _ = normalize_signature(sig)
        return self._for_kernels(tuple(args)).entry_point

    def _for_kernels(self, args: tuple[Any, ...]) -> Any:
        """The code that other kernels call for arguments of some types."""
        known = self.overloads.get(args) or self._inner.get(args)
        if known is not None:
            return known
        flags: Any = _Flags()
        self.targetdescr.options.parse_as_flags(flags, self.targetoptions)
        flags.no_compile = flags.no_cpython_wrapper = True
        with global_compiler_lock, self._compiling_counter:
            code = _InnerCode(self.targetctx.codegen(), self.py_func.__qualname__)
            result = compile_extra(self.typingctx, self.targetctx, self.py_func, args, None, flags, self.locals, code)
            result = result._replace(entry_point=(self, args))
            self.targetctx.insert_user_function(result.entry_point, result.fndesc, [code])
        return self._inner.setdefault(args, result)


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
    options = {"error_model": "numpy", "no_cfunc_wrapper": True, "_nrt": allocates}
    options |= {"inline": inline, "forceinline": forceinline, "nogil": nogil}

    def decorated(function: F) -> Dispatcher[F]:
        if config.DISABLE_JIT:  # type: ignore[attr-defined]
            return cast("Dispatcher[F]", function)
        # As `njit` does.
        kernel = _Kernel(function, targetoptions={"nopython": True, "boundscheck": None} | options)
        # As `cache=True` does, with our names.
        try:
            kernel._cache = _Cache(function)
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
