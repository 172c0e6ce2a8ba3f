"""The scores of predictions against the labels of a suite."""

from __future__ import annotations

import json
import os
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from datagen.labels.frame import image_points
from datagen.records.arrays import Bools, Floats
from datagen.records.checks import check_kind, check_path
from datagen.scoring import single_objects, tracks
from datagen.scoring.metrics import center_distances, chamfer_distance, intersection_over_union, ssim
from datagen.scoring.predictions import Predictions, read_predictions
from datagen.scoring.truth import Truth, read_truth
from datagen.store import Manifest, read_manifest
from datagen.store.files import finite
from datagen.store.summaries import LEAST
from datagen.suites.building import is_published

TITLES = {
    "depth_rmse_m": "root mean square error of depth on pixels of objects (m)",
    "depth_mae_m": "mean error of depth on pixels of objects (m)",
    "silhouette_iou": "overlap of silhouettes (IoU)",
    "ssim": "SSIM of depth pictures",
    "chamfer_m": "chamfer distance of points (m)",
    "occupancy_iou": "overlap of occupied voxels (IoU)",
    "center_m": "distance of objects' centres (m)",
}
"""Metric of single scenes → its title for people."""
KINDS = (
    (TITLES, "every object has"), (tracks.TITLES, "each frame changes by"), (single_objects.TITLES, "the object has"),
)  # fmt: skip
"""Titles of the metrics of single scenes, of sequences and of single objects, and what has evidence there."""
Metrics = dict[str, float]


@dataclass(frozen=True)
class Scores:
    """The scores of predictions.

    Attributes
    ----------
    dataset : name of the dataset.
    published : whether the dataset is a suite that agrees with the published one.
    split, scenes : the split, and its number of scenes.
    scenes_with_evidence : number of scenes in which every object has evidence (a significance of 3 or more); of
        sequences, in which the change by every object that moves has it, in the median of the frames.
    all, with_evidence : metric → value, over all objects, and over the objects with evidence. Metrics of quantities
        that were not predicted are left out. Of sequences over the objects that move, in all frames.
    """

    dataset: str
    published: bool
    split: str
    scenes: int
    scenes_with_evidence: int
    all: Mapping[str, float]
    with_evidence: Mapping[str, float]

    def table(self) -> str:
        """The scores as a table for people."""
        state = "as published" if self.published else "not one of the published suites"
        titles, has = next(kind for kind in KINDS if self.all.keys() <= kind[0].keys())
        width = max(map(len, titles.values()))
        lines = [
            f"{self.dataset} ({state}), split {self.split}: {self.scenes} scenes, in {self.scenes_with_evidence} of "
            f"them {has} {LEAST:g} σ",
            "",
            f"{'':{width}}  {'all':>8}  {f'≥ {LEAST:g} σ':>8}",
        ]
        for name, value in self.all.items():
            lines.append(f"{titles[name]:{width}}  {value:8.3f}  {self.with_evidence[name]:8.3f}")
        return "\n".join(lines)

    def json(self) -> str:
        """The scores as JSON; NaN becomes null."""
        return json.dumps(finite(asdict(self)), indent=1)


def score(suite: str | Path, predictions: str | Path | Mapping[str, Any], split: str = "test") -> Scores:
    """Score predictions against the labels of a split of a suite.

    Parameters
    ----------
    suite : the folder that `build_suite` made, or any dataset with the fields depth, part_id and objects; of
        sequences, and of scenes with one object each, with the field objects.
    predictions : an `.npz` file, a Zarr group, or a mapping: `scene` (N,) and any of `depth` (N, row, column) in m,
        `mask` (N, row, column) whether an object is seen, `points` (N, M, 3) and `centers` (N, K, 3) in the label
        frame (rows of NaN are fill), `occupancy` (N, depth, row, column) in 0 … 1. Of sequences `centers`
        (N, F, K, 3) of what moves and, if they are to be scored, its `velocities` (N, F, K, 3) in m/s. Of scenes with
        one object each and without depth any of its `places` (N, 2) along right and depth in m, `classes` (N,), which
        are numbers of the dataset's classes, and `heights` (N,) in m.
        docs/datasets.md defines them.
    split : the split whose scenes must all be predicted.

    Raises
    ------
    InputError : no such dataset, missing labels; predictions that have another form, are incomplete, or not finite.
    CheckError : the dataset is damaged.
    """
    check_path("suite", suite, "the folder that build_suite made")
    check_kind(
        "predictions", predictions, str, os.PathLike, Mapping, remedy="an .npz file, a Zarr group, or a mapping"
    )
    check_kind("split", split, str, remedy="such as 'test'")
    manifest = read_manifest(suite)
    of = _of_scenes if manifest.frames is None else _of_sequences
    if manifest.frames is None and single_objects.has_single_objects(manifest):
        of = _of_single_objects
    scenes, evident, every, with_evidence = of(suite, manifest, predictions, split)
    named, published = str(manifest.config["name"]), is_published(suite, manifest)
    return Scores(named, published, split, scenes, evident, every, with_evidence)


Found = tuple[int, int, Metrics, Metrics]
"""Number of scenes, of those with evidence, and the metrics over everything and over what has evidence."""


def _of_scenes(dataset: str | Path, manifest: Manifest, predictions: Any, split: str) -> Found:
    truth = read_truth(dataset, manifest, split)
    found = read_predictions(predictions, truth)
    each, centers = _by_scene(found, truth), _center_errors(found, truth)
    every, evident = (_metrics(found, truth, each, centers, only) for only in (False, True))
    return len(truth.scenes), int(truth.all_evident.sum()), every, evident


def _of_sequences(dataset: str | Path, manifest: Manifest, predictions: Any, split: str) -> Found:
    truth = tracks.read_tracks(dataset, manifest, split)
    errors = tracks.track_errors(predictions, truth)
    every, evident = (tracks.track_metrics(errors, only) for only in (False, True))
    return len(truth.scenes), int((truth.evident | ~truth.moves).all(axis=1).sum()), every, evident


def _of_single_objects(dataset: str | Path, manifest: Manifest, predictions: Any, split: str) -> Found:
    truth = single_objects.read_single_objects(dataset, manifest, split)
    every, evident = single_objects.metrics_of(predictions, truth)
    return len(truth.scenes), int(truth.evident.sum()), every, evident


def _metrics(
    found: Predictions, truth: Truth, each: dict[str, Floats], centers: list[Floats], evident: bool
) -> Metrics:
    """Metric → value, over everything, or (`evident`) over what has evidence: objects for the metrics of depth and of
    centres, scenes in which every object has evidence for the others."""
    values: Metrics = {}
    if found.depth is not None:
        off = (found.depth - truth.depth)[truth.on_evident if evident else truth.on_object]
        values["depth_rmse_m"] = float(np.sqrt(np.mean(off**2))) if off.size else float("nan")
        values["depth_mae_m"] = float(np.mean(np.abs(off))) if off.size else float("nan")
    for name, values_by_scene in each.items():
        chosen = values_by_scene[truth.all_evident] if evident else values_by_scene
        values[name] = float(np.nanmean(chosen)) if np.isfinite(chosen).any() else float("nan")
    if centers:
        of_objects = [row[~np.isnan(row)] for row in truth.sigma]
        chosen_ones = [errors[sigma >= LEAST] for errors, sigma in zip(centers, of_objects, strict=True)]
        every = np.concatenate(chosen_ones if evident else centers)
        values["center_m"] = float(every.mean()) if every.size else float("nan")
    return values


def _by_scene(found: Predictions, truth: Truth) -> dict[str, Floats]:
    """Metric → (N,) value for each scene, of the metrics that are means over scenes."""
    metrics: dict[str, Callable[[int], float]] = {}
    depth, shows = found.depth, found.shows
    if depth is not None and shows is not None:
        metrics["silhouette_iou"] = lambda k: intersection_over_union(shows[k], truth.on_object[k])
        metrics["ssim"] = lambda k: _ssim(depth, shows, truth, k)
    if found.points is not None or depth is not None:
        metrics["chamfer_m"] = lambda k: _chamfer(found, truth, k)
    if found.occupancy is not None and truth.occupancy is not None:
        full, known = found.occupancy > 0.5, truth.occupancy > 0
        metrics["occupancy_iou"] = lambda k: intersection_over_union(full[k], known[k])
    return {name: np.array([metric(k) for k in range(len(truth.scenes))]) for name, metric in metrics.items()}


def _ssim(depth: Floats, mask: Bools, truth: Truth, k: int) -> float:
    """SSIM of the depth images of scene `k`, in units of the hidden part's depth; 0 where no object is."""
    true = np.where(truth.on_object[k], truth.depth[k], 0.0)
    return ssim(np.where(mask[k], depth[k], 0.0) / truth.reach[k], true / truth.reach[k])


def _chamfer(found: Predictions, truth: Truth, k: int) -> float:
    """Chamfer distance of scene `k`, metres: NaN if it shows no object, the diagonal of all if none was found."""
    true = image_points(truth.depth[k], truth.on_object[k], *truth.view[k])
    if not len(true):
        return float("nan")
    if found.points is not None:
        points = found.points[k][~np.isnan(found.points[k, :, 0])]
    else:
        assert found.depth is not None and found.shows is not None
        points = image_points(found.depth[k], found.shows[k], *truth.view[k])
    return chamfer_distance(points, true) if len(points) else float(truth.span[k])


def _center_errors(found: Predictions, truth: Truth) -> list[Floats]:
    """For each scene the error of each object's centre, metres; an empty list without predicted centres."""
    if found.centers is None:
        return []
    return [
        center_distances(centers[~np.isnan(centers[:, 0])], true[~np.isnan(sigma)], float(span))
        for centers, true, sigma, span in zip(found.centers, truth.centers, truth.sigma, truth.span, strict=True)
    ]
