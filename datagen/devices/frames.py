"""Frames that a sensor of zones recorded: histograms, and where the sensor stood."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any
from warnings import warn

import numpy as np
from numpy.typing import NDArray

from datagen.errors import InputError, InputWarning
from datagen.records.arrays import Floats, Ints
from datagen.records.checks import as_rows, check_path, check_reals
from datagen.untrusted import one_line, read_npy, read_npz, read_records, why_no_file

_FAR_M = 100.0
"""Lengths above which metres are doubted: sensors of zones see some 5 m, and are moved within a room or a hall."""
_AS_A_TURN = 0.01
"""Largest difference of the products of a pose's columns from those of a turn: poses are written with some digits."""
SUFFIXES = (".json", ".json.gz", ".npz", ".npy")


@dataclass(frozen=True)
class Frames:
    """n frames of one sensor.

    Attributes
    ----------
    source : the file's name.
    histograms : (n, zones, bins) counts; with the ambient light that the sensor subtracted, where a file has it.
    poses : (n, 4, 4) poses of the sensor, its z axis looking out, metres; None where the file holds none.
    distances_m : (n,) distances to a plane that the sensor faces; None where the file holds none.
    reference : (n, bins) the reference channel inside the sensor; None where the file holds none.
    zone_order : how the zones are listed, a name of `zone_order.ORDERS` or the device's number of each; None where
        the file does not say it, so that they are taken to be in the device's order.
    """

    source: str
    histograms: Floats
    poses: Floats | None = None
    distances_m: Floats | None = None
    reference: Floats | None = None
    zone_order: str | tuple[int, ...] | None = None

    def __post_init__(self) -> None:
        check_reals("Frames.histograms", self.histograms, (None, None, None))
        count, _, bins = self.histograms.shape
        for name, shape in (("poses", (count, 4, 4)), ("distances_m", (count,)), ("reference", (count, bins))):
            if getattr(self, name) is not None:
                check_reals(f"Frames.{name}", getattr(self, name), shape)
        if self.poses is not None:
            check_poses("Frames.poses", self.poses)

    def __len__(self) -> int:
        return len(self.histograms)

    def some(self, rows: Ints) -> Frames:
        """The frames with these numbers."""
        rows = as_rows("Frames.some: rows", rows, len(self))
        given = {name: getattr(self, name) for name in ("poses", "distances_m", "reference")}
        there = {name: values[rows] for name, values in given.items() if values is not None}
        return replace(self, histograms=self.histograms[rows], **there)


def check_poses(where: str, poses: Floats) -> None:
    """Raise `InputError`, which begins with `where`, unless poses (n, 4, 4) are a turn and a shift: a mirrored one
    would exchange left and right of what a sensor sees, a scaled or transposed one stand elsewhere."""
    turns = poses[:, :3, :3]
    is_turn = abs(turns.transpose(0, 2, 1) @ turns - np.eye(3)).max(axis=(1, 2)) < _AS_A_TURN
    is_mirrored = np.linalg.det(turns) < 0
    is_last_row = abs(poses[:, 3] - [0, 0, 0, 1]).max(axis=1) < 1e-6
    wrong = np.flatnonzero(~is_turn | is_mirrored | ~is_last_row)
    if len(wrong):
        first = wrong[0]
        what = "no turn" if not is_turn[first] else "mirrored" if is_mirrored[first] else "transposed"
        raise InputError(
            f"{where}: that of frame {first} is {what}; its columns must be the sensor's left, up and forward, of "
            "length 1, at right angles and left × up = forward, and its position in metres; its last row is 0 0 0 1"
        )


def fitted_and_tested(count: int) -> tuple[Ints, Ints]:
    """Of frames along a path of the sensor or a sweep: numbers of those that a fit sees, the first and third quarter,
    and of those that are held out to test it, the second and fourth.

    Neighbours on the path see nearly the same, so that every second frame would test a fit by what it has seen.
    """
    quarter = np.arange(count) * 4 // count
    return np.flatnonzero(quarter % 2 == 0), np.flatnonzero(quarter % 2 == 1)


def read_frames(path: str | Path) -> Frames:
    """The frames of a file.

    path : JSON (also .gz), a list of frames with `hists` (zones, bins) and, in all frames or none, `pose` (4, 4),
        `dist_to_plane` (metres), `reference_hist` (bins), `ambient` (zones,) and `zone_order`; .npz with `hists` (n,
        zones, bins) and the same optional names for all frames; or .npy with the histograms alone. Histograms (n,
        rows, columns, bins), as DENALI has them, are of zones in rows from the top left. `ambient` is what a sensor
        subtracted from each bin of a zone, in the unit of `hists`; it is added back, to the nearest whole count
        where `hists` is whole. `zone_order` says how the zones are listed (docs/devices.md).

    Raises `InputError` for a file that is missing or damaged, and for histograms that are ragged, negative or not
    finite.
    """
    check_path("path", path, f"name frames of a sensor ({', '.join(SUFFIXES)})")
    path = Path(path)
    if (why := why_no_file(path)) is not None:
        raise InputError(f"{path}: {why}; name frames of a sensor ({', '.join(SUFFIXES)})")
    if not path.name.endswith(SUFFIXES):
        raise InputError(f"{path}: its suffix says no format of frames; they are {', '.join(SUFFIXES)}")
    with one_line(f"{path}: holds no frames of a sensor"):
        found = _json(path) if ".json" in path.suffixes else _numpy(path)
    ambient = found.pop("ambient", None)
    counts = found["histograms"]
    if counts.ndim == 4:
        counts = found["histograms"] = counts.reshape(len(counts), -1, counts.shape[3])
        found.setdefault("zone_order", "rows from top left")
    if counts.ndim != 3 or not counts.size or not np.isfinite(counts).all():
        raise InputError(f"{path}: hists of shape {counts.shape}; finite counts ≥ 0 (frames, zones, bins) are needed")
    if ambient is not None:
        counts = found["histograms"] = _with_ambient(path, counts, ambient)
    elif (counts < 0).any():
        raise InputError(
            f"{path}: hists: {(counts < 0).mean():.1%} of the values are negative, as where a sensor subtracts "
            "ambient light; give what it subtracted beside hists: ambient, one number ≥ 0 a zone, counts a bin"
        )
    for name, shape in (("poses", (4, 4)), ("distances_m", ()), ("reference", (counts.shape[2],))):
        values = found.get(name)
        if values is not None and (values.shape != (len(counts), *shape) or not np.isfinite(values).all()):
            raise InputError(f"{path}: {name} of shape {values.shape} for {len(counts)} frames; give one a frame")
    if "poses" in found:
        check_poses(f"{path}: pose", found["poses"])
        _doubt(path, "positions of pose differ by", np.ptp(found["poses"][:, :3, 3], axis=0).max())
    if "distances_m" in found:
        _doubt(path, "dist_to_plane reaches", found["distances_m"].max())
    return Frames(path.name, **found)


def _doubt(path: Path, what: str, length_m: float) -> None:
    """Warn of lengths that are most likely no metres."""
    if length_m > _FAR_M:
        warn(f"{path}: {what} {length_m:.4g} m; is that in metres?", InputWarning, stacklevel=3)


def _with_ambient(path: Path, counts: Floats, ambient: Floats) -> Floats:
    """Histograms (n, zones, bins) with the ambient light (n, zones), counts a bin, that the sensor has subtracted."""
    if ambient.shape != counts.shape[:2] or not np.isfinite(ambient).all() or (ambient < 0).any():
        raise InputError(
            f"{path}: ambient of shape {ambient.shape} for hists of shape {counts.shape}; one finite number ≥ 0 for "
            "each zone of each frame is needed, in counts a bin"
        )
    are_whole, whole = all_whole(counts), np.empty_like(counts)
    for frame, light, total in zip(counts, ambient, whole, strict=True):
        np.add(frame, light[:, None], out=total)
        if are_whole:
            # A chip counts whole events and subtracts a mean.
            np.rint(total, out=total)
    if (whole < 0).any():
        raise InputError(
            f"{path}: hists + ambient has values down to {whole.min():.4g}; ambient must be what was subtracted from "
            "each bin, in the unit of hists"
        )
    return whole


def all_whole(histograms: Floats) -> bool:
    """Whether all counts of histograms (n, zones, bins) are whole numbers."""
    # Frame by frame, since remainders of all would take as much memory as the histograms.
    return all((frame % 1 == 0).all() for frame in histograms)


_KEYS = {"histograms": "hists", "poses": "pose", "distances_m": "dist_to_plane", "reference": "reference_hist",
         "ambient": "ambient"}  # fmt: skip
"""Attribute of `Frames` → its key in files, for what has a value in each frame."""
_ORDER = "zone_order"


def _json(path: Path) -> dict[str, Any]:
    listed = list(read_records(path, [*_KEYS.values()], _ORDER))
    if not listed:
        raise ValueError("a list of frames is needed")
    found = dict[str, Any]()
    orders = {_order(frame[_ORDER]) for frame in listed if _ORDER in frame}
    if len(orders) > 1:
        raise ValueError("frames of several zone_order; write them into several files")
    if orders:
        found["zone_order"] = orders.pop()
    for name, key in _KEYS.items():
        having = sum(key in frame for frame in listed)
        if having not in (0, len(listed)):
            raise ValueError(f"{key!r} is in {having} of {len(listed)} frames; all or none must have it")
        if having:
            found[name] = _stack_of(key, [frame.pop(key) for frame in listed])
    if "histograms" not in found:
        raise ValueError("no frame has 'hists'")
    return found


def _order(given: NDArray[Any]) -> str | tuple[int, ...]:
    """The value of `zone_order`: a text, or whole numbers."""
    if given.dtype.kind == "U" and given.size == 1:
        return str(given.reshape(-1)[0])
    if given.ndim != 1 or given.dtype.kind not in "fiu" or (given % 1 != 0).any():
        raise ValueError("zone_order must be a text, or one whole number for each zone")
    return tuple(map(int, given))


def _stack_of(key: str, values: list[NDArray[Any]]) -> Floats:
    """(n, …) the values of n frames, which must have one shape."""
    stacked = np.empty((len(values), *values[0].shape))
    for number, value in enumerate(values):
        if value.shape != stacked.shape[1:]:
            raise ValueError(f"{key!r} has the shape {stacked.shape[1:]} in frame 0, {value.shape} in {number}")
        stacked[number] = value
    return stacked


def _numpy(path: Path) -> dict[str, Any]:
    if path.suffix == ".npy":
        return {"histograms": read_npy(path).astype(np.float64)}
    loaded, _ = read_npz(path, [*_KEYS.values(), _ORDER])
    if "hists" not in loaded:
        raise ValueError("has no 'hists'")
    order = {"zone_order": _order(loaded.pop(_ORDER))} if _ORDER in loaded else {}
    return order | {name: np.asarray(loaded.pop(key), np.float64) for name, key in _KEYS.items() if key in loaded}
