"""Labels of captures of DENALI (*A Dataset Enabling Non-Line-of-Sight Spatial Reasoning with Low-Cost LiDARs*, 2026),
which stand in the names of its folders and in a file of places.

`<object>_<size>_<grid>_<light>_NLOSdata/spad_histogram/<place>.npy` holds (repeat, row, column, bin) counts of a
TMF8828; `tag1_positions.json` has `"frame<place>_tag1": [x, y, z]`, metres in the world's frame of that data set.
"""

from __future__ import annotations

import json
import math
import re
from pathlib import Path
from typing import Any

from datagen.errors import InputError
from datagen.records.checks import as_given, option
from datagen.untrusted import one_line, read_text

_FOLDER = re.compile(r"(?P<object>[^_]+)_(?P<inches>\d{1,3})inch_\d+x\d+_light(?P<light>on|off)_NLOSdata")
_INCH_M = 0.0254


def denali_labels(
    path: Path, places: dict[int, tuple[float, float, float]] | None
) -> dict[str, str | int | float] | None:
    """Name → value of what the names of a file and of its folders, and the places, say of what is hidden; None for
    a file whose folders are not named like those of DENALI.

    `hidden.class`, `hidden.size_m`, `hidden.light` (on, off), `hidden.place` (the number of the place), and with
    places `hidden.x_m`, `hidden.y_m`, `hidden.z_m`. Raises `InputError` for a file without place where places are
    given.
    """
    resolved = path.resolve()
    found = _FOLDER.fullmatch(resolved.parent.parent.name)
    if found is None or resolved.parent.name != "spad_histogram" or not resolved.stem.isdecimal():
        if places is not None:
            raise InputError(
                f"{path}: no <object>_<size>_<grid>_<light>_NLOSdata/spad_histogram/<place>.npy, so that it has no "
                f"place; leave {option('places')} out"
            )
        return None
    number = int(resolved.stem)
    labels: dict[str, str | int | float] = {
        "hidden.class": found["object"],
        "hidden.size_m": round(int(found["inches"]) * _INCH_M, 4),
        "hidden.light": found["light"],
        "hidden.place": number,
    }
    if places is not None:
        if number not in places:
            raise InputError(f"{path}: {option('places')} has no frame{number}_tag1")
        labels |= dict(zip(("hidden.x_m", "hidden.y_m", "hidden.z_m"), places[number], strict=True))
    return labels


def read_places(path: Path) -> dict[int, tuple[float, float, float]]:
    """Number of a place → its (x, y, z), metres, of a file like `tag1_positions.json`. Raises `InputError` for
    others."""
    refusal = f"{as_given('places', str(path))}: holds no places of DENALI"
    with one_line(refusal):
        stored: Any = json.loads(read_text(path))
        if not isinstance(stored, dict):
            raise ValueError("names with three numbers each are needed")
        places = dict[int, tuple[float, float, float]]()
        for name, at in stored.items():
            number = re.fullmatch(r"frame(\d{1,6})_tag1", name)
            if number is None:
                continue
            x, y, z = (float(value) for value in at)
            if not all(map(math.isfinite, (x, y, z))):
                raise ValueError(f"{name} is not finite")
            places[int(number[1])] = x, y, z
    if not places:
        raise InputError(f"{refusal}: no frame…_tag1 in it")
    return places
