"""Lists of points and their histograms, read from files.

`trans_data` (N, T), `camera_points`, `laser_points`, `camera_normals`, `laser_normals` (N, 3): a row for each pair
of a laser point and a pixel; times count from the wall, as 3D Gaussian Transient Rendering (3D-GTR, 2026) loads
them. Other lists are those of the functions below.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from datagen.errors import InputError
from datagen.formats.containers import Content
from datagen.formats.recording import (
    SAME,
    UNKNOWN,
    Captured,
    Recording,
    Stated,
    WallFrame,
    bin_width_s,
    time_bins,
)
from datagen.records.arrays import Floats
from datagen.records.checks import as_given, option
from datagen.units import time_from_path

_UNEVEN = 0.01
"""Part of a bin by which evenly spaced path lengths may differ: files state them with single precision."""


def read_pairs(content: Content, stated: Stated) -> Captured:
    """The recording of a list of pairs: every pixel for every laser point, or (confocal) one for each."""
    rows, seen, lit = content.array("trans_data"), content.points("camera_points"), content.points("laser_points")
    if rows.ndim != 2 or rows.size == 0 or seen.shape != (len(rows), 3) or lit.shape != (len(rows), 3):
        raise InputError(
            f"{content.path}: trans_data {rows.shape}, camera_points {seen.shape}, laser_points {lit.shape}: must be "
            "(N, T), (N, 3), (N, 3)"
        )
    time = time_bins(
        content.path, rows.shape[1], bin_width_s(content), stated.options, start_s=0.0, origin="wall",
        named="bin_resolution",
    )  # fmt: skip
    lit_normals, seen_normals = content.normals("laser_normals", lit), content.normals("camera_normals", seen)
    lasers, pixels = _every_pixel(lit, seen)
    if lasers * pixels == len(rows):
        values: NDArray[Any] = rows.reshape(lasers, pixels, -1)
        lit, lit_normals = lit[::pixels], lit_normals[::pixels]
        seen, seen_normals = seen[:pixels], seen_normals[:pixels]
    else:
        values = rows[:, None]
    paired = lasers * pixels != len(rows)
    frame = WallFrame.facing(seen, seen_normals)
    recording = Recording(values, paired, lit, lit_normals, seen, seen_normals, time, UNKNOWN, UNKNOWN, frame)
    return Captured(recording, "trans_data (pair, time)", notes=("lengths in m",))


def _every_pixel(lit: Floats, seen: Floats) -> tuple[int, int]:
    """(lasers, pixels) if the list has all pixels for one laser point after the other; (0, 0) if it has not."""
    changes = np.flatnonzero((lit != lit[0]).any(axis=1))
    pixels = int(changes[0]) if len(changes) else len(lit)
    if len(lit) % pixels or (pixels == 1 and (seen != seen[0]).any()):
        return 0, 0
    lasers = len(lit) // pixels
    in_order = np.array_equal(lit, np.repeat(lit[::pixels], pixels, axis=0))
    alike = np.array_equal(seen, np.tile(seen[:pixels], (lasers, 1)))
    return (lasers, pixels) if in_order and alike else (0, 0)


def read_convolutional(content: Content, stated: Stated) -> Captured:
    """The recording in the structure `NLOSDATA` of convolutional approximations to NLOS imaging (Ahn et al. 2019),
    of a confocal scan: `transient` (a, b, time), `l` (a · b, 3) with the last axis fastest, `times` the ends of the
    bins in metres of path from the wall, as its light-cone transform and its backprojection take them."""
    path, light = content.path, content.array("NLOSDATA.transient")
    says = bool(content.number("NLOSDATA.is_confocal")) if "NLOSDATA.is_confocal" in content.arrays else None
    if not _is_confocal(content, says, "NLOSDATA.is_confocal", stated):
        raise InputError(
            f"{path}: NLOSDATA.is_confocal = 0, and the order of transient over l and s is not published; write it "
            "as trans_data (N, T), camera_points and laser_points (N, 3), a row for each pair"
        )
    seen = content.points("NLOSDATA.l").reshape(-1, 3)
    if light.ndim != 3 or light.size == 0 or light.shape[0] * light.shape[1] != len(seen):
        raise InputError(
            f"{path}: NLOSDATA.transient {light.shape} for {len(seen)} points in l; (a, b, time) is needed"
        )
    end_m, width_m = _even_bins(content, "NLOSDATA.times", light.shape[2], 1.0)
    axes, notes = "NLOSDATA.transient (a, b, time)", ("points l with the last axis fastest", "lengths in m")
    return _confocal(content, light.reshape(len(seen), 1, -1), seen, (end_m - width_m, width_m), stated, axes, notes)


def read_fermat(content: Content, stated: Stated) -> Captured:
    """The recording in a file of Fermat paths (Xin et al. 2019): `transients` (N, T), `detLocs` (N, 3) in cm on the
    wall z = 0, `temporalBinCenters` (T) in cm of path from the wall, and `srcLoc` (3) in cm unless the scan is
    confocal.

    Raises `InputError` for a file that says neither `whetherConfocal` nor `srcLoc`, which no option states.
    """
    path, rows, seen = content.path, content.array("transients"), content.points("detLocs").reshape(-1, 3) / 100
    if rows.ndim != 2 or rows.size == 0 or len(seen) != len(rows):
        raise InputError(f"{path}: transients {rows.shape} for {len(seen)} detLocs; (N, T) and (N, 3) are needed")
    center_m, width_m = _even_bins(content, "temporalBinCenters", rows.shape[1], 0.01)
    source = content.arrays.get("srcLoc")
    says = None if source is None else source.size == 0
    if "whetherConfocal" in content.arrays:
        says = bool(content.number("whetherConfocal"))
    is_confocal = _is_confocal(content, says, "whetherConfocal and srcLoc", stated)
    bins, axes, notes = (center_m - width_m / 2, width_m), "transients (point, time)", ("lengths in cm",)
    if is_confocal:
        return _confocal(content, rows[:, None], seen, bins, stated, axes, notes)
    at = stated.options.laser
    if source is not None and source.size and at is not None:
        raise InputError(f"{path}: has srcLoc; leave {option('laser')} out")
    lit = np.array([at]) if isinstance(at, tuple) else content.points("srcLoc").reshape(-1, 3) / 100
    if len(lit) != 1:
        raise InputError(f"{path}: srcLoc: {len(lit)} points; one laser point, or none of a confocal scan, is needed")
    found = _confocal(content, rows[:, None], seen, bins, stated, axes, notes)
    first = replace(
        found.first, values=rows[None], paired=False, laser_points=lit, laser_normals=np.full((1, 3), np.nan)
    )
    return replace(found, first=first)


def read_consumer(content: Content, stated: Stated) -> Captured:
    """The recording in a file of consumer NLOS (Somasundaram et al. 2026): `hists` (zones, T) and `pt_cloud`
    (zones, 3), the place on the wall z = 0, metres, that each zone lights and sees; the direct light is cut off,
    and times count from the wall, as its loader says."""
    hists, points = content.array("hists"), content.points("pt_cloud").reshape(-1, 3)
    if hists.ndim < 2 or hists.size == 0 or hists.size % len(points) or hists.shape[-1] * len(points) != hists.size:
        raise InputError(
            f"{content.path}: hists {hists.shape} for {len(points)} points of pt_cloud; one each is needed"
        )
    rows = hists.reshape(len(points), 1, -1)
    notes = ("each zone is taken to light what it sees", "lengths in m", "hidden part at z > 0")
    return _confocal(content, rows, points, (0.0, None), stated, "hists (zone, time)", notes)


def _is_confocal(content: Content, says: bool | None, named: str, stated: Stated) -> bool:
    """Whether a scan is confocal, as the file `says` in the variables `named`, or the options.

    Raises `InputError` where neither states it, and where they contradict each other.
    """
    asked = stated.options.laser
    if says is None and asked is None:
        raise InputError(
            f"{content.path}: has no {named}; say {as_given('laser', 'confocal')}, or where the laser point was, in "
            f"metres: {as_given('laser', '0.1,0,0')}"
        )
    if says is not None and asked is not None and says != (asked == "confocal"):
        raise InputError(
            f"{content.path}: {named} says {'' if says else 'not '}confocal; leave {option('laser')} out"
        )
    return asked == "confocal" if says is None else says


def _confocal(
    content: Content, values: NDArray[Any], seen: Floats, bins: tuple[float, float | None], stated: Stated, axes: str,
    notes: tuple[str, ...],
) -> Captured:  # fmt: skip
    """What a confocal list of points of the wall z = 0 holds. bins : metres of path at which the first one begins,
    and the width of each, None where the options state it."""
    start_m, width_m = bins
    width_s = bin_width_s(content) if width_m is None else time_from_path(width_m)
    # What is less than a millionth of a bin is rounding.
    start_m = 0.0 if width_m is not None and abs(start_m) < SAME * width_m else start_m
    time = time_bins(
        content.path, values.shape[-1], width_s, stated.options, start_s=time_from_path(start_m), origin="wall",
        named="the width of its bins",
    )  # fmt: skip
    unknown = np.full(seen.shape, np.nan)
    frame = WallFrame.facing(seen, unknown)
    recording = Recording(values, True, seen, unknown, seen, unknown, time, UNKNOWN, UNKNOWN, frame)
    return Captured(recording, axes, notes=notes)


def _even_bins(content: Content, name: str, bins: int, metres: float) -> tuple[float, float]:
    """(the first, the distance of two) of evenly spaced path lengths, one for each bin, as metres.

    metres : how many the file's unit has. Raises `InputError` for others.
    """
    found = content.array(name).astype(np.float64)
    # One row for each transient is allowed if all are alike.
    rows = found.reshape(-1, bins) if found.size % bins == 0 else found.reshape(1, -1)
    step = float((rows[0, -1] - rows[0, 0]) / max(bins - 1, 1)) if rows.shape[1] == bins > 1 else 0.0
    due = rows[0, 0] + step * np.arange(rows.shape[1])
    if not np.isfinite(rows).all() or step <= 0 or abs(rows - due).max() > _UNEVEN * step:
        raise InputError(
            f"{content.path}: {name}: shape {found.shape}; {bins} evenly spaced, ascending lengths are needed, the "
            "same for all transients"
        )
    return float(rows[0, 0]) * metres, step * metres
