"""Checks of arguments. Each raises an `InputError` of one line that names argument, value and remedy."""

from __future__ import annotations

import os
import sys
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray

from datagen.errors import InputError, shown
from datagen.records.arrays import Floats, Ints

LONGEST_NAME = 100
"""Most characters of a name: a longer one would fill the legend of a picture."""
TDC_PERIOD_ACCURACY = 1e-5
"""Relative accuracy to which the edges of a TDC's bins must fill its period, such as those of rounded tables:
a bin of 2.5 ns / 140 may be written as 17.857 ps."""


def check_number(record: str, name: str, value: object, low: float, high: float, remedy: str) -> None:
    """Raise `InputError` unless `value` is a real number in low … high."""
    is_number = isinstance(value, (int, float, np.integer, np.floating)) and not isinstance(value, bool)
    if not is_number or not low <= value <= high:  # type: ignore[operator]
        raise InputError(f"{record}.{name} = {shown(value)}: must be a number in {low:g} … {high:g} ({remedy})")


def check_integer(record: str, name: str, value: object, low: int, high: int) -> None:
    """Raise `InputError` unless `value` is an integer in low … high."""
    if not isinstance(value, (int, np.integer)) or isinstance(value, bool) or not low <= value <= high:
        raise InputError(f"{record}.{name} = {shown(value)}: must be an integer in {low} … {high}")


def check_seed(value: object) -> None:
    """Raise `InputError` unless `value` is an integer in 0 … 2⁶⁴ − 1."""
    if not isinstance(value, (int, np.integer)) or isinstance(value, bool) or not 0 <= value < 2**64:
        raise InputError(f"{as_given('seed', value)}: must be an integer in 0 … 2^64 − 1")


def check_flag(name: str, value: object, remedy: str = "") -> None:
    """Raise `InputError` unless `value` is True or False."""
    if not isinstance(value, (bool, np.bool_)):
        raise InputError(f"{name} = {shown(value)}: must be True or False{f'; {remedy}' if remedy else ''}")


def check_name(name: str, value: object) -> None:
    """Raise `InputError` unless `value` can name a part, a class or a parameter in a line of text."""
    check_kind(name, value, str)
    assert isinstance(value, str)
    if not 1 <= len(value) <= LONGEST_NAME or not value.isprintable():
        raise InputError(
            f"{name} = {shown(value)}: must have 1 … {LONGEST_NAME} printable characters; choose a plainer name"
        )


def check_choice(name: str, value: object, allowed: tuple[str, ...]) -> None:
    """Raise `InputError` unless `value` is one of the words allowed."""
    if not isinstance(value, str) or value not in allowed:
        raise InputError(f"{name} = {shown(value)}: must be one of {', '.join(allowed)}")


def check_kind(name: str, value: object, *kinds: type, remedy: str = "") -> None:
    """Raise `InputError` unless `value` is one of `kinds`."""
    if not isinstance(value, kinds):
        wanted = " or ".join(kind.__name__ for kind in kinds)
        raise InputError(f"{name} = {shown(value)}: {wanted} needed{f'; {remedy}' if remedy else ''}")


def check_mapping(name: str, value: object, *kinds: type, remedy: str) -> None:
    """Raise `InputError` unless `value` is a mapping of texts to values of one of `kinds`."""
    if not isinstance(value, Mapping):
        raise InputError(f"{name} = {shown(value)}: Mapping needed; {remedy}")
    for key, item in value.items():
        check_kind(f"{name}: key", key, str, remedy=remedy)
        check_kind(f"{name}[{key!r}]", item, *kinds, remedy=remedy)


def check_callable(name: str, value: object, remedy: str) -> None:
    """Raise `InputError` unless `value` is None or can be called."""
    if value is not None and not callable(value):
        raise InputError(f"{name} = {shown(value)}: must be a function; {remedy}")


def check_path(name: str, value: object, remedy: str) -> None:
    """Raise `InputError` unless `value` can be a path."""
    check_kind(name, value, str, os.PathLike, remedy=remedy)
    if "\0" in str(value):
        raise InputError(f"{name} = {shown(value)}: no path has a null character; {remedy}")


def as_paths(name: str, value: object, remedy: str) -> list[Path]:
    """`value`, a path or several, as paths; raises `InputError` for anything else."""
    if isinstance(value, str | os.PathLike):
        check_path(name, value, remedy)
        return [Path(value)]
    check_kind(name, value, str, os.PathLike, Sequence, remedy=remedy)
    assert isinstance(value, Sequence)
    for number, path in enumerate(value):
        check_path(f"{name}[{number}]", path, remedy)
    return [Path(path) for path in value]


def as_names(name: str, value: object, remedy: str) -> tuple[str, ...]:
    """`value`, a text or several, as texts; raises `InputError` for anything else."""
    if isinstance(value, str):
        return (value,)
    check_kind(name, value, str, Iterable, remedy=remedy)
    assert isinstance(value, Iterable)
    names = tuple(value)
    for one in names:
        check_kind(name, one, str, remedy=remedy)
    return names


def as_rows(name: str, value: object, count: int) -> Ints:
    """Numbers of the rows that `value` chooses of `count`: a slice, numbers (from the end if negative) or a mask.

    Raises `InputError` for anything else, and for numbers that are out of range.
    """
    everything = np.arange(count)
    try:
        return everything[value if isinstance(value, slice) else _numbers(value)]
    except (IndexError, TypeError, ValueError, OverflowError):
        raise InputError(
            f"{name} = {shown(value)}: must be numbers in 0 … {count - 1}, a mask of {count} values, or a slice"
        ) from None


def _numbers(value: object) -> NDArray[np.generic]:
    """Whole numbers or truth values; raises `TypeError` for anything else."""
    array = np.asarray(value)
    if array.ndim != 1 or array.dtype.kind not in "iub":
        raise TypeError
    return array


def check_reals(name: str, value: object, shape: tuple[int | None, ...]) -> None:
    """Raise `InputError` unless `value` is an array of real numbers of the wanted shape (None: any size)."""
    check_kind(name, value, np.ndarray)
    assert isinstance(value, np.ndarray)
    fits = value.ndim == len(shape) and all(w is None or w == g for g, w in zip(value.shape, shape, strict=False))
    if not fits or value.dtype.kind not in "fiu":
        wanted = ", ".join("n" if size is None else str(size) for size in shape)
        raise InputError(f"{name}: {value.dtype} {value.shape} given, real numbers of shape ({wanted}) needed")


def numbers_of(what: str, text: str, count: int) -> list[int]:
    """`"0-2,7"` → the numbers, ascending, each once; raises `InputError` for numbers that are not in 0 … count − 1.

    what : "shards" or "scenes", as the argument is called.
    """
    asked = as_given(what, text)
    chosen: set[int] = set()
    for piece in text.split(","):
        first, dash, last = piece.partition("-")
        try:
            low, high = int(first), int(last) if dash else int(first)
        except ValueError:
            raise InputError(f"{asked}: must be numbers and ranges such as 0-99 or 3,7-9") from None
        if low > high:
            raise InputError(f"{asked}: the range {piece} is upside down; write the smaller number first")
        if high >= count:
            raise InputError(f"{asked}: this dataset has the {what} 0-{count - 1}")
        chosen.update(range(low, high + 1))
    return sorted(chosen)


def option(argument: str) -> str:
    """How the user at work writes an argument: `--scenes` on the command line, `scenes` in Python."""
    # Only whoever is on the command line has imported it, and then a command has a context.
    click = sys.modules.get("click")
    context = None if click is None else click.get_current_context(silent=True)
    if context is None or not str(getattr(context.command.callback, "__module__", "")).startswith("datagen."):
        return argument
    for parameter in context.command.params:
        if parameter.name == argument:
            # An argument of a command is written in capitals, and has no option in front.
            first = str(parameter.opts[-1])
            return first if first.startswith("-") else str(parameter.human_readable_name).strip("[]")
    return f"--{argument.replace('_', '-')}"


def as_given(argument: str, value: object) -> str:
    """An argument with its value, as the user at work writes them: `--scenes 3`, or `scenes = 3` in Python."""
    name = option(argument)
    if not name.startswith("-"):
        return f"{name} = {shown(value)}"
    return name if value is True else f"{name} {value}"


def as_reals(name: str, value: ArrayLike) -> Floats:
    """`value` as an array of float64; raises `InputError` for ragged rows and for anything but real numbers."""
    try:
        array = np.asarray(value)
    except (TypeError, ValueError, RuntimeError):
        raise InputError(f"{name}: rows of different lengths; an array of real numbers is needed") from None
    if array.dtype.kind not in "fiu":
        found = shown(value) if array.dtype.kind in "OUS" else f"{array.dtype} numbers"
        raise InputError(f"{name} = {found}: an array of real numbers is needed")
    return array.astype(np.float64, copy=False)


def as_shaped(name: str, value: ArrayLike, shape: tuple[int | None, ...]) -> Floats:
    """Real numbers, a read-only copy of the wanted shape (None: any size from 1); else `InputError`."""
    array = as_reals(name, value)
    fits = array.ndim == len(shape) and all(w is None or w == g for g, w in zip(array.shape, shape, strict=False))
    if not fits or array.size == 0:
        wanted = ", ".join("n" if s is None else str(s) for s in shape)
        needed = f"({wanted}{',' if len(shape) == 1 else ''})"
        raise InputError(
            f"{name}: shape {array.shape} given, {needed} needed{' with n ≥ 1' if None in shape else ''}"
        )
    array = array.copy()
    array.setflags(write=False)
    return array


def as_weights(name: str, value: ArrayLike, shape: tuple[int | None, ...]) -> Floats:
    """Finite numbers ≥ 0, a read-only copy of the wanted shape (None: any size from 1); else `InputError`."""
    array = as_shaped(name, value, shape)
    if not (np.isfinite(array) & (array >= 0)).all():
        raise InputError(f"{name}: holds numbers that are negative or not finite; give finite numbers ≥ 0")
    return array


def as_points(name: str, value: ArrayLike, shape: tuple[int | None, ...]) -> Floats:
    """Coordinates in metres, a read-only copy of the wanted shape (None: any size from 1); else `InputError`."""
    array = as_shaped(name, value, shape)
    check_places(name, array)
    return array


FARTHEST_M = 1e9
"""Largest coordinate. Fourth powers of larger ones overflow single precision."""


def check_places(name: str, points: Floats) -> None:
    """Raise `InputError` for coordinates that are not finite or farther than `FARTHEST_M`."""
    if not np.isfinite(points).all():
        count = np.count_nonzero(~np.isfinite(points))
        raise InputError(f"{name}: {count} coordinates are NaN or infinite; all must be finite metres")
    largest = float(np.abs(points).max(initial=0.0))
    if largest > FARTHEST_M:
        raise InputError(f"{name}: a coordinate of {largest:.3g} m; at most {FARTHEST_M:g} m are handled")


def as_tdc_edges(name: str, value: ArrayLike) -> Floats:
    """Edges (pixel, edge) of a TDC's bins over one period, from (pixel, edge) or (edge,) for all pixels alike.

    Raises `InputError` for what is no such table, and for edges that do not start at 0, descend, or end at different
    times.
    """
    edges = as_reals(name, value)
    if edges.ndim not in (1, 2) or edges.shape[-1] < 2 or edges.size == 0:
        raise InputError(
            f"{name}: shape {edges.shape} given; (pixel, edge) or (edge,) is needed, with one edge more than the "
            "period has bins"
        )
    edges = np.atleast_2d(edges)
    lengths = edges[:, -1]
    with np.errstate(invalid="ignore"):
        wrong = ~(np.isfinite(edges).all(axis=1) & (edges[:, 0] == 0) & (np.diff(edges) >= 0).all(axis=1))
        wrong |= ~((lengths > 0) & (np.abs(lengths - lengths[0]) <= TDC_PERIOD_ACCURACY * lengths[0]))
    if wrong.any():
        pixel = int(wrong.argmax())
        first, second, last = edges[pixel][[0, 1, -1]]
        raise InputError(
            f"{name}[{pixel}] = ({first:g}, {second:g}, …, {last:g}): edges must start at 0 and never descend, and "
            f"those of all pixels must end at the same time; correct them ({wrong.sum()} such pixels)"
        )
    return edges
