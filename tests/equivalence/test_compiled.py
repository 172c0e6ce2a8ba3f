"""A kernel is compiled once for all that call it, gives them the same answer, and never outlives its sources."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from numba import njit

from datagen.compiled import _alone, compiled, drop_stale_kernels

ROOT = Path(__file__).resolve().parents[2]


@compiled()
def one_of(values, k, factor=2.0):  # type: ignore[no-untyped-def]
    return values[k] * factor


@njit
def three_of(values, k):  # type: ignore[no-untyped-def]
    return one_of(values, 0) + one_of(values, 1) + one_of(values, k)


@compiled()
def ratio(a, b):  # type: ignore[no-untyped-def]
    return a / b


@njit(error_model="python")
def ratio_for_another(a, b):  # type: ignore[no-untyped-def]
    return ratio(a, b)


def test_numbers_in_a_call_and_variables_are_one_function_and_python_has_its_own() -> None:
    values = np.arange(5.0)
    assert three_of(values, 4) == 10.0
    twin = one_of.called_by_kernels  # type: ignore[attr-defined]
    assert len(twin.signatures) == 1 and one_of.signatures == []
    assert one_of(values, 3) == 6.0 and one_of(values, 3, 1.0) == 3.0

    def wrapped(kernel):  # type: ignore[no-untyped-def]
        (first, *_) = kernel.overloads.values()
        return first.library.get_pointer_to_function(first.fndesc.llvm_cpython_wrapper_name) != 0

    assert wrapped(one_of) and not wrapped(twin)


@pytest.mark.skipif(sys.platform == "win32", reason="files are not locked there")
def test_what_another_process_compiles_is_waited_for_and_read(tmp_path: Path) -> None:
    (tmp_path / "of_both.py").write_text(
        "from datagen.compiled import compiled\n@compiled()\ndef twice(x):\n    return 2 * x\n"
    )
    code = (
        "from of_both import twice\n"
        "print('ready', flush=True)\n"
        "print(twice(21), sum(twice.stats.cache_hits.values()), sum(twice.stats.cache_misses.values()))"
    )
    path, cache = os.pathsep.join([str(tmp_path), str(ROOT)]), tmp_path / "cache"
    environment = {**os.environ, "PYTHONPATH": path, "NUMBA_CACHE_DIR": str(cache)}
    both = []
    with _alone(str(tmp_path / "of_both.py")):
        for _ in range(2):
            one = subprocess.Popen([sys.executable, "-c", code], env=environment, stdout=subprocess.PIPE, text=True)
            assert one.stdout is not None and one.stdout.readline() == "ready\n"
            both.append(one)
        with pytest.raises(subprocess.TimeoutExpired):
            both[0].wait(2)
    assert sorted(one.communicate()[0] for one in both) == ["42 0 1\n", "42 1 0\n"]


@pytest.mark.skipif(sys.platform == "win32", reason="files are not locked there")
def test_who_compiles_for_too_long_is_waited_for_no_more(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    import fcntl

    monkeypatch.setattr("datagen.compiled.PATIENCE_S", 0.1)
    source = tmp_path / "kernels.py"
    source.touch()
    with source.open() as held:
        fcntl.flock(held, fcntl.LOCK_EX)
        with _alone(str(source)), _alone(str(source)), _alone(str(tmp_path / "not there.py")):
            pass
    with _alone(str(source)), source.open() as wanted, pytest.raises(BlockingIOError):
        fcntl.flock(wanted, fcntl.LOCK_EX | fcntl.LOCK_NB)
    with source.open() as wanted:
        fcntl.flock(wanted, fcntl.LOCK_EX | fcntl.LOCK_NB)


def test_division_by_zero_does_not_hang_on_who_calls() -> None:
    assert ratio_for_another(1.0, 0.0) == np.inf == ratio(1.0, 0.0)


@pytest.mark.nightly
def test_a_first_scene_compiles_each_kernel_once(tmp_path: Path) -> None:
    """Compiling is most of the first build after an installation."""
    code = """
import gc, json
from datagen import load_config
from datagen.compiled import Kernel
from datagen.pipeline import simulate_sample
simulate_sample(load_config("configs/quickstart.yaml"), 0)
kernels = [each for each in gc.get_objects() if isinstance(each, Kernel)]
print(json.dumps({
    f"{k.__module__}.{k.__qualname__}": len(k.signatures) + len(k.called_by_kernels.signatures) for k in kernels
}))
"""
    environment = {**os.environ, "NUMBA_CACHE_DIR": str(tmp_path), "PYTHONPATH": str(ROOT)}
    said = subprocess.check_output([sys.executable, "-c", code], env=environment, cwd=ROOT, text=True)
    times = json.loads(said)
    assert sum(times.values()) > 50
    assert {name: n for name, n in times.items() if n > 1} == {}


def test_caches_older_than_any_source_are_dropped(tmp_path: Path) -> None:
    cache = tmp_path / "transport" / "__pycache__"
    cache.mkdir(parents=True)
    for name, written in (("transport/kernels.py", 100), ("brdf.py", 300)):
        (tmp_path / name).write_text("pass")
        os.utime(tmp_path / name, (written, written))
    for name, written in (("old.nbi", 200), ("old.1.nbc", 299), ("new.nbi", 301), ("other.pyc", 1)):
        (cache / name).write_bytes(b"x")
        os.utime(cache / name, (written, written))
    assert drop_stale_kernels(tmp_path) == 2
    assert sorted(p.name for p in cache.iterdir()) == ["new.nbi", "other.pyc"]
    assert drop_stale_kernels(tmp_path) == 0


def test_caches_older_than_a_source_that_they_call_are_dropped(tmp_path: Path) -> None:
    for name, written in (("paper/old.nbi", 200), ("transport/kernels.py", 300)):
        (tmp_path / name).parent.mkdir()
        (tmp_path / name).write_bytes(b"x")
        os.utime(tmp_path / name, (written, written))
    assert drop_stale_kernels(tmp_path / "paper") == 0
    assert drop_stale_kernels(tmp_path / "paper", tmp_path / "transport") == 1
