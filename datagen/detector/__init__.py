"""The detector: from the flux per laser cycle to the counts of a SPAD and its TDC, and to their expected values.

The expected value is exact for every mode, except where afterpulsing, crosstalk or saturating counters meet a dead
time: there `expected_histogram` needs `approximate=True`, and its error is of second order in their probabilities.

Not modelled:

- recovery of the PDE after the dead time: the diode is back at full sensitivity at once;
- twilight pulses: an avalanche that begins while the diode is being armed is recorded like any other;
- gate memory: photons that arrive before the gate opens have no effect on it;
- photons outside the time axis: a direct return before its start, or light after its end, causes no dead time.
"""

from datagen.detector.classes import DETECTOR_CLASSES, detector_for
from datagen.detector.detect import choose_sampler, detect, detect_and_choice, expected_histogram
from datagen.detector.sampler_choice import Sampler, SamplerChoice
from datagen.detector.spad import Exposure, Pulse, Spad

__all__ = [
    "DETECTOR_CLASSES", "Exposure", "Pulse", "Sampler", "SamplerChoice", "Spad", "choose_sampler",
    "detect", "detect_and_choice", "detector_for", "expected_histogram",
]  # fmt: skip
