"""Rounds of samples: each goes to the strata where it lowers the variance most for its cost, until the bound is met.

A sample is a hidden vertex drawn for a laser point (in the factorised form for all of them), with the path behind it.
A stratum is a set of components that are sampled together (`stratum.py`).

With variance Vᵢ = gᵢ²/Nᵢ and cost cᵢ Nᵢ of a stratum, the least cost for a given total variance is at Nᵢ ∝ gᵢ/√cᵢ
(Neyman 1934, with costs).
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from datagen.records import Spend
from datagen.records.arrays import Floats
from datagen.seeding import LightStream
from datagen.transport.error_control.confidence import bound_factor, total_variance
from datagen.transport.error_control.cost import Work
from datagen.transport.error_control.stratum import Known, Stratum, square_norm, strata_of, with_usual_fov_samples
from datagen.transport.path_tracing.averages import Estimate, rays_of, split_rows
from datagen.transport.problem import Problem
from datagen.transport.sampling import stream_seeds

REPLICATES = 8
"""Fewest replicates of a round; up to twice as many are taken, so that the samples of each can stay a power of two.
From half as many the scatter is known so badly that its confidence bound costs more samples than it saves."""
FIRST_SAMPLES, FIRST_EACH = 4096, (4, 64)
"""Samples of a first round over all laser points and replicates; fewest and most samples of one laser point in each
replicate. Half as many leave the first variance so uncertain that the next round is sized by luck."""
ROUNDS_AT_LEAST, ROUNDS_AT_MOST = 2, 64
"""Fewest rounds of a stratum that matters, and most rounds of all: with one, nothing confirms the first variance; the
second is ample, for each round may be `GROWTH` times as large as all before it."""
MATTERS = 0.2
"""Share of the variance from which a stratum needs `ROUNDS_AT_LEAST`. Half of it would sample strata of little light
twice; twice of it would leave a stratum with nearly half of the variance unconfirmed."""
GROWTH = 8.0
"""Largest cost of one round, relative to all rounds before it: the first variances are uncertain. Half of it takes a
round more."""
WITHOUT_VARIANCE = 0.05
"""Share of the cost that goes to a stratum whose variance seems to be zero: its light may not have been met yet. Half
of it finds rare light later."""
TOO_FEW = 0.05
"""Smallest addition to a stratum, relative to its samples so far; smaller ones are left for later. Half of it makes
rounds that change little."""
MARGIN = 0.9
"""Variance that a round aims at, relative to the one that would just meet the target: variances come out above the
predicted one as often as below, and a further round costs more than a few samples too many. Half of it doubles the
samples."""
NOISE_AT_MOST = 0.9
"""Largest share of ‖mean‖² that is taken for noise when ‖truth‖² is estimated from it, so that the estimate stays
positive. Half of it takes noise for light in the first rounds."""
LEAST_LEFT = 0.1
"""Least share of the square of the target that is left to sampled light, whatever light by quadrature has used up.
Half of it may cost twice the samples."""
SEARCH_GROWTH = 8
"""Factor by which a round grows while hardly any light was met. Half of it takes more rounds."""
DARK = 1e-200
"""Σ of squared photons per emitted photon up to which a transient counts as zero: the tail of a narrow lobe may bring
e⁻⁵⁰⁰, whose square is too small a number to divide by."""
LOOK_FROM = 10.0
"""Cost of another method, in units of a first round of path tracing, from which that first round is sampled to
forecast the cost of path tracing. Half of it spends up to a fifth of the other method's cost on the comparison."""

Additions = list[tuple[int, int]]
"""What a round adds to each stratum: samples of each laser point in each replicate (0 for none), and replicates."""


def sampled(problem: Problem, known: Known | None) -> Estimate:
    """The components of the problem, sampled until the error of the whole transient is within `Accuracy.target`.

    A first round of every stratum gives variances and costs. Each further round is sized by these, and adds to the
    average with its number of samples as its weight. Rounds end when the upper confidence bound of the error
    (`confidence.py`) is within the target and every stratum that matters has had two rounds; or, with the target not
    met, before `Accuracy.max_lookins` are exceeded.

    known : light that needs no samples. The target is for the sum of sampled and known light, and the error of the
        known light counts.
    """
    target, budget = problem.accuracy.target, float(problem.accuracy.max_lookins)
    assert target is not None
    seeds, of_known = _seeds(problem.seed), 0.0 if known is None else known.error**2
    strata = strata_of(problem)
    for stratum in strata:
        stratum.sample(_first_samples(problem), REPLICATES, next(seeds))
    bound, outcome, rounds = np.inf, "", 1
    while not outcome:
        seen = square_norm(strata, known)
        if seen <= DARK:
            bound, additions = 0.0, _search(strata, budget)
            outcome = "" if additions else f"nothing visible: no light in {_samples(strata):.0f} lookins"
        else:
            variance, factor, factor_to_come = _uncertainty(strata)
            truth = max(seen - variance, (1 - NOISE_AT_MOST) * seen)
            bound = math.sqrt((variance * factor + of_known) / truth)
            left = max(MARGIN * target**2 * truth - of_known, LEAST_LEFT * target**2 * truth)
            if bound <= target:
                additions = _met(strata, budget) or _confirming(strata)
                outcome = "" if additions else "target met"
            else:
                more = rounds < ROUNDS_AT_MOST
                additions = _next_round(strata, left / factor_to_come, budget) if more else []
                outcome = "" if additions else f"target not met in {rounds} rounds within max_lookins"
        for stratum, (each, replicates) in zip(strata, additions, strict=False):
            if each:
                stratum.sample(each, replicates, next(seeds))
        rounds += not outcome
    return _estimate(problem, strata, rounds, bound, outcome)


def _seeds(seed: int) -> Iterator[int]:
    """Independent seeds, one for each round of each stratum."""
    number = 0
    while True:
        high, low = (int(stream_seeds(seed, LightStream.TARGET_HALVES, half, number)[0]) for half in (0, 1))
        yield high << 32 | low
        number += 1


def _first_samples(problem: Problem) -> int:
    """Samples of each laser point in each replicate of a first round, a power of two."""
    wanted = FIRST_SAMPLES // (REPLICATES * len(problem.points.part))
    return int(np.clip(1 << max(wanted, 1).bit_length() - 1, *FIRST_EACH))


def _samples(strata: list[Stratum]) -> float:
    """Samples over all laser points and strata."""
    return sum(stratum.samples for stratum in strata) * len(strata[0].problem.points.part)


def _uncertainty(strata: list[Stratum]) -> tuple[float, float, float]:
    """Variance of the whole transient, summed over all bins; factor from it to the upper bound of the squared error;
    and that factor after one more round, when the variance is better known."""
    scatters = [replace(one, variance=one.variance * of.excess) for of in strata for one in of.scatters()]
    doubled = [replace(one, replicates=2 * one.replicates) for one in scatters]
    return total_variance(scatters), bound_factor(scatters), bound_factor(doubled)


def _search(strata: list[Stratum], budget: float) -> Additions:
    """A larger round for strata that have met no light so far; empty if `NOTHING_AFTER` samples have met none, or if
    the round would exceed the budget."""
    return [] if all(of.searched for of in strata) else _larger(strata, [True] * len(strata), budget)


def _met(strata: list[Stratum], budget: float) -> Additions:
    """A larger round for strata that have met so little light that its scatter says nothing of the error; empty if
    there are none, or if the round would exceed the budget."""
    scarcely = [of.scarcely_met for of in strata]
    return _larger(strata, scarcely, budget) if any(scarcely) else []


def _larger(strata: list[Stratum], which: list[bool], budget: float) -> Additions:
    """A round `SEARCH_GROWTH` times as large as the last one for some strata; empty if it would exceed the budget."""
    more = [SEARCH_GROWTH * of.rounds[-1].each * grows for of, grows in zip(strata, which, strict=True)]
    rays = sum(of.rays + of.rays_per_sample * each * REPLICATES for of, each in zip(strata, more, strict=True))
    return [] if rays > budget else [(each, REPLICATES) for each in more]


def _confirming(strata: list[Stratum]) -> Additions:
    """A quarter more samples for strata that matter and have had only their first round, which nothing has confirmed
    yet; empty if all are confirmed."""
    variances = [total_variance(stratum.scatters()) for stratum in strata]
    once = [len(of.rounds) < ROUNDS_AT_LEAST and v > MATTERS * sum(variances)
            for of, v in zip(strata, variances, strict=True)]  # fmt: skip
    more = [_up_to(of, (1.25 * of.samples + REPLICATES) * which) for of, which in zip(strata, once, strict=True)]
    return more if any(once) else []


def _up_to(stratum: Stratum, samples: float) -> tuple[int, int]:
    """Samples of each laser point in each replicate, and replicates, that bring a stratum to about `samples` of each
    laser point over all rounds."""
    new = samples - stratum.samples
    if new <= TOO_FEW * stratum.samples:
        return 0, REPLICATES
    each = 1 << max(0, int(math.log2(max(new / REPLICATES, 1.0))))
    return each, min(2 * REPLICATES, max(REPLICATES, math.ceil(new / each)))


def _next_round(strata: Sequence[Stratum], goal: float, budget: float) -> Additions:
    """The cheapest round that is predicted to bring the variance down to `goal`, or the largest round allowed if that
    is smaller; empty if the rays that are left allow no round."""
    worth = [math.sqrt(of.variance_of_one / max(of.cost_per_sample, 1e-9)) for of in strata]
    if not any(worth):
        return []
    spent = sum(stratum.work.cost for stratum in strata)

    def at(scale: float) -> Additions:
        wanted = [scale * w for w in worth]
        whole = sum(n * of.cost_per_sample for n, of in zip(wanted, strata, strict=True))
        return [
            _up_to(of, max(n, WITHOUT_VARIANCE * whole / of.cost_per_sample))
            for n, of in zip(wanted, strata, strict=True)
        ]

    def enough(round_of: Additions) -> bool:
        return sum(of.variance_after(*more) for of, more in zip(strata, round_of, strict=True)) <= goal

    def too_much(round_of: Additions) -> bool:
        cost = rays = 0.0
        for of, (each, replicates) in zip(strata, round_of, strict=True):
            cost += each * replicates * of.cost_per_sample + (each > 0) * replicates * of.cost_per_replicate
            rays += of.rays + of.rays_per_sample * each * replicates
        return cost > GROWTH * spent or rays > budget

    # From less than what is there, in steps that are finer than the powers of two that samples come in.
    scale = min(of.samples / w for of, w in zip(strata, worth, strict=True) if w > 0) / 2
    chosen = at(scale)
    while not enough(chosen):
        scale *= 1.07
        if too_much(at(scale)):
            break
        chosen = at(scale)
    if not any(each for each, _ in chosen):
        worst = max(strata, key=lambda of: total_variance(of.scatters()))
        chosen = [_up_to(of, (1.25 * of.samples + REPLICATES) * (of is worst)) for of in strata]
    return [] if too_much(chosen) else chosen


def _estimate(problem: Problem, strata: list[Stratum], rounds: int, bound: float, outcome: str) -> Estimate:
    """The estimate with the mean over all rounds, the standard error, and the record of what was spent."""
    components: dict[str, Floats] = {}
    parts: dict[str, Floats] = {}
    variance, overflow = np.zeros(problem.capture.shape), np.zeros(problem.capture.shape[:2])
    samples, costs, ways, points = dict[str, float](), dict[str, float](), dict[str, str](), dict[str, int]()
    for stratum in strata:
        variance += stratum.variance / stratum.samples**2
        overflow += stratum.overflow / stratum.samples
        of_components, of_parts = split_rows(
            [row / stratum.samples for row in stratum.rows], stratum.problem.tally_rows
        )
        parts |= of_parts
        for name, values in of_components.items():
            components[name] = components[name] + values if name in components else values
            samples[name] = samples.get(name, 0.0) + stratum.samples
            costs[name] = costs.get(name, 0.0) + stratum.work.cost / len(of_components)
            way = "walk" if stratum.observed is None else "factorised"
            ways[name] = "walk + factorised" if ways.get(name, way) != way else way
            points[name] = int(stratum.problem.accuracy.fov_samples)
    total, requested = sum(costs.values()), problem.tally_rows.components
    spend = Spend(
        lookins={name: samples[name] for name in requested},
        share={name: costs[name] / total for name in requested},
        way={name: ways[name] for name in requested}, fov_samples={name: points[name] for name in requested},
        rounds=rounds, cost=total, outcome=outcome,
    )  # fmt: skip
    target, work = problem.accuracy.target, sum((of.work for of in strata), start=Work(calls=0))
    return Estimate(
        {name: components[name] for name in requested}, parts, np.sqrt(variance), overflow, spend, bound,
        target is not None and bound <= target, rays=rays_of(problem, work),
    )  # fmt: skip


@dataclass(frozen=True)
class Forecast:
    """The cost of sampling all components of a problem until their L2 error is `wanted` photons."""

    problem: Problem
    wanted: float

    def costs_less_than(self, cost: float) -> bool:
        """Whether sampling costs less than `cost`; False, without a look, where rounds that meet enough light to tell
        would not be cheap beside `cost`."""
        stratum, each = self.stratum, _first_samples(self.problem)
        while not stratum.rounds or stratum.scarcely_met:
            each = SEARCH_GROWTH * stratum.rounds[-1].each if stratum.rounds else each
            if cost <= LOOK_FROM * self._cost_of_round(each):
                return False
            stratum.sample(each, REPLICATES, next(self.seeds))
        # Extrapolated from rounds whose variance falls inversely with the number of samples.
        variance = total_variance(stratum.scatters())
        return cost > stratum.work.cost + stratum.work.marginal_cost * variance / self.wanted**2

    @cached_property
    def stratum(self) -> Stratum:
        """The components, with the rounds that were sampled so far."""
        return Stratum(with_usual_fov_samples(self.problem))

    @cached_property
    def seeds(self) -> Iterator[int]:
        """Seeds of the rounds to come."""
        return _seeds(self.problem.seed)

    def _cost_of_round(self, each: int) -> float:
        """Cost of a round with `each` samples of each laser point in each replicate."""
        samples, capture = each * REPLICATES, self.problem.capture
        vertices = samples * len(self.problem.points.part)
        # Two rays of each sample; and FoV points, which the laser points share.
        rays = 2.0 * vertices + samples * len(capture.sensor.pixels)
        return Work(rays, vertices * capture.shape[1], REPLICATES * math.prod(capture.shape)).cost
