"""What travels between the stages, all of it frozen: scene → capture → transient → sample."""

from datagen.records.accuracy import Accuracy
from datagen.records.capture import Capture, Laser, Origin, Pairing, Sensor, TimeAxis
from datagen.records.materials import Lambertian, Material
from datagen.records.sample import Sample, Scalar, Transient
from datagen.records.scene import Part, Rectangle, Role, Scene

__all__ = [
    "Accuracy",
    "Capture",
    "Lambertian",
    "Laser",
    "Material",
    "Origin",
    "Pairing",
    "Part",
    "Rectangle",
    "Role",
    "Sample",
    "Scalar",
    "Scene",
    "Sensor",
    "TimeAxis",
    "Transient",
]
