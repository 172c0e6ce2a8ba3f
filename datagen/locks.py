"""Locks on open files, which go with the process that holds them."""

from __future__ import annotations

try:
    import fcntl
except ImportError:  # Windows.
    fcntl = None  # type: ignore[assignment]


def locked(handle: int, otherwise: bool) -> bool:
    """Lock an open file until it is closed, or its process ends; False where another process holds it, and
    `otherwise` where the file system has no locks.
    """
    if fcntl is None:
        return otherwise
    try:
        fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    except OSError:
        return otherwise
    return True
