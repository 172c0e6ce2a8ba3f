"""Captures: laser points and fields of view as configured, fitted to a scene."""

from datagen.capture.fit import capture_for
from datagen.capture.motion import SensorWay, sensor_way

__all__ = ["SensorWay", "capture_for", "sensor_way"]
