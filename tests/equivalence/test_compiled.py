"""A cached kernel never outlives the sources it was compiled from."""

from __future__ import annotations

import os
from pathlib import Path

from datagen.compiled import drop_stale_kernels


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
