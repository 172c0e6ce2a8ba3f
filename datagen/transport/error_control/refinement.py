"""How finely surfaces and pixels are cut, found on some pairs of laser point and pixel that stand for all.

Objects, each for itself, and all else together are cut ever more finely until what that changes is small in the whole
and in each object's own light. What is no object has one error that an element may make: where it is the same
everywhere, elements bring the whole nearest to the truth for their number. A change tells of the error only where it
was one: small triangles stay as they are over many steps and agree with themselves, so that a cutting is believed
once a finer one, which agrees with it, took markedly more work.
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
"""An error that every element may make: surfaces are cut by distance alone."""
FIRST, FINER, LEVELS = 0.03, 0.25, 12
"""Error that an element may make, relative to the norm of its group, after the coarsest cutting; what it is
multiplied with from one cutting to the next, finer one; and the number of cuttings at most."""
GROWN = 1.5
"""Elements of a cutting that is finer in fact, relative to the one that it is compared with."""
SURE = 3
"""Cuttings after the coarsest from which on they are believed: the first ones lack the same light, and where all is
in one bin two of them may agree by chance."""
FALLS = 0.55
"""How much smaller the last difference has to be than the one before it, where the finest cutting tried is taken
itself: else nothing tells how much of it is left."""
REST = 1.6
"""Error of a cutting, relative to its difference from the next: errors fall to about four tenths, and
1 + 0.4 + 0.16 + … is this."""
LOOKS = 4
"""Coarsest cuttings, each with other rays, in which a group is looked for that has no light."""
SETTLED = 0.3
"""Share of the error to be met, for each of G groups over √G, under which one is not cut further for the whole."""
UNSEEN, UNSEEN_BY_RAYS = 1e-4, 1e-2
"""Norm that a group is taken to have at least, relative to the whole, when it is cut; and one whose light comes by
rays, for half as much would send twice as many before it is known to be hidden."""
NEGLIGIBLE, NEGLIGIBLE_BY_RAYS = 1e-9, 1e-5
"""Norm of a part, relative to the whole, up to which nothing is claimed of its own light: the finest of `LEVELS`
cuttings does not resolve it, and a cutting that changes nothing agrees with itself; and the same norm of a mesh whose
light comes by rays, which hardly ever meet it."""
LOOKED_AT, EVENLY = 12, 0.25
"""Pairs looked at roughly for each that is tried, and the weight of taking them evenly beside that of their light."""
HELPS = 0.1
"""Share of the error to be met, for each of G groups over G, under which cutting one does not help the whole."""
TOO_DEAR = 1 << 16
"""Elements and rays of a part in one histogram, after which an object is not cut on for its own sake: what is nearly
hidden may take any number of rays for light that is a millionth of the whole."""
RAYS_CHEAPER = 2.0
"""How many rays of a lattice, with what they meet, cost as much as an element with its rays, about."""
WITHIN = 0.7
"""Share of the errors to be met, of the whole and of each object, that their estimates may reach on the pairs tried:
others may be worse."""
BETWEEN, HALVINGS, WIDELY, TINY = 8, 60, 60.0, 1e-150
"""Cuttings looked at from one that was tried to the next; how often the range of prices is halved that errors may
have, and how far it reaches, by powers of e; and what is too small to divide by."""
MOST_PATCHES, MOST_PATCHES_TRIED = 1 << 22, 1 << 18
"""Footprints of all pixels at most, and points of those of the trial that are at edges."""
PATCHES_SHARE = 0.2
"""Share of the error to be met that may come of the size of footprints."""
MOST_LEVELS, FROM_LARGER, FINEST_SHARE = 6, 1 / 3, 0.5
"""How often pixels of the trial are quartered at most; error of footprints, relative to the difference from those
twice as large, for it is of second order; and how much of `PATCHES_SHARE` the finest ones may have."""
FROM_FEWER, SLOWEST = 0.5, 0.4
"""Error of a net of points, relative to its difference from one of a quarter of them: of order 3/4 in their number
beside an edge; and that difference, relative to the one before it, at least: it may be small by chance."""


@dataclass(frozen=True)
class Asked:
    """The errors asked for, and which parts (K,) are objects; the others are one group, the first of G.

    faint : photons, per emitted photon and over all histograms, under which an object is not held to `part_target`.
    """

    target: float
    part_target: float
    faint: float
    objects: Bools

    @property
    def group(self) -> Ints:
        """(K,) the group of each part."""
        return np.where(self.objects, np.cumsum(self.objects), 0)


@dataclass
class Work:
    """Elements spread and rays asked so far."""

    cells: int = 0
    rays: int = 0


@dataclass(frozen=True)
class Trial:
    """Some pairs of laser point and pixel that stand for all, the brighter the more often.

    Attributes
    ----------
    pairs : (n, 2).
    weight : (n,) how many of all pairs each stands for.
    group : (K,) of each part, as `Asked` has it.
    scale : (G,) by how much each group is brighter in all pairs than these stand for, as far as a rough look tells.
    levels : how often their pixels are quartered at most, to begin with.
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
        """Drawn by what a rough look finds of the whole, which counts for half, and of each object: few points may
        have all the light of one, and all its error."""
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
        """(G,) groups all of whose parts come by rays."""
        return np.asarray(np.bincount(self.group, ~self.gathering.by_rays, len(self.scale)) == 0)

    def some(self, which: Bools) -> Trial:
        """Only some of the pairs."""
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
    """The error that an element of each group may make, and what that leaves.

    Attributes
    ----------
    cutting : (G,) L2 error of an element. tried, draw : (G,) the finer one of the trial's `histogram`, and its draw.
    error, whole : L2 error and norm of the whole.
    still, own : (G,) of each group.
    held : (G,) which are held to an error of their own, or would be but for `TOO_DEAR`.
    limit : (G,) that error, infinite for the others.
    histogram : (n, G, T) of the pairs tried.
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
    """What ever finer cuttings of a trial found, the coarsest one first.

    Attributes
    ----------
    histograms, cuttings, cells, costs : of each run, those of each group.
    finest : (G,) number of the finest run of each group: the last one, or the one it was settled with.
    settled, dear : (G,) groups that are cut no further; and those that took more than `TOO_DEAR` in some run.
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
        """With surfaces cut by distance alone."""
        groups = len(trial.scale)
        coarse, none = np.full(groups, COARSE), np.zeros(groups, np.bool_)
        found = trial.gathered(coarse, trial.levels)
        costs = CELL * found.cells + CELL_RAY * found.rays
        return cls(trial, [found.histogram], [coarse], [found.cells], [costs], np.zeros(groups, np.int64), none, none)

    def light_to_cut_for(self) -> Floats:
        """(n, G, T) the most that the coarsest cutting finds of each group, however its rays fall."""
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
        """Add a run with a finer cutting (G,); settled groups stay as they are."""
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
        """(G,) whether a difference between runs tells of the error: a finer run took markedly more work, is not
        among the first, and let no element be wrong by more than there is (G,)."""
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
    """The coarsest cutting of each group that does, found with ever finer ones; None where none does within
    `max_lookins`, and where there is no light, which must be looked for harder."""
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
    """How often even pixels are quartered, and those at edges; the L2 error of the footprints of the ones and the
    points of the others, in the whole and (G,) in each group; and `gain`, the L2 norm of the light by which these
    footprints differ from those that the cutting was chosen with."""

    levels: int
    edge_levels: int
    error: float
    of_parts: Floats
    gain: float


def quarter(trial: Trial, choice: Choice, asked: Asked, pixels: int) -> Quartering | None:
    """As seldom as will do; None where that leaves no room for the footprints of all `pixels`."""
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
    """How often pixels at edges are quartered: until the error of their points fits beside that of elements, or there
    is no room for more; and that error. Their histograms at the fewest levels are `finer`."""
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
    """(G,) cuttings that cost least while the errors (G,) that they leave, which come second, are each within `limit`
    and together, added as squares, within `most`.

    They lie between those tried, where errors and costs go with powers of the cutting. Those of `level` do, and
    remain where nothing else is known.
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
    """(n, K) L2 error that each group still has in each run, whose finest one for a group is number `finest`."""
    every = np.arange(len(finest))
    last = runs[-1]
    still = np.array([_norms(run - last) for run in runs])
    return np.asarray(still + (REST - 1) * still[finest - 1, every])


def _falls(runs: list[Floats], finest: Ints) -> Bools:
    """(K,) whether the last difference of each group is by `FALLS` smaller than the one before."""
    last = [np.linalg.norm(runs[n][:, k] - runs[n - 1][:, k]) for k, n in enumerate(finest)]
    before = [np.linalg.norm(runs[n - 1][:, k] - runs[max(n - 2, 0)][:, k]) for k, n in enumerate(finest)]
    return np.array(last) <= FALLS * np.array(before)


def _whole_error(runs: list[Floats], level: Ints, finest: Ints) -> float:
    """L2 error of the sum over groups, each as it is in the run of its level."""
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
    """At most `wanted` rows drawn by their norms (n, K), and how many each stands for. The first column counts as
    much as all others together; the brightest are always among them. Errors are neither the same in all rows, for
    which they should be drawn evenly, nor as large as their light, for which by its square: norms are in between."""
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
    """Places drawn with chances as their shares, and how many each stands for: those whose share is worth a place of
    their own, and of the others in equal steps along the running sum."""
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
    """On how many of so many pairs a cutting is tried, each with so many values of histograms."""
    return int(np.clip(min(pairs // 32, MOST_TRIED // values), *TRIALS))


def spread_evenly(count: int, wanted: int) -> Ints:
    """At most `wanted` of `count` indices, in no step with the rows of a scan."""
    if count <= wanted:
        return np.arange(count)
    return np.unique(((np.arange(wanted) * (math.sqrt(5) - 1) / 2 + 0.5) % 1.0 * count).astype(np.int64))
