"""How finely surfaces and pixels are cut, found on some pairs of laser point and pixel that stand for all.

Each object is a group of its own; of all other parts, those with a lobe are a group, and matt ones are another: a
floor with a narrow lobe takes so many elements that its convergence would hide that of walls. A run gathers the light
of the trial's pairs with a cutting: for each group, the L2 error that one element may make. Cuttings get finer until
the difference between runs is small in the whole (the sum of all groups) and in each object's own light. Elements of
one group may all make the same error, for then a given number of them brings the group nearest to the truth. A
difference between two runs is an estimate of the error only if the finer run did more work: small triangles stay
whole over many cuttings, and two runs of the same elements agree however wrong they are.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from datagen.records.arrays import Bools, Floats, Ints, l2_norm
from datagen.transport.error_control.cost import CELL, CELL_RAY
from datagen.transport.quadrature.gathering import EDGE_LEVELS, Gathered, Gathering, Seen

MOST_WORK = 1 << 23
"""Most surface elements and shadow rays of a pair in a trial, some seconds."""
TRIALS, MOST_TRIED = (12, 48), 1 << 23
"""Fewest and most pairs of laser point and pixel in a trial, one in 32 of the scan's pairs in between (all of them
if they are less than twice the fewest); and the most values (pairs × groups × bins) that the histograms of more than
the fewest pairs may have. Half as many pairs stand for the scan less well; half as many values take half the
memory."""
COARSE = 1e300
"""L2 error that every element may make in the coarsest cutting: no limit, so surfaces are cut by distance alone."""
FIRST, FINER, LEVELS = 0.03, 0.25, 12
"""Error that an element may make in the second cutting, relative to the norm of its group; factor of that error from
one cutting to the next; and the most cuttings. Half of `FIRST` or `FINER` reaches a strict target in fewer runs, and
a loose one with more elements than it needs; half of `LEVELS` gives up strict targets."""
LEAP = 2
"""Most steps `FINER` from one cutting to the next. Half of it takes more runs where the first ones found too much
light; with twice as much, elements of narrow lobes are halved for minutes before the budget is known to be
exceeded."""
GROWN = 1.5
"""Factor by which one run must have more elements than another for their difference to be an estimate of error. With
half of it, two runs of the same elements would confirm each other."""
SURE = 3
"""Number of cuttings after the coarsest before differences are taken as estimates of error: the first cuttings
lack the same light, and where all light is in one bin two of them may agree by chance. With fewer, they do."""
FALLS = 0.55
"""Largest ratio of the last difference between runs to the one before it, at which the finest run may itself be
chosen: without that decrease nothing says how large the remaining error is. Half of it asks for one more run nearly
always."""
REST, SLOW_REST = 0.6, 1.7
"""Error of a cutting, relative to its difference from the one before: errors fall to about 0.4 from one cutting to
the next, and 0.4 + 0.16 + … ≈ 0.6; and the same of pixels at edges and near surfaces. There elements and footprints
are halved together, and errors fall as the cube root of what each may make, to 0.63: 0.63 + 0.63² + … = 1.7. With
half of either, errors would be claimed too small."""
NEAR = 0.05
"""Relative change of a pair's light, when its footprints are quartered, from which on surfaces count as near the
pixel. Half of it asks for finer elements of large pixels that do not need them; with twice as much, light of what
touches a wall beside a pixel is claimed too precisely."""
LOOKS = 4
"""Most runs with the coarsest cutting, each with other random points, in search of a group's first light. With half
as many, the second cutting more often begins without a measure of a group's light."""
SETTLED = 0.3
"""Error of one of G groups, relative to 1/√G of the error asked of the whole, below which the group is not cut more
finely for the sake of the whole. Half of it cuts groups further that hardly contribute to the error."""
UNSEEN, UNSEEN_BY_RAYS = 1e-4, 1e-2
"""Least norm, relative to the whole, that a group is taken to have when its cutting is chosen, until its light is
found (half of it begins with finer elements on what may turn out to be hidden); and the same for a group whose light
comes by rays, where half of it sends twice as many rays."""
NEGLIGIBLE, NEGLIGIBLE_BY_RAYS = 1e-9, 1e-5
"""Norm of a part, relative to the whole, up to which no error is claimed for the part's light, because the finest of
`LEVELS` cuttings does not resolve it; and the same for a mesh whose light comes by rays, which hardly ever meet
it."""
LOOKED_AT, EVENLY = 12, 0.25
"""Pairs whose light is computed roughly, for each pair that is drawn for the trial; and the weight of an even draw
beside a draw by light. Half of the first may miss the few pairs that have an object's light; half of the second lets
dim pairs stand for more others."""
BRIGHTER = 2.0
"""Light of a pair, relative to that of the brightest pair of a trial, beyond which the trial is said to have
overlooked it. Half of it repeats trials that were good; with twice as much, one pair may have half of the light and
of its error unnoticed."""
HELPS = 0.1
"""Error of one of G groups, relative to 1/G of the error asked of the whole, below which cutting the group more
finely does not help the whole. Half of it refines groups in vain."""
TOO_DEAR = 1 << 16
"""Elements and rays for one histogram, from which on an object is not cut more finely for the sake of its own
light: what is nearly hidden may take any number of rays for a millionth of the light. Half of it gives up more faint
objects."""
RAYS_CHEAPER = 2.0
"""Number of rays of a lattice, with the connections of their hits, that cost about as much as one element with its
shadow rays."""
WITHIN = 0.7
"""Largest estimate of error on the trial's pairs, relative to the error asked, that is accepted: other pairs may be
worse. Half of it costs a cutting more."""
RUNAWAY = 1 << 24
"""Elements and shadow rays of one run from which on quadrature is given up, for every 48 pairs (`TRIALS[1]`) or part
of 48: narrow lobes on both sides of an element take some 10¹⁰. Half of it gives up some scans of large pixels."""
BETWEEN, TINY = 8, 1e-150
"""Cuttings considered between two that were tried (with half as many, the cheapest is met less exactly); and a number
to divide by in place of zero."""
MOST_PATCHES, MOST_PATCHES_TRIED = 1 << 22, 1 << 18
"""Most footprints of all pixels, and most points of the trial's pixels at edges; half as many take half the memory
and give up strict targets earlier."""
PATCHES_SHARE = 0.2
"""Share of the error asked that the size of footprints may cause. Half of it doubles the number of footprints, for
their error is inversely proportional to their number."""
MOST_LEVELS, FINEST_SHARE = 6, 0.5
"""Most times that pixels of the trial are quartered; and fraction of `PATCHES_SHARE` that the finest footprints may
have, which are the truth for the others. Half of either gives up strict targets earlier."""
FROM_FEWER, SLOWEST = 0.5, 0.4
"""Error of a net of points, relative to its difference from a net of a quarter as many: beside an edge it is of order
3/4 in their number; and the least ratio of an estimated error to the one before it that is believed, for a difference
may be small by chance. Half of either claims less error than there may be."""


@dataclass(frozen=True)
class Asked:
    """The relative L2 errors that are asked of the whole (`target`) and of each object's own light (`part_target`).

    faint : energy, photons per emitted photon over all histograms, below which `part_target` does not apply.
    objects : (K,) which parts are objects.
    """

    target: float
    part_target: float
    faint: float
    objects: Bools

    def group(self, lobed: Bools) -> Ints:
        """(K,) index of the group of each part: 0 for parts that are no objects, 1 … n for n objects, and n + 1 for
        the parts that are no objects and have a lobe (`lobed` (K,)), if others have none."""
        others = 1 + self.objects.sum() if (~self.objects & ~lobed).any() else 0
        return np.asarray(np.where(self.objects, np.cumsum(self.objects), lobed * others), np.int64)

    def of_objects(self, groups: int) -> Bools:
        """(G,) which of the groups are objects."""
        return np.asarray((np.arange(groups) > 0) & (np.arange(groups) <= self.objects.sum()))


@dataclass
class Work:
    """Numbers of elements and of rays that a trial has taken so far."""

    cells: int = 0
    rays: int = 0


@dataclass(frozen=True)
class Trial:
    """Pairs of laser point and pixel that represent all pairs of a scan; bright ones are drawn more often.

    Attributes
    ----------
    pairs : (n, 2) indices of laser point and pixel.
    weight : (n,) number of pairs that each of these represents.
    group : (K,) index of each part's group.
    scale : (G,) norm of each group over all pairs, relative to the weighted norm over these pairs, from a rough
        computation of many pairs.
    levels : most times that the pixels are quartered in the first runs.
    work : elements and rays so far.
    seen : footprints of the pixels by how often they are quartered, computed once and kept.
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
    def of(cls, gathering: Gathering, lit: Ints, request: Asked, found: Floats | None = None) -> Trial:
        """A trial of pairs drawn from `lit` (n, 2) by their light, as `found`, or by a rough computation of some.

        Half of the draw is by the light of the whole, half by that of each object: a few pairs may have all the light
        of an object, and all its error.

        found : (n, 1 + G) square of the L2 norm of each pair's light, in the whole and in each group.
        """
        task, group = gathering.task, request.group(gathering.width < 1.0)
        groups = 1 + int(group.max())
        wanted = _trials(len(lit), groups * task.capture.time.bins)
        looked_at = spread_evenly(len(lit), LOOKED_AT * wanted) if found is None else np.arange(len(lit))
        represents = len(lit) / max(len(looked_at), 1)
        rough = cls(
            gathering, lit[looked_at], np.full(len(looked_at), represents), group, np.ones(groups),
            gathering.levels(), Work(),
        )  # fmt: skip
        if len(looked_at) <= wanted:
            return rough
        squares = rough.rough_light() if found is None else found
        norms = np.sqrt(squares[:, np.concatenate([[True], request.of_objects(groups)])])
        places, stands_for = by_light(norms, wanted)
        # The draw changes each group's norm by chance; `scale` takes that back.
        of_all, of_drawn = squares[:, 1:].sum(axis=0), stands_for @ squares[places, 1:]
        scale = np.sqrt(np.divide(of_all, of_drawn, where=of_drawn > 0, out=np.ones(groups)))
        return replace(rough, pairs=rough.pairs[places], weight=stands_for * represents, scale=scale, seen={})

    def rough_light(self) -> Floats:
        """(n, 1 + G) square of the L2 norm of each pair's light with the coarsest elements, in the whole and in each
        group."""
        even, coarse = replace(self, weight=np.ones(len(self.pairs))), np.full(len(self.scale), COARSE)
        light = even.gathered(coarse, 0, EDGE_LEVELS[0]).histogram
        if self.gathering.lobed:
            # Coarse elements may miss lobes, and with them the pairs that have most of the light.
            light = light + even.gathered(coarse, 0, EDGE_LEVELS[0], matt=True).histogram
        return np.column_stack([(light.sum(axis=1) ** 2).sum(axis=1), (light**2).sum(axis=2)])

    def overlooks(self, lit: Ints, squares: Floats) -> bool:
        """Whether some of the pairs `lit` (n, 2) has more than `BRIGHTER` times as much light as any of the trial.

        squares : (n, columns) square of the L2 norm of each pair's light, in the whole and in some groups.
        """
        tried = (lit[:, None] == self.pairs).all(axis=2).any(axis=1)
        return bool((squares > BRIGHTER**2 * squares[tried].max(axis=0, initial=0.0)).any())

    @cached_property
    def near(self) -> Bools:
        """(n, G) whether a group has surfaces so near a pixel that its light depends on how large footprints are."""
        if self.levels == 0:
            return np.zeros((len(self.pairs), len(self.scale)), np.bool_)
        cutting = np.where(self.by_rays, np.inf, COARSE)
        # Chance and lobes would make a difference, too.
        whole, quartered = (
            self.gathered(cutting, k, 0, matt=True, clear=True).histogram.sum(axis=2) for k in (0, self.levels)
        )
        return np.asarray(np.abs(quartered - whole) > NEAR * quartered)

    @property
    def by_rays(self) -> Bools:
        """(G,) whether the light of all parts of a group comes by rays."""
        return np.asarray(np.bincount(self.group, ~self.gathering.by_rays, len(self.scale)) == 0)

    def some(self, which: Bools) -> Trial:
        """The trial with only those of its pairs that `which` (n,) marks."""
        return replace(self, pairs=self.pairs[which], weight=self.weight[which], seen={})

    def gathered(
        self, cutting: Floats, levels: int, edge_levels: int | None = None, draw: Ints | None = None,
        matt: bool = False, clear: bool = False,
    ) -> Gathered:  # fmt: skip
        """The pairs' histograms (n, G, T), weighted so that their squares add up to those of all pairs; overflow; and
        the numbers of elements and rays of each group (G,).

        cutting : (G,) L2 error that one element may make. draw : (G,) index of the set of random points.
        levels, edge_levels : times that pixels which see one flat surface, and pixels at edges, are quartered.
        matt, clear : whether every surface is taken as Lambertian with its albedo, and nothing to hide anything.
        """
        quarterings = levels, edge_levels
        if quarterings not in self.seen:
            self.seen[quarterings] = list(self.gathering.seen(self.pairs, levels, edge_levels))
        draw = None if draw is None else draw[self.group]
        most_work = RUNAWAY * math.ceil(len(self.pairs) / TRIALS[1])
        result = self.gathering.gathered(
            self.pairs, self.seen[quarterings], cutting[self.group], self.group, draw, matt, clear, most_work
        )
        cells, rays = (
            np.bincount(self.group, work, len(cutting)).astype(np.int64) for work in (result.cells, result.rays)
        )
        self.work.cells += int(cells.sum())
        self.work.rays += int(rays.sum())
        histogram = result.histogram * np.sqrt(self.weight)[:, None, None] * self.scale[:, None]
        return Gathered(histogram, result.overflow, cells, rays)

    def energy(self, histogram: Floats) -> Floats:
        """(G,) photons of each group in all pairs of the scan, from weighted histograms (n, G, T)."""
        return np.asarray(np.einsum("nkt,n->k", histogram, np.sqrt(self.weight)) / self.scale)


@dataclass(frozen=True)
class Choice:
    """The chosen cutting, and estimates of the errors that it leaves.

    Attributes
    ----------
    cutting : (G,) L2 error that one element may make.
    tried_cutting, draw : (G,) the finer cutting that `histogram` was gathered with, and the index of its random
        points.
    error, norm : L2 error and L2 norm of the whole.
    group_error, group_norm : (G,) L2 error and L2 norm of each group.
    claimed : (G,) whether an error is claimed for the group's own light, even if that group was `TOO_DEAR` to meet
        `part_target`.
    limit : (G,) L2 error that the group may have, infinite where none is asked.
    histogram : (n, G, T) light of the trial's pairs.
    """

    cutting: Floats
    tried_cutting: Floats
    draw: Ints
    error: float
    norm: float
    group_error: Floats
    group_norm: Floats
    claimed: Bools
    limit: Floats
    histogram: Floats


@dataclass
class _Runs:
    """Runs of a trial with finer and finer cuttings, the coarsest first.

    Attributes
    ----------
    histograms, cuttings, cells, costs : for each run, light (n, G, T), cutting, number of elements, and cost of each
        group (G,).
    finest : (G,) index of the finest run of each group: the last run, or that after which the group was settled.
    settled : (G,) whether a group is cut no more finely.
    too_dear : (G,) whether a group took more than `TOO_DEAR` in some run.
    """

    trial: Trial
    histograms: list[Floats]
    cuttings: list[Floats]
    cells: list[Ints]
    costs: list[Floats]
    finest: Ints
    settled: Bools
    too_dear: Bools

    @classmethod
    def coarsest(cls, trial: Trial) -> _Runs:
        """The first run alone, with surfaces cut by distance alone."""
        groups = len(trial.scale)
        coarse, none = np.full(groups, COARSE), np.zeros(groups, np.bool_)
        run = trial.gathered(coarse, trial.levels)
        costs = CELL * run.cells + CELL_RAY * run.rays
        return cls(trial, [run.histogram], [coarse], [run.cells], [costs], np.zeros(groups, np.int64), none, none)

    def first_light(self) -> Floats:
        """(n, G, T) the largest light of each group in several runs with the coarsest cutting: the measure by which
        the second cutting is chosen."""
        groups, light, draw = len(self.finest), self.histograms[0], 1
        # One ray for a whole face may miss what it sees of it.
        while draw < LOOKS and not _norms(light).all():
            again = self.trial.gathered(np.full(groups, COARSE), self.trial.levels, draw=np.full(groups, draw))
            light, draw = np.maximum(light, again.histogram), draw + 1
        if self.trial.gathering.lobed:
            # What coarse elements find of lobes may be a millionth of their light, and no measure of how fine to
            # begin; nor is what matt surfaces would bring: it may be a million times as much.
            matt = self.trial.gathered(np.full(groups, COARSE), self.trial.levels, matt=True).histogram
            light = np.maximum(light, matt)
        return light

    def refine(self, cutting: Floats) -> None:
        """Add a run with a finer cutting (G,); settled groups keep the light of the run before."""
        # Points drawn anew: where clusters stay as they are, runs would else agree in what chance made of them.
        draw, settled = np.full(len(cutting), len(self.histograms)), self.settled
        # An infinite error leaves a settled group out, so that it costs nothing.
        run = self.trial.gathered(np.where(settled, np.inf, cutting), self.trial.levels, draw=draw)
        run.histogram[:, settled] = self.histograms[-1][:, settled]
        self.histograms.append(run.histogram)
        self.cuttings.append(np.where(settled, self.cuttings[-1], cutting))
        self.cells.append(np.where(settled, self.cells[-1], run.cells))
        self.costs.append(np.where(settled, self.costs[-1], CELL * run.cells + CELL_RAY * run.rays))
        self.too_dear = self.too_dear | (
            run.cells + run.rays > TOO_DEAR * len(self.trial.pairs) * np.where(self.trial.by_rays, RAYS_CHEAPER, 1.0)
        )
        self.finest[~settled] = len(self.histograms) - 1

    def comparable(self, fine_enough: Floats) -> Bools:
        """(runs, G) whether the difference between a run and the last one is an estimate of the group's error.

        The last run must have `GROWN` times as many elements, must not be among the first `SURE`, and its cutting
        must be at most `fine_enough` (G,).
        """
        late_enough = (self.finest >= SURE) & (self.cuttings[-1] <= fine_enough)
        grown = GROWN * np.array(self.cells[:-1]) <= self.cells[-1]
        compared = np.minimum(np.arange(len(self.cells))[:, None], self.finest - 1)
        return np.asarray(grown[compared, np.arange(len(self.finest))] & late_enough)

    def at(self, level: Ints, of_runs: Floats) -> Floats:
        """(G,) values of each group in run `level` (G,), or in its finest, out of those of all runs (runs, G)."""
        return np.asarray(of_runs[np.minimum(level, self.finest), np.arange(len(self.finest))])

    def lacking(self) -> Floats:
        """(n, G, T) estimated error of each group's finest run: a multiple of its difference from the run before."""
        finest = enumerate(self.finest)
        difference = np.stack([(self.histograms[n - 1] - self.histograms[-1])[:, k] for k, n in finest], axis=1)
        trial = self.trial
        # Errors of rays are not those of elements.
        slow = (trial.gathering.at_edge[trial.pairs[:, 1]][:, None] | trial.near) & ~trial.by_rays
        return np.asarray(difference * np.where(slow, SLOW_REST, REST)[:, :, None])

    def differences(self) -> Floats:
        """(runs, G) L2 norm of each group's difference from the last run, and what the last one still lacks."""
        last = self.histograms[-1]
        return np.array([_norms(run - last) for run in self.histograms]) + _norms(self.lacking())

    def group_errors(self, differences: Floats) -> Floats:
        """(runs, G) estimated L2 error of each group, from its `differences` (runs, G).

        The error of N random rays falls at most as 1/N, and so as the error that each may make. Two runs that differ
        by less may do so by chance, above all where one pair has most of the light.
        """
        errors = differences.copy()
        for n in range(2, len(errors)):
            believed = self.trial.by_rays * self.cuttings[n] / self.cuttings[n - 1]
            errors[n] = np.maximum(errors[n], np.where(n <= self.finest, believed * errors[n - 1], 0.0))
        return errors

    def whole_error(self, level: Ints, group_error: Floats, differences: Floats) -> float:
        """Estimated L2 error of the sum over groups, where each group is taken from run `level` (G,).

        group_error, differences : (runs, G) from the methods of these names.
        """
        last = self.histograms[-1].sum(axis=1)
        chosen = sum(self.histograms[min(n, len(self.histograms) - 1)][:, k] for k, n in enumerate(level))
        known = l2_norm(chosen - last) + _norm(self.lacking())
        # What groups' errors were raised by, since they had agreed by chance.
        raised = self.at(level, group_error) ** 2 - self.at(level, differences) ** 2
        return math.sqrt(known**2 + float(np.maximum(raised, 0.0).sum()))

    def levels(
        self, meets: Bools, group_error: Floats, differences: Floats, claimed: Bools, most: float
    ) -> tuple[Ints, float]:
        """(G,) index of the coarsest run of each group that meets its limit, one more than the finest where none
        does; and the L2 error of the whole with these runs.

        meets : (runs, G) whether a run meets the group's limit. group_error, differences : (runs, G) from the methods
        of these names.
        most : L2 error that the whole may have; groups are taken from finer runs until it is met.
        """
        groups, next_run = len(claimed), self.finest + ~self.settled
        level = np.minimum(np.argmax(np.vstack([meets, np.ones(groups, np.bool_)]), axis=0), next_run)
        # The finest run of a group that was given up is too dear for all pairs, or nearly: the one before has to do.
        level = np.where(claimed & self.too_dear, self.finest - 1, level)
        error = self.whole_error(level, group_error, differences)
        while error > most:
            # The group with the largest error has the most to give.
            reducible = np.where(level < next_run, self.at(level, group_error), 0.0)
            if groups * reducible.max() <= HELPS * most:
                break
            level[np.argmax(reducible)] += 1
            error = self.whole_error(level, group_error, differences)
        return level, error


def choose(trial: Trial, request: Asked) -> Choice | None:
    """The cheapest cutting of each group that meets the errors asked, found with finer and finer ones.

    None where no cutting meets them within `MOST_WORK`, and where no light was found: light must then be sampled.
    """
    groups = len(trial.scale)
    every, objects, runs = np.arange(groups), request.of_objects(groups), _Runs.coarsest(trial)
    light = runs.first_light()
    norm, group_norm = _norm(light), _norms(light)
    if norm == 0.0:
        return None
    # Norms are over all pairs of the scan: what one histogram has of them falls with the root of the number of pairs.
    share, by_rays = FIRST / math.sqrt(trial.weight.sum()), trial.by_rays
    unseen = np.where(by_rays, UNSEEN_BY_RAYS, UNSEEN)
    negligible = np.where(by_rays, NEGLIGIBLE_BY_RAYS, NEGLIGIBLE)
    cutting = share / FINER * np.maximum(group_norm, unseen * norm)
    while True:
        # A group that turns out to have less light than the first runs had found needs more than one step, but a leap
        # might take hours, of which the runs so far say nothing.
        wanted = np.minimum(FINER * cutting, share * np.maximum(group_norm, unseen * norm))
        cutting = np.maximum(wanted, FINER**LEAP * cutting)
        before = trial.work.cells + trial.work.rays
        runs.refine(cutting)
        light, finest = runs.histograms[-1], runs.finest
        norm, group_norm = _norm(light), _norms(light)
        if norm == 0.0:
            return None
        claimed = objects & (group_norm > negligible * norm) & (trial.energy(light) >= request.faint)
        limit = np.where(claimed & ~runs.too_dear, request.part_target * group_norm, np.inf)
        differences, last = runs.differences(), len(runs.histograms) > LEVELS
        group_error = runs.group_errors(differences)
        # The error of a group need not be known where the group is too faint to matter to anything asked.
        matters = (claimed & ~runs.too_dear) | (group_norm > request.target * norm)
        # While single elements may err by more than all the light of a faint object, two runs agree by chance. Few
        # rays meet a faint mesh, but each of these then errs by little: their runs are comparable sooner.
        least = np.where(claimed & ~by_rays, 0.0, unseen * norm)
        known = runs.comparable(share / FINER * np.maximum(group_norm, least)) | ~matters | last
        meets = (group_error <= WITHIN * limit) & known & ~(claimed & runs.too_dear)
        most = WITHIN * request.target * norm
        level, error = runs.levels(meets, group_error, differences, claimed, most)
        # The finest run has no finer one to be compared with: only a steady decrease tells of its error.
        unconfirmed = (level == finest) & matters & ~runs.settled & ~_converging(runs.histograms, finest)
        level = np.where(unconfirmed, finest + 1, level)
        if error <= most and (level <= finest).all():
            chosen = np.stack([runs.histograms[n][:, k] for k, n in enumerate(level)], axis=1)
            # Together groups may be wrong by as much more as the whole has room for.
            room = max(most / max(error, TINY) * l2_norm(group_error[level, every]), TINY)
            tried = np.array(runs.cuttings)
            coarser, left = _cheapest(tried, group_error, np.array(runs.costs), level, finest, WITHIN * limit, room)
            error *= l2_norm(left) / max(l2_norm(group_error[level, every]), TINY)
            return Choice(coarser, tried[level, every], level, error, norm, left, group_norm, claimed, limit, chosen)
        work = trial.work.cells + trial.work.rays
        # The next run takes as much more as elements are finer.
        over_budget = work + (work - before) / FINER > MOST_WORK * len(trial.pairs)
        if last or over_budget:
            return None
        # A group that meets its limit is not cut further, unless the whole needs it.
        needed = math.sqrt(groups) * group_error[finest, every] > SETTLED * request.target * norm
        settled = runs.settled | ((level <= finest) & ((error <= most) | ~needed))
        # If all were settled while something is missing, no further run would change anything.
        runs.settled = settled & ~settled.all()


@dataclass(frozen=True)
class Quartering:
    """How often pixels are quartered into footprints, and what error that leaves.

    Attributes
    ----------
    levels, edge_levels : times that pixels which see one flat surface, and pixels at edges, are quartered.
    error : L2 error of the whole.
    group_error : (G,) L2 error of each group.
    change : L2 norm of the difference between the light of these footprints and of those that the cutting was chosen
        with.
    """

    levels: int
    edge_levels: int
    error: float
    group_error: Floats
    change: float


def quarter(trial: Trial, choice: Choice, request: Asked, pixels: int) -> Quartering | None:
    """The fewest quarterings of pixels that keep the error of footprints within its share of the error asked; None
    if that needs more than `MOST_PATCHES` footprints for all `pixels` (their number)."""
    at_edge = trial.gathering.at_edge[trial.pairs[:, 1]]
    edges, flat = trial.some(at_edge), trial.some(~at_edge)
    most, limits = PATCHES_SHARE * request.target * choice.norm, PATCHES_SHARE * choice.limit
    # What comes by rays is not gathered again: its points of pixels are chosen by their distance.
    cutting = np.where(trial.by_rays, np.inf, choice.tried_cutting)
    runs = {trial.levels: choice.histogram[~at_edge]}

    def at(levels: int) -> Floats:
        if levels not in runs:
            runs[levels] = flat.gathered(cutting, levels, draw=choice.draw).histogram
            runs[levels][:, trial.by_rays] = choice.histogram[~at_edge][:, trial.by_rays]
        return runs[levels]

    # Where a surface is close before a pixel, even the finest footprints of the first runs may be too large.
    finest, error_of_finest, groups_of_finest = trial.levels, 0.0, np.zeros(len(limits))
    while finest > 0:
        # The error is of second order: a third of the difference from footprints twice as large.
        change = 1 / 3 * (at(finest) - at(finest - 1))
        error_of_finest, groups_of_finest = _norm(change), _norms(change)
        if finest == MOST_LEVELS or (
            error_of_finest <= FINEST_SHARE * most and (groups_of_finest <= FINEST_SHARE * limits).all()
        ):
            break
        finest += 1
    # From the finest towards coarser ones, for each step makes all later gathering four times as cheap.
    coarsest, error, errors = finest, error_of_finest, groups_of_finest
    while coarsest > 0:
        change = at(finest) - at(coarsest - 1)
        larger, larger_of_groups = _norm(change) + error_of_finest, _norms(change) + groups_of_finest
        if larger > most or (larger_of_groups > limits).any():
            break
        coarsest, error, errors = coarsest - 1, larger, larger_of_groups
    too_many = coarsest > 0 and pixels * 4 ** (coarsest + 1) > MOST_PATCHES
    if too_many or error > most or (errors > limits).any():
        return None
    edge_levels, edge_error, edge_errors = _at_edges(edges, choice, request, choice.histogram[at_edge])
    change_of_light = _norm(at(coarsest) - at(trial.levels))
    return Quartering(
        coarsest, edge_levels, math.hypot(error, edge_error), np.hypot(errors, edge_errors), change_of_light
    )


def _at_edges(edges: Trial, choice: Choice, request: Asked, finer: Floats) -> tuple[int, float, Floats]:
    """Times that pixels at edges are quartered, and the L2 error of their points in the whole and, (G,), in each
    group.

    They are quartered until that error fits beside that of elements, or the number of points reaches its limit.
    finer : (n, G, T) light of the trial's pixels at edges with the fewest quarterings.
    """
    level, at_edge = edges.gathering.edge_levels(), int(edges.gathering.at_edge.sum())
    if len(edges.pairs) == 0:
        return level, 0.0, np.zeros(len(choice.group_norm))
    # Errors of elements and of points are independent: what is left for points is a difference of squares.
    left = (request.target * choice.norm) ** 2 - choice.error**2
    left_of_group = np.where(choice.claimed, choice.limit**2 - choice.group_error**2, np.inf)
    coarsest, coarser = (
        edges.gathered(choice.tried_cutting, 0, max(level - k, 0), choice.draw).histogram for k in (2, 1)
    )
    error, errors = FROM_FEWER * _norm(coarser - coarsest), FROM_FEWER * _norms(coarser - coarsest)
    while True:
        change = FROM_FEWER * (finer - coarser)
        error, errors = max(_norm(change), SLOWEST * error), np.maximum(_norms(change), SLOWEST * errors)
        enough = error**2 <= left and (errors**2 <= left_of_group).all()
        points = 4 ** (level + 1)
        if enough or at_edge * points > MOST_PATCHES or len(edges.pairs) * points > MOST_PATCHES_TRIED:
            return level, error, errors
        level += 1
        coarser, finer = finer, edges.gathered(choice.tried_cutting, 0, level, choice.draw).histogram


def _cheapest(
    cuttings: Floats, group_error: Floats, costs: Floats, level: Ints, finest: Ints, limit: Floats, most: float
) -> tuple[Floats, Floats]:
    """(G,) the cuttings of least cost whose errors are each within `limit` (G,) and together, added as squares,
    within `most`; and these errors (G,).

    Between two cuttings that were tried, errors and costs are interpolated as powers of the cutting. The cuttings of
    run `level` (G,) meet the limits, and are returned where nothing cheaper is known.

    cuttings, group_error, costs : (runs, G) of each run. finest : (G,) index of each group's finest run.
    """
    steps, groups = np.arange(len(group_error) * BETWEEN) / BETWEEN, len(level)
    cutting, error, cost = (np.empty((len(steps), groups)) for _ in range(3))
    for g in range(groups):
        # Only the last runs that are one step apart: between two cuttings far apart errors are not known.
        jumps = cuttings[1 : finest[g] + 1, g] < 0.9 * FINER * cuttings[: finest[g], g]
        first = 1 + np.flatnonzero(jumps).max(initial=-1)
        known = np.arange(first, finest[g] + 1) if level[g] >= first else level[g : g + 1]
        # A finer cutting is never taken to be more wrong than a coarser one.
        errors = np.maximum.accumulate(np.maximum(group_error[known, g], TINY)[::-1])[::-1]
        at = np.clip(steps, known[0], known[-1])
        for table, values in ((cutting, cuttings[known, g]), (error, errors), (cost, np.maximum(costs[known, g], 1))):
            table[:, g] = np.exp(np.interp(at, known, np.log(values)))
        cost[error[:, g] > max(limit[g], group_error[level[g], g]), g] = np.inf
    # The least cost under a bound on Σ error² is the least of cost + λ error² in each group; λ by bisection, over a
    # range that reaches e^60 beyond the values that occur, in 60 halvings.
    every, finite = np.arange(groups), cost[np.isfinite(cost)]
    low, high = math.log(finite.min() / most**2) - 60.0, math.log(finite.max() / most**2) + 60.0
    # `most` is next to nothing where other groups have used up the error; e^700 is nearly the largest float.
    high = min(high, 700.0)
    for _ in range(60):
        multiplier = 0.5 * (low + high)
        which = np.argmin(cost + np.exp(multiplier) * error**2, axis=0)
        low, high = (multiplier, high) if l2_norm(error[which, every]) > most else (low, multiplier)
    which = np.argmin(cost + np.exp(high) * error**2, axis=0)
    return cutting[which, every], error[which, every]


def _converging(runs: list[Floats], finest: Ints) -> Bools:
    """(G,) whether the last difference between runs of each group is at most `FALLS` of the one before."""
    last = [np.linalg.norm(runs[n][:, k] - runs[n - 1][:, k]) for k, n in enumerate(finest)]
    before = [np.linalg.norm(runs[n - 1][:, k] - runs[max(n - 2, 0)][:, k]) for k, n in enumerate(finest)]
    return np.array(last) <= FALLS * np.array(before)


def _norm(histograms: Floats) -> float:
    """L2 norm of the sum over groups of (n, G, T)."""
    return l2_norm(histograms.sum(axis=1))


def _norms(histograms: Floats) -> Floats:
    """(G,) L2 norm over laser points, pixels and bins of (n, G, T)."""
    return np.asarray(np.sqrt((histograms**2).sum(axis=(0, 2))))


def by_light(norms: Floats, wanted: int) -> tuple[Ints, Floats]:
    """Indices of at most `wanted` rows, drawn by their norms (n, K), and the number of rows that each represents.

    The first column, the whole, counts as much as all others together, the objects. The brightest rows are always
    drawn. If errors were alike in all rows, an even draw would be best; if they were proportional to the light, a
    draw by its square: a draw by the norm is in between.
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
    """Indices of `wanted` rows drawn with probabilities proportional to `share` (n,), in ascending order, and the
    number of rows that each represents.

    Rows whose share is worth a draw of its own are all taken; of the others one in each equal step along the running
    sum of shares.
    """
    certain, left = np.zeros(len(share), np.bool_), wanted
    # Each row taken for certain leaves fewer draws for less light, which may make other rows certain.
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
    # A hair short of the end, so that rounding never yields an index behind the last row.
    drawn = np.searchsorted(running, (np.arange(left) + 0.5) / left * running[-1] * (1 - 1e-12))
    stands_for = running[-1] / (left * others[drawn])
    order = np.argsort(np.concatenate([places, drawn]))
    return np.concatenate([places, drawn])[order], np.concatenate([np.ones(len(places)), stands_for])[order]


def _trials(pairs: int, values: int) -> int:
    """Number of pairs to draw for a trial out of `pairs`, whose histograms have `values` numbers each."""
    if pairs < 2 * TRIALS[0]:
        # One of the few pairs left out may have all the error of an object's light.
        return pairs
    return int(np.clip(min(pairs // 32, MOST_TRIED // values), *TRIALS))


def spread_evenly(count: int, wanted: int) -> Ints:
    """At most `wanted` of the indices 0 … `count` − 1, spread evenly in ascending order.

    Steps of the golden ratio: a fixed step would take the same column of every row of a scan.
    """
    if count <= wanted:
        return np.arange(count)
    return np.unique(((np.arange(wanted) * (math.sqrt(5) - 1) / 2 + 0.5) % 1.0 * count).astype(np.int64))
