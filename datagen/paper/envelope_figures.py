"""Fig. 7 and 9 of the paper: envelopes by part of the room, two densities side by side, for both estimators."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from datagen.detector import detector_for
from datagen.detector.irf import FWHM_PER_SIGMA
from datagen.paper.measures import Curve
from datagen.paper.published import BOX, PEAKS_NS, PILLAR, ROOM, SECONDARY, TOTAL
from datagen.paper.runs import Case, Estimator, Runs, Scheme
from datagen.records import TimeAxis
from datagen.report.style import caption, caption_height, house_style, new_figure
from datagen.report.transient_plots import busy_window

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_WIDTH_IN = 12.0
_ROWS: tuple[Estimator, ...] = ("as printed", "radiometric")
_LABELS: dict[Estimator, str] = {
    "as printed": "L(t) per bin (as printed, mm⁻⁴)",
    "radiometric": "L(t) per bin (per emitted photon)",
}
_OTHER_COLORS = ("#1B9E77", "#C51B7D", "#8C6D31", "#35978F")
_MARGIN_BELOW = 100.0
"""The axis ends this factor below the lowest peak shown."""
_MOST_DECADES = 12.0


def envelope_figure(runs: Runs, scheme: Scheme, number: str) -> Figure:
    """Two rows (as printed; radiometric) by two columns (sparse, dense), logarithmic."""
    sizes, case = runs.sizes, runs.case
    what = "all secondary paths" if scheme == "all" else "the strongest secondary path of each lookin"
    text = (
        f"As Fig. {number} of Scholes & Leach (2024), with {what}: the likelihood envelope L(t) (black), and what of "
        "it comes by walls, roof and floor (blue, dashed), box (purple), pillar (orange), secondary bounce (red). "
        "Above: Eq. 6 and 8 as printed, lengths in millimetres. Below: radiometric weights with as many lookins, "
        "observed points and FoV points, over the converged result of all paths (thin, pale). Dotted lines: where "
        f"the paper's Fig. 7 has its peaks. A bin is {runs.capture.time.width_s * 1e12:g} ps wide; σ = "
        f"{sigma_ps(runs):.0f} ps."
    )
    titled = {
        estimator: [
            (f"{estimator}, {rays} × {rays} × {sizes.pixels} × {sizes.pixels}", case(estimator, rays, scheme))
            for rays in sizes.rays
        ]
        for estimator in _ROWS
    }
    height = caption_height(_WIDTH_IN, text)
    with house_style():
        figure = new_figure(_WIDTH_IN, 9.2 + height)
        grid = figure.add_gridspec(3, 2, height_ratios=[4.6, 4.6, height])
        for row, (estimator, cases) in enumerate(titled.items()):
            limits = _limits([curve for _, one in cases for curve in _curves(one).values()])
            for column, (title, one) in enumerate(cases):
                axes = figure.add_subplot(grid[row, column])
                if estimator == "radiometric":
                    _draw(axes, case("converged"), thin=True)
                _panel(axes, title, one, limits, _time_limits(case("converged")))
                if column == 0:
                    axes.set_ylabel(_LABELS[estimator])
                if (row, column) == (0, 1):
                    axes.legend(loc="upper right")
        caption(figure, figure.add_subplot(grid[2, :]), text)
    return figure


def other_room_figure(runs: Runs) -> Figure:
    """Fig. 7 once more, in the room laid out for the printed weights: as printed beside radiometric (converged)."""
    text = (
        "As the paper's Fig. 7, in the second room: its sizes are chosen so that the printed weights, left, have the "
        "published peaks (dotted); right, the same room by radiometric weights, converged. Colours as in Fig. 7."
    )
    printed, converged = runs.laid_out[runs.dense], runs.laid_out[0]
    height = caption_height(_WIDTH_IN, text)
    with house_style():
        figure = new_figure(_WIDTH_IN, 4.8 + height)
        grid = figure.add_gridspec(2, 2, height_ratios=[4.8, height])
        for column, (estimator, one) in enumerate(zip(_ROWS, (printed, converged), strict=True)):
            axes = figure.add_subplot(grid[0, column])
            counts = f"{runs.dense} × {runs.dense} × {runs.sizes.pixels} × {runs.sizes.pixels}"
            title = f"as printed, {counts}" if column == 0 else "radiometric, converged"
            _panel(axes, title, one, _limits(list(_curves(one).values())), _time_limits(converged))
            axes.set_ylabel(_LABELS[estimator])
            if column:
                axes.legend(loc="upper right")
        caption(figure, figure.add_subplot(grid[1, :]), text)
    return figure


def _panel(axes: Axes, title: str, case: Case, limits: tuple[float, float], time_limits: tuple[float, float]) -> None:
    _draw(axes, case)
    _mark_peaks(axes, case)
    axes.set_title(title)
    axes.set_yscale("log")
    axes.set_ylim(*limits)
    axes.set_xlim(*time_limits)
    axes.set_xlabel("time since the light reached the laser point (ns)")
    axes.grid(color="#E8E8E8", linewidth=0.6)


def sigma_ps(runs: Runs) -> float:
    """Standard deviation of laser pulse and jitter together, as the envelopes are convolved with."""
    spad, exposure = detector_for(runs.config.detector, runs.config.seed, 0, runs.capture.time)
    return float(np.hypot(exposure.pulse_fwhm_s, spad.jitter_fwhm_s) / FWHM_PER_SIGMA * 1e12)


def colors_of(case: Case) -> dict[str, str]:
    """Curve name → colour: the first part is the room, box and pillar as in the paper, others from a palette."""
    colors, spare = {"total": TOTAL, "secondary bounce": SECONDARY}, 0
    for place, name in enumerate(case.curves.parts):
        if name in ("box", "pillar"):
            colors[name] = BOX if name == "box" else PILLAR
        elif place == 0:
            colors[name] = ROOM
        else:
            colors[name] = _OTHER_COLORS[spare % len(_OTHER_COLORS)]
            spare += 1
    return colors


def _curves(case: Case) -> dict[str, Curve]:
    return {"total": case.primary + case.secondary, **case.curves.parts, "secondary bounce": case.secondary}


def _draw(axes: Axes, case: Case, thin: bool = False) -> None:
    colors = colors_of(case)
    for place, (name, curve) in enumerate(_curves(case).items()):
        if not curve.any():
            continue
        width = 0.8 if thin else 2.4 if name == "total" else 1.4
        # The blue lies on the black where the room makes the total: dashed, as in the paper.
        line = (0, (4, 2)) if place == 1 and not thin else "-"
        axes.plot(
            case.curves.time_ns, np.where(curve > 0, curve, np.nan), color=colors[name], linewidth=width,
            linestyle=line, alpha=0.45 if thin else 1.0, label=None if thin else name.replace("_", " "),
        )  # fmt: skip


def _mark_peaks(axes: Axes, case: Case) -> None:
    for name, time in PEAKS_NS.items():
        if name in case.curves.parts:
            axes.axvline(time, color=colors_of(case)[name], linewidth=0.9, linestyle=":", zorder=0)


def _limits(curves: list[Curve]) -> tuple[float, float]:
    peaks = [float(curve.max()) for curve in curves if curve.any()]
    if not peaks:
        return 1e-3, 1.0
    return max(min(peaks) / _MARGIN_BELOW, max(peaks) * 10.0**-_MOST_DECADES), 4.0 * max(peaks)


def _time_limits(case: Case) -> tuple[float, float]:
    time = case.curves.time_ns
    step = float(time[1] - time[0]) if len(time) > 1 else 1.0
    axis = TimeAxis(len(time), step * 1e-9, float(time[0] - step / 2) * 1e-9)
    return busy_window(case.curves.total, axis)
