"""What is known of a scene whose room cannot be made again: made in Python, imported, or without its mesh files."""

from __future__ import annotations

import numpy as np

from datagen.config import DatasetConfig, time_axes
from datagen.config.scene_layouts import ImportedCaptures, NoLayout
from datagen.labels import ViewFrame
from datagen.records import Capture, Lambertian, Laser, Part, Rectangle, Scene, Sensor, TimeAxis
from datagen.records.arrays import Floats
from datagen.report.replay import Light, StoredScene

QUANTITIES = ("histogram", "transient")
"""Stored measurements that are drawn."""


def why_roomless(config: DatasetConfig, missing: str) -> str | None:
    """Why the rooms of a dataset cannot be drawn, as a whole clause; None where they can.

    missing : a line about a mesh file that is missing; empty if all are there.
    """
    layout = config.scene.layout
    if isinstance(layout, NoLayout):
        return layout.why
    return "the mesh files of its objects are gone; put them back to see the rooms" if missing else None


def unit_of(stored: StoredScene, name: str) -> str:
    """What a bin of a stored measurement has."""
    if name == "histogram":
        return "counts"
    return "signal" if isinstance(stored.config.scene.layout, ImportedCaptures) else "photons per emitted photon"


def time_of_stored(stored: StoredScene, name: str) -> TimeAxis:
    """The bins of a stored measurement."""
    axes = time_axes(stored.config)
    return axes["transient_bin" if name == "transient" and "transient_bin" in axes else "bin"].axis()


def light_of_stored(stored: StoredScene) -> Light | None:
    """The first stored measurement; None where there is none."""
    there = [name for name in QUANTITIES if name in stored.arrays]
    if not there:
        return None
    total = np.asarray(stored.arrays[there[0]], np.float64)
    outline = _rectangle(stored, "hidden_view") or _rectangle(stored, "relay_wall")
    frame = None if outline is None else ViewFrame.about(outline)
    unit = f"{unit_of(stored, there[0])} per bin"
    return Light(_capture(stored), total, np.zeros_like(total), time_of_stored(stored, there[0]), frame, unit)


def scene_of_stored(stored: StoredScene) -> Scene | None:
    """A stand-in for the unknown scene in pictures of labels: the window, and for each part a pane in it; None where
    the window is not known."""
    import trimesh

    view = _rectangle(stored, "hidden_view")
    if view is None:
        return None
    objects = {int(part) for part in np.ravel(stored.arrays.get("object_part", ())) if part >= 0}
    names = str(stored.parameters.get("scene.part_names", "")).split(",")
    pane = trimesh.Trimesh(view.corners, [(0, 1, 2), (0, 2, 3)], process=False)
    parts = [
        Part(name, pane, Lambertian(0.5), "object" if number in objects else "structure")
        for number, name in enumerate(names)
    ]
    bounds = stored.arrays["hidden_bounds"]
    return Scene.from_parts(parts, hidden_view=view, hidden_bounds=bounds if np.isfinite(bounds).all() else None)


def _rectangle(stored: StoredScene, name: str) -> Rectangle | None:
    vectors = stored.arrays[name]
    return Rectangle(*vectors) if np.isfinite(vectors).all() else None


def _capture(stored: StoredScene) -> Capture:
    """The stored capture; a device whose place is not known stands before the wall, which no picture here shows."""
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
