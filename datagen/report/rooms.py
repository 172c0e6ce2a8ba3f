"""A room in plan and opened like a doll's house, with device, laser points, field of view and the labels' window.

Both pictures are made by parallel rays, so they have no perspective. Walls that hide what is in the room are taken
off, and only their edges are drawn.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import trimesh
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection, PolyCollection
from matplotlib.colors import to_rgb
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from numpy.typing import NDArray

from datagen.records import Capture, Scene
from datagen.records.arrays import Bools, Floats, Ints
from datagen.report.style import FIELD_OF_VIEW, INK, LASER, part_colors, short

HIDDEN_VIEW = "#117733"
TAKEN_OFF = "#777777"
LEGEND_COLUMNS = 4
_ELEVATION_DEG = 42.0
_AZIMUTHS_DEG = (-55.0, -30.0, 30.0, 55.0)
_SURVEY_PIXELS = 160
"""Longer side of the pictures that decide which walls go and from where the room is seen; wide enough for a wall of
5 cm in a room of 8 m."""
_IN_THE_WAY = 0.002
"""Share of the picture that a wall may hide before it is taken off."""
_LYING = 0.7
"""Least vertical part of the normal of floor and ceiling."""
_FEW_PIXELS = 400
"""Sensor pixels up to which their outlines can be told apart."""


@dataclass(frozen=True)
class Camera:
    """Parallel projection. `axes` (3, 3): unit vectors right, up, and into the scene, as rows."""

    axes: Floats

    @classmethod
    def looking(cls, azimuth_deg: float, elevation_deg: float) -> Camera:
        """A camera that looks at the scene: azimuth counted from +x towards +y, elevation above the floor."""
        a, e = np.radians([azimuth_deg, elevation_deg])
        into = -np.array([np.cos(e) * np.cos(a), np.cos(e) * np.sin(a), np.sin(e)])
        right = np.array([-np.sin(a), np.cos(a), 0.0])
        return cls(np.stack([right, np.cross(right, into), into]))

    @classmethod
    def from_above(cls) -> Camera:
        """The camera of a plan: x to the right, y up."""
        return cls(np.array([[1.0, 0, 0], [0, 1, 0], [0, 0, -1]]))

    def project(self, points: Floats) -> Floats:
        """(..., 3) world → (..., 3): metres right, up and into the picture."""
        return points @ self.axes.T


@dataclass(frozen=True)
class View:
    """What parallel rays meet, in a grid over the whole scene.

    faces : (rows, columns) the triangle met, −1 for none.
    depth : (rows, columns) metres along the camera into the scene; inf for none.
    extent : left, right, bottom, top in metres of the camera.
    """

    faces: Ints
    depth: Floats
    extent: tuple[float, float, float, float]

    def shaded(self, scene: Scene, camera: Camera, colors: Mapping[str, str]) -> Floats:
        """(rows, columns, 4) RGBA: parts in their colours, darker where they turn away, with outlines."""
        normal = normals_of(scene.vertices[scene.triangles[self.faces]])
        part = np.where(self.faces < 0, -1, scene.face_part[self.faces])
        light = camera.axes.T @ np.array([-0.35, 0.6, -0.72])
        color = np.array([to_rgb(colors[name]) for name in scene.part_names])[part]
        color = color * (0.74 + 0.26 * abs(normal @ light))[..., None]
        color[_outlines(part, normal, self.depth)] *= 0.45
        return np.dstack([color, part >= 0]) * (part >= 0)[..., None]


def _outlines(part: NDArray[Any], normal: Floats, depth: Floats) -> Bools:
    """Pixels that carry an outline: between parts, along a sharp crease, or around everything."""
    edge = np.zeros(part.shape, np.bool_)
    for axis in (0, 1):
        here, there = ((slice(None),) * axis + (cut,) for cut in (slice(None, -1), slice(1, None)))
        crease = abs((normal[here] * normal[there]).sum(axis=-1)) < 0.8
        differs = (part[here] != part[there]) | (crease & (part[here] >= 0))
        # The nearer of the two carries the line, so that an object's outline does not grow into what is behind it.
        nearer = depth[here] <= depth[there]
        edge[here] |= differs & nearer
        edge[there] |= differs & ~nearer
    return edge & (part >= 0)


@dataclass(frozen=True)
class Surfaces:
    """Some triangles of a scene, which rays can meet."""

    scene: Scene
    faces: Ints

    @cached_property
    def mesh(self) -> trimesh.Trimesh:
        """The triangles in the order of `faces`."""
        return trimesh.Trimesh(self.scene.vertices, self.scene.triangles[self.faces], process=False)

    def seen(self, camera: Camera, pixels: int) -> View:
        """What a camera sees of them; `pixels` is the longer side of the grid, which has room for the whole scene."""
        spread = camera.project(self.scene.vertices)
        low, high = spread.min(axis=0), spread.max(axis=0)
        step = max(float((high - low)[:2].max()), 1e-9) / pixels
        columns, rows = (int(n) + 2 for n in (high - low)[:2] / step)
        right = low[0] + step * (np.arange(columns) - 0.5)
        up = low[1] + step * (np.arange(rows) - 0.5)[::-1]
        met, depth = np.full((rows, columns), -1), np.full((rows, columns), np.inf)
        if len(self.faces):
            # Rays start before everything.
            start = np.full((rows, columns), low[2] - step)
            rays = np.stack([*np.meshgrid(right, up), start], axis=-1).reshape(-1, 3) @ camera.axes
            found = self.mesh.ray.intersects_first(rays, np.broadcast_to(camera.axes[2], rays.shape))
            hit = np.flatnonzero(found >= 0)
            triangle = self.faces[found[hit]]
            corners = self.scene.vertices[self.scene.triangles[triangle]]
            normal, own = normals_of(corners), corners @ camera.axes[2]
            slope = normal @ camera.axes[2]
            away = ((corners[:, 0] - rays[hit]) * normal).sum(axis=1) / np.where(slope == 0, np.inf, slope)
            # A triangle seen edge-on has no depth of its own.
            depth.flat[hit] = (start[0, 0] + away).clip(own.min(axis=1), own.max(axis=1))
            met.flat[hit] = triangle
        return View(met, depth, (right[0] - step / 2, right[-1] + step / 2, up[-1] - step / 2, up[0] + step / 2))


def normals_of(corners: Floats) -> Floats:
    """(..., 3) unit normals of triangles (..., 3, 3); 0 for one without area."""
    normal = np.cross(corners[..., 1, :] - corners[..., 0, :], corners[..., 2, :] - corners[..., 0, :])
    length = np.linalg.norm(normal, axis=-1, keepdims=True)
    return normal / np.where(length > 0, length, 1.0)


def room_faces(scene: Scene) -> tuple[Ints, Ints, Ints]:
    """Triangles of the walls, of the ceiling, and all others."""
    structure = np.array([role == "structure" for role in scene.roles])[scene.face_part]
    corners = scene.corners
    lying = abs(normals_of(corners)[:, 2]) > _LYING
    upper = corners[..., 2].mean(axis=1) > (scene.vertices[:, 2].min() + scene.vertices[:, 2].max()) / 2
    walls, ceiling = structure & ~lying, structure & lying & upper
    return np.flatnonzero(walls), np.flatnonzero(ceiling), np.flatnonzero(~walls & ~ceiling)


def flat_walls(scene: Scene, walls: Ints) -> list[tuple[Ints, Floats]]:
    """Triangles of each flat piece of wall, and its border as (E, 2, 3) edges."""
    mesh = Surfaces(scene, walls).mesh
    mesh.merge_vertices()
    flat = mesh.face_adjacency[mesh.face_adjacency_angles < 1e-3]
    pieces = []
    for piece in trimesh.graph.connected_components(flat, nodes=np.arange(len(walls)), min_len=1):
        edges = mesh.edges_sorted.reshape(-1, 3, 2)[piece].reshape(-1, 2)
        border = edges[trimesh.grouping.group_rows(edges, require_count=1)]
        pieces.append((walls[piece], mesh.vertices[border]))
    return pieces


def cut_open(scene: Scene, camera: Camera) -> tuple[Ints, Floats]:
    """The triangles to draw, without ceiling and walls in the way, and the (E, 2, 3) edges of those walls."""
    walls, _, others = room_faces(scene)
    pieces, outlines = flat_walls(scene, walls) if len(walls) else [], [np.empty((0, 2, 3))]
    behind = Surfaces(scene, others).seen(camera, _SURVEY_PIXELS)
    margin = 0.01 * float(np.ptp(camera.project(scene.vertices)[:, 2]))
    # What a wall in the way hides may be another wall in the way: until none is left.
    while pieces:
        before = Surfaces(scene, np.concatenate([faces for faces, _ in pieces])).seen(camera, _SURVEY_PIXELS)
        hiding = before.faces[before.depth < np.where(np.isinf(behind.depth), -np.inf, behind.depth - margin)]
        pixels = np.bincount(hiding, minlength=len(scene.triangles))
        goes = [pixels[faces].sum() > _IN_THE_WAY * before.faces.size for faces, _ in pieces]
        if not any(goes):
            break
        outlines += [edges for (_, edges), gone in zip(pieces, goes, strict=True) if gone]
        pieces = [piece for piece, gone in zip(pieces, goes, strict=True) if not gone]
    return np.concatenate([others, *(faces for faces, _ in pieces)]), np.concatenate(outlines)


def best_camera(scene: Scene) -> Camera:
    """The camera, of a few before the relay wall, that shows most of objects and relay wall, all walls taken off."""
    normal = np.array([-1.0, 0.0, 0.0]) if scene.relay_wall is None else scene.relay_wall.normal
    front = float(np.degrees(np.arctan2(normal[1], normal[0])))
    wanted, surfaces = np.array([role != "structure" for role in scene.roles]), Surfaces(scene, room_faces(scene)[2])

    def shown(camera: Camera) -> float:
        met = surfaces.seen(camera, _SURVEY_PIXELS).faces
        pixels = np.bincount(scene.face_part[met[met >= 0]], minlength=len(wanted))
        # By the logarithm, so that a small part that is hidden counts more than a large one that is seen better.
        return float(np.log1p(pixels[wanted]).sum())

    return max((Camera.looking(front + azimuth, _ELEVATION_DEG) for azimuth in _AZIMUTHS_DEG), key=shown)


@dataclass(frozen=True)
class RoomPicture:
    """A room, and what its pictures show besides it.

    laser_points : (L, 3) where the laser rays met the scene; NaN where they met nothing.
    pixels : longer side of the pictures.
    colors : of all parts; left out: those of `part_colors`.
    """

    scene: Scene
    capture: Capture | None = None
    laser_points: Floats | None = None
    pixels: int = 700
    colors: Mapping[str, str] | None = None

    @cached_property
    def opened(self) -> tuple[Camera, Ints, Floats]:
        """Camera, triangles and edges as by `best_camera` and `cut_open`."""
        camera = best_camera(self.scene)
        return camera, *cut_open(self.scene, camera)

    @property
    def devices(self) -> dict[str, Floats]:
        """Label → position of laser and sensor, one entry where they stand together."""
        if self.capture is None:
            here = self.scene.device_position
            return {} if here is None else {"laser and sensor": here}
        laser, sensor = self.capture.laser.position, self.capture.sensor.position
        if np.linalg.norm(laser - sensor) < 1e-9:
            return {"laser and sensor": laser}
        return {"laser": laser, "sensor": sensor}


def draw_plan(axes: Axes, room: RoomPicture) -> None:
    """Draw the room from above, x to the right and y up, ceiling off; walls are lines. Axes in metres."""
    camera = Camera.from_above()
    _show(axes, room, camera, room_faces(room.scene)[2])
    draw_walls(axes, room.scene)
    _mark(axes, room, camera)
    axes.set(xlabel="x (m)", ylabel="y (m)", aspect="equal")
    axes.margins(0.03)


def draw_walls(axes: Axes, scene: Scene) -> None:
    """Draw the walls of a plan as lines, the relay wall in its colour."""
    camera, (walls, _, _) = Camera.from_above(), room_faces(scene)
    _lines(axes, camera, _sides(scene, walls), color="#555555", linewidth=1.6, zorder=3)
    for name, role in zip(scene.part_names, scene.roles, strict=True):
        if role == "relay_wall":
            sides = _sides(scene, scene.faces_of(name))
            # A flat wall is a broad line; a broad line would hide the profile of an uneven one.
            width = 4.5 if len(sides) < 60 else 0.8
            _lines(axes, camera, sides, color=part_colors(scene)[name], linewidth=width, zorder=4)


def draw_opened(axes: Axes, room: RoomPicture, arrows: bool = True) -> None:
    """Draw the room from before the relay wall, ceiling and walls in the way taken off."""
    camera, faces, outlines = room.opened
    left, _, bottom, _ = _show(axes, room, camera, faces)
    _lines(axes, camera, outlines, color=TAKEN_OFF, linewidth=0.8, linestyle=(0, (4, 3)), zorder=5)
    _mark(axes, room, camera)
    if arrows:
        _mark_axes(axes, camera, room.scene, left, bottom)
    axes.set_aspect("equal")
    axes.margins(0.03)
    axes.set_axis_off()


def draw_sight(axes: Axes, scene: Scene) -> None:
    """Fill the area of a plan that the device sees at its own height."""
    if scene.device_position is None:
        return
    walls, _, others = room_faces(scene)
    mesh = Surfaces(scene, np.concatenate([walls, others])).mesh
    angle = np.linspace(0, 2 * np.pi, 1440, endpoint=False)
    rays = np.stack([np.cos(angle), np.sin(angle), np.zeros_like(angle)], axis=1)
    # In the open the view ends where the scene does.
    reach = np.full(len(angle), float(np.ptp(scene.vertices, axis=0).max()))
    places, ray, _ = mesh.ray.intersects_location(
        np.broadcast_to(scene.device_position, rays.shape), rays, multiple_hits=False
    )
    reach[ray] = np.linalg.norm(places - scene.device_position, axis=1)
    seen = scene.device_position[:2] + reach[:, None] * rays[:, :2]
    fan = PolyCollection([seen], facecolors="#FFD75E", alpha=0.5, zorder=2.5)
    axes.add_collection(fan, autolim=False)


def draw_legend(axes: Axes, room: RoomPicture, notes: Mapping[str, str] | None = None) -> None:
    """A legend of the parts and marks of plan and opened room, filling `axes`, at most six marks beside the parts;
    `notes` follow the names of parts."""
    scene, notes = room.scene, notes or {}
    handles: list[Patch | Line2D] = [
        Patch(fc=color, ec="#555555", lw=0.5, label=f"{short(name)}{notes.get(name, '')}")
        for name, color in part_colors(scene).items()
    ]
    dots: dict[str, Any] = {"color": "black", "linestyle": "", "markersize": 8}
    handles += [Line2D([], [], marker=_marker(label), label=label, **dots) for label in room.devices]
    if room.laser_points is not None and np.isfinite(room.laser_points).all(axis=1).any():
        handles.append(Line2D([], [], marker="o", color=LASER, linestyle="", markersize=4, label="laser points"))
        if any(label.startswith("laser") for label in room.devices):
            handles.append(Line2D([], [], color=LASER, lw=0.9, label="way to the outermost"))
    if room.capture is not None:
        handles.append(Patch(fc="none", ec=FIELD_OF_VIEW, lw=1.2, label="field of view of the pixels"))
    if scene.hidden_view is not None:
        handles.append(Line2D([], [], color=HIDDEN_VIEW, lw=1.6, ls=(0, (5, 2)), label="window of the labels"))
    if len(room.opened[2]):
        handles.append(Line2D([], [], color=TAKEN_OFF, lw=0.9, ls=(0, (4, 3)), label="edges of what is taken off"))
    axes.set_axis_off()
    legend = axes.legend(handles=handles, loc="upper left", ncols=LEGEND_COLUMNS, borderaxespad=0, handlelength=1.6)
    legend.set_in_layout(False)


def _marker(label: str) -> str:
    return {"laser": "^", "sensor": "s"}.get(label, "D")


def _show(axes: Axes, room: RoomPicture, camera: Camera, faces: Ints) -> tuple[float, float, float, float]:
    """Show triangles, shaded; returns the extent of the picture."""
    view = Surfaces(room.scene, faces).seen(camera, room.pixels)
    axes.imshow(view.shaded(room.scene, camera, room.colors or part_colors(room.scene)), extent=view.extent, zorder=2)
    # Space for marks that reach beyond the picture.
    axes.use_sticky_edges = False
    return view.extent


def _sides(scene: Scene, faces: Ints) -> Floats:
    """(3 F, 2, 3) sides of triangles."""
    return scene.corners[faces][:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2, 3)


def _lines(axes: Axes, camera: Camera, segments: Floats, **style: Any) -> None:
    """Draw (n, 2, 3) segments."""
    axes.add_collection(LineCollection(list(camera.project(segments)[..., :2]), capstyle="round", **style))


def _mark(axes: Axes, room: RoomPicture, camera: Camera) -> None:
    """The labels' window with its direction, the pixels' fields of view, laser points, and the devices."""
    view = room.scene.hidden_view
    if view is not None:
        loop = np.stack([view.corners, np.roll(view.corners, -1, axis=0)], axis=1)
        _lines(axes, camera, loop, color=HIDDEN_VIEW, linewidth=1.6, linestyle=(0, (5, 2)), zorder=6)
        reach = 0.35 * float(np.linalg.norm(view.right))
        start, end = camera.project(np.stack([view.center, view.center + reach * view.normal]))[:, :2]
        _arrow(axes, start, end, HIDDEN_VIEW)
    if room.capture is not None:
        pixels = camera.project(room.capture.sensor.pixels)[..., :2]
        width = 0.9 if len(pixels) <= _FEW_PIXELS else 0.15
        edges = {"facecolors": "none", "edgecolors": FIELD_OF_VIEW, "linewidths": width}
        axes.add_collection(PolyCollection(list(pixels), zorder=8, **edges))  # type: ignore[arg-type]
    points = np.empty((0, 3))
    if room.laser_points is not None:
        points = room.laser_points[np.isfinite(room.laser_points).all(axis=1)]
        x, y, _ = camera.project(points).T
        axes.scatter(x, y, s=float(np.clip(400 / max(len(x), 1), 0.4, 6)), color=LASER, linewidths=0, zorder=9)
    for label, position in room.devices.items():
        if len(points) and label.startswith("laser"):
            flat = camera.project(points)[:, :2]
            ends = points[[*flat.argmin(axis=0), *flat.argmax(axis=0)]]
            beam = np.stack([np.broadcast_to(position, ends.shape), ends], axis=1)
            _lines(axes, camera, beam, color=LASER, linewidth=0.6, alpha=0.7, zorder=8)
        x, y, _ = camera.project(position)
        axes.scatter(x, y, s=55, marker=_marker(label), color="black", edgecolors="white", linewidths=0.8, zorder=10)


def _arrow(axes: Axes, start: Floats, end: Floats, color: str) -> None:
    style = {"arrowstyle": "-|>", "color": color, "linewidth": 1.4, "shrinkA": 0, "shrinkB": 0}
    axes.annotate("", xy=tuple(end), xytext=tuple(start), arrowprops=style, zorder=11)


def _mark_axes(axes: Axes, camera: Camera, scene: Scene, left: float, bottom: float) -> None:
    """The directions x, y, z below the picture, 1 m long or the power of ten that suits the scene."""
    size = float(np.ptp(scene.vertices, axis=0).max())
    length = 10.0 ** np.floor(np.log10(max(size, 1e-9) / 3))
    unit = camera.axes[:2].T * length
    origin = np.array([left, bottom]) - 1.3 * np.array([min(unit[:, 0].min(), 0.0), unit[:, 1].max()])
    for name, arrow in zip("xyz", unit, strict=True):
        _arrow(axes, origin, origin + arrow, INK)
        x, y = origin + 1.25 * arrow
        axes.text(x, y, name, ha="center", va="center", fontsize=8, color=INK)
    beside = origin[0] + max(1.4 * unit[:, 0].max(), 0.4 * length)
    axes.text(beside, origin[1], f"{length:g} m each", fontsize=8, color=INK, va="center")
    axes.update_datalim([origin, *(origin + 1.3 * unit)])
