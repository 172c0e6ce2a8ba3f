"""The configured capture for a scene: laser points and pixels on its relay wall, and the time axis."""

from __future__ import annotations

import numpy as np

from datagen.capture.devices import device_capture, position_of
from datagen.capture.in_sight import check_hidden, check_in_sight, check_met, pixel_points
from datagen.capture.scans import flood_targets, rectangle_on, scan_targets
from datagen.config import DatasetConfig
from datagen.config.capture import CaptureConfig, FieldOfView
from datagen.config.scans import GridScan, PointsScan
from datagen.errors import InputError
from datagen.records import Capture, Laser, Rectangle, Scene, Sensor
from datagen.records.arrays import Floats
from datagen.records.checks import check_kind
from datagen.seeding import Purpose, generator

CONFOCAL_PIXEL_M = 0.05
"""Side of a confocal pixel on the wall if no size is configured."""
SAME_PLACE_M = 1e-9
"""Distance below which a device stands at the scene's own place. Far above rounding."""


def capture_for(config: DatasetConfig, scene: Scene, seed: int | None = None, index: int = 0) -> Capture:
    """The capture that `config.capture` gives for a scene: laser, sensor and time axis; of a sequence, as it begins,
    with a sensor that stands.

    Laser points of a grid, and pixels, are numbered row by row from the top left as seen from the device (right × up
    of the relay wall points into the room).

    Parameters
    ----------
    seed, index : seed of the dataset (left out, `config.seed`) and number of the scene. Only scans that are drawn for
        every scene depend on them.

    Raises
    ------
    InputError : the scene names no relay wall or device; the scan or the field of view is larger than the wall that
        the device sees; from a configured position a laser point or pixel is hidden, or an object is in plain sight;
        no place is found from which a device sees an object (`capture.at_objects`).

    >>> import datagen as dg
    >>> config = dg.load_config("configs/quickstart.yaml")
    >>> capture = dg.capture_for(config, dg.generate_scene(config.scene, seed=7, index=3))
    >>> capture.shape, capture.laser.targets.shape
    ((256, 1, 512), (256, 3))
    """
    check_kind("config", config, DatasetConfig, remedy="such as load_config(path)")
    check_kind("scene", scene, Scene)
    settings, scene = config.capture, scene.at(0.0) if scene.moving else scene
    wall = scene.relay_wall
    if wall is None:
        raise InputError(
            "scene: names no relay wall; give Scene.from_parts(relay_wall=Rectangle…) or build a Capture"
        )
    rng = generator(config.seed if seed is None else seed, index, Purpose.CAPTURE)
    if settings.device is not None:
        return device_capture(settings, settings.device, scene, wall, rng)
    targets = _targets(settings, wall, rng)
    laser = Laser(position_of("laser", settings.laser_position_m, settings.laser_offset_m, scene), targets)
    place = position_of("sensor", settings.sensor_position_m, settings.sensor_offset_m, scene)
    sensor = _sensor(settings, place, wall, targets)
    capture = Capture(laser, sensor, settings.time.axis(), settings.pairing, settings.illumination)
    _check_sight(settings, scene, capture)
    return capture


def _targets(settings: CaptureConfig, wall: Rectangle, rng: np.random.Generator) -> Floats:
    """(L, 3) laser targets on the wall, metres."""
    scan, view = settings.scan, settings.field_of_view
    if settings.illumination != "flood" or not isinstance(scan, GridScan):
        return scan_targets(scan, wall, rng)
    if settings.flood_fills_view:
        lit = rectangle_on("field_of_view", wall, view.center_m, view.width_m, view.height_m)
    else:
        lit = rectangle_on("scan", wall, scan.center_m, scan.width_m, scan.height_m)
    return flood_targets(scan, *lit)


def _sensor(settings: CaptureConfig, position: Floats, wall: Rectangle, targets: Floats) -> Sensor:
    """The sensor: a grid of pixels on the wall, or a pixel about each laser target if confocal."""
    view: FieldOfView = settings.field_of_view
    radius = view.aperture_radius_mm * 1e-3
    if settings.pairing == "exhaustive":
        center, right, up = rectangle_on("field_of_view", wall, view.center_m, view.width_m, view.height_m)
        return Sensor.grid(position, center, right, up, view.rows, view.columns, radius)
    width = CONFOCAL_PIXEL_M if view.width_m is None else view.width_m
    height = CONFOCAL_PIXEL_M if view.height_m is None else view.height_m
    right = wall.right * (width / 2 / np.linalg.norm(wall.right))
    up = wall.up * (height / 2 / np.linalg.norm(wall.up))
    square = np.stack([-right - up, right - up, right + up, -right + up])
    return Sensor(position, targets[:, None] + square, radius)


def _check_sight(settings: CaptureConfig, scene: Scene, capture: Capture) -> None:
    """Raise `InputError` if a device that stands elsewhere than the scene's own does not see its points, or sees
    objects.

    Confocal pixels may extend beyond the wall's edge, so only their middles have to be in sight.
    """
    if scene.device_position is None:
        return
    places = {"laser": capture.laser.position, "sensor": capture.sensor.position}
    elsewhere = {name: np.linalg.norm(place - scene.device_position) > SAME_PLACE_M for name, place in places.items()}
    scan, pixels, confocal = settings.scan, capture.sensor.pixels, settings.pairing == "confocal"
    anywhere = isinstance(scan, PointsScan) and any(len(point) == 3 for point in scan.points_m)
    points = pixels.mean(axis=1) if confocal else pixel_points(pixels)
    for device, aimed, what, seen in (
        ("laser", anywhere, "laser points", capture.laser.targets),
        ("sensor", anywhere and confocal, "points of pixels", points),
    ):
        if elsewhere[device] or aimed:
            key = _key(settings, device) if elsewhere[device] else "scan.points_m"
            check_in_sight(key, what, scene, places[device], seen)
    if anywhere:
        check_met("scan.points_m", scene, places["laser"], capture.laser.targets)
    for device, place in places.items():
        if elsewhere[device]:
            check_hidden(_key(settings, device), scene, place)


def _key(settings: CaptureConfig, device: str) -> str:
    """The configuration's key that puts a device elsewhere."""
    configured = getattr(settings, f"{device}_position_m") is not None
    return f"{device}_{'position' if configured else 'offset'}_m"
