"""The interactive part of the preview: rooms to turn, labels to filter, scans to slide through.

The page's script (`explorer_page.html`) draws everything from the numbers given here and loads nothing else.
"""

from __future__ import annotations

import base64
import itertools
import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from datagen.labels.boxes import classes_in
from datagen.records import Scene
from datagen.records.arrays import Floats
from datagen.report.curves import busy_window
from datagen.report.labels import DRAWN, LabelImage
from datagen.report.replay import Replay, StoredScene
from datagen.report.scans import Raster, reach
from datagen.report.style import part_colors

MOST_TRIANGLES = 400
"""A part of more triangles is shown as its bounding box; furniture has fewer."""
MOST_BINS = 128
DECADES = 4.0
"""Time bins of a scan, and range of its brightness."""
_CUBE = np.array([[0, 1, 3], [0, 3, 2], [4, 6, 7], [4, 7, 5], [0, 4, 5], [0, 5, 1], [2, 3, 7], [2, 7, 6], [0, 2, 6],
                  [0, 6, 4], [1, 5, 7], [1, 7, 3]])  # fmt: skip


def explorer(scenes: Sequence[dict[str, Any]], total: int) -> str:
    """HTML with style and script that shows `scenes`, each made by `scene_data`, of `total` in the dataset."""
    page = (Path(__file__).parent / "explorer_page.html").read_text(encoding="utf-8")
    # No tag or comment of HTML within the data must end the script, or keep its own tag from doing so.
    page = page.replace("/*total*/0", str(total))
    return page.replace("[/*scenes*/]", json.dumps(scenes, separators=(",", ":")).replace("<", "\\u003c"))


def scene_data(stored: StoredScene, scene: Scene, error: float | None, replayed: Replay | None) -> dict[str, Any]:
    """One scene as plain values: triangles, labels and what filters need; with `replayed`, its light, too."""
    return {
        "index": stored.index,
        "layout": str(stored.parameters.get("layout.kind", "")),
        "classes": list(classes_in(scene)),
        "error": None if error is None or not np.isfinite(error) else float(error),
        "parts": _parts(scene, stored.significance()),
        "device": None if scene.device_position is None else np.round(scene.device_position, 3).tolist(),
        "labels": _labels(stored, scene),
        "scan": None if replayed is None else _scan(replayed),
    }


def _parts(scene: Scene, significance: Mapping[str, float]) -> list[dict[str, Any]]:
    found, colors = [], part_colors(scene)
    for name, role in zip(scene.part_names, scene.roles, strict=True):
        if "ceiling" in name:
            continue
        corners = scene.corners[scene.faces_of(name)]
        if len(corners) > MOST_TRIANGLES:
            axes = scene.pose_of(name).axes
            own = corners.reshape(-1, 3) @ axes.T
            ends = np.array([own.min(axis=0), own.max(axis=0)])
            box = np.stack(np.meshgrid(*ends.T, indexing="ij"), axis=-1).reshape(8, 3) @ axes
            corners = box[_CUBE]
        points = np.round(corners, 3).reshape(-1).tolist()
        part = {"name": name, "role": role, "color": colors[name], "corners": points}
        found.append(part | ({"sigma": float(f"{significance[name]:.2g}")} if name in significance else {}))
    return found


def _labels(stored: StoredScene, scene: Scene) -> list[dict[str, Any]]:
    """Stored labels as bytes, red, green and blue."""
    images = []
    for name in (name for name in DRAWN if name in stored.arrays):
        image = LabelImage.of(scene, name, stored.arrays[name])
        colors, size = image.rgb, np.round(image.high - image.low, 3).tolist()
        rows, columns, _ = colors.shape
        title = image.look.title + ("" if image.span is None else f", {image.span[0]:.3g} … {image.span[1]:.3g}")
        values = base64.b64encode(colors.tobytes()).decode()
        images.append({"name": title, "rows": rows, "columns": columns, "size": size, "values": values})
    return images


def _scan(replayed: Replay) -> dict[str, Any]:
    """The light at each place of the scan, by object and of the rest of the room, logarithmic in bytes."""
    raster, total = Raster.of(replayed.light), replayed.transient.total
    grids = {name: raster.scan_of(values) for name, values in _layers(replayed, total).items()}
    whole = next(iter(grids.values()))
    time = replayed.capture.time
    low, high = busy_window(whole.reshape(-1, time.bins), time, 0.999)
    first, last = np.searchsorted(time.edges_s * 1e9, [low, high])
    first, last = max(int(first) - 1, 0), min(max(int(last), 1), time.bins)
    step = max(1, -(-(last - first) // MOST_BINS))
    starts = np.arange(first, last, step)
    binned = {name: np.add.reduceat(values[..., :last], starts, axis=-1) for name, values in grids.items()}
    # The page opens at the bin that has most light of the objects, and at the place that has most of it then: most of
    # all light comes before, from the room.
    opened = np.sum([values for name, values in binned.items() if name in replayed.scene.objects], axis=0)
    opened = opened if np.any(opened) else binned["all light"]
    at = int(np.argmax(opened.sum(axis=(0, 1))))
    place = np.unravel_index(np.argmax(opened[..., at]), opened.shape[:2])
    highest, colors = max(float(values.max()) for values in binned.values()) or 1.0, part_colors(replayed.scene)
    curves = [
        {
            "name": name,
            "color": colors.get(name, "#222222" if name == "all light" else "#999999"),
            "values": _bytes(1 + np.log10(np.maximum(values / highest, 10.0**-DECADES)) / DECADES),
        }
        for name, values in binned.items()
    ]
    return {
        "rows": whole.shape[0], "columns": whole.shape[1], "bins": len(starts), "decades": DECADES,
        "highest": highest, "start_ns": float(time.edges_s[first] * 1e9), "width_ns": step * time.width_s * 1e9,
        "open": {"bin": at, "place": [int(index) for index in place]}, "curves": curves,
        "across": _across(raster), "up": _up(raster),
    }  # fmt: skip


def _across(raster: Raster) -> dict[str, Any]:
    """The horizontal axis of a scan: its name, and its ends from half a step before the first place."""
    if raster.x_m is None:
        return {"name": f"number of the {raster.what}", "ends": [-0.5, raster.channels.shape[1] - 0.5]}
    return {"name": "right (m)", "ends": reach(raster.x_m)}


def _up(raster: Raster) -> dict[str, Any] | None:
    """The vertical axis of a scan, whose first end is at the top; None for places on no grid, in a single row."""
    return None if raster.z_m is None else {"name": "up (m)", "ends": reach(raster.z_m)}


def _layers(replayed: Replay, total: Floats) -> Mapping[str, Floats]:
    """Name → (laser, pixel, bin): all light, the light of each of the first five objects, and the rest."""
    chosen = {
        name: replayed.transient.parts[name] for name in replayed.scene.objects if name in replayed.transient.parts
    }
    chosen = dict(itertools.islice(chosen.items(), 5))
    if not chosen:
        return {"all light": total}
    rest = np.maximum(total - np.sum([*chosen.values()], axis=0), 0.0)
    return {"all light": total, **chosen, "the rest": rest}


def _bytes(values: Floats) -> str:
    """Values in 0 … 1 as one byte each, in base64."""
    return base64.b64encode(np.clip(np.rint(255 * values), 0, 255).astype(np.uint8).tobytes()).decode()
