"""Meeting an accuracy target: which module decides what, step by step.

1. `meet_target` divides the target among the components. Their errors add up as squares, and the primary takes an
   equal share of the sum; what the primary does not use of its share is for the others.
2. The primary (three bounces) is computed by quadrature, which has no noise: `three_bounces.py` decides how finely
   surfaces are cut (`refinement.py`).
3. A few unbiased samples are compared with the primary (`second_opinion.py`). If they disagree, quadrature gets a
   second try, with a quarter of the error. If they still disagree, or where quadrature is not possible (a pixel that
   looks past its wall, or more elements than `max_lookins` allows), everything is sampled.
4. The secondary (four bounces) is computed by quadrature over pairs of elements (`four_bounces.py`), unless a
   forecast says that path tracing costs less, and is compared with samples in the same way.
5. The other components are sampled in rounds (`rounds.py`): by path tracing, and by the factorised form of the
   secondary where surfaces stand right beside the field of view.
6. Sampled components are compared with other samples, too: their own scatter shows nothing of paths never met.
7. Errors of light by quadrature that were estimated to be far below the errors asked for are claimed as `LEAST_CLAIM`
   of these (`_claimed`), because the estimates come from few pairs.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import reduce

import numpy as np

from datagen.records import Spend
from datagen.records.arrays import Floats, l2_norm
from datagen.transport.error_control.cost import CELL, CELL_PAIR, CELL_RAY, PAIR_RAY
from datagen.transport.error_control.rounds import LEAST_LEFT, Forecast, sampled
from datagen.transport.error_control.second_opinion import Claim, Opinion, second_opinion
from datagen.transport.error_control.stratum import Known
from datagen.transport.path_tracing.averages import Estimate
from datagen.transport.problem import Problem
from datagen.transport.quadrature.four_bounces import Secondary, secondary_by_cells
from datagen.transport.quadrature.gathering import Gathering
from datagen.transport.quadrature.three_bounces import Primary, primary_by_cells

SECONDARY_OWN = 2.0
"""Error asked of the secondary's own light, most of which arrives after the primary's, relative to the error asked of
an object's own light. Half of it takes finer elements, and more often gives the secondary to samples."""
TRIES = (1.0, 0.25)
"""Errors that the primary by quadrature is tried with, one after the other, relative to those asked for."""
LEAST_CLAIM = 0.4
"""Least error that is claimed of light by quadrature, relative to the error asked for. An estimate comes from a dozen
pairs of laser point and pixel, and is now and then 2.2 times too small; with half of this, one in 400 claims would be
exceeded twofold."""
DISPUTED = "target not met: other samples found bright paths that these have missed"


@dataclass(frozen=True)
class _Quadrature:
    """A component by quadrature: light (L, P, T), overflow (L, P), L2 error in photons, cost in units of `cost.py`,
    and number of elements (of pairs of elements for the secondary)."""

    light: Floats
    overflow: Floats
    error: float
    cost: float
    elements: int


def meet_target(problem: Problem) -> Estimate:
    """A transient whose relative L2 errors, of the whole and of each object's primary, meet `Accuracy`, or an
    estimate that says that they do not."""
    splits = problem.tally_rows
    if not (problem.points.part >= 0).any():
        return _nothing(problem)
    gathering, opinions = Gathering.of(problem), list[Opinion]()
    primary = _primary(gathering, math.sqrt(1 / (1 + len(splits.others))), opinions)
    if primary is None:
        return _confirmed(problem, sampled(problem, None), (), opinions)
    computed = {"primary": _of_primary(primary)}
    if "secondary" in splits.components and problem.accuracy.strongest is None:
        secondary = _secondary(gathering, computed["primary"], opinions)
        if secondary is not None:
            computed["secondary"] = secondary
    known = Known(
        reduce(np.add, (one.light for one in computed.values())),
        math.hypot(*(one.error for one in computed.values())),
    )
    left = tuple(name for name in splits.others if name not in computed)
    if left:
        rest = sampled(replace(problem, tally_rows=replace(splits, components=left, parts=())), known)
    else:
        rest = _no_rest(problem, known)
    return _confirmed(
        problem, _claimed(problem, _joined(problem, computed, primary, rest)), tuple(computed), opinions
    )


def _claimed(problem: Problem, estimate: Estimate) -> Estimate:
    """The same estimate with every claimed error raised to at least `LEAST_CLAIM` of the error asked."""
    accuracy = problem.accuracy
    assert accuracy.target is not None
    least_of_part = LEAST_CLAIM * accuracy.each_part
    return replace(
        estimate, error_bound=max(estimate.error_bound or 0.0, LEAST_CLAIM * accuracy.target),
        part_errors={name: max(error, least_of_part) for name, error in estimate.part_errors.items()},
    )  # fmt: skip


def _primary(gathering: Gathering, share: float, opinions: list[Opinion]) -> Primary | None:
    """The primary by quadrature if unbiased samples agree with it, else None; the opinion on each try is appended to
    `opinions`. `share` is the primary's part of the target."""
    problem, accuracy = gathering.task, gathering.task.accuracy
    assert accuracy.target is not None
    for factor in TRIES:
        primary = primary_by_cells(
            gathering, factor * share * accuracy.target, factor * accuracy.each_part, accuracy.faint_part
        )
        if primary is None:
            return None
        opinions.append(second_opinion(problem, _claims(problem, primary), _of_primary(primary).cost, len(opinions)))
        if opinions[-1].agrees:
            return primary
    return None


def _secondary(gathering: Gathering, primary: _Quadrature, opinions: list[Opinion]) -> _Quadrature | None:
    """The secondary by quadrature if that costs less than path tracing and unbiased samples agree with it, else None;
    the opinion is appended to `opinions`."""
    problem, accuracy, splits = gathering.task, gathering.task.accuracy, gathering.task.tally_rows
    assert accuracy.target is not None
    error_asked, own_error = accuracy.target * l2_norm(primary.light), min(SECONDARY_OWN * accuracy.each_part, 1.0)
    limit = math.sqrt(max(error_asked**2 - primary.error**2, LEAST_LEFT * error_asked**2) / len(splits.others))
    alone = replace(problem, tally_rows=replace(splits, components=("secondary",), parts=()))
    traced = Forecast(alone, limit)
    secondary = secondary_by_cells(gathering, limit, own_error, accuracy.faint_part, traced.costs_less_than)
    if secondary is None:
        return None
    component = _of_secondary(secondary)
    error = component.error / (l2_norm(component.light) or 1.0)
    claim = Claim(component.light, error * float(component.light.sum()), order=4)
    opinions.append(second_opinion(problem, {"secondary": claim}, component.cost, len(opinions)))
    return component if opinions[-1].agrees else None


def _claims(problem: Problem, primary: Primary) -> dict[str, Claim]:
    """Name → claimed light, for the whole primary and for each part that brings light.

    The light of a part without an error of its own may be wrong by as much as the whole.
    """
    whole = reduce(np.add, primary.rows)
    error_of_whole = primary.error * float(whole.sum())
    claims = {"primary": Claim(whole, error_of_whole, order=3)}
    for k, name in enumerate(problem.tally_rows.parts):
        own_error = primary.part_errors.get(name)
        if own_error is not None or primary.rows[k].any():
            error = error_of_whole if own_error is None else own_error * float(primary.rows[k].sum())
            claims[name] = Claim(primary.rows[k], error, 3, k)
    return claims


def _confirmed(
    problem: Problem, estimate: Estimate, by_quadrature: tuple[str, ...], opinions: list[Opinion]
) -> Estimate:
    """The same estimate with all second opinions in its record, after one more on the components that were sampled.

    Where the other samples met light that these have missed, the claimed error is raised to that light and the target
    is not met.
    """
    claims, bound = {}, estimate.error_bound or 0.0
    whole = float(sum(map(np.sum, estimate.components.values())))
    for order, name in ((3, "primary"), (4, "secondary")):
        sampled_here = name in estimate.components and name not in by_quadrature
        if sampled_here and problem.accuracy.strongest is None:
            # The bound is on the whole transient; a component may have little of its light or, so far, none.
            claims[name] = Claim(estimate.components[name], bound * whole, order)
    if claims:
        opinions = [*opinions, second_opinion(problem, claims, estimate.spend.cost, len(opinions))]
        if not opinions[-1].agrees:
            missing = abs(opinions[-1].missing) / max(whole, 1e-300)
            estimate = replace(
                estimate, error_bound=max(bound, missing, 1.01 * (problem.accuracy.target or 0.0)),
                met_target=False, spend=replace(estimate.spend, outcome=DISPUTED),
            )  # fmt: skip
    return replace(estimate, spend=replace(estimate.spend, second_opinion="; ".join(map(str, opinions))))


def _of_primary(primary: Primary) -> _Quadrature:
    """The primary summed over its rows, with its error in photons and its cost."""
    whole = primary.rows[0].copy()
    for row in primary.rows[1:]:
        whole += row
    cost = CELL * primary.cells + CELL_RAY * primary.rays
    return _Quadrature(whole, primary.overflow, primary.error * l2_norm(whole), cost, primary.cells)


def _of_secondary(secondary: Secondary) -> _Quadrature:
    """The secondary with its cost."""
    cost = CELL_PAIR * secondary.pairs + PAIR_RAY * secondary.rays
    return _Quadrature(secondary.histogram, secondary.overflow, secondary.error, cost, secondary.pairs)


def _no_rest(problem: Problem, known: Known) -> Estimate:
    """The estimate of the sampled components where quadrature found all components: no light, and whether the known
    light alone meets the target."""
    error, target = known.error / l2_norm(known.light), problem.accuracy.target
    met = target is not None and error <= target
    spend = Spend({}, {}, {}, {}, 1, 0.0, "target met" if met else "target not met by cells")
    shape = problem.capture.shape
    return Estimate({}, {}, np.zeros(shape), np.zeros(shape[:2]), spend, error, met)


def _joined(problem: Problem, computed: dict[str, _Quadrature], primary: Primary, rest: Estimate) -> Estimate:
    """One estimate from the components by quadrature (`computed`) and the sampled ones (`rest`). The standard error
    of a component by quadrature is its relative L2 error times each bin."""
    total = sum(one.cost for one in computed.values()) + rest.spend.cost
    lasers = max(int((problem.points.part >= 0).sum()), 1)
    share = {name: share * rest.spend.cost for name, share in rest.spend.share.items()}
    share |= {name: one.cost for name, one in computed.items()}
    components = {
        name: computed[name].light if name in computed else rest.components[name]
        for name in problem.tally_rows.components
    }
    parts_met = all(error <= problem.accuracy.each_part for error in primary.part_errors.values())
    outcome = rest.spend.outcome
    if rest.met_target and not parts_met:
        outcome = "target met but for an object's own light"
    spend = Spend(
        lookins=dict(rest.spend.lookins) | {name: one.elements / lasers for name, one in computed.items()},
        share={name: value / total if total > 0 else 0.0 for name, value in share.items()},
        way=dict(rest.spend.way) | dict.fromkeys(computed, "cells"),
        fov_samples=dict(rest.spend.fov_samples) | dict.fromkeys(computed, 1),
        rounds=rest.spend.rounds, cost=total, outcome=outcome,
    )  # fmt: skip
    errors = [one.error / (l2_norm(one.light) or 1.0) * one.light for one in computed.values()]
    overflow = reduce(np.add, [rest.overflow, *(one.overflow for one in computed.values())])
    return Estimate(
        components, dict(zip(problem.tally_rows.parts, primary.rows, strict=False)),
        reduce(np.hypot, [rest.stderr, *errors] if rest.components else errors), overflow, spend,
        rest.error_bound, rest.met_target and parts_met, dict(primary.part_errors), rest.rays,
    )  # fmt: skip


def _nothing(problem: Problem) -> Estimate:
    """The estimate where no laser ray meets the scene: exactly zero."""
    requested, shape = problem.tally_rows.components, problem.capture.shape
    spend = Spend(
        lookins=dict.fromkeys(requested, 0.0), share=dict.fromkeys(requested, 0.0),
        way=dict.fromkeys(requested, "walk"),
        fov_samples=dict.fromkeys(requested, 1), rounds=0, cost=0.0,
        outcome="nothing visible: no laser ray meets the scene",
    )  # fmt: skip
    zeros = {name: np.zeros(shape) for name in requested}
    parts = {name: np.zeros(shape) for name in problem.tally_rows.parts}
    return Estimate(zeros, parts, np.zeros(shape), np.zeros(shape[:2]), spend, 0.0, True)
