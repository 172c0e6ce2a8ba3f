"""The configured capture, fitted to a scene: laser points, pixels and time axis on this room's relay wall."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from datagen.config import DatasetConfig
from datagen.config.capture import CaptureConfig, FieldOfView
from datagen.errors import InputError
from datagen.records import Capture, Laser, Rectangle, Scene, Sensor, TimeAxis

DEFAULT_FILL = 0.8
"""Share of the visible wall that a scan or a field of view covers when no size is configured."""
CONFOCAL_PIXEL_M = 0.05
"""Side of a confocal pixel on the wall when no size is configured."""


def capture_for(config: DatasetConfig, scene: Scene) -> Capture:
    """Laser, sensor and time axis of `config.capture` for this scene.

    Laser points are numbered row by row from the top left as seen from the device (right × up of the relay wall
    points into the room); so are the pixels.

    Raises `InputError` when the scene names no relay wall or device, or when the scan or the field of view is larger
    than the wall that the device sees.
    """
    settings = config.capture
    wall = scene.relay_wall
    if wall is None:
        raise InputError(
            "scene: names no relay wall; give Scene.from_parts(relay_wall=Rectangle…) or build a Capture"
        )
    targets = _scan_points(settings, wall)
    laser = Laser(_position("laser", settings.laser_position_m, scene), targets)
    sensor = _sensor(settings, _position("sensor", settings.sensor_position_m, scene), wall, targets)
    axis = TimeAxis(
        settings.time.bins, settings.time.bin_width_ps * 1e-12, settings.time.start_ns * 1e-9, settings.time.origin
    )
    return Capture(laser, sensor, axis, settings.pairing)


def capture_shape(config: DatasetConfig) -> tuple[int, int, int]:
    """(laser, pixel, bin) of every sample's transient, known without a scene."""
    scan, view = config.capture.scan, config.capture.field_of_view
    return scan.rows * scan.columns, view.rows * view.columns, config.capture.time.bins


def _position(device: str, configured: tuple[float, float, float] | None, scene: Scene) -> NDArray[np.float64]:
    if configured is not None:
        return np.asarray(configured, np.float64)
    if scene.device_position is None:
        raise InputError(f"capture.{device}_position_m: missing, and the scene names no place for the device; set it")
    return scene.device_position


def _half_extents(
    key: str, width_m: float | None, height_m: float | None, wall: Rectangle
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Half-extent vectors of a rectangle centred on the wall; a size left out takes its share of the wall."""
    halves = []
    for name, asked, axis in (("width_m", width_m, wall.right), ("height_m", height_m, wall.up)):
        visible = 2 * float(np.linalg.norm(axis))
        if asked is not None and asked > visible * (1 + 1e-9):
            raise InputError(
                f"capture.{key}.{name} = {asked:g}: the device sees only {visible:.3g} m of this scene's relay wall; "
                "make it smaller or leave it out"
            )
        halves.append(axis * (DEFAULT_FILL if asked is None else asked / visible))
    return halves[0], halves[1]


def _scan_points(settings: CaptureConfig, wall: Rectangle) -> NDArray[np.float64]:
    scan = settings.scan
    right, up = _half_extents("scan", scan.width_m, scan.height_m, wall)
    across = np.linspace(-1, 1, scan.columns) if scan.columns > 1 else np.zeros(1)
    upward = np.linspace(1, -1, scan.rows) if scan.rows > 1 else np.zeros(1)
    return (wall.center + across[None, :, None] * right + upward[:, None, None] * up).reshape(-1, 3)


def _sensor(
    settings: CaptureConfig, position: NDArray[np.float64], wall: Rectangle, targets: NDArray[np.float64]
) -> Sensor:
    view: FieldOfView = settings.field_of_view
    radius = view.aperture_radius_mm * 1e-3
    if settings.pairing == "exhaustive":
        right, up = _half_extents("field_of_view", view.width_m, view.height_m, wall)
        return Sensor.grid(position, wall.center, right, up, view.rows, view.columns, radius)
    width = CONFOCAL_PIXEL_M if view.width_m is None else view.width_m
    height = CONFOCAL_PIXEL_M if view.height_m is None else view.height_m
    right = wall.right * (width / 2 / np.linalg.norm(wall.right))
    up = wall.up * (height / 2 / np.linalg.norm(wall.up))
    square = np.stack([-right - up, right - up, right + up, -right + up])
    return Sensor(position, targets[:, None] + square, radius)
