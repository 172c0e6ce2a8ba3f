"""What a build shows while it runs, and what a command says that a signal ends."""

from __future__ import annotations

import importlib
import os
import pty
import re
from typing import NoReturn

import pytest

from datagen import exit_status
from datagen.building import progress
from datagen.building.progress import Progress
from datagen.cli import run
from datagen.errors import InputError
from datagen.exit_status import CHANGED_NOTHING, GOES_ON


def shown_on_a_terminal(monkeypatch: pytest.MonkeyPatch, kind: str) -> str:
    """What a terminal gets of a build: of two shards under way one ends; then the worker of the other dies, and it
    begins anew."""
    ours, theirs = pty.openpty()
    monkeypatch.setenv("TERM", kind)
    with os.fdopen(theirs, "w") as stderr:
        monkeypatch.setattr("sys.stderr", stderr)
        shown = Progress(True)
        shown.doing("starting")
        shown.doing("compiling")
        shown.begin(16, 0)
        for done, in_work, failures in ((13, (7, 12), 0), (8, (8,), 1), (14, (14,), 1), (16, (), 1)):
            shown.update(done, in_work, failures)
        shown.close()
        print(end="END", file=stderr, flush=True)
        said = b""
        while not said.endswith(b"END"):
            said += os.read(ours, 1024)
    os.close(ours)
    return said.removesuffix(b"END").decode()


def test_a_bar_says_what_is_in_work_and_never_runs_backwards(monkeypatch: pytest.MonkeyPatch) -> None:
    said = shown_on_a_terminal(monkeypatch, "xterm")
    counts = [int(count) for count in re.findall(r"(\d+)/16", said)]
    assert counts == sorted(counts) and {0, 13, 16} <= set(counts)
    places = [said.index(text) for text in ("starting", "compiling", "scene 7 and 1 more", "failed=1")]
    assert places == sorted(places)


def test_a_dumb_terminal_gets_lines(monkeypatch: pytest.MonkeyPatch) -> None:
    first, last = shown_on_a_terminal(monkeypatch, "dumb").splitlines()
    assert first.startswith("13 of 16 scenes, ") and last.startswith("16 of 16 scenes, 1 failed, ")


def test_a_log_gets_a_line_now_and_then(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    now = [0.0]
    monkeypatch.setattr(progress.time, "monotonic", lambda: now[0])
    shown = Progress(True)
    for step in ("checking", *["compiling"] * 100):
        now[0] += 1.0
        shown.doing(step)
    assert capsys.readouterr().err == "compiling\n"
    now[0] = 0.0
    shown.begin(1000, 0)
    for scene in range(1000):
        now[0] += 1.0
        shown.update(scene, [scene], 0)
    for _ in range(5):
        shown.update(1000, (), 0)
    *lines, last = capsys.readouterr().err.splitlines()
    assert last == "1000 of 1000 scenes, 1 scenes/s, 0 s left"
    assert lines[0] == "0 of 1000 scenes; scene 0 in work" and "10 of 1000 scenes, 0.91 scenes/s" in lines[1]
    # Every ten seconds, later at each twentieth of the time.
    assert 40 < len(lines) < 70


def test_a_log_gets_no_line_twice(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    """Steps that recur, a scene that takes an hour, and tables that are written after the last scene."""
    now = [progress.LINE_S]
    monkeypatch.setattr(progress.time, "monotonic", lambda: now[0])
    shown = Progress(True)
    now[0] *= 2
    for step in ("fit", "trial", "fit", "trial"):
        now[0] += progress.LINE_S
        shown.doing(step)
    shown.begin(3, 0)
    for done, in_work, failures in ((0, (0,), 0), (1, (1,), 0), (2, (2,), 1), (3, (2,), 1), (3, (), 1)):
        for _ in range(10):
            now[0] += 360.0
            shown.update(done, in_work, failures)
    said = [re.sub(r", [\d.e-]+ scenes/s, \d+ s left", "", line) for line in capsys.readouterr().err.splitlines()]
    scenes = ["0 of 3 scenes; scene 0 in work", "1 of 3 scenes; scene 1 in work"]
    assert said == ["fit", "trial", *scenes, "2 of 3 scenes, 1 failed; scene 2 in work", "3 of 3 scenes, 1 failed"]


ANEW = "not finished, run the same command again: it begins anew"
FINISHED_FILES = "files that are finished stay, the same command writes all of them again"


@pytest.mark.parametrize(
    ("work", "command", "said"),
    [
        ("datagen.devices read_frames", "compare a.npz --device tmf8820 --mesh a.stl", ANEW),
        ("datagen.config load_config", "plan a.yaml", ANEW),
        ("datagen.store verify", "verify out", CHANGED_NOTHING),
        ("datagen.formats export", "export out files --format npz", FINISHED_FILES),
        ("datagen.config load_config", "build a.yaml out", GOES_ON),
        ("datagen.formats import_captures", "import a.npz out", GOES_ON),
    ],
)
def test_what_a_signal_would_leave_is_known_before_the_work_begins(
    work: str, command: str, said: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    def begun(*_: object, **__: object) -> NoReturn:
        raise InputError("the work begins")

    module, function = work.split()
    monkeypatch.setattr(exit_status, "_at_end", [ANEW])
    monkeypatch.setattr(importlib.import_module(module), function, begun)
    assert run(command.split()) == 2 and exit_status._at_end == [said]
