"""What the paper says, held against the run: each statement with its verdicts and the numbers behind them.

Nothing here knows the outcome: another room gives other verdicts.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from datagen.paper import measures
from datagen.paper.lookin_balance import LookinBalance
from datagen.paper.measures import PEAK_TOLERANCE_NS, PEAKS_NS, mean_ns, peak_ns, shape_difference
from datagen.paper.runs import SCHEMES, Estimator, Runs, Simulation

WALLS, BOX, PILLAR = PEAKS_NS
MUCH_HIGHER = 3.0
"""A factor in height that counts as "≫"."""
COPY_RESIDUAL = 0.2
"""Relative L2 residual below which one curve counts as a delayed, scaled copy of another."""
SAME_PROFILE = 0.25
"""Relative L2 difference of normalised envelopes below which profiles count as consistent."""
WIDTH_LEVEL = 0.01
MINOR_SHARE = 0.1
"""Secondary over primary energy below which it counts as a minor contribution."""
SAME_LEVEL = 0.1
"""Relative change of a level as printed below which it counts as independent of the sampling."""
STANDARD_ERRORS = 4.0


@dataclass(frozen=True)
class Verdict:
    """holds : None where the room or the run cannot tell. numbers : one line of text."""

    holds: bool | None
    numbers: str


@dataclass(frozen=True)
class Statement:
    """A claim, where the paper makes it, and whether it holds in each estimator."""

    key: str
    claim: str
    source: str
    printed: Verdict
    radiometric: Verdict


def statements_of(runs: Runs, balance: LookinBalance) -> list[Statement]:
    """All statements: on when light arrives, on the optimised scheme and denser sampling, on how much there is."""

    def each(key: str, claim: str, source: str, verdict: Callable[[Simulation], Verdict]) -> Statement:
        """Held against the dense grid as printed, and against the converged radiometric run."""
        return Statement(
            key, claim, source, verdict(runs.case("as printed", runs.dense)), verdict(runs.case("converged"))
        )

    def sampled(key: str, claim: str, source: str, verdict: Callable[[Runs, Estimator], Verdict]) -> Statement:
        """Held against runs of both estimators with the paper's counts."""
        return Statement(key, claim, source, verdict(runs, "as printed"), verdict(runs, "radiometric"))

    detour = balance.least_detour_m
    later = Verdict(
        _decided(detour > 0, detour),
        f"least detour over the straight way, all lookins and observed points: {1e3 * detour:.3g} mm",
    )
    return [
        each(
            "peaks", "Fig. 7 has its peaks at " + ", ".join(f"{t:g} ns ({n})" for n, t in PEAKS_NS.items()),
            f"Fig. 7; within {PEAK_TOLERANCE_NS:g} ns", _peaks,
        ),
        each(
            "order", "The walls, roof and floor return most, then the box, and the pillar far less",
            f"Fig. 7; ≫ taken as {MUCH_HIGHER:g} times", _order,
        ),
        each(
            "pillar", "The pillar's signal arrives with a lower amplitude and a greater delay than the box's",
            "sec. 4", _pillar,
        ),
        Statement(
            "later", "Secondary paths arrive later than the primary paths of their lookin",
            "sec. 4, “Secondly”", later, later,
        ),
        each("later peak", "The secondary's envelope comes after the primary's", "Fig. 7", _delay),
        sampled(
            "strongest", "The strongest path alone keeps the place of the secondary's peak, lower and narrower",
            "sec. 4, Fig. 9", _strongest,
        ),
        sampled(
            "copy", "With Lambertian surfaces the strongest paths make the secondary a time-delayed, lower-amplitude "
            "copy of the primary", f"sec. 4; copy taken as a residual under {100 * COPY_RESIDUAL:g} %", _copy,
        ),
        sampled(
            "smooth", "Denser sampling smooths the envelopes and leaves their profile",
            f"sec. 4, Fig. 7; profile taken as under {100 * SAME_PROFILE:g} % (L2)", _smoother,
        ),
        sampled("broad", "Denser sampling somewhat broadens the envelopes", "sec. 4, Fig. 7", _broader),
        *_of_levels(runs, balance),
        each(
            "extended", "Extended surfaces dominate: the total follows the walls, roof and floor", "sec. 4, Fig. 7",
            _dominated,
        ),
        _shape(runs),
    ]  # fmt: skip


def ratio(numerator: float, denominator: float) -> float:
    """NaN where there is nothing to compare with."""
    return numerator / denominator if denominator > 0 else float("nan")


def _decided(holds: bool, *values: float) -> bool | None:
    """`holds`, or None if a number that it rests on is undefined."""
    return holds if all(math.isfinite(value) for value in values) else None


def _peaks(case: Simulation) -> Verdict:
    found = {n: peak_ns(case.curves.parts[n], case.time_ns) for n in PEAKS_NS if n in case.curves.parts}
    if not found:
        return Verdict(None, "none of these parts is in this room")
    off = {name: peak - PEAKS_NS[name] for name, peak in found.items()}
    text = ", ".join(f"{name} {peak:.1f} ({off[name]:+.1f})" for name, peak in found.items())
    # Peaks fall on bins; a tenth of a bin's rounding is no deviation.
    near = all(abs(d) <= PEAK_TOLERANCE_NS + 0.01 for d in off.values())
    return Verdict(_decided(near, *off.values()), text + " ns")


def _heights(case: Simulation) -> dict[str, float]:
    return {name: float(curve.max()) for name, curve in case.curves.parts.items()}


def _order(case: Simulation) -> Verdict:
    height = _heights(case)
    if not {WALLS, BOX, PILLAR} <= set(height):
        return Verdict(None, "this room has other parts")
    over = [ratio(height[WALLS], height[name]) for name in (BOX, PILLAR)]
    return Verdict(
        height[WALLS] > height[BOX] > MUCH_HIGHER * height[PILLAR],
        f"walls : box : pillar = 1 : 1/{over[0]:.2g} : 1/{over[1]:.2g}",
    )


def _pillar(case: Simulation) -> Verdict:
    parts, height = case.curves.parts, _heights(case)
    if not {BOX, PILLAR} <= set(height):
        return Verdict(None, "this room has no box and pillar")
    box, pillar = (peak_ns(parts[name], case.time_ns) for name in (BOX, PILLAR))
    holds = _decided(height[PILLAR] < height[BOX] and pillar > box, box, pillar)
    return Verdict(holds, f"{pillar - box:.1f} ns later, {ratio(height[PILLAR], height[BOX]):.2g} of its height")


def _delay(case: Simulation) -> Verdict:
    (p, s), (mean_p, mean_s) = (
        [measure(curve, case.time_ns) for curve in (case.primary, case.secondary)] for measure in (peak_ns, mean_ns)
    )
    return Verdict(
        _decided(s > p and mean_s > mean_p, p, s, mean_p, mean_s),
        f"peaks {p:.1f} → {s:.1f} ns, mean arrival {mean_p:.1f} → {mean_s:.1f} ns",
    )


def _strongest(runs: Runs, estimator: Estimator) -> Verdict:
    full, one = (runs.case(estimator, runs.dense, scheme) for scheme in SCHEMES)
    a, b = (peak_ns(case.secondary, case.time_ns) for case in (full, one))
    height = ratio(float(one.secondary.max()), float(full.secondary.max()))
    widths = [measures.width_ns(case.secondary, case.time_ns, WIDTH_LEVEL) for case in (full, one)]
    kept = ratio(one.level["secondary"], full.level["secondary"])
    return Verdict(
        _decided(abs(a - b) <= PEAK_TOLERANCE_NS and height < 1 and widths[1] <= widths[0], a, b, height, *widths),
        f"peak {a:.1f} → {b:.1f} ns; height × {height:.2g}, energy × {kept:.2g}; width at {100 * WIDTH_LEVEL:g} % "
        f"{widths[0]:.1f} → {widths[1]:.1f} ns",
    )


def _copy(runs: Runs, estimator: Estimator) -> Verdict:
    full, one = (runs.case(estimator, runs.dense, scheme) for scheme in SCHEMES)
    time = one.time_ns
    delay, scale, residual = measures.best_copy(one.primary, one.secondary)
    step = float(time[1] - time[0]) if len(time) > 1 else float("nan")
    peaks = (peak_ns(case.secondary, time) for case in (full, one))
    return Verdict(
        _decided(residual <= COPY_RESIDUAL and delay > 0, *peaks),
        f"best fit: delayed by {delay * step:.1f} ns, times {scale:.2g}, residual {100 * residual:.0f} % (L2)",
    )


def _smoother(runs: Runs, estimator: Estimator) -> Verdict:
    total = [runs.case(estimator, rays).total for rays in runs.sizes.rays]
    rough = [measures.roughness(curve) for curve in total]
    change = shape_difference(total[0], total[1])
    return Verdict(
        _decided(rough[1] < rough[0] and change < SAME_PROFILE, *rough, change),
        f"roughness {rough[0]:.3g} → {rough[1]:.3g}; profiles differ by {100 * change:.0f} % (L2)",
    )


def _broader(runs: Runs, estimator: Estimator) -> Verdict:
    cases = [runs.case(estimator, rays) for rays in runs.sizes.rays]
    broad = [measures.width_ns(case.total, case.time_ns, WIDTH_LEVEL) for case in cases]
    return Verdict(
        _decided(broad[1] > broad[0], *broad),
        f"width at {100 * WIDTH_LEVEL:g} % of the peak {broad[0]:.1f} → {broad[1]:.1f} ns",
    )


def _of_levels(runs: Runs, balance: LookinBalance) -> list[Statement]:
    """How much light there is, and on what that depends."""
    printed, converged = runs.case("as printed", runs.dense), runs.case("converged")
    sparse, metres = runs.case("as printed", runs.sparse), runs.in_metres[runs.sparse]
    unit, ratio_unit = ratio(metres.level["primary"], sparse.level["primary"]), ratio(metres.ratio, sparse.ratio)
    from_ns = measures.exceeds_from_ns(converged.secondary, converged.primary, runs.time_ns)
    overtakes = f"; above the primary from {from_ns:.0f} ns on" if math.isfinite(from_ns) else ""
    strongest, every = _highest(balance.strongest), _highest(balance.every)
    once, again = runs.rescaled
    primary = ratio(again.primary, once.primary)
    both = ratio(ratio(again.secondary, again.primary), ratio(once.secondary, once.primary))
    return [
        Statement(
            "minor", "Secondary paths make only a minor contribution to the total",
            f"sec. 4, Fig. 7; taken as under {100 * MINOR_SHARE:g} % of the primary",
            Verdict(
                _decided(printed.ratio < MINOR_SHARE, printed.ratio),
                f"secondary / primary = {printed.ratio:.2g} in mm, {printed.ratio * ratio_unit:.2g} in m",
            ),
            Verdict(
                _decided(converged.ratio < MINOR_SHARE, converged.ratio),
                f"secondary / primary = {converged.ratio:.3g}{overtakes}",
            ),
        ),
        Statement(
            "less", "The contribution of a secondary path is always less than that of a primary path",
            "sec. 4, “Firstly”",
            Verdict(
                _decided(strongest * max(1.0, ratio_unit) < 1, strongest, ratio_unit),
                f"strongest path over primary on its way into a lookin, at most: {strongest:.2g} in mm, "
                f"{strongest * ratio_unit:.2g} in m; all paths together {every:.2g} and {every * ratio_unit:.2g}",
            ),
            _irradiance(balance),
        ),
        Statement(
            "unit", "The aperture term renders L(t) unitless", "sec. 3.2",
            Verdict(
                _decided(abs(unit - 1) < 1e-6, unit),
                f"with metres in place of millimetres L_p changes {unit:.3g}-fold; Eq. 6 has the unit length⁻⁴",
            ),
            Verdict(
                _decided(abs(primary - 1) < 1e-3, primary),
                f"all lengths × 1000, the aperture's too: primary × {primary:.6f}",
            ),
        ),
        Statement(
            "ratio unit", "The secondary's weight is a property of the room (implied)", "Eq. 8 adds L_s to L_p",
            Verdict(
                _decided(abs(ratio_unit - 1) < 1e-6, ratio_unit),
                f"L_s / L_p changes {ratio_unit:.3g}-fold between mm and m: its unit is 1/length²",
            ),
            Verdict(
                _decided(abs(both - 1) < 1e-3, both), f"all lengths × 1000: secondary / primary × {both:.6f}"
            ),
        ),
        Statement(
            "independence", "The level does not depend on how many rays sample the room (implied)", "Eq. 6, 8",
            *_independence(runs),
        ),
    ]  # fmt: skip


def _highest(values: NDArray[np.float64]) -> float:
    return float(np.max(values[np.isfinite(values)], initial=0.0)) if np.isfinite(values).any() else float("nan")


def _irradiance(balance: LookinBalance) -> Verdict:
    if balance.irradiance is None or not np.isfinite(balance.irradiance).any():
        return Verdict(None, "computed for Lambertian rooms only")
    share = balance.irradiance[np.isfinite(balance.irradiance)]
    brighter = float((share > 1).mean())
    return Verdict(
        brighter == 0,
        f"indirect over direct irradiance of a lookin: median {np.median(share):.2g}, at most {share.max():.2g}; "
        f"above 1 at {100 * brighter:.0f} % of lookins",
    )


def _independence(runs: Runs) -> tuple[Verdict, Verdict]:
    """Over the two grids and the sweep as printed, and over the seeds of the radiometric runs."""
    a, b = runs.sizes.rays
    few, many = (runs.radiometric_levels[rays] for rays in (a, b))
    change, spread, away = dict[str, float](), dict[str, float](), list[float]()
    for name in ("primary", "secondary"):
        change[name] = ratio(*(runs.case("as printed", rays).level[name] for rays in (b, a)))
        swept = [getattr(level, name) for level in runs.sweep.values()]
        spread[name] = ratio(max(swept), min(swept))
        error = math.hypot(getattr(few, f"{name}_error"), getattr(many, f"{name}_error"))
        away.append(ratio(getattr(many, name) - getattr(few, name), error))
    steady = max(abs(c - 1) for c in change.values()) < SAME_LEVEL and max(spread.values()) < 1 + SAME_LEVEL
    printed = Verdict(
        _decided(steady, *change.values(), *spread.values()),
        f"from {a}×{a} to {b}×{b} rays the primary changes by {100 * (change['primary'] - 1):+.1f} %, the secondary "
        f"{change['secondary']:.2f}-fold; over {', '.join(map(str, runs.sweep))} rays a side the highest is "
        f"{spread['primary']:.2f} and {spread['secondary']:.3g} times the lowest",
    )
    return printed, Verdict(
        _decided(all(abs(d) < STANDARD_ERRORS for d in away), *away),
        f"primary {few.primary:.4g} ± {few.primary_error:.1g} and {many.primary:.4g} ± {many.primary_error:.1g}, "
        f"secondary {few.secondary:.4g} ± {few.secondary_error:.1g} and {many.secondary:.4g} ± "
        f"{many.secondary_error:.1g} ({runs.sizes.seeds} seeds)",
    )


def _dominated(case: Simulation) -> Verdict:
    level = {name: float(curve.sum()) for name, curve in case.curves.parts.items()}
    walls = max((n for n in level if n not in (BOX, PILLAR)), key=lambda n: level[n], default=None)
    total = float(case.curves.total.sum())
    if walls is None or total <= 0:
        return Verdict(None, "this room has no extended surfaces")
    share, height = level[walls] / total, float(case.curves.parts[walls].max() / case.curves.total.max())
    return Verdict(share > 0.5, f"{100 * share:.0f} % of all light, {100 * height:.0f} % of the total's peak")


def _shape(runs: Runs) -> Statement:
    printed, converged = runs.case("as printed", runs.dense), runs.case("converged")
    shape = shape_difference(printed.primary, converged.primary)
    own = shape_difference(runs.case("radiometric", runs.dense).primary, converged.primary)
    mean, true_mean = (mean_ns(case.primary, runs.time_ns) for case in (printed, converged))
    return Statement(
        "shape",
        "The primary's envelope is that of the room (implied)",
        f"Eq. 6; taken as under {100 * SAME_PROFILE:g} % (L2) from the converged one",
        Verdict(
            _decided(shape < SAME_PROFILE, shape),
            f"differs from the radiometric one by {100 * shape:.0f} % (L2, equal areas); mean arrival {mean:.1f} ns "
            f"where it should be {true_mean:.1f} ns",
        ),
        Verdict(
            _decided(own < SAME_PROFILE, own),
            f"at the same counts {100 * own:.0f} % from the converged one, whose standard error is "
            f"{100 * converged.relative_error:.2g} % (L2 over bins of {runs.capture.time.width_s * 1e12:g} ps)",
        ),
    )
