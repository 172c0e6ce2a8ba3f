"""A floor plan with heights, and the closed surface it stands for.

Conventions: right-handed, z up, metres; the device stands at x = y = 0 and looks along +x at the relay wall, which
lies in a plane x = constant. Layouts are drawn with the hidden part at y > 0 and mirrored as a whole.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from scene_library.arrays import Floats
from scene_library.polygons import (
    Polygon,
    contains,
    cross,
    is_simple,
    point_segment_distance,
    segments_of,
    triangulate,
)
from scene_library.solids import Surface, joined


class RoomDoesNotClose(ValueError):
    """These dimensions give no room: the message says which of them to change."""


@dataclass(frozen=True)
class Doorway:
    """An opening through a wall: jambs from corner `a` to `b` and from `c` to `d` of the outline, and a lintel."""

    a: int
    b: int
    c: int
    d: int
    height_m: float


@dataclass(frozen=True)
class FloorPlan:
    """A room in plan.

    Attributes
    ----------
    outline : (n, 2) corners, counter-clockwise.
    relay_edge : the edge `outline[i] → outline[i + 1]` that is the relay wall.
    height_m : floor to ceiling.
    device : (3,) position of laser and sensor, inside.
    hidden_corners : those corners of the outline whose bounding box, in plan, holds the hidden part (with the far
        end of the screen, where there is one).
    across_from_low : whether the hidden part is entered at its low-y side (else at its high-y side).
    doorway : an opening lower than the room, or None.
    open_air : the outline only limits where objects stand; of its edges the relay wall alone is a surface.
    screen : (2, 2) a free-standing upright screen in plan, as high as the room, or None.
    all_in_view : the device sees the whole relay wall by the way that the plan is made. Rays past its ends, which a
        device near its plane sees at a slant, would miss some microns of it.
    """

    outline: Polygon
    relay_edge: int
    height_m: float
    device: Floats
    hidden_corners: tuple[int, ...]
    across_from_low: bool = True
    doorway: Doorway | None = None
    open_air: bool = False
    screen: Floats | None = None
    all_in_view: bool = False

    @cached_property
    def edges(self) -> Floats:
        """(n, 2, 2) the edges of the outline."""
        return segments_of(self.outline)

    @property
    def walls(self) -> Floats:
        """(m, 2, 2) the vertical surfaces in plan."""
        walls = self.relay_segment[None] if self.open_air else self.edges
        return walls if self.screen is None else np.concatenate([walls, self.screen[None]])

    @property
    def limits(self) -> Floats:
        """(m, 2, 2) walls and, in the open, the limits of sight."""
        return self.edges if self.screen is None else np.concatenate([self.edges, self.screen[None]])

    @property
    def relay_segment(self) -> Floats:
        """(2, 2) the relay wall in plan, from right to left as seen from the room."""
        return np.asarray(self.edges[self.relay_edge])

    @cached_property
    def hidden(self) -> Floats:
        """(2, 2) low and high corner of the box, in plan, that holds the hidden part before the relay wall."""
        corners = self.outline[list(self.hidden_corners)]
        if self.screen is not None:
            corners = np.concatenate([corners, self.screen[1:]])
        high = corners.max(axis=0)
        return np.array([corners.min(axis=0), [min(high[0], self.relay_segment[0, 0]), high[1]]])

    @property
    def visible_top_m(self) -> float:
        """How high up the relay wall the device sees: to the ceiling, or to what a lintel leaves free."""
        if self.doorway is None:
            return self.height_m
        lintel_x = self.outline[[self.doorway.b, self.doorway.c], 0].max()
        rise = (self.doorway.height_m - self.device[2]) * self.relay_segment[0, 0] / lintel_x
        return float(min(self.height_m, self.device[2] + rise))


def mirrored(plan: FloorPlan) -> FloorPlan:
    """The plan reflected in y = 0; it stays counter-clockwise."""
    n = len(plan.outline)
    door = plan.doorway
    if door is not None:
        a, b, c, d = (n - 1 - i for i in (door.a, door.b, door.c, door.d))
        door = Doorway(d, c, b, a, door.height_m)
    return replace(
        plan,
        outline=(plan.outline * [1.0, -1.0])[::-1],
        relay_edge=(n - 2 - plan.relay_edge) % n,
        device=plan.device * [1.0, -1.0, 1.0],
        hidden_corners=tuple(n - 1 - i for i in plan.hidden_corners),
        across_from_low=not plan.across_from_low,
        doorway=door,
        screen=None if plan.screen is None else plan.screen * [1.0, -1.0],
    )


def wall_groups(plan: FloorPlan) -> list[int]:
    """For every edge the first edge on the same line: both sides of an opening belong to one wall."""
    edges = plan.edges
    along = edges[:, 1] - edges[:, 0]
    along /= np.linalg.norm(along, axis=1)[:, None]
    groups = list(range(len(edges)))
    for i in range(len(edges)):
        for j in range(i):
            offset = edges[i] - edges[j, 0]
            if np.abs(cross(offset, along[j])).max() < 1e-9:
                groups[i] = groups[j]
                break
    return groups


def out_of_square(plan: FloorPlan, angles_rad: Floats) -> FloorPlan:
    """Rotate every wall but the relay wall about its middle by `angles_rad` (n,); the corners move along.

    Edges of one wall (`wall_groups`) rotate together, by the angle of the first.
    Raises `RoomDoesNotClose` when walls would cross or the device would be left outside.
    """
    edges, groups = plan.edges, np.array(wall_groups(plan))
    middle = np.array([edges[groups == g].reshape(-1, 2).mean(axis=0) for g in groups])
    angles = np.where(groups == groups[plan.relay_edge], 0.0, np.asarray(angles_rad)[groups])
    c, s = np.cos(angles), np.sin(angles)
    along = edges[:, 1] - edges[:, 0]
    along = np.stack([c * along[:, 0] - s * along[:, 1], s * along[:, 0] + c * along[:, 1]], axis=1)
    before, before_along = np.roll(middle, 1, axis=0), np.roll(along, 1, axis=0)
    bend = cross(before_along, along)
    if (np.abs(bend) < 0.1 * np.linalg.norm(along, axis=-1) * np.linalg.norm(before_along, axis=-1)).any():
        raise RoomDoesNotClose("two neighbouring walls come out nearly parallel; lower out_of_square_deg")
    outline = before + (cross(middle - before, along) / bend)[:, None] * before_along
    # The relay wall stays in its plane to the last bit.
    outline[[plan.relay_edge, (plan.relay_edge + 1) % len(outline)], 0] = plan.relay_segment[:, 0]
    back = np.einsum("ij,ij->i", np.roll(outline, -1, axis=0) - outline, along)
    if not is_simple(outline) or (back <= 0).any():
        raise RoomDoesNotClose("walls cross each other; lower out_of_square_deg")
    if (
        not contains(outline, plan.device[:2])
        or point_segment_distance(plan.device[None, :2], segments_of(outline)).min() < 0.05
    ):
        raise RoomDoesNotClose("the device comes to stand in a wall; lower out_of_square_deg")
    return replace(plan, outline=outline)


def surfaces(plan: FloorPlan, *, floor: bool = True, ceiling: bool = True) -> dict[str, Surface]:
    """The plan as surfaces `relay_wall`, `walls`, `floor`, `ceiling`: closed, triangles meeting edge to edge.

    In the open there are no `walls`, and a `screen` where the plan has one.
    """
    n, door, height = len(plan.outline), plan.doorway, plan.height_m
    levels = {i: [0.0, height] for i in range(n)}
    if door is not None:
        for i in (door.a, door.b, door.c, door.d):
            levels[i] = [0.0, door.height_m, height]
    i = plan.relay_edge
    result = {"relay_wall": _wall(plan.outline, i, (i + 1) % n, levels, 0.0, height)}
    if not plan.open_air:
        result["walls"] = _other_walls(plan, levels)
    if plan.screen is not None:
        result["screen"] = _wall(plan.screen, 0, 1, {0: [0.0, height], 1: [0.0, height]}, 0.0, height)
    if floor:
        result["floor"] = _slab(plan.outline, 0.0)
    if ceiling:
        result["ceiling"] = joined([_slab(piece, z) for piece, z in _ceiling_pieces(plan)])
    return result


def _other_walls(plan: FloorPlan, levels: dict[int, list[float]]) -> Surface:
    n, door, height = len(plan.outline), plan.doorway, plan.height_m
    walls = []
    for i in range(n):
        if i != plan.relay_edge:
            top = door.height_m if door is not None and i in (door.a, door.c) else height
            walls.append(_wall(plan.outline, i, (i + 1) % n, levels, 0.0, top))
    if door is not None:
        for i, j in ((door.a, door.d), (door.c, door.b)):
            walls.append(_wall(plan.outline, i, j, levels, door.height_m, height))
    return joined(walls)


def _ceiling_pieces(plan: FloorPlan) -> list[tuple[Polygon, float]]:
    door, n = plan.doorway, len(plan.outline)
    if door is None:
        return [(plan.outline, plan.height_m)]

    def around(start: int, stop: int) -> Polygon:
        return plan.outline[[(start + k) % n for k in range((stop - start) % n + 1)]]

    quad = plan.outline[[door.a, door.b, door.c, door.d]]
    return [
        (around(door.b, door.c), plan.height_m),
        (around(door.d, door.a), plan.height_m),
        (quad, door.height_m),
    ]


def _slab(polygon: Polygon, z: float) -> Surface:
    return np.column_stack([polygon, np.full(len(polygon), z)]), triangulate(polygon)


def _wall(outline: Polygon, i: int, j: int, levels: dict[int, list[float]], bottom: float, top: float) -> Surface:
    """The wall over the edge i → j, with a corner wherever a neighbour has one."""
    long = float(np.linalg.norm(outline[j] - outline[i]))
    right = [(long, z) for z in levels[j] if bottom <= z <= top]
    left = [(0.0, z) for z in reversed(levels[i]) if bottom <= z <= top]
    flat = np.array(right + left)
    on_plan = np.where(flat[:, :1] > 0, outline[j], outline[i])
    return np.column_stack([on_plan, flat[:, 1]]), triangulate(flat)
