"""Locks on files; the system releases them when their process ends."""

from __future__ import annotations

import errno
import fcntl
import os
import socket
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

PULSE_S = 5.0
"""Seconds between two signs of life of a process that has locked a file: a file system that a thousand workers share
has to answer two hundred of them a second."""
LOOK = os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK
"""How a file is opened that somebody may have locked: opening a pipe in its place does not wait for a writer."""


def try_lock(handle: int, otherwise: bool) -> bool:
    """True if this process now has the lock of an open file, until the file is closed or the process ends; False if
    another process has it; `otherwise` where the file system has no locks."""
    try:
        fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    except OSError:
        return otherwise
    return True


def lock_file(path: Path) -> int | None:
    """Handle of a file, made if it is missing, that is now locked until the handle is closed, and says by whom; None
    if somebody else has it. Raises `OSError` for a link.

    If the file system has no locks, nothing prevents a user from starting two builds of one shard.
    """
    while True:
        handle = os.open(path, os.O_RDWR | os.O_CREAT | os.O_NOFOLLOW, 0o644)
        try:
            if not try_lock(handle, otherwise=True):
                break
            # Whoever had it may have removed it in the meantime.
            if os.fstat(handle).st_nlink > 0:
                with suppress(OSError):
                    os.ftruncate(handle, 0)
                    os.pwrite(handle, f"{socket.gethostname()}, process {os.getpid()}".encode(), 0)
                kept, handle = handle, -1
                return kept
        finally:
            if handle >= 0:
                os.close(handle)
    return None


def holder_of(*paths: Path) -> str:
    """Who has locked the last one of some files that says so, in words."""
    for path in reversed(paths):
        with suppress(OSError, UnicodeDecodeError):
            handle = os.open(path, LOOK)
            try:
                if name := os.read(handle, 200).decode():
                    return name
            finally:
                os.close(handle)
    return "somebody"


def sign_of_life(path: Path) -> int:
    """A number that changes as long as whoever has locked a file is at work; 0 if there is no file."""
    try:
        # Network file systems tell the time anew when a file is opened.
        handle = os.open(path, LOOK)
    except OSError:
        return 0
    try:
        return os.fstat(handle).st_mtime_ns
    finally:
        os.close(handle)


def give_sign(handle: int) -> None:
    """Let `sign_of_life` change."""
    with suppress(OSError):
        os.utime(handle)


@contextmanager
def alone_in(folder: Path, patience_s: float = 10.0) -> Iterator[None]:
    """A context of some milliseconds in which no other process is in that of the same folder, if its file system has
    locks for folders. Raises `OSError` if another one is there for longer than `patience_s`."""
    handle = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)
    try:
        last = time.monotonic() + patience_s
        while not try_lock(handle, otherwise=True):
            if time.monotonic() > last:
                raise OSError(errno.EBUSY, "another build is preparing this folder and does not go on", str(folder))
            time.sleep(0.02)
        yield
    finally:
        os.close(handle)


@contextmanager
def signs_of_life(handle: int) -> Iterator[None]:
    """A context in which another thread gives signs of life: what the block computes may take hours. They cease when
    the process is stopped."""
    over = threading.Event()

    def beat() -> None:
        while not over.wait(PULSE_S):
            give_sign(handle)

    beating = threading.Thread(target=beat, daemon=True)
    beating.start()
    try:
        yield
    finally:
        over.set()
        beating.join()
