"""The primary of a scan without noise: light of three bounces, found by cutting surfaces into cells.

What a pixel receives by way of the hidden surface is an integral over that surface, and one whose integrand is smooth
wherever nothing hides it. So it is not sampled: each triangle is halved until a cell is small against its distance
from the laser point and the pixel, and until the error that it can still make in the histogram is small
(`cells/light.py`); cells that are partly hidden are halved further. What large a cell may be is one number for each
part, the L2 error that it may make, and these numbers are what an accuracy target chooses: some laser points are
gathered with ever smaller ones, until the difference that this makes is small in the whole and in each object's own
light. The error of what is chosen is thus known without noise and is a function of the scene alone.

Clusters of small triangles, whose light would be lost in the rest, are seen through one random point each.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from datagen.records.arrays import Bools, Floats, Ints
from datagen.records.materials import GGX, Material, Phong, Retroreflector
from datagen.transport.cells.hierarchy import Hierarchy
from datagen.transport.cells.light import COARSEST, Clock, Cutting, Lasers, gather
from datagen.transport.cells.occlusion import Occluders
from datagen.transport.cells.patches import Patches
from datagen.transport.sampling import stream_seeds
from datagen.transport.walk import WalkTask
from datagen.units import path_from_time

CLUSTER_STREAM = 64
NARROWEST_RAD = 0.1
"""Width of a BRDF's lobe under which the walk, which aims at lobes, is the better way."""
TRIALS, MOST_TRIED = (8, 48), 1 << 23
"""Fewest and most pairs of laser point and pixel on which the cutting is chosen, one in twenty in between; and values
of their histograms at most."""
COARSE = 1e300
"""An error that every cell may make: surfaces are cut by distance alone."""
FIRST, FINER, LEVELS = 0.03, 0.25, 12
"""Error that a cell may make, relative to the norm of its part, after the coarsest cutting; what it is multiplied
with from one cutting to the next, finer one; and the number of cuttings at most."""
REST = 1.6
"""Error of a cutting, relative to its difference from the next: errors fall to about four tenths, and
1 + 0.4 + 0.16 + … is this."""
SETTLED = 0.3
"""Share of the error to be met, for each of K parts over √K, under which a part is not cut further for the whole."""
UNSEEN = 1e-4
"""Norm that a part is taken to have at least, relative to the whole, when it is cut."""
LOOKED_AT, EVENLY = 6, 0.5
"""Pairs looked at roughly for each that is tried, and the weight of taking them evenly beside that of their light."""
WITHIN, WITHIN_PARTS = 0.6, 0.65
"""Share of the errors to be met, of the whole and of each object, that their estimates may reach on the pairs tried:
others may be worse."""
PATCHES_TRIED, MOST_PATCHES = 1, 1 << 19
"""How often pixels are quartered while the cutting is chosen, and patches of all pixels at most."""
EDGE_LEVELS, MOST_AT_EDGES = range(2, 7), 1 << 14
"""How often pixels that see more than one surface are quartered: as often as leaves no more than so many patches of
all of them, for what one has too much others lack."""
PATCHES_SHARE, FROM_QUARTERS = 0.25, 4 / 3
"""Share of the error to be met that may come of the pixels' patches; and that error, relative to what quartering them
once more changes, of second order in their size."""


@dataclass(frozen=True)
class Primary:
    """The primary of all laser points and pixels.

    Attributes
    ----------
    rows : one (L, P, T) array for each row of the task's splits.
    overflow : (L, P) photons outside the window.
    error : relative L2 error of the whole primary, as estimated.
    part_errors : part → that of its own light, for the objects that bring any.
    cells, rays : how many of them, the trials' with them.
    """

    rows: list[Floats]
    overflow: Floats
    error: float
    part_errors: Mapping[str, float]
    cells: int
    rays: int


def smooth(task: WalkTask) -> bool:
    """Whether every BRDF of the scene varies slowly enough for cells."""
    return min(lobe_width(material) for material in task.scene.materials) >= NARROWEST_RAD


def lobe_width(material: Material) -> float:
    """Half width of a BRDF's narrowest lobe, rad, at most 1."""
    match material:
        case Phong(exponent=exponent) if exponent > 0 and material.specular > 0:
            return min(math.sqrt(2 * math.log(2) / exponent), 1.0)
        case GGX():
            return min(1.3 * float(material.roughness) ** 2, 1.0)
        case Retroreflector() if material.retro > 0:
            return min(float(material.half_width_rad), 1.0)
    return 1.0


@dataclass(frozen=True)
class _Gathered:
    """Histograms (pair, row, bin) and overflow (pair,) in photons; cells and rays."""

    histogram: Floats
    overflow: Floats
    cells: int
    rays: int


@dataclass(frozen=True)
class _Seen:
    """Pairs whose pixels' patches are cut alike.

    which : (n,) which of the pairs asked for. pairs : (n, 2) laser point and row of `patches`.
    """

    which: Ints
    pairs: Ints
    patches: Patches


def patches_of(task: WalkTask, pixels: Ints, levels: int) -> Patches:
    return Patches.of(task.caster, task.scene, task.capture.sensor, task.cones, pixels, levels, task.seed)


@dataclass(frozen=True)
class _Gathering:
    """A scene and a capture as the compiled loop wants them."""

    task: WalkTask
    tree: Hierarchy
    occluders: Occluders
    lasers: Lasers
    clock: Clock
    coarsest: Floats
    peak: Floats
    at_edge: Bools
    """(P,) pixels that see more than one surface, or past one."""

    @classmethod
    def of(cls, task: WalkTask) -> _Gathering:
        points, axis, air = task.points, task.capture.time, task.scene.attenuation_per_m
        lasers = Lasers(
            points.position, points.normal, points.to_laser, points.part, np.exp(-air * np.nan_to_num(points.leg)),
            points.leg,
        )  # fmt: skip
        clock = Clock(
            1.0 / float(path_from_time(axis.width_s)), axis.start_s / axis.width_s, axis.origin == "source", air
        )
        width = np.array([lobe_width(material) for material in task.scene.materials])
        seen = width[np.unique(points.part[points.part >= 0])].min(initial=1.0)
        peak = task.materials.values[:, 0] / (math.pi * width**2)
        tree = Hierarchy.of(task.scene)
        past = np.isinf(task.patches.radius)
        at_edge = past | patches_of(task, np.arange(len(past)), 1).uneven[:, 0]
        return cls(
            task, tree, Occluders.of(task.scene, tree), lasers, clock, COARSEST * np.minimum(width, seen), peak,
            at_edge,
        )  # fmt: skip

    def seen(self, pairs: Ints, levels: int) -> list[_Seen]:
        """What the pixels of some pairs see, the even ones quartered `levels` times."""
        at_edge, found = self.at_edge[pairs[:, 1]], []
        for which in (np.flatnonzero(~at_edge), np.flatnonzero(at_edge)):
            if len(which) == 0:
                continue
            pixels, own = np.unique(pairs[which, 1], return_inverse=True)
            if at_edge[which[0]]:
                levels = max((k for k in EDGE_LEVELS if self.at_edge.sum() * 4**k <= MOST_AT_EDGES), default=1)
            local = np.stack([pairs[which, 0], own.reshape(-1)], axis=1)
            found.append(_Seen(which, local, patches_of(self.task, pixels, levels)))
        return found

    def gathered(self, pairs: Ints, seen: list[_Seen], error: Floats, row_of_part: Ints) -> _Gathered:
        """The light of some pairs of laser point and pixel, with each part in its row."""
        task, rows = self.task, int(row_of_part.max()) + 1
        histogram = np.zeros((len(pairs) * rows, task.capture.time.bins))
        overflow = np.zeros(len(histogram))
        seed = int(stream_seeds(task.seed, CLUSTER_STREAM, 0, np.zeros(1, np.int64))[0])
        cutting = Cutting(
            error, self.coarsest, self.peak, task.accuracy.occlusion != "off", task.accuracy.occlusion == "auto", seed
        )
        cells = rays = 0
        for some in seen:
            spread, asked = gather(
                some.pairs, some.which * rows, self.tree, self.occluders, self.lasers, some.patches,
                task.materials.kind, task.materials.values, cutting, self.clock, row_of_part, histogram, overflow,
            )  # fmt: skip
            cells, rays = cells + spread, rays + asked
        of_pairs = histogram.reshape(len(pairs), rows, task.capture.time.bins)
        return _Gathered(of_pairs, overflow.reshape(len(pairs), rows).sum(axis=1), cells, rays)


def primary_by_cells(task: WalkTask, target: float, part_target: float, faint: float = 0.0) -> Primary | None:
    """The primary with a relative L2 error of at most `target`, and of `part_target` in each object's own light.

    Returns nothing if that would take more work than `max_lookins`, or no light is found.

    faint : photons, per emitted photon and over all histograms, under which an object's light is not held to that.
    """
    gathering, pairs = _Gathering.of(task), pairs_of(task)
    asked = _Asked(target, part_target, faint, np.array([role == "object" for role in task.scene.roles]))
    trial = _Trial.of(gathering, pairs[task.points.part[pairs[:, 0]] >= 0], asked)
    choice = _choose(trial, asked)
    if choice is None:
        return None
    # The patches of a pixel are fine enough if their quarters give the same; once they did not, twice in a row, for
    # light that only few patches see may be missed by one level as by the other.
    levels, same = 0, 0
    coarser = trial.gathered(choice.cutting, 0).histogram
    while True:
        finer = trial.gathered(choice.cutting, levels + 1).histogram
        of_patches = FROM_QUARTERS * float(np.linalg.norm((finer - coarser).sum(axis=1)))
        of_parts = FROM_QUARTERS * _norms(finer - coarser)
        do = of_patches <= PATCHES_SHARE * target * choice.whole and (of_parts <= PATCHES_SHARE * choice.limit).all()
        same = same + 1 if do else 0
        if same > (levels > 0) or levels == EDGE_LEVELS[-1] or len(pairs) * 4 ** (levels + 2) > MOST_PATCHES:
            if not do:
                return None
            break
        levels, coarser = levels + 1, finer
    rows = np.arange(len(choice.cutting)) if task.splits.parts else np.zeros(len(choice.cutting), np.int64)
    found = gathering.gathered(pairs, gathering.seen(pairs, levels), choice.cutting, rows)
    shape, names = task.capture.shape, task.scene.part_names
    errors = {names[k]: float((choice.still[k] + of_parts[k]) / choice.own[k]) for k in np.flatnonzero(choice.held)}
    return Primary(
        [np.ascontiguousarray(found.histogram[:, k]).reshape(shape) for k in range(rows.max() + 1)],
        found.overflow.reshape(shape[:2]), (choice.error + of_patches) / choice.whole, errors,
        trial.work.cells + found.cells, trial.work.rays + found.rays,
    )  # fmt: skip


@dataclass(frozen=True)
class _Asked:
    """The errors asked for, and which parts (K,) are objects."""

    target: float
    part_target: float
    faint: float
    objects: Bools


@dataclass
class _Work:
    """Cells spread and rays asked so far."""

    cells: int = 0
    rays: int = 0


@dataclass(frozen=True)
class _Trial:
    """Some pairs of laser point and pixel that stand for all, the brighter the more often.

    Attributes
    ----------
    pairs : (n, 2).
    weight : (n,) how many of all pairs each stands for.
    """

    gathering: _Gathering
    pairs: Ints
    weight: Floats
    work: _Work
    seen: dict[int, list[_Seen]] = field(default_factory=dict)

    @classmethod
    def of(cls, gathering: _Gathering, lit: Ints, asked: _Asked) -> _Trial:
        """Drawn in equal steps along the running sum of what a rough look finds of the whole and of each object."""
        task, parts = gathering.task, len(asked.objects)
        wanted = _trials(len(lit), parts * task.capture.time.bins)
        looked = lit[spread_evenly(len(lit), LOOKED_AT * wanted)]
        rough = cls(gathering, looked, np.full(len(looked), len(lit) / max(len(looked), 1)), _Work())
        if len(looked) <= wanted:
            return rough
        seen = rough.gathered(np.full(parts, COARSE), 0).histogram
        squares = np.column_stack([(seen.sum(axis=1) ** 2).sum(axis=1), (seen**2).sum(axis=2)[:, asked.objects]])
        squares = squares[:, squares.sum(axis=0) > 0]
        share = (squares / squares.sum(axis=0)).sum(axis=1) / max(squares.shape[1], 1)
        share = (share + EVENLY / len(looked)) / (share + EVENLY / len(looked)).sum()
        places, count = np.unique(
            np.searchsorted(np.cumsum(share), (np.arange(wanted) + 0.5) / wanted * (1 - 1e-12)), return_counts=True
        )
        weight = count / (wanted * share[places]) * len(lit) / len(looked)
        return cls(gathering, looked[places], weight, rough.work)

    def gathered(self, cutting: Floats, levels: int) -> _Gathered:
        """Their histograms with each part apart, such that squares add up to those of all pairs."""
        if levels not in self.seen:
            self.seen[levels] = self.gathering.seen(self.pairs, levels)
        found = self.gathering.gathered(self.pairs, self.seen[levels], cutting, np.arange(len(cutting)))
        self.work.cells += found.cells
        self.work.rays += found.rays
        return replace(found, histogram=found.histogram * np.sqrt(self.weight)[:, None, None])

    def energy(self, histogram: Floats) -> Floats:
        """(K,) photons of each part in all pairs."""
        return np.asarray(np.einsum("nkt,n->k", histogram, np.sqrt(self.weight)))


@dataclass(frozen=True)
class _Choice:
    """The error that a cell of each part may make, and what that leaves.

    Attributes
    ----------
    cutting : (K,) L2 error of a cell.
    error, whole : L2 error and norm of the whole.
    still, own : (K,) of each part.
    held : (K,) which are held to an error of their own; limit : (K,) that error, infinite for the others.
    """

    cutting: Floats
    error: float
    whole: float
    still: Floats
    own: Floats
    held: Bools
    limit: Floats


def _choose(trial: _Trial, asked: _Asked) -> _Choice | None:
    """The coarsest cutting of each part that does, found with ever finer ones; None where none does within
    `max_lookins`, and where there is no light, which must be looked for harder."""
    parts = len(asked.objects)
    every, settled = np.arange(parts), np.zeros(parts, np.bool_)
    runs, cuttings = [trial.gathered(np.full(parts, COARSE), PATCHES_TRIED).histogram], [np.full(parts, COARSE)]
    whole, own = float(np.linalg.norm(runs[0].sum(axis=1))), _norms(runs[0])
    if whole == 0.0:
        return None
    scale = np.maximum(own, UNSEEN * whole) / math.sqrt(trial.weight.sum())
    finest = np.zeros(parts, np.int64)
    while True:
        cuttings.append(FIRST * FINER ** (len(runs) - 1) * scale)
        before = trial.work.cells + trial.work.rays
        found = trial.gathered(np.where(settled, np.inf, cuttings[-1]), PATCHES_TRIED).histogram
        found[:, settled] = runs[-1][:, settled]
        runs.append(found)
        finest[~settled] = len(runs) - 1
        whole, own = float(np.linalg.norm(found.sum(axis=1))), _norms(found)
        held = asked.objects & (own > 0) & (trial.energy(found) >= asked.faint)
        limit = np.where(held, asked.part_target * own, np.inf)
        still = _still(runs, finest)
        level = np.argmax(np.vstack([still <= WITHIN_PARTS * limit, np.ones(parts, np.bool_)]), axis=0)
        error = _whole_error(runs, level, finest)
        highest = np.where(settled, finest - 1, finest)
        while error > WITHIN * asked.target * whole and (level < highest).any():
            level[np.argmax(np.where(level < highest, still[np.minimum(level, len(still) - 1), every], -1.0))] += 1
            error = _whole_error(runs, level, finest)
        if (level < finest).all():
            return _Choice(np.array(cuttings)[level, every], error, whole, still[level, every], own, held, limit)
        work = trial.work.cells + trial.work.rays
        beyond = work + (work - before) / FINER > trial.gathering.task.accuracy.max_lookins * len(trial.pairs)
        if len(runs) > LEVELS or beyond:
            return None
        # What does already is not cut further, unless the whole still wants it.
        waits = math.sqrt(parts) * still[finest - 1, every] > SETTLED * asked.target * whole
        settled |= (level < finest) & ((error <= WITHIN * asked.target * whole) | ~waits)


def _still(runs: list[Floats], finest: Ints) -> Floats:
    """(n − 1, K) L2 error that each part still has in each run, whose finest one for a part is number `finest`."""
    every = np.arange(len(finest))
    last = runs[-1]
    still = np.array([_norms(run - last) for run in runs[:-1]])
    return np.asarray(still + (REST - 1) * still[finest - 1, every])


def _whole_error(runs: list[Floats], level: Ints, finest: Ints) -> float:
    """L2 error of the sum over parts, each as it is in the run of its level."""
    last = runs[-1].sum(axis=1)
    chosen = sum(runs[n][:, k] for k, n in enumerate(level))
    before = sum(runs[n - 1][:, k] for k, n in enumerate(finest))
    return float(np.linalg.norm(chosen - last) + (REST - 1) * np.linalg.norm(before - last))


def _norms(histograms: Floats) -> Floats:
    """(K,) L2 norm over laser points, pixels and bins of (n, K, T)."""
    return np.asarray(np.sqrt((histograms**2).sum(axis=(0, 2))))


def _trials(pairs: int, values: int) -> int:
    """On how many of so many pairs a cutting is tried, each with so many values of histograms."""
    return int(np.clip(min(pairs // 20, MOST_TRIED // values), *TRIALS))


def pairs_of(task: WalkTask) -> Ints:
    """(n, 2) laser point and pixel of each histogram, in their order; laser rays that met nothing with them."""
    lasers, pixels, _ = task.capture.shape
    if task.capture.pairing == "confocal":
        return np.stack([np.arange(lasers), np.arange(lasers)], axis=1)
    return np.stack(np.divmod(np.arange(lasers * pixels), pixels), axis=1)


def spread_evenly(count: int, wanted: int) -> Ints:
    """At most `wanted` of `count` indices, in no step with the rows of a scan."""
    if count <= wanted:
        return np.arange(count)
    return np.unique(((np.arange(wanted) * (math.sqrt(5) - 1) / 2 + 0.5) % 1.0 * count).astype(np.int64))
