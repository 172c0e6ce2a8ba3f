"""Ready configurations and suites at small size, and digests of what they give, pinned in `small_configs.json`.

    python tests/small_configs.py [--geometry]

(`make digests`) renews those of all values, which change whenever light or noise of a seed do; with `--geometry` also
those of rooms, scans and pixels, which change only when rooms do. Versions are those of the lock file: with it the
bytes are the same on every x86-64, which `tests/cpu_types.py` tries with other types of processor.
"""

from __future__ import annotations

import functools
import hashlib
import json
import sys
import tempfile
from pathlib import Path
from typing import Any

import numpy as np

from datagen.building.build import build
from datagen.capture import capture_for
from datagen.config import DatasetConfig, config_from_mapping, load_config
from datagen.scene import generate_scene
from datagen.store.environment import LIBRARIES, made_with
from datagen.store.verify import dataset_digest

CONFIGS = Path(__file__).resolve().parents[1] / "configs"
READY = [*sorted(CONFIGS.glob("*.yaml")), *sorted((CONFIGS.parent / "datagen/suites").glob("*.yaml"))]
MOST = {"rows": 3, "columns": 3, "count": 4}
"""Of a scan or a field of view."""


def reduced(config: DatasetConfig) -> DatasetConfig:
    """One scene with fewer of everything, and otherwise the same."""
    values: dict[str, Any] = config.model_dump(mode="json")
    device = values["capture"].get("device")
    if device is not None:
        # The rest of the section follows from the device; its zones stay as they are.
        device["light"] |= {key: min(device["light"][key], MOST[key]) for key in ("rows", "columns")}
        values["capture"] = {key: values["capture"][key] for key in ("device", "at_objects")}
    for section in ("scan", "field_of_view") if device is None else ():
        part = values["capture"][section]
        for number, size in (("rows", "height_m"), ("columns", "width_m")):
            if part.get(number) and part.get(size) and section == "field_of_view":
                # Pixels of the same size, so that as many photons meet one.
                part[size] *= min(part[number], MOST[number]) / part[number]
        part |= {key: min(part[key], most) for key, most in MOST.items() if key in part}
    uneven = values["scene"]["layout"].get("relay_wall", {})
    if "max_triangles" in uneven:
        uneven["max_triangles"] = min(uneven["max_triangles"], 1500)
    if values["detector"]["array_columns"] is not None:
        values["detector"]["array_columns"] = values["capture"]["field_of_view"]["columns"]
    coarse = {"lookins": 32, "fov_samples": 1, "replicates": 2}
    values["transport"] |= coarse if values["transport"]["target"] is None else {"target": 0.3}
    values["labels"] |= {"rows": 16, "columns": 16, "voxels": [8, 8, 8]}
    values["scenes"] = 1
    return config_from_mapping(values, base_directory=CONFIGS)


PINNED = Path(__file__).with_suffix(".json")
GEOMETRY_SCENES = 3


def geometry_digests(config: DatasetConfig) -> dict[str, str]:
    """Rooms, relay walls, laser points and pixels of the first scenes → SHA-256 of their doubles."""
    found: dict[str, Any] = {}
    for index in range(GEOMETRY_SCENES):
        scene = generate_scene(config.scene, config.seed, index)
        capture, wall = capture_for(config, scene, config.seed, index), scene.relay_wall
        arrays = {"room": scene.vertices, "laser points": capture.laser.targets, "pixels": capture.sensor.pixels}
        if wall is not None:
            arrays["relay wall"] = np.stack([wall.center, wall.right, wall.up])
        for name, values in arrays.items():
            found.setdefault(name, hashlib.sha256()).update(np.ascontiguousarray(values, "<f8").tobytes())
    return {name: digest.hexdigest() for name, digest in found.items()}


@functools.cache
def pinned() -> dict[str, Any]:
    values: dict[str, Any] = json.loads(PINNED.read_text())
    return values


def made_as_pinned() -> bool:
    """Whether this is the architecture, and these are the versions, that the digests are promised for."""
    return {name: made_with()[name] for name in (*LIBRARIES, "machine")} == pinned()["made_with"]


def main() -> None:
    old = pinned() if PINNED.exists() else {}
    configs = {path.stem: load_config(path) for path in READY}
    geometry = {} if "--geometry" in sys.argv else old.get("geometry", {})
    geometry = {name: digests for name, digests in geometry.items() if name in configs}
    geometry |= {name: geometry_digests(config) for name, config in configs.items() if name not in geometry}
    values = {}
    with tempfile.TemporaryDirectory() as folder:
        for name, config in configs.items():
            build(reduced(config), Path(folder, name), progress=False)
            values[name] = dataset_digest(Path(folder, name))
            print(name, "changed" if old.get("values", {}).get(name) != values[name] else "as before", flush=True)
    made = {name: made_with()[name] for name in (*LIBRARIES, "machine")}
    PINNED.write_text(json.dumps({"made_with": made, "geometry": geometry, "values": values}, indent=1) + "\n")


if __name__ == "__main__":
    main()
