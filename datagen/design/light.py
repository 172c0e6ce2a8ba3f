"""The arguments of the transport for a scene of a dataset: effects, accuracy and random seed.

The search for an exposure, scenes whose objects must have evidence, and the plan of a build use the same light at a
coarser target. Their evidence differs from the stored one only by the error of that light, since the detector is the
same (docs/physics.md says by how much).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

from datagen.config import DatasetConfig
from datagen.detector import Exposure, Spad
from datagen.effects import EffectDecisions, decide_transport_effects
from datagen.evidence import Evidence, own_evidence
from datagen.records import Accuracy, Capture, Scene, SequenceLight, Transient
from datagen.records.arrays import Floats
from datagen.seeding import Purpose, derived_seed
from datagen.transport import transient_of
from datagen.transport.rays import Raycaster
from datagen.transport.sequences import light_of_sequence


@dataclass(frozen=True)
class Light:
    """The arguments of the transport.

    scene, accuracy : scene and accuracy without the effects that are left out.
    seed : seed of the scene's own random stream.
    caster : of the scene's triangles, if there is one already.
    captures : one for each frame, of a sensor that moves; None of one that stands.
    """

    scene: Scene
    capture: Capture
    accuracy: Accuracy
    seed: int
    caster: Raycaster | None = None
    captures: tuple[Capture, ...] | None = None

    def transient(self) -> Transient:
        """The transient of the scene."""
        return transient_of(self.scene, self.capture, self.accuracy, seed=self.seed, caster=self.caster)

    def frames(self, times_s: Floats, exposure_s: float, apart: bool = False) -> SequenceLight:
        """The light of the frames of a sequence, whose laser points are measured for `exposure_s` about `times_s`
        (F, L). apart : whether what is by moving parts is told apart in all of it, as in `light_of_sequence`."""
        captures = [self.capture] * len(times_s) if self.captures is None else self.captures
        return light_of_sequence(self.scene, captures, times_s, exposure_s, self.accuracy, self.seed, apart)

    def frames_without(self, name: str, times_s: Floats, exposure_s: float) -> SequenceLight:
        """The light of the frames without one part, from the same random numbers."""
        return replace(self, scene=self.scene.without(name)).frames(times_s, exposure_s)

    def background(self) -> Transient:
        """The transient of the scene without its objects, from the same random numbers: other paths stay the same."""
        empty = self.scene.without(*self.scene.objects)
        return transient_of(empty, self.capture, self.accuracy, seed=self.seed)

    def without(self, name: str) -> Transient:
        """The transient of the scene without one part, from the same random numbers."""
        return transient_of(self.scene.without(name), self.capture, self.accuracy, self.seed, split_parts=False)


def transport_effects(
    config: DatasetConfig, scene: Scene, capture: Capture, index: int, caster: Raycaster | None = None
) -> EffectDecisions:
    """The decisions on the transport's effects in scene `index`."""
    seed = derived_seed(config.seed, index, Purpose.EFFECTS)
    return decide_transport_effects(scene, capture, config.transport.accuracy(), config.effects, seed, caster)


def light_of(
    config: DatasetConfig, index: int, scene: Scene, capture: Capture, effects: EffectDecisions, spad: Spad,
    exposure: Exposure, caster: Raycaster | None = None, frames: int = 1,
) -> Light:  # fmt: skip
    """The arguments of the transport for scene `index`, given its `transport_effects` and its detector.

    frames : how many exposures a laser point has.
    """
    lit, accuracy = effects.apply_transport(scene, capture, config.transport.accuracy())
    # Photons at the aperture, per emitted photon and over a whole scan (all frames of a sequence), that give one
    # detection on average: the error of an object with less light than that does not matter.
    counted = exposure.photons_per_pulse * exposure.cycles * spad.pde * frames
    accuracy = replace(accuracy, faint_part=1.0 / counted if counted > 0 else 0.0)
    return Light(lit, capture, accuracy, derived_seed(config.seed, index, Purpose.TRANSPORT), caster)


COARSE_TARGET = 0.1
"""Relative error of the light for estimates, if the configured target is finer: σ is then known to about a tenth."""


def coarse_transient(
    config: DatasetConfig, index: int, scene: Scene, capture: Capture, spad: Spad, exposure: Exposure
) -> Transient:
    """The transient of scene `index` with the error `COARSE_TARGET`, or with the configured numbers of samples."""
    if config.transport.target is not None:
        coarse = {"target": max(COARSE_TARGET, config.transport.target), "part_target": None}
        config = config.model_copy(update={"transport": config.transport.model_copy(update=coarse)})
    effects = transport_effects(config, scene, capture, index)
    return light_of(config, index, scene, capture, effects, spad, exposure).transient()


def estimated_evidence(
    config: DatasetConfig, index: int, scene: Scene, capture: Capture, spad: Spad, exposure: Exposure
) -> dict[str, Evidence]:
    """Object → evidence in scene `index`, estimated from coarse light."""
    if not scene.objects:
        return {}
    transient = coarse_transient(config, index, scene, capture, spad, exposure)
    return own_evidence(transient, spad, exposure, scene.objects)
