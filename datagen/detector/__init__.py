"""The detector: flux per laser cycle → what a SPAD and its TDC make of it → counts, and their exact mean."""

from datagen.detector.classes import DETECTOR_CLASSES
from datagen.detector.detect import detect, expected_histogram
from datagen.detector.draw import detector_for
from datagen.detector.spad import Exposure, Spad

__all__ = ["DETECTOR_CLASSES", "Exposure", "Spad", "detect", "detector_for", "expected_histogram"]
