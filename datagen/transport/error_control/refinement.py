"""How finely surfaces and pixels are cut, found on some pairs of laser point and pixel that stand for all.

Each object is a group of its own, and all other parts together are one. A run gathers the light of the trial's pairs
with a cutting: for each group, the L2 error that one element may make. Cuttings get finer until the difference
between runs is small in the whole and in each object's own light. Elements of one group may all make the same error,
for then a given number of them brings the group nearest to the truth. A difference between two runs is an estimate of
the error only if the finer run did more work: small triangles stay whole over many cuttings, and two runs of the same
elements agree however wrong they are.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace

import numpy as np

from datagen.records.arrays import Bools, Floats, Ints, l2_norm
from datagen.transport.error_control.cost import CELL, CELL_RAY
from datagen.transport.quadrature.gathering import EDGE_LEVELS, Gathered, Gathering, Seen

TRIALS, MOST_TRIED = (12, 48), 1 << 23
"""Fewest and most pairs of laser point and pixel on which the cutting is chosen, one in 32 in between; and values
of their histograms at most."""
COARSE = 1e300
"""L2 error that every element may make in the coarsest cutting: surfaces are then cut by distance alone."""
FIRST, FINER, LEVELS = 0.03, 0.25, 12
"""Error that an element may make in the second cutting, relative to the norm of its group; factor of that error
from one cutting to the next; and most cuttings."""
GROWN = 1.5
"""Factor by which a run must have more elements than another for their difference to be an estimate of error."""
SURE = 3
"""Number of cuttings after the coarsest before differences are taken as estimates of error: the first cuttings
lack the same light, and where all light is in one bin two of them may agree by chance."""
FALLS = 0.55
"""Factor by which the last difference must be smaller than the one before it, where the finest cutting that was
tried is chosen itself: without that decrease nothing tells how large the remaining error is."""
REST = 1.6
"""Error of a cutting, relative to its difference from the next one: errors fall to about 0.4 from one cutting to the
next, and 1 + 0.4 + 0.16 + … ≈ 1.6."""
LOOKS = 4
"""Most runs with the coarsest cutting, each with other random points, in search of a group's first light."""
SETTLED = 0.3
"""Error of one of G groups, relative to 1/√G of the error asked of the whole, below which it is not cut more
finely for the sake of the whole."""
UNSEEN, UNSEEN_BY_RAYS = 1e-4, 1e-2
"""Least norm, relative to the whole, that a group is taken to have when its cutting is chosen; and that of a group
whose light comes by rays, where half of it sends twice as many rays to what may turn out to be hidden."""
NEGLIGIBLE, NEGLIGIBLE_BY_RAYS = 1e-9, 1e-5
"""Norm of a part, relative to the whole, up to which no error is claimed for its own light, because the finest of
`LEVELS` cuttings does not resolve it; and the same for a mesh whose light comes by rays, which hardly ever meet
it."""
LOOKED_AT, EVENLY = 12, 0.25
"""Pairs whose light is computed roughly, for each that is drawn for the trial; and weight of an even draw beside
one by light."""
HELPS = 0.1
"""Error of one of G groups, relative to 1/G of the error asked of the whole, below which cutting it more finely
does not help the whole."""
TOO_DEAR = 1 << 16
"""Elements and rays for one histogram, from which on an object is not cut more finely for the sake of its own
light: what is nearly hidden may take any number of rays for a millionth of the light."""
RAYS_CHEAPER = 2.0
"""Number of rays of a lattice, with the connections of their hits, that cost about as much as one element with its
shadow rays."""
WITHIN = 0.7
"""Largest estimate of error on the trial's pairs, relative to the error asked, that is accepted: other pairs may be
worse."""
BETWEEN, HALVINGS, WIDELY, TINY = 8, 60, 60.0, 1e-150
"""Cuttings considered between two that were tried; halvings of the range of the Lagrange multiplier, and the range's
extent in powers of e; and a number too small to divide by."""
MOST_PATCHES, MOST_PATCHES_TRIED = 1 << 22, 1 << 18
"""Most footprints of all pixels, and most points of the trial's pixels at edges."""
PATCHES_SHARE = 0.2
"""Share of the error asked that the size of footprints may cause."""
MOST_LEVELS, FROM_LARGER, FINEST_SHARE = 6, 1 / 3, 0.5
"""Most times that pixels of the trial are quartered; error of footprints, relative to their difference from
footprints twice as large, for it is of second order; and share of `PATCHES_SHARE` that the finest footprints may
have."""
FROM_FEWER, SLOWEST = 0.5, 0.4
"""Error of a net of points, relative to its difference from a net of a quarter as many: beside an edge it is of order
3/4 in their number; and least difference, relative to the one before it, that is taken, for it may be small by
chance."""


@dataclass(frozen=True)
class Asked:
    """The relative L2 errors that are asked of the whole (`target`) and of each object's own light (`part_target`).

    faint : energy, photons per emitted photon over all histograms, below which `part_target` does not apply.
    objects : (K,) which parts are objects. The other parts are one group, the first of G.
    """

    target: float
    part_target: float
    faint: float
    objects: Bools

    @property
    def group(self) -> Ints:
        """(K,) number of the group of each part."""
        return np.where(self.objects, np.cumsum(self.objects), 0)


@dataclass
class Work:
    """Numbers of elements and of rays so far."""

    cells: int = 0
    rays: int = 0


@dataclass(frozen=True)
class Trial:
    """Pairs of laser point and pixel that represent all pairs; bright ones are drawn more often.

    Attributes
    ----------
    pairs : (n, 2).
    weight : (n,) number of pairs that each represents.
    group : (K,) number of each part's group.
    scale : (G,) norm of each group over all pairs, relative to that over these pairs with their weights, as a rough
        computation of many pairs finds it.
    levels : most times that their pixels are quartered in the first runs.
    """

    gathering: Gathering
    pairs: Ints
    weight: Floats
    group: Ints
    scale: Floats
    levels: int
    work: Work
    seen: dict[tuple[int, int | None], list[Seen]] = field(default_factory=dict)

    @classmethod
    def of(cls, gathering: Gathering, lit: Ints, asked: Asked) -> Trial:
        """A trial drawn from the pairs `lit` (n, 2) by their light, computed roughly: half by the light of the
        whole, half by that of each object, since a few pairs may have all the light of an object, and all its
        error."""
        task, group = gathering.task, asked.group
        groups = 1 + int(group.max())
        wanted = _trials(len(lit), groups * task.capture.time.bins)
        looked = lit[spread_evenly(len(lit), LOOKED_AT * wanted)]
        rough = cls(
            gathering, looked, np.full(len(looked), len(lit) / max(len(looked), 1)), group, np.ones(groups),
            gathering.levels(), Work(),
        )  # fmt: skip
        if len(looked) <= wanted:
            return rough
        seen = rough.gathered(np.full(groups, COARSE), 0, EDGE_LEVELS[0]).histogram
        if rough.gathering.lobed:
            # Coarse elements may miss lobes, and with them the pairs that have most of the light.
            seen = seen + rough.gathered(np.full(groups, COARSE), 0, EDGE_LEVELS[0], matt=True).histogram
        whole, own = (seen.sum(axis=1) ** 2).sum(axis=1), (seen**2).sum(axis=2)
        places, stands_for = by_light(np.sqrt(np.column_stack([whole, own[:, 1:]])), wanted)
        of_all, of_these = own.sum(axis=0), stands_for @ own[places]
        scale = np.sqrt(np.divide(of_all, of_these, where=of_these > 0, out=np.ones(groups)))
        weight = stands_for * len(lit) / len(looked)
        return cls(gathering, looked[places], weight, group, scale, rough.levels, rough.work)

    @property
    def by_rays(self) -> Bools:
        """(G,) whether the light of all parts of a group comes by rays."""
        return np.asarray(np.bincount(self.group, ~self.gathering.by_rays, len(self.scale)) == 0)

    def some(self, which: Bools) -> Trial:
        """The trial with only some of its pairs."""
        return replace(self, pairs=self.pairs[which], weight=self.weight[which], seen={})

    def gathered(
        self, cutting: Floats, levels: int, edge_levels: int | None = None, draw: Ints | None = None,
        matt: bool = False,
    ) -> Gathered:  # fmt: skip
        """Their histograms with each group apart, such that squares add up to those of all pairs, and its elements
        and rays. `cutting` and `draw` are (G,)."""
        asked = levels, edge_levels
        if asked not in self.seen:
            self.seen[asked] = list(self.gathering.seen(self.pairs, levels, edge_levels))
        draw = None if draw is None else draw[self.group]
        found = self.gathering.gathered(self.pairs, self.seen[asked], cutting[self.group], self.group, draw, matt)
        cells, rays = (
            np.bincount(self.group, work, len(cutting)).astype(np.int64) for work in (found.cells, found.rays)
        )
        self.work.cells += int(cells.sum())
        self.work.rays += int(rays.sum())
        histogram = found.histogram * np.sqrt(self.weight)[:, None, None] * self.scale[:, None]
        return Gathered(histogram, found.overflow, cells, rays)

    def energy(self, histogram: Floats) -> Floats:
        """(G,) photons of each group in all pairs."""
        return np.asarray(np.einsum("nkt,n->k", histogram, np.sqrt(self.weight)) / self.scale)


@dataclass(frozen=True)
class Choice:
    """The chosen cutting, and estimates of the errors that it leaves.

    Attributes
    ----------
    cutting : (G,) L2 error that one element may make.
    tried, draw : (G,) the finer cutting that `histogram` was gathered with, and the number of its draw.
    error, whole : L2 error and L2 norm of the whole.
    still, own : (G,) L2 error and L2 norm of each group.
    held : (G,) whether `part_target` applies to a group, even if it was given up as `TOO_DEAR`.
    limit : (G,) L2 error that the group may have, infinite where none is asked.
    histogram : (n, G, T) light of the trial's pairs.
    """

    cutting: Floats
    tried: Floats
    draw: Ints
    error: float
    whole: float
    still: Floats
    own: Floats
    held: Bools
    limit: Floats
    histogram: Floats


@dataclass
class _Runs:
    """Runs of a trial with finer and finer cuttings, the coarsest first.

    Attributes
    ----------
    histograms, cuttings, cells, costs : for each run, light (n, G, T), cutting, number of elements, and cost of each
        group (G,).
    finest : (G,) number of the finest run of each group: the last run, or that after which it was settled.
    settled, dear : (G,) whether a group is cut no more finely; and whether it took more than `TOO_DEAR` in some run.
    """

    trial: Trial
    histograms: list[Floats]
    cuttings: list[Floats]
    cells: list[Ints]
    costs: list[Floats]
    finest: Ints
    settled: Bools
    dear: Bools

    @classmethod
    def begun(cls, trial: Trial) -> _Runs:
        """The first run, with surfaces cut by distance alone."""
        groups = len(trial.scale)
        coarse, none = np.full(groups, COARSE), np.zeros(groups, np.bool_)
        found = trial.gathered(coarse, trial.levels)
        costs = CELL * found.cells + CELL_RAY * found.rays
        return cls(trial, [found.histogram], [coarse], [found.cells], [costs], np.zeros(groups, np.int64), none, none)

    def light_to_cut_for(self) -> Floats:
        """(n, G, T) largest light of each group that several runs with the coarsest cutting find."""
        groups, scale, draw = len(self.finest), self.histograms[0], 1
        # One ray for a whole face may miss what it sees of it.
        while draw < LOOKS and not _norms(scale).all():
            again = self.trial.gathered(np.full(groups, COARSE), self.trial.levels, draw=np.full(groups, draw))
            scale, draw = np.maximum(scale, again.histogram), draw + 1
        if self.trial.gathering.lobed:
            # What coarse elements find of lobes may be a millionth of their light, and no measure of how fine to
            # begin; nor is what matt surfaces would bring: it may be a million times as much.
            matt = self.trial.gathered(np.full(groups, COARSE), self.trial.levels, matt=True).histogram
            scale = np.maximum(scale, matt)
        return scale

    def refine(self, cutting: Floats) -> None:
        """Add a run with a finer cutting (G,); settled groups keep the light of the run before."""
        # Points drawn anew: where clusters stay as they are, runs would else agree in what chance made of them.
        draw, settled = np.full(len(cutting), len(self.histograms)), self.settled
        found = self.trial.gathered(np.where(settled, np.inf, cutting), self.trial.levels, draw=draw)
        found.histogram[:, settled] = self.histograms[-1][:, settled]
        self.histograms.append(found.histogram)
        self.cuttings.append(np.where(settled, self.cuttings[-1], cutting))
        self.cells.append(np.where(settled, self.cells[-1], found.cells))
        self.costs.append(np.where(settled, self.costs[-1], CELL * found.cells + CELL_RAY * found.rays))
        self.dear = self.dear | (
            found.cells + found.rays
            > TOO_DEAR * len(self.trial.pairs) * np.where(self.trial.by_rays, RAYS_CHEAPER, 1.0)
        )
        self.finest[~settled] = len(self.histograms) - 1

    def tell_of_error(self, in_scale: Floats) -> Bools:
        """(G,) whether a group's difference between runs is an estimate of its error: the finer run has more elements
        by `GROWN`, is not among the first `SURE`, and its elements may each be wrong by less than `in_scale` (G,)."""
        sure = (self.finest >= SURE) & (self.cuttings[-1] <= in_scale)
        grown = GROWN * np.array(self.cells[:-1]) <= self.cells[-1]
        compared = np.minimum(np.arange(len(self.cells))[:, None], self.finest - 1)
        return np.asarray(grown[compared, np.arange(len(self.finest))] & sure)

    def levels(self, does: Bools, still: Floats, held: Bools, most: float) -> tuple[Ints, float]:
        """(G,) the coarsest run of each group that does (n, G), one beyond the finest where none does; and the error
        of the whole, for which groups are taken finer until it is within `most`."""
        every, groups, beyond = np.arange(len(held)), len(held), self.finest + ~self.settled
        level = np.minimum(np.argmax(np.vstack([does, np.ones(groups, np.bool_)]), axis=0), beyond)
        # The finest that is known to have been too dear, or nearly.
        level = np.where(held & self.dear, self.finest - 1, level)
        error = _whole_error(self.histograms, level, self.finest)
        while error > most:
            left = np.where(level < beyond, still[np.minimum(level, self.finest), every], 0.0)
            if groups * left.max() <= HELPS * most:
                break
            level[np.argmax(left)] += 1
            error = _whole_error(self.histograms, level, self.finest)
        return level, error


def choose(trial: Trial, asked: Asked) -> Choice | None:
    """The cheapest cutting of each group that meets the errors asked, found with finer and finer ones.

    None where no cutting does within `max_lookins`, and where no light was found, for then more must be sampled.
    """
    groups = len(trial.scale)
    every, objects, runs = np.arange(groups), np.arange(groups) > 0, _Runs.begun(trial)
    light = runs.light_to_cut_for()
    whole, own = _norm(light), _norms(light)
    if whole == 0.0:
        return None
    share, by_rays = FIRST / math.sqrt(trial.weight.sum()), trial.by_rays
    unseen = np.where(by_rays, UNSEEN_BY_RAYS, UNSEEN)
    negligible = np.where(by_rays, NEGLIGIBLE_BY_RAYS, NEGLIGIBLE)
    cutting = share / FINER * np.maximum(own, unseen * whole)
    while True:
        cutting = np.minimum(FINER * cutting, share * np.maximum(own, unseen * whole))
        before = trial.work.cells + trial.work.rays
        runs.refine(cutting)
        found, finest = runs.histograms[-1], runs.finest
        whole, own = _norm(found), _norms(found)
        if whole == 0.0:
            return None
        held = objects & (own > negligible * whole) & (trial.energy(found) >= asked.faint)
        limit = np.where(held & ~runs.dear, asked.part_target * own, np.inf)
        still, last = _still(runs.histograms, finest), len(runs.histograms) > LEVELS
        # Groups too faint to matter need not be known.
        counts = (held & ~runs.dear) | (own > asked.target * whole)
        known = runs.tell_of_error(share / FINER * np.maximum(own, unseen * whole)) | ~counts | last
        does = (still <= WITHIN * limit) & known & ~(held & runs.dear)
        most = WITHIN * asked.target * whole
        level, error = runs.levels(does, still, held, most)
        unsure = (level == finest) & counts & ~runs.settled & ~_falls(runs.histograms, finest)
        level = np.where(unsure, finest + 1, level)
        if error <= most and (level <= finest).all():
            chosen = np.stack([runs.histograms[n][:, k] for k, n in enumerate(level)], axis=1)
            # Together groups may be wrong by as much more as the whole has room for.
            room = max(most / max(error, TINY) * l2_norm(still[level, every]), TINY)
            tried = np.array(runs.cuttings)
            coarser, left = _cheapest(tried, still, np.array(runs.costs), level, finest, WITHIN * limit, room)
            error *= l2_norm(left) / max(l2_norm(still[level, every]), TINY)
            return Choice(coarser, tried[level, every], level, error, whole, left, own, held, limit, chosen)
        work = trial.work.cells + trial.work.rays
        # The next run takes as much more as elements are finer.
        beyond = work + (work - before) / FINER > trial.gathering.task.accuracy.max_lookins * len(trial.pairs)
        if last or beyond:
            return None
        # What does already is not cut further, unless the whole still wants it.
        waits = math.sqrt(groups) * still[finest, every] > SETTLED * asked.target * whole
        settled = runs.settled | ((level <= finest) & ((error <= most) | ~waits))
        runs.settled = settled & ~settled.all()


@dataclass(frozen=True)
class Quartering:
    """Times that pixels which see one flat surface are quartered (`levels`), and pixels at edges (`edge_levels`);
    L2 error that this leaves in the whole and, (G,), in each group (`of_parts`); and L2 norm of the difference
    between the light of these footprints and of those that the cutting was chosen with (`gain`)."""

    levels: int
    edge_levels: int
    error: float
    of_parts: Floats
    gain: float


def quarter(trial: Trial, choice: Choice, asked: Asked, pixels: int) -> Quartering | None:
    """The fewest quarterings of pixels that keep the error of footprints within its share of the error asked; None
    if that needs more than `MOST_PATCHES` footprints for all `pixels` (their number)."""
    at_edge = trial.gathering.at_edge[trial.pairs[:, 1]]
    edges, even = trial.some(at_edge), trial.some(~at_edge)
    most, limits = PATCHES_SHARE * asked.target * choice.whole, PATCHES_SHARE * choice.limit
    # What comes by rays is not gathered again: its points of pixels are chosen by their distance.
    tried, runs = np.where(trial.by_rays, np.inf, choice.tried), {trial.levels: choice.histogram[~at_edge]}

    def at(levels: int) -> Floats:
        if levels not in runs:
            runs[levels] = even.gathered(tried, levels, draw=choice.draw).histogram
            runs[levels][:, trial.by_rays] = choice.histogram[~at_edge][:, trial.by_rays]
        return runs[levels]

    # Of a surface that is close before a pixel the finest footprints may be too large, too.
    finest, still, of_parts = trial.levels, 0.0, np.zeros(len(limits))
    while finest > 0:
        change = FROM_LARGER * (at(finest) - at(finest - 1))
        still, of_parts = _norm(change), _norms(change)
        if finest == MOST_LEVELS or (still <= FINEST_SHARE * most and (of_parts <= FINEST_SHARE * limits).all()):
            break
        finest += 1
    # From the finest on, for what they cost falls by as much as their number.
    coarsest, error, errors = finest, still, of_parts
    while coarsest > 0:
        change = at(finest) - at(coarsest - 1)
        more, of_each = _norm(change) + still, _norms(change) + of_parts
        if more > most or (of_each > limits).any():
            break
        coarsest, error, errors = coarsest - 1, more, of_each
    too_many = coarsest > 0 and pixels * 4 ** (coarsest + 1) > MOST_PATCHES
    if too_many or error > most or (errors > limits).any():
        return None
    edge_levels, beside, of_each = _at_edges(edges, choice, asked, choice.histogram[at_edge])
    gain = _norm(at(coarsest) - at(trial.levels))
    return Quartering(coarsest, edge_levels, math.hypot(error, beside), np.hypot(errors, of_each), gain)


def _at_edges(edges: Trial, choice: Choice, asked: Asked, finer: Floats) -> tuple[int, float, Floats]:
    """Times that pixels at edges are quartered, and the L2 error of their points in the whole and, (G,), in each
    group.

    They are quartered until that error fits beside that of elements, or the number of points reaches its limit.
    finer : (n, G, T) light of the trial's pixels at edges with the fewest quarterings.
    """
    level, at_edge = edges.gathering.edge_levels(), int(edges.gathering.at_edge.sum())
    if len(edges.pairs) == 0:
        return level, 0.0, np.zeros(len(choice.own))
    left = (asked.target * choice.whole) ** 2 - choice.error**2
    left_of_part = np.where(choice.held, choice.limit**2 - choice.still**2, np.inf)
    coarsest, coarser = (edges.gathered(choice.tried, 0, max(level - k, 0), choice.draw).histogram for k in (2, 1))
    error, of_parts = FROM_FEWER * _norm(coarser - coarsest), FROM_FEWER * _norms(coarser - coarsest)
    while True:
        change = FROM_FEWER * (finer - coarser)
        error, of_parts = max(_norm(change), SLOWEST * error), np.maximum(_norms(change), SLOWEST * of_parts)
        enough = error**2 <= left and (of_parts**2 <= left_of_part).all()
        points = 4 ** (level + 1)
        if enough or at_edge * points > MOST_PATCHES or len(edges.pairs) * points > MOST_PATCHES_TRIED:
            return level, error, of_parts
        level += 1
        coarser, finer = finer, edges.gathered(choice.tried, 0, level, choice.draw).histogram


def _cheapest(
    cuttings: Floats, still: Floats, costs: Floats, level: Ints, finest: Ints, limit: Floats, most: float
) -> tuple[Floats, Floats]:
    """(G,) the cuttings of least cost whose errors are each within `limit` (G,) and together, added as squares,
    within `most`; and these errors (G,).

    Between two cuttings that were tried, errors and costs are interpolated as powers of the cutting. The cuttings of
    run `level` (G,) meet the limits, and are returned where nothing cheaper is known.
    """
    steps, groups = np.arange(len(still) * BETWEEN) / BETWEEN, len(level)
    cutting, error, cost = (np.empty((len(steps), groups)) for _ in range(3))
    for g in range(groups):
        # The last ones, each a step finer than the one before: nothing is known of what lies in a jump.
        jumps = cuttings[1 : finest[g] + 1, g] < 0.9 * FINER * cuttings[: finest[g], g]
        first = 1 + np.flatnonzero(jumps).max(initial=-1)
        known = np.arange(first, finest[g] + 1) if level[g] >= first else level[g : g + 1]
        # What is cut more finely is never taken to be more wrong.
        errors = np.maximum.accumulate(np.maximum(still[known, g], TINY)[::-1])[::-1]
        at = np.clip(steps, known[0], known[-1])
        for found, values in ((cutting, cuttings[known, g]), (error, errors), (cost, np.maximum(costs[known, g], 1))):
            found[:, g] = np.exp(np.interp(at, known, np.log(values)))
        cost[error[:, g] > max(limit[g], still[level[g], g]), g] = np.inf
    every, some = np.arange(groups), cost[np.isfinite(cost)]
    low, high = math.log(some.min() / most**2) - WIDELY, math.log(some.max() / most**2) + WIDELY
    for _ in range(HALVINGS):
        price = 0.5 * (low + high)
        which = np.argmin(cost + np.exp(price) * error**2, axis=0)
        low, high = (price, high) if l2_norm(error[which, every]) > most else (low, price)
    which = np.argmin(cost + np.exp(high) * error**2, axis=0)
    return cutting[which, every], error[which, every]


def _still(runs: list[Floats], finest: Ints) -> Floats:
    """(runs, G) estimated L2 error of each group in each run; `finest` (G,) is the number of a group's finest run."""
    every = np.arange(len(finest))
    last = runs[-1]
    still = np.array([_norms(run - last) for run in runs])
    return np.asarray(still + (REST - 1) * still[finest - 1, every])


def _falls(runs: list[Floats], finest: Ints) -> Bools:
    """(G,) whether the last difference of each group is smaller than the one before by `FALLS`."""
    last = [np.linalg.norm(runs[n][:, k] - runs[n - 1][:, k]) for k, n in enumerate(finest)]
    before = [np.linalg.norm(runs[n - 1][:, k] - runs[max(n - 2, 0)][:, k]) for k, n in enumerate(finest)]
    return np.array(last) <= FALLS * np.array(before)


def _whole_error(runs: list[Floats], level: Ints, finest: Ints) -> float:
    """Estimated L2 error of the sum over groups, where each group is taken from run `level` (G,)."""
    last = runs[-1].sum(axis=1)
    chosen = sum(runs[min(n, len(runs) - 1)][:, k] for k, n in enumerate(level))
    before = sum(runs[n - 1][:, k] for k, n in enumerate(finest))
    return l2_norm(chosen - last) + (REST - 1) * l2_norm(before - last)


def _norm(histograms: Floats) -> float:
    """L2 norm of the sum over groups of (n, G, T)."""
    return l2_norm(histograms.sum(axis=1))


def _norms(histograms: Floats) -> Floats:
    """(G,) L2 norm over laser points, pixels and bins of (n, G, T)."""
    return np.asarray(np.sqrt((histograms**2).sum(axis=(0, 2))))


def by_light(norms: Floats, wanted: int) -> tuple[Ints, Floats]:
    """Indices of at most `wanted` rows, drawn by their norms (n, K), and the number of rows that each represents.

    The first column counts as much as all others together. The brightest rows are always among those drawn. If errors
    were alike in all rows, an even draw would be best; if they went with the light, a draw by its square: the norm is
    in between.
    """
    count = len(norms)
    if count <= wanted:
        return np.arange(count), np.ones(count)
    share, whole, objects = np.full(count, EVENLY / count), norms[:, 0], norms[:, 1:]
    objects = objects[:, objects.sum(axis=0) > 0]
    if whole.any():
        share += 0.5 * whole / whole.sum()
    if objects.shape[1]:
        share += 0.5 * (objects / objects.sum(axis=0)).mean(axis=1)
    return _drawn(share, wanted)


def _drawn(share: Floats, wanted: int) -> tuple[Ints, Floats]:
    """Indices drawn with probabilities `share`, and the number of rows that each represents: rows whose share is
    worth a draw of its own are all taken, of the others one in each equal step along the running sum of shares."""
    certain, left = np.zeros(len(share), np.bool_), wanted
    while left > 0:
        others = np.where(certain, 0.0, share)
        more = ~certain & (left * others >= others.sum())
        if not more.any():
            break
        certain |= more
        left = wanted - int(certain.sum())
    places = np.flatnonzero(certain)
    if left <= 0:
        return places, np.ones(len(places))
    running = np.cumsum(others)
    drawn = np.searchsorted(running, (np.arange(left) + 0.5) / left * running[-1] * (1 - 1e-12))
    stands_for = running[-1] / (left * others[drawn])
    order = np.argsort(np.concatenate([places, drawn]))
    return np.concatenate([places, drawn])[order], np.concatenate([np.ones(len(places)), stands_for])[order]


def _trials(pairs: int, values: int) -> int:
    """Number of pairs of a trial, out of `pairs`, whose histograms have `values` numbers each."""
    return int(np.clip(min(pairs // 32, MOST_TRIED // values), *TRIALS))


def spread_evenly(count: int, wanted: int) -> Ints:
    """At most `wanted` of `count` indices, in no step with the rows of a scan."""
    if count <= wanted:
        return np.arange(count)
    return np.unique(((np.arange(wanted) * (math.sqrt(5) - 1) / 2 + 0.5) % 1.0 * count).astype(np.int64))
