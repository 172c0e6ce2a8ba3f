"""Tracks: where the objects of sequences are in each frame, and how far predictions are off.

Only objects that move are scored. A row of the predicted centres is a track: the same object in all frames.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from scipy.optimize import linear_sum_assignment

from datagen.errors import InputError
from datagen.records.arrays import Bools, Floats, Ints
from datagen.records.checks import as_given
from datagen.scoring.metrics import quantile
from datagen.scoring.predictions import Form, Wanted, named, read_arrays
from datagen.scoring.truth import labels_of, scenes_of_split
from datagen.store import Manifest
from datagen.store.summaries import LEAST

NEEDED = (
    "object_part", "object_box_center", "object_box_rotation", "object_velocity", "object_change", "hidden_bounds",
)  # fmt: skip
NEAR_M = 0.25
"""Distance up to which a centre counts as found: half the width of a person's shoulders."""
TITLES = {
    "center_median_m": "distance of centres, median (m)",
    "center_p90_m": "distance of centres, 90 % (m)",
    "center_within_25_cm": "share of centres within 25 cm",
    "velocity_median_m_s": "error of velocities, median (m/s)",
    "velocity_p90_m_s": "error of velocities, 90 % (m/s)",
}
"""Metric of sequences → its title for people."""


@dataclass(frozen=True)
class Tracks:
    """What moves in the sequences of one split.

    manifest : the dataset's manifest.
    scenes : (N,) indices of the scenes.
    centers, velocities : (N, F, K, 3) of the objects' boxes in the label frame, metres and metres a second; NaN in
        rows without an object that moves.
    sigma : (N, K) significance of an object's change, the median over the frames after the first; NaN in these rows.
    span : (N,) diagonal of the hidden part, metres.
    """

    manifest: Manifest
    scenes: Ints
    centers: Floats
    velocities: Floats
    sigma: Floats
    span: Floats

    @property
    def moves(self) -> Bools:
        """(N, K) whether a row has an object that moves."""
        return ~np.isnan(self.centers[:, 0, :, 0])

    @property
    def evident(self) -> Bools:
        """(N, K) whether an object's change is at least `LEAST` standard deviations."""
        return np.nan_to_num(self.sigma) >= LEAST


@dataclass(frozen=True)
class TrackErrors:
    """Errors of tracks, one row for each object that moves, of all scenes (M,).

    center_m, velocity_m_s : (M, F); the second is None if no velocities were predicted. evident : (M,).
    """

    center_m: Floats
    velocity_m_s: Floats | None
    evident: Bools


def read_tracks(dataset: str | Path, manifest: Manifest, split: str) -> Tracks:
    """What moves in one split of a dataset of sequences.

    Raises `InputError` if it has no such split, lacks labels that scores need, or if nothing moves in it;
    `CheckError` if it is damaged.
    """
    missing = [name for name in NEEDED if name not in manifest.schema.by_name]
    if missing:
        raise InputError(f"{dataset}: has no {', '.join(missing)}; build with store.fields objects")
    scenes = scenes_of_split(dataset, manifest, split)
    got = labels_of(dataset, manifest, scenes, NEEDED)
    moves = (got["object_part"] >= 0) & moving(got["object_box_center"], got["object_box_rotation"])
    if not moves.any():
        raise InputError(f"{as_given('split', split)}: nothing moves in {dataset}, and only what moves is scored")
    # Rows of objects that stand in every scene are left out.
    of_some = moves.any(axis=0)
    there = moves[:, of_some]
    center, velocity = (
        np.where(there[:, None, :, None], got[name][:, :, of_some], np.nan)
        for name in ("object_box_center", "object_velocity")
    )
    sigma = np.where(there, np.median(got["object_change"][:, 1:, of_some], axis=1), np.nan)
    span = np.linalg.norm(got["hidden_bounds"][:, 1] - got["hidden_bounds"][:, 0], axis=1)
    return Tracks(manifest, np.array(scenes), center, velocity, sigma, span)


def moving(centers: Floats, rotations: Floats) -> Bools:
    """(N, K) whether the box of an object is not the same in all frames.

    centers : (N, F, K, 3). rotations : (N, F, K, 3, 3).
    """
    shifted = (centers != centers[:, :1]).any(axis=(1, 3))
    return np.asarray(shifted | (rotations != rotations[:, :1]).any(axis=(1, 3, 4)))


def track_errors(source: str | Path | Mapping[str, Any], tracks: Tracks) -> TrackErrors:
    """The errors of predictions.

    source : an `.npz` file, a Zarr group, or a mapping, with `scene` (N,), `centers` (N, F, K, 3) in m and, if they
        are to be scored, `velocities` (N, F, K, 3) in m/s, in the label frame; rows of NaN are fill.

    Of each scene tracks and objects are matched one to one so that the sum of the distances over all frames is least
    (the Hungarian method). A centre that is missing counts as far off as the diagonal of the hidden part, a velocity
    that is missing as one of 0.

    Raises `InputError` as `read_arrays` does, for velocities without centres, and for numbers of tracks that differ.
    """
    frames, span = tracks.centers.shape[1], float(tracks.span.max())
    forms = {"centers": Form((frames, None, 3), "m", span), "velocities": Form((frames, None, 3), "m/s", span)}
    found = read_arrays(source, Wanted(tracks.manifest, tracks.scenes, forms))
    if "centers" not in found:
        raise InputError(f"{named(source)}: `velocities` are those of the tracks in `centers`, which are missing")
    centers, velocities = found["centers"], found.get("velocities")
    if velocities is not None and velocities.shape != centers.shape:
        raise InputError(
            f"{named(source)}: velocities of {velocities.shape[2]} tracks and centers of {centers.shape[2]}; must be "
            "the same tracks"
        )
    off, speed = [], []
    for n, row in enumerate(tracks.moves):
        true, moved = tracks.centers[n][:, row], tracks.velocities[n][:, row]
        distances, match = matched(centers[n], true, float(tracks.span[n]))
        off.append(distances.T)
        if velocities is not None:
            ours = np.zeros_like(moved)
            ours[:, match >= 0] = np.nan_to_num(velocities[n][:, match[match >= 0]])
            speed.append(np.linalg.norm(ours - moved, axis=-1).T)
    of_speed = np.concatenate(speed) if velocities is not None else None
    return TrackErrors(np.concatenate(off), of_speed, tracks.evident[tracks.moves])


def matched(found: Floats, true: Floats, missed_m: float) -> tuple[Floats, Ints]:
    """(F, M) distance of each object from its track in each frame, metres, and (M,) the row of its track; −1: none.

    found : (F, K, 3) tracks, NaN where one is missing. true : (F, M, 3) objects. missed_m : distance of what is
    missing.
    """
    apart = np.linalg.norm(found[:, :, None] - true[:, None], axis=-1)
    apart = np.where(np.isnan(apart), missed_m, apart)
    tracks, objects = linear_sum_assignment(apart.sum(axis=0))
    distances, match = np.full(true.shape[:2], missed_m), np.full(true.shape[1], -1)
    distances[:, objects], match[objects] = apart[:, tracks, objects], tracks
    return distances, match


def track_metrics(errors: TrackErrors, evident: bool) -> dict[str, float]:
    """Metric → value over all frames of all objects that move, or (`evident`) of those whose change has evidence."""
    chosen = errors.evident if evident else np.ones(len(errors.evident), np.bool_)
    center = errors.center_m[chosen]
    values = {
        "center_median_m": quantile(center, 0.5), "center_p90_m": quantile(center, 0.9),
        "center_within_25_cm": float(np.mean(center <= NEAR_M)) if center.size else float("nan"),
    }  # fmt: skip
    if errors.velocity_m_s is not None:
        speed = errors.velocity_m_s[chosen]
        values |= {"velocity_median_m_s": quantile(speed, 0.5), "velocity_p90_m_s": quantile(speed, 0.9)}
    return values
