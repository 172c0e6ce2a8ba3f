"""What was simulated of a scene, and why: the switchboard's decisions as a table."""

from __future__ import annotations

import textwrap
from typing import TYPE_CHECKING

from datagen.effects import EFFECTS
from datagen.report.replay import Replay, StoredScene
from datagen.report.style import captioned

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
    reasons = [textwrap.wrap(decision.reason.replace("`", ""), _REASON_WIDTH) or [""] for decision in decisions]
    lines = sum(map(len, reasons)) + 1.5
    figure, grid = captioned(13, [_LINE_IN * lines + 0.5], text, f"{stored.title}: effects")
    axes = figure.add_subplot(grid[0])
    axes.set(xlim=(0, 1), ylim=(lines, 0))
    axes.set_axis_off()
    for name, x in _COLUMNS:
        axes.text(x, 0.0, name, fontweight="bold", va="top", fontsize=9)
    titles = {row.name: row.title for row in EFFECTS}
    y = 1.4
    for decision, reason in zip(decisions, reasons, strict=True):
        state = "simulated" if decision.simulated else "left out" if decision.left_out else "none"
        number = ""
        if decision.estimate is not None and state != "none":
            number = "> 1" if decision.estimate > 1 else f"{decision.estimate:.2g}"
        words = (titles[decision.effect], state, number, "" if state == "none" else decision.kind, "\n".join(reason))
        for (_, x), word in zip(_COLUMNS, words, strict=True):
            axes.text(x, y, word, va="top", fontsize=8.5, color=_COLOURS[state], linespacing=1.3)
        y += len(reason)
    return figure
