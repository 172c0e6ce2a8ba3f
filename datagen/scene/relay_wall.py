"""The surfaces of an uneven relay wall and of the clutter before it, drawn from settings and a floor plan."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from datagen.config.distributions import draw, draw_count
from datagen.config.scene_relay import RelayWall
from datagen.records import Scalar
from datagen.records.arrays import Floats
from scene_library.clutter import CLUTTER
from scene_library.placement import Occupied
from scene_library.polygons import boundary_distance, contains
from scene_library.relief import Relief, ReliefTooFine, bumpy, corrugated, curved, stepped, uneven_wall
from scene_library.rooms import FloorPlan, RoomDoesNotClose
from scene_library.separation import gap_between
from scene_library.solids import Surface
from scene_library.visibility import visible_fan, visible_interval

CLUTTER_GAP_M = 0.01
"""Gap between the relay wall's nominal plane and the clutter before it, far above the rounding of rays
in single precision."""
_PLACES_TRIED = 40
"""Places tried for a piece of clutter before the room is drawn again."""


@dataclass(frozen=True)
class PlacedClutter:
    """A piece of clutter before the relay wall: kind, shape, the space it takes, and its numbers by short name."""

    kind: str
    surface: Surface
    occupied: Occupied
    parameters: dict[str, Scalar]


def draw_relay_wall(
    settings: RelayWall, plan: FloorPlan, rng: np.random.Generator
) -> tuple[Surface | None, dict[str, Scalar]]:
    """The surface of an uneven relay wall, and the numbers drawn; for a flat wall None, and nothing is drawn.

    Raises `scene_library.rooms.RoomDoesNotClose` when its triangle budget cannot resolve it.
    """
    if settings.kind == "flat":
        return None, {}
    start, end = plan.relay_segment
    size = float(np.linalg.norm(end - start)), plan.height_m
    relief_m = draw(settings.relief_m, rng)
    drawn: dict[str, Scalar] = {"relay_wall.kind": settings.kind, "relay_wall.relief_m": relief_m}
    length_m = 0.0
    if settings.kind != "curved":
        length_m = drawn["relay_wall.length_m"] = draw(settings.length_m, rng)
    try:
        relief = _relief(settings, size, length_m, rng)
    except ReliefTooFine as error:
        raise RoomDoesNotClose(str(error)) from None
    return uneven_wall(start, end, plan.height_m, relief, relief_m), drawn


def _relief(settings: RelayWall, size: tuple[float, float], length_m: float, rng: np.random.Generator) -> Relief:
    budget = settings.max_triangles
    match settings.kind:
        case "corrugated":
            phase = rng.uniform(0, 2 * np.pi)
            return corrugated(*size, length_m, phase, settings.ridges == "vertical", budget)
        case "bumpy":
            return bumpy(*size, length_m, budget, rng)
        case "stepped":
            return stepped(*size, length_m, budget, rng)
    return curved(*size)


def draw_clutter(
    settings: RelayWall, plan: FloorPlan, clearance_m: float, rng: np.random.Generator
) -> list[PlacedClutter]:
    """Clutter before the visible part of the relay wall, clear of the other walls and of each other.

    Where the count is 0 nothing else is drawn from `rng`. Raises `scene_library.rooms.RoomDoesNotClose` where a piece
    has no place.
    """
    clutter = settings.clutter
    count = draw_count(clutter.count, rng)
    if count == 0:
        return []
    start, end = plan.relay_segment
    seen = visible_interval(visible_fan(plan.limits, plan.device[:2]), start, end)
    if seen is None:
        return []
    walls = plan.walls[(np.abs(plan.walls - plan.relay_segment) > 0).any(axis=(1, 2))]
    placed: list[PlacedClutter] = []
    for _ in range(count):
        kind = clutter.kinds[int(rng.integers(len(clutter.kinds)))]
        reach_m, width_m = draw(clutter.reach_m, rng), draw(clutter.width_m, rng)
        piece = CLUTTER[kind](width_m, reach_m, plan.height_m, rng)
        for _ in range(_PLACES_TRIED):
            along_m = rng.uniform(*seen)
            surface, occupied = _before_wall(piece, along_m, start, end)
            if _is_free(occupied, placed, plan, walls, clearance_m):
                break
        else:
            raise RoomDoesNotClose(
                f"a {kind} of relay_wall.clutter ({width_m:.2g} m wide, {reach_m:.2g} m out) has no place before the "
                f"{seen[1] - seen[0]:.2g} m of relay wall that the device sees: lower its count, width_m or reach_m"
            )
        x, y = occupied.footprint.mean(axis=0)
        numbers: dict[str, Scalar] = {"x_m": float(x), "y_m": float(y), "width_m": width_m, "reach_m": reach_m}
        placed.append(PlacedClutter(kind, surface, occupied, numbers))
    return placed


def _before_wall(piece: Surface, along_m: float, start: Floats, end: Floats) -> tuple[Surface, Occupied]:
    """Surface and space of a piece (x along the wall, y out of it, z up) whose middle is at `along_m`."""
    vertices, faces = piece
    along = (end - start) / np.linalg.norm(end - start)
    inward = np.array([-along[1], along[0]])

    def in_plan(places: Floats) -> Floats:
        return np.asarray(start + (along_m + places[:, :1]) * along + (CLUTTER_GAP_M + places[:, 1:2]) * inward)

    low, high = vertices.min(axis=0), vertices.max(axis=0)
    corners = np.array([[low[0], low[1]], [high[0], low[1]], [high[0], high[1]], [low[0], high[1]]])
    placed = np.column_stack([in_plan(vertices), vertices[:, 2]])
    return (placed, faces), Occupied(in_plan(corners), float(low[2]), float(high[2]))


def _is_free(
    candidate: Occupied, placed: list[PlacedClutter], plan: FloorPlan, walls: Floats, clearance_m: float
) -> bool:
    footprint = candidate.footprint
    if not plan.open_air and not contains(plan.outline, footprint).all():
        return False
    if len(walls) and boundary_distance(footprint, walls) < clearance_m:
        return False
    if np.linalg.norm(footprint - plan.device[:2], axis=1).min() < 0.1:
        return False
    return all(
        gap_between(footprint, other.occupied.footprint) >= clearance_m
        or max(other.occupied.bottom_m - candidate.top_m, candidate.bottom_m - other.occupied.top_m) >= clearance_m
        for other in placed
    )
