"""Reading predictions from a file or a mapping, with one line for each error that they can have."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from datagen.config.base import near_hint
from datagen.errors import InputError
from datagen.records.arrays import Bools, Floats
from datagen.scoring.truth import Truth
from datagen.untrusted import check_expansion, one_line, read_npz, why_no_file

QUANTITIES = ("depth", "mask", "points", "occupancy", "centers")
SUITE = "suite"
"""Array with the name of the dataset that was predicted; it may be left out."""
FAR = 50.0
"""Predictions lie farther than so many times the size of the hidden part only if they are in another unit."""
_REMEDY = "docs/datasets.md shows how to write predictions"


@dataclass(frozen=True)
class Predictions:
    """Predictions for the scenes of a `Truth`, in the same order; quantities that were not predicted are None.

    depth, mask : (N, R, C). occupancy : (N, D, H, W). points : (N, M, 3) and centers : (N, K, 3) in the label frame;
    rows of NaN are fill.
    """

    depth: Floats | None = None
    mask: Floats | None = None
    points: Floats | None = None
    occupancy: Floats | None = None
    centers: Floats | None = None

    @property
    def shows(self) -> Bools | None:
        """(N, R, C) whether a pixel shows an object; None without depth and mask."""
        if self.mask is not None:
            return self.mask > 0.5
        return None if self.depth is None else self.depth > 0


def read_predictions(source: str | Path | Mapping[str, Any], truth: Truth) -> Predictions:
    """The predictions for the scenes of `truth`; predictions for other scenes are ignored.

    source : an `.npz` file, a Zarr group, or a mapping, with `scene` (N,) and any of `QUANTITIES`; `SUITE`, too, if
        it says of which dataset the predictions are.

    Raises `InputError` for a missing file, another format or dataset, scenes that are missing or there twice, an
    unknown quantity or none, a wrong shape, and values that are no numbers, not finite, out of range, or lengths in
    another unit than metres.
    """
    arrays = dict(source) if isinstance(source, Mapping) else _loaded(Path(source), truth)
    where = "predictions" if isinstance(source, Mapping) else str(source)
    if "scene" not in arrays:
        raise InputError(f"{where}: has no `scene`, the numbers of the scenes predicted; {_REMEDY}")
    for name in arrays:
        if name not in ("scene", *QUANTITIES, SUITE):
            hint = near_hint(name, QUANTITIES, f"known are scene, {', '.join(QUANTITIES)}, {SUITE}")
            raise InputError(f"{where}: unknown array {name!r}; {hint}")
    if (of := str(np.asarray(arrays.pop(SUITE, "")))) not in ("", truth.manifest.config["name"]):
        raise InputError(f"{where}: predicts {of[:100]!r}, not {truth.manifest.config['name']!r}; name its own suite")
    if len(arrays) == 1:
        raise InputError(f"{where}: holds nothing beside `scene`; give any of {', '.join(QUANTITIES)}")
    rows = _rows(where, np.asarray(arrays["scene"]), truth)
    count = len(np.asarray(arrays["scene"]))
    made = {
        name: _checked(f"{where}: {name}", name, np.asarray(arrays[name]), count, rows, truth)
        for name in QUANTITIES
        if name in arrays
    }
    if "mask" in made and "depth" not in made:
        raise InputError(f"{where}: `mask` says where `depth` shows an object, and there is no `depth`; give both")
    return Predictions(**made)


def _loaded(path: Path, truth: Truth) -> dict[str, NDArray[Any]]:
    """Name → array of a file or group of predictions. An array of an unknown name is empty and was not read."""
    if not path.is_dir() and (why := why_no_file(path)) is not None:
        raise InputError(f"{path}: {why}; name an .npz file or a Zarr group of predictions")
    for file in path.rglob("*"):
        if not file.is_dir() and (why := why_no_file(file)) is not None:
            raise InputError(f"{file}: {why}; a Zarr group has plain files alone")
    known, enough = ("scene", *QUANTITIES, SUITE), _bytes_of_all(truth)
    with one_line(f"{path}: is no .npz file and no Zarr group of predictions", _REMEDY):
        if path.is_dir():
            import zarr

            found = dict(zarr.open_group(path, mode="r").arrays())
            # A missing chunk is as good as one of zeros, so a shape is not limited by what is stored; and a chunk,
            # which is decoded as a whole, may be larger than its array.
            declared = sum(
                max(array.nbytes, math.prod(array.shards or array.chunks) * array.dtype.itemsize)
                for name, array in found.items()
                if name in known
            )
            stored = sum(file.stat().st_size for file in path.rglob("*") if file.is_file())
            check_expansion(str(path), declared, stored, enough)
            loaded, names = {name: np.asarray(found[name][...]) for name in known if name in found}, list(found)
        else:
            loaded, names = read_npz(path, known, enough)
    return dict.fromkeys(names, np.zeros(0)) | loaded


def _bytes_of_all(truth: Truth) -> int:
    """Bytes of predictions of every quantity for every scene of the dataset, with a point for each pixel."""
    cells = 0 if truth.occupancy is None else math.prod(truth.occupancy.shape[1:])
    return 8 * truth.manifest.schema.scenes * (8 * math.prod(truth.depth.shape[1:]) + cells + 1)


def _rows(where: str, scene: NDArray[Any], truth: Truth) -> NDArray[np.intp]:
    """(N,) the row of the predictions that belongs to each scene of `truth`; `scene` has the index of each row."""
    if scene.ndim != 1 or scene.dtype.kind not in "iu":
        raise InputError(f"{where}: scene is {scene.dtype} {scene.shape}; must be whole numbers of shape (N,)")
    values, first = np.unique(scene, return_index=True)
    if len(values) < len(scene):
        twice = next(int(value) for value in values if np.count_nonzero(scene == value) > 1)
        raise InputError(f"{where}: scene {twice} is there more than once; give one prediction of each")
    total = truth.manifest.schema.scenes
    if len(values) and (values[0] < 0 or values[-1] >= total):
        wrong = values[0] if values[0] < 0 else values[-1]
        raise InputError(f"{where}: scene {wrong} is none of the dataset's 0 … {total - 1}")
    missing = np.setdiff1d(truth.scenes, values)
    if len(missing):
        raise InputError(
            f"{where}: {len(missing)} of {len(truth.scenes)} scenes are missing, the first is {missing[0]}; predict "
            "every scene of the split"
        )
    return first[np.searchsorted(values, truth.scenes)]


def _checked(where: str, name: str, given: NDArray[Any], count: int, rows: NDArray[np.intp], truth: Truth) -> Floats:
    """A predicted quantity in float64, the rows of the scenes of `truth` only. Raises as `read_predictions` does."""
    if given.dtype.kind not in "fiub":
        raise InputError(f"{where} is {given.dtype}; must be numbers")
    image, volume = truth.depth.shape[1:], None if truth.occupancy is None else truth.occupancy.shape[1:]
    if name == "occupancy" and volume is None:
        raise InputError(f"{where}: the dataset has no occupancy to hold it against; leave it out")
    table = name in ("points", "centers")
    due = volume if name == "occupancy" else image
    fits = given.ndim == 3 and given.shape[2] == 3 if table else given.shape[1:] == due
    if not fits or len(given) != count:
        wanted = f"({count}, any number, 3)" if table else (count, *(due or ()))
        raise InputError(f"{where} has the shape {given.shape}; must be {wanted}")
    values = given[rows].astype(np.float64)
    if table:
        fill = np.isnan(values)
        if (fill.any(axis=-1) != fill.all(axis=-1)).any() or np.isinf(values).any():
            raise InputError(f"{where} has rows that are neither three finite numbers nor three NaN (fill)")
        _check_metres(where, np.linalg.norm(values[~fill.any(axis=-1)], axis=-1), float(truth.span.max()))
        return values
    bad: Callable[[int], str] = lambda k: f"in scene {truth.scenes[k]}"  # noqa: E731
    wrong = ~np.isfinite(values)
    if wrong.any():
        raise InputError(f"{where} has values that are not finite, {bad(int(np.argwhere(wrong)[0][0]))}")
    high = np.inf if name == "depth" else 1.0
    wrong = (values < 0) | (values > high)
    if wrong.any():
        allowed = "≥ 0 (m; 0: empty)" if name == "depth" else "in 0 … 1"
        k = tuple(np.argwhere(wrong)[0])
        raise InputError(f"{where} = {values[k]:g}, {bad(int(k[0]))}: must be {allowed}")
    if name == "depth":
        _check_metres(where, values[values > 0], float(truth.reach.max()))
    return values


def _check_metres(where: str, lengths: Floats, size_m: float) -> None:
    """Raise `InputError` for lengths that most likely are not in metres, beside a hidden part of so many metres."""
    if lengths.size and (typical := float(np.median(lengths))) > FAR * size_m:
        raise InputError(
            f"{where}: the median is {typical:.4g}, and the hidden part has {size_m:.3g} m; metres are needed"
        )
