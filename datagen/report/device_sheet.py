"""What each device sees of the same room: one row a device, and a table of what a scene of it takes and counts."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.collections import PolyCollection
from matplotlib.colors import Colormap
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from numpy.typing import NDArray

from datagen.capture.device_optics import half_tangents, zone_boxes
from datagen.detector import Exposure, Spad, detect
from datagen.devices import Device, zone_depth
from datagen.effects import EFFECTS, EffectDecisions, plan_effects
from datagen.records import Accuracy, Capture, Lambertian, Part, Scene, Transient
from datagen.records.arrays import Floats
from datagen.report.style import SMALLEST_PT, captioned, check_png, house_style, save_png, short
from datagen.transport import transient_of
from datagen.transport.rays import Raycaster
from datagen.units import SPEED_OF_LIGHT_M_PER_S

PLACE = np.array([0.0, 0.0, 0.5])
"""Where every device stands in the room, its axis along x."""
ACCURACY = Accuracy(samples=64, max_bounces=3, direct=True)
"""Light of one bounce is integrated over beams; that of three, far fainter, only has to be of the right size."""
VIEW = (0.78, 0.62)
"""Tangents of half the width and height of the pictures: wider than the field of any device of the catalogue."""
_LIGHT = "#FF7F0E"
_DOT: dict[str, Any] = {
    "color": _LIGHT, "marker": "o", "markersize": 4, "markeredgecolor": "black", "markeredgewidth": 0.4,
    "linestyle": "",
}  # fmt: skip
PIXELS = 360
"""Pixels of a picture from left to right."""
FRONTS_M = {"box": 0.55, "ball": 0.85, "wall": 1.2}
"""What stands in the room → depth of its front."""
NEAR_M, FAR_M = 0.4, 1.4
"""Ends of the scale of colours."""
MOST_CURVES = 81
"""Most histograms drawn for a device: more would cover one another."""
MOST_DETECTIONS = 0.02
"""Detections a laser pulse above which a scanning device's laser is attenuated, as a filter would do it, so that the
first photons do not hide all others."""


@dataclass(frozen=True)
class Seen:
    """What a device sees of the room.

    counts : (laser, pixel, bin). depth : (P,) as of `zone_depth`. attenuation : factor by which the laser is
    weakened, 1 for none. seconds : of light and counts.
    """

    device: Device
    capture: Capture
    counts: NDArray[np.integer]
    depth: Floats
    effects: EffectDecisions
    attenuation: float
    seconds: float


def device_sheet(devices: Sequence[Device], out: str | Path) -> str:
    """Draw what each device sees of the same room into the file `out`, .png; returns the table of the devices.

    The table has, for each device, zones and bins, seconds of a scene, counts, and the effects simulated. Raises
    `InputError` where the picture cannot be written.
    """
    path, scene = check_png(out), sheet_room()
    seen = [seen_by(device, scene) for device in devices]
    _draw(scene, seen, path)
    return table(seen)


def sheet_room() -> Scene:
    """The room: a box and a ball on a floor before a wall, 0.55, 0.85 and 1.2 m away."""
    import trimesh

    def box(low: tuple[float, float, float], high: tuple[float, float, float]) -> trimesh.Trimesh:
        made: trimesh.Trimesh = trimesh.creation.box(bounds=[low, high])
        return made

    ball = trimesh.creation.icosphere(3, 0.17).apply_translation((1.02, -0.28, 0.47))
    parts = [
        Part("relay_wall", box((1.2, -3, -0.02), (1.22, 3, 2)), Lambertian(0.7), role="relay_wall"),
        Part("floor", box((-0.5, -3, -0.02), (1.2, 3, 0)), Lambertian(0.4), role="structure"),
        Part("box", box((0.55, 0.08, 0), (0.8, 0.33, 0.6)), Lambertian(0.6)),
        Part("pedestal", box((0.95, -0.35, 0), (1.09, -0.21, 0.31)), Lambertian(0.3)),
        Part("ball", ball, Lambertian(0.8)),
    ]
    return Scene.from_parts(parts)


def seen_by(device: Device, scene: Scene) -> Seen:
    """What a device that stands at `PLACE` sees of a scene."""
    capture, spad, exposure = device.at(PLACE, PLACE + np.array([1.0, 0.0, 0.0]))
    if isinstance(device.counting.gate_ns, tuple) and spad.gate_width_s is not None:
        # Such a gate moves in steps; here it stands where the wall's light arrives.
        middle_s = 2 * FRONTS_M["wall"] / SPEED_OF_LIGHT_M_PER_S
        spad = replace(spad, gate_start_s=middle_s - spad.gate_width_s / 2)
    # Once before the clock runs, for kernels that are compiled at their first call.
    light = transient_of(scene, capture, ACCURACY, 0)
    began = time.perf_counter()
    light = transient_of(scene, capture, ACCURACY, 0)
    weaker, conditions = _attenuated(light, spad, exposure, capture)
    counts = detect(light.total, capture.time, spad, conditions, seed=0, approximate=True)
    seconds = time.perf_counter() - began
    effects = plan_effects(scene, capture, ACCURACY, spad, conditions, transient=light)
    return Seen(device, capture, counts, zone_depth(scene, capture), effects, weaker, seconds)


def _attenuated(light: Transient, spad: Spad, exposure: Exposure, capture: Capture) -> tuple[float, Exposure]:
    """The factor by which a scanning device's laser has to be weakened, and the exposure with it."""
    if capture.illumination == "flood":
        return 1.0, exposure
    most = float(light.total.sum(axis=2).max()) * exposure.photons_per_pulse * spad.pde
    factor = max(most / MOST_DETECTIONS, 1.0)
    return factor, replace(exposure, photons_per_pulse=exposure.photons_per_pulse / factor)


def table(seen: Sequence[Seen]) -> str:
    """The table of the devices, as Markdown, and a line with the effects that all of them have."""
    titles = {row.name: row.title for row in EFFECTS}
    lines = ["| device | zones × bins | s a scene | counts | further effects |", "|---|---:|---:|---:|---|"]
    on = [[titles[d.effect] for d in one.effects.decisions if d.simulated and d.kind != "absent"] for one in seen]
    shared = [title for title in on[0] if all(title in others for others in on)]
    for one, simulated in zip(seen, on, strict=True):
        lasers, pixels, bins = one.counts.shape
        shape = f"{pixels} × {bins}" if lasers == 1 else f"{lasers} points × {pixels} × {bins}"
        counts = f"{one.counts.sum():.2g}" + ("" if one.attenuation == 1 else f" (laser / {one.attenuation:.1g})")
        further = ", ".join(title for title in simulated if title not in shared)
        lines.append(f"| `{one.device.name}` | {shape} | {one.seconds:.2f} | {counts} | {further} |")
    return "\n".join([*lines, "", f"Effects simulated for all: {', '.join(shared)}."])


def _draw(scene: Scene, seen: Sequence[Seen], path: Path) -> None:
    """A row for each device: the room as it faces it, with its zones and its light, and its histograms."""
    text = (
        "Left: the room as each device faces it, in the colour of its depth. Right: its histograms of one frame over "
        "the distance that a bin stands for, each in the colour of the mean depth that its zone sees (grey: none); "
        "what is level are dark counts and ambient light. Triangles: fronts of box, ball and wall."
    )
    colors = colormaps["turbo_r"]
    with house_style():
        title = "What each device sees of the same room"
        figure, grid = captioned([1.7] * len(seen) + [0.55], text, title, 2, [1, 2.1])
        picture = _picture(scene, colors)
        for row, one in enumerate(seen):
            _draw_view(figure.add_subplot(grid[row, 0]), one, picture)
            axes = figure.add_subplot(grid[row, 1])
            _draw_histograms(axes, one, colors, named=row == 0)
            axes.set_xlabel("distance that the bin stands for (m)" if row + 1 == len(seen) else "")
        _draw_key(figure.add_subplot(grid[len(seen), :]), colors)
        save_png(figure, path)


def _draw_key(axes: Axes, colors: Colormap) -> None:
    """What the marks of the pictures mean, and the scale of depths."""
    axes.set_axis_off()
    marks = [
        Line2D([], [], color=_LIGHT, linestyle="--", linewidth=1.6, label="the light's field"),
        Line2D([], [], **_DOT, label="a dot of light"),
        Patch(facecolor="none", edgecolor="black", label="a zone"),
        Line2D([], [], color="black", marker=".", markersize=3, linestyle="", label="a point of a scan"),
    ]
    axes.legend(handles=marks, loc="center left", bbox_to_anchor=(0.0, 0.5), ncols=2, borderaxespad=0)
    scale = axes.inset_axes((0.62, 0.55, 0.36, 0.25))
    scale.imshow(colors(np.linspace(0, 1, 256))[None], extent=(NEAR_M, FAR_M, 0, 1), aspect="auto")
    scale.set(yticks=[], xlabel="depth (m)")


def _picture(scene: Scene, colors: Colormap) -> Floats:
    """(rows, columns, 3) the room as a device faces it: colours for depth, shaded by the slant of surfaces."""
    width, height = VIEW
    rows = round(PIXELS * height / width)
    right, up = np.meshgrid(np.linspace(-width, width, PIXELS), np.linspace(height, -height, rows))
    directions = np.stack([np.ones_like(right), -right, up], axis=-1).reshape(-1, 3)
    hits = Raycaster(scene).closest(PLACE, directions)
    depth = np.where(hits.valid, hits.position[:, 0] - PLACE[0], np.inf)
    unit = directions / np.linalg.norm(directions, axis=1, keepdims=True)
    slant = np.abs(np.einsum("nk,nk->n", hits.normal, unit))
    shown = _color(colors, depth)[:, :3] * (0.45 + 0.55 * slant[:, None])
    return np.asarray(np.where(hits.valid[:, None], shown, 1.0)).reshape(rows, PIXELS, 3)


def _color(colors: Colormap, depth: Floats) -> Floats:
    return np.asarray(colors((depth - NEAR_M) / (FAR_M - NEAR_M)))


def _tangents(points: Floats, eye: Floats) -> Floats:
    """(…, 2) right and up of the directions to points, which a device at `PLACE` faces along x."""
    span = points - eye
    return np.asarray(np.stack([-span[..., 1], span[..., 2]], axis=-1) / span[..., :1])


def _draw_view(axes: Axes, one: Seen, picture: Floats) -> None:
    """The room with the device's zones and light."""
    (width, height), light, zones = VIEW, one.device.light, one.device.zones
    axes.imshow(picture, extent=(-width, width, -height, height), alpha=0.85)
    axes.set(xticks=[], yticks=[], xlim=(-width, width), ylim=(-height, height))
    axes.set_ylabel(short(one.device.name), fontweight="bold")
    half = half_tangents(light.field_deg)
    field = np.array([(-1, -1), (1, -1), (1, 1), (-1, 1), (-1, -1)]) * half
    axes.plot(*field.T, "--", color=_LIGHT, lw=1.6)
    points = _tangents(one.capture.laser.targets, one.capture.laser.position)
    if light.confocal:
        axes.plot(*points.T, ",", color="black", alpha=0.6)
        return
    boxes = zone_boxes(zones)
    x, y, w, h = (side[:, None] for side in boxes.T)
    corners = np.stack([np.hstack([x - w / 2, x + w / 2, x + w / 2, x - w / 2]),
                        np.hstack([y - h / 2, y - h / 2, y + h / 2, y + h / 2])], axis=-1)  # fmt: skip
    if light.kind != "flood":
        axes.plot(*points.T, **_DOT, zorder=3)
    axes.add_collection(PolyCollection([*corners], facecolors="none", edgecolors="black",
                                     linewidths=0.8 if len(corners) <= MOST_CURVES else 0.1))  # fmt: skip


def _draw_histograms(axes: Axes, one: Seen, colors: Colormap, named: bool) -> None:
    """The counts of the zones over distance. named : whether the triangles at the fronts have names."""
    device, counts = one.device, one.counts
    lasers, _, bins = counts.shape
    # A scan over many pixels is shown as each pixel's sum over the scan, a confocal one point by point.
    curves = counts[:, 0] if device.light.confocal else counts.sum(axis=0)
    some = np.linspace(0, len(curves) - 1, MOST_CURVES).round().astype(int)
    shown = np.unique(np.append(some, curves.sum(axis=1).argmax()))
    edges = (np.arange(bins + 1) - device.time.zero_bin) * device.time.bin_width_ps * 1e-12
    edges_m = edges * SPEED_OF_LIGHT_M_PER_S / 2
    for k in shown:
        color = _color(colors, one.depth[k : k + 1])[0] if np.isfinite(one.depth[k]) else "#999999"
        axes.stairs(np.maximum(curves[k], 0.5), edges_m, color=color, lw=0.9, baseline=None)
    axes.set(yscale="log", xlim=(-0.15, 2.0), ylim=(0.7, 2.5 * max(float(curves.max()), 10.0)))
    top = axes.get_ylim()[1]
    for name, depth in FRONTS_M.items():
        axes.plot([depth], [top], "v", color=_color(colors, np.array([depth]))[0], ms=7, mec="black", clip_on=False)
        if named:
            there: dict[str, Any] = {"ha": "center", "textcoords": "offset points", "fontsize": SMALLEST_PT}
            axes.annotate(f"{name}\n{depth:g} m", (depth, top), (0, 6), **there)
    if edges_m[-1] < 2.0:
        axes.axvspan(edges_m[-1], 2.0, color="#EEEEEE", lw=0)
        axes.text(edges_m[-1] + 0.02, top / 2, "no bins", color="#777777", va="top", fontsize=SMALLEST_PT)
    many = f"{len(shown)} of {len(curves)}" if len(shown) < len(curves) else f"{len(curves)}"
    zones = "points" if device.light.confocal else "zones" if len(curves) > 1 else "zone"
    more = [f"sum over {lasers} laser points"] * (lasers > 1 and not device.light.confocal)
    more += ["gate moved to the wall"] * isinstance(device.counting.gate_ns, tuple)
    more += [f"laser weakened {float(f'{one.attenuation:.1g}'):,.0f}-fold"] * (one.attenuation != 1)
    lines = [f"{many} {zones}, {bins} bins of {device.time.bin_width_ps:g} ps", ", ".join(more)]
    axes.set_title("\n".join(line for line in lines if line), fontsize=9, fontweight="normal", pad=34 if named else 8)
    axes.set_ylabel("counts")
