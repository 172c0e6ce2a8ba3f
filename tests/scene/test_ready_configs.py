"""Every configuration and suite that ships draws rooms that meet every law and that its whole scan fits; those of
`configs/` hardly ever give a drawn room up."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from room_laws import assert_room_laws
from small_configs import CONFIGS, READY

from datagen.capture import capture_for
from datagen.config import load_config
from datagen.scene import check_scene_config, generate_scene


@pytest.mark.parametrize("path", READY, ids=lambda path: path.stem)
def test_rooms_of_every_ready_configuration(path: Path) -> None:
    config = load_config(path)
    assert config.name == path.stem
    assert config.description
    check_scene_config(config.scene)
    draws = []
    for index in range(2):
        scene = generate_scene(config.scene, config.seed, index, clock=config.clock)
        draws.append(scene.parameters["draws"])
        assert_room_laws(scene, np.random.default_rng(index))
        assert capture_for(config, scene, config.seed, index).shape == config.capture.shape
    assert path.parent != CONFIGS or np.mean(draws) < 1.5
