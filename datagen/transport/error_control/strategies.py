"""What first rounds decide: FoV points for each vertex, what shares a walk, and how the secondary is found."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from datagen.records.arrays import Bools, Ints
from datagen.seeding import LightStream
from datagen.transport.error_control.allocation import REPLICATES
from datagen.transport.error_control.confidence import total_variance
from datagen.transport.error_control.cost import RAY, Work
from datagen.transport.error_control.strata import Known, Stratum, square_norm, with_fov_samples
from datagen.transport.error_control.surroundings import CONTACT, surroundings
from datagen.transport.factorised.secondary import factorising
from datagen.transport.problem import Problem, part_of
from datagen.transport.sampling import stream_seeds

SEEDS_PER_ROUND = 8
FIRST_LOOKINS = 4096
"""Lookins of a first round over all laser points, between the bounds of the next line for each of them."""
FIRST_EACH = (4, 64)
"""Fewest and most lookins of a first round in each replicate of each laser point; powers of two."""
FOV_CHOICES = (1, 4, 16, 64)
"""FoV points for each vertex that are tried."""
CONNECTIONS_AT_MOST = 128
"""Most connections of a vertex, over its pixels, that are tried: beyond, the ray that led to it costs nothing."""
FINE_PATCH = 4.0
"""Patches smaller than so many bins (or hundredths of the scene) look the same all over: one FoV point does."""
FOV_TRIAL_LASERS = 8
OBSERVED = 64
LASERS_AT_MOST = 16
"""Confocal laser points up to which the factorised form is tried: it shares nothing between them."""
USUAL_FOV_SAMPLES, USUAL_CONNECTIONS = 4, 16
WORTH_TRYING_FOV = 4.0
"""Cost to go, in first rounds, from which other numbers of FoV points than the usual are tried."""
WORTH_CHANGING_FOV = 0.75
"""Largest variance × cost, relative to the usual number of FoV points, for which another is taken: first rounds are
noisy, and what the usual number gave is lost."""
WORTH_LOOKING = 30.0
"""Cost to go, in first rounds, from which other ways than one walk for everything are tried."""
LOOKINS_WORTH_LOOKING = 1 << 17
"""Limits of the lookins under which looking around would take too many of them."""
LOOK_FROM = 10.0
"""Cost of another way, in first rounds of a walk, from which one is made to compare with."""
WORTH_SHARING = 0.8
"""Largest cost, relative to that of walks apart, for which some orders share a walk that has to begin anew."""


class Seeds:
    """Independent seeds, a fresh set for each round of each stratum."""

    def __init__(self, seed: int) -> None:
        self._seed, self._used = seed, 0

    def draw(self) -> list[int]:
        """The seeds of one round, one for each number of lookins in it."""
        numbers = np.arange(self._used, self._used + SEEDS_PER_ROUND)
        self._used += SEEDS_PER_ROUND
        high, low = (stream_seeds(self._seed, LightStream.TARGET_HALVES, half, numbers) for half in (0, 1))
        return [int(h) << 32 | int(w) for h, w in zip(high, low, strict=True)]


def _first_points(task: Problem) -> Ints:
    """(L,) lookins for each replicate of a first round."""
    lasers = len(task.points.part)
    wanted = FIRST_LOOKINS // (REPLICATES * lasers)
    count = int(np.clip(1 << max(wanted, 1).bit_length() - 1, *FIRST_EACH))
    return np.full(lasers, count)


def first_rounds(
    task: Problem, target: float, seeds: Seeds, known: Known | None = None
) -> tuple[list[Stratum], float]:
    """The strata to work with, each with a first round, and the cost of what was tried and left.

    One walk for everything is the first thing tried. Only where meeting the target will cost more than looking around
    are other numbers of FoV points tried; only where it costs far more, its orders apart, and the secondary in its
    factorised form.
    """
    task, tried = with_fov_samples(task, _usual_fov_samples(task)), 0.0
    asked, points = task.splits.components, _first_points(task)
    factor, ranked = factorising(task.materials), task.accuracy.strongest is not None
    walked = ~factor if ranked else np.ones(len(factor), np.bool_)
    strata = []
    if "direct" in asked:
        strata.append(_sampled(Stratum(_of_components(task, ("direct",), walked)), points, seeds))
    orders = tuple(n for n in asked if n != "direct" and (n != "secondary" or walked.any()))
    ranking = ranked and "secondary" in asked and bool(factor.any())
    if ranking:
        strata.append(_sampled(_factorised(task, factor, task.accuracy.observed or OBSERVED), points, seeds))
    if not orders:
        return strata, tried
    joint = _sampled(Stratum(_of_components(task, orders, walked)), points, seeds)
    if ranking:
        return [*strata, joint], tried
    to_go = _cost_to_go(joint, [*strata, joint], target, known)
    if to_go > WORTH_TRYING_FOV * joint.work.cost:
        best, more = _with_best_fov_samples(task, seeds)
        tried += more
        if best.accuracy.fov_samples != task.accuracy.fov_samples:
            other = _sampled(Stratum(_of_components(best, orders, walked)), points, seeds)
            if _price([other]) < _price([joint]):
                task, joint, other = best, other, joint
            tried += other.work.cost
            to_go = _cost_to_go(joint, [*strata, joint], target, known)
    short = task.accuracy.max_lookins < LOOKINS_WORTH_LOOKING
    separable = bool(factor.any()) and "secondary" in orders and not short
    contact = separable and surroundings(task, seeds.draw()[0]) > max(CONTACT, target)
    if not contact and (len(orders) == 1 or short or to_go < WORTH_LOOKING * joint.work.cost):
        return [*strata, joint], tried
    apart = [_sampled(Stratum(_of_components(task, (name,), walked)), points, seeds) for name in orders]
    shared = task.capture.pairing == "exhaustive" or len(points) <= LASERS_AT_MOST
    if separable and (contact or shared):
        apart, more = _with_better_secondary(task, apart, factor, points, seeds, contact)
        tried += more
    if contact:
        return [*strata, *apart], tried + joint.work.cost
    found, more = _with_shared_walks(task, joint, apart, points, seeds)
    return [*strata, *found], tried + more


@dataclass(frozen=True)
class ForecastWalk:
    """What a walk for all components of a task will cost, with an L2 error of `wanted` photons."""

    task: Problem
    wanted: float

    def costs_less_than(self, cost: float) -> bool:
        """Whether it costs less. It is looked into where that costs little beside."""
        points, capture = _first_points(self.task) * float(REPLICATES), self.task.capture
        # Two rays of each lookin; and FoV points, which the laser points share.
        rays = 2.0 * points.sum() + points.max() * len(capture.sensor.pixels)
        look = Work(rays, points.sum() * capture.shape[1], REPLICATES * math.prod(capture.shape)).cost
        return cost > LOOK_FROM * look and cost > self.cost

    @cached_property
    def cost(self) -> float:
        """The cost by the variance of a first round, which falls with the number of lookins."""
        task = with_fov_samples(self.task, _usual_fov_samples(self.task))
        stratum = _sampled(Stratum(task), _first_points(task), Seeds(task.seed))
        variance = total_variance(stratum.scatters())
        return stratum.work.cost + stratum.work.growing * variance / self.wanted**2


def _sampled(stratum: Stratum, points: Ints, seeds: Seeds) -> Stratum:
    """The stratum with its first round."""
    stratum.sample(points, REPLICATES, seeds.draw())
    return stratum


def _cost_to_go(joint: Stratum, strata: list[Stratum], target: float, known: Known | None) -> float:
    """About what one walk for everything would cost to meet the target, its variance taken as ∝ 1/lookins."""
    variance = total_variance(joint.scatters())
    norm = square_norm(strata, known)
    wanted = target**2 * max(norm - variance, 0.1 * norm) - (0.0 if known is None else known.error**2)
    return joint.work.growing * variance / wanted if wanted > 0 else 0.0


def _of_components(task: Problem, components: tuple[str, ...], walked: Bools) -> Problem:
    parts = task.splits.parts if "primary" in components else ()
    return replace(task, splits=replace(task.splits, components=components, parts=parts), walked=walked)


def _factorised(task: Problem, carriers: Bools, observed: int) -> Stratum:
    return Stratum(_of_components(task, ("secondary",), ~carriers), observed, carriers)


def _usual_fov_samples(task: Problem) -> int:
    """FoV points for each vertex to begin with: several for few pixels whose patches are large."""
    if task.patch_detail(np.arange(len(task.patches.radius))) < FINE_PATCH:
        return 1
    room = max(USUAL_CONNECTIONS // task.capture.shape[1], 1)
    return min(USUAL_FOV_SAMPLES, 1 << room.bit_length() - 1)


def _with_best_fov_samples(task: Problem, seeds: Seeds) -> tuple[Problem, float]:
    """Try numbers of FoV points on the primary of some laser points, in rising order for as long as that pays: more
    of them lower the variance and save rays. It falls by more than 1/M where the pixel is smooth, so nothing is
    interpolated."""
    pixels = task.capture.shape[1]
    choices = [m for m in FOV_CHOICES if m * pixels <= CONNECTIONS_AT_MOST]
    if len(choices) < 2 or task.accuracy.fov_samples == 1:
        return task, 0.0
    existing = np.flatnonzero(task.points.part >= 0)
    few = existing[np.linspace(0, len(existing) - 1, min(len(existing), FOV_TRIAL_LASERS)).astype(int)]
    some = part_of(_of_components(task, ("primary",), task.walked), np.unique(few))
    prices: dict[int, float] = {}
    spent = 0.0
    for samples in choices:
        stratum = _sampled(Stratum(with_fov_samples(some, samples)), _first_points(some), seeds)
        spent += stratum.work.cost
        prices[samples] = _price([stratum])
        if prices[samples] > min(prices.values()):
            break
    best = min(prices, key=lambda samples: prices[samples])
    worth = prices[best] < WORTH_CHANGING_FOV * prices.get(task.accuracy.fov_samples, np.inf)
    return (with_fov_samples(task, best) if worth else task), spent


def _with_better_secondary(
    task: Problem, strata: list[Stratum], factor: Bools, points: Ints, seeds: Seeds, contact: bool
) -> tuple[list[Stratum], float]:
    """The factorised form for the secondary of Lambertian lookins, where variance × cost is less than by the walk, or
    where the walk's own variance is not to be believed (`contact`)."""
    place = next(k for k, stratum in enumerate(strata) if stratum.components == ("secondary",))
    walk = strata[place]
    replacements = [_factorised(task, factor, OBSERVED)]
    if not factor.all():
        replacements.append(Stratum(_of_components(task, ("secondary",), ~factor)))
    for stratum in replacements:
        _sampled(stratum, points, seeds)
    if contact or _price(replacements) < _price([walk]):
        return strata[:place] + replacements + strata[place + 1 :], walk.work.cost
    return strata, sum(stratum.work.cost for stratum in replacements)


def _price(strata: list[Stratum]) -> float:
    """Variance × cost of the best division between strata: (Σ √(variance cost))²."""
    return sum(float(np.sqrt((s.scale * s.points).sum() * s.growing)) for s in strata) ** 2


def _with_shared_walks(
    task: Problem, joint: Stratum, apart: list[Stratum], points: Ints, seeds: Seeds
) -> tuple[list[Stratum], float]:
    """The walk for all orders, or walks apart, or some orders joined: walks apart repeat each other's rays."""
    of_joint, of_apart = _price([joint]), _price(apart)
    lost = sum(stratum.work.cost for stratum in apart)
    if of_joint <= of_apart:
        return [joint], lost
    if any(stratum.observed is not None for stratum in apart) or len(apart) < 3:
        return apart, joint.work.cost
    best, groups = min(((_shared_price(way), way) for way in _divisions(apart)), key=lambda pair: pair[0])
    if best > WORTH_SHARING * min(of_apart, of_joint):
        return apart, joint.work.cost
    kept, lost = [], joint.work.cost
    for group in groups:
        if len(group) == 1:
            kept.append(group[0])
            continue
        lost += sum(stratum.work.cost for stratum in group)
        together = _of_components(task, sum((s.components for s in group), ()), group[0].task.walked)
        kept.append(_sampled(Stratum(together), points, seeds))
    return kept, lost


def _divisions(orders: list[Stratum]) -> list[list[list[Stratum]]]:
    """All ways to cut a row of strata into runs."""
    if not orders:
        return [[]]
    return [[orders[:k], *rest] for k in range(1, len(orders) + 1) for rest in _divisions(orders[k:])]


def _shared_price(groups: list[list[Stratum]]) -> float:
    """As `_price`, where each group is one walk: the rays of its highest order, the connections of all."""
    price = 0.0
    for group in groups:
        lookins = [float(s.weight.sum()) for s in group]
        cost = RAY * group[-1].work.rays / lookins[-1]
        cost += sum(s.work.connections / n for s, n in zip(group, lookins, strict=True))
        price += float(np.sqrt(sum((s.scale * s.points).sum() for s in group) * cost))
    return price**2
