"""Pictures of evidence: how detectable objects are, by the SNR of a matched filter (their significance).

For a scene the light of each object over the noise; for a dataset the significance of each kind of object.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence
from html import escape
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from datagen.records import Scalar, Scene, TimeAxis
from datagen.records.arrays import Floats
from datagen.report.replay import Replay, StoredScene
from datagen.report.style import EXPECTED, INK, captioned, empty_note, part_colors
from datagen.report.time_plots import busy_window, time_label
from datagen.store.summaries import LEAST, evidence_by_kind, evidence_lines, significance_by_kind

FAINT = 1.0
"""Significance, in standard deviations, under which an object is as good as absent."""
_WEAK = "#A33030"
_EDGES = np.geomspace(0.01, 1000, 41)
"""Edges of the bins in which objects are counted; those outside are counted in the first or the last bin."""


def verdict(significance: float, presence: tuple[float, float] | None = None) -> str:
    """Words that say whether an object of this significance can be found in the data.

    presence : significance of its presence, and how far that may be off.
    """
    if significance >= LEAST:
        return "in the data"
    if presence is not None and presence[0] - presence[1] >= LEAST:
        return "in the data by its shadow"
    return "doubtful" if significance >= FAINT else "not in the data"


def stated_significance(stored: StoredScene, scene: Scene) -> dict[str, float]:
    """Object → stored significance; objects without one are left out."""
    found = {name: stored.parameters.get(f"evidence.{name}.significance") for name in scene.objects}
    return {name: float(value) for name, value in found.items() if isinstance(value, int | float) and value == value}


def evidence_page(stored: StoredScene, again: Replay) -> Figure | None:
    """The page of evidence, each object's light over the noise and its significance; None if none is known."""
    significance = stated_significance(stored, again.scene) or {
        name: float(np.sqrt((curve**2).sum())) for name, curve in again.own.items()
    }
    if not significance:
        return None
    text = (
        "What each object's label rests on. Left: its own light over the noise, √Σ s²/b over all histograms of the "
        "scan in each time bin, with s the expected detections of its light of three bounces and b all that are "
        "expected; the root of the sum of a curve's squares is the object's significance. Right: that significance, "
        f"what an ideal matched filter could see. Under {LEAST:g} σ (grey) no network can learn the object from the "
        "data; objects that lie there are drawn pale."
    )
    presence = _presence(stored.parameters, significance)
    if presence:
        text += (
            " Diamonds: the scene with the object against the scene without it, so that its shadow counts, too; "
            "whiskers: by how much the simulations' errors may have moved them."
        )
    high = 1.5 + 0.42 * len(significance)
    figure, grid = captioned(12, [max(3.6, high)], text, f"{stored.title}: the evidence for each object", 2, [1.1, 1])
    colors = part_colors(again.scene)
    _draw_in_time(figure.add_subplot(grid[0, 0]), again, significance, colors)
    _draw_significance(figure.add_subplot(grid[0, 1]), stored.parameters, significance, presence, colors)
    return figure


def _presence(parameters: Mapping[str, Scalar], names: Iterable[str]) -> dict[str, tuple[float, float]]:
    """Object → significance of its presence and how far that may be off, where both are stored."""
    found = {}
    for name in names:
        value, floor = (parameters.get(f"evidence.{name}.presence{of}") for of in ("", "_floor"))
        if isinstance(value, int | float) and isinstance(floor, int | float) and np.isfinite([value, floor]).all():
            found[name] = (float(value), float(floor))
    return found


def _draw_in_time(axes: Axes, again: Replay, significance: Mapping[str, float], colors: Mapping[str, str]) -> None:
    time: TimeAxis = again.counted
    axes.set_title("Its light over the noise, by time")
    axes.set(xlabel=time_label(time), ylabel=f"σ per bin of {time.width_s * 1e12:g} ps")
    curves = {name: again.own[name] for name in significance if name in again.own}
    highest = max((float(curve.max()) for curve in curves.values()), default=0.0)
    if highest <= 0:
        empty_note(axes, "no light of any object is known apart" if not curves else "no object brings any light")
        return
    edges = time.edges_s * 1e9
    for name, curve in sorted(curves.items(), key=lambda of: -float(of[1].max())):
        seen = significance[name] >= LEAST
        axes.stairs(curve, edges, fill=True, color=colors[name], alpha=0.35 if seen else 0.12, linewidth=0)
        axes.stairs(curve, edges, color=colors[name], linewidth=1.4 if seen else 0.8, label=name)
    axes.set_xlim(*busy_window(np.sum([curve**2 for curve in curves.values()], axis=0), time))
    # Scaled to its own height, light of no significance would look like much.
    axes.set_ylim(0, max(1.08 * highest, 1.0))


def _draw_significance(
    axes: Axes, parameters: Mapping[str, Scalar], significance: Mapping[str, float],
    presence: Mapping[str, tuple[float, float]], colors: Mapping[str, str],
) -> None:  # fmt: skip
    """A bar for each object, the most significant on top, on a logarithmic axis."""
    axes.set_title("Significance")
    order = sorted(significance, key=lambda name: significance[name])
    highest = max(*significance.values(), *(a + b for a, b in presence.values()), 10 * LEAST)
    low = 0.01
    axes.set_xscale("log")
    # Space to the right of each bar for its text.
    axes.set(xlim=(low, highest * (highest / low) ** 0.75), ylim=(min(-0.6, len(order) - 3.4), len(order) - 0.4))
    axes.axvspan(low, LEAST, color="#E9E9E9", linewidth=0, zorder=0)
    axes.axvline(LEAST, color=INK, linewidth=0.9, zorder=1)
    axes.set_yticks(range(len(order)), order)
    axes.set_xticks([10.0**k for k in range(-2, int(np.log10(highest)) + 1)])
    axes.xaxis.set_major_formatter(lambda value, _: f"{value:g}")
    axes.minorticks_off()
    axes.set_xlabel(f"standard deviations (line: {LEAST:g})")
    for row, name in enumerate(order):
        value, other = significance[name], presence.get(name)
        words = verdict(value, other)
        seen = words.startswith("in the data")
        axes.barh(row, max(value - low, 0.0), left=low, height=0.62, color=colors[name], alpha=1.0 if seen else 0.35)
        end = max(value, low)
        if other is not None:
            least, middle, most = (max(of, low) for of in (other[0] - other[1], other[0], sum(other)))
            axes.plot([least, most], [row, row], color=INK, linewidth=0.9, zorder=3)
            axes.plot([middle], [row], marker="D", markersize=4, color="white", markeredgecolor=INK, zorder=4)
            end = max(end, most)
        style: dict[str, Any] = {"color": INK if seen else _WEAK, "fontweight": "bold" if seen else "normal"}
        box = {"facecolor": "white", "alpha": 0.8, "edgecolor": "none", "pad": 0.6}
        axes.text(end * 1.25, row + 0.03, f"{_short(value)} σ: {words}", va="bottom", fontsize=8, bbox=box, **style)
        brought = parameters.get(f"evidence.{name}.detections")
        if isinstance(brought, int | float):
            counts = f"{_short(float(brought))} detections"
            axes.text(end * 1.25, row - 0.03, counts, va="top", fontsize=7, color="#666666", bbox=box)


def _short(value: float) -> str:
    return f"{value:,.0f}" if value >= 10 else f"{value:.1f}" if value >= 1 else f"{value:.2g}"


def kinds_report(scenes: Sequence[Mapping[str, Scalar]]) -> str:
    """HTML: the distribution of the significance of each kind of object over scenes, with a line that says what to
    do; empty where no evidence is stored. Its text is no picture, so that it can be read on any screen.
    """
    values = significance_by_kind(scenes)
    lines = {re.sub(":.*", "", line): line for line in evidence_lines(evidence_by_kind(scenes))}
    return "".join(f"<p>{escape(lines[kind])}</p>{_strip(np.array(of))}" for kind, of in values.items())


def _strip(values: Floats) -> str:
    """An SVG histogram over a logarithmic axis from 0.01 to 1000; bars under `LEAST` are red."""
    counts, _ = np.histogram(np.clip(values, _EDGES[0], _EDGES[-1] * (1 - 1e-9)), _EDGES)
    width, high = 100 / len(counts), max(int(counts.max()), 1)
    bars = "".join(
        f'<rect x="{k * width:.2f}" y="{40 - 38 * n / high:.1f}" width="{0.9 * width:.2f}" '
        f'height="{38 * n / high:.1f}" fill="{_WEAK if _EDGES[k + 1] <= 1.01 * LEAST else EXPECTED}"/>'
        for k, n in enumerate(counts)
        if n
    )
    at = 100 * np.log(LEAST / _EDGES[0]) / np.log(_EDGES[-1] / _EDGES[0])
    ticks = "".join(f"<span>{10.0**k:g}{' σ' if k == 3 else ''}</span>" for k in range(-2, 4))
    return (
        '<svg viewBox="0 0 100 40" preserveAspectRatio="none" style="width:100%;max-width:640px;height:60px;'
        f'display:block;background:#fafafa;border-bottom:1px solid #999"><rect width="{at:.2f}" height="40" '
        f'fill="#eee"/>{bars}</svg><div style="display:flex;justify-content:space-between;max-width:640px;'
        f'font-size:12px">{ticks}</div>'
    )
