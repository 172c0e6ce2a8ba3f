"""What was simulated of a scene, and why: the switchboard's decisions as a table."""

from __future__ import annotations

import textwrap
from typing import TYPE_CHECKING

from datagen.effects import EFFECTS
from datagen.effects.rule import Decision
from datagen.report.replay import Replay, StoredScene
from datagen.report.style import caption, caption_height, new_figure

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_COLUMNS = (("effect", 0.0), ("decision", 0.19), ("changes ≤", 0.27), ("by", 0.34), ("why", 0.40))
_REASON_WIDTH = 100
_LINE_IN = 0.21
_COLOURS = {"simulated": "#1b6e3c", "left out": "#a04000", "none": "#999999"}


def effects_page(stored: StoredScene, again: Replay) -> Figure | None:
    """A row for each effect; None where nothing was decided."""
    decisions = again.effects.decisions
    if not decisions:
        return None
    text = (
        "What of this scene was simulated. An effect is left out if that changes the light of three bounces and more "
        "(or, for the detector, the expected histogram) by less than its share of the tolerance, relative L2 over "
        f"the whole scan: together at most {again.effects.tolerance:g}. “changes ≤” is how much leaving it out could "
        "change: a bound is proven, a trial run measures with few samples. Effects that were switched on or off, and "
        "those that cost no time, are not estimated."
    )
    rows = [(decision, textwrap.wrap(_reason(decision), _REASON_WIDTH) or [""]) for decision in decisions]
    lines = sum(len(reason) for _, reason in rows) + 1.5
    figure = new_figure(13, _LINE_IN * lines + 0.5 + caption_height(13, text))
    grid = figure.add_gridspec(2, 1, height_ratios=[_LINE_IN * lines, caption_height(13, text)])
    figure.suptitle(f"{stored.title}: effects", fontweight="bold")
    axes = figure.add_subplot(grid[0])
    axes.set(xlim=(0, 1), ylim=(lines, 0))
    axes.set_axis_off()
    for name, x in _COLUMNS:
        axes.text(x, 0.0, name, fontweight="bold", va="top", fontsize=9)
    titles = {row.name: row.title for row in EFFECTS}
    y = 1.4
    for decision, reason in rows:
        state = "simulated" if decision.simulated else "left out" if decision.left_out else "none"
        number = (
            ""
            if decision.estimate is None or state == "none"
            else "> 1"
            if decision.estimate > 1
            else f"{decision.estimate:.2g}"
        )
        words = (titles[decision.effect], state, number, "" if state == "none" else decision.kind, "\n".join(reason))
        for (_, x), word in zip(_COLUMNS, words, strict=True):
            axes.text(x, y, word, va="top", fontsize=8.5, color=_COLOURS[state], linespacing=1.3)
        y += len(reason)
    caption(figure, figure.add_subplot(grid[1]), text)
    return figure


def _reason(decision: Decision) -> str:
    return decision.reason.replace("`", "")
