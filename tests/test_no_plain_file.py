"""What is no plain file (a pipe, socket, device, or a link to one) is refused in a line by whoever opens files. No
reader waits for it, or reads it without end."""

from __future__ import annotations

import ast
import os
import shutil
import signal
import socket
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest
import trimesh
from damage import small_dataset, told

import datagen as dg
from datagen.cli import run
from datagen.config import config_from_mapping
from datagen.errors import CheckError, InputError
from datagen.loader import TransientDataset
from datagen.locks import holder_of, sign_of_life
from datagen.report.preview import preview
from datagen.report.style import new_figure, save_png
from datagen.store import verify
from datagen.store.info import info
from datagen.untrusted import content_of, opened, read_npy, read_npz, read_records, read_text

PATIENCE_S = 60


def pipe(path: Path) -> None:
    os.mkfifo(path)


def link_to_a_pipe(path: Path) -> None:
    target = path.with_name("a pipe")
    target.exists() or os.mkfifo(target)
    path.symlink_to(target)


def endless(path: Path) -> None:
    path.symlink_to("/dev/zero")


def listening(path: Path) -> None:
    # A socket's address is short; its name may be long.
    here = Path.cwd()
    os.chdir(path.parent)
    try:
        with socket.socket(socket.AF_UNIX) as end:
            end.bind(path.name)
    finally:
        os.chdir(here)


KINDS: tuple[Callable[[Path], None], ...] = (pipe, link_to_a_pipe, endless, listening)


@contextmanager
def soon() -> Iterator[None]:
    """A context that raises if its block waits for ever."""

    def ring(*_: object) -> None:
        raise AssertionError("waits for what never comes")

    before = signal.signal(signal.SIGALRM, ring)
    signal.alarm(PATIENCE_S)
    try:
        yield
    finally:
        signal.alarm(0)
        signal.signal(signal.SIGALRM, before)


@pytest.mark.parametrize("make", KINDS)
def test_all_readers_of_files_refuse_it(tmp_path: Path, make: Callable[[Path], None]) -> None:
    path = tmp_path / "file"
    make(path)
    calls: tuple[Callable[[Path], Any], ...] = (
        content_of,
        read_text,
        read_npy,
        lambda p: read_npz(p, []),
        lambda p: [*read_records(p, [])],
    )
    for call in calls:
        with soon(), pytest.raises(OSError, match="is no plain file"):
            call(path)
    with soon(), pytest.raises(OSError), opened(path):
        pass


def configuration(**scene: Any) -> dict[str, Any]:
    return {"scenes": 1, "capture": {"scan": {"rows": 1, "columns": 1}, "time": {"bins": 8}}} | scene


@pytest.mark.parametrize("make", KINDS)
def test_every_file_that_a_user_may_name(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], make: Callable[[Path], None]
) -> None:
    """On the command line, in a configuration and in Python."""
    places = {
        name: tmp_path / name for name in (
            "c.yaml", "d.yaml", "m.obj", "edges.csv", "edges.npz", "map.npz", "frames.json", "frames.npz",
            "frames.npy", "capture.mat", "capture.hdf5", "predictions.npz", "times.mat",
        )
    }  # fmt: skip
    for place in places.values():
        make(place)
    capture = tmp_path / "sound.mat"
    capture.write_bytes(b"no capture, and a plain file")
    named = {name: str(place) for name, place in places.items()}
    for command in (
        ["plan", named["c.yaml"]], ["build", named["c.yaml"], str(tmp_path / "out")],
        ["sheet", named["c.yaml"], str(tmp_path / "rooms.png")], ["device", named["d.yaml"]],
        ["import", named["capture.mat"], str(tmp_path / "out")],
        ["import", named["capture.hdf5"], str(tmp_path / "out")],
        ["import", str(capture), str(tmp_path / "out"), "--tof", named["times.mat"]],
        ["compare", named["frames.json"], "--device", "tmf8820", "--mesh", named["m.obj"]],
        ["calibrate", named["frames.npz"], "--device", "tmf8820", "--out", str(tmp_path / "new.yaml")],
    ):  # fmt: skip
        with soon():
            assert run(command) == 2, command
        (line,) = capsys.readouterr().err.splitlines()
        assert "plain file" in line and "Traceback" not in line, line
    mesh = {"kind": "mesh", "path": named["m.obj"], "height_m": 1.0}
    for values in (
        {"scene": {"contents": [mesh]}},
        {"detector": {"tdc_edges_ps": named["edges.csv"]}},
        {"detector": {"tdc_edges_ps": named["edges.npz"]}},
    ):
        with soon(), pytest.raises(InputError, match="plain file"):
            config_from_mapping(configuration(**values))
    with soon(), pytest.raises(InputError, match="plain file"):
        dg.device(named["d.yaml"])
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("make", KINDS)
def test_every_file_of_a_dataset(tmp_path: Path, make: Callable[[Path], None]) -> None:
    """One after the other is no plain file. What reads it says so in a line, or reads the same from elsewhere, as the
    scenes that could be made; and building again writes the file anew, but not through a link."""
    root = tmp_path / "set"
    small_dataset(root)
    due = TransientDataset(root).scenes.tolist()
    for name in (
        "dataset.json", "samples.parquet", "croissant.json", "README.md", "build/shard-000001.json",
        "data.zarr/zarr.json", "data.zarr/histogram/zarr.json", "data.zarr/bin/c/0",
        "data.zarr/histogram/c/1/0/0/0", "data.zarr/laser_points/c/1/0/0",
    ):  # fmt: skip
        path, kept = root / name, tmp_path / "kept"
        path.rename(kept)
        make(path)

        def read() -> list[int]:
            data = TransientDataset(root, ("histogram", "laser_points"))
            assert all(len(data[item]) == 3 for item in range(len(data)))
            data.parameters("width_m"), data.stats
            return data.scenes.tolist()

        with soon():
            found = told(lambda: verify(root, deep=True))
            assert found is None or found.problems, name
            told(lambda: info(root))
            assert told(read) in (None, due)
        path.unlink()
        kept.rename(path)
    assert verify(root, deep=True).problems == ()


@pytest.mark.parametrize("make", KINDS)
def test_who_has_locked_it(tmp_path: Path, make: Callable[[Path], None]) -> None:
    """A build that looks at the lock of a shard does not wait for what is in its place."""
    make(tmp_path / "shard.running")
    with soon():
        assert holder_of(tmp_path / "shard.running") == "somebody"
        sign_of_life(tmp_path / "shard.running")


def test_a_dataset_that_is_a_link_to_itself(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    root = tmp_path / "set"
    root.symlink_to(root.name)
    name, out = str(root), str(tmp_path / "out.npz")
    for command in (
        ["verify", name], ["info", name], ["digest", name], ["show", name, "0"], ["replay", name, "0"],
        ["preview", name], ["export", name, out, "--format", "npz"], ["baseline", "mean", name, out],
        ["score", name, out],
    ):  # fmt: skip
        assert run(command) == 2, command
        (line,) = capsys.readouterr().err.splitlines()
        assert "no such dataset" in line or "is no dataset" in line, line
    with pytest.raises(InputError, match="no such dataset"):
        TransientDataset(root)


UNGUARDED = {
    # Our own sources and pages, files that a build makes for itself, and what the system has.
    "compiled.py": 1, "report/explorer.py": 1, "building/build_from.py": 1, "building/shard_job.py": 1,
    "store/upload.py": 4, "store/environment.py": 1,
    # The guarded way itself, and objects of an object store.
    "untrusted.py": 1, "store/location.py": 1,
}  # fmt: skip
"""File below `datagen` → how often it opens a file to read without `untrusted.opened`."""


def test_files_are_opened_in_one_guarded_way() -> None:
    """A new way to open files fails here, so that whoever adds it thinks of what is no plain file."""
    package, found = Path(dg.__file__).parent, Counter[str]()
    for source in package.rglob("*.py"):
        for node in ast.walk(ast.parse(source.read_text())):
            called = node.func if isinstance(node, ast.Call) else None
            named = isinstance(called, ast.Name) and called.id == "open"
            of_a_path = isinstance(called, ast.Attribute) and called.attr in ("open", "read_bytes", "read_text")
            written = isinstance(node, ast.Call) and [
                arg.value for arg in node.args if isinstance(arg, ast.Constant)
            ] == ["xb"]
            of_a_module = isinstance(called, ast.Attribute) and ast.unparse(called.value) in (
                "os",
                "archive",
                "Image",
            )
            found[source.relative_to(package).as_posix()] += (named or of_a_path) and not (written or of_a_module)
    assert {name: times for name, times in found.items() if times} == UNGUARDED


def test_a_group_of_predictions_with_something_else_in_it(tmp_path: Path) -> None:
    from datagen.scoring.predictions import _arrays_of_file

    group = tmp_path / "group"
    group.mkdir()
    pipe(group / "zarr.json")
    with soon(), pytest.raises(InputError, match=r"zarr\.json: is no plain file"):
        _arrays_of_file(group, None)  # type: ignore[arg-type]
    pipe(tmp_path / "predictions.npz")
    with soon(), pytest.raises(InputError, match=r"predictions\.npz: is no plain file"):
        _arrays_of_file(tmp_path / "predictions.npz", None)  # type: ignore[arg-type]


def test_an_export_of_a_dataset_whose_card_is_a_pipe(tmp_path: Path) -> None:
    from datagen.formats import export

    root = tmp_path / "set"
    small_dataset(root)
    (root / "README.md").unlink()
    pipe(root / "README.md")
    with soon(), pytest.raises((InputError, CheckError)):
        export(root, tmp_path / "hub", "hub")
    shutil.rmtree(root)


@pytest.mark.parametrize("make", KINDS)
def test_what_is_written_takes_the_place_of_it(tmp_path: Path, make: Callable[[Path], None]) -> None:
    """Pages, pictures and files of a device or room: nobody waits for a reader, and nothing goes to a device."""
    root, ball = tmp_path / "set", dg.Part("ball", trimesh.creation.icosphere(1, 0.3), dg.Lambertian(0.6))
    small_dataset(root)
    for name, write in (
        ("page.html", lambda path: preview(root, path, 0)),
        ("picture.png", lambda path: save_png(new_figure(1), path)),
        ("room.glb", lambda path: dg.write_glb(dg.Scene.from_parts([ball]), path)),
        ("mine.yaml", lambda path: dg.write_device(dg.device("tmf8820"), path)),
    ):  # fmt: skip
        path = tmp_path / name
        make(path)
        with soon():
            write(path)
        assert path.is_file() and not path.is_symlink() and path.stat().st_size, name
