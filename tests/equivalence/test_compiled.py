"""Compiled kernels divide as numpy does, whatever calls them, are compiled once, and are cached where files can be
written, as long as no source changes."""

from __future__ import annotations

import gc
import os
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numba import njit, types
from numba.core import event
from numba.core.caching import NullCache
from numba.core.errors import TypingError

from datagen.compiled import _make_private, compiled

ROOT = Path(__file__).resolve().parents[2]


@compiled()
def ratio(a, b):  # type: ignore[no-untyped-def]
    return a / b


@njit(error_model="python")
def ratio_for_another(a, b):  # type: ignore[no-untyped-def]
    return ratio(a, b)


def test_division_by_zero_does_not_hang_on_who_calls() -> None:
    assert ratio_for_another(1.0, 0.0) == np.inf == ratio(1.0, 0.0)


def anew(*kernels: Any) -> None:
    """Kernels of tests are cached, too: let some be compiled whatever was stored."""
    for kernel in kernels:
        kernel._cache = NullCache()


@compiled(allocates=False)
def root(x):  # type: ignore[no-untyped-def]
    if x < 0:
        raise ValueError("no root")
    return np.sqrt(x)


@compiled()
def roots(x):  # type: ignore[no-untyped-def]
    return root(4) + root(9) + root(x)


@compiled()
def rooted(x):  # type: ignore[no-untyped-def]
    return roots(x)


@njit
def roots_for_another(x):  # type: ignore[no-untyped-def]
    return rooted(x)


def test_kernels_that_kernels_call_are_compiled_once_as_a_part_of_them() -> None:
    """Whatever whole numbers stand in the calls. Python may call each of them all the same, before or after."""
    anew(root, roots, rooted)
    assert rooted(16) == 9.0
    assert (len(rooted.signatures), len(roots.signatures), len(root.signatures)) == (1, 0, 0)
    assert list(root._inner) == [(types.int64,)]  # type: ignore[attr-defined]
    assert root(25) == 5.0 and root(6.25) == 2.5 and roots(16) == roots_for_another(16) == rooted(16) == 9.0
    for kernel in (root, roots, rooted, roots_for_another):
        with pytest.raises(ValueError, match="no root"):
            kernel(-1)
    assert root.py_func(4.0) == 2.0


@compiled(nogil=True)
def at_least_zero(x):  # type: ignore[no-untyped-def]
    return max(x, np.float32(0.0))


@compiled()
def at_least_once(x):  # type: ignore[no-untyped-def]
    return max(at_least_zero(x), np.float32(1.0))


def test_what_a_kernel_needs_of_numba_is_compiled_once_for_all_kernels() -> None:
    anew(at_least_zero, at_least_once)
    with event.install_recorder("numba:compile") as recorder:  # type: ignore[no-untyped-call]
        assert at_least_once(np.float32(0.5)) == 1.0 and at_least_zero(np.float32(-1.0)) == 0.0
    names = [what.data["dispatcher"].py_func.__qualname__ for _, what in recorder.buffer if what.is_start]
    assert names[0] == "at_least_once" and names[-1] == "at_least_zero" and len(names) == len(set(names))


def test_garbage_is_collected_again_after_compiling() -> None:
    anew(ratio)
    ratio(1, 2)
    assert gc.isenabled()
    with pytest.raises(TypingError):
        ratio("1", 2)
    assert gc.isenabled()
    gc.disable()
    try:
        ratio(np.float32(1), 2)
        assert not gc.isenabled()
    finally:
        gc.enable()


PRINTED = """
import sys
{before}
from kernels import twice
print(twice(21), sum(twice.stats.cache_hits.values()), twice.stats.cache_path)
"""


def package_that_cannot_be_written(folder: Path) -> Path:
    """A folder with a kernel. A file takes the place of the folder for caches: permissions would not stop the
    superuser."""
    package = folder / "package"
    package.mkdir()
    (package / "kernels.py").write_text(
        "from datagen.compiled import compiled\n@compiled()\ndef twice(x):\n    return 2 * x\n"
    )
    (package / "__pycache__").touch()
    return package


def said_by(package: Path, home: Path, before: str = "", **environment: str) -> tuple[list[str], str]:
    """What a process says that calls the kernel (value, hits of the cache, its folder), and its warnings.

    before : lines that the process runs before it imports the kernel.
    """
    path = os.pathsep.join([str(package), str(ROOT)])
    taken_over = {key: os.environ[key] for key in ("PATH", "OMP_NUM_THREADS") if key in os.environ}
    environment = taken_over | {"PYTHONPATH": path, "HOME": str(home)} | environment
    command = [sys.executable, "-c", PRINTED.format(before=before)]
    (home.parent / "here").mkdir(exist_ok=True)
    done = subprocess.run(
        command, env=environment, cwd=home.parent / "here", capture_output=True, text=True, check=True
    )
    return done.stdout.split(), done.stderr


def test_where_sources_cannot_be_written_beside_the_cache_is_the_users(tmp_path: Path) -> None:
    """With a read-only installation, the first of two processes compiles into the user's cache, the second reads
    that, without a word. Files that a power cut emptied are compiled and stored anew."""
    package, home = package_that_cannot_be_written(tmp_path), tmp_path / "home"
    cache = {"XDG_CACHE_HOME": str(home / "cache"), "LOCALAPPDATA": str(home / "cache")}
    for hits in "01":
        said, warned = said_by(package, home, **cache)
        assert said[:2] == ["42", hits] and warned == ""
    assert Path(said[2]).is_relative_to(home)
    files = list(Path(said[2]).glob("kernels.twice*"))
    assert len(files) == 2
    for file in files:
        file.write_bytes(b"")
    for hits in "01":
        said, warned = said_by(package, home, **cache)
        assert said[:2] == ["42", hits] and warned == ""


NO_USER = """
import pwd
def getpwuid(user):
    raise KeyError(user)
pwd.getpwuid = getpwuid
del __import__("os").environ["HOME"]
"""
"""A container's user who is in no list of users."""
FULL = """
import resource, signal
signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
resource.setrlimit(resource.RLIMIT_FSIZE, (64, resource.RLIM_INFINITY))
"""
"""No file may grow beyond 64 bytes, as on a full disk."""


@pytest.mark.parametrize("before", ["", NO_USER], ids=["no home", "no user"])
def test_without_a_home_the_cache_is_a_private_temporary_folder(tmp_path: Path, before: str) -> None:
    """A process that starts another says so in one line, the other nothing. Nothing else is written."""
    package, home, temporary = package_that_cannot_be_written(tmp_path), tmp_path / "home", tmp_path / "temporary"
    home.touch()
    temporary.mkdir()
    unusable = {"TMPDIR": str(temporary), "NUMBA_CACHE_DIR": str(home / "numba")}
    said, warned = said_by(package, home, before, **unusable)
    private = temporary / f"datagen-{os.geteuid()}"
    assert said[:2] == ["42", "0"] and Path(said[2]).parent == private
    assert f"compiled kernels are kept in {private}" in warned and warned.count("Warning") == 1
    assert private.stat().st_mode & 0o777 == 0o700 and list((tmp_path / "here").iterdir()) == []
    assert said_by(package, home, before, DATAGEN_SAID_OF_CACHE="1", **unusable)[0][1] == "1"


@pytest.mark.parametrize(
    ("before", "why"),
    [
        ("__import__('tempfile').tempdir = '/proc/nothing'", "no folder for them can be written"),
        ("open", "no folder for them can be written"),
        (FULL, "File too large"),
    ],
    ids=["nowhere to write", "others may write there", "a full disk"],
)
def test_without_a_place_for_a_cache_kernels_are_compiled(tmp_path: Path, before: str, why: str) -> None:
    package, home, temporary = package_that_cannot_be_written(tmp_path), tmp_path / "home", tmp_path / "temporary"
    home.touch()
    temporary.mkdir()
    private = temporary / f"datagen-{os.geteuid()}"
    if before == "open":
        private.mkdir()
        private.chmod(0o770)
    said, warned = said_by(package, home, before, TMPDIR=str(temporary))
    assert said[:2] == ["42", "0"] and warned.count("Warning") == 1
    assert "compiled kernels cannot be stored (" in warned and why in warned
    assert not list(temporary.rglob("*.nb[ic]*"))


def test_a_folder_that_others_may_write_is_not_trusted(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """numba executes what a cache holds."""
    folder = tmp_path / "private"
    for _ in range(2):
        _make_private(folder)
    assert folder.stat().st_mode & 0o777 == 0o700
    (tmp_path / "link").symlink_to(folder)
    (tmp_path / "file").touch()
    (tmp_path / "open").mkdir()
    (tmp_path / "open").chmod(0o701)
    for name in ("link", "file", "open"):
        with pytest.raises(PermissionError):
            _make_private(tmp_path / name)
    with monkeypatch.context() as patch, pytest.raises(PermissionError):
        patch.setattr(os, "geteuid", lambda: folder.stat().st_uid + 1)
        _make_private(folder)
    tmp_path.chmod(0o777)
    with pytest.raises(PermissionError):
        _make_private(folder)
    tmp_path.chmod(0o1777)
    _make_private(folder)


PACKAGE = {
    "datagen/__init__.py": "",
    "datagen/callee.py": "from datagen.compiled import compiled\nFACTOR = 2\n"
    "@compiled()\ndef times(x):\n    return FACTOR * x\n",
    "datagen/caller.py": "from datagen.callee import times\nfrom datagen.compiled import compiled\n"
    "@compiled()\ndef kernel(x):\n    return times(x) + 1\n",
    "scene_library/__init__.py": "",
    "scene_library/sizes.py": "SIZE = 5\n",
    "scene_library/areas.py": "from datagen.compiled import compiled\nfrom scene_library.sizes import SIZE\n"
    "@compiled()\ndef kernel(x):\n    return SIZE * x\n",
    "kernels_of_tests.py": "from datagen.caller import kernel\nfrom datagen.compiled import compiled\n"
    "@compiled()\ndef twice(x):\n    return 2 * kernel(x)\n",
}
"""Small files in the place of the packages' own, beside the real `compiled.py`."""
PROGRAM = """
from datagen.caller import kernel
from datagen.compiled import first_use
from kernels_of_tests import twice
from scene_library.areas import kernel as area
first = first_use()
print(kernel(10), twice(10), area(10), first, sum(kernel.stats.cache_hits.values()))
"""


IMPORTS_AN_EDIT = """
from pathlib import Path
import datagen.compiled
callee = Path(datagen.compiled.__file__).with_name("callee.py")
text = callee.read_text()
callee.write_text(text.replace("FACTOR = 2", "FACTOR = 4"))
from datagen.caller import kernel
print(kernel(10))
callee.write_text(text)
"""


def started(root: Path, program: str = PROGRAM) -> subprocess.Popen[str]:
    environment = {name: value for name, value in os.environ.items() if name != "NUMBA_CACHE_DIR"}
    # Python's own cache goes by time and size of a file, which do not change here.
    environment |= {"PYTHONPATH": str(root), "PYTHONDONTWRITEBYTECODE": "1"}
    return subprocess.Popen(
        [sys.executable, "-c", program], cwd=root, env=environment, text=True, stdout=subprocess.PIPE
    )


def small_package(root: Path) -> None:
    for name, text in PACKAGE.items():
        (root / name).parent.mkdir(exist_ok=True)
        (root / name).write_text(text)
    shutil.copy(ROOT / "datagen" / "compiled.py", root / "datagen")


def answers(*running: subprocess.Popen[str]) -> list[list[str]]:
    said = [process.communicate()[0].split() for process in running]
    assert all(process.returncode == 0 for process in running)
    return said


def changed(path: Path, old: str, new: str) -> None:
    """Replace a text by one of the same length, and leave the time of the file as it was."""
    before, text = path.stat(), path.read_text()
    assert old in text and len(old) == len(new)
    path.write_text(text.replace(old, new))
    os.utime(path, ns=(before.st_atime_ns, before.st_mtime_ns))


def test_kernels_follow_an_edit_of_any_source(tmp_path: Path) -> None:
    """A function or a constant of another file changes, its size and time do not: kernels of both packages and of
    tests compute the new values, in several processes that start at once, and nothing of the old ones stays."""
    small_package(tmp_path)
    assert answers(started(tmp_path)) == [["21", "42", "50", "True", "0"]]
    assert answers(started(tmp_path)) == [["21", "42", "50", "False", "1"]]
    old = {path.name for path in tmp_path.rglob("*.nb[ic]")}
    changed(tmp_path / "datagen" / "callee.py", "FACTOR = 2", "FACTOR = 3")
    changed(tmp_path / "scene_library" / "sizes.py", "SIZE = 5", "SIZE = 7")
    said = answers(*(started(tmp_path) for _ in range(3)))
    assert [one[:3] for one in said] == [["31", "62", "70"]] * 3
    assert "True" in {one[3] for one in said}
    assert answers(started(tmp_path)) == [["31", "62", "70", "False", "1"]]
    new = {path.name for path in tmp_path.rglob("*.nb[ic]")}
    assert len(new) == len(old)
    assert new.isdisjoint(old)


def test_an_edit_while_a_process_runs_is_not_stored_as_what_was_there_before(tmp_path: Path) -> None:
    """A process imports a source after it was edited, and the edit is taken back: nobody computes with it later."""
    small_package(tmp_path)
    assert answers(started(tmp_path, IMPORTS_AN_EDIT)) == [["41"]]
    assert answers(started(tmp_path))[0][0] == "21"


DIGESTS = """
import hashlib, sys
import datagen as dg
config = dg.load_config(sys.argv[1])
scene = dg.scene_for(config, 0)
capture = dg.capture_for(config, scene, config.seed, 0)
ways = {"paths": dg.Accuracy(samples=16), "target": dg.Accuracy(target=0.1, max_bounces=5)}
for name in sys.argv[2:]:
    light = dg.simulate(scene, capture, ways[name], 3)
    values = [light.total, light.stderr, light.overflow]
    print(name, repr(light.relative_error), hashlib.sha256(b"".join(of.tobytes() for of in values)).hexdigest())
"""


@pytest.mark.nightly
def test_light_does_not_hang_on_the_order_in_which_kernels_were_compiled(tmp_path: Path) -> None:
    """Nor on whether they were compiled or read from the cache."""
    said = list[list[str]]()
    for cache, order in (("one", "paths target"), ("two", "target paths"), ("two", "target paths")):
        command = [sys.executable, "-c", DIGESTS, str(ROOT / "configs" / "quickstart.yaml"), *order.split()]
        environment = os.environ | {"NUMBA_CACHE_DIR": str(tmp_path / cache)}
        said.append(sorted(subprocess.check_output(command, env=environment, cwd=ROOT, text=True).splitlines()))
    assert said[0] == said[1] == said[2]
