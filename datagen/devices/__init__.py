"""Sensors that one can buy or that laboratories built, and their calibration from a sweep before a plane."""

from datagen.devices.model import Device, device, device_names

__all__ = ["Device", "device", "device_names"]
