"""Many rooms on one sheet, each in plan and opened; or a few rooms, each beside all its labels."""

from __future__ import annotations

import textwrap
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from datagen.config import DatasetConfig
from datagen.design.exposure import with_exposure_found
from datagen.design.scene_for import scene_for
from datagen.errors import InputError
from datagen.labels import LABEL_MAKERS, ObjectBoxes, make_labels
from datagen.labels.boxes import classes_in
from datagen.records import Scene
from datagen.records.checks import as_given
from datagen.report.labels import DRAWN, draw_boxes, draw_label
from datagen.report.rooms import RoomPicture, draw_opened, draw_plan, draw_sight
from datagen.report.style import INK, SMALLEST_PT, captioned, check_png, house_style, plain, save_png, short
from datagen.scene import check_scene_config

MOST_ROOMS = 400
MOST_LABELLED = 16
_ROOMS_ACROSS = 3
_PLAN, _OPENED = 1.1, 1.5
"""Widths of a plan and of an opened room, one beside the other."""
_ROOM_IN = 1.8
_PANELS_ACROSS = 3
_PANEL_IN = 1.9
"""Height of a room and of a label, inches."""
_NAME_LETTERS = 38


def contact_sheet(configs: DatasetConfig | Sequence[DatasetConfig], rooms: int, out: str | Path) -> Path:
    """Draw the first scenes of one or several configurations (no light is simulated) as one PNG; returns its path.

    `rooms` of them in all, shared evenly. Raises `InputError` for a number outside 1 … 400, a room that cannot be
    made, or an output that cannot be written.
    """
    picture = check_png(out)
    if not 1 <= rooms <= MOST_ROOMS:
        raise InputError(f"{as_given('rooms', rooms)}: a contact sheet holds 1 … {MOST_ROOMS} rooms")
    several = [configs] if isinstance(configs, DatasetConfig) else list(configs)
    of = f"{several[0].name} (seed {several[0].seed})" if len(several) == 1 else f"{len(several)} configurations"
    text = (
        "Plan (bar: 1 m, yellow: what the device sees) and the room without ceiling and near walls, with laser and "
        "sensor (diamond), relay wall (light blue), window of the labels (green) and objects (bright)."
    )
    columns = min(_ROOMS_ACROSS, int(np.ceil(np.sqrt(rooms))))
    scenes = first_scenes(several, rooms)
    with house_style():
        figure, grid = captioned(
            [_ROOM_IN] * -(-rooms // columns), text, f"{rooms} rooms of {of}", 2 * columns,
            [_PLAN, _OPENED] * columns, arranged=False,
        )  # fmt: skip
        figure.subplots_adjust(0.01, right=0.99, wspace=0.08, hspace=0.35)
        for number, (config, index) in enumerate(scenes):
            row, column = divmod(number, columns)
            room = RoomPicture(scene_for(config, index), pixels=300)
            plan, opened = (figure.add_subplot(grid[row, 2 * column + k]) for k in range(2))
            draw_plan(plan, room)
            draw_opened(opened, room, arrows=False)
            draw_sight(plan, room.scene)
            (left, _), (bottom, top) = plan.get_xlim(), plan.get_ylim()
            bar = bottom - 0.05 * (top - bottom)
            plan.plot([left, left + 1], [bar, bar], color=INK, linewidth=1.4, solid_capstyle="butt", clip_on=False)
            plan.set_axis_off()
            # All pictures of a row are as high, whatever their room.
            for axes in (plan, opened):
                axes.set_aspect("equal", adjustable="datalim")
            name = _name_of(room.scene, config.name if len(several) > 1 else "", index)
            plan.set_title(plain(name), fontsize=SMALLEST_PT, fontweight="normal", linespacing=1.25)
        return save_png(figure, picture)


def label_sheet(configs: DatasetConfig | Sequence[DatasetConfig], labels: int, out: str | Path) -> Path:
    """Draw the first scenes of one or several configurations, each beside all the labels it can have; returns the
    PNG's path.

    Raises `InputError` for a number outside 1 … 16, a room that cannot be made, or an output that cannot be
    written.
    """
    picture = check_png(out)
    if not 1 <= labels <= MOST_LABELLED:
        raise InputError(f"{as_given('labels', labels)}: a sheet of labels holds 1 … {MOST_LABELLED} rooms")
    several = [configs] if isinstance(configs, DatasetConfig) else list(configs)
    # Parts come last, where there is room for their names.
    fields = sorted((name for name in LABEL_MAKERS if name in DRAWN), key=lambda field: field == "part_id")
    lines = -(-(3 + len(fields)) // _PANELS_ACROSS)
    text = (
        "One room after the other; labels are seen through the dashed green window along its arrow, right and up as "
        "for somebody who faces the relay wall (normal: red to the right, green up, blue to the wall)."
    )
    scenes = first_scenes(several, labels)
    with house_style():
        figure, grid = captioned(
            [_PANEL_IN] * (lines * labels), text, f"Rooms and their labels: {labels}", _PANELS_ACROSS, arranged=False
        )  # fmt: skip
        # Space for colour bars, and for the names of parts at the right.
        figure.subplots_adjust(0.07, right=0.91, wspace=0.6, hspace=0.5)
        for number, (config, index) in enumerate(scenes):
            cells = [divmod(k, _PANELS_ACROSS) for k in range(3 + len(fields))]
            plan, opened, objects, *images = (figure.add_subplot(grid[number * lines + r, c]) for r, c in cells)
            scene = scene_for(config, index)
            room = RoomPicture(scene)
            draw_plan(plan, room)
            draw_sight(plan, scene)
            plan.set_title(short(f"{config.name} {index}"))
            draw_opened(opened, room)
            made = make_labels(config.labels, scene, fields)
            classes = classes_in(scene)
            draw_boxes(
                objects, scene, ObjectBoxes.of(scene, classes, max(1, len(scene.objects))), classes, made["depth"]
            )
            for axes, field in zip(images, fields, strict=True):
                draw_label(figure, axes, scene, field, made[field])
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
