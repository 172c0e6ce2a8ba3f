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


@pytest.mark.parametrize("name", ["lookins", "fov_samples", "replicates", "observed"])
def test_counts_beside_a_target_are_refused_even_at_their_defaults(name: str) -> None:
    with pytest.raises(InputError, match=name) as error:
        configured(target=0.1, **{name: 64})
    assert "target" in str(error.value)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize("value", [0.0, 2, -0.1, "fine"])
def test_impossible_targets_are_refused(value: object) -> None:
    with pytest.raises(InputError, match=r"transport\.target"):
        configured(target=value)


def test_a_target_reaches_the_simulation_and_the_fingerprint() -> None:
    config = configured(target=0.1, max_bounces=4, max_lookins=5000)
    assert config.fingerprint() != configured(target=0.2, max_bounces=4, max_lookins=5000).fingerprint()
    accuracy = config.transport.accuracy()
    assert (accuracy.target, accuracy.max_lookins, accuracy.max_bounces) == (0.1, 5000, 4)


def test_a_dataset_says_whether_its_targets_were_met(tmp_path: Path) -> None:
    build(configured(target=0.3), tmp_path / "targeted", progress=False)
    text = info(tmp_path / "targeted")
    assert "target met in 2 of 2 scenes" in text
    assert "share of the transport's cost (median): primary 100%" in text
    build(configured(target=1e-4, max_lookins=2048), tmp_path / "hopeless", progress=False)
    assert "target met in 0 of 2 scenes" in info(tmp_path / "hopeless")
