"""Reading predictions from a file or a mapping, with one line for each error that they can have."""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from datagen.config.base import near_hint
from datagen.errors import InputError
from datagen.records.arrays import Bools, Floats, Ints
from datagen.scoring.truth import Truth
from datagen.store import Manifest
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


@dataclass(frozen=True)
class Form:
    """What a predicted array must look like.

    shape : of one scene; None stands for any number.
    unit : `m` and `m/s`, for which rows of NaN are fill; `depth`, metres ≥ 0; `share`, numbers in 0 … 1; `class`,
        whole numbers from 0 on.
    size_m : size of the hidden part, metres, beside which lengths in another unit than metres are noticed.
    classes : number of classes.
    """

    shape: tuple[int | None, ...]
    unit: str
    size_m: float = math.inf
    classes: int = 0


@dataclass(frozen=True)
class Wanted:
    """What predictions may hold.

    manifest : of the dataset. scenes : (N,) indices of the scenes to be predicted. forms : array → its form; None if
    the dataset has no label to compare it with.
    """

    manifest: Manifest
    scenes: Ints
    forms: Mapping[str, Form | None]

    @property
    def names(self) -> tuple[str, ...]:
        """All arrays that may be there, beside `SUITE`."""
        return ("scene", *self.forms)

    @property
    def bytes(self) -> int:
        """Bytes of predictions of every array for every scene of the dataset. Where any number of rows may be, there
        are as many as a label image has pixels, or a thousand without label images."""
        forms = [form for form in self.forms.values() if form is not None]
        many = next((math.prod(n or 0 for n in form.shape) for form in forms if form.unit == "depth"), 1000)
        of_scene = sum(math.prod(many if n is None else n for n in form.shape) for form in forms)
        return 8 * self.manifest.schema.scenes * (of_scene + 1)


def read_predictions(source: str | Path | Mapping[str, Any], truth: Truth) -> Predictions:
    """The predictions for the scenes of `truth`; predictions for other scenes are ignored.

    source : an `.npz` file, a Zarr group, or a mapping, with `scene` (N,) and any of `QUANTITIES`; `SUITE`, too, if
        it says of which dataset the predictions are.

    Raises `InputError` as `read_arrays` does, and for a mask without depth.
    """
    image, span = truth.depth.shape[1:], float(truth.span.max())
    volume = None if truth.occupancy is None else Form(truth.occupancy.shape[1:], "share")
    forms = (
        Form(image, "depth", float(truth.reach.max())), Form(image, "share"), Form((None, 3), "m", span), volume,
        Form((None, 3), "m", span),
    )  # fmt: skip
    made = read_arrays(source, Wanted(truth.manifest, truth.scenes, dict(zip(QUANTITIES, forms, strict=True))))
    if "mask" in made and "depth" not in made:
        raise InputError(
            f"{named(source)}: `mask` says where `depth` shows an object, and there is no `depth`; give both"
        )
    return Predictions(**made)


def named(source: str | Path | Mapping[str, Any]) -> str:
    """What messages call predictions."""
    return "predictions" if isinstance(source, Mapping) else str(source)


def read_arrays(source: str | Path | Mapping[str, Any], wanted: Wanted) -> dict[str, Floats]:
    """Array → its values (N, …) in float64 for the scenes that are wanted, in their order; other scenes are ignored.

    source : an `.npz` file, a Zarr group, or a mapping, with `scene` (N,), any of the arrays that are wanted, and
        `SUITE`, if it says of which dataset the predictions are.

    Raises `InputError` for a missing file, another format or dataset, scenes that are missing or there twice, an
    unknown quantity or none, a wrong shape, and values that are no numbers, not finite, out of range, or lengths in
    another unit than metres.
    """
    arrays = dict(source) if isinstance(source, Mapping) else _arrays_of_file(Path(source), wanted)
    where, known = named(source), list(wanted.forms)
    if "scene" not in arrays:
        raise InputError(f"{where}: has no `scene`, the numbers of the scenes predicted; {_REMEDY}")
    for name in arrays:
        if name not in (*wanted.names, SUITE):
            hint = near_hint(name, known, f"known are scene, {', '.join(known)}, {SUITE}")
            raise InputError(f"{where}: unknown array {name!r}; {hint}")
    if (of := str(np.asarray(arrays.pop(SUITE, "")))) not in ("", wanted.manifest.config["name"]):
        raise InputError(
            f"{where}: predicts {of[:100]!r}, not {wanted.manifest.config['name']!r}; name its own suite"
        )
    if len(arrays) == 1:
        raise InputError(f"{where}: holds nothing beside `scene`; give any of {', '.join(known)}")
    rows, count = _rows(where, np.asarray(arrays["scene"]), wanted), len(np.asarray(arrays["scene"]))
    made: dict[str, Floats] = {}
    for name, form in wanted.forms.items():
        if name not in arrays:
            continue
        if form is None:
            raise InputError(f"{where}: {name}: the dataset has no {name} to hold it against; leave it out")
        made[name] = _values_wanted(f"{where}: {name}", np.asarray(arrays[name]), count, rows, form, wanted.scenes)
    return made


def _arrays_of_file(path: Path, wanted: Wanted) -> dict[str, NDArray[Any]]:
    """Name → array of a file or group of predictions. An array of an unknown name is empty and was not read."""
    if not path.is_dir() and (why := why_no_file(path)) is not None:
        raise InputError(f"{path}: {why}; name an .npz file or a Zarr group of predictions")
    for file in path.rglob("*"):
        if not file.is_dir() and (why := why_no_file(file)) is not None:
            raise InputError(f"{file}: {why}; a Zarr group has plain files alone")
    known = (*wanted.names, SUITE)
    with one_line(f"{path}: is no .npz file and no Zarr group of predictions", _REMEDY):
        if path.is_dir():
            loaded, names = _of_group(path, known, wanted.bytes)
        else:
            loaded, names = read_npz(path, known, wanted.bytes)
    return dict.fromkeys(names, np.zeros(0)) | loaded


def _of_group(path: Path, known: Collection[str], enough: int) -> tuple[dict[str, NDArray[Any]], list[str]]:
    """Name → array of the arrays of a Zarr group whose names are known, and the names of all of its arrays."""
    import zarr

    found = dict(zarr.open_group(path, mode="r").arrays())
    # A missing chunk is as good as one of zeros, so a shape is not limited by what is stored; and a chunk, which is
    # decoded as a whole, may be larger than its array.
    declared = sum(
        max(array.nbytes, math.prod(array.shards or array.chunks) * array.dtype.itemsize)
        for name, array in found.items()
        if name in known
    )
    stored = sum(file.stat().st_size for file in path.rglob("*") if file.is_file())
    check_expansion(str(path), declared, stored, enough)
    return {name: np.asarray(found[name][...]) for name in known if name in found}, list(found)


def _rows(where: str, scene: NDArray[Any], wanted: Wanted) -> NDArray[np.intp]:
    """(N,) the row of the predictions that belongs to each scene wanted; `scene` has the index of each row."""
    if scene.ndim != 1 or scene.dtype.kind not in "iu":
        raise InputError(f"{where}: scene is {scene.dtype} {scene.shape}; must be whole numbers of shape (N,)")
    values, first = np.unique(scene, return_index=True)
    if len(values) < len(scene):
        twice = next(int(value) for value in values if np.count_nonzero(scene == value) > 1)
        raise InputError(f"{where}: scene {twice} is there more than once; give one prediction of each")
    total = wanted.manifest.schema.scenes
    if len(values) and (values[0] < 0 or values[-1] >= total):
        wrong = values[0] if values[0] < 0 else values[-1]
        raise InputError(f"{where}: scene {wrong} is none of the dataset's 0 … {total - 1}")
    missing = np.setdiff1d(wanted.scenes, values)
    if len(missing):
        raise InputError(
            f"{where}: {len(missing)} of {len(wanted.scenes)} scenes are missing, the first is {missing[0]}; predict "
            "every scene of the split"
        )
    return first[np.searchsorted(values, wanted.scenes)]


def _values_wanted(
    where: str, given: NDArray[Any], count: int, rows: NDArray[np.intp], form: Form, scenes: Ints
) -> Floats:  # fmt: skip
    """A predicted array in float64, the rows of the scenes wanted only. Raises as `read_arrays` does."""
    if given.dtype.kind not in "fiub":
        raise InputError(f"{where} is {given.dtype}; must be numbers")
    due = (count, *form.shape)
    if given.ndim != len(due) or any(n not in (None, m) for n, m in zip(due, given.shape, strict=True)):
        axes = ", ".join("any number" if n is None else str(n) for n in due)
        raise InputError(f"{where} has the shape {given.shape}; must be ({axes})")
    values = given[rows].astype(np.float64)
    if form.unit in ("m", "m/s"):
        fill = np.isnan(values)
        if (fill.any(axis=-1) != fill.all(axis=-1)).any() or np.isinf(values).any():
            many = "two" if form.shape[-1] == 2 else "three"
            raise InputError(f"{where} has rows that are neither {many} finite numbers nor {many} NaN (fill)")
        _check_metres(where, np.linalg.norm(values[~fill.any(axis=-1)], axis=-1), form)
        return values
    bad = np.argwhere(~np.isfinite(values))
    if len(bad):
        raise InputError(f"{where} has values that are not finite, in scene {scenes[bad[0][0]]}")
    if form.unit == "class":
        bad = np.argwhere((values < 0) | (values >= form.classes) | (values != np.floor(values)))
        if len(bad):
            raise InputError(
                f"{where} = {values[tuple(bad[0])]:g}, in scene {scenes[bad[0][0]]}: must be the number of a class, "
                f"0 … {form.classes - 1}"
            )
        return values
    bad = np.argwhere((values < 0) | (values > (np.inf if form.unit == "depth" else 1.0)))
    if len(bad):
        allowed = "≥ 0 (m; 0: empty)" if form.unit == "depth" else "in 0 … 1"
        raise InputError(f"{where} = {values[tuple(bad[0])]:g}, in scene {scenes[bad[0][0]]}: must be {allowed}")
    if form.unit == "depth":
        _check_metres(where, values[values > 0], form)
    return values


def _check_metres(where: str, lengths: Floats, form: Form) -> None:
    """Raise `InputError` for lengths, or lengths a second, that most likely are not in metres."""
    if lengths.size and (typical := float(np.median(lengths))) > FAR * form.size_m:
        needed = "metres a second" if form.unit == "m/s" else "metres"
        raise InputError(
            f"{where}: the median is {typical:.4g}, and the hidden part has {form.size_m:.3g} m; {needed} are needed"
        )
