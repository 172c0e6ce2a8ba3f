"""Label images, volumes and boxes, all in the frame of the label images: metres on the plane of the relay wall."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.colors import CenteredNorm, LogNorm, Normalize, PowerNorm, to_rgb
from matplotlib.figure import Figure
from matplotlib.patches import Patch
from numpy.typing import NDArray

from datagen.labels import OBJECT_TABLES, ObjectBoxes, ViewFrame
from datagen.labels.volumes import VoxelGrid
from datagen.records import Scene
from datagen.records.arrays import Floats
from datagen.records.label_fields import LabelField, Look, drawn_fields
from datagen.report.replay import StoredScene
from datagen.report.style import SMALLEST_PT, WIDTH_IN, captioned, empty_note, part_colors, short

DRAWN = drawn_fields()
_MOST_NAMES = 12
"""Parts that a legend beside an image has room for."""


SCALES: dict[str, Callable[[NDArray[Any]], Normalize]] = {
    "linear": lambda image: Normalize(),
    "from zero": lambda image: Normalize(0),
    "zero to one": lambda image: Normalize(0, 1),
    "square root": lambda image: PowerNorm(0.5, 0),
    "logarithmic": lambda image: LogNorm(),
    # Colours reach the distance that a quarter of the picture has, so that surfaces stand out.
    "about zero": lambda image: CenteredNorm(halfrange=float(np.quantile(abs(image), 0.25)) or 1.0),
}
"""`Look.scale` → the scale of an image."""


def _pixels(scene: Scene, of: LabelField, values: NDArray[Any]) -> NDArray[Any]:
    """(rows, columns) values as they are drawn, masked where the label is empty, or (rows, columns, 3) colours."""
    look = of.look
    assert look is not None, of.name
    if look.colors == "parts":
        palette = [to_rgb(part_colors(scene)[name]) for name in scene.part_names]
        return np.asarray(np.array([*palette, (1.0, 1.0, 1.0)])[values])
    if look.colors == "directions":
        there = np.linalg.norm(values, axis=-1, keepdims=True) > 0
        return np.asarray(np.where(there, (values * (1.0, 1.0, -1.0) + 1) / 2, 1.0).clip(0, 1))
    if of.is_volume:
        values = values.mean(axis=0) if look.along_depth == "mean" else values.min(axis=0)
    return values if look.least is None else np.ma.masked_where(values < look.least, values)


@dataclass(frozen=True)
class LabelImage:
    """A label as a picture.

    values : (rows, columns), masked where it is empty, or (rows, columns, 3) colours. look : how it is drawn.
    low, high : (2,) right and up of its lower left and upper right corner in the frame of the labels, metres.
    """

    values: NDArray[Any]
    look: Look
    low: Floats
    high: Floats

    @classmethod
    def of(cls, scene: Scene, field: str, values: NDArray[Any]) -> LabelImage:
        """The picture of a label of `datagen.labels`."""
        frame, of = ViewFrame.of(scene), DRAWN[field]
        high = np.array([frame.half_width_m, frame.half_height_m])
        low = -high
        if of.is_volume:
            grid = VoxelGrid.of(scene, values.shape)
            low, high = grid.low[:2], grid.high[:2]
        assert of.look is not None
        return cls(_pixels(scene, of, values), of.look, low, high)

    @property
    def norm(self) -> Normalize:
        """The scale of its values."""
        return SCALES[self.look.scale](self.values)

    @property
    def rgb(self) -> NDArray[np.uint8]:
        """(rows, columns, 3) colours as bytes; white where it is empty."""
        if self.values.ndim == 3:
            return np.asarray(np.rint(255 * self.values), np.uint8)
        if self.empty:
            return np.full((*self.values.shape, 3), 255, np.uint8)
        colors = colormaps[self.look.colors].with_extremes(bad="white")
        shown: NDArray[np.uint8] = colors(self.norm(self.values), bytes=True)[..., :3]
        return shown

    @property
    def span(self) -> tuple[float, float] | None:
        """Least and largest value; None of colours and where it is empty."""
        return None if self.empty or self.values.ndim == 3 else (float(self.values.min()), float(self.values.max()))

    @property
    def empty(self) -> bool:
        """Whether no pixel has a value."""
        return bool(np.ma.count(self.values) == 0)


def draw_label(figure: Figure, axes: Axes, scene: Scene, field: str, values: NDArray[Any]) -> None:
    """Draw one label of `datagen.labels` with its scale."""
    image = LabelImage.of(scene, field, values)
    (left, bottom), (right, top) = image.low, image.high
    axes.set(title=image.look.title, xlabel="right (m)", ylabel="up (m)")
    style: dict[str, Any] = {} if image.values.ndim == 3 else {"cmap": image.look.colors, "norm": image.norm}
    if image.empty:
        axes.set(xlim=(left, right), ylim=(bottom, top), aspect="equal")
        return empty_note(axes, "empty")
    shown = axes.imshow(image.values, extent=(left, right, bottom, top), interpolation="nearest", **style)
    if style:
        figure.colorbar(shown, cax=axes.inset_axes((1.03, 0.0, 0.045, 1.0)))
    if image.look.colors == "parts":
        colors = part_colors(scene)
        seen = [scene.part_names[k] for k in np.unique(values) if k >= 0][:_MOST_NAMES]
        edge: dict[str, Any] = {"edgecolor": "#555555", "linewidth": 0.5}
        handles = [Patch(facecolor=colors[name], label=short(name), **edge) for name in seen]
        axes.legend(handles=handles, loc="center left", bbox_to_anchor=(1.0, 0.5))


def draw_boxes(
    axes: Axes, scene: Scene, boxes: ObjectBoxes, classes: Sequence[str], behind: NDArray[Any] | None
) -> None:
    """Outlines of the object boxes with their classes, over an image of the same view; thick: the front of each."""
    frame = ViewFrame.of(scene)
    wide, high = frame.half_width_m, frame.half_height_m
    if behind is not None:
        shown = np.ma.masked_where(behind <= 0, behind)
        axes.imshow(shown, extent=(-wide, wide, -high, high), interpolation="nearest", cmap="gray_r", alpha=0.45)
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
        style: dict[str, Any] = {"fontsize": SMALLEST_PT, "ha": "center", "va": "center", "bbox": box, "zorder": 5}
        named = axes.text(x, y, short(classes[label]), **style)
        # The name of an object at the edge must not take space from the picture, or cover the next one.
        named.set_in_layout(False)
        named.set_clip_on(True)
    axes.set(xlim=(-wide, wide), ylim=(-high, high), aspect="equal", xlabel="right (m)", ylabel="up (m)")
    axes.set_title("Objects (thick: front)")
    if boxes.count == 0:
        empty_note(axes, "no objects")


def labels_page(stored: StoredScene, scene: Scene, labels: Mapping[str, NDArray[Any]], text: str) -> Figure:
    """All labels and the stored boxes, two in a row, with a caption."""
    boxes = None
    if OBJECT_TABLES[0] in stored.arrays:
        boxes = ObjectBoxes.from_tables({name: stored.arrays[name] for name in OBJECT_TABLES})
    panels = len(labels) + (boxes is not None)
    columns = min(2, panels)
    frame = ViewFrame.of(scene)
    high = float(np.clip(0.7 * WIDTH_IN / columns * frame.half_height_m / frame.half_width_m, 1.5, 5.0)) + 1.0
    figure, grid = captioned([high] * -(-panels // columns), text, f"{stored.title}: labels", columns)
    for number, (field, values) in enumerate(labels.items()):
        draw_label(figure, figure.add_subplot(grid[divmod(number, columns)]), scene, field, values)
    if boxes is not None:
        axes = figure.add_subplot(grid[divmod(len(labels), columns)])
        draw_boxes(axes, scene, boxes, stored.classes, labels.get("depth"))
    return figure
