"""Fig. 7 and 9 of the paper: envelopes by part of the room, two densities side by side, for both estimators."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from datagen.detector import detector_for
from datagen.detector.irf import FWHM_PER_SIGMA
from datagen.paper.envelopes import SECONDARY, TIME_LABEL, Curve, colors_of, curve_window
from datagen.paper.measures import PEAKS_NS
from datagen.paper.runs import Estimator, Runs, Scheme, Simulation
from datagen.report.style import captioned, house_style

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_WIDTH_IN = 12.0
_ROWS: tuple[Estimator, ...] = ("as printed", "radiometric")
_LABELS: dict[Estimator, str] = {
    "as printed": "L(t) per bin (as printed, mm⁻⁴)",
    "radiometric": "L(t) per bin (per emitted photon)",
}
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
    window = curve_window(case("converged").curves)
    with house_style():
        figure, grid = captioned(_WIDTH_IN, [4.6, 4.6], text, columns=2)
        for row, estimator in enumerate(_ROWS):
            cases = {rays: case(estimator, rays, scheme) for rays in sizes.rays}
            limits = _limits([curve for one in cases.values() for curve in _curves(one).values()])
            for column, (rays, one) in enumerate(cases.items()):
                axes = figure.add_subplot(grid[row, column])
                if estimator == "radiometric":
                    _draw(axes, case("converged"), thin=True)
                _draw(axes, one)
                colors = colors_of(one.curves)
                for name in colors.keys() & PEAKS_NS.keys():
                    axes.axvline(PEAKS_NS[name], color=colors[name], linewidth=0.9, linestyle=":", zorder=0)
                title = f"{estimator}, {rays} × {rays} × {sizes.pixels} × {sizes.pixels}"
                axes.set(title=title, yscale="log", ylim=limits, xlim=window, xlabel=TIME_LABEL)
                axes.set_ylabel("" if column else _LABELS[estimator])
                axes.grid(color="#E8E8E8", linewidth=0.6)
                if (row, column) == (0, 1):
                    axes.legend(loc="upper right")
    return figure


def sigma_ps(runs: Runs) -> float:
    """Standard deviation of laser pulse and jitter together, as the envelopes are convolved with."""
    spad, exposure = detector_for(runs.config.detector, runs.config.seed, 0, runs.capture.time)
    return float(np.hypot(exposure.pulse_fwhm_s, spad.jitter_fwhm_s) / FWHM_PER_SIGMA * 1e12)


def _curves(case: Simulation) -> dict[str, Curve]:
    return {"total": case.total, **case.curves.parts, "secondary bounce": case.secondary}


def _draw(axes: Axes, case: Simulation, thin: bool = False) -> None:
    colors = {"total": "black", "secondary bounce": SECONDARY} | colors_of(case.curves)
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


def _limits(curves: list[Curve]) -> tuple[float, float]:
    peaks = [float(curve.max()) for curve in curves if curve.any()]
    if not peaks:
        return 1e-3, 1.0
    return max(min(peaks) / _MARGIN_BELOW, max(peaks) * 10.0**-_MOST_DECADES), 4.0 * max(peaks)
