"""Many rooms on one sheet, each in plan and opened; or a few rooms, each beside all its labels."""

from __future__ import annotations

import textwrap
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import PolyCollection
from matplotlib.figure import Figure

from datagen.config import DatasetConfig
from datagen.design.exposure import with_exposure_found
from datagen.design.scene_for import scene_for
from datagen.errors import InputError
from datagen.labels import IMAGE_FIELDS, VOLUME_FIELDS, ObjectBoxes, make_labels
from datagen.labels.boxes import classes_in
from datagen.records import Scene
from datagen.records.arrays import Floats
from datagen.report.cutaway import room_faces
from datagen.report.label_plots import draw_boxes, draw_label
from datagen.report.room_plots import RoomPicture, draw_opened, draw_plan
from datagen.report.style import INK, caption, caption_height, check_png, house_style, new_figure, save_png
from datagen.scene import check_scene_config
from scene_library.visibility import visible_fan

MOST_ROOMS = 400
MOST_LABELLED = 16
IN_SIGHT = "#FFD75E"
_CELL_IN = (3.1, 1.95)
_PANEL_IN = (3.35, 2.5)
_PANELS_ACROSS = 5
_HEAD_IN = 0.4
_NAME_LETTERS = 52
_NOTE = (
    "Left: plan, x to the right and y up; yellow: what the device sees. Right: the same room without ceiling and "
    "near walls (dashed edges). The bar in the plan is 1 m. Diamond: laser and sensor; light blue: relay wall; "
    "dashed green: the window of the labels in its plane, with the direction they look along; bright colours: the "
    "objects, which are hidden from the device."
)
_LABEL_NOTE = (
    "One room after the other. Plan: yellow is what the device (diamond) sees. Opened: without ceiling and near "
    "walls. Labels "
    "look through the dashed green window along its arrow, orthographically: up is up, and right is right for "
    "somebody who faces the relay wall, so that all images of a room lie over each other; axes in metres from the "
    "window's middle. Normals: red grows to the right, green upwards, blue towards the wall. Shaded: lit by the part "
    "of the relay wall that the device sees. Objects: their boxes. Occupancy: metres of taken voxels behind each "
    "point. Signed distance: "
    "one level slice from above, depth upwards; the black line is the objects' surface, negative inside."
)


def contact_sheet(configs: DatasetConfig | Sequence[DatasetConfig], count: int, out: str | Path) -> Path:
    """Draw the first scenes of one or several configurations (no light is simulated) as one PNG; returns its path.

    `count` rooms in all, shared evenly. Raises `InputError` for a count outside 1 … 400, a room that cannot be made,
    or an output that cannot be written.
    """
    picture = check_png(out)
    if not 1 <= count <= MOST_ROOMS:
        raise InputError(f"count = {count}: a contact sheet holds 1 … {MOST_ROOMS} rooms")
    several = [configs] if isinstance(configs, DatasetConfig) else list(configs)
    rooms, names = [], []
    for config, index in first_scenes(several, count):
        rooms.append(RoomPicture(scene_for(config, index), pixels=180))
        names.append(_name_of(rooms[-1].scene, config.name if len(several) > 1 else "", index))
    with house_style():
        of = f"{several[0].name} (seed {several[0].seed})" if len(several) == 1 else f"{len(several)} configurations"
        return save_png(sheet_figure(rooms, names, f"{count} rooms of {of}"), picture)


def label_sheet(configs: DatasetConfig | Sequence[DatasetConfig], count: int, out: str | Path) -> Path:
    """Draw the first scenes of one or several configurations, each beside all the labels it can have; returns the
    PNG's path.

    Raises `InputError` for a count outside 1 … 16, a room that cannot be made, or an output that cannot be
    written.
    """
    picture = check_png(out)
    if not 1 <= count <= MOST_LABELLED:
        raise InputError(f"labels = {count}: a sheet of labels holds 1 … {MOST_LABELLED} rooms")
    several = [configs] if isinstance(configs, DatasetConfig) else list(configs)
    # Parts come last, where there is room for their names.
    fields = sorted(IMAGE_FIELDS + VOLUME_FIELDS, key=lambda field: field == "part_id")
    wide, high = _PANEL_IN
    lines = -(-(3 + len(fields)) // _PANELS_ACROSS)
    width = wide * _PANELS_ACROSS + 0.5
    note = caption_height(width, _LABEL_NOTE)
    height = high * lines * count + note + _HEAD_IN
    with house_style():
        figure = new_figure(width, height, arranged=False)
        figure.text(0.12 / width, 1 - 0.12 / height, f"Rooms and their labels: {count}", va="top", fontweight="bold")
        for row, (config, index) in enumerate(first_scenes(several, count)):
            across, up = (wide - 1.25) / width, (high - 0.8) / height
            panels = []
            for number in range(3 + len(fields)):
                line, column = divmod(number, _PANELS_ACROSS)
                bottom = height - _HEAD_IN - (row * lines + line + 1) * high
                place = ((column * wide + 0.5) / width, (bottom + 0.45) / height, across, up)
                panels.append(figure.add_axes(place))
            scene = scene_for(config, index)
            room = RoomPicture(scene, pixels=420)
            draw_plan(panels[0], room)
            mark_sight(panels[0], scene)
            panels[0].set_title(f"{config.name} {index}: plan")
            draw_opened(panels[1], room)
            panels[1].set_title("Opened")
            labels = make_labels(config.labels, scene, fields)
            classes = classes_in(scene)
            boxes = ObjectBoxes.of(scene, classes, max(1, len(scene.objects)))
            draw_boxes(panels[2], scene, boxes, classes, labels["depth"])
            panels[2].set_title("Objects (thick: front)")
            for axes, field in zip(panels[3:], fields, strict=True):
                draw_label(figure, axes, scene, field, labels[field])
                for bar in axes.child_axes:
                    bar.set_ylabel("")
        caption(figure, figure.add_axes((0.12 / width, 0.0, 1 - 0.24 / width, note / height)), _LABEL_NOTE)
        return save_png(figure, picture)


def first_scenes(configs: Sequence[DatasetConfig], count: int) -> list[tuple[DatasetConfig, int]]:
    """(configuration, scene number) of `count` scenes: the first of each configuration, equally many of each. Raises
    `InputError` for a mesh file that cannot be used."""
    for config in configs:
        check_scene_config(config.scene)
    configs = [with_exposure_found(config) if config.scene.asks_for_evidence else config for config in configs]
    share = [count // len(configs) + (k < count % len(configs)) for k in range(len(configs))]
    return [(config, index) for config, n in zip(configs, share, strict=True) for index in range(n)]


def _name_of(scene: Scene, config: str, index: int) -> str:
    """Number, layout and objects of a room, in two lines."""
    layout = str(scene.parameters.get("layout.kind", "")).replace("_", " ")
    objects = ", ".join(scene.objects).replace("_", " ")
    listed = textwrap.shorten(objects or "no objects", _NAME_LETTERS, placeholder=" …")
    return f"{config} {index}: {layout}\n{listed}".strip()


def mark_sight(axes: Axes, scene: Scene) -> None:
    """Fill the area of the plan that the device sees; walls reach from floor to ceiling, so that a plan is enough."""
    if scene.device_position is None:
        return
    eye = scene.device_position[:2]
    walls = _plan_walls(scene, below_m=float(scene.device_position[2]))
    fan = visible_fan(np.concatenate([walls, _frame(axes)]), eye)
    # Drawn over the picture, since all objects are outside; without edges, which would be seen where triangles
    # overlap.
    style = {"facecolors": IN_SIGHT, "edgecolors": "none", "alpha": 0.5, "zorder": 2.5, "antialiased": False}
    axes.add_collection(PolyCollection(list(fan), **style), autolim=False)  # type: ignore[arg-type]


def _plan_walls(scene: Scene, below_m: float) -> Floats:
    """(n, 2, 2) walls and relay wall in plan, without lintels: the longest side of every upright triangle."""
    relay = np.array([name == "relay_wall" for name in scene.part_names])[scene.face_part]
    faces = scene.corners[np.union1d(room_faces(scene)[0], np.flatnonzero(relay))]
    corners = faces[faces[..., 2].min(axis=1) < below_m][..., :2]
    sides = np.stack([corners, np.roll(corners, -1, axis=1)], axis=2)
    longest = np.linalg.norm(sides[:, :, 1] - sides[:, :, 0], axis=2).argmax(axis=1)
    return np.unique(sides[np.arange(len(sides)), longest], axis=0)


def _frame(axes: Axes) -> Floats:
    """(4, 2, 2) sides of the picture, where the view of the device ends in the open."""
    (x0, x1), (y0, y1) = axes.get_xlim(), axes.get_ylim()
    corners = np.array([(x0, y0), (x1, y0), (x1, y1), (x0, y1)])
    return np.stack([corners, np.roll(corners, -1, axis=0)], axis=1)


def sheet_figure(rooms: Sequence[RoomPicture], names: Sequence[str], title: str) -> Figure:
    """Rooms in a grid, plan at the left of each cell and the opened room at its right; within `house_style()`."""
    columns = min(8, max(1, int(np.ceil(np.sqrt(len(rooms))))))
    rows = -(-len(rooms) // columns)
    width = columns * _CELL_IN[0]
    note = textwrap.fill(_NOTE, int(width * 15))
    foot = 0.15 + 0.15 * len(note.splitlines())
    height = rows * _CELL_IN[1] + _HEAD_IN + foot
    figure = new_figure(width, height, arranged=False)
    figure.text(0.12 / width, 1 - 0.15 / height, title, va="top", fontsize=11, fontweight="bold")
    figure.text(0.12 / width, 0.1 / height, note, fontsize=8, color="#444444", va="bottom")
    for k, (room, name) in enumerate(zip(rooms, names, strict=True)):
        row, column = divmod(k, columns)
        left, bottom = column * _CELL_IN[0], height - _HEAD_IN - (row + 1) * _CELL_IN[1]
        at = [((left + x) / width, (bottom + 0.08) / height) for x in (0.12, 1.5)]
        size = [(w / width, (_CELL_IN[1] - 0.38) / height) for w in (1.3, 1.5)]
        plan, view = (figure.add_axes((*a, *s)) for a, s in zip(at, size, strict=True))
        draw_plan(plan, room)
        mark_sight(plan, room.scene)
        _mark_metre(plan)
        plan.set_axis_off()
        draw_opened(view, room, arrows=False)
        at_top = (left + 0.06) / width, (bottom + _CELL_IN[1] - 0.04) / height
        figure.text(*at_top, name, va="top", color=INK, fontsize=6.5, linespacing=1.25)
    return figure


def _mark_metre(axes: Axes) -> None:
    """A bar of 1 m below the plan, at its left."""
    (left, _), (bottom, top) = axes.get_xlim(), axes.get_ylim()
    y = bottom - 0.05 * (top - bottom)
    axes.plot([left, left + 1], [y, y], color=INK, linewidth=1.4, solid_capstyle="butt", clip_on=False)
