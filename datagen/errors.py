"""What goes wrong, told to the person who can mend it."""

from __future__ import annotations


class InputError(ValueError):
    """Bad input of any kind: the message is one line naming key, value, allowed range and remedy.

    The command line prints it without a traceback and exits with status 2.
    """


class InputWarning(UserWarning):
    """Input that is legal and most likely not meant: an aperture of 20 m, bins of 100 s, a scene in millimetres."""


class CheckError(RuntimeError):
    """A check that was asked for did not pass (exit status 1): a corrupt dataset, scenes that failed."""


def printable(text: str) -> str:
    """Text with control characters written as escapes, but for the ends of its lines: it may come from anywhere, and
    goes to terminals."""
    return "".join(c if c == "\n" or c.isprintable() else ascii(c)[1:-1] for c in text)
