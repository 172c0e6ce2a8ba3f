"""How a command ends."""

from __future__ import annotations

import subprocess
import sys

WRONG = """
import os, signal, click
from datagen.errors import InputError
from datagen.exit_status import exit_with, guarded

@click.command()
def command():
    {before}
    raise InputError("scenes: must be a whole number, such as 32")

exit_with(lambda: guarded(command, []))
"""
"""A command that ends by bad input."""
IMPORTED = """try:
        os.kill(os.getpid(), signal.SIGTERM)
    except BaseException:
        pass"""
"""A library that is being imported makes an error of its own of whatever is raised in it."""


def ended(code: str) -> tuple[int, str]:
    """Exit status, and what a process said on standard error."""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    return done.returncode, done.stderr


def test_bad_input_is_one_line() -> None:
    assert ended(WRONG.format(before="pass")) == (2, "datagen: scenes: must be a whole number, such as 32\n")


def test_what_goes_wrong_after_a_signal_is_the_signals_doing() -> None:
    """One line says that it was terminated, and none that input was bad."""
    status, said = ended(WRONG.format(before=IMPORTED))
    assert status == 143
    assert said == "datagen: terminated; not finished, run the same command again: it begins anew\n"
