"""Locks on open files; the system releases them when their process ends."""

from __future__ import annotations

import fcntl


def locked(handle: int, otherwise: bool) -> bool:
    """True if this process now has the lock of an open file, until the file is closed or the process ends; False if
    another process has it; `otherwise` where the file system has no locks."""
    try:
        fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    except OSError:
        return otherwise
    return True
