"""The key `detector.tdc_edges_ps`: measured edges of a TDC's bins, as numbers or from a file."""

from __future__ import annotations

import csv
import io
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from pydantic import BeforeValidator, ValidationInfo

from datagen.config.base import named_file
from datagen.errors import InputError, TooLargeError
from datagen.records.arrays import Floats
from datagen.records.checks import as_tdc_edges
from datagen.untrusted import one_line, read_npz, read_text, why_no_file

SUFFIXES = (".csv", ".csv.gz", ".npz")
DECIMALS = 3
"""Of a picosecond, to which edges from a file are rounded: no TDC is known better than a femtosecond, and a stored
configuration would be two and a half times as long with all digits of a file."""
MOST_EDGES = 2**20
"""Largest number of edges of a file, which a configuration stores as text: 8192 pixels with 128 bins each."""

Edges = tuple[tuple[float, ...], ...]


def read_tdc_edges(path: Path) -> Edges:
    """(pixel, edge) picoseconds from a file.

    path : .csv (also .gz), a row for each pixel. A table with a head and a column of numbers before it, as the
        calibrations of LinoSPAD2 are, has for each code the time at which it ends; rows without numbers are TDCs that
        were not calibrated, and are left out. A table of numbers alone has all edges, the first one 0. Or .npz with
        `edges_ps` (pixel, edge) or (edge,).

    Raises `InputError` for a file that is missing or holds no such edges.
    """
    if (why := why_no_file(path)) is not None:
        raise InputError(f"{path}: {why}; paths start at the configuration's folder")
    if not path.name.endswith(SUFFIXES):
        raise InputError(f"{path}: its suffix says no table of edges; they are {', '.join(SUFFIXES)}")
    with one_line(f"{path}: holds no edges of a TDC"):
        given = _npz(path) if path.suffix == ".npz" else _csv(path)
    edges = np.round(as_tdc_edges(str(path), given), DECIMALS)
    return tuple(tuple(row) for row in edges.tolist())


def _npz(path: Path) -> Floats:
    edges = read_npz(path, ["edges_ps"])[0]["edges_ps"]
    _check_number(path, edges.size)
    return np.asarray(edges, np.float64)


def _csv(path: Path) -> list[list[float]]:
    text = read_text(path)
    # Counted before the text is divided: each number takes twenty times its characters then.
    _check_number(path, text.count(b",") + text.count(b"\n"))
    rows = [row for row in csv.reader(io.StringIO(text.decode(), newline="")) if row]
    if rows and not rows[0][0].strip():
        return [[0.0, *map(float, row[1:])] for row in rows[1:] if any(row[1:])]
    return [list(map(float, row)) for row in rows]


def _check_number(path: Path, number: int) -> None:
    if number > MOST_EDGES:
        raise TooLargeError(f"{path}: {number} values; at most {MOST_EDGES} edges are read; keep the pixels needed")


def _edges_of(value: Any, info: ValidationInfo) -> Any:
    """Edges of a file's path or of numbers, which a dataset stores."""
    if isinstance(value, str):
        return read_tdc_edges(named_file(info, value))
    return tuple(tuple(row) for row in as_tdc_edges("edges", value).tolist())


MeasuredEdges = Annotated[Edges, BeforeValidator(_edges_of, json_schema_input_type=str | Edges | tuple[float, ...])]
