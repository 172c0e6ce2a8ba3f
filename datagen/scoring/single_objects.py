"""Which object is hidden, how large it is, and where: datasets whose scenes have one object each, and no images."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from datagen.errors import InputError
from datagen.records.arrays import Bools, Floats, Ints
from datagen.scoring.metrics import quantile
from datagen.scoring.predictions import Form, Wanted, read_arrays
from datagen.scoring.truth import labels_of, scenes_of_split
from datagen.store import Manifest
from datagen.store.summaries import LEAST

NEEDED = ("object_class", "object_box_center", "object_box_size", "object_significance", "hidden_bounds")
SIZE_RIGHT = 0.25
"""A height is right that is off by no more than this share of the true one."""
TITLES = {
    "place_rms_m": "distance of places, root mean square (m)",
    "place_median_m": "distance of places, median (m)",
    "place_p90_m": "distance of places, 90 % (m)",
    "class_right": "share of classes that are right",
    "height_right": f"share of heights within {SIZE_RIGHT:.0%}",
}
"""Metric of single objects → its title for people."""


@dataclass(frozen=True)
class SingleObjects:
    """The one object of each scene of a split.

    manifest : the dataset's manifest.
    scenes : (N,) indices of the scenes.
    places : (N, 2) middle of the object's box along right and depth of the label frame, metres.
    classes : (N,) index into the dataset's classes.
    heights : (N,) of the object's box, metres.
    sigma : (N,) significance of the object.
    span : (N,) diagonal of the hidden part, metres.
    """

    manifest: Manifest
    scenes: Ints
    places: Floats
    classes: Ints
    heights: Floats
    sigma: Floats
    span: Floats

    @property
    def evident(self) -> Bools:
        """(N,) whether the object has evidence, a significance of `LEAST` or more."""
        return self.sigma >= LEAST


def has_single_objects(manifest: Manifest) -> bool:
    """Whether a dataset of single scenes is scored here: it has tables of one object, and no images of depth."""
    fields = manifest.schema.by_name
    return "depth" not in fields and all(name in fields for name in NEEDED) and fields[NEEDED[0]].shape == (1,)


def read_single_objects(dataset: str | Path, manifest: Manifest, split: str) -> SingleObjects:
    """The objects of one split. Raises `InputError` if there is no such split, or if a scene has no object;
    `CheckError` if the dataset is damaged."""
    scenes = scenes_of_split(dataset, manifest, split)
    got = labels_of(dataset, manifest, scenes, NEEDED)
    classes, center = got["object_class"][:, 0].astype(np.int64), got["object_box_center"][:, 0].astype(np.float64)
    if (classes < 0).any():
        empty = scenes[int(np.argmax(classes < 0))]
        raise InputError(f"{dataset}: scene {empty} has no object; build with store.fields depth, part_id, objects")
    sides = got["hidden_bounds"][:, 1] - got["hidden_bounds"][:, 0]
    return SingleObjects(
        manifest, np.array(scenes), center[:, [0, 2]], classes, got["object_box_size"][:, 0, 2].astype(np.float64),
        got["object_significance"][:, 0].astype(np.float64), np.linalg.norm(sides, axis=1),
    )  # fmt: skip


def metrics_of(source: str | Path | Mapping[str, Any], truth: SingleObjects) -> tuple[dict[str, float], ...]:
    """Metric → value over all scenes, and over those whose object has evidence; metrics of what was not predicted are
    left out.

    source : an `.npz` file, a Zarr group, or a mapping, with `scene` (N,) and any of `places` (N, 2) in m, `classes`
        (N,) and `heights` (N,) in m. A place of NaN counts as far off as the diagonal of the hidden part.

    Raises `InputError` as `read_arrays` does.
    """
    span = float(truth.span.max())
    classes = len(truth.manifest.schema.by_name["object_class"].classes)
    class_form = Form((), "class", classes=classes)
    forms = {"places": Form((2,), "m", span), "classes": class_form, "heights": Form((), "depth", span)}
    found = read_arrays(source, Wanted(truth.manifest, truth.scenes, forms))
    return tuple(_metrics(found, truth, chosen) for chosen in (np.ones_like(truth.evident), truth.evident))


def _metrics(found: Mapping[str, Floats], truth: SingleObjects, chosen: Bools) -> dict[str, float]:
    values = dict[str, float]()
    if "places" in found:
        off = np.linalg.norm(found["places"] - truth.places, axis=1)
        off = np.where(np.isnan(off), truth.span, off)[chosen]
        values["place_rms_m"] = float(np.sqrt(_mean(off**2)))
        values |= {"place_median_m": quantile(off, 0.5), "place_p90_m": quantile(off, 0.9)}
    if "classes" in found:
        values["class_right"] = _mean((found["classes"] == truth.classes)[chosen])
    if "heights" in found:
        wrong = np.abs(found["heights"] - truth.heights) / truth.heights
        values["height_right"] = _mean((wrong <= SIZE_RIGHT)[chosen])
    return values


def _mean(values: Floats | Bools) -> float:
    return float(np.mean(values)) if values.size else float("nan")
