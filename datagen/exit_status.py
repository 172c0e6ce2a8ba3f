"""Exit statuses: 0 success, 1 a check failed, 2 bad input (one line on standard error), 130 Ctrl-C, 143 SIGTERM."""

from __future__ import annotations

import atexit
import logging
import os
import signal
import sys
import warnings
from collections.abc import Callable, Sequence
from contextlib import suppress
from typing import Any, NoReturn

import click

from datagen.errors import CheckError, InputError, printable

WORDS: dict[int, str] = {signal.SIGINT: "interrupted", signal.SIGTERM: "terminated"}
"""Signal → what the last line of the process calls it."""
AGAIN_S = 0.1
"""Seconds after which `Ended` is raised again where a library swallowed it."""


GOES_ON = "what is committed stays, run the same command again to go on"
"""What a command says that was ended by a signal and finds again what it did."""
CHANGED_NOTHING = "nothing was changed, run the same command again"
"""What a command says that was ended by a signal and only reads."""
_at_end = ["not finished, run the same command again: it begins anew"]
"""What the command at work says when a signal ends it; true for commands that do not name anything else."""
_received = list[int]()
"""Signals that end this process. What goes wrong after the first of them is its doing, and nothing is said of it."""


def say(text: object, err: bool = False) -> None:
    """Print what a command has to say, to standard output or (`err`) standard error. Whatever names of files,
    datasets and scenes hold, no character steers the terminal."""
    click.echo(printable(str(text)), err=err)


def if_ended(what: str) -> None:
    """Let the last line of this process say `what`, should a signal end the command that is at work."""
    _at_end[:] = [what]


class Ended(SystemExit):
    """Raised in the main thread of a process that got Ctrl-C or SIGTERM, so that the process clears up."""


def exit_with(command: Callable[[], int]) -> NoReturn:
    """Run a command as all that this process does, and exit with its status; signals end it with one line."""
    _received.clear()
    # First, so that it is the last of what Python does at its end.
    atexit.register(_leave, os.getpid())
    is_over = False

    def end(number: int, _: object) -> None:
        _received.append(number)
        if is_over:
            # Nothing is left to be ended, and the alarm must not ring in a process that handles it no more.
            return
        # Nobody has to know what a library could not finish.
        warnings.simplefilter("ignore", RuntimeWarning)
        logging.getLogger("asyncio").disabled = True
        # Libraries that are being imported swallow what is raised in them, or raise errors of their own instead.
        signal.setitimer(signal.ITIMER_REAL, AGAIN_S)
        if not _is_clearing_up():
            raise Ended(128 + _received[0])

    # A shell makes its background processes ignore Ctrl-C, and that stays so.
    handled = [number for number in (*WORDS, signal.SIGALRM) if signal.getsignal(number) != signal.SIG_IGN]
    sys.unraisablehook = _unraisable
    status = 0
    try:
        # A signal may come between any two steps until `is_over` is set. What `end` raises in this block ends it, and
        # nothing more is raised while that is being handled.
        try:
            for number in handled:
                # Not as a KeyboardInterrupt: after one during an import Python may kill itself instead of returning a
                # status.
                signal.signal(number, end)
            status = command()
            is_over = True
        except BaseException:
            is_over = True
            if not _received:
                raise
    except Ended:
        is_over = True
    finally:
        # One more signal, while Python ends, would print a traceback.
        for number in handled:
            signal.signal(number, signal.SIG_IGN)
    if _received:
        status = 128 + _received[0]
        # A terminal has printed ^C.
        print(end="\n" if sys.stderr.isatty() else "", file=sys.stderr)
        _say(f"{WORDS.get(_received[0], 'ended by an alarm')}; {_at_end[0]}")
    sys.exit(status)


def _leave(process: int) -> None:
    """End this process if a signal ended its command. After Python a library in C, whose import the signal cut short,
    may exit with a status of its own."""
    if _received and os.getpid() == process:
        for stream in (sys.stdout, sys.stderr):
            with suppress(OSError, ValueError):
                stream.flush()
        os._exit(128 + _received[0])


def _is_clearing_up() -> bool:
    """Whether this thread is handling an `Ended` already: another signal must not cut that short."""
    error = sys.exception()
    while error is not None and not isinstance(error, Ended):
        error = error.__context__
    return error is not None


def _unraisable(unraisable: sys.UnraisableHookArgs) -> None:
    # An `Ended` that was raised in a destructor is lost there, and will be raised again.
    if not isinstance(unraisable.exc_value, Ended):
        sys.__unraisablehook__(unraisable)


def guarded(command: click.Command, arguments: Sequence[str] | None = None, name: str | None = None) -> int:
    """The exit status of a click command, which is run; errors and warnings become lines on standard error."""
    show_others = warnings.showwarning

    def show(message: Warning | str, category: type[Warning], *where: Any, **more: Any) -> None:
        if category.__module__.startswith("datagen."):
            _complain(f"warning: {message}", 0)
        else:
            show_others(printable(str(message)), category, *where, **more)

    warnings.showwarning = show
    try:
        status = command.main(arguments, prog_name=name, standalone_mode=False)
        sys.stdout.flush()
        return status if isinstance(status, int) else 0
    except click.ClickException as error:
        return _complain(_one_line(error), 2)
    except (InputError, CheckError) as error:
        return _complain(str(error), 2 if isinstance(error, InputError) else 1)
    except BrokenPipeError:
        # The reader of our output (such as `head`) has closed it. Nothing more may be written, not even at exit.
        with suppress(OSError, ValueError, AttributeError):
            os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 0
    except OSError as error:
        return _complain(f"{error.filename or 'input/output'}: {error.strerror or error}", 2)
    finally:
        warnings.showwarning = show_others


def _one_line(error: click.ClickException) -> str:
    command = error.ctx.command_path if isinstance(error, click.UsageError) and error.ctx else "datagen"
    text = " ".join(error.format_message().split()).rstrip(".")
    return f"{text[:1].lower()}{text[1:]}; see `{command} --help`"


def _complain(message: str, status: int) -> int:
    """`status`, after a line on standard error."""
    if not _received:
        _say(message)
    return status


def _say(message: str) -> None:
    with suppress(BrokenPipeError):
        print(f"datagen: {printable(' '.join(message.split()))}", file=sys.stderr, flush=True)
