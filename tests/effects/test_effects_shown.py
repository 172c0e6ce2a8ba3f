"""Stored decisions in the text of `info`, and in the replay of a scene."""

from __future__ import annotations

from pathlib import Path

import pytest

from datagen.building.build import build
from datagen.config import config_from_mapping
from datagen.report.replay import read_scene, replay
from datagen.store.info import info

pytestmark = pytest.mark.usefixtures("builds_here")


@pytest.fixture(scope="module")
def dataset(tmp_path_factory: pytest.TempPathFactory) -> Path:
    config = config_from_mapping(
        {
            "name": "shown",
            "scenes": 1,
            "capture": {"scan": {"rows": 2, "columns": 2}, "time": {"bins": 32, "bin_width_ps": 1600}},
            "transport": {"lookins": 64, "fov_samples": 1, "max_bounces": 4, "direct": True},
            "detector": {"photons_per_pulse": 1e4},
            "store": {"fields": ["histogram", "transient"]},
            "effects": {"secondary_bounce": "off", "direct_return": "on"},
        }
    )
    root = tmp_path_factory.mktemp("effects") / "shown.zarr"
    build(config, root, progress=False)
    return root


def test_info_counts_scenes_by_decision(dataset: Path) -> None:
    lines = {line.split()[0]: line.split()[1:] for line in info(dataset).splitlines() if line.strip()}
    assert lines["secondary_bounce"] == ["0", "1", "configuration"]
    assert lines["direct_return"] == ["1", "0", "configuration"]
    assert lines["timing_response"][:2] == ["0", "1"] and float(lines["timing_response"][2]) <= 0.01
    assert "higher_bounces" not in lines
    assert "effects" in lines


def test_replay_leaves_out_the_same_effects(dataset: Path) -> None:
    again = replay(read_scene(dataset, 0))
    assert again.reproduced
    assert set(again.transient.components) == {"direct", "primary"}
