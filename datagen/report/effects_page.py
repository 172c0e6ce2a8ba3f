"""What was simulated of a scene, and why: the switchboard's decisions, a line each."""

from __future__ import annotations

import textwrap
from typing import TYPE_CHECKING

from datagen.effects import decision_lines
from datagen.report.replay import Replay, StoredScene
from datagen.report.style import captioned

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_LETTERS = 180
_LINE_IN = 0.17


def effects_page(stored: StoredScene, again: Replay) -> Figure | None:
    """A line for each effect; None where nothing was decided."""
    if not again.effects.decisions:
        return None
    text = (
        "What of this scene was simulated. An effect is left out if that changes the light of three bounces and more "
        "(or, for the detector, the expected histogram) by less than its share of the tolerance, relative L2 over "
        f"the whole scan: together at most {again.effects.tolerance:g}. “change” is how much leaving it out could "
        "change: a bound is proven, a trial run measures with few samples. Effects that were switched on or off, and "
        "those that cost no time, are not estimated."
    )
    indent = " " * decision_lines(again.effects)[0].index("why")
    lines = [
        piece
        for line in decision_lines(again.effects)
        for piece in textwrap.wrap(line.replace("`", ""), _LETTERS, subsequent_indent=indent)
    ]
    figure, grid = captioned(13, [_LINE_IN * len(lines) + 0.3], text, f"{stored.title}: effects")
    axes = figure.add_subplot(grid[0])
    axes.set_axis_off()
    axes.text(0.0, 1.0, "\n".join(lines), family="DejaVu Sans Mono", fontsize=7.5, linespacing=1.3, va="top")
    return figure
