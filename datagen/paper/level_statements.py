"""Statements on how much light there is, and on what that depends."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from datagen.paper.lookin_balance import LookinBalance
from datagen.paper.measures import exceeds_from_ns, mean_ns, shape_difference
from datagen.paper.runs import Runs, Simulation
from datagen.paper.statements import BOX, PILLAR, SAME_PROFILE, Statement, Verdict, decided, ratio

MINOR_SHARE = 0.1
"""Secondary over primary energy below which it counts as a minor contribution."""
SAME_LEVEL = 0.1
"""Relative change of a level as printed below which it counts as independent of the sampling."""
STANDARD_ERRORS = 4.0


def level_statements(runs: Runs, balance: LookinBalance) -> list[Statement]:
    """Statements on how much light there is, and on what that depends."""
    printed, converged = runs.case("as printed", runs.dense), runs.case("converged")
    sparse, metres = runs.case("as printed", runs.sparse), runs.in_metres[runs.sparse]
    time = runs.time_ns
    unit, ratio_unit = ratio(metres.level["primary"], sparse.level["primary"]), ratio(metres.ratio, sparse.ratio)
    from_ns = exceeds_from_ns(converged.secondary, converged.primary, time)
    overtakes = f"; above the primary from {from_ns:.0f} ns on" if math.isfinite(from_ns) else ""
    strongest, every = (_highest(values) for values in (balance.strongest, balance.every))
    shape = shape_difference(printed.primary, converged.primary)
    means = mean_ns(printed.primary, time), mean_ns(converged.primary, time)
    once, again = runs.rescaled
    shares = ratio(again.secondary, again.primary), ratio(once.secondary, once.primary)
    free = ratio(again.primary, once.primary), ratio(*shares)
    same = runs.case("radiometric", runs.dense)
    own = shape_difference(same.primary, converged.primary)
    return [
        Statement(
            "minor", "Secondary paths make only a minor contribution to the total",
            f"sec. 4, Fig. 7; taken as under {100 * MINOR_SHARE:g} % of the primary",
            Verdict(
                decided(printed.ratio < MINOR_SHARE, printed.ratio),
                f"secondary / primary = {printed.ratio:.2g} in mm, {printed.ratio * ratio_unit:.2g} in m",
            ),
            Verdict(
                decided(converged.ratio < MINOR_SHARE, converged.ratio),
                f"secondary / primary = {converged.ratio:.3g}{overtakes}",
            ),
            {"printed, mm": printed.ratio, "printed, m": printed.ratio * ratio_unit, "radiometric": converged.ratio},
        ),
        Statement(
            "less", "The contribution of a secondary path is always less than that of a primary path",
            "sec. 4, “Firstly”",
            Verdict(
                decided(strongest * max(1.0, ratio_unit) < 1, strongest, ratio_unit),
                f"strongest path over primary on its way into a lookin, at most: {strongest:.2g} in mm, "
                f"{strongest * ratio_unit:.2g} in m; all paths together {every:.2g} and "
                f"{every * ratio_unit:.2g}",
            ),
            _irradiance(balance),
        ),
        Statement(
            "unit", "The aperture term renders L(t) unitless", "sec. 3.2",
            Verdict(
                decided(abs(unit - 1) < 1e-6, unit),
                f"with metres in place of millimetres L_p changes {unit:.3g}-fold; Eq. 6 has the unit length⁻⁴",
            ),
            Verdict(
                decided(abs(free[0] - 1) < 1e-3, free[0]),
                f"all lengths × 1000, the aperture's too: primary × {free[0]:.6f}",
            ),
            {"L_p, m over mm": unit, "radiometric, m over mm": free[0]},
        ),
        Statement(
            "ratio unit", "The secondary's weight is a property of the room (implied)", "Eq. 8 adds L_s to L_p",
            Verdict(
                decided(abs(ratio_unit - 1) < 1e-6, ratio_unit),
                f"L_s / L_p changes {ratio_unit:.3g}-fold between mm and m: its unit is 1/length²",
            ),
            Verdict(
                decided(abs(free[1] - 1) < 1e-3, free[1]),
                f"all lengths × 1000: secondary / primary × {free[1]:.6f}",
            ),
            {"L_s/L_p, m over mm": ratio_unit, "radiometric, m over mm": free[1]},
        ),
        _independence(runs),
        Statement(
            "extended", "Extended surfaces dominate: the total follows the walls, roof and floor", "sec. 4, Fig. 7",
            _dominated(printed), _dominated(converged),
        ),
        Statement(
            "shape", "The primary's envelope is that of the room (implied)",
            f"Eq. 6; taken as under {100 * SAME_PROFILE:g} % (L2) from the converged one",
            Verdict(
                decided(shape < SAME_PROFILE, shape),
                f"differs from the radiometric one by {100 * shape:.0f} % (L2, equal areas); mean arrival "
                f"{means[0]:.1f} ns where it should be {means[1]:.1f} ns",
            ),
            Verdict(
                decided(own < SAME_PROFILE, own),
                f"at the same counts {100 * own:.0f} % from the converged one, whose standard error is "
                f"{100 * runs.relative_error[0]:.2g} % (L2 over bins of {_width_ps(runs):g} ps)",
            ),
            {"shape difference": shape, "printed mean, ns": means[0], "radiometric mean, ns": means[1]},
        ),
    ]  # fmt: skip


def _dominated(case: Simulation) -> Verdict:
    level = {name: float(curve.sum()) for name, curve in case.curves.parts.items()}
    walls = max((n for n in level if n not in (BOX, PILLAR)), key=lambda n: level[n], default=None)
    total = float(case.curves.total.sum())
    if walls is None or total <= 0:
        return Verdict(None, "this room has no extended surfaces")
    share, height = level[walls] / total, float(case.curves.parts[walls].max() / case.curves.total.max())
    return Verdict(share > 0.5, f"{100 * share:.0f} % of all light, {100 * height:.0f} % of the total's peak")


def _irradiance(balance: LookinBalance) -> Verdict:
    if balance.irradiance is None or not np.isfinite(balance.irradiance).any():
        return Verdict(None, "computed for Lambertian rooms only")
    ratio = balance.irradiance[np.isfinite(balance.irradiance)]
    brighter = float((ratio > 1).mean())
    return Verdict(
        brighter == 0,
        f"indirect over direct irradiance of a lookin: median {np.median(ratio):.2g}, at most {ratio.max():.2g}; "
        f"above 1 at {100 * brighter:.0f} % of lookins",
    )


def _independence(runs: Runs) -> Statement:
    levels = [runs.case("as printed", rays).level for rays in runs.sizes.rays]
    sweep = list(runs.sweep.values())
    change = {n: ratio(levels[1][n], levels[0][n]) for n in ("primary", "secondary")}
    spread = {n: _spread([getattr(level, n) for level in sweep]) for n in ("primary", "secondary")}
    few, many = (runs.radiometric_levels[rays] for rays in runs.sizes.rays)
    away = {}
    for n in ("primary", "secondary"):
        error = math.hypot(getattr(few, f"{n}_error"), getattr(many, f"{n}_error"))
        away[n] = ratio(getattr(many, n) - getattr(few, n), error)
    a, b = runs.sizes.rays
    sides = ", ".join(str(rays) for rays in runs.sweep)
    return Statement(
        "independence", "The level does not depend on how many rays sample the room (implied)", "Eq. 6, 8",
        Verdict(
            decided(
                max(abs(c - 1) for c in change.values()) < SAME_LEVEL and max(spread.values()) < 1 + SAME_LEVEL,
                *change.values(), *spread.values(),
            ),
            f"from {a}×{a} to {b}×{b} rays the primary changes by {100 * (change['primary'] - 1):+.1f} %, the "
            f"secondary {change['secondary']:.2f}-fold; over {sides} rays a side the highest is "
            f"{spread['primary']:.2f} and {spread['secondary']:.3g} times the lowest",
        ),
        Verdict(
            decided(all(abs(d) < STANDARD_ERRORS for d in away.values()), *away.values()),
            f"primary {few.primary:.4g} ± {few.primary_error:.1g} and {many.primary:.4g} ± {many.primary_error:.1g}, "
            f"secondary {few.secondary:.4g} ± {few.secondary_error:.1g} and {many.secondary:.4g} ± "
            f"{many.secondary_error:.1g} ({runs.sizes.seeds} seeds)",
        ),
        {f"printed {n} change": c for n, c in change.items()} | {f"printed {n} spread": s for n, s in spread.items()}
        | {f"radiometric {n}, standard errors apart": d for n, d in away.items()},
    )  # fmt: skip


def _spread(values: list[float]) -> float:
    return ratio(max(values), min(values))


def _highest(values: NDArray[np.float64]) -> float:
    return float(np.max(values[np.isfinite(values)], initial=0.0)) if np.isfinite(values).any() else float("nan")


def _width_ps(runs: Runs) -> float:
    return runs.capture.time.width_s * 1e12
