"""The scenes of a configuration that asks its objects for evidence: objects are placed anew until they have it."""

from __future__ import annotations

from collections.abc import Mapping
from statistics import median

from datagen.capture import capture_for
from datagen.config import DatasetConfig
from datagen.design.light import estimated_evidence
from datagen.detector import detector_for
from datagen.records import Clock, Scene
from datagen.records.checks import check_kind
from datagen.scene import generate_scene

MARGIN = 1.1
"""Factor by which the estimate, whose light is coarse, must exceed the requested evidence: nearly all stored objects
then have it."""


def scene_for(config: DatasetConfig, index: int) -> Scene:
    """Scene `index` of the dataset of a configuration.

    This is `generate_scene(config.scene, config.seed, index)`, with `clock=config.clock` for a sequence, unless
    `contents` ask for `evidence_at_least`. Then the objects are placed anew until a quick estimate, with the scene's
    capture and detector, gives each of them as much; of a sequence in the median of its beginning, middle and end.
    The scene's parameter `evidence.placed_anew` says how often they were.

    Raises
    ------
    InputError : as `generate_scene` and `capture_for`; no placing gives enough evidence; the configuration names no
        exposure but `exposure_for`.

    >>> import datagen as dg
    >>> config = dg.load_config("configs/quickstart.yaml")
    >>> dg.scene_for(config, 3).part_names
    ('relay_wall', 'walls', 'floor', 'ceiling', 'pillar', 'box')
    """
    check_kind("config", config, DatasetConfig, remedy="such as load_config(path)")
    if not config.scene.asks_for_evidence:
        return generate_scene(config.scene, config.seed, index, clock=config.clock)

    def object_without_evidence(scene: Scene, least: Mapping[str, float]) -> str | None:
        capture = capture_for(config, scene, config.seed, index)
        spad, exposure = detector_for(config.detector, config.seed, index, capture.time)
        every = [
            estimated_evidence(config, index, one, capture, spad, exposure) for one in _moments(scene, config.clock)
        ]

        def significance(name: str) -> float:
            return median(evidence[name].significance for evidence in every)

        return next((name for name in least if significance(name) < MARGIN * least[name]), None)

    return generate_scene(config.scene, config.seed, index, object_without_evidence, config.clock)


def _moments(scene: Scene, clock: Clock | None) -> list[Scene]:
    """The scene as it stands when evidence is estimated: once, or, where things move, at the beginning, in the middle
    and at the end of the sequence."""
    if clock is None or not scene.moving:
        return [scene]
    return [scene.at(share * clock.duration_s) for share in (0.0, 0.5, 1.0)]


def without_floors(config: DatasetConfig) -> DatasetConfig:
    """The configuration without `evidence_at_least`, so that objects stand wherever there is room."""
    contents = tuple(item.model_copy(update={"evidence_at_least": None}) for item in config.scene.contents)
    return config.model_copy(update={"scene": config.scene.model_copy(update={"contents": contents})})
