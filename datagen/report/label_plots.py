"""Label images, volumes and boxes, with their axes in metres on the plane of the relay wall."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.colorbar import Colorbar
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure
from matplotlib.image import AxesImage
from matplotlib.patches import Patch
from numpy.typing import NDArray

from datagen.labels import OBJECT_TABLES, ObjectBoxes, ViewFrame
from datagen.labels.volumes import VoxelGrid
from datagen.records import Scene
from datagen.report.replay import StoredScene
from datagen.report.style import captioned, empty_note, part_colors

TITLES = {
    "depth": "Depth (m)",
    "normal": "Surface normal",
    "albedo": "Albedo",
    "part_id": "Part",
    "shaded": "Shaded view (wall: 1)",
    "occupancy": "Occupancy (m)",
    "sdf": "Signed distance (m)",
    "evidence": "Evidence (expected detections)",
}


def boxes_of(stored: StoredScene) -> ObjectBoxes | None:
    """The stored boxes of the objects, if there are any."""
    if OBJECT_TABLES[0] not in stored.arrays:
        return None
    return ObjectBoxes.from_tables({name: stored.arrays[name] for name in OBJECT_TABLES})


def labels_figure(stored: StoredScene, scene: Scene, labels: Mapping[str, NDArray[Any]], text: str) -> Figure:
    """All labels and the stored boxes, two or three in a row, with a caption."""
    boxes = boxes_of(stored)
    panels = len(labels) + (boxes is not None)
    columns = min(3, panels)
    frame, width = ViewFrame.of(scene), 4.6 * columns if columns > 1 else 7.0
    high = float(np.clip(0.7 * width / columns * frame.half_height_m / frame.half_width_m, 1.5, 5.0)) + 1.0
    heights = [high] * -(-panels // columns)
    figure, grid = captioned(width, heights, text, f"{stored.title}: labels", columns)
    for number, (field, values) in enumerate(labels.items()):
        draw_label(figure, figure.add_subplot(grid[divmod(number, columns)]), scene, field, values)
    if boxes is not None:
        axes = figure.add_subplot(grid[divmod(len(labels), columns)])
        draw_boxes(axes, scene, boxes, stored.classes, labels.get("depth"))
    return figure


def draw_label(figure: Figure, axes: Axes, scene: Scene, field: str, values: NDArray[Any]) -> None:
    """Draw one label of `datagen.labels`; `field` picks the manner."""
    axes.set_title(TITLES[field])
    axes.set(xlabel="right (m)", ylabel="up (m)")
    _DRAW[field](figure, axes, scene, values)


def draw_boxes(
    axes: Axes, scene: Scene, boxes: ObjectBoxes, classes: Sequence[str], behind: NDArray[Any] | None
) -> None:
    """Outlines of the object boxes with their classes, over an image of the same view; thick: the front of each."""
    axes.set_title("Objects: boxes and classes (thick: front)")
    axes.set(xlabel="right (m)", ylabel="up (m)")
    if behind is not None:
        _image(axes, scene, np.ma.masked_where(behind <= 0, behind), cmap="gray_r", alpha=0.45)
    colors = part_colors(scene)
    for corners, label, part in zip(boxes.corners(), boxes.label, boxes.part, strict=False):
        color = colors[scene.part_names[part]]
        edges = [(a, a ^ bit) for a in range(8) for bit in (1, 2, 4) if not a & bit]
        lines = [corners[list(edge), :2] for edge in edges]
        # Corners without bit 1 lie at −depth: the object's own front.
        widths = [2.4 if not (a | b) & 2 else 0.9 for a, b in edges]
        axes.add_collection(LineCollection(lines, colors="white", linewidths=np.add(widths, 1.2), zorder=3))
        axes.add_collection(LineCollection(lines, colors=color, linewidths=widths, zorder=4))
        x, y = (corners[:, :2].min(axis=0) + corners[:, :2].max(axis=0)) / 2
        box = {"facecolor": "white", "edgecolor": color, "boxstyle": "round,pad=0.15", "linewidth": 0.8}
        axes.text(x, y, classes[label], fontsize=7, ha="center", va="center", bbox=box, zorder=5)
    left, right, bottom, top = _image_extent(scene)
    axes.set(xlim=(left, right), ylim=(bottom, top), aspect="equal")
    if boxes.count == 0:
        empty_note(axes, "no objects")


def _image_extent(scene: Scene) -> tuple[float, float, float, float]:
    frame = ViewFrame.of(scene)
    return -frame.half_width_m, frame.half_width_m, -frame.half_height_m, frame.half_height_m


def _image(axes: Axes, scene: Scene, values: NDArray[Any], **style: Any) -> AxesImage:
    return axes.imshow(values, **{"extent": _image_extent(scene), "interpolation": "nearest", **style})


def _draw_depth(figure: Figure, axes: Axes, scene: Scene, values: NDArray[Any]) -> None:
    """Draw depth: near is bright, empty (0) is white."""
    shown = np.ma.masked_where(values <= 0, values)
    image = _image(axes, scene, shown, cmap="viridis_r")
    if shown.count() == 0:
        empty_note(axes, "nothing stands behind the view")
        return
    _color_bar(figure, axes, image, "depth (m); white: empty" if shown.count() < shown.size else "depth (m)")


def _draw_albedo(figure: Figure, axes: Axes, scene: Scene, values: NDArray[Any]) -> None:
    _color_bar(figure, axes, _image(axes, scene, values, cmap="gray", vmin=0.0, vmax=1.0), "albedo (0: empty)")


def _draw_shaded(figure: Figure, axes: Axes, scene: Scene, values: NDArray[Any]) -> None:
    image = _image(axes, scene, np.sqrt(values), cmap="gray", vmin=0.0)
    ticks = [t for t in (0.0, 0.01, 0.05, 0.1, 0.2, 0.4, 0.7, 1.0) if t <= values.max()]
    bar = _color_bar(figure, axes, image, "radiance (lit relay wall: 1)")
    bar.set_ticks([float(np.sqrt(t)) for t in ticks], labels=[f"{t:g}" for t in ticks])


def _draw_evidence(figure: Figure, axes: Axes, scene: Scene, values: NDArray[Any]) -> None:
    """Draw expected detections by powers of ten, down to one in a thousand exposures."""
    shown = np.ma.masked_where(values < 1e-3, values)
    if shown.count() == 0:
        _image(axes, scene, shown)
        empty_note(axes, "no light from what is seen")
        return
    image = _image(axes, scene, np.ma.log10(shown), cmap="magma")
    bar = _color_bar(figure, axes, image, "detections; white: under 0.001")
    low, high = (int(np.floor(np.log10(limit))) for limit in (shown.min(), shown.max()))
    bar.set_ticks(list(range(low + 1, high + 1)), labels=[f"{10.0**k:g}" for k in range(low + 1, high + 1)])


def _draw_normal(figure: Figure, axes: Axes, scene: Scene, values: NDArray[Any]) -> None:
    """Red: facing right, green: up, blue: facing the wall (half intensity: perpendicular to that)."""
    towards = values * np.array([1.0, 1.0, -1.0])
    color = np.where(np.linalg.norm(values, axis=-1, keepdims=True) > 0, (towards + 1) / 2, 1.0)
    _image(axes, scene, np.clip(color, 0, 1))


def _draw_parts(figure: Figure, axes: Axes, scene: Scene, values: NDArray[Any]) -> None:
    colors = part_colors(scene)
    _image(axes, scene, np.array([to_rgb(colors[name]) for name in scene.part_names] + [(1.0, 1.0, 1.0)])[values])
    seen = [scene.part_names[k] for k in np.unique(values) if k >= 0]
    handles = [Patch(facecolor=colors[name], edgecolor="#555555", linewidth=0.5, label=name) for name in seen[:12]]
    axes.legend(handles=handles, loc="center left", bbox_to_anchor=(1.0, 0.5))


def _draw_occupancy(figure: Figure, axes: Axes, scene: Scene, values: NDArray[Any]) -> None:
    """Draw occupancy as metres of taken voxels behind each point of the view."""
    grid = VoxelGrid.of(scene, values.shape)
    extent = (grid.low[0], grid.high[0], grid.low[1], grid.high[1])
    thickness = values.sum(axis=0, dtype=np.float64) * grid.voxel_m[0]
    image = _image(axes, scene, thickness, extent=extent, cmap="cividis", vmin=0.0)
    _color_bar(figure, axes, image, "taken depth (m)")


def _draw_sdf(figure: Figure, axes: Axes, scene: Scene, values: NDArray[Any]) -> None:
    """Draw one level slice of the signed distance from above: right across, depth upwards, the surface as a line."""
    grid = VoxelGrid.of(scene, values.shape)
    row = int(np.argmin(values.mean(axis=(0, 2))))
    layer = values[:, row, :]
    # Half the range to the far side of the surface, so that inside and outside differ in colour.
    reach = max(3 * float(-layer.min()), 0.4 * float(abs(layer).max())) or 1.0
    extent = (grid.low[0], grid.high[0], grid.low[2], grid.high[2])
    image = axes.imshow(layer, extent=extent, origin="lower", cmap="RdBu", vmin=-reach, vmax=reach)
    if layer.min() < 0 < layer.max() and min(layer.shape) > 1:
        axes.contour(layer, levels=[0.0], extent=extent, colors="black", linewidths=0.9)
    up = grid.high[1] - (row + 0.5) * grid.voxel_m[1]
    axes.set_title(f"Signed distance, {up:.2f} m up".replace("-", "\N{MINUS SIGN}"))
    axes.set(ylabel="depth (m)")
    _color_bar(figure, axes, image, "distance (m), inside negative")


def _color_bar(figure: Figure, axes: Axes, image: AxesImage, label: str) -> Colorbar:
    """A colour bar as high as the picture beside it."""
    return figure.colorbar(image, cax=axes.inset_axes((1.03, 0.0, 0.045, 1.0)), label=label)


_DRAW: dict[str, Callable[[Figure, Axes, Scene, NDArray[Any]], None]] = {
    "depth": _draw_depth,
    "normal": _draw_normal,
    "albedo": _draw_albedo,
    "part_id": _draw_parts,
    "shaded": _draw_shaded,
    "occupancy": _draw_occupancy,
    "sdf": _draw_sdf,
    "evidence": _draw_evidence,
}
