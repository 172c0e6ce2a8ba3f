"""Sensors that one can buy or that laboratories built, and their calibration from a sweep before a plane."""

from datagen.config.device import device_names
from datagen.devices.calibrate import Calibration, Fitted, calibrate
from datagen.devices.frames import Frames, read_frames
from datagen.devices.model import Device, device, write_device
from datagen.devices.sight import share_of_late_zones, zone_depth

__all__ = [
    "Calibration",
    "Device",
    "Fitted",
    "Frames",
    "calibrate",
    "device",
    "device_names",
    "read_frames",
    "share_of_late_zones",
    "write_device",
    "zone_depth",
]
