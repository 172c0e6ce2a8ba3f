"""Limits of this process that stand in for a small machine."""

from __future__ import annotations

import resource
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path


@contextmanager
def limited(kind: int, size: int) -> Iterator[None]:
    """While a resource of the process, `resource.RLIMIT_…`, has this limit."""
    before = resource.getrlimit(kind)
    resource.setrlimit(kind, (size, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(kind, before)


@contextmanager
def little_memory(more_bytes: int = 2**30) -> Iterator[None]:
    """While there is no more address space than so many bytes beyond what is used now."""
    used = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
    with limited(resource.RLIMIT_AS, used + more_bytes):
        yield
