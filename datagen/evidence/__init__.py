"""Evidence: the detectability of objects in the noise of a measurement.

Detectability is the signal-to-noise ratio of a matched filter, the number of standard
deviations by which the best linear test, which knows everything else of the scene, tells whether the object's light
is there. Let b_i be the expected detections of bin i of a histogram (all light, ambient and dark counts, under gate,
pile-up and dead time), and s_i those of the object's own light among them (`detector/own_light.py`). The
detectability of the object, the `significance` of fields and parameters, is

    σ = √ Σ s_i² / b_i

over all bins, pixels and laser points. The mean of Σ (s_i/b_i) n_i over counts n_i differs by σ of its own standard
deviations from its mean without the object's light. With a dead time Σ s²/b is the Fisher information of a counting
process whose intensity is λ(t) while the diode is armed; docs/physics.md has the derivation and its limits.

Below a σ of 3 no network can learn the label from the data.
"""

from datagen.evidence.image import evidence_image
from datagen.evidence.in_sight import light_in_sight
from datagen.evidence.own import Evidence, own_evidence
from datagen.evidence.presence import Presence, presence_evidence

__all__ = ["Evidence", "Presence", "evidence_image", "light_in_sight", "own_evidence", "presence_evidence"]
