"""Compiled kernels on disk, kept true to their sources.

numba recompiles a cached function when its own file changes, but not when a function it calls from another file does.
So each package of kernels drops, when it is imported, caches older than the newest of its sources: the first call
of a kernel, which loads them, comes later.
"""

from __future__ import annotations

from contextlib import suppress
from pathlib import Path


def drop_stale_kernels(package: Path, *called: Path) -> int:
    """Delete a package's cache files of numba (`.nbi`, `.nbc`) that are older than its newest source, or than that of
    the packages whose kernels it calls; return how many.

    Where they cannot be deleted (a read-only installation) nothing is done: such sources do not change either.
    """
    newest = max(map(_newest_source, (package, *called)))
    dropped = 0
    for cache in [*package.rglob("*.nbi"), *package.rglob("*.nbc")]:
        # Another process may be quicker, or the folder read-only.
        with suppress(OSError):
            if cache.stat().st_mtime < newest:
                cache.unlink()
                dropped += 1
    return dropped


def _newest_source(package: Path) -> float:
    return max((path.stat().st_mtime for path in package.rglob("*.py")), default=0.0)
