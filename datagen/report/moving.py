"""An animation of a stored sequence in real time: what moves in the room, what changes in the light meanwhile, and
what backprojection makes of that."""

from __future__ import annotations

import io
from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure, FigureBase
from matplotlib.lines import Line2D
from matplotlib.patches import Patch, Polygon
from numpy.typing import NDArray
from PIL import Image

from datagen.records import Scene
from datagen.records.arrays import Floats
from datagen.report.curves import busy_window, time_label
from datagen.report.floor_plans import FloorPlans
from datagen.report.replay import StoredScene
from datagen.report.rooms import RoomPicture, draw_plan, draw_walls
from datagen.report.scans import Raster, reach
from datagen.report.stored import QUANTITIES, light_of_stored, scene_of_stored, time_of_stored, unit_of
from datagen.report.strip import label_images, label_of
from datagen.report.style import EXPECTED, INK, LASER, WIDTH_IN, captioned, in_sigma, part_colors, short

LEAST_HZ, MOST_HZ = 0.5, 50.0
"""Pictures a second: browsers slow down what is faster, and nobody waits for what is slower."""
MOST_PICTURES = 64
"""Most pictures, so that the file keeps below some 2 MB; longer sequences show every second, third, … frame."""
_WIDTH_PX = 824
"""Width of the pictures, pixels: pages of text show GIFs as they are."""
_CELLS = 96
"""Most cells of time, so that each has three pixels or more; bins are summed up to these."""
_CLIPPED = 0.01
"""Share of the cells of all frames that lie beyond the scale of colours, which would else be that of the few first
bins in which the wall's own light is strongest."""
_NAMED = 3
"""Objects that the legend has room for, those that move first."""

Update = Callable[[int], None]
"""Changes a picture to the frame of a given number."""


def animation(stored: StoredScene, room: Scene | None) -> bytes | None:
    """A GIF of a sequence that runs in real time, again and again: on the left the room from above, then by how much
    the counts of the frame differ from the mean over all frames, and on the right the floor plan that backprojection
    makes of this difference, where counts and their geometry are stored. The same dataset gives the same bytes.

    Sequences of more than `MOST_HZ` pictures a second, or fewer than `LEAST_HZ`, run at these; the caption says so.
    None of a scene that is measured once, and where neither histogram nor transient is stored. To be used within
    `house_style()`.

    room : the scene with its paths; None if it is not known: then the left shows a stored label, if there is one.
    """
    measured = next((name for name in QUANTITIES if name in stored.arrays), None)
    if stored.frames is None or measured is None:
        return None
    sequence = stored.config.sequence
    assert sequence is not None
    chosen = np.arange(0, stored.frames, -(-stored.frames // MOST_PICTURES))
    rate_hz = sequence.rate_hz / (chosen[1] - chosen[0])
    shown_hz = float(np.clip(rate_hz, LEAST_HZ, MOST_HZ))
    times_s = stored.arrays["laser_time"].mean(axis=1)
    window = scene_of_stored(stored.at_frame()) if room is None else None
    label = None if window is None else label_of(stored)
    plans = None if room is None else FloorPlans.of(stored)
    text = (
        f"{measured} of this frame less the mean over all frames, summed over the rows of the scan. Red: more than "
        "on average, as where light of what moves arrives now; blue: less."
    )
    columns = 1 + (room is not None or label is not None) + (plans is not None)
    text = f"{'Middle' if plans else 'Right'}: {text}" if columns > 1 else text[0].upper() + text[1:]
    if plans is not None:
        text += " Right: this difference backprojected, from above."
    if room is not None and stored.change():
        text += " σ: how far the change from frame to frame stands out of the noise, in the median."
    text += f" {_pace(shown_hz / rate_hz)}."
    figure, grid = captioned([2.9, 0.4] if room is not None else [3.0], text, " ")
    figure.set_dpi(_WIDTH_PX / WIDTH_IN)
    # In a subfigure, so that room for a colour bar beside one panel is not left free beside all.
    above = figure.add_subfigure(grid[0, 0])
    panels = list(above.subplots(1, columns, squeeze=False, width_ratios=[1.2, 1, 1][:columns])[0])
    updates = [draw_change(above, panels[min(columns - 1, 1)], stored, measured)]
    if room is not None:
        updates.append(draw_movers(panels[0], room, stored, times_s))
        draw_marks(figure.add_subplot(grid[1, 0]), room, in_sigma(stored.change()), plans is not None)
    elif window is not None and label is not None:
        updates.append(_draw_label(panels[0], window, stored, label))
    if room is not None and plans is not None:
        updates.append(draw_plans(panels[2], room, plans, times_s))
    pictures = []
    for frame in chosen:
        figure.suptitle(f"{short(stored.title, 48)}: {times_s[frame]:.2f} s", fontweight="bold")
        for update in updates:
            update(int(frame))
        pictures.append(_pixels_of(figure))
        # Axes stay where they are in the first picture; placed anew for each, they would tremble.
        figure.set_layout_engine("none")
    return _gif(pictures, durations_ms(len(chosen), shown_hz))


def durations_ms(pictures: int, rate_hz: float) -> list[int]:
    """Milliseconds that each picture is shown, in the hundredths of a second that a GIF knows: the time at which each
    begins is rounded, and not its duration, so that the whole takes as long as it should."""
    begins = np.rint(np.arange(pictures + 1) * 100 / rate_hz).astype(np.int64) * 10
    return [int(span) for span in np.diff(begins)]


def _pace(speed: float) -> str:
    """How fast the animation runs, as a clause."""
    if abs(speed - 1) < 1e-9:
        return "In real time"
    return (
        f"It runs {speed:.3g} times faster than real time"
        if speed > 1
        else f"It runs {1 / speed:.3g} times slower than real time"
    )


def draw_movers(axes: Axes, room: Scene, stored: StoredScene, times_s: Floats) -> Update:
    """Draw the room from above, with a box about each part that moves and its way over all frames; a sensor that
    moves likewise."""
    colors, moving = part_colors(room), room.moving
    # The window of the labels is not shown here.
    standing = replace(room.without(*moving) if moving else room, hidden_view=None)
    points, drives = stored.arrays.get("laser_points"), "sensor_position" in stored.framed
    if drives:
        standing, points = replace(standing, device_position=None), None
    draw_plan(axes, RoomPicture(standing, laser_points=points, colors=colors))
    axes.set_title("The room from above")
    boxes = []
    for name, placed in footprints(room, times_s).items():
        axes.plot(*placed.mean(axis=1).T, color=INK, linewidth=0.9, linestyle=":", zorder=14)
        box = Polygon(placed[0], fc=colors[name], ec=INK, lw=1.4, zorder=13)
        axes.add_patch(box)
        boxes.append((box, placed))
    move_sensor = _draw_sensor(axes, stored) if drives else None

    def update(frame: int) -> None:
        for box, placed in boxes:
            box.set_xy(placed[frame])
        if move_sensor is not None:
            move_sensor(frame)

    return update


def footprints(room: Scene, times_s: Floats) -> dict[str, Floats]:
    """Part that moves → (frame, 4, 2) x and y of the corners of the box about it, which turns with it, metres."""
    found = {}
    for name in room.moving:
        path = room.paths[name]
        # Along the part's own axes, so that the box turns with it.
        own = path.at(0.0).undo(room.vertices[np.unique(room.triangles[room.faces_of(name)])])
        (left, front, low), (right, back, _) = own.min(axis=0), own.max(axis=0)
        corners = np.array([(left, front, low), (right, front, low), (right, back, low), (left, back, low)])
        found[name] = path.at(times_s[:, None]).apply(corners)[..., :2]
    return found


def draw_plans(axes: Axes, room: Scene, plans: FloorPlans, times_s: Floats) -> Update:
    """Draw the floor plan of each frame, all with the same colours, in the room's own x and y; an outline about each
    part that moves, and the relay wall."""
    # What is less than on average, and noise, is left white.
    most = max(float(np.quantile(plans.values, 1 - _CLIPPED / 10)), 1.0)
    shown = axes.pcolormesh(*np.moveaxis(plans.corners, -1, 0), plans.values[0], cmap="Reds", vmin=1.0, vmax=most)
    draw_walls(axes, room)
    outlines = []
    for placed in footprints(room, times_s).values():
        outline = Polygon(placed[0], fc="none", ec=EXPECTED, lw=1.6, zorder=13)
        axes.add_patch(outline)
        outlines.append((outline, placed))
    low, high = plans.corners.reshape(-1, 2).min(axis=0), plans.corners.reshape(-1, 2).max(axis=0)
    margin = 0.04 * float((high - low).max())
    axes.set(xlim=(low[0] - margin, high[0] + margin), ylim=(low[1] - margin, high[1] + margin), aspect="equal")
    axes.set(xlabel="x (m)", ylabel="y (m)")
    axes.set_title("Backprojection")

    def update(frame: int) -> None:
        shown.set_array(plans.values[frame])
        for outline, placed in outlines:
            outline.set_xy(placed[frame])

    return update


def _draw_sensor(axes: Axes, stored: StoredScene) -> Update:
    """Draw a sensor that moves, its way over all frames, and its laser points."""
    places, points = stored.arrays["sensor_position"], stored.arrays["laser_points"]
    axes.plot(*places[:, :2].T, color=INK, linewidth=0.9, linestyle=":", zorder=14)
    (device,) = axes.plot([], [], "D", color="black", markersize=5, zorder=15)
    (lit,) = axes.plot([], [], "o", color=LASER, markersize=2, zorder=15)

    def update(frame: int) -> None:
        device.set_data(places[frame, :1], places[frame, 1:2])
        lit.set_data(points[frame, :, 0], points[frame, :, 1])

    return update


def draw_marks(axes: Axes, room: Scene, change: Mapping[str, str], outlined: bool) -> None:
    """A legend of the plan in axes of its own. change : part → its change from frame to frame in words. outlined :
    whether what moves is outlined in a floor plan, too."""
    colors, wall = part_colors(room), next((k for k, role in enumerate(room.roles) if role == "relay_wall"), None)
    moving = [(name, f"{short(name, 20)}{change.get(name, '')}") for name in room.moving[:_NAMED]]
    handles: list[Patch | Line2D] = [Patch(fc=colors[name], ec=INK, label=label) for name, label in moving]
    standing = [name for name in room.objects if name not in room.moving]
    handles += [Patch(fc=colors[name], label=short(name, 20)) for name in standing[: max(_NAMED - len(handles), 0)]]
    handles.append(Line2D([], [], linestyle=":", color=INK, label="way of what moves"))
    if wall is not None:
        handles.append(Line2D([], [], linewidth=4.5, color=colors[room.part_names[wall]], label="relay wall"))
    if room.device_position is not None:
        handles.append(Line2D([], [], marker="D", linestyle="", color="black", label="laser and sensor"))
    handles.append(Line2D([], [], marker="o", markersize=4, linestyle="", color=LASER, label="laser points"))
    if outlined:
        handles.append(Patch(fc="none", ec=EXPECTED, lw=1.6, label="where it truly is"))
    axes.set_axis_off()
    axes.legend(handles=handles, loc="upper left", ncols=4, borderaxespad=0).set_in_layout(False)


def _draw_label(axes: Axes, window: Scene, stored: StoredScene, label: str) -> Update:
    """Draw a stored label, all frames with the same colours."""
    images, style = label_images(window, stored.arrays[label], label)
    (left, bottom), (right, top) = images[0].low, images[0].high
    shown = axes.imshow(images[0].values, extent=(left, right, bottom, top), interpolation="nearest", **style)
    axes.set(xlabel="right (m)", ylabel="up (m)", title=images[0].look.title)
    return lambda frame: shown.set_data(images[frame].values)


def draw_change(figure: FigureBase, axes: Axes, stored: StoredScene, measured: str) -> Update:
    """Draw the difference from the mean over all frames: arrival time across, and down the places along
    the rows of the scan, summed over the rows; its points by number where they lie on no grid."""
    light = light_of_stored(stored.at_frame())
    assert light is not None
    raster, time = Raster.of(light), time_of_stored(stored, measured)
    by_laser = raster.what == "laser point"
    # (frame, laser or pixel, bin), then (frame, place along a row, bin): rows lie one above the other, and light
    # of something hidden at one side comes later the farther off a place is.
    values = np.asarray(stored.arrays[measured], np.float64).sum(axis=2 if by_laser else 1)
    values = values[:, raster.channels[..., 0 if by_laser else 1]]
    values = values.sum(axis=1)
    cells, edges_ns = _sums_by_time(values, time.edges_s * 1e9, busy_window(values.sum(axis=0), time, 0.99))
    change = cells - cells.mean(axis=0)
    most = float(np.quantile(abs(change), 1 - _CLIPPED)) or float(abs(change).max()) or 1.0
    first, last = reach(np.arange(values.shape[1], dtype=np.float64) if raster.x_m is None else raster.x_m)
    style: dict[str, Any] = {
        "cmap": "RdBu_r",
        "vmin": -most,
        "vmax": most,
        "aspect": "auto",
        "interpolation": "nearest",
    }
    shown = axes.imshow(change[0], extent=(edges_ns[0], edges_ns[-1], last, first), **style)
    axes.set(
        xlabel=time_label(time),
        ylabel=f"number of the {raster.what}" if raster.x_m is None else f"{raster.what}s along the wall (m)",
    )
    axes.set_title("What changes in the light")
    figure.colorbar(shown, ax=axes, label=f"{unit_of(stored, measured)}, less their mean", extend="both")
    return lambda frame: shown.set_data(change[frame])


def _sums_by_time(values: Floats, edges_ns: Floats, window_ns: tuple[float, float]) -> tuple[Floats, Floats]:
    """(…, cell) sums of equally many bins each, at most `_CELLS` within a window, and their (cell + 1,) edges."""
    low, high = np.searchsorted(edges_ns, window_ns)
    bins = -(-(high - low) // _CELLS)
    cells = (high - low) // bins
    high = low + cells * bins
    return values[..., low:high].reshape(*values.shape[:-1], cells, bins).sum(axis=-1), edges_ns[
        low : high + 1 : bins
    ]


def _pixels_of(figure: Figure) -> NDArray[np.uint8]:
    """(row, column, 3) the figure as it is now."""
    canvas = figure.canvas
    assert isinstance(canvas, FigureCanvasAgg)
    canvas.draw()  # type: ignore[no-untyped-call]
    return np.array(canvas.buffer_rgba())[..., :3]  # type: ignore[no-untyped-call]


def _gif(pictures: list[NDArray[np.uint8]], durations: list[int]) -> bytes:
    """The pictures as an endless GIF, all with the same 256 colours."""
    few = np.unique(np.linspace(0, len(pictures) - 1, 8).round().astype(int))
    palette = Image.fromarray(np.concatenate([pictures[k] for k in few])).quantize(256)
    made = [Image.fromarray(one).quantize(palette=palette, dither=Image.Dither.NONE) for one in pictures]
    file = io.BytesIO()
    made[0].save(file, "GIF", save_all=True, append_images=made[1:], duration=durations, loop=0)
    return file.getvalue()
