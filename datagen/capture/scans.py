"""Scan patterns: the laser targets on a relay wall for the settings of `capture.scan`."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from datagen.config.scans import AnyScan, CircleScan, GridScan, ImportedScan, PointsScan, RandomScan, SubsetScan
from datagen.errors import InputError
from datagen.records import Rectangle
from datagen.records.arrays import Floats

DEFAULT_FILL = 0.8
"""Share of the visible wall that a scan or field of view covers by default."""
ON_THE_WALL_M = 0.01
"""Largest distance of a place given as (x, y, z) from the wall's plane."""


def scan_targets(scan: AnyScan, wall: Rectangle, rng: np.random.Generator) -> Floats:
    """(L, 3) laser targets, metres, in the scan's order.

    Grids go row by row from the top left as the device sees them. Only patterns that are drawn for every scene use
    `rng`. Raises `InputError` if the pattern is larger than the visible wall.
    """
    match scan:
        case PointsScan():
            return np.array([_listed_place(f"scan.points_m[{i}]", p, wall) for i, p in enumerate(scan.points_m)])
        case CircleScan():
            return _circle(scan, wall)
        case ImportedScan():
            raise InputError("capture.scan.kind = 'imported': its points stand in the dataset, scene by scene")
    center, right, up = rectangle_on("scan", wall, scan.center_m, scan.width_m, scan.height_m)
    match scan:
        case RandomScan():
            place = rng.uniform(-1, 1, (scan.count, 2))
            return np.asarray(center + place[:, :1] * right + place[:, 1:] * up)
        case SubsetScan():
            chosen = rng.choice(scan.rows * scan.columns, scan.count, replace=False, shuffle=False)
            return _grid(scan, center, right, up)[np.sort(chosen)]
        case GridScan():
            return _grid(scan, center, right, up)
    raise TypeError(f"no pattern is known for {type(scan).__name__}")


def flood_targets(scan: GridScan, center: Floats, right: Floats, up: Floats) -> Floats:
    """(L, 3) midpoints of rows × columns equal cells of a rectangle, row by row from the top left: the nodes of a
    quadrature with equal weights."""
    shrink_right, shrink_up = 1 - 1 / scan.columns, 1 - 1 / scan.rows
    return _grid(scan, center, shrink_right * right, shrink_up * up)


def rectangle_on(
    key: str, wall: Rectangle, center_m: Sequence[float] | None, width_m: float | None, height_m: float | None
) -> tuple[Floats, Floats, Floats]:
    """Centre, and half-extent vectors right and up, of a rectangle on the wall.

    A size that is None becomes `DEFAULT_FILL` of the largest that fits around the centre. Raises `InputError`, with
    keys below `capture.<key>`, if the rectangle extends beyond the visible wall.
    """
    middle = _in_plane(f"{key}.center_m", center_m, wall)
    halves = []
    for name, size_m, axis, offset in zip(
        ("width_m", "height_m"), (width_m, height_m), (wall.right, wall.up), middle, strict=True
    ):
        visible = 2 * float(np.linalg.norm(axis))
        most = visible - 2 * abs(float(offset))
        if most <= 0:
            raise _off_the_wall(f"{key}.center_m", center_m, wall)
        if size_m is not None and size_m > most + 1e-9 * visible:
            around = "" if center_m is None else f" and {most:.3g} m around the centre asked for"
            raise InputError(
                f"capture.{key}.{name} = {size_m:g}: the device sees only {visible:.3g} m of this scene's relay wall"
                f"{around}; make it smaller or leave it out"
            )
        halves.append(axis * ((DEFAULT_FILL * most if size_m is None else size_m) / visible))
    return _at(wall, *middle), halves[0], halves[1]


def _grid(scan: GridScan | SubsetScan, center: Floats, right: Floats, up: Floats) -> Floats:
    """(rows · columns, 3) points of a grid that fills a rectangle, row by row from the top left."""
    across = np.linspace(-1, 1, scan.columns) if scan.columns > 1 else np.zeros(1)
    upward = np.linspace(1, -1, scan.rows) if scan.rows > 1 else np.zeros(1)
    return np.asarray(center + across[None, :, None] * right + upward[:, None, None] * up).reshape(-1, 3)


def _circle(scan: CircleScan, wall: Rectangle) -> Floats:
    """(count, 3) points evenly on a circle, counter-clockwise as the device sees them."""
    middle = _in_plane("scan.center_m", scan.center_m, wall)
    room = np.linalg.norm([wall.right, wall.up], axis=1) - np.abs(middle)
    largest = float(room.min())
    if largest <= 0:
        raise _off_the_wall("scan.center_m", scan.center_m, wall)
    radius = DEFAULT_FILL * largest if scan.radius_m is None else scan.radius_m
    if radius > largest * (1 + 1e-9):
        raise InputError(
            f"capture.scan.radius_m = {radius:g}: around its centre the device sees only {largest:.3g} m of this "
            "scene's relay wall; make it smaller or leave it out"
        )
    angle = np.radians(scan.start_deg) + 2 * np.pi * np.arange(scan.count) / scan.count
    return np.stack([_at(wall, *(middle + radius * np.array([np.cos(a), np.sin(a)]))) for a in angle])


def _listed_place(key: str, place: Sequence[float], wall: Rectangle) -> Floats:
    """(3,) a listed place: a point (x, y, z) of the room as it is, or (right, up) on the visible wall."""
    if len(place) == 3:
        return np.asarray(place, np.float64)
    right, up = place
    reach = np.linalg.norm([wall.right, wall.up], axis=1) * (1 + 1e-9)
    if abs(right) > reach[0] or abs(up) > reach[1]:
        raise _off_the_wall(key, place, wall)
    return _at(wall, right, up)


def _in_plane(key: str, place: Sequence[float] | None, wall: Rectangle) -> Floats:
    """(2,) metres right and up of the wall's centre, of a place given as (right, up) or as (x, y, z)."""
    if place is None:
        return np.zeros(2)
    if len(place) == 2:
        return np.asarray(place, np.float64)
    right, up = (axis / np.linalg.norm(axis) for axis in (wall.right, wall.up))
    from_center = np.asarray(place, np.float64) - wall.center
    off = abs(float(from_center @ np.cross(right, up)))
    if off > ON_THE_WALL_M:
        raise InputError(
            f"capture.{key} = {list(place)}: lies {off:.3g} m off this scene's relay wall; give a point on it, or "
            "(right, up) from the middle of its visible part"
        )
    return np.array([from_center @ right, from_center @ up])


def _at(wall: Rectangle, right_m: float, up_m: float) -> Floats:
    """(3,) the point of the wall at (right, up) from its centre."""
    right, up = (axis / np.linalg.norm(axis) for axis in (wall.right, wall.up))
    return np.asarray(wall.center + right_m * right + up_m * up)


def _off_the_wall(key: str, place: Sequence[float] | None, wall: Rectangle) -> InputError:
    """The error for a place outside the visible wall."""
    width, height = 2 * np.linalg.norm([wall.right, wall.up], axis=1)
    return InputError(
        f"capture.{key} = {None if place is None else list(place)}: lies outside the {width:.3g} × {height:.3g} m of "
        "this scene's relay wall that the device sees; move it nearer to the middle"
    )
