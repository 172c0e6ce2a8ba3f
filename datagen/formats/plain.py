"""A scene as plain arrays: `.npz` for NumPy, `.h5` for programs that read HDF5. Every field has its stored values."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np

from datagen.formats.containers import h5py
from datagen.records.arrays import Floats
from datagen.store.scenes import SceneContent


def write_npz(scene: SceneContent, path: Path) -> None:
    """Write all fields by name, `bin_edges_s`, and `info`, a JSON text with what are attributes in the `.h5` file.

    Where the sensor merges bins, `transient_bin_edges_s` are those of the transient."""
    arrays: dict[str, Any] = {**scene.arrays, **_edges(scene)}
    np.savez_compressed(path, info=np.array(json.dumps(_info(scene))), **arrays)


def write_h5(scene: SceneContent, path: Path) -> None:
    """Write all fields by name, with labelled axes and the attributes `units` and `long_name`, and `parameters`."""
    with h5py().File(path, "w") as file:
        for field in scene.manifest.schema.fields:
            value = scene.arrays[field.name]
            stored = file.create_dataset(field.name, data=value, compression="gzip" if value.size > 64 else None)
            stored.attrs["units"], stored.attrs["long_name"] = field.unit, field.meaning
            for axis, name in enumerate(field.dims[1:]):
                stored.dims[axis].label = name
            if field.classes:
                stored.attrs["classes"] = list(field.classes)
        for name, values in _edges(scene).items():
            edges = file.create_dataset(name, data=values)
            edges.attrs["units"] = "s"
            edges.attrs["long_name"] = f"edges of the bins, counted from the {scene.time.origin}"
        info = _info(scene)
        parameters = file.create_group("parameters").attrs
        for name, value in info.pop("parameters").items():
            parameters[name] = value
        for name, value in info.items():
            file.attrs[name] = value


def _edges(scene: SceneContent) -> dict[str, Floats]:
    """Name → edges of the bins of an axis of time, seconds."""
    edges = {"bin_edges_s": scene.time.edges_s}
    if scene.manifest.bins_merged > 1:
        edges["transient_bin_edges_s"] = scene.manifest.time_of("transient").edges_s
    return edges


def _info(scene: SceneContent) -> dict[str, Any]:
    config = scene.manifest.config
    return {
        "dataset": config["name"],
        "scene": scene.index,
        "fingerprint": scene.manifest.fingerprint,
        "pairing": config["capture"]["pairing"],
        "time_origin": scene.time.origin,
        "parameters": dict(scene.parameters),
    }
