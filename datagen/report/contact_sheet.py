"""Many rooms on one sheet, each in plan and opened, all to one scale."""

from __future__ import annotations

import textwrap
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from datagen.config import DatasetConfig
from datagen.errors import InputError
from datagen.report.room_plots import RoomPicture, draw_opened, draw_plan
from datagen.report.style import INK, house_style, new_figure, save_png
from datagen.scene import generate_scene

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

MOST_ROOMS = 400
_CELL_IN = (3.1, 1.75)
_HEAD_IN = 0.4
_NOTE = (
    "Left: plan, x to the right and y up. Right: without ceiling and near walls. All to one scale. Light blue: "
    "relay wall; diamond: laser and sensor; red-orange: laser points; green: the window of the labels; other bright "
    "colours: objects."
)


def contact_sheet(config: DatasetConfig, count: int, out: str | Path) -> Path:
    """Draw the first `count` scenes of a configuration (no light is simulated) as one PNG; returns its path.

    Raises `InputError` for a count outside 1 … 400, a room that cannot be made, or an output that cannot be written.
    """
    if not 1 <= count <= MOST_ROOMS:
        raise InputError(f"count = {count}: a contact sheet holds 1 … {MOST_ROOMS} rooms")
    rooms = [RoomPicture(generate_scene(config.scene, config.seed, k), pixels=180) for k in range(count)]
    with house_style():
        title = f"{config.name}: the first {count} rooms (seed {config.seed})"
        return save_png(sheet_figure(rooms, [str(k) for k in range(count)], title), Path(out))


def sheet_figure(
    rooms: Sequence[RoomPicture], names: Sequence[str], title: str, columns: int | None = None
) -> Figure:
    """Rooms in a grid, plan at the left of each cell and the opened room at its right; within `house_style()`."""
    columns = columns or min(8, max(1, int(np.ceil(np.sqrt(len(rooms))))))
    rows = -(-len(rooms) // columns)
    columns = min(columns, len(rooms))
    width = columns * _CELL_IN[0]
    foot = 0.15 + 0.15 * len(textwrap.wrap(_NOTE, int(width * 15)))
    height = rows * _CELL_IN[1] + _HEAD_IN + foot
    figure = new_figure(width, height, arranged=False)
    figure.text(0.12 / width, 1 - 0.15 / height, title, va="top", fontsize=11, fontweight="bold")
    note = textwrap.fill(_NOTE, int(width * 15))
    figure.text(0.12 / width, 0.1 / height, note, fontsize=8, color="#444444", va="bottom")
    plans, opened = [], []
    for k, (room, name) in enumerate(zip(rooms, names, strict=True)):
        row, column = divmod(k, columns)
        left, bottom = column * _CELL_IN[0], height - _HEAD_IN - (row + 1) * _CELL_IN[1]
        at = [((left + x) / width, (bottom + 0.08) / height) for x in (0.22, 1.55)]
        size = [(w / width, (_CELL_IN[1] - 0.16) / height) for w in (1.25, 1.45)]
        plan, view = (figure.add_axes((*a, *s)) for a, s in zip(at, size, strict=True))
        draw_plan(plan, room)
        plan.set_axis_off()
        draw_opened(view, room, arrows=False)
        figure.text((left + 0.06) / width, (bottom + _CELL_IN[1] - 0.12) / height, name, va="top", color=INK)
        plans.append(plan)
        opened.append(view)
    _to_one_scale(plans)
    _to_one_scale(opened)
    return figure


def _to_one_scale(axes: Sequence[Axes]) -> None:
    """Give every axes the same span in metres, around its own middle."""
    limits = np.array([(a.get_xlim(), a.get_ylim()) for a in axes])
    half = (limits[..., 1] - limits[..., 0]).max(axis=0) / 2
    for a, middle in zip(axes, limits.mean(axis=-1), strict=True):
        a.set(xlim=(middle[0] - half[0], middle[0] + half[0]), ylim=(middle[1] - half[1], middle[1] + half[1]))
