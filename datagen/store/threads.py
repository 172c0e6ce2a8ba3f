"""Threads that decode the scenes of a batch side by side: blosc and SHA-256 let each other run."""

from __future__ import annotations

import multiprocessing
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor

from datagen.store.environment import cores

MOST_THREADS = 8
WORTH_BYTES = 2**21
"""Decoded bytes of a read below which handing them out takes longer than it spares."""


def in_turn(call: Callable[[int], None], count: int, decoded_bytes: int) -> None:
    """`call` of 0 … count - 1, side by side; one after the other in a worker, which has others beside it, and where
    little is to be decoded.
    """
    threads = min(cores(), count, MOST_THREADS)
    if threads < 2 or decoded_bytes < WORTH_BYTES or multiprocessing.parent_process() is not None:
        for number in range(count):
            call(number)
        return
    # Threads that outlived the call would be there when a loader forks its workers. The first error is raised, as it
    # would be one after the other.
    with ThreadPoolExecutor(threads, "datagen-decode") as pool:
        for _ in pool.map(call, range(count)):
            pass
