"""The scenes of a configuration whose objects are asked to have evidence: placed anew until they do."""

from __future__ import annotations

from collections.abc import Mapping

from datagen.capture import capture_for
from datagen.config import DatasetConfig
from datagen.design.light import estimated_evidence
from datagen.detector import detector_for
from datagen.records import Scene
from datagen.scene import generate_scene

MARGIN = 1.1
"""So many times what is asked for is asked of the estimate, whose light is coarse."""


def scene_for(config: DatasetConfig, index: int) -> Scene:
    """Scene `index` of the dataset that a configuration gives.

    That of `generate_scene(config.scene, config.seed, index)`, but where `contents` ask for `evidence_at_least`: then
    the objects are placed anew until a quick estimate gives each of them as much, with the capture and the detector
    of the scene. How often they were is its parameter `evidence.placed_anew`.

    Raises
    ------
    InputError : as `generate_scene` and `capture_for`; no placing gives enough; the exposure is yet to be found.

    >>> import datagen as dg
    >>> config = dg.load_config("configs/quickstart.yaml")
    >>> dg.scene_for(config, 3).part_names
    ('relay_wall', 'walls', 'floor', 'ceiling', 'pillar', 'box')
    """
    if not config.scene.asks_for_evidence:
        return generate_scene(config.scene, config.seed, index)

    def short_of(scene: Scene, asked: Mapping[str, float]) -> str | None:
        capture = capture_for(config, scene, config.seed, index)
        spad, exposure = detector_for(config.detector, config.seed, index, capture.time)
        found = estimated_evidence(config, index, scene, capture, spad, exposure)
        return next((name for name, least in asked.items() if found[name].significance < MARGIN * least), None)

    return generate_scene(config.scene, config.seed, index, short_of)


def without_floors(config: DatasetConfig) -> DatasetConfig:
    """The configuration with objects wherever they may stand, whatever evidence they have there."""
    contents = tuple(item.model_copy(update={"evidence_at_least": None}) for item in config.scene.contents)
    return config.model_copy(update={"scene": config.scene.model_copy(update={"contents": contents})})
