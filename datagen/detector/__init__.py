"""The detector: flux per laser cycle → what a SPAD and its TDC make of it → counts, and their mean.

The mean is exact for every mode, except where afterpulsing, crosstalk or saturating counters meet a dead time; there
`expected_histogram` asks for `approximate=True` and is good to second order in their probabilities.

Not modelled:

- recovery of the PDE after the dead time: the diode is back at full sensitivity at once;
- twilight pulses: an avalanche that begins while the diode is being armed comes out like any other;
- gate memory: what arrives before the gate opens leaves no trace in it;
- nonlinearity of the TDC: all bins have the same width;
- photons outside the time axis: a direct return before its start, or light after its end, causes no dead time.
"""

from pathlib import Path

from datagen.compiled import drop_stale_kernels
from datagen.detector.classes import DETECTOR_CLASSES
from datagen.detector.detect import detect, expected_histogram, plan_detector
from datagen.detector.draw import detector_for
from datagen.detector.inverse import coates_correction, dead_time_correction
from datagen.detector.plan import DetectorPlan, Sampler
from datagen.detector.spad import Exposure, Spad

__all__ = [
    "DETECTOR_CLASSES",
    "DetectorPlan",
    "Exposure",
    "Sampler",
    "Spad",
    "coates_correction",
    "dead_time_correction",
    "detect",
    "detector_for",
    "expected_histogram",
    "plan_detector",
]

drop_stale_kernels(Path(__file__).parent)
