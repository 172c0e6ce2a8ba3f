"""How a command ends."""

from __future__ import annotations

import subprocess
import sys

import pytest

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


STEPS = """
import gc, os, signal, sys
from datagen import exit_status

def command():
    try:
        {command}
    except BaseException:
        if not {swallows}:
            raise
    return 0

def ended_at(step):
    # Exit status and last words of a process that gets the signal before a step of `exit_with`; None: no such step.
    reader, writer = os.pipe()
    child = os.fork()
    if child:
        os.close(writer)
        with open(reader) as said:
            text = said.read()
        status = os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])
        return None if status == 99 else (status, text)
    os.dup2(writer, 2)
    left = step

    def trace(frame, event, argument):
        nonlocal left
        if frame.f_code is not exit_status.exit_with.__code__:
            return None
        frame.f_trace_opcodes = True
        left -= event == "opcode"
        if event == "opcode" and left == 0:
            sys.settrace(None)
            if {when}:
                os.kill(os.getpid(), signal.{sent})
        return trace

    sys.settrace(trace)
    try:
        exit_status.exit_with(command)
    except SystemExit:
        if left > 0:
            os._exit(99)
        raise

gc.freeze()
outcomes, step = [], 1
while (outcome := ended_at(step)) is not None:
    outcomes.append(outcome)
    step += {stride}
print(step, {{*outcomes}})
"""
"""Processes that get a signal, each before another step of `exit_with`."""
HANDLED = "callable(signal.getsignal(signal.SIGTERM))"
"""Before it is handled a signal is Python's matter, and later it is ignored."""


@pytest.mark.parametrize("stride", [5, pytest.param(1, marks=pytest.mark.nightly)], ids=["some", "each"])
@pytest.mark.parametrize(
    ("command", "swallows", "sent", "when", "due"),
    [
        ("pass", False, "SIGTERM", HANDLED, {0, 143}),
        ("raise OSError", True, "SIGTERM", HANDLED, {0, 143}),
        ("os.kill(os.getpid(), signal.SIGTERM)", False, "SIGALRM", "exit_status._received", {143}),
        ("os.kill(os.getpid(), signal.SIGTERM)", True, "SIGALRM", "exit_status._received", {143}),
    ],
    ids=["it does nothing", "it fails", "it ends", "it goes on"],
)
def test_a_signal_or_the_alarm_at_any_step_ends_in_one_line(
    command: str, swallows: bool, sent: str, when: str, due: set[int], stride: int
) -> None:
    """What `exit_with` does after the command is as safe from signals as the command itself."""
    code = STEPS.format(command=command, swallows=swallows, sent=sent, when=when, stride=stride)
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    steps, _, outcomes = done.stdout.partition(" ")
    line = "datagen: terminated; not finished, run the same command again: it begins anew\n"
    assert int(steps) > 50
    assert eval(outcomes) == {(status, line if status == 143 else "") for status in due}
