"""Every configuration that ships draws rooms that meet every law, and hardly ever gives a drawn room up."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from room_laws import assert_room_laws

from datagen.config import load_config
from datagen.scene import check_scene_config, generate_scene

CONFIGS = sorted((Path(__file__).resolve().parents[2] / "configs").glob("*.yaml"))


def test_there_are_some() -> None:
    assert {"quickstart", "own_mesh", "furnished_rooms", "letters_on_a_bench"} <= {c.stem for c in CONFIGS}


@pytest.mark.parametrize("path", CONFIGS, ids=lambda path: path.stem)
def test_rooms_of_every_ready_configuration(path: Path) -> None:
    config = load_config(path)
    assert config.name == path.stem
    assert config.description
    check_scene_config(config.scene)
    draws = []
    for index in range(8):
        scene = generate_scene(config.scene, config.seed, index)
        draws.append(scene.parameters["draws"])
        assert_room_laws(scene, np.random.default_rng(index))
    assert np.mean(draws) < 1.5
