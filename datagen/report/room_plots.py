"""The room in plan and opened in 3D, with device, laser points, field of view and the hidden view."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import EllipseCollection, LineCollection, PolyCollection
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from datagen.labels import ObjectBoxes, ViewFrame
from datagen.labels.raster import first_hits
from datagen.records import Capture, Scene
from datagen.records.arrays import Floats, Ints
from datagen.report import cutaway
from datagen.report.cutaway import Camera, Cutaway, Extent, Shaded, room_faces, shaded
from datagen.report.style import FIELD_OF_VIEW, INK, LASER, part_colors

_ELEVATION_DEG = 42.0
_AZIMUTHS_DEG = (-55.0, -30.0, 30.0, 55.0)
_MANY_PIXELS = 400
HIDDEN_VIEW = "#117733"
LEGEND_COLUMNS = 8


@dataclass(frozen=True)
class RoomPicture:
    """A room, and what its pictures show besides it.

    laser_points : (L, 3) where the laser rays met the scene; NaN where they met nothing.
    pixels : about the width of the shaded pictures.
    boxes : of the objects, outlined in the plan.
    colors : of all parts; left out: those of `part_colors`.
    """

    scene: Scene
    capture: Capture | None = None
    laser_points: Floats | None = None
    pixels: int = 560
    boxes: ObjectBoxes | None = None
    colors: dict[str, str] | None = None

    @cached_property
    def opened(self) -> tuple[Camera, Cutaway, Shaded]:
        """Camera, cut-open room, and its shaded picture in 3D."""
        camera, cut = best_view(self.scene)
        colors = self.colors or part_colors(self.scene)
        return camera, cut, shaded(self.scene, camera, cut.faces, colors, self.pixels)

    @cached_property
    def plan(self) -> Shaded:
        """The shaded picture from above: no ceiling, and walls have no width."""
        walls, _, ceiling = room_faces(self.scene)
        faces = np.setdiff1d(np.arange(len(self.scene.triangles)), np.concatenate([walls, ceiling]))
        return shaded(self.scene, Camera.from_above(), faces, part_colors(self.scene), self.pixels)

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
    scene, camera = room.scene, Camera.from_above()
    _show(axes, room.plan)
    walls = room_faces(scene)[0]
    if len(walls):
        border = np.concatenate(cutaway.flat_groups(scene, walls)[1])
        _lines(axes, border[..., :2], color="#555555", linewidth=1.6, zorder=3)
    if "relay_wall" in scene.roles:
        name = scene.part_names[scene.roles.index("relay_wall")]
        edges = scene.corners[scene.faces_of(name)][:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2, 3)
        # A flat wall is a broad line; a broad line would hide the profile of an uneven one.
        width = 4.5 if len(edges) < 60 else 0.8
        _lines(axes, edges[..., :2], color=part_colors(scene)[name], linewidth=width, zorder=4)
    _mark_hidden_view(axes, scene, camera)
    _mark_boxes(axes, room, camera)
    _mark_capture(axes, room, camera)
    axes.set(xlabel="x (m)", ylabel="y (m)")
    axes.set_aspect("equal")
    axes.margins(0.03)


def draw_opened(axes: Axes, room: RoomPicture, arrows: bool = True) -> None:
    """Draw the room in 3D without perspective, from before the relay wall; ceiling and walls in the way taken off."""
    scene = room.scene
    camera, cut, picture = room.opened
    _show(axes, picture)
    _lines(
        axes, camera.project(cut.outlines)[..., :2], color="#777777", linewidth=0.8, linestyle=(0, (4, 3)), zorder=5
    )
    _mark_hidden_view(axes, scene, camera)
    _mark_capture(axes, room, camera)
    if arrows:
        _mark_axes(axes, camera, scene, *picture)
    axes.set_aspect("equal")
    axes.margins(0.03)
    axes.set_axis_off()


def best_view(scene: Scene) -> tuple[Camera, Cutaway]:
    """Camera and opened room from that of a few directions that shows most of objects and relay wall."""
    normal = np.array([-1.0, 0.0, 0.0]) if scene.relay_wall is None else scene.relay_wall.normal
    front = float(np.degrees(np.arctan2(normal[1], normal[0])))
    wanted = np.flatnonzero([role != "structure" for role in scene.roles])
    best, most = None, -np.inf
    for azimuth in _AZIMUTHS_DEG:
        camera = Camera.looking(front + azimuth, _ELEVATION_DEG)
        cut = cutaway.cut_open(scene, camera)
        share = _seen_share(scene, camera, cut, wanted)
        if share > most + 1e-6:
            best, most = (camera, cut), share
    assert best is not None
    return best


def _seen_share(scene: Scene, camera: Camera, cut: Cutaway, wanted: Ints) -> float:
    """Sum over the wanted parts of the share of their outline that is not hidden."""
    triangles, rows, columns, _ = cutaway.to_pixels(scene, camera, cut.faces, 200)
    part = scene.face_part[cut.faces]
    together = first_hits(triangles, rows, columns, -np.inf)[0]
    shown = np.where(together < 0, -1, part[together])
    share = 0.0
    for p in wanted:
        alone = first_hits(triangles[part == p], rows, columns, -np.inf)[0] >= 0
        share += float((shown == p).sum()) / max(float(alone.sum()), 1.0)
    return share


def draw_legend(figure: Figure, axes: Axes, room: RoomPicture) -> None:
    """A legend of the parts and marks that plan or opened room show, filling `axes`."""
    scene = room.scene
    # The ceiling is off in both.
    shown = np.setdiff1d(np.arange(len(scene.triangles)), room_faces(scene)[2])
    drawn = {scene.part_names[part] for part in np.unique(scene.face_part[shown])}
    colors = [(name, color) for name, color in part_colors(scene).items() if name in drawn]
    handles: list[Patch | Line2D] = [Patch(fc=color, ec="#555555", lw=0.5, label=name) for name, color in colors]
    dots: dict[str, Any] = {"color": "black", "linestyle": "", "markersize": 8}
    handles += [Line2D([], [], marker=_marker(label), label=label, **dots) for label in room.devices]
    if room.laser_points is not None and np.isfinite(room.laser_points).all(axis=1).any():
        handles.append(Line2D([], [], marker="o", color=LASER, linestyle="", markersize=4, label="laser points"))
    if room.capture is not None:
        handles.append(Patch(fc="none", ec=FIELD_OF_VIEW, lw=1.2, label="field of view of the pixels"))
    if scene.hidden_view is not None:
        label, dashed = "hidden view (window of the labels)", (0, (5, 2))
        handles.append(Line2D([], [], color=HIDDEN_VIEW, linewidth=1.6, linestyle=dashed, label=label))
    axes.set_axis_off()
    legend = axes.legend(handles=handles, loc="upper left", ncols=LEGEND_COLUMNS, borderaxespad=0, handlelength=1.6)
    legend.set_in_layout(False)


def _marker(label: str) -> str:
    return {"laser": "^", "sensor": "s"}.get(label, "D")


def _show(axes: Axes, picture: Shaded) -> None:
    axes.imshow(picture[0], extent=picture[1], interpolation="bilinear", zorder=2)


def _lines(axes: Axes, segments: Floats, **style: object) -> None:
    if len(segments):
        axes.add_collection(LineCollection(list(segments), capstyle="round", **style), autolim=True)  # type: ignore[arg-type]


def _mark_hidden_view(axes: Axes, scene: Scene, camera: Camera) -> None:
    view = scene.hidden_view
    if view is None:
        return
    corners = camera.project(view.corners)[:, :2]
    loop = np.stack([corners, np.roll(corners, -1, axis=0)], axis=1)
    _lines(axes, loop, color=HIDDEN_VIEW, linewidth=1.6, linestyle=(0, (5, 2)), zorder=6)
    reach = 0.35 * float(np.linalg.norm(view.right))
    start, end = camera.project(np.stack([view.center, view.center + reach * view.normal]))[:, :2]
    style = {"arrowstyle": "-|>", "color": HIDDEN_VIEW, "linewidth": 1.6, "shrinkA": 0, "shrinkB": 0}
    axes.annotate("", xy=tuple(end), xytext=tuple(start), arrowprops=style, zorder=7)


def _mark_boxes(axes: Axes, room: RoomPicture, camera: Camera) -> None:
    """The stored boxes from above, with a tick where each object's front is."""
    if room.boxes is None:
        return
    for corners in ViewFrame.of(room.scene).to_world(room.boxes.corners()):
        left, right, back_left, back_right = camera.project(corners[:4])[:, :2]
        front, behind = (left + right) / 2, (back_left + back_right) / 2
        tick = np.stack([front, front + 0.25 * (front - behind)])
        loop = [(left, right), (right, back_right), (back_right, back_left), (back_left, left), tuple(tick)]
        _lines(axes, np.array(loop), color="black", linewidth=0.9, zorder=7)


def _mark_capture(axes: Axes, room: RoomPicture, camera: Camera) -> None:
    from scipy.spatial import ConvexHull, QhullError

    if room.capture is not None:
        pixels = camera.project(room.capture.sensor.pixels)[..., :2]
        if len(pixels) > _MANY_PIXELS:
            try:
                flat = pixels.reshape(-1, 2)
                pixels = flat[ConvexHull(flat).vertices][None]
            except QhullError:
                pixels = pixels[:1]
        style = {"facecolors": "none", "edgecolors": FIELD_OF_VIEW, "linewidths": 0.9}
        axes.add_collection(PolyCollection(list(pixels), zorder=8, **style), autolim=True)  # type: ignore[arg-type]
    points = np.empty((0, 2))
    if room.laser_points is not None:
        seen = room.laser_points[np.isfinite(room.laser_points).all(axis=1)]
        points = camera.project(seen)[:, :2]
        _dots(axes, points, float(np.ptp(room.scene.vertices, axis=0).max()))
    for label, position in room.devices.items():
        here = camera.project(position)[:2]
        if len(points) and label.startswith("laser"):
            spread = points[[*points.argmin(axis=0), *points.argmax(axis=0)]]
            beam = np.stack([np.broadcast_to(here, spread.shape), spread], axis=1)
            _lines(axes, beam, color=LASER, linewidth=0.6, alpha=0.7, zorder=8)
        mark: dict[str, Any] = {"color": "black", "edgecolors": "white", "linewidths": 0.8, "zorder": 10}
        axes.scatter(here[0], here[1], s=55, marker=_marker(label), **mark)


def _dots(axes: Axes, points: Floats, extent: float) -> None:
    """Dots that grow with the picture, and leave gaps where points are dense."""
    from scipy.spatial import KDTree

    places = np.unique(np.round(points / (1e-6 * extent)), axis=0) * (1e-6 * extent)
    if len(places) == 0:
        return
    apart = np.median(KDTree(places).query(places, k=2)[0][:, 1]) if len(places) > 1 else np.inf
    size = np.full(len(places), float(np.clip(0.55 * apart, 0.002 * extent, 0.014 * extent)))
    style = {"facecolors": LASER, "edgecolors": "none", "zorder": 9}
    at = {"units": "xy", "offsets": places, "offset_transform": axes.transData}
    axes.add_collection(EllipseCollection(size, size, np.zeros(len(places)), **at, **style), autolim=True)  # type: ignore[arg-type]


def _mark_axes(axes: Axes, camera: Camera, scene: Scene, picture: Floats, extent: Extent) -> None:
    """The directions x, y, z, 1 m long (or the power of ten that suits the scene), in the emptier lower corner."""
    size = float(np.ptp(scene.vertices, axis=0).max())
    length = 10.0 ** np.floor(np.log10(max(size, 1e-9) / 3))
    unit = camera.axes[:2].T * length
    low, high = 1.3 * unit.min(axis=0).clip(max=0), 1.3 * unit.max(axis=0).clip(min=0)
    left, right, bottom, top = extent
    rows, columns = picture.shape[:2]
    high_px = max(1, int(rows * (high - low)[1] / (top - bottom)))
    wide_px = max(1, int(columns * (high - low)[0] / (right - left)))
    strip = picture[-high_px:, :, 3]
    at_left = strip[:, :wide_px].mean() <= strip[:, -wide_px:].mean()
    origin = np.array([left - low[0] if at_left else right - high[0], bottom - low[1]])
    for name, arrow in zip("xyz", unit, strict=True):
        style = {"arrowstyle": "-|>", "color": INK, "linewidth": 1.0, "shrinkA": 0, "shrinkB": 0}
        axes.annotate("", xy=tuple(origin + arrow), xytext=tuple(origin), arrowprops=style, zorder=11)
        x, y = origin + 1.22 * arrow
        axes.text(x, y, name, ha="center", va="center", fontsize=8, color=INK, zorder=11)
    corner = (left if at_left else right, bottom - 0.035 * (top - bottom))
    side = "left" if at_left else "right"
    axes.text(*corner, f"arrows: {length:g} m", ha=side, va="top", fontsize=7.5, color=INK)
