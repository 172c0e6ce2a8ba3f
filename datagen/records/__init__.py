"""Frozen records that travel between the stages: scene → capture → transient → sample."""

from datagen.records.accuracy import Accuracy
from datagen.records.capture import Capture, Laser, Origin, Pairing, Sensor, TimeAxis
from datagen.records.clock import Clock, Order
from datagen.records.materials import (
    GGX,
    Lambertian,
    Material,
    MeasuredByAngle,
    OrenNayar,
    Phong,
    Retroreflector,
    SinLobe,
)
from datagen.records.path import Moves, Path
from datagen.records.sample import OnSurfaces, Sample, Scalar, Transient
from datagen.records.scene import Part, Pose, Rectangle, Role, Scene
from datagen.records.sequence_light import SequenceLight

__all__ = [
    "GGX", "Accuracy", "Capture", "Clock", "Lambertian", "Laser", "Material", "MeasuredByAngle", "Moves",
    "OnSurfaces", "Order", "OrenNayar", "Origin", "Pairing", "Part", "Path", "Phong", "Pose", "Rectangle",
    "Retroreflector", "Role", "Sample", "Scalar", "Scene", "Sensor", "SequenceLight", "SinLobe", "TimeAxis",
    "Transient",
]  # fmt: skip
