"""Checks, by rays, that devices which a configuration places in a scene see their points but no hidden object."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from datagen.errors import InputError
from datagen.records import Scene
from datagen.records.arrays import Floats
from scene_library.sightlines import first_faces, lattice_points

INWARD = 0.02
"""Share of the way from a pixel's corner to its middle at which the corner is checked, because a pixel's edge may lie
exactly on the wall's."""
ON_A_WALL = 1e-5
"""Share of the distance to an object within which single precision cannot tell whether it or a wall comes first."""


def check_in_sight(key: str, what: str, scene: Scene, eye: Floats, points: Floats) -> None:
    """Raise `InputError` for `capture.<key>` if a part but the relay wall hides one of `points` (n, 3) from `eye`."""
    wall = scene.relay_wall
    if wall is not None and (eye - wall.center) @ np.cross(wall.right, wall.up) <= 0:
        raise InputError(
            f"capture.{key}: {_place(eye)} lies behind the plane of the relay wall; move the device into the room"
        )
    face = first_faces(scene.corners, eye, points)
    relay = np.array([role == "relay_wall" for role in scene.roles])
    hidden = (face >= 0) & ~relay[scene.face_part[face]]
    if hidden.any():
        first = int(np.argmax(hidden))
        name = scene.part_names[scene.face_part[face[first]]]
        raise InputError(
            f"capture.{key}: from {_place(eye)} the part {name!r} hides {int(hidden.sum())} of {len(points)} {what} "
            f"(the first at {_place(points[first])}); move the device, or make scan and field of view smaller"
        )


def check_met(key: str, scene: Scene, eye: Floats, points: Floats) -> None:
    """Raise `InputError` for `capture.<key>` if a ray from `eye` through one of `points` (n, 3) meets no surface."""
    missing = first_faces(scene.corners, eye, points, slack=-np.inf) < 0
    if missing.any():
        raise InputError(
            f"capture.{key}: from {_place(eye)} the laser meets nothing towards {int(missing.sum())} of "
            f"{len(points)} points (the first is {_place(points[np.argmax(missing)])}); put them on a surface"
        )


def check_hidden(key: str, scene: Scene, eye: Floats) -> None:
    """Raise `InputError` for `capture.<key>` if `eye` sees an object, which has to be hidden around the corner.

    Only the room hides objects: one that hides another would be seen itself.
    """
    seen = in_plain_sight(scene, eye, scene.objects)
    if seen:
        raise InputError(
            f"capture.{key}: from {_place(eye)} the object {seen[0]!r} is in plain sight; move the device towards "
            "the place that the scene gives it, or leave the key out"
        )


def in_plain_sight(scene: Scene, eye: Floats, objects: Sequence[str]) -> list[str]:
    """Those of some objects that the room does not hide from `eye` (3,)."""
    roles = np.array(scene.roles)[scene.face_part]
    room, found = scene.corners[roles != "object"], list[str]()
    for name in objects:
        points = lattice_points(scene.corners[scene.faces_of(name)])
        if not len(room) or (first_faces(room, eye, points, slack=ON_A_WALL) < 0).any():
            found.append(name)
    return found


def pixel_points(pixels: Floats) -> Floats:
    """(5 P, 3) middles and corners of pixels (P, 4, 3), the corners moved a little inward."""
    middle = pixels.mean(axis=1, keepdims=True)
    inner = pixels + INWARD * (middle - pixels)
    return np.concatenate([middle, inner], axis=1).reshape(-1, 3)


def _place(point: Floats) -> str:
    return "(" + ", ".join(f"{x:.3g}" for x in point) + ")"
