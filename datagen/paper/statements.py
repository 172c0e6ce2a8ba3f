"""What the paper says, held against the run: each statement with its verdicts and the numbers behind them.

Nothing here knows the outcome: another room gives other verdicts.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field

from datagen.paper.lookin_balance import LookinBalance
from datagen.paper.measures import (
    PEAK_TOLERANCE_NS,
    PEAKS_NS,
    Curve,
    best_copy,
    mean_ns,
    peak_ns,
    roughness,
    shape_difference,
    width_ns,
)
from datagen.paper.runs import Estimator, Runs, Simulation

WALLS, BOX, PILLAR = PEAKS_NS
MUCH_HIGHER = 3.0
"""A factor in height that counts as "≫"."""
COPY_RESIDUAL = 0.2
"""Relative L2 residual below which one curve counts as a delayed, scaled copy of another."""
SAME_PROFILE = 0.25
"""Relative L2 difference of normalised envelopes below which profiles count as consistent."""
WIDTH_LEVEL = 0.01


@dataclass(frozen=True)
class Verdict:
    """holds : None where the room or the run cannot tell. numbers : one line of text."""

    holds: bool | None
    numbers: str


@dataclass(frozen=True)
class Statement:
    """A claim, where the paper makes it, and whether it holds in each estimator. values : the numbers by name."""

    key: str
    claim: str
    source: str
    printed: Verdict
    radiometric: Verdict
    values: Mapping[str, float] = field(default_factory=dict)


def decided(holds: bool, *values: float) -> bool | None:
    """`holds`, or None if a number that it rests on is undefined."""
    return holds if all(math.isfinite(value) for value in values) else None


def ratio(numerator: float, denominator: float) -> float:
    """NaN where there is nothing to compare with."""
    return numerator / denominator if denominator > 0 else float("nan")


def arrival_statements(runs: Runs, balance: LookinBalance) -> list[Statement]:
    """Statements on when light arrives: peaks, their order, the secondary's delay."""
    printed, converged = runs.case("as printed", runs.dense), runs.case("converged")
    time = runs.time_ns
    later = {
        name: (peak_ns(c.primary, time), peak_ns(c.secondary, time), mean_ns(c.primary, time),
               mean_ns(c.secondary, time))
        for name, c in (("printed", printed), ("converged", converged))
    }  # fmt: skip

    def delay(name: str) -> Verdict:
        p, s, mean_p, mean_s = later[name]
        holds = decided(s > p and mean_s > mean_p, *later[name])
        text = f"peaks {p:.1f} → {s:.1f} ns, mean arrival {mean_p:.1f} → {mean_s:.1f} ns"
        return Verdict(holds, text)

    detour = balance.least_detour_m
    each = Verdict(
        None if math.isnan(detour) else detour > 0,
        f"least detour over the straight way, all lookins and observed points: {1e3 * detour:.3g} mm",
    )
    return [
        Statement(
            "peaks", "Fig. 7 has its peaks at " + ", ".join(f"{t:g} ns ({n})" for n, t in PEAKS_NS.items()),
            f"Fig. 7; within {PEAK_TOLERANCE_NS:g} ns", _peaks(printed, time), _peaks(converged, time),
            {f"{who} {name}": peak_ns(curve, time) for who, case in (("printed", printed), ("radiometric", converged))
             for name, curve in case.curves.parts.items()},
        ),
        Statement(
            "order", "The walls, roof and floor return most, then the box, and the pillar far less",
            f"Fig. 7; ≫ taken as {MUCH_HIGHER:g} times", _order(printed), _order(converged),
        ),
        Statement(
            "pillar", "The pillar's signal arrives with a lower amplitude and a greater delay than the box's",
            "sec. 4", _pillar(printed, time), _pillar(converged, time),
        ),
        Statement(
            "later", "Secondary paths arrive later than the primary paths of their lookin",
            "sec. 4, “Secondly”", each, each, {"least detour, m": detour},
        ),
        Statement(
            "later peak", "The secondary's envelope comes after the primary's", "Fig. 7", delay("printed"),
            delay("converged"),
            {f"{who} {what}": value for who, row in later.items()
             for what, value in zip(("primary peak", "secondary peak", "primary mean", "secondary mean"), row,
                                    strict=True)},
        ),
    ]  # fmt: skip


def scheme_statements(runs: Runs) -> list[Statement]:
    """Statements on the optimised scheme and on denser sampling."""
    time = runs.time_ns

    def strongest(estimator: Estimator) -> tuple[Verdict, Verdict, dict[str, float]]:
        full, one = runs.case(estimator, runs.dense), runs.case(estimator, runs.dense, "strongest")
        a, b = peak_ns(full.secondary, time), peak_ns(one.secondary, time)
        height = ratio(float(one.secondary.max()), float(full.secondary.max()))
        widths = [width_ns(c.secondary, time, WIDTH_LEVEL) for c in (full, one)]
        kept = ratio(one.level["secondary"], full.level["secondary"])
        place = Verdict(
            decided(abs(a - b) <= PEAK_TOLERANCE_NS and height < 1 and widths[1] <= widths[0], a, b, height, *widths),
            f"peak {a:.1f} → {b:.1f} ns; height × {height:.2g}, energy × {kept:.2g}; width at "
            f"{100 * WIDTH_LEVEL:g} % {widths[0]:.1f} → {widths[1]:.1f} ns",
        )
        delay, scale, residual = best_copy(one.primary, one.secondary)
        step = float(time[1] - time[0]) if len(time) > 1 else float("nan")
        copy = Verdict(
            decided(residual <= COPY_RESIDUAL and delay > 0, a, b),
            f"best fit: delayed by {delay * step:.1f} ns, times {scale:.2g}, residual {100 * residual:.0f} % (L2)",
        )
        values = {
            f"{estimator} peak, all": a, f"{estimator} peak, strongest": b, f"{estimator} height": height,
            f"{estimator} energy kept": kept, f"{estimator} copy residual": residual,
        }  # fmt: skip
        return place, copy, values

    place_p, copy_p, values_p = strongest("as printed")
    place_r, copy_r, values_r = strongest("radiometric")
    return [
        Statement(
            "strongest", "The strongest path alone keeps the place of the secondary's peak, lower and narrower",
            "sec. 4, Fig. 9", place_p, place_r, values_p | values_r,
        ),
        Statement(
            "copy", "With Lambertian surfaces the strongest paths make the secondary a time-delayed, lower-amplitude "
            "copy of the primary",
            f"sec. 4; copy taken as a residual under {100 * COPY_RESIDUAL:g} %", copy_p, copy_r,
        ),
        Statement(
            "smooth", "Denser sampling smooths the envelopes and leaves their profile",
            f"sec. 4, Fig. 7; profile taken as under {100 * SAME_PROFILE:g} % (L2)", _smoother(runs, "as printed"),
            _smoother(runs, "radiometric"),
        ),
        Statement(
            "broad", "Denser sampling somewhat broadens the envelopes", "sec. 4, Fig. 7",
            _broader(runs, "as printed"), _broader(runs, "radiometric"),
        ),
    ]  # fmt: skip


def _peaks(case: Simulation, time: Curve) -> Verdict:
    found = {n: peak_ns(case.curves.parts[n], time) for n in PEAKS_NS if n in case.curves.parts}
    if not found:
        return Verdict(None, "none of these parts is in this room")
    off = {name: peak - PEAKS_NS[name] for name, peak in found.items()}
    text = ", ".join(f"{name} {peak:.1f} ({off[name]:+.1f})" for name, peak in found.items())
    # Peaks fall on bins; a tenth of a bin's rounding is no deviation.
    near = all(abs(d) <= PEAK_TOLERANCE_NS + 0.01 for d in off.values())
    return Verdict(decided(near, *off.values()), text + " ns")


def _heights(case: Simulation) -> dict[str, float]:
    return {name: float(curve.max()) for name, curve in case.curves.parts.items()}


def _order(case: Simulation) -> Verdict:
    height = _heights(case)
    if not {WALLS, BOX, PILLAR} <= set(height):
        return Verdict(None, "this room has other parts")
    holds = height[WALLS] > height[BOX] > MUCH_HIGHER * height[PILLAR]
    over = [ratio(height[WALLS], height[name]) for name in (BOX, PILLAR)]
    return Verdict(holds, f"walls : box : pillar = 1 : 1/{over[0]:.2g} : 1/{over[1]:.2g}")


def _pillar(case: Simulation, time: Curve) -> Verdict:
    parts, height = case.curves.parts, _heights(case)
    if not {BOX, PILLAR} <= set(height):
        return Verdict(None, "this room has no box and pillar")
    peaks = peak_ns(parts[BOX], time), peak_ns(parts[PILLAR], time)
    holds = height[PILLAR] < height[BOX] and peaks[1] > peaks[0]
    share = ratio(height[PILLAR], height[BOX])
    return Verdict(decided(holds, *peaks), f"{peaks[1] - peaks[0]:.1f} ns later, {share:.2g} of its height")


def _totals(runs: Runs, estimator: Estimator) -> list[Curve]:
    return [case.primary + case.secondary for case in (runs.case(estimator, rays) for rays in runs.sizes.rays)]


def _smoother(runs: Runs, estimator: Estimator) -> Verdict:
    total = _totals(runs, estimator)
    rough = [roughness(curve) for curve in total]
    change = shape_difference(total[0], total[1])
    return Verdict(
        decided(rough[1] < rough[0] and change < SAME_PROFILE, *rough, change),
        f"roughness {rough[0]:.3g} → {rough[1]:.3g}; profiles differ by {100 * change:.0f} % (L2)",
    )


def _broader(runs: Runs, estimator: Estimator) -> Verdict:
    broad = [width_ns(curve, runs.time_ns, WIDTH_LEVEL) for curve in _totals(runs, estimator)]
    return Verdict(
        decided(broad[1] > broad[0], *broad),
        f"width at {100 * WIDTH_LEVEL:g} % of the peak {broad[0]:.1f} → {broad[1]:.1f} ns",
    )
