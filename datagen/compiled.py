"""Compiled kernels on disk, kept true to their sources.

numba recompiles a cached function when its own file changes, but not when a function it calls from another file does.
So each package of kernels drops, when it is imported, caches older than the newest of its sources: the first call
of a kernel, which loads them, comes later.
"""

from __future__ import annotations

import os
from pathlib import Path


def drop_stale_kernels(package: Path, *called: Path) -> int:
    """Delete a package's cache files of numba (`.nbi`, `.nbc`) that are older than its newest source, or than that of
    the packages whose kernels it calls; return how many.

    Where they cannot be deleted (a read-only installation) nothing is done: such sources do not change either.
    """
    caches: list[tuple[float, str]] = []
    newest = max((_newest_source(folder) for folder in called), default=0.0)
    for folder, _, names in os.walk(package):
        for name in names:
            path = os.path.join(folder, name)
            if name.endswith(".py"):
                newest = max(newest, os.stat(path).st_mtime)
            elif name.endswith((".nbi", ".nbc")):
                try:
                    caches.append((os.stat(path).st_mtime, path))
                except FileNotFoundError:
                    continue
    dropped = 0
    for written, path in caches:
        if written < newest:
            try:
                os.unlink(path)
                dropped += 1
            except OSError:
                # Another process was quicker, or the folder is read-only.
                continue
    return dropped


def _newest_source(package: Path) -> float:
    return max((path.stat().st_mtime for path in package.rglob("*.py")), default=0.0)
