"""Compiled kernels divide as numpy does, whatever calls them, and are cached where files can be written; Python
cannot call subroutines; the garbage collector waits for the compiler."""

from __future__ import annotations

import gc
import importlib.util
import os
import subprocess
import sys
from pathlib import Path

import numba
import numpy as np
import pytest
from numba import njit, types
from numba.core.errors import TypingError
from numba.extending import overload

from datagen.compiled import compiled, subroutine

ROOT = Path(__file__).resolve().parents[2]


@compiled()
def ratio(a, b):  # type: ignore[no-untyped-def]
    return a / b


@njit(error_model="python")
def ratio_for_another(a, b):  # type: ignore[no-untyped-def]
    return ratio(a, b)


@subroutine()
def doubled(a):  # type: ignore[no-untyped-def]
    return 2 * a


def test_only_kernels_call_subroutines() -> None:
    """The kernel is not cached, so that the subroutine has machine code when Python calls it, but no wrapper."""
    assert njit(lambda a: doubled(a))(1.5) == 3.0
    assert doubled.signatures
    with pytest.raises(TypeError, match="only compiled functions can call doubled"):
        doubled(1.5)


def watched(a):  # type: ignore[no-untyped-def]
    raise NotImplementedError("compiled code only")


def test_the_garbage_collector_waits_for_the_compiler() -> None:
    """It stands still while a kernel is compiled, and runs afterwards if it ran before, even after an error."""
    ran = []

    @overload(watched)
    def typed(a):  # type: ignore[no-untyped-def]
        ran.append(gc.isenabled())
        return None if isinstance(a, types.UnicodeType) else lambda a: a

    kernel = njit(lambda a: watched(a))
    assert gc.isenabled()
    assert kernel(1) == 1
    with pytest.raises(TypingError):
        kernel("text")
    assert gc.isenabled()
    gc.disable()
    try:
        assert kernel(1.5) == 1.5
        assert not gc.isenabled()
    finally:
        gc.enable()
    assert len(ran) >= 3
    assert not any(ran)


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


def test_the_first_use_is_the_first_alone(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Two copies of the module share a cache, as two processes would."""
    monkeypatch.setattr(numba.config, "CACHE_DIR", str(tmp_path))
    said = []
    for _ in range(2):
        spec = importlib.util.spec_from_file_location("compiled_anew", ROOT / "datagen" / "compiled.py")
        assert spec is not None and spec.loader is not None
        module = importlib.util.module_from_spec(spec)
        spec.loader.exec_module(module)
        said.append(module.first_use())
    assert said == [True, False]
