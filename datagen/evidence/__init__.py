"""What a label rests on: the light that each object brings to a measurement, and how far it stands out of the noise.

With b_i the expected detections of bin i of a histogram (every light, ambient and dark counts, under gate, pile-up
and dead time) and s_i those of an object's own light among them (`detector/own_light.py`), its significance is

    σ = √ Σ s_i² / b_i,

over all bins, pixels and laser points: what a matched filter sees that knows everything else of the scene. The mean
of Σ (s_i/b_i) n_i over counts n_i differs by σ of its own standard deviations from that without the object's light.
With a dead time Σ s²/b is the Fisher information of a counting process with intensity λ(t) while the diode is armed;
docs/physics.md has the derivation and what is left out.

Under 3 no network can learn the label from the data.
"""

from datagen.evidence.image import evidence_image
from datagen.evidence.in_sight import light_in_sight
from datagen.evidence.own import Evidence, own_evidence
from datagen.evidence.presence import Presence, presence_evidence

__all__ = ["Evidence", "Presence", "evidence_image", "light_in_sight", "own_evidence", "presence_evidence"]
