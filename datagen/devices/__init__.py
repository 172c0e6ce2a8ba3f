"""Sensors that one can buy or that laboratories built: their calibration from a sweep before a plane, and captures
held against their simulation."""

from datagen.config.device import device_names
from datagen.devices.agreement import Fitted
from datagen.devices.calibrate import Calibration, calibrate
from datagen.devices.compare import compare
from datagen.devices.compared_datasets import compare_datasets
from datagen.devices.comparison import Comparison
from datagen.devices.frames import Frames, read_frames
from datagen.devices.material_files import read_materials, write_materials
from datagen.devices.mesh_parts import read_parts
from datagen.devices.model import Device, device, recorded_by, without_reference, write_device
from datagen.devices.sight import share_of_late_zones, zone_depth

__all__ = [
    "Calibration",
    "Comparison",
    "Device",
    "Fitted",
    "Frames",
    "calibrate",
    "compare",
    "compare_datasets",
    "device",
    "device_names",
    "read_frames",
    "read_materials",
    "read_parts",
    "recorded_by",
    "share_of_late_zones",
    "without_reference",
    "write_device",
    "write_materials",
    "zone_depth",
]
