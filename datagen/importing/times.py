"""Time bins and sizes as a file or an option says them."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Literal

from datagen.config.capture import TimeConfig
from datagen.config.imported import ImportOptions
from datagen.errors import InputError

SAME = 1e-6
"""Relative difference up to which a file and an option say the same."""
_SECONDS = {"fs": 1e-15, "ps": 1e-12, "ns": 1e-9, "us": 1e-6, "s": 1.0}
_METRES = {"mm": 1e-3, "cm": 1e-2, "m": 1.0}
_NUMBER = r"(\d+(?:\.\d*)?(?:[eE][+-]?\d+)?)"


def time_bins(
    path: Path, bins: int, width_s: float | None, options: ImportOptions, *, start_s: float,
    origin: Literal["source", "wall"], named: str,
) -> TimeConfig:  # fmt: skip
    """The time axis, its width from the file (`width_s`) or the options.

    Raises `InputError` where neither or both differently say the width, and for what is no time axis.
    """
    asked = None if options.bin_width_ps is None else options.bin_width_ps * 1e-12
    if width_s is None and asked is None:
        raise InputError(f"{path}: {named}: missing; say how wide a bin is: --bin 4ps")
    if width_s is not None and asked is not None and abs(width_s - asked) > SAME * asked:
        raise InputError(f"{path}: says {named} of {width_s * 1e12:g} ps, --bin {asked * 1e12:g}ps; leave --bin out")
    width = width_s if width_s is not None else asked
    assert width is not None
    try:
        # Digits beyond the twelfth are those of having converted it.
        return TimeConfig(
            bins=bins, bin_width_ps=float(f"{width * 1e12:.12g}"), start_ns=float(f"{start_s * 1e9:.12g}"),
            origin=origin,
        )  # fmt: skip
    except InputError as error:
        raise InputError(f"{path}: {str(error).removeprefix('TimeConfig: ')}") from None


def seconds_of(text: str) -> float:
    """`"4ps"` → 4e-12. Raises `InputError` for what is no time."""
    found = re.fullmatch(rf"{_NUMBER}\s*(fs|ps|ns|us|s)", text.strip())
    if found is None or float(found[1]) <= 0:
        raise InputError(f"--bin {text}: must be a time such as 4ps or 0.032ns")
    return float(found[1]) * _SECONDS[found[2]]


def metres_of(text: str) -> tuple[float, float]:
    """`"2m"` → (2, 2), `"2m x 150cm"` → (2, 1.5): width and height. Raises `InputError` for what are none."""
    unit = r"\s*(mm|cm|m)"
    found = re.fullmatch(rf"{_NUMBER}{unit}(?:\s*[x×]\s*{_NUMBER}{unit})?", text.strip())
    if found is None:
        raise InputError(f"--wall {text}: must be a size such as 2m, or width and height such as 2m x 150cm")
    width = float(found[1]) * _METRES[found[2]]
    return width, width if found[3] is None else float(found[3]) * _METRES[found[4]]
