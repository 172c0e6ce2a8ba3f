"""What `datagen bench accuracy` tells: a table, a picture, and what to choose."""

from __future__ import annotations

import math
import statistics
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from datagen.bench.accuracy_measure import Row
from datagen.bench.accuracy_settings import ALL_LOOKINS
from datagen.report.style import INK, house_style, new_figure, save_png

if TYPE_CHECKING:
    from matplotlib.axes import Axes

GOALS = (0.10, 0.05, 0.02, 0.01)
_LOOKS = {
    "lookins": ("#000000", "o"),
    "FoV points": ("#009E73", "^"),
    "observed points": ("#0072B2", "s"),
    "k strongest paths": ("#CC79A7", "P"),
    "estimator": ("#777777", "D"),
    "bin width": ("#56B4E9", "<"),
    "target": ("#D55E00", "v"),
    ALL_LOOKINS: ("#000000", "o"),
    "bounce orders": ("#E69F00", "X"),
}
"""Colour and marker of each swept quantity."""


def table(rows: Sequence[Row]) -> str:
    """Markdown, a row for each setting; the Pareto front is marked by ●."""
    lines = [
        "| swept | value | processor s | error | of it noise | of it bias | front |",
        "|---|---|---:|---:|---:|---:|:-:|",
    ]
    for row in rows:
        error = percent(row.error) + (" (scaled)" if row.scaled else "")
        if row.together is not None:
            error += f" (in the widest bins {percent(row.together)})"
        cells = [row.quantity, row.value, f"{row.seconds:.3g}", error, _share(row.noise), _share(row.bias)]
        lines.append(f"| {' | '.join(cells)} | {'●' if row.front else ''} |")
    return "\n".join(lines)


def _share(value: float) -> str:
    return "?" if math.isnan(value) else percent(value) if value > 0 else "–"


def percent(share: float) -> str:
    """`12 %`, `3.4 %`, `0.56 %`."""
    return f"{100 * share:.0f} %" if share >= 0.0995 else f"{100 * share:.2g} %"


def advice(rows: Sequence[Row]) -> list[str]:
    """What to choose, computed: the cheapest setting for each goal, and where a bias sets the floor."""
    return [
        f"What to choose for {light_of(rows)} (processor seconds a scene, error found):",
        "",
        *(_for_goal(rows, goal) for goal in GOALS),
        *_floors(rows),
    ]


def light_of(rows: Sequence[Row]) -> str:
    """The light that most sweeps have as their truth, in words."""
    orders = {row.config.rpartition("max_bounces: ")[2].split(",")[0] for row in rows if row.quantity == "lookins"}
    return "light of all bounces" if orders in (set(), {"null"}) else f"light of up to {orders.pop()} bounces"


def _for_goal(rows: Sequence[Row], goal: float) -> str:
    fixed = [row for row in rows if row.config and not row.complete and row.quantity != "target"]
    enough = [row for row in fixed if row.error <= goal]
    if enough:
        best = min(enough, key=lambda row: row.seconds)
        text = f"- {percent(goal)}: `{best.config}`, {best.seconds:.2g} s ({percent(best.error)})"
    else:
        text = f"- {percent(goal)}: no fixed setting of these; {_extrapolated(fixed, goal)}"
    told = [row for row in rows if row.quantity == "target" and row.value == f"{goal:g}" and row.error <= goal]
    if not told:
        return text
    return (
        f"{text}; or leave the choice to it, `{told[0].config}`, {told[0].seconds:.2g} s ({percent(told[0].error)})"
    )


def _extrapolated(rows: Sequence[Row], goal: float) -> str:
    sweep = [row for row in rows if row.quantity == "lookins" and row.error > 0]
    if len(sweep) < 2 or sweep[-1].error >= sweep[-2].error:
        return "more lookins do not lead there"
    low, high = sweep[-2:]
    power = math.log(low.error / high.error) / math.log(float(high.value) / float(low.value))
    times = (high.error / goal) ** (1 / power)
    return f"by the trend about {float(high.value) * times:.2g} lookins, {high.seconds * times:.2g} s"


def _floors(rows: Sequence[Row]) -> Iterator[str]:
    """What no number of samples mends."""
    orders = [row for row in rows if row.quantity == "bounce orders" and row.value != "all" and row.bias > 0]
    if orders:
        told = ", ".join(f"≤ {row.value.removeprefix('≤ ')} bounces {percent(row.bias)}" for row in orders)
        yield (
            f"- Of the light of all bounces is left out, however many samples are taken: {told}. "
            f"All bounces cost {_all_bounces(rows)}."
        )
    few = [row for row in rows if row.quantity == "k strongest paths" and row.bias > 0]
    if few:
        told = ", ".join(f"k = {row.value} {percent(row.bias)}" for row in few)
        yield f"- Keeping the k strongest secondary paths of each lookin is a floor, too: {told}."
    printed = [row for row in rows if row.scaled]
    if printed:
        best = min(printed, key=lambda row: row.error)
        yield (
            "- The estimator as printed has a level that means nothing; scaled to fit as well as can be, its shape "
            f"is off by {percent(best.error)} ({best.value.removeprefix('as printed ')}, {best.seconds:.2g} s)."
        )
    widths = [row for row in rows if row.quantity == "bin width" and row.together is not None]
    if len(widths) > 1:
        wide, narrow = widths[0], widths[-1]
        yield (
            f"- Bin width: error {percent(wide.error)} in bins {wide.value}, {percent(narrow.error)} in bins "
            f"{narrow.value}, at {wide.seconds:.2g} and {narrow.seconds:.2g} s; narrow ones added up to the widest "
            f"have {percent(narrow.together or 0.0)}."
        )


def _all_bounces(rows: Sequence[Row]) -> str:
    """Seconds of all bounces over those of the base setting's, at the same lookins."""
    own = {row.value: row.seconds for row in rows if row.quantity == "lookins"}
    ratios = [row.seconds / own[row.value] for row in rows if row.quantity == ALL_LOOKINS and row.value in own]
    return f"{statistics.median(ratios):.2g} times as much time as {light_of(rows)}" if ratios else "more"


def picture(rows: Sequence[Row], title: str, path: Path) -> Path:
    """Error against seconds, one colour for each swept quantity, the Pareto front as a line; and the floors."""
    with house_style():
        figure = new_figure(13.0, 5.6)
        left, middle, right = figure.subplots(1, 3, width_ratios=(2.2, 1.3, 1.1))
        own = [row for row in rows if not row.complete]
        every = [row for row in rows if row.complete]
        _cost(left, own, f"Error against cost: {light_of(rows)}")
        _cost(middle, every, "… of all bounces")
        limits = [axes.get_ylim() for axes in (left, middle)]
        for axes in (left, middle):
            axes.set_ylim(min(low for low, _ in limits), max(high for _, high in limits))
        _bias(right, rows)
        figure.suptitle(title, fontsize=10, color=INK)
        return save_png(figure, path)


def _cost(axes: Axes, rows: Sequence[Row], title: str) -> None:
    shown = [row for row in rows if row.error > 0]
    front = sorted((row for row in shown if row.front), key=lambda row: row.seconds)
    axes.plot(
        [row.seconds for row in front], [row.error for row in front], color="#F0C000", lw=7, alpha=0.45, zorder=0,
        solid_capstyle="round", label="Pareto front",
    )  # fmt: skip
    for quantity in dict.fromkeys(row.quantity for row in shown):
        color, marker = _LOOKS[quantity]
        points = [row for row in shown if row.quantity == quantity and not row.scaled]
        axes.plot(
            [row.seconds for row in points], [row.error for row in points], color=color, marker=marker, ms=5.5,
            lw=1.0, ls="none" if quantity == "estimator" else "-", alpha=0.9, label=quantity,
        )  # fmt: skip
        for row in (points[0], points[-1]) if len(points) > 1 else points:
            axes.annotate(
                row.value,
                (row.seconds, row.error),
                xytext=(5, 4),
                textcoords="offset points",
                fontsize=6.5,
                color=color,
            )
    scaled = [row for row in shown if row.scaled]
    if scaled:
        axes.plot(
            [row.seconds for row in scaled], [row.error for row in scaled], "x", color="#777777", ms=6,
            label="as printed, best scaled",
        )  # fmt: skip
    for goal in GOALS:
        axes.axhline(goal, color="#BBBBBB", lw=0.6, zorder=0)
    axes.set(xscale="log", yscale="log", xlabel="processor seconds a scene", ylabel="relative L2 error")
    _percent_axis(axes)
    axes.set_title(title)
    axes.legend(loc="lower left", fontsize=7)
    low, high = axes.get_ylim()
    axes.set_ylim(low / 3, high * 1.5)
    first, last = axes.get_xlim()
    axes.set_xlim(first / 1.5, last * 1.8)


def _bias(axes: Axes, rows: Sequence[Row]) -> None:
    """Bars: what is left out however many samples are taken."""
    shown = [row for row in rows if row.quantity in ("bounce orders", "k strongest paths") and row.value != "all"]
    labels = [
        f"{'max_bounces' if row.quantity == 'bounce orders' else 'k ='} {row.value.removeprefix('≤ ')}"
        for row in shown
    ]
    colors = [_LOOKS[row.quantity][0] for row in shown]
    places = range(len(shown))
    known = [row.bias if row.bias > 0 else 0.0 for row in shown]
    axes.barh(places, known, color=colors, height=0.7)
    for place, row in zip(places, shown, strict=True):
        text = f" {percent(row.bias)}" if row.bias > 0 else " hidden by the noise"
        axes.text(
            max(row.bias, 0.0) if row.bias > 0 else 0.0, place, text, va="center", fontsize=7.5, color="#444444"
        )
    axes.set_yticks(places, labels)
    axes.invert_yaxis()
    axes.set_xlim(0, 1.35 * max([*known, 0.01]))
    axes.xaxis.set_major_formatter(lambda value, _: f"{100 * value:.0f} %")
    axes.set_xlabel("relative L2 (k: of the left panel's light)")
    axes.set_title("Floors: light left out")


def _percent_axis(axes: Axes) -> None:
    from matplotlib.ticker import LogLocator, NullFormatter

    axes.yaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0), numticks=30))
    axes.yaxis.set_major_formatter(lambda value, _: percent(value))
    axes.yaxis.set_minor_formatter(NullFormatter())
    axes.xaxis.set_major_formatter(lambda value, _: f"{value:g}")
