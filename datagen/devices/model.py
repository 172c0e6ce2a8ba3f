"""A device in a scene: its capture, its detector and its exposure. The catalogue by name, and device files."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from warnings import warn

import numpy as np
from numpy.typing import ArrayLike

from datagen.capture.device_optics import capture_at
from datagen.config.detector import DetectorConfig
from datagen.config.device import DeviceConfig, device_names, read_device
from datagen.detector import Exposure, Spad, detector_for
from datagen.devices.frames import Frames, check_poses
from datagen.devices.yaml_files import check_yaml_path, write_yaml
from datagen.devices.zone_order import in_device_order
from datagen.errors import InputError, InputWarning
from datagen.records import Capture
from datagen.records.checks import as_points, as_reals, check_kind


class Device(DeviceConfig):
    """A sensor with its light source; `Device.at` places it in a scene.

    Examples
    --------
    >>> import datagen as dg
    >>> device = dg.device("tmf8820")
    >>> capture, spad, exposure = device.at(position=(0, 0, 1), toward=(1, 0, 1), up=(0, 0, 1))
    >>> capture.shape, capture.illumination, spad.bins_merged
    ((1, 9, 1024), 'flood', 8)
    """

    def at(self, position: ArrayLike, toward: ArrayLike, up: ArrayLike = (0, 0, 1)) -> tuple[Capture, Spad, Exposure]:
        """The device at a place: its capture for `simulate`, and its detector and exposure for `detect`.

        Parameters
        ----------
        position : (3,) of the sensor's aperture, metres.
        toward : (3,) a point on its axis, metres.
        up : (3,) direction, any length, that its vertical is nearest to.

        Raises
        ------
        InputError : positions that are not finite, `toward` at the position, or `up` along the axis.
        """
        place, target = as_points("Device.at: position", position, (3,)), as_points("Device.at: toward", toward, (3,))
        vertical = as_points("Device.at: up", up, (3,))
        return capture_at(self, place, target, vertical), self.spad, self.exposure

    def at_pose(self, pose: ArrayLike) -> tuple[Capture, Spad, Exposure]:
        """As `at`, for a 4 × 4 pose matrix: its columns are the device's left, up and forward, and its position."""
        matrix = as_reals("Device.at_pose: pose", pose)
        if matrix.shape != (4, 4) or not np.isfinite(matrix).all():
            raise InputError(f"Device.at_pose: shape {matrix.shape} given; a finite 4 × 4 matrix is needed")
        check_poses("Device.at_pose: pose", matrix[None])
        place, forward, up = matrix[:3, 3], matrix[:3, 2], matrix[:3, 1]
        return self.at(place, place + forward, up)

    @property
    def spad(self) -> Spad:
        """The detector."""
        return self._detector()[0]

    @property
    def exposure(self) -> Exposure:
        """The exposure of one frame."""
        return self._detector()[1]

    def _detector(self) -> tuple[Spad, Exposure]:
        """Detector and exposure, as of the scenes of a dataset with this device."""
        return detector_for(DetectorConfig().of_device(self), 0, 0)


def has_shape_of(frames: Frames, device: Device, zones: int) -> bool:
    """Whether frames have `zones` zones, or one more, and a device's bins."""
    _, found, bins = frames.histograms.shape
    return found in (zones, zones + 1) and bins == device.time.bins


def recorded_by(source: object, frames: Frames, device: Device, zones: int) -> Frames:
    """Frames of a device with `zones` zones, in the order of the device where the file states another.

    Where there is one histogram more than zones, the first is taken as that of the reference channel, as drivers put
    it: it is moved to `Frames.reference` with a warning. Raises `InputError`, which names the `source`, for frames of
    other shapes, and for an order of zones that is none.
    """
    _, found, bins = frames.histograms.shape
    what = f"{source}: {found} zones of {bins} bins, {device.name} has {zones} of {device.time.bins}"
    if not has_shape_of(frames, device, zones):
        raise InputError(f"{what}; {_likely_cause(found, bins, device, zones)}")
    if found > zones:
        warn(f"{what}; the first is taken as the reference channel and left out", InputWarning, stacklevel=3)
    return in_device_order(without_reference(frames, zones), device.zones)


def without_reference(frames: Frames, zones: int) -> Frames:
    """Frames of `zones` zones: the first of one histogram more is moved to `Frames.reference`."""
    if frames.histograms.shape[1] == zones:
        return frames
    return replace(frames, histograms=frames.histograms[:, 1:], reference=frames.histograms[:, 0])


def _likely_cause(found: int, bins: int, sensor: Device, zones: int) -> str:
    """What makes frames of (found, bins) most likely, where a device has `zones` zones, and what to do."""
    other = [
        name
        for name in device_names()
        if device(name).time.bins == bins and found in (n := device(name).zones.count, n + 1)
    ]
    if other:
        return f"these have the shape of {' and '.join(other)}: name the device that recorded them"
    if (found, bins) in ((sensor.time.bins, zones), (sensor.time.bins, zones + 1)):
        return "the last two axes look swapped: hists is (frames, zones, bins)"
    if found in (zones, zones + 1):
        return (
            f"the sensor was set to other bins: give time.bins = {bins} and its bin_width_ps in a device file "
            f"(`datagen device {sensor.name}` prints one)"
        )
    if bins == sensor.time.bins:
        return (
            "a mode with other zones, or frames in parts that belong together: put them in one histogram a zone, or "
            "give zones.boxes of that mode in a device file"
        )
    return "name the device that recorded them, of the catalogue or as a device file"


def device(name: str | Path) -> Device:
    """A device of the catalogue by its name, or of a file by its path (`datagen calibrate` writes one).

    Raises `InputError` for a name that is neither, and for a file that is no device.

    >>> import datagen as dg
    >>> dg.device("vl53l8ch").zones.rows
    8
    """
    return read_device(name, Device)


def write_device(device: Device, path: str | Path) -> None:
    """Write a device to a file that `device` reads. Raises `InputError` where the file cannot be written."""
    check_kind("device", device, DeviceConfig, remedy="such as dg.device('tmf8820')")
    check_yaml_path(path, "a device file", "name the file to make, .yaml")
    write_yaml(json.loads(device.model_dump_json(exclude_defaults=True)), path)
