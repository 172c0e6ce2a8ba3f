"""`transport: {target: …}` in a configuration: refused beside sample counts, kept in a manifest, and reported."""

from __future__ import annotations

from pathlib import Path

import pytest

from datagen.building.build import build
from datagen.config import DatasetConfig, config_from_mapping
from datagen.errors import InputError
from datagen.store.info import info

pytestmark = pytest.mark.usefixtures("builds_here")

SMALL = {
    "name": "targeted",
    "scenes": 2,
    "capture": {
        "scan": {"rows": 2, "columns": 2, "width_m": 0.5, "height_m": 0.5},
        "time": {"bins": 32, "bin_width_ps": 2000, "start_ns": 20},
    },
    "labels": {"rows": 4, "columns": 4},
    "store": {"fields": ["histogram", "transient"]},
}


def configured(**transport: object) -> DatasetConfig:
    return config_from_mapping({**SMALL, "transport": transport})


def test_counts_beside_a_target_and_impossible_targets_are_refused() -> None:
    for name in ("lookins", "fov_samples", "replicates", "observed"):
        with pytest.raises(InputError, match=f"target.*{name}|{name}.*target"):
            configured(target=0.1, **{name: 64})
    for value in (0.0, 2, -0.1, "fine"):
        with pytest.raises(InputError, match=r"transport\.target"):
            configured(target=value)


def test_a_target_reaches_the_simulation_and_the_fingerprint() -> None:
    config = configured(target=0.1, max_bounces=4, max_lookins=5000)
    assert config.fingerprint() != configured(target=0.2, max_bounces=4, max_lookins=5000).fingerprint()
    accuracy = config.transport.accuracy()
    assert (accuracy.target, accuracy.max_lookins, accuracy.max_bounces) == (0.1, 5000, 4)


def test_a_dataset_says_whether_its_targets_were_met(tmp_path: Path) -> None:
    build(configured(target=0.3), tmp_path / "targeted", progress=False)
    assert "target met in 2 of 2 scenes" in info(tmp_path / "targeted")
    build(configured(target=1e-4, max_lookins=2048), tmp_path / "hopeless", progress=False)
    assert "target met in 0 of 2 scenes" in info(tmp_path / "hopeless")
