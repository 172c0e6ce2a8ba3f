"""The pictures of a scene whose room cannot be drawn: made in Python, captured elsewhere, or without its mesh files.

They show stored values only.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from datagen.config import DatasetConfig, time_axes
from datagen.config.scene_layouts import ImportedCaptures, NoLayout
from datagen.errors import InputError
from datagen.labels import IMAGE_FIELDS, OBJECT_TABLES, VOLUME_FIELDS, ViewFrame
from datagen.records import Capture, Lambertian, Laser, Part, Rectangle, Scene, Sensor, TimeAxis
from datagen.records.arrays import Floats
from datagen.report import scan_plots as scans
from datagen.report.label_plots import labels_figure
from datagen.report.replay import StoredScene
from datagen.report.style import EXPECTED, INK, captioned, empty_note
from datagen.report.time_plots import busy_window, time_label

QUANTITIES = ("histogram", "transient")
_LABELS = (
    "Ground truth as stored, seen from the plane of the relay wall, orthographically; right and up as for somebody "
    "who faces it."
)


def why_roomless(config: DatasetConfig, missing: str) -> str | None:
    """Why the rooms of a dataset cannot be drawn, as a whole clause; None where they can.

    missing : a line about a mesh file that is missing; empty if all are there.
    """
    layout = config.scene.layout
    if isinstance(layout, NoLayout):
        return layout.why
    return "the mesh files of its objects are gone; put them back to see the rooms" if missing else None


def roomless_pages(stored: StoredScene) -> Iterator[tuple[str, Figure]]:
    """(name, figure) of each stored measurement, `histogram` and `transient`, and of the stored `labels`.

    To be used within `house_style()`. Raises `InputError` where none of them is stored.
    """
    there = [name for name in QUANTITIES if name in stored.arrays]
    images = [name for name in (*IMAGE_FIELDS, "evidence", *VOLUME_FIELDS) if name in stored.arrays]
    seen = np.isfinite(stored.arrays["hidden_view"]).all()
    if not there and not (seen and images):
        raise InputError(
            f"{stored.title}: {why_roomless(stored.config, stored.missing)}, and neither histogram, transient nor "
            "labels are stored"
        )
    for name in there:
        yield name, _measured_page(stored, name)
    if seen and (images or OBJECT_TABLES[0] in stored.arrays):
        kept = {name: stored.arrays[name] for name in images}
        yield "labels", labels_figure(stored, _as_labelled(stored), kept, _LABELS)


def _measured_page(stored: StoredScene, name: str) -> Figure:
    """A measurement over the wall, over time, and at a few moments."""
    capture, frame = _capture(stored), _frame(stored)
    values = np.asarray(stored.arrays[name], np.float64)
    whole, time = values.sum(axis=2), _time(stored, name)
    laser, pixel = (int(k) for k in np.unravel_index(int(np.argmax(whole)), whole.shape))
    raster = scans.raster_of(capture, (laser, pixel), frame)
    source = f" File: {stored.parameters['capture.file']}." if "capture.file" in stored.parameters else ""
    why = why_roomless(stored.config, stored.missing)
    text = (
        f"The stored {name}, and nothing beyond it: {why}.{source} Left: its sum at each place on the relay wall. "
        "Middle: along the row that has most (brightness: logarithm). Right: over time, summed over all and at the "
        "place that has most."
    )
    if raster is not None:
        text += (
            f" Below: the wall at {scans.MOMENTS} moments, right and up as for somebody who faces it (square root of "
            "the signal, each on its own scale)."
        )
    heights = [4.4] if raster is None else [4.4, 3.4]
    figure, grid = captioned(15, heights, text, f"{stored.title}: {name}")
    # Subfigures, so that the rows may have different columns.
    above = figure.add_subfigure(grid[0, 0])
    places, sliced, curves = (above.add_subplot(1, 3, k) for k in (1, 2, 3))
    unit = _unit(stored, name)
    counted, listed = _listed(values)
    scan = listed if raster is None else scans.scan_of(values, raster)
    shown = raster or scans.numbered_raster(scan.shape[1])
    _draw_places(places, capture, raster, scan.sum(axis=-1), frame)
    row = scans.clear_row(scan)
    limits = busy_window(scan.reshape(-1, time.bins), time, 0.98)
    scans.draw_time_slice(above, sliced, scan, row, shown, time, limits, unit)
    sliced.set_title(f"Time along row {row + 1} from the top" if raster else f"Time against {counted}")
    if raster is None:
        sliced.set_xlabel(f"number of the {counted}")
    _draw_curves(curves, values, (laser, pixel), time, unit)
    if raster is not None:
        below = figure.add_subfigure(grid[1, 0])
        for number, bins in enumerate(scans.moments(scan)):
            scans.draw_moment(below.add_subplot(1, scans.MOMENTS, number + 1), scan, bins, raster, time)
    return figure


def _unit(stored: StoredScene, name: str) -> str:
    if name == "histogram":
        return "counts per bin"
    imported = isinstance(stored.config.scene.layout, ImportedCaptures)
    return "signal per bin" if imported else "photons per emitted photon and bin"


def _time(stored: StoredScene, name: str) -> TimeAxis:
    """The bins of a measurement."""
    axes = time_axes(stored.config)
    return axes["transient_bin" if "transient" in name and "transient_bin" in axes else "bin"].axis()


def _draw_curves(axes: Axes, values: Floats, channel: tuple[int, int], time: TimeAxis, unit: str) -> None:
    whole, one = values.sum(axis=(0, 1)), values[channel]
    axes.set(xlabel=time_label(time), ylabel=unit, title="Over time")
    if not whole.any():
        empty_note(axes, "nothing arrives within the time window")
        return
    edges = time.edges_s * 1e9
    axes.stairs(whole, edges, color=INK, linewidth=0.9, label="sum over all")
    axes.stairs(one, edges, color=EXPECTED, linewidth=0.9, label=f"laser point {channel[0]}, pixel {channel[1]}")
    axes.set_yscale("log")
    lowest = float(one[one > 0].min(initial=float(whole.max())))
    axes.set_ylim(max(0.5 * lowest, 1e-6 * float(whole.max())), 3 * float(whole.max()))
    axes.set_xlim(*busy_window(whole, time))
    axes.legend(loc="upper right")


def _draw_places(
    axes: Axes, capture: Capture, raster: scans.Raster | None, total: Floats, frame: ViewFrame | None
) -> None:
    """The sum over time as a picture of the wall, or as points on it where they make no grid."""
    axes.set_title("Sum over time, on the relay wall")
    if raster is not None:
        scans.draw_moment(axes, total[..., None], slice(0, 1), raster)
        return
    points = capture.laser.targets if len(capture.laser.targets) > 1 else capture.sensor.pixels.mean(axis=1)
    scans.draw_places(axes, points, frame, values=total.ravel() if total.size == len(points) else None)


def _listed(values: Floats) -> tuple[str, Floats]:
    """Name of the channels of a scan without a grid, "laser point" or "pixel", and their (1, N, bin) histograms."""
    if len(values) > 1 or values.shape[1] == 1:
        return "laser point", values.sum(axis=1)[None]
    return "pixel", values


def _rectangle(stored: StoredScene, name: str) -> Rectangle | None:
    vectors = stored.arrays[name]
    return Rectangle(*vectors) if np.isfinite(vectors).all() else None


def _frame(stored: StoredScene) -> ViewFrame | None:
    """The frame for places in pictures: that of the labels, or else of the relay wall; None without either."""
    found = _rectangle(stored, "hidden_view") or _rectangle(stored, "relay_wall")
    return None if found is None else ViewFrame.about(found)


def _capture(stored: StoredScene) -> Capture:
    """The stored capture. A device without a stored place gets an arbitrary one, which no picture here shows."""
    arrays, settings = stored.arrays, stored.config.capture
    lit, pixels = np.asarray(arrays["laser_points"], np.float64), np.asarray(arrays["sensor_pixels"], np.float64)
    # Pictures show what pixels look at, where that is known, and not how large their fields of view are.
    seen = np.asarray(arrays["sensor_points"], np.float64)[:, None]
    pixels = np.where(np.isfinite(seen), seen, pixels.mean(axis=1, keepdims=True)).repeat(4, axis=1)
    middle = pixels.mean(axis=(0, 1))
    lit = np.where(np.isfinite(lit), lit, middle)

    def placed(name: str) -> Floats:
        position = arrays[name]
        return position if np.isfinite(position).all() else middle + np.array([0.0, 0.0, 1.0 + np.ptp(lit)])

    laser, sensor = Laser(placed("laser_position"), lit), Sensor(placed("sensor_position"), pixels)
    return Capture(laser, sensor, settings.time.axis(), settings.pairing, settings.illumination)


def _as_labelled(stored: StoredScene) -> Scene:
    """A stand-in for the unknown scene in pictures of labels: the window, and for each part a pane in it."""
    import trimesh

    view = _rectangle(stored, "hidden_view")
    assert view is not None
    objects = {int(part) for part in np.ravel(stored.arrays.get("object_part", ())) if part >= 0}
    names = str(stored.parameters.get("scene.part_names", "")).split(",")
    pane = trimesh.Trimesh(view.corners, [(0, 1, 2), (0, 2, 3)], process=False)
    parts = [
        Part(name, pane, Lambertian(0.5), "object" if number in objects else "structure")
        for number, name in enumerate(names)
    ]
    bounds = stored.arrays["hidden_bounds"]
    hidden = bounds if np.isfinite(bounds).all() else None
    return Scene.from_parts(parts, hidden_view=view, hidden_bounds=hidden)
