"""Evidence, the detectability of objects: how far the light of each stands out of the noise of a measurement.

Detectability is the SNR of a matched filter: the number of standard deviations by which the best linear test that
knows everything else of the scene tells whether the object's light is there. It is called significance here.

With b_i the expected detections of bin i of a histogram (every light, ambient and dark counts, under gate, pile-up
and dead time) and s_i those of an object's own light among them (`detector/own_light.py`), its significance is

    σ = √ Σ s_i² / b_i,

over all bins, pixels and laser points. The mean of Σ (s_i/b_i) n_i over counts n_i differs by σ of its own standard
deviations from that without the object's light.
With a dead time Σ s²/b is the Fisher information of a counting process with intensity λ(t) while the diode is armed;
docs/physics.md has the derivation and what is left out.

Under 3 no network can learn the label from the data.
"""

from datagen.evidence.image import evidence_image
from datagen.evidence.in_sight import light_in_sight
from datagen.evidence.own import Evidence, own_evidence
from datagen.evidence.presence import Presence, presence_evidence

__all__ = ["Evidence", "Presence", "evidence_image", "light_in_sight", "own_evidence", "presence_evidence"]
