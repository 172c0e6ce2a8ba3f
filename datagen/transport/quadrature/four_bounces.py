"""The secondary of a scan without noise: light of four bounces, from pairs of cells.

A laser point lights cells, a pixel sees cells (`transfer.py`), and every cell of the one gives light to every
cell of the other (`element_pairs.py`); pairs that bring much of the light, or are near each other, are cut further.
How fine that must be is found on some pairs of laser point and pixel, with ever finer cells, until the next finer
ones make little difference. The error of what is chosen is thus known without noise. And each finer level foretells
what the cells of all pairs will cost to meet the error asked: where samples cost less, they are left to those.

Cells are cut for each laser point and each pixel on its own, L + P times for an exhaustive scan. One ray is asked
between the middles of each pair of cells.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np

from datagen.records.arrays import Floats, Ints, l2_norm
from datagen.seeding import LightStream
from datagen.transport.brdf.table import LAMBERTIAN, OREN_NAYAR
from datagen.transport.error_control.cost import CELL_PAIR, PAIR_RAY
from datagen.transport.error_control.refinement import by_light, spread_evenly
from datagen.transport.problem import Problem
from datagen.transport.quadrature.element_pairs import DEEPEST, EndPairs, Found, Rules, arrive, join
from datagen.transport.quadrature.gathering import Gathering, patches_of
from datagen.transport.quadrature.transfer import (
    ENERGY,
    SHARE,
    TO_DEVICE,
    UPWARD,
    Ends,
    Fineness,
    Optics,
    elements_of,
)
from datagen.transport.reference import pairs_of
from datagen.transport.sampling import stream_seeds
from datagen.units import path_from_time

COARSEST, LIGHT, PAIR = 1.2, 0.1, 4e-3
"""Of the coarsest cells: the largest, relative to its distance; its error, relative to the light of its end; and the
error of a pair, relative to the light of all pairs. With half of the last two even scans that ask for little take
twice the time."""
LIGHT_FINER, FINER, REST, LEVELS = 0.5, 0.25, 2.0, 9
"""What the two errors are multiplied with from one level to the next, finer one; the error of a level, relative to
its difference from the next, for errors fall to about half; and the number of levels at most."""
GROWTH, FALL = 2.5, 0.65
"""Pairs of cells and error from one level to the next, about: what levels not yet tried are foretold by."""
WITHIN = 0.85
"""Share of the error to be met that its estimate may reach on the pairs tried: others may be worse."""
TRIALS, LOOKED_AT = (8, 48), 4
"""Fewest and most pairs of laser point and pixel on which the level is chosen, one in 32 in between; and how many
are looked at roughly for each of them."""
PATCH_LEVELS, PATCHES_SHARE, PATCHES_AT_MOST, FROM_QUARTERS = 3, 0.25, 0.5, 4 / 3
"""How often pixels are quartered at most; the share of the error that may come of it, and with the finest footprints;
and that error, relative to what quartering them once more changes."""
CONFOCAL_AT_ONCE, EXHAUSTIVE_AT_ONCE, PAIRS_AT_ONCE = 512, 4096, 1 << 18
ROUNDING = 1e-12
"""What is left of a histogram where its light has ended, relative to its highest bin; and outside of the window,
relative to all."""


@dataclass(frozen=True)
class Secondary:
    """The secondary of all laser points and pixels.

    Attributes
    ----------
    histogram : (L, P, T), overflow : (L, P), in photons.
    error : L2 error of it, in photons, as estimated.
    pairs, rays : how many pairs of cells and rays, those of trials with them.
    """

    histogram: Floats
    overflow: Floats
    error: float
    pairs: int
    rays: int


def secondary_by_cells(
    gathering: Gathering,
    limit: float,
    own: float,
    faint: float = 0.0,
    too_dear: Callable[[float], bool] = lambda cost: False,
) -> Secondary | None:
    """The secondary with an L2 error of at most `limit`, in photons, and of `own` relative to its own norm.

    The second is given up for the first where it would cost too much. Returns nothing where the first would, too.

    faint : photons, per emitted photon and over all histograms, under which it is not held to the second.
    too_dear : whether a cost, in the units of `cost.py`, is too much.
    """
    try:
        return _secondary(gathering, limit, own, faint, too_dear)
    except _TooDear:
        return None


class _TooDear(Exception):
    """Cells took far more pairs than were foretold, or than anything foretold: narrow lobes are searched for."""


def _secondary(
    gathering: Gathering, limit: float, own: float, faint: float, too_dear: Callable[[float], bool]
) -> Secondary | None:
    """As `secondary_by_cells`, but that `_TooDear` is raised."""
    scan, task = replace(_Scan.of(gathering), too_dear=too_dear), gathering.task
    pairs = pairs_of(task.capture)
    lit = pairs[task.points.part[pairs[:, 0]] >= 0]
    patches, most = scan.patches_to_begin, _Most(len(lit), too_dear)
    if len(lit) == 0 or most.exceeded(scan.light(lit[:1], 0, patches, np.inf).cost):
        return None
    wanted = int(np.clip(len(lit) // 32, *TRIALS))
    looked = lit[spread_evenly(len(lit), LOOKED_AT * wanted)]
    rough = scan.light(looked, 0, patches, np.inf)
    if gathering.lobed:
        # Coarse cells may miss lobes, and what they find is then no measure of how fine to begin.
        matt = scan.light(looked, 0, patches, np.inf, matt=True)
        rough = replace(
            rough, histogram=rough.histogram + matt.histogram, photons=np.maximum(rough.photons, matt.photons)
        )
    gain = max(rough.gain, 1e-300)
    scale = float(rough.photons.sum() / gain)
    if scale == 0.0:
        return None
    scan = replace(scan, caught=rough.caught)
    if math.isfinite(limit):
        # Where far less is asked than of its own light, coarser pairs will do: some lobes bring nothing at any price.
        scale = max(scale, limit / math.sqrt(len(lit)) * len(looked) / gain)
    tried, stands_for = by_light(np.linalg.norm(rough.histogram, axis=1, keepdims=True), wanted)
    tried, weight = looked[tried], stands_for * len(lit) / len(looked)
    level = _level(scan, tried, weight, patches, scale, limit, own, faint, most)
    if level is None:
        return None
    if len(tried) == len(pairs):
        found, error = level.finest, level.of_finest
    else:
        found = scan.light(pairs, level.number, level.patches, PAIR * FINER**level.number * scale)
        error = level.error
    shape, outside = task.capture.shape, found.photons - found.histogram.sum(axis=1)
    outside[outside < ROUNDING * found.photons] = 0.0
    return Secondary(
        found.histogram.reshape(shape), outside.reshape(shape[:2]), error,
        rough.pairs + level.pairs + found.pairs, rough.rays + level.rays + found.rays,
    )  # fmt: skip


@dataclass(frozen=True)
class _Most:
    """What the cells of so many pairs of laser point and pixel may cost."""

    count: int
    too_dear: Callable[[float], bool]

    def exceeded(self, each: float) -> bool:
        """Whether so much for each of them is too much."""
        return self.too_dear(self.count * each)


@dataclass(frozen=True)
class _Level:
    """How finely cells are cut, between two of the levels tried, and how often pixels are quartered; the L2 error
    that this leaves; the light of the finest tried and its error; and what finding it took."""

    number: float
    patches: int
    error: float
    finest: _Light
    of_finest: float
    pairs: int
    rays: int


def _level(
    scan: _Scan, tried: Ints, weight: Floats, patches: int, scale: float, limit: float, own: float, faint: float,
    most: _Most,
) -> _Level | None:  # fmt: skip
    """The coarsest that will do, or nothing where that would cost too much."""
    root = np.sqrt(weight)[:, None]
    runs, histograms, of_patches = list[_Light](), list[Floats](), 0.0
    while True:
        n = len(runs)
        runs.append(scan.light(tried, n, patches, PAIR * FINER**n * scale))
        histograms.append(root * runs[-1].histogram)
        held = runs[-1].photons @ weight >= faint
        wanted = min(limit, own * l2_norm(histograms[-1])) if held else limit
        if n == 0:
            continue
        if n == 1:
            # Not with the coarsest cells: how those are cut changes with the patches, too.
            number, _ = _to_reach(_still(histograms), WITHIN * limit)
            least = _cost_at([run.cost for run in runs], number) / runs[1].cost
            patches, of_patches = _patches_for(
                scan, tried, root, patches, runs[1], histograms[1], PAIR * FINER * scale, wanted, least, most
            )
            if patches < 0:
                return None
        # What clusters give to cells beside them is wrong alike at all levels.
        doubt = [run.doubt * l2_norm(histogram) for run, histogram in zip(runs, histograms, strict=True)]
        still = _still(histograms) + of_patches + doubt[:-1]
        costs = [run.cost for run in runs]
        # The error of its own light is given up where that costs too much, and where no level is left.
        for goal in (wanted, limit):
            number, error = _to_reach(still, WITHIN * goal)
            if (number <= n - 1 or n < LEVELS) and not most.exceeded(_cost_at(costs, number)):
                break
        else:
            return None
        if number > n - 1:
            continue
        left = (REST - 1) * l2_norm(histograms[-1] - histograms[-2]) + of_patches + doubt[-1]
        return _Level(
            number, patches, error, runs[-1], left, sum(run.pairs for run in runs), sum(run.rays for run in runs)
        )


def _to_reach(still: Floats, wanted: float) -> tuple[float, float]:
    """The level that leaves an error of `wanted`, with those that some levels leave, and what it leaves: between two
    of them or the first where one does, else as many levels beyond the last as it will take."""
    fine = np.flatnonzero(still <= wanted)
    if len(fine) == 0:
        steps = math.log(wanted / still[-1]) / math.log(FALL) if wanted > 0.0 else math.inf
        return len(still) - 1 + steps, wanted
    level = int(fine[0])
    if level == 0 or not 0.0 < still[level] < wanted < still[level - 1]:
        return float(level), float(still[level])
    return level - math.log(wanted / still[level]) / math.log(still[level - 1] / still[level]), wanted


def _cost_at(costs: list[float], level: float) -> float:
    """Cost of a level, with those of some levels."""
    known = min(math.floor(level), len(costs) - 1)
    growth = costs[known + 1] / costs[known] if known + 1 < len(costs) else GROWTH
    return float(costs[known] * growth ** (level - known))


def _patches_for(
    scan: _Scan, pairs: Ints, root: Floats, level: int, run: _Light, coarse: Floats, allowed: float, wanted: float,
    least: float, most: _Most,
) -> tuple[int, float]:  # fmt: skip
    """How often pixels have to be quartered, −1 for too often or where all would cost too much, and the L2 error that
    this leaves.

    run, coarse : with the pixels as they are, and its weighted histograms. least : cost of the coarsest cells that
    will do, relative to those of the run.
    """
    off = math.inf
    while not most.exceeded(least * run.cost):
        if not scan.extended:
            return level, 0.0
        if level == PATCH_LEVELS:
            # Half the error of those twice as large, where an edge makes it one of first order.
            return (level, 0.5 * off) if 0.5 * off <= PATCHES_AT_MOST * wanted else (-1, 0.0)
        run = scan.light(pairs, 1, level + 1, allowed)
        finer = root * run.histogram
        off = FROM_QUARTERS * l2_norm(finer - coarse)
        if off <= PATCHES_SHARE * wanted:
            return level, off
        level, coarse = level + 1, finer
    return -1, 0.0


def _still(histograms: list[Floats]) -> Floats:
    """(n − 1,) L2 error that each run still has, the last of them apart."""
    off = np.array([l2_norm(run - histograms[-1]) for run in histograms[:-1]])
    return np.asarray(off + (REST - 1) * off[-1])


@dataclass(frozen=True)
class _Light:
    """Histograms (n, T) and all photons (n,) of pairs; the sum of their gains; the mean share of an end's light that
    its cells catch; photons of clusters that are too near to other cells; pairs of cells looked at, and rays."""

    histogram: Floats
    photons: Floats
    gain: float
    caught: float
    near: float
    pairs: int
    rays: int

    @property
    def doubt(self) -> float:
        """Share of the light that is not known."""
        return self.near / max(float(self.photons.sum()), self.near, 1e-300)

    @property
    def cost(self) -> float:
        """In the units of `cost.py`, for each pair."""
        return (CELL_PAIR * self.pairs + PAIR_RAY * self.rays) / max(len(self.photons), 1)


@dataclass(frozen=True)
class _Scan:
    """A scene and a capture as the compiled loops want them; the ends of pixels are made when they are asked for."""

    gathering: Gathering
    extended: bool
    """Whether some pixel is larger than a point."""
    patches_to_begin: int
    caught: float = 1.0
    """Mean share of an end's light that surfaces catch: in the open the rest flies off."""
    too_dear: Callable[[float], bool] = lambda cost: False
    """Whether a cost is too much: twice that ends the search for pairs."""
    found: Found = field(default_factory=lambda: Found.room(PAIRS_AT_ONCE))

    @classmethod
    def of(cls, gathering: Gathering) -> _Scan:
        task, at_edge = gathering.task, bool(gathering.at_edge.any())
        small = task.patches.radius.max(initial=0.0) < 1e-3 * task.caster.half_extent_m
        return cls(gathering, not small or at_edge, 2 if at_edge else 0)

    @property
    def task(self) -> Problem:
        """What is asked of the scene."""
        return self.gathering.task

    def light(self, pairs: Ints, level: float, patches: int, allowed: float, matt: bool = False) -> _Light:
        """The secondary of some pairs of laser point and pixel, by cells of a level.

        matt : as if every surface followed Lambert's law with its albedo.
        """
        bins = self.task.capture.time.bins
        knots, photons = np.zeros((len(pairs), bins + 3)), np.zeros(len(pairs))
        gain, caught, near, count, rays = 0.0, 0.0, 0.0, 0, 0
        at_once = CONFOCAL_AT_ONCE if self.task.capture.pairing == "confocal" else EXHAUSTIVE_AT_ONCE
        for start in range(0, len(pairs), at_once):
            run = slice(start, start + at_once)
            of_run, share, doubt, joined, asked = self._add(
                pairs[run], start, LIGHT * LIGHT_FINER**level * self.caught, patches, allowed, matt, knots, photons
            )
            gain, caught, near = gain + of_run, caught + share * len(pairs[run]) / len(pairs), near + doubt
            count, rays = count + joined, rays + asked
        histogram = np.cumsum(np.cumsum(knots, axis=1), axis=1)[:, :bins]
        histogram[histogram < ROUNDING * histogram.max(axis=1, initial=0.0, keepdims=True)] = 0.0
        return _Light(histogram, photons, gain, caught, near, count, rays)

    def _add(
        self, pairs: Ints, first: int, error: float, patches: int, allowed: float, matt: bool, knots: Floats,
        photons: Floats,
    ) -> tuple[float, float, float, int, int]:  # fmt: skip
        """Add the knots of a run of pairs; returns the sum of their gains, the share of their light that is caught,
        photons of clusters too near to other cells, pairs of cells looked at, and rays."""
        task, axis, air = self.task, self.task.capture.time, self.task.scene.attenuation_per_m
        tree, occluders, width = self.gathering.tree, self.gathering.occluders, self.gathering.width
        device, asked = axis.origin == "source", task.accuracy.occlusion != "off"
        lasers, i = np.unique(pairs[:, 0], return_inverse=True)
        pixels, p = np.unique(pairs[:, 1], return_inverse=True)
        seed = int(stream_seeds(task.seed, LightStream.PAIR_CLUSTERS, first, np.zeros(1, np.int64))[0])
        lit, leg1 = self._lasers(lasers)
        seen, weight, leg3 = self._pixels(pixels, patches, device)
        materials, sharp = task.materials, 1.0 / width**2
        if matt:
            materials, sharp = replace(materials, kind=np.zeros_like(materials.kind)), np.ones_like(width)
        narrow = ~np.isin(materials.kind, (LAMBERTIAN, OREN_NAYAR))
        optics = Optics(materials.kind, materials.values, sharp, narrow)
        # The laser is no reason to leave rays out: whoever asks for no occlusion means the last leg.
        ones, rays = elements_of(lit, tree, occluders, optics, Fineness(COARSEST, error, True, seed))
        same = self._same(lit, seen, pairs)
        twos = ones
        if not same:
            twos, more = elements_of(seen, tree, occluders, optics, Fineness(COARSEST, error, asked, seed))
            rays += more
        legs = leg1[i] + leg3[p]
        gain = np.exp(-air * leg1[i]) * weight[p]
        per_metre = 1.0 / float(path_from_time(axis.width_s))
        zero = axis.start_s / axis.width_s - (legs * per_metre if device else np.zeros(len(legs)))
        caster, found = task.caster, self.found
        of_ends = EndPairs(
            np.stack([i.reshape(-1), p.reshape(-1)], axis=1), 2.0 * gain if same else gain, zero,
            first + np.arange(len(pairs)),
        )  # fmt: skip
        rules = Rules(
            same, allowed, PAIRS_AT_ONCE, air, per_metre, caster.offset_m,
            np.array([*caster.center, caster.half_extent_m]),
        )  # fmt: skip
        at, waiting, count, near = (0, -1, -1), np.empty((DEEPEST + 2, 2), np.int64), 0, 0.0
        while at[0] < len(pairs):
            at, joined, looked_at, doubt = join(at, of_ends, lit, ones, seen, twos, optics, rules, found, waiting)
            count, near = count + looked_at, near + doubt
            if asked and occluders.any:
                hidden = caster.occluded_scaled(found.origin[:joined], found.span[:joined])
                rays += joined
            else:
                hidden = np.zeros(joined, np.bool_)
            arrive(found, joined, hidden, knots, photons)
            if self.too_dear(0.5 * (CELL_PAIR * count + PAIR_RAY * rays)):
                raise _TooDear
        energy = sum(of.known[: of.first[-1], ENERGY].sum() for of in (ones, twos))
        return float(gain.sum()), float(energy / (len(lasers) + len(pixels))), near, count, rays

    def _same(self, lit: Ends, seen: Ends, pairs: Ints) -> bool:
        """Whether each laser point is its own pixel, so that light may go round either way."""
        if self.task.capture.pairing != "confocal" or seen.part.shape[1] > 1 or len(lit.part) != len(seen.part):
            return False
        if (lit.part != seen.part).any() or (pairs[:, 0] != pairs[:, 1]).any():
            return False
        near = 1e-6 * self.gathering.tree.extent
        alike = np.abs(lit.point - seen.point)[..., :UPWARD].max(axis=(1, 2)) < near
        kinds = self.task.materials.kind[lit.part[:, 0]]
        alike &= (kinds == LAMBERTIAN) | (
            np.abs(lit.point - seen.point)[..., TO_DEVICE:SHARE].max(axis=(1, 2)) < 1e-6
        )
        return bool((alike | (lit.part[:, 0] < 0)).all())

    def _lasers(self, lasers: Ints) -> tuple[Ends, Floats]:
        points = self.task.points
        one = np.ones((len(lasers), 1))
        ends = Ends.of(
            np.nan_to_num(points.position[lasers])[:, None], points.normal[lasers][:, None],
            points.to_laser[lasers][:, None], points.part[lasers][:, None], one, 0 * one,
        )  # fmt: skip
        return ends, np.nan_to_num(points.leg[lasers])

    def _pixels(self, pixels: Ints, level: int, device: bool) -> tuple[Ends, Floats, Floats]:
        """The finest patches of some pixels as ends; their weight (n,), air in it, and metres to the sensor (n,)."""
        patches = patches_of(self.task, pixels, level)
        finest = slice((4**level - 1) // 3, None)
        part, weight, leg = patches.part[:, finest], patches.weight[:, finest], patches.leg[:, finest]
        weight = np.where(part >= 0, weight, 0.0)
        whole = weight.sum(axis=1)
        share = weight / np.where(whole > 0, whole, 1.0)[:, None]
        mean = (share * np.where(part >= 0, leg, 0.0)).sum(axis=1)
        longer = np.where(part >= 0, leg - mean[:, None], 0.0) if device else np.zeros_like(leg)
        part = np.where(weight > 0, part, -1)
        ends = Ends.of(
            patches.position[:, finest], patches.normal[:, finest], patches.to_sensor[:, finest], part, share, longer,
        )  # fmt: skip
        return ends, whole, mean
