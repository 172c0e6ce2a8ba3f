"""Frames that a sensor of zones recorded: histograms, and where the sensor stood."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from datagen.errors import InputError
from datagen.records.arrays import Floats
from datagen.untrusted import one_line, read_json, read_npy, read_npz

SUFFIXES = (".json", ".json.gz", ".npz", ".npy")


@dataclass(frozen=True)
class Frames:
    """n frames of one sensor.

    Attributes
    ----------
    source : the file's name.
    histograms : (n, zones, bins) counts.
    poses : (n, 4, 4) poses of the sensor, its z axis looking out, metres; None where the file holds none.
    distances_m : (n,) distances to a plane that the sensor faces; None where the file holds none.
    reference : (n, bins) the reference channel inside the sensor; None where the file holds none.
    """

    source: str
    histograms: Floats
    poses: Floats | None = None
    distances_m: Floats | None = None
    reference: Floats | None = None

    def __len__(self) -> int:
        return len(self.histograms)


def read_frames(path: str | Path) -> Frames:
    """The frames of a file.

    path : JSON (also .gz), a list of frames with `hists` (zones, bins) and, in all frames or none, `pose` (4, 4),
        `dist_to_plane` (metres) and `reference_hist` (bins); .npz with `hists` (n, zones, bins) and the same optional
        names for all frames; or .npy with the histograms alone.

    Raises `InputError` for a file that is missing or damaged, and for histograms that are ragged, negative or not
    finite.
    """
    path = Path(path)
    if not path.is_file():
        raise InputError(f"{path}: no such file; name frames of a sensor ({', '.join(SUFFIXES)})")
    if not path.name.endswith(SUFFIXES):
        raise InputError(f"{path}: its suffix says no format of frames; they are {', '.join(SUFFIXES)}")
    with one_line(f"{path}: holds no frames of a sensor"):
        found = _json(path) if ".json" in path.suffixes else _numpy(path)
    frames = Frames(path.name, **found)
    counts = frames.histograms
    if counts.ndim != 3 or not counts.size or not np.isfinite(counts).all() or (counts < 0).any():
        raise InputError(f"{path}: hists of shape {counts.shape}; finite counts ≥ 0 (frames, zones, bins) are needed")
    for name, shape in (("poses", (4, 4)), ("distances_m", ()), ("reference", (counts.shape[2],))):
        values = getattr(frames, name)
        if values is not None and (values.shape != (len(counts), *shape) or not np.isfinite(values).all()):
            raise InputError(f"{path}: {name} of shape {values.shape} for {len(counts)} frames; give one a frame")
    return frames


def _json(path: Path) -> dict[str, Any]:
    listed = read_json(path)
    if not isinstance(listed, list) or not listed:
        raise ValueError("a list of frames is needed")

    def of(key: str) -> Floats | None:
        having = sum(key in frame for frame in listed)
        if having not in (0, len(listed)):
            raise ValueError(f"{key!r} is in {having} of {len(listed)} frames; all or none must have it")
        return np.array([frame[key] for frame in listed], np.float64) if having else None

    if (histograms := of("hists")) is None:
        raise ValueError("no frame has 'hists'")
    return {
        "histograms": histograms, "poses": of("pose"), "distances_m": of("dist_to_plane"),
        "reference": of("reference_hist"),
    }  # fmt: skip


def _numpy(path: Path) -> dict[str, Any]:
    names = {"poses": "pose", "distances_m": "dist_to_plane", "reference": "reference_hist"}
    if path.suffix == ".npy":
        return {"histograms": read_npy(path).astype(np.float64)}
    loaded, _ = read_npz(path, ("hists", *names.values()))
    optional = {name: np.asarray(loaded[key], np.float64) for name, key in names.items() if key in loaded}
    return {"histograms": np.asarray(loaded["hists"], np.float64), **optional}
