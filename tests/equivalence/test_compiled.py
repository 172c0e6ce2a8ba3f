"""Compiled kernels divide as numpy does, whatever calls them, and are cached where files can be written; Python
cannot call subroutines; the garbage collector waits for the compiler."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
from numba import njit

from datagen.compiled import compiled

ROOT = Path(__file__).resolve().parents[2]


@compiled()
def ratio(a, b):  # type: ignore[no-untyped-def]
    return a / b


@njit(error_model="python")
def ratio_for_another(a, b):  # type: ignore[no-untyped-def]
    return ratio(a, b)


def test_division_by_zero_does_not_hang_on_who_calls() -> None:
    assert ratio_for_another(1.0, 0.0) == np.inf == ratio(1.0, 0.0)


def test_where_sources_cannot_be_written_beside_the_cache_is_the_users(tmp_path: Path) -> None:
    """With a read-only installation, the first of two processes compiles into the user's cache, the second reads
    that."""
    package, home = tmp_path / "package", tmp_path / "home"
    package.mkdir()
    (package / "kernels.py").write_text(
        "from datagen.compiled import compiled\n@compiled()\ndef twice(x):\n    return 2 * x\n"
    )
    # A file takes the place of the folder for caches: permissions would not stop the superuser.
    (package / "__pycache__").touch()
    code = "from kernels import twice\nprint(twice(21), sum(twice.stats.cache_hits.values()), twice.stats.cache_path)"
    environment = {name: value for name, value in os.environ.items() if name != "NUMBA_CACHE_DIR"}
    environment |= {"PYTHONPATH": os.pathsep.join([str(package), str(ROOT)]), "HOME": str(home)}
    environment |= {"XDG_CACHE_HOME": str(home / "cache"), "LOCALAPPDATA": str(home / "cache")}
    said = [
        subprocess.check_output([sys.executable, "-c", code], env=environment, text=True).split() for _ in range(2)
    ]
    assert [one[:2] for one in said] == [["42", "0"], ["42", "1"]]
    assert Path(said[1][2]).is_relative_to(home)
