"""What a command says that a signal ends is true for that command."""

from __future__ import annotations

import importlib
import subprocess
import sys
from typing import NoReturn

import pytest

from datagen import exit_status
from datagen.cli import run
from datagen.errors import InputError
from datagen.exit_status import CHANGED_NOTHING, GOES_ON

ANEW = "not finished, run the same command again: it begins anew"
FINISHED_FILES = "files that are finished stay, the same command writes all of them again"
KILLED = """
import os, signal
import datagen.devices
datagen.devices.read_frames = lambda path: os.kill(os.getpid(), signal.SIGTERM)
from datagen.cli import main
main(["compare", "a.npz", "--device", "tmf8820", "--mesh", "a.stl"])
"""


def test_a_command_that_is_ended_says_so_in_one_line() -> None:
    ended = subprocess.run([sys.executable, "-c", KILLED], capture_output=True, text=True, check=False)
    assert (ended.returncode, ended.stderr) == (143, f"datagen: terminated; {ANEW}\n")


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
