"""Every ready configuration is built, verified and read, with fewer laser points, pixels and rays."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

import datagen as dg
from datagen.capture import capture_for
from datagen.config import DatasetConfig, config_from_mapping, load_config
from datagen.scene import generate_scene
from datagen.store import verify

CONFIGS = Path(__file__).resolve().parents[2] / "configs"
READY = sorted(CONFIGS.glob("*.yaml"))
MOST = {"rows": 3, "columns": 3, "count": 4}
"""Of a scan or a field of view."""


def reduced(config: DatasetConfig) -> DatasetConfig:
    """One scene with fewer of everything, and otherwise the same."""
    values: dict[str, Any] = config.model_dump(mode="json")
    for section in ("scan", "field_of_view"):
        part = values["capture"][section]
        for number, size in (("rows", "height_m"), ("columns", "width_m")):
            if part.get(number) and part.get(size) and section == "field_of_view":
                # Pixels of the same size, so that as many photons meet one.
                part[size] *= min(part[number], MOST[number]) / part[number]
        part |= {key: min(part[key], most) for key, most in MOST.items() if key in part}
    if values["detector"]["array_columns"] is not None:
        values["detector"]["array_columns"] = values["capture"]["field_of_view"]["columns"]
    coarse = {"lookins": 32, "fov_samples": 1, "replicates": 2}
    values["transport"] |= coarse if values["transport"]["target"] is None else {"target": 0.3}
    values["labels"] |= {"rows": 16, "columns": 16, "voxels": [8, 8, 8]}
    values["scenes"] = 1
    return config_from_mapping(values, base_directory=CONFIGS)


def test_there_are_at_least_eight() -> None:
    assert len(READY) >= 8
    configs = [load_config(path) for path in READY]
    kinds = {(config.capture.pairing, config.capture.scan.kind) for config in configs}
    assert {("confocal", "grid"), ("confocal", "subset"), ("exhaustive", "grid"), ("exhaustive", "points")} <= kinds
    assert any(config.capture.illumination == "flood" and config.transport.direct for config in configs)
    assert any(config.scene.layout.relay_wall.kind != "flat" for config in configs)
    assert any({"shaded", "objects"} <= set(config.store.fields) for config in configs)


@pytest.mark.parametrize("path", READY, ids=lambda path: path.stem)
def test_every_ready_configuration_is_built(path: Path, tmp_path: Path) -> None:
    config = reduced(load_config(path))
    result = dg.build(config, tmp_path / "set", progress=False)
    assert result.complete
    assert verify(tmp_path / "set").problems == ()
    data = dg.TransientDataset(str(tmp_path / "set"), fields=("histogram",))
    counts = np.asarray(data[0]["histogram"])
    assert counts.shape == config.capture.shape
    assert counts.sum() > 0


@pytest.mark.parametrize("path", READY, ids=lambda path: path.stem)
def test_the_whole_scan_fits_every_scene(path: Path) -> None:
    config = load_config(path)
    for index in range(6):
        scene = generate_scene(config.scene, config.seed, index)
        assert capture_for(config, scene, config.seed, index).shape == config.capture.shape
