"""Two datasets held against each other: one of captures, one of their simulation."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np

from datagen.devices.agreement import Fitted, clustered_covariance, relative_l2
from datagen.devices.comparison import Comparison
from datagen.errors import InputError
from datagen.records.checks import check_path
from datagen.store.manifest import Manifest
from datagen.store.scenes import Scenes


def compare_datasets(recorded: str | Path, simulated: str | Path) -> Comparison:
    """The histograms of all scenes that two datasets have in common; one scale and one floor are fitted.

    recorded, simulated : folders of datasets with the field histogram; each pixel of each laser point is a zone, and
        each scene a frame; of sequences each frame of each scene.

    Raises `InputError` for datasets without histograms, of other shapes or times, or with no scene in common.
    """
    for name, path in (("recorded", recorded), ("simulated", simulated)):
        check_path(name, path, "name the folder of a dataset")
    ours, theirs = Scenes(recorded), Scenes(simulated)
    common = sorted(set(ours.made()) & set(theirs.made()))
    for dataset in (ours, theirs):
        if "histogram" not in dataset.manifest.schema.by_name:
            raise InputError(f"{dataset.root}: has no field histogram; build it with histogram in store.fields")
    _check_alike(ours.manifest, theirs.manifest, f"{recorded} and {simulated}")
    if not common:
        raise InputError(f"{recorded} and {simulated}: have no scene in common; number scenes alike")
    stacks = [
        np.stack([np.asarray(dataset.read(index).arrays["histogram"], np.float64) for index in common])
        for dataset in (ours, theirs)
    ]
    if stacks[0].shape != stacks[1].shape:
        shapes = " and ".join(
            f"({', '.join(dataset.manifest.schema.by_name['histogram'].dims[1:])}) {stack.shape[1:]}"
            for dataset, stack in zip((ours, theirs), stacks, strict=True)
        )
        raise InputError(f"{recorded} and {simulated}: histograms of {shapes}; they must be alike")
    measured, model = (stack.reshape(-1, math.prod(stack.shape[-3:-1]), stack.shape[-1]) for stack in stacks)
    lit = np.linalg.norm(measured, axis=2, keepdims=True) > 0
    if not lit.all():
        raise InputError(f"{recorded}: {np.sum(~lit)} histograms are empty; nothing can be compared with them")
    weight = 1 / np.linalg.norm(measured, axis=2, keepdims=True)
    design = np.stack([(model * weight).ravel(), np.broadcast_to(weight, model.shape).ravel()], axis=1)
    # A floor that the simulation has, too, may have to be lowered.
    (scale, floor), *_ = np.linalg.lstsq(design, (measured * weight).ravel())
    residual = (measured * weight).ravel() - design @ [scale, floor]
    errors = np.sqrt(np.diag(clustered_covariance(design, residual, len(common))))
    fitted = {
        "scale": Fitted(float(scale), float(errors[0])),
        "floor (counts a bin)": Fitted(float(floor), float(errors[1])),
    }
    modelled = scale * model + floor
    steps = {}
    for name, values in (("nothing", model), ("scale, floor", modelled)):
        error = relative_l2(values, measured)
        steps[name] = float(np.median(error)), float(np.percentile(error, 90))
    return Comparison(str(recorded), str(simulated), fitted, steps, measured, modelled)


def _check_alike(recorded: Manifest, simulated: Manifest, names: str) -> None:
    """Raise `InputError` where histograms of two datasets have other times, or come from another kind of scan."""
    one, other = recorded.time, simulated.time
    half = min(one.width_s, other.width_s) / 2
    ends = abs(one.start_s - other.start_s), abs(one.stop_s - other.stop_s)
    if one.bins == other.bins and (one.origin != other.origin or max(ends) > half):
        texts = (f"{t.width_s * 1e12:.6g} ps from {t.start_s * 1e9:.6g} ns on ({t.origin})" for t in (one, other))
        raise InputError(
            f"{names}: bins of {' and of '.join(texts)}; they must be the same times, so simulate with the time axis "
            "of what was recorded"
        )
    for key, usual in (("pairing", "exhaustive"), ("illumination", "scan")):
        kinds = [manifest.config["capture"].get(key, usual) for manifest in (recorded, simulated)]
        if kinds[0] != kinds[1]:
            raise InputError(f"{names}: capture.{key} is {kinds[0]} and {kinds[1]}; they must be alike")
