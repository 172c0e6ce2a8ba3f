"""Where a configured device stands in a scene, and what it looks at."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from datagen.capture.device_optics import capture_at
from datagen.capture.in_sight import check_in_sight
from datagen.config.capture import AtObjects, CaptureConfig, Point
from datagen.config.device import DeviceConfig
from datagen.config.distributions import draw
from datagen.errors import InputError
from datagen.records import Capture, Rectangle, Scene
from datagen.records.arrays import Floats
from scene_library.sightlines import first_faces

UP = np.array([0.0, 0.0, 1.0])
TRIES = 256
"""Places tried for a device that looks straight at an object, enough for a crowded room with few free places."""
STEEPEST = 2**-0.5
"""Largest sine of the angle at which a device looks up or down at the middle of an object: 45 degrees."""
ELBOW_ROOM_M = 0.05
"""Least distance of a device from the first surface along each axis."""


def device_capture(
    settings: CaptureConfig, device: DeviceConfig, scene: Scene, wall: Rectangle, rng: np.random.Generator
) -> Capture:
    """The capture of a device in a scene: before the relay wall, or (`at_objects`) before an object.

    Raises `InputError` where the relay wall's middle is hidden from a configured place, or no place sees an object.
    """
    straight = settings.at_objects
    if straight is not None and scene.objects and rng.random() < straight.share:
        place, target = _before_an_object(straight, scene, rng)
    else:
        place = position_of("sensor", settings.sensor_position_m, settings.sensor_offset_m, scene)
        target = wall.center
        for key in ("sensor_position_m", "sensor_offset_m"):
            if getattr(settings, key) is not None:
                check_in_sight(key, "point that the device looks at", scene, place, target[None])
    return replace(capture_at(device, place, target, UP), time=settings.time.axis())


def _before_an_object(straight: AtObjects, scene: Scene, rng: np.random.Generator) -> tuple[Floats, Floats]:
    """(3,) place of a device that looks straight at an object, and (3,) a point on its axis."""
    corners = scene.corners
    for _ in range(TRIES):
        name = scene.objects[int(rng.integers(len(scene.objects)))]
        own = corners[scene.faces_of(name)].reshape(-1, 3)
        middle = (own.min(axis=0) + own.max(axis=0)) / 2
        distance, height = draw(straight.distance_m, rng), draw(straight.height_m, rng)
        bearing, aside = 2 * np.pi * rng.random(), np.radians(draw(straight.aside_deg, rng))
        rise = float(np.clip(height - middle[2], -STEEPEST * distance, STEEPEST * distance))
        away = np.array([np.cos(bearing), np.sin(bearing), 0.0]) * np.sqrt(distance**2 - rise**2)
        place = middle + away + rise * UP
        if _sees(scene, corners, place, middle, name):
            ahead = middle - place
            turned = [
                np.cos(aside) * ahead[0] - np.sin(aside) * ahead[1],
                np.sin(aside) * ahead[0] + np.cos(aside) * ahead[1],
            ]
            return place, place + np.array([*turned, ahead[2]])
    raise InputError(
        f"capture.at_objects: none of {TRIES} places sees an object of this scene; allow other distances and "
        "heights, or a larger room"
    )


def _sees(scene: Scene, corners: Floats, place: Floats, middle: Floats, name: str) -> bool:
    """Whether a place in the room is free, and nothing stands between it and the middle of an object."""
    face = first_faces(corners, place, middle[None])[0]
    if face >= 0 and scene.part_names[scene.face_part[face]] != name:
        return False
    return has_elbow_room(corners, place) and bool(np.linalg.norm(middle - place) > 0)


def has_elbow_room(corners: Floats, place: Floats) -> bool:
    """Whether no triangle (F, 3, 3) lies within `ELBOW_ROOM_M` of a place (3,) along each axis."""
    around = place + ELBOW_ROOM_M * np.concatenate([np.eye(3), -np.eye(3)])
    return bool((first_faces(corners, place, around, slack=0.0) < 0).all())


def position_of(device: str, configured: Point | None, offset: Point | None, scene: Scene) -> Floats:
    """(3,) position of a device: as configured, or the scene's own place, moved by `offset`."""
    if configured is not None:
        return np.asarray(configured, np.float64)
    if scene.device_position is None:
        raise InputError(f"capture.{device}_position_m: missing, and the scene names no place for the device; set it")
    return scene.device_position if offset is None else scene.device_position + np.asarray(offset, np.float64)
