"""A quick estimate of what evidence a measurement will hold: the light of a scene, followed coarsely.

It differs from what a sample of that scene stores by the coarser light alone: the detector's law is the same
(docs/evidence.md has how far).
"""

from __future__ import annotations

from dataclasses import replace

from datagen.config import DatasetConfig
from datagen.detector import Exposure, Spad
from datagen.effects import decide_transport_effects
from datagen.evidence import Evidence, own_evidence
from datagen.records import Capture, Scene, Transient
from datagen.seeding import Purpose, derived_seed
from datagen.transport import transient_of

COARSE_TARGET = 0.1
"""Error of the light that an estimate rests on, where the configuration gives a finer target."""


def coarse_transient(config: DatasetConfig, index: int, scene: Scene, capture: Capture, faintest: float) -> Transient:
    """The light of scene `index`, at `COARSE_TARGET`; where numbers of samples are configured, with these.

    faintest : photons per emitted photon under which an object's light need not be known well.
    """
    transport = config.transport
    if transport.target is not None:
        coarse = {"target": max(COARSE_TARGET, transport.target), "part_target": None}
        transport = transport.model_copy(update=coarse)
    accuracy = transport.accuracy()
    seed = derived_seed(config.seed, index, Purpose.EFFECTS)
    effects = decide_transport_effects(scene, capture, accuracy, config.effects, seed)
    lit, accuracy = effects.apply_transport(scene, capture, accuracy)
    accuracy = replace(accuracy, faint_part=faintest)
    return transient_of(lit, capture, accuracy, seed=derived_seed(config.seed, index, Purpose.TRANSPORT))


def estimated_evidence(
    config: DatasetConfig, index: int, scene: Scene, capture: Capture, spad: Spad, exposure: Exposure
) -> dict[str, Evidence]:
    """The evidence of each object of scene `index`, from coarse light."""
    if not scene.objects:
        return {}
    transient = coarse_transient(config, index, scene, capture, one_detection(spad, exposure))
    return own_evidence(transient, spad, exposure, scene.objects)


def one_detection(spad: Spad, exposure: Exposure) -> float:
    """Photons at the aperture, per emitted photon and over a whole scan, that give one detection on average.

    An object with less light than that is not held to an error of its own.
    """
    counted = exposure.photons_per_pulse * exposure.cycles * spad.pde
    return 1.0 / counted if counted > 0 else 0.0
