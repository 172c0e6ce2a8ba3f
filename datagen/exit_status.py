"""Exit statuses: 0 success, 1 a check failed, 2 bad input (one line on standard error), 130 interrupted."""

from __future__ import annotations

import os
import sys
import warnings
from collections.abc import Sequence
from contextlib import suppress
from typing import Any

import click

from datagen.errors import CheckError, InputError, InputWarning, printable

INTERRUPTED = 130


def guarded(command: click.Command, arguments: Sequence[str] | None = None, name: str | None = None) -> int:
    """The exit status of a click command, which is run; errors and warnings for the user become one line each on
    standard error."""
    otherwise = warnings.showwarning

    def told(message: Warning | str, category: type[Warning], *where: Any, **more: Any) -> None:
        if issubclass(category, InputWarning):
            _complain(f"warning: {message}", 0)
        else:
            otherwise(message, category, *where, **more)

    warnings.showwarning = told
    try:
        status = command.main(arguments, prog_name=name, standalone_mode=False)
        sys.stdout.flush()
        return status if isinstance(status, int) else 0
    except click.ClickException as error:
        return _complain(_one_line(error), 2)
    except InputError as error:
        return _complain(str(error), 2)
    except CheckError as error:
        return _complain(str(error), 1)
    except (KeyboardInterrupt, click.Abort):
        return _complain("interrupted; what is committed stays, run the same command again to go on", INTERRUPTED)
    except BrokenPipeError:
        # The reader of our output (such as `head`) has closed it. Nothing more may be written, not even at exit.
        _silence(sys.stdout)
        return 0
    except OSError as error:
        return _complain(f"{error.filename or 'input/output'}: {error.strerror or error}", 2)
    finally:
        warnings.showwarning = otherwise


def _one_line(error: click.ClickException) -> str:
    command = error.ctx.command_path if isinstance(error, click.UsageError) and error.ctx else "datagen"
    text = " ".join(error.format_message().split()).rstrip(".")
    return f"{text[:1].lower()}{text[1:]}; see `{command} --help`"


def _complain(message: str, status: int) -> int:
    with suppress(BrokenPipeError):
        print(f"datagen: {printable(' '.join(message.split()))}", file=sys.stderr, flush=True)
    return status


def _silence(stream: object) -> None:
    with suppress(OSError, ValueError, AttributeError):
        os.dup2(os.open(os.devnull, os.O_WRONLY), stream.fileno())  # type: ignore[attr-defined]
