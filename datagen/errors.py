"""Errors and warnings for users: each message is one line that says what to do."""

from __future__ import annotations

LONGEST_SHOWN = 60
"""Most characters of a value in an error message, enough for a short list. Longer texts are cut, longer values of
other kinds shown by their type."""


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


def shown(value: object) -> str:
    """A value in one short line: its `repr` where that is short, else the beginning of a text, the shape of an array,
    or the type."""
    shape = getattr(value, "shape", None)
    if isinstance(shape, tuple) and shape:
        return f"an array of shape {shape}"
    if isinstance(value, type):
        return f"the class {value.__name__}"
    try:
        text = repr(value)
    except Exception:
        # Of a whole number of thousands of digits, or of a user's own class: nothing that a message could show.
        text = ""
    if isinstance(value, str) and len(text) > LONGEST_SHOWN:
        return f"{value[:LONGEST_SHOWN]!r}…"
    # What begins with < is Python's own name of an object, with its place in memory.
    is_short = 0 < len(text) <= LONGEST_SHOWN and not text.startswith("<") and text.isprintable()
    name = type(value).__name__
    return text if is_short else f"{'an' if name[0] in 'aeiouAEIOU' else 'a'} {name}"
