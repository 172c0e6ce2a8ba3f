"""The ready configurations and suites, and each of them at small size."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from datagen.config import DatasetConfig, config_from_mapping

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
        values["capture"] = {key: values["capture"].get(key) for key in ("device", "at_objects", "motion")}
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
    coarse = {"samples": 32}
    values["transport"] |= coarse if values["transport"]["target"] is None else {"target": 0.3}
    values["labels"] |= {"rows": 16, "columns": 16, "voxels": [8, 8, 8]}
    values["scenes"] = 1
    return config_from_mapping(values, base_directory=CONFIGS)
