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

from datagen.labels import ViewFrame
from datagen.labels.boxes import classes_in
from datagen.records import Scene
from datagen.records.arrays import Floats
from datagen.report import scan_plots as scans
from datagen.report.evidence_pictures import stated_significance
from datagen.report.replay import Replay, StoredScene
from datagen.report.style import part_colors
from datagen.report.time_plots import busy_window, clear_channel

MOST_TRIANGLES = 400
"""A part of more triangles is shown as its bounding box. Half as many would show furniture as boxes."""
MOST_BINS = 128
DECADES = 4.0
"""Time bins of a scan, and range of its brightness."""
_IMAGES = ("depth", "albedo", "shaded", "normal", "part_id")
_CUBE = np.array([[0, 1, 3], [0, 3, 2], [4, 6, 7], [4, 7, 5], [0, 4, 5], [0, 5, 1], [2, 3, 7], [2, 7, 6], [0, 2, 6],
                  [0, 6, 4], [1, 5, 7], [1, 7, 3]])  # fmt: skip


def explorer(scenes: Sequence[dict[str, Any]]) -> str:
    """HTML with style and script that shows `scenes`, each made by `scene_data`."""
    page = (Path(__file__).parent / "explorer_page.html").read_text(encoding="utf-8")
    # A closing tag within the data must not end the script.
    return page.replace("[/*scenes*/]", json.dumps(scenes, separators=(",", ":")).replace("</", "<\\/"))


def scene_data(stored: StoredScene, scene: Scene, error: float | None, again: Replay | None) -> dict[str, Any]:
    """One scene as plain values: triangles, labels and what filters need; with `again`, its light, too."""
    return {
        "index": stored.index,
        "layout": str(stored.parameters.get("layout.kind", "")),
        "classes": list(classes_in(scene)),
        "error": None if error is None or not np.isfinite(error) else float(error),
        "parts": _parts(scene, stated_significance(stored, scene)),
        "device": None if scene.device_position is None else np.round(scene.device_position, 3).tolist(),
        "labels": _labels(stored, scene),
        "scan": None if again is None else _scan(again),
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
    """Stored label images as bytes, of one band (grey) or three (red, green, blue)."""
    frame = ViewFrame.of(scene)
    images = []
    for name in _IMAGES:
        if name not in stored.arrays:
            continue
        values = np.asarray(stored.arrays[name], np.float64)
        meaning = name
        if name == "normal":
            shown = np.where(np.abs(values).sum(axis=-1, keepdims=True) > 0, (values * [1, 1, -1] + 1) / 2, 1.0)
        elif name == "part_id":
            colors = [part_colors(scene)[part] for part in scene.part_names]
            table = np.array([[int(c[k : k + 2], 16) for k in (1, 3, 5)] for c in colors] + [[255] * 3]) / 255
            shown = table[stored.arrays[name].astype(np.int64)]
        else:
            highest = float(values.max()) or 1.0
            shown = 1 - 0.85 * values / highest if name == "depth" else values / highest
            shown = np.where(values > 0, shown, 1.0 if name == "depth" else 0.0)
            unit = " m" if name == "depth" else ""
            meaning = f"{name}, 0 … {highest:.3g}{unit}"
        size = [round(2 * frame.half_width_m, 3), round(2 * frame.half_height_m, 3)]
        rows, columns = shown.shape[:2]
        bands = 3 if shown.ndim == 3 else 1
        images.append(
            {"name": meaning, "rows": rows, "columns": columns, "bands": bands, "size": size, "values": _bytes(shown)}
        )
    return images


def _scan(again: Replay) -> dict[str, Any]:
    """The light at each place of the scan, by object and of the rest of the room, logarithmic in bytes."""
    raster = scans.raster_of(again.capture, clear_channel(again.scene, again.transient), again.frame)
    total = again.transient.total
    layers = _layers(again, total)
    if raster is None:
        grids = {name: values.sum(axis=1)[None] for name, values in layers.items()}
    else:
        grids = {name: scans.scan_of(values, raster) for name, values in layers.items()}
    whole = next(iter(grids.values()))
    time = again.capture.time
    low, high = busy_window(whole.reshape(-1, time.bins), time, 0.999)
    first, last = np.searchsorted(time.edges_s * 1e9, [low, high])
    first, last = max(int(first) - 1, 0), min(max(int(last), 1), time.bins)
    step = max(1, -(-(last - first) // MOST_BINS))
    starts = np.arange(first, last, step)
    binned = {name: np.add.reduceat(values[..., :last], starts, axis=-1) for name, values in grids.items()}
    highest, colors = max(float(values.max()) for values in binned.values()) or 1.0, part_colors(again.scene)
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
        "curves": curves,
    }  # fmt: skip


def _layers(again: Replay, total: Floats) -> Mapping[str, Floats]:
    """Name → (laser, pixel, bin): all light, the light of each of the first five objects, and the rest."""
    chosen = {name: again.transient.parts[name] for name in again.scene.objects if name in again.transient.parts}
    chosen = dict(itertools.islice(chosen.items(), 5))
    if not chosen:
        return {"all light": total}
    rest = np.maximum(total - np.sum([*chosen.values()], axis=0), 0.0)
    return {"all light": total, **chosen, "the rest": rest}


def _bytes(values: Floats) -> str:
    """Values in 0 … 1 as one byte each, in base64."""
    return base64.b64encode(np.clip(np.rint(255 * values), 0, 255).astype(np.uint8).tobytes()).decode()
