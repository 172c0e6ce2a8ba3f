"""A quick estimate of what evidence a measurement will hold: the light of a scene, followed coarsely.

It differs from what a sample of that scene stores by the coarser light alone: the detector's law is the same
(docs/evidence.md has how far).
"""

from __future__ import annotations

from datagen.config import DatasetConfig
from datagen.design.light import light_of, transport_effects
from datagen.detector import Exposure, Spad
from datagen.evidence import Evidence, own_evidence
from datagen.records import Capture, Scene, Transient

COARSE_TARGET = 0.1
"""Error of the light that an estimate rests on, where the configuration gives a finer target."""


def coarse_transient(
    config: DatasetConfig, index: int, scene: Scene, capture: Capture, spad: Spad, exposure: Exposure
) -> Transient:
    """The light of scene `index`, at `COARSE_TARGET`; where numbers of samples are configured, with these."""
    if config.transport.target is not None:
        coarse = {"target": max(COARSE_TARGET, config.transport.target), "part_target": None}
        config = config.model_copy(update={"transport": config.transport.model_copy(update=coarse)})
    effects = transport_effects(config, scene, capture, index)
    return light_of(config, index, scene, capture, effects, spad, exposure).transient()


def estimated_evidence(
    config: DatasetConfig, index: int, scene: Scene, capture: Capture, spad: Spad, exposure: Exposure
) -> dict[str, Evidence]:
    """The evidence of each object of scene `index`, from coarse light."""
    if not scene.objects:
        return {}
    transient = coarse_transient(config, index, scene, capture, spad, exposure)
    return own_evidence(transient, spad, exposure, scene.objects)
