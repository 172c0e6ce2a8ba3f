"""The light of a scene of a dataset: what of it is followed, how accurately, and with which random numbers.

An exposure to be found, scenes whose objects must have evidence, and the plan of a build rest on the same light at a
coarser target: what evidence a measurement will hold then differs from what is stored by the coarser light alone, for
the detector's law is the same (docs/physics.md has how far)."""

from __future__ import annotations

from dataclasses import dataclass, replace

from datagen.config import DatasetConfig
from datagen.detector import Exposure, Spad
from datagen.effects import EffectDecisions, decide_transport_effects
from datagen.evidence import Evidence, own_evidence
from datagen.records import Accuracy, Capture, Scene, Transient
from datagen.seeding import Purpose, derived_seed
from datagen.transport import transient_of
from datagen.transport.visibility.raycast import Raycaster


@dataclass(frozen=True)
class Light:
    """What is handed to the transport.

    Attributes
    ----------
    scene, accuracy : as the decisions about effects leave them.
    seed : of the scene's own stream.
    caster : of the scene's triangles, where one was made already.
    """

    scene: Scene
    capture: Capture
    accuracy: Accuracy
    seed: int
    caster: Raycaster | None = None

    def transient(self) -> Transient:
        """The light of the scene."""
        return transient_of(self.scene, self.capture, self.accuracy, seed=self.seed, caster=self.caster)

    def background(self) -> Transient:
        """The light of the scene without its objects, from the same samples: what no object touches is the same."""
        empty = self.scene.without(*self.scene.objects)
        return transient_of(empty, self.capture, self.accuracy, seed=self.seed)


def transport_effects(
    config: DatasetConfig, scene: Scene, capture: Capture, index: int, caster: Raycaster | None = None
) -> EffectDecisions:
    """What of scene `index` the transport is to simulate, and why."""
    seed = derived_seed(config.seed, index, Purpose.EFFECTS)
    return decide_transport_effects(scene, capture, config.transport.accuracy(), config.effects, seed, caster)


def light_of(
    config: DatasetConfig, index: int, scene: Scene, capture: Capture, effects: EffectDecisions, spad: Spad,
    exposure: Exposure, caster: Raycaster | None = None,
) -> Light:  # fmt: skip
    """The light of scene `index`, after `transport_effects` were decided, for a detector."""
    lit, accuracy = effects.apply_transport(scene, capture, config.transport.accuracy())
    accuracy = replace(accuracy, faint_part=_one_detection(spad, exposure))
    return Light(lit, capture, accuracy, derived_seed(config.seed, index, Purpose.TRANSPORT), caster)


def _one_detection(spad: Spad, exposure: Exposure) -> float:
    """Photons at the aperture, per emitted photon and over a whole scan, that give one detection on average.

    An object with less light than that is not held to an error of its own.
    """
    counted = exposure.photons_per_pulse * exposure.cycles * spad.pde
    return 1.0 / counted if counted > 0 else 0.0


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
