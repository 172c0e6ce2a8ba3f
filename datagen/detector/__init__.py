"""The detector: flux per laser cycle → what a SPAD and its TDC make of it → counts, and their exact mean."""

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
