"""Errors and warnings for users: each message is one line that says what to do."""

from __future__ import annotations


class InputError(ValueError):
    """Bad input of any kind: the message is one line naming key, value, allowed range and remedy.

    The command line prints it without a traceback and exits with status 2.
    """


class TooLargeError(InputError):
    """A file that would take more memory than its kind ever needs, most likely made to do so."""


class InputWarning(UserWarning):
    """Input that is legal and most likely not meant: an aperture of 20 m, bins of 100 s, a scene in millimetres."""


class CheckError(RuntimeError):
    """A check did not pass (exit status 1): a corrupt dataset, scenes that failed."""


def printable(text: str) -> str:
    """`text` with its control characters, except line ends, as escapes: text from files must not steer a terminal."""
    return "".join(c if c == "\n" or c.isprintable() else ascii(c)[1:-1] for c in text)


def as_line(text: str) -> str:
    """`text` as one line: line ends are spaces, other control characters escapes."""
    return printable(" ".join(text.splitlines()))
