"""Captures: laser points and fields of view as configured, fitted to a scene."""

from datagen.capture.fit import capture_for

__all__ = ["capture_for"]
