"""Crops: a selection of laser points, pixels and bins, as parts of fields."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from datagen.errors import InputError, shown
from datagen.records.arrays import Ints
from datagen.store import Manifest
from datagen.store.reader import Part
from datagen.store.schema import Field

Crop = slice | Sequence[int] | NDArray[np.generic] | tuple[slice, slice]
"""A slice, indices or a mask of an axis; or (rows, columns), two slices, if the axis is a grid."""
_SUCH_AS = "such as slice(0, 256), a list of numbers, or np.s_[8:24, 8:24] of a grid"


class Crops:
    """The selection along each axis of a dataset's scans.

    sizes : axis → its whole length. chosen : axis → indices to read, for the axes that are not read as a whole.
    """

    def __init__(self, manifest: Manifest, lasers: Crop | None, pixels: Crop | None, bins: slice | None) -> None:
        capture = manifest.config["capture"]
        scan, view = capture.get("scan", {}), capture.get("field_of_view", {})
        measured = manifest.schema.by_name.get("histogram") or manifest.schema.by_name.get("transient")
        crops = {"lasers": (lasers, scan), "pixels": (pixels, view)}
        given = [name for name, (crop, _) in crops.items() if crop is not None] + ["bins"] * (bins is not None)
        if given and measured is None:
            raise InputError(f"{given[0]}: the dataset has neither histograms nor transients to read a part of")
        self.sizes = dict(zip(("laser", "pixel", "bin"), measured.shape[-3:], strict=True)) if measured else {}
        merged = manifest.bins_merged
        if measured and measured.dims[-1] == "transient_bin":
            self.sizes["bin"] //= merged
        self.chosen: dict[str, Ints] = {}
        for (name, (crop, grid)), axis in zip(crops.items(), ("laser", "pixel"), strict=True):
            if crop is not None:
                self.chosen[axis] = _indices(name, crop, self.sizes[axis], _grid(grid, self.sizes[axis]))
        if bins is not None:
            chosen = self.chosen["bin"] = _bins(bins, self.sizes["bin"])
            if merged > 1:
                self.chosen["transient_bin"] = np.arange(chosen[0] * merged, (chosen[-1] + 1) * merged)
        # A confocal scan has one pixel for each laser point.
        self._same = {"sensor_pixel": "laser" if capture["pairing"] == "confocal" else "pixel"}

    def part(self, field: Field, frames: Ints | None = None) -> Part | None:
        """The part of a field that is read, of a sequence of some `frames`; None for the whole field."""
        names = [self._same.get(axis, axis) for axis in field.dims[1:]]
        chosen = self.chosen if frames is None else {**self.chosen, "frame": frames}
        if not chosen.keys() & set(names):
            return None
        *others, last = (chosen.get(name, np.arange(size)) for name, size in zip(names, field.shape, strict=True))
        # Bins are a slice; the last axis of a small field may be that of laser points or pixels.
        is_slice = len(last) == 0 or np.array_equal(last, np.arange(last[0], last[0] + len(last)))
        return Part(tuple(others), slice(int(last[0]), int(last[-1]) + 1) if is_slice else last)

    def __str__(self) -> str:
        """`laser 256 of 4096, bin 512 of 1024`."""
        return ", ".join(
            f"{axis} {len(chosen)} of {self.sizes[axis]}"
            for axis, chosen in self.chosen.items()
            if axis in self.sizes
        )


def _grid(settings: Mapping[str, Any], size: int) -> tuple[int, int] | None:
    """Rows and columns of an axis that is a grid, row by row; None for any other axis."""
    rows, columns = settings.get("rows"), settings.get("columns")
    if settings.get("kind", "grid") != "grid" or not isinstance(rows, int) or not isinstance(columns, int):
        return None
    return (rows, columns) if rows * columns == size else None


def _indices(name: str, crop: Crop, size: int, grid: tuple[int, int] | None) -> Ints:
    """The indices, in 0 … size − 1, that a crop selects, in the order of the crop."""
    every = np.arange(size, dtype=np.int64)
    if isinstance(crop, tuple) and len(crop) == 2 and any(isinstance(one, slice) for one in crop):
        if grid is None:
            raise InputError(
                f"{name} = {shown(crop)}: these are no grid of rows and columns; give a slice or numbers"
            )
        if not all(isinstance(one, slice) for one in crop):
            raise InputError(
                f"{name} = {shown(crop)}: rows and columns must both be slices, such as np.s_[8:24, 3:4]"
            )
        chosen = _numbers_in_crop(name, crop, every.reshape(grid)).reshape(-1)
    elif isinstance(crop, slice):
        chosen = _numbers_in_crop(name, crop, every)
    else:
        chosen = every[_numbers(name, crop, size)]
    if not len(chosen):
        raise InputError(f"{name} = {shown(crop)}: none of {size} is left")
    return chosen


def _numbers_in_crop(name: str, crop: Any, numbers: Ints) -> Ints:
    try:
        return np.asarray(numbers[crop])
    except (TypeError, ValueError):
        raise InputError(f"{name} = {crop}: must be a slice of whole numbers") from None


def _numbers(name: str, crop: object, size: int) -> NDArray[np.generic]:
    """The indices (negative ones count from the end) or the mask of a crop, as an array."""
    try:
        given = np.asarray(crop)
    except (TypeError, ValueError):
        given = np.empty((0, 0))
    is_mask = given.dtype.kind == "b" and given.shape == (size,)
    if isinstance(crop, str) or given.ndim != 1 or not (is_mask or given.dtype.kind in "iu"):
        raise InputError(f"{name} = {shown(crop)}: must choose of {size}, {_SUCH_AS}")
    outside = given[(given < -size) | (given >= size)] if not is_mask else given[:0]
    if len(outside):
        raise InputError(f"{name}: {outside[0]} is not in 0 … {size - 1}")
    return given


def _bins(crop: object, size: int) -> Ints:
    if not isinstance(crop, slice) or crop.step not in (None, 1):
        raise InputError(f"bins = {shown(crop)}: must be a slice of step 1, such as slice(100, 612)")
    chosen = _numbers_in_crop("bins", crop, np.arange(size, dtype=np.int64))
    if not len(chosen):
        raise InputError(f"bins = {crop}: none of {size} is left")
    return chosen
