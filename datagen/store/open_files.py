"""Open files of datasets: one budget a process, however many fields, shards and datasets are read."""

from __future__ import annotations

import errno
import itertools
import os
import stat
import threading
from collections import OrderedDict
from collections.abc import Iterator
from contextlib import contextmanager
from io import BufferedReader

import numpy as np
from numpy.typing import NDArray

from datagen.errors import CheckError
from datagen.store.places import Bucket, Place

MOST_OPEN = 512
"""Open files at most; a quarter of what the process is allowed, if that is less: it has other files to open."""


@contextmanager
def sized(path: Place) -> Iterator[tuple[int, BufferedReader]]:
    """Size and bytes of a file or object, which is asked for them once. Raises `OSError` where none is there, or no
    plain one (errno EINVAL)."""
    if isinstance(path, Bucket):
        size, stream = path.sized()
        yield size, stream
        return
    handle, size = _opened(str(path))
    with open(handle, "rb") as file:
        yield size, file


def size_of(path: Place) -> int:
    """Bytes of a file or object, asked for once; raises `OSError` as `sized` does."""
    if isinstance(path, Bucket):
        return path.stat().st_size
    found = path.stat()
    if not stat.S_ISREG(found.st_mode):
        raise _no_plain_file(path)
    return found.st_size


def _no_plain_file(path: object) -> OSError:
    return OSError(errno.EINVAL, "no plain file", str(path))


def _opened(path: str) -> tuple[int, int]:
    """Handle and size of a plain file."""
    # Whatever else stands there, such as a pipe, must not make us wait.
    handle = os.open(path, os.O_RDONLY | getattr(os, "O_NONBLOCK", 0))
    found = os.fstat(handle)
    if not stat.S_ISREG(found.st_mode):
        os.close(handle)
        raise _no_plain_file(path)
    return handle, found.st_size


class OpenFile:
    """A plain file, open for as long as somebody holds this.

    Attributes
    ----------
    size : bytes.
    index : where chunks begin, and how long they are, as the reader found it at the end of a sharded file.
    """

    index: NDArray[np.uint64]

    def __init__(self, path: str) -> None:
        self._handle, self.size = _opened(path)

    def read(self, size: int, offset: int) -> bytes:
        """So many bytes from there, or fewer where the file ends."""
        return os.pread(self._handle, size, offset)

    def __del__(self) -> None:
        if hasattr(self, "_handle"):
            os.close(self._handle)


class OpenObject:
    """The same of an object of an object store; every read is a request.

    Attributes
    ----------
    size, index : as of an `OpenFile`.
    """

    index: NDArray[np.uint64]

    def __init__(self, path: Bucket) -> None:
        self._path, self.size = path, path.stat().st_size

    def read(self, size: int, offset: int) -> bytes:
        """So many bytes from there, or fewer where the object ends."""
        return self._path.read_range(offset, min(size, self.size - offset))


class OpenFiles:
    """The files that one reader has open; the least recently used of all readers' makes room for a new one."""

    def __init__(self) -> None:
        self._reader = next(_readers)

    def get(self, path: Place) -> OpenFile | OpenObject | None:
        """The file, if it is open."""
        with _lock:
            file = _open.get((self._reader, path))
            if file is not None:
                _open.move_to_end((self._reader, path))
            return file

    def open(self, path: Place) -> OpenFile | OpenObject:
        """Open a file; raises `OSError`, or `CheckError` where the process may open no more."""
        if isinstance(path, Bucket):
            return OpenObject(path)
        for room in (_budget(), 1):
            with _lock:
                while len(_open) >= room:
                    _open.popitem(last=False)
            try:
                return OpenFile(str(path))
            except OSError as error:
                if error.errno not in (errno.EMFILE, errno.ENFILE):
                    raise
        raise too_many(path)

    def keep(self, path: Place, file: OpenFile | OpenObject) -> None:
        """Keep a file open for as long as there is room."""
        with _lock:
            _open[self._reader, path] = file

    def close(self) -> None:
        """Close them all."""
        with _lock:
            for key in [key for key in _open if key[0] == self._reader]:
                del _open[key]


def too_many(path: object) -> CheckError:
    """What to tell when a file cannot be opened because too many are open."""
    return CheckError(
        f"{path}: this process has too many files open ({_allowed()} are allowed); allow more (`ulimit -n`)"
    )


_readers = itertools.count()
_open: OrderedDict[tuple[int, Place], OpenFile | OpenObject] = OrderedDict()
_lock = threading.Lock()


def _allowed() -> int:
    try:
        import resource
    except ImportError:
        return 4 * MOST_OPEN
    return resource.getrlimit(resource.RLIMIT_NOFILE)[0]


def _budget() -> int:
    allowed = _allowed()
    return max(1, min(MOST_OPEN, allowed // 4)) if allowed > 0 else MOST_OPEN


def _after_fork() -> None:
    """Another thread may have held the lock; the files stay good, since nothing is read from a shared position."""
    global _lock
    _lock = threading.Lock()


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_after_fork)
