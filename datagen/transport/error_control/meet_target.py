"""Meeting an accuracy target: rounds of samples where the variance is, until the error bound is met."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import reduce

import numpy as np

from datagen.records import Spend
from datagen.records.arrays import Floats, l2_norm
from datagen.transport.error_control.allocation import REPLICATES, Allotment, next_allotments, one_more
from datagen.transport.error_control.confidence import bound_factor, total_variance
from datagen.transport.error_control.cost import CELL, CELL_PAIR, CELL_RAY, PAIR_RAY, Work
from datagen.transport.error_control.second_opinion import Claim, Opinion, second_opinion
from datagen.transport.error_control.strata import Known, Stratum, square_norm
from datagen.transport.error_control.strategies import ForecastWalk, Seeds, first_rounds
from datagen.transport.path_tracing.averages import Estimate, rays_of, split_rows
from datagen.transport.problem import Problem
from datagen.transport.quadrature.four_bounces import Secondary, secondary_by_cells
from datagen.transport.quadrature.gathering import Gathering
from datagen.transport.quadrature.three_bounces import Primary, primary_by_cells

ROUNDS_AT_LEAST, ROUNDS_AT_MOST = 2, 64
MATTERS = 0.2
"""Share of the variance from which a stratum needs `ROUNDS_AT_LEAST`."""
MARGIN = 0.9
"""Share of the variance that would just do which a round aims at: it comes out above what was predicted as often as
below, and a further round costs more than a few samples too many."""
NOISE_AT_MOST = 0.9
"""Share of ‖mean‖² that may be noise when ‖truth‖² is estimated from it, so that the estimate stays positive."""
NOTHING_AFTER = 1 << 16
"""Lookins in all after which a component without any light is taken for dark."""
DARK = 1e-200
"""Σ of squared photons per emitted photon up to which nothing is seen: the tail of a narrow lobe may bring e⁻⁵⁰⁰,
whose square is no number to divide by."""
SEARCH_GROWTH = 8
SECONDARY_OWN = 2.0
"""The error of the secondary's own light, which comes when the primary's is past, relative to that of an object's."""
TRIES = (1.0, 0.25)
"""Errors that the primary from cells is tried with, relative to those asked for: where unbiased samples disagree with
the one, finer cells get a chance before all is sampled."""
DISPUTED = "target not met: other samples found bright paths that these have missed"
LEAST_LEFT = 0.1
"""Share of the square of the target that is left to components still to be found at least."""


def meet_target(task: Problem) -> Estimate:
    """A transient whose relative L2 error, in all and in each object's primary, is within what `Accuracy` asks.

    Primary and secondary come from cells, without noise (`three_bounces.py`, `four_bounces.py`), and what these
    leave of the error is met by sampling the other components. Where cells are not the means (a pixel that looks past
    its wall, more cells than `max_lookins` would leave rays, unbiased samples that disagree with them:
    `second_opinion.py`) all components are sampled, or all but the primary, and only the whole is held to an error.
    """
    accuracy, splits = task.accuracy, task.splits
    assert accuracy.target is not None
    if not (task.points.part >= 0).any():
        return _nothing(task)
    others = len(splits.others)
    # Errors of different light add up as squares, and the primary takes an equal share: its cells, pairs of cells and
    # samples all cost about as their error squared. What it leaves of its own is the others'.
    gathering, share = Gathering.of(task), math.sqrt(1 / (1 + others))
    primary, opinions = _agreed_primary(gathering, share)
    if primary is None:
        return _confirmed(task, _sampled(task, None), (), opinions)
    found = {"primary": _of_primary(primary)}
    if "secondary" in splits.components and accuracy.strongest is None:
        asked, own = accuracy.target * l2_norm(found["primary"].light), min(SECONDARY_OWN * accuracy.each_part, 1.0)
        square = max(asked**2 - found["primary"].error ** 2, LEAST_LEFT * asked**2)
        limit = math.sqrt(square / others)
        apart = replace(task, splits=replace(splits, components=("secondary",), parts=()))
        walk = ForecastWalk(apart, limit)
        secondary = secondary_by_cells(gathering, limit, own, accuracy.faint_part, walk.costs_less_than)
        if secondary is not None:
            of_cells = _of_secondary(secondary)
            error = of_cells.error / (l2_norm(of_cells.light) or 1.0)
            claim = Claim(of_cells.light, error * float(of_cells.light.sum()), order=4)
            opinions.append(second_opinion(task, {"secondary": claim}, of_cells.cost, len(opinions)))
            if opinions[-1].agrees:
                found["secondary"] = of_cells
    left = tuple(name for name in splits.others if name not in found)
    known = Known(
        reduce(np.add, (one.light for one in found.values())), math.hypot(*(one.error for one in found.values()))
    )
    if left:
        rest = _sampled(replace(task, splits=replace(splits, components=left, parts=())), known)
    else:
        error = known.error / l2_norm(known.light)
        met = error <= accuracy.target
        spend = Spend({}, {}, {}, {}, 1, 0.0, "target met" if met else "target not met by cells")
        rest = Estimate({}, {}, np.zeros(task.capture.shape), np.zeros(task.capture.shape[:2]), spend, error, met)
    return _confirmed(task, _joined(task, found, primary, rest), tuple(found), opinions)


def _agreed_primary(gathering: Gathering, share: float) -> tuple[Primary | None, list[Opinion]]:
    """The primary by cells, if unbiased samples agree with it, and what they said of each try; else nothing."""
    task, accuracy, opinions = gathering.task, gathering.task.accuracy, list[Opinion]()
    assert accuracy.target is not None
    for finer in TRIES:
        primary = primary_by_cells(
            gathering, finer * share * accuracy.target, finer * accuracy.each_part, accuracy.faint_part
        )
        if primary is None:
            return None, opinions
        opinions.append(second_opinion(task, _claims(task, primary), _of_primary(primary).cost, len(opinions)))
        if opinions[-1].agrees:
            return primary, opinions
    return None, opinions


def _claims(task: Problem, primary: Primary) -> dict[str, Claim]:
    """What the primary says of the error of its whole, and of each part that brings light.

    The light of a part that is held to no error of its own may be wrong by as much as the whole.
    """
    whole = reduce(np.add, primary.rows)
    of_whole = primary.error * float(whole.sum())
    claims = {"primary": Claim(whole, of_whole, order=3)}
    for k, name in enumerate(task.splits.parts):
        own = primary.part_errors.get(name)
        if own is not None or primary.rows[k].any():
            claims[name] = Claim(
                primary.rows[k], of_whole if own is None else own * float(primary.rows[k].sum()), 3, k
            )
    return claims


def _confirmed(task: Problem, estimate: Estimate, by_cells: tuple[str, ...], opinions: list[Opinion]) -> Estimate:
    """The same estimate, its record saying what all second opinions were, the one on what was sampled with them.

    The bound of sampled light knows nothing of paths so rare that no replicate met them. Where other samples did, the
    claim is raised to what they say is missing, and the target is not met.
    """
    claims, bound = {}, estimate.error_bound or 0.0
    whole = float(sum(map(np.sum, estimate.components.values())))
    for order, name in ((3, "primary"), (4, "secondary")):
        if name not in estimate.components or name in by_cells or task.accuracy.strongest is not None:
            continue
        # The bound is one on the whole, of which this may be little or, so far, nothing.
        claims[name] = Claim(estimate.components[name], bound * whole, order)
    if claims:
        opinions = [*opinions, second_opinion(task, claims, estimate.spend.cost, len(opinions))]
        if not opinions[-1].agrees:
            missing = abs(opinions[-1].missing) / max(whole, 1e-300)
            estimate = replace(
                estimate, error_bound=max(bound, missing, 1.01 * (task.accuracy.target or 0.0)),
                met_target=False, spend=replace(estimate.spend, outcome=DISPUTED),
            )  # fmt: skip
    return replace(estimate, spend=replace(estimate.spend, second_opinion="; ".join(map(str, opinions))))


@dataclass(frozen=True)
class _Found:
    """What cells gave of a component: light (L, P, T), overflow (L, P), L2 error, cost, and cells in all."""

    light: Floats
    overflow: Floats
    error: float
    cost: float
    cells: int


def _of_primary(primary: Primary) -> _Found:
    whole = primary.rows[0].copy()
    for row in primary.rows[1:]:
        whole += row
    cost = CELL * primary.cells + CELL_RAY * primary.rays
    return _Found(whole, primary.overflow, primary.error * l2_norm(whole), cost, primary.cells)


def _of_secondary(secondary: Secondary) -> _Found:
    cost = CELL_PAIR * secondary.pairs + PAIR_RAY * secondary.rays
    return _Found(secondary.histogram, secondary.overflow, secondary.error, cost, secondary.pairs)


def _joined(task: Problem, found: dict[str, _Found], primary: Primary, rest: Estimate) -> Estimate:
    """What cells gave with the other components from samples; its error is taken as the same share of every bin."""
    total = sum(one.cost for one in found.values()) + rest.spend.cost
    lasers = max(int((task.points.part >= 0).sum()), 1)
    share = {name: share * rest.spend.cost for name, share in rest.spend.share.items()}
    share |= {name: one.cost for name, one in found.items()}
    components = {
        name: found[name].light if name in found else rest.components[name] for name in task.splits.components
    }
    told = all(error <= task.accuracy.each_part for error in primary.part_errors.values())
    outcome = rest.spend.outcome if told or not rest.met_target else "target met but for an object's own light"
    spend = Spend(
        lookins=dict(rest.spend.lookins) | {name: one.cells / lasers for name, one in found.items()},
        share={name: value / total if total > 0 else 0.0 for name, value in share.items()},
        way=dict(rest.spend.way) | dict.fromkeys(found, "cells"),
        fov_samples=dict(rest.spend.fov_samples) | dict.fromkeys(found, 1),
        rounds=rest.spend.rounds, cost=total, outcome=outcome,
    )  # fmt: skip
    norms = [l2_norm(one.light) or 1.0 for one in found.values()]
    errors = [one.error / norm * one.light for one, norm in zip(found.values(), norms, strict=True)]
    overflow = reduce(np.add, [rest.overflow, *(one.overflow for one in found.values())])
    return Estimate(
        components, dict(zip(task.splits.parts, primary.rows, strict=False)),
        reduce(np.hypot, [rest.stderr, *errors] if rest.components else errors), overflow, spend,
        rest.error_bound, rest.met_target and told, dict(primary.part_errors), rest.rays,
    )  # fmt: skip


def _sampled(task: Problem, known: Known | None) -> Estimate:
    """Sample until an upper bound of the relative L2 error of the whole transient is within `Accuracy.target`.

    Each component is a stratum with samples of its own, unless a walk that finds several together is cheaper. A first
    round gives variances and costs; each further one goes where it lowers the variance most for its cost
    (`allocation.py`), is sized by the observed order of convergence, and adds to the average with its number of
    lookins as its weight. It stops when the bound (`confidence.py`) is within the target, after two rounds at least
    and with the last in agreement with those before; or, unmet, before `Accuracy.max_lookins` are exceeded.
    """
    target = task.accuracy.target
    assert target is not None
    lasers = int((task.points.part >= 0).sum())
    seeds, of_known = Seeds(task.seed), 0.0 if known is None else known.error**2
    strata, tried = first_rounds(task, target, seeds, known)
    budget = float(task.accuracy.max_lookins) * lasers
    bound, outcome, rounds = np.inf, "", 1
    while not outcome:
        variance, factor, factor_to_come = _uncertainty(strata)
        seen = square_norm(strata, known)
        if seen <= DARK:
            bound = 0.0
            outcome = _search(strata, seeds, budget)
            rounds += not outcome
            continue
        truth = max(seen - variance, (1 - NOISE_AT_MOST) * seen)
        bound = float(np.sqrt((variance * factor + of_known) / truth))
        once = _seen_once(strata)
        allotments: list[Allotment] | None = None
        if bound <= target and once:
            allotments = one_more(strata, once)
        elif bound > target and rounds < ROUNDS_AT_MOST:
            spent = sum(float(s.weight.sum()) * s.rays_per_lookin for s in strata)
            left = max(MARGIN * target**2 * truth - of_known, LEAST_LEFT * target**2 * truth)
            allotments = next_allotments(strata, left / factor_to_come, budget - spent)
        if allotments is None:
            outcome = "target met" if bound <= target else f"target not met in {rounds} rounds within max_lookins"
            break
        for stratum, allotment in zip(strata, allotments, strict=True):
            if allotment.lookins:
                stratum.sample(allotment.points, allotment.replicates, seeds.draw())
        rounds += 1
    return _estimate(task, strata, tried, rounds, bound, outcome)


def _uncertainty(strata: list[Stratum]) -> tuple[float, float, float]:
    """The variance of the whole transient, summed over all bins, what bounds the squared error when multiplied with
    it, and that factor after one more round, which makes the variance better known."""
    kept = [(one, stratum.excess) for stratum in strata for one in stratum.scatters()]
    scatters = [replace(one, variance=one.variance * excess) for one, excess in kept]
    doubled = [replace(one, replicates=2 * one.replicates) for one, _ in kept]
    return total_variance(scatters), bound_factor(scatters), bound_factor(doubled)


def _seen_once(strata: list[Stratum]) -> list[int]:
    """Strata that matter and have had only their first round, which nothing has confirmed yet."""
    variances = [total_variance(stratum.scatters()) for stratum in strata]
    return [
        k
        for k, (stratum, variance) in enumerate(zip(strata, variances, strict=True))
        if len(stratum.rounds) < ROUNDS_AT_LEAST and variance > MATTERS * sum(variances)
    ]


def _search(strata: list[Stratum], seeds: Seeds, budget: float) -> str:
    """Look harder for light where there was none; says why it gave up, or nothing."""
    looked = [float(stratum.weight.sum()) for stratum in strata]
    more = [SEARCH_GROWTH * int(stratum.points.max()) for stratum in strata]
    rays = sum(
        stratum.rays_per_lookin * (before + count * REPLICATES * len(stratum.weight))
        for stratum, before, count in zip(strata, looked, more, strict=True)
    )
    if min(looked) >= NOTHING_AFTER or rays > budget:
        return f"nothing visible: no light in {sum(looked):.0f} lookins"
    for stratum, count in zip(strata, more, strict=True):
        stratum.sample(np.full(len(stratum.weight), count), REPLICATES, seeds.draw())
    return ""


def _estimate(
    task: Problem, strata: list[Stratum], tried: float, rounds: int, bound: float, outcome: str
) -> Estimate:
    components: dict[str, Floats] = {}
    parts: dict[str, Floats] = {}
    variance, overflow = np.zeros(task.capture.shape), np.zeros(task.capture.shape[:2])
    lookins: dict[str, float] = {}
    costs: dict[str, float] = {}
    ways: dict[str, str] = {}
    points: dict[str, int] = {}
    seen = task.points.part >= 0
    for stratum in strata:
        variance += stratum.variance / np.maximum(stratum.weight, 1.0)[:, None, None] ** 2
        overflow += stratum.mean(stratum.overflow)
        found, of_parts = split_rows([stratum.mean(row) for row in stratum.rows], stratum.task.splits)
        parts |= of_parts
        for name, values in found.items():
            components[name] = components[name] + values if name in components else values
            lookins[name] = lookins.get(name, 0.0) + float(stratum.weight[seen].mean())
            costs[name] = costs.get(name, 0.0) + stratum.work.cost / len(found)
            way = "walk" if stratum.observed is None else "factorised"
            ways[name] = "walk + factorised" if ways.get(name, way) != way else way
            points[name] = int(stratum.task.accuracy.fov_samples)
    total = sum(costs.values())
    asked = task.splits.components
    spend = Spend(
        lookins={name: lookins[name] for name in asked}, share={name: costs[name] / total for name in asked},
        way={name: ways[name] for name in asked}, fov_samples={name: points[name] for name in asked}, rounds=rounds,
        cost=total + tried, outcome=outcome,
    )  # fmt: skip
    target = task.accuracy.target
    ordered = {name: components[name] for name in asked}
    work = sum((stratum.work for stratum in strata), start=Work(calls=0))
    return Estimate(
        ordered, parts, np.sqrt(variance), overflow, spend, bound, target is not None and bound <= target,
        rays=rays_of(task, work),
    )  # fmt: skip


def _nothing(task: Problem) -> Estimate:
    """No laser ray meets the scene: the transient is zero, exactly."""
    asked, shape = task.splits.components, task.capture.shape
    spend = Spend(
        lookins=dict.fromkeys(asked, 0.0), share=dict.fromkeys(asked, 0.0), way=dict.fromkeys(asked, "walk"),
        fov_samples=dict.fromkeys(asked, 1), rounds=0, cost=0.0,
        outcome="nothing visible: no laser ray meets the scene",
    )  # fmt: skip
    zeros = {name: np.zeros(shape) for name in asked}
    parts = {name: np.zeros(shape) for name in task.splits.parts}
    return Estimate(zeros, parts, np.zeros(shape), np.zeros(shape[:2]), spend, 0.0, True)
