"""A time limit for what a worker runs, also where it hangs outside of Python."""

from __future__ import annotations

import faulthandler
import os
import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager

GRACE_S = 10.0
"""After an exception was sent and did not arrive for so long, or as long again, the process ends."""
LONGEST_SCENE_S = 30 * 86400.0


class Overtime(BaseException):
    """The time is up. No `Exception`: what runs too long must not catch it."""


def overtime(seconds: float) -> str:
    """Why a scene was given up."""
    return f"took longer than {seconds:g} s (--scene-seconds)"


@contextmanager
def limited(seconds: float | None) -> Iterator[None]:
    """Raise `Overtime` when the block takes longer; a block that cannot be reached, such as compiled code that never
    returns, takes this process with it. Works in a process's main thread alone; None: no limit.
    """
    if (
        seconds is None
        or not hasattr(signal, "setitimer")
        or threading.current_thread() is not threading.main_thread()
    ):
        yield
        return

    def ring(*_: object) -> None:
        raise Overtime(overtime(seconds))

    with open(os.devnull, "w") as nowhere:
        before = signal.signal(signal.SIGALRM, ring)
        # A thread outside of Python: it needs no lock that the block may hold.
        faulthandler.dump_traceback_later(seconds + min(GRACE_S, seconds), exit=True, file=nowhere)
        signal.setitimer(signal.ITIMER_REAL, seconds)
        try:
            yield
        finally:
            signal.setitimer(signal.ITIMER_REAL, 0.0)
            faulthandler.cancel_dump_traceback_later()
            signal.signal(signal.SIGALRM, before)
