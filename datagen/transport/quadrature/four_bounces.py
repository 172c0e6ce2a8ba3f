"""The secondary of a scan without noise: light of four bounces, from pairs of surface elements.

A laser point lights elements, a pixel sees elements (`transfer.py`), and every element of the first set gives light
to every element of the second (`element_pairs.py`); pairs that bring much light, or are near each other, are halved.
How fine the elements must be is found on some pairs of laser point and pixel (the trial), level by level, until the
next finer level makes little difference. The error of the chosen level is thus known without noise. Each level also
forecasts what the whole scan will cost at the error asked: where sampling costs less, the secondary is left to
samples.

Elements are made for each laser point and each pixel on its own, L + P times for an exhaustive scan. One shadow ray
is cast between the mean positions of each pair of elements.
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
from datagen.transport.memory import VALUES_AT_ONCE
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
"""Limits of the coarsest level: size of an element, relative to its distance; error of an element, relative to the
light of its end; and error of a pair of elements, relative to the light of all pairs. With half of the last two, even
scans with loose targets take twice the time."""
LIGHT_FINER, FINER, REST, LEVELS = 0.5, 0.25, 2.0, 9
"""Factors of the two errors from one level to the next, finer one; error of a level, relative to its difference from
the next, for errors fall to about half (1 + 1/2 + 1/4 + … = 2); and the most levels. Half of a factor overshoots
loose targets; half of `REST` claims errors too small; half of `LEVELS` gives strict targets to samples."""
GROWTH, FALL = 2.5, 0.65
"""Typical factors of the number of pairs of elements and of the error from one level to the next, by which levels not
yet tried are forecast. With half of the first, dear levels are tried in vain."""
WITHIN = 0.85
"""Largest estimate of error on the trial's pairs, relative to the error asked, that is accepted: other pairs may be
worse. Half of it costs a level more."""
TRIALS, LOOKED_AT = (8, 48), 4
"""Fewest and most pairs of laser point and pixel in the trial, one in 32 of the scan's pairs in between; and the
number of pairs computed roughly for each that is drawn. Half as many pairs represent the scan less well."""
PATCH_LEVELS, PATCHES_SHARE, PATCHES_AT_MOST = 3, 0.25, 0.5
"""Most times that pixels are quartered; fraction of the error asked that the size of footprints may cause, and the
same for the finest footprints. Half of the fractions takes up to twice the footprints."""
ELEMENT_PAIRS_AT_ONCE = VALUES_AT_ONCE // 16
ROUNDING = 1e-12
"""Rounding error of the running sums: bins below this share of a histogram's highest bin, and overflow below this
share of all light, count as zero."""


@dataclass(frozen=True)
class Secondary:
    """The secondary of all laser points and pixels.

    Attributes
    ----------
    histogram : (L, P, T), overflow : (L, P), in photons.
    error : estimated L2 error of the histogram, in photons.
    pairs, rays : numbers of pairs of elements and of shadow rays, those of trials included.
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

    If `own` would cost too much, only `limit` is met; if that would cost too much as well, returns None.

    faint : energy, photons per emitted photon over all histograms, below which `own` does not apply.
    too_dear : whether a cost, in the units of `cost.py`, is too much.
    """
    try:
        return _secondary(gathering, limit, own, faint, too_dear)
    except _TooDear:
        return None


class _TooDear(Exception):
    """Computing the elements' light costs far more than forecast, as happens when narrow lobes are searched for."""


def _secondary(
    gathering: Gathering, limit: float, own: float, faint: float, too_dear: Callable[[float], bool]
) -> Secondary | None:
    """The same as `secondary_by_cells`, but raises `_TooDear` where the search for pairs has to be stopped."""
    scan, task = replace(_Scan.of(gathering), too_dear=too_dear), gathering.task
    pairs = pairs_of(task.capture)
    lit = pairs[task.points.part[pairs[:, 0]] >= 0]
    patches, most = scan.patches_to_begin, _Most(len(lit), too_dear)
    if len(lit) == 0 or most.exceeded(scan.light(lit[:1], 0, patches, np.inf).cost):
        return None
    wanted = int(np.clip(len(lit) // 32, *TRIALS))
    candidates = lit[spread_evenly(len(lit), LOOKED_AT * wanted)]
    rough = scan.light(candidates, 0, patches, np.inf)
    if gathering.lobed:
        # Coarse elements may miss lobes, and the light that they find is then no measure of how fine to begin.
        matt = scan.light(candidates, 0, patches, np.inf, matt=True)
        rough = replace(
            rough, histogram=rough.histogram + matt.histogram, photons=np.maximum(rough.photons, matt.photons)
        )
    gain = max(rough.gain, 1e-300)
    scale = float(rough.photons.sum() / gain)
    if scale == 0.0:
        return None
    scan = replace(scan, caught=rough.caught)
    if math.isfinite(limit):
        # Where the limit is loose beside the secondary's own light, coarser pairs are enough: there are lobes that
        # bring next to no light at any cost.
        scale = max(scale, limit / math.sqrt(len(lit)) * len(candidates) / gain)
    tried, represented = by_light(np.linalg.norm(rough.histogram, axis=1, keepdims=True), wanted)
    tried, weight = candidates[tried], represented * len(lit) / len(candidates)
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
    """Limit of the cost of `count` pairs of laser point and pixel."""

    count: int
    too_dear: Callable[[float], bool]

    def exceeded(self, each: float) -> bool:
        """Whether a cost of `each` for every pair is too much."""
        return self.too_dear(self.count * each)


@dataclass(frozen=True)
class _Level:
    """The chosen refinement level, and the result of the trial.

    Attributes
    ----------
    number : refinement level, a fraction between two levels that were tried.
    patches : times that pixels are quartered.
    error : L2 error of the whole scan at this level.
    finest, of_finest : light of the trial's pairs at the finest level tried, and its L2 error.
    pairs, rays : pairs of elements and shadow rays of the trial.
    """

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
    """The coarsest refinement level that meets the errors asked, None if that would cost too much.

    tried, weight : (n, 2) pairs of the trial, and (n,) number of pairs that each represents.
    patches : times that pixels are quartered at first. scale : mean photons of a pair of gain one.
    limit, own, faint : as in `secondary_by_cells`.
    """
    # Squares of weighted histograms add up to those of the whole scan.
    root = np.sqrt(weight)[:, None]
    runs, histograms, of_patches = list[_Light](), list[Floats](), 0.0
    while True:
        n = len(runs)
        runs.append(scan.light(tried, n, patches, PAIR * FINER**n * scale))
        histograms.append(root * runs[-1].histogram)
        # Coarse elements reach into a window that ends before the light: where finer ones do not, it has no light of
        # its own to which an error could be relative.
        norm = l2_norm(histograms[-1])
        own_applies = norm > 0.0 and runs[-1].photons @ weight >= faint
        wanted = min(limit, own * norm) if own_applies else limit
        if n == 0:
            continue
        if n == 1:
            # Quartering is chosen at level 1: the coarsest elements change with the footprints, too.
            number, _ = _to_reach(_errors_of(histograms), WITHIN * limit)
            least = _cost_at([run.cost for run in runs], number) / runs[1].cost
            patches, of_patches = _patches_for(
                scan, tried, root, patches, runs[1], histograms[1], PAIR * FINER * scale, wanted, least, most
            )
            if patches < 0:
                return None
        # The light between clusters and elements beside them has the same error at all levels, which no difference
        # between levels shows.
        doubt = [run.doubt * l2_norm(histogram) for run, histogram in zip(runs, histograms, strict=True)]
        errors = _errors_of(histograms) + of_patches + doubt[:-1]
        costs = [run.cost for run in runs]
        # The target of the secondary's own light is given up where it costs too much, or no level is left.
        for goal in (wanted, limit):
            number, error = _to_reach(errors, WITHIN * goal)
            if (number <= n - 1 or n < LEVELS) and not most.exceeded(_cost_at(costs, number)):
                break
        else:
            return None
        if number > n - 1:
            continue
        error_of_finest = (REST - 1) * l2_norm(histograms[-1] - histograms[-2]) + of_patches + doubt[-1]
        return _Level(
            number,
            patches,
            error,
            runs[-1],
            error_of_finest,
            sum(run.pairs for run in runs),
            sum(run.rays for run in runs),
        )


def _to_reach(errors: Floats, wanted: float) -> tuple[float, float]:
    """The level whose error is `wanted`, and the error that it leaves, from the errors (n,) of levels 0 … n − 1.

    The level is interpolated between two levels, or extrapolated beyond the last one by `FALL`; it is at least 0.
    """
    fine = np.flatnonzero(errors <= wanted)
    if len(fine) == 0:
        steps = math.log(wanted / errors[-1]) / math.log(FALL) if wanted > 0.0 else math.inf
        return len(errors) - 1 + steps, wanted
    level = int(fine[0])
    if level == 0 or not 0.0 < errors[level] < wanted < errors[level - 1]:
        return float(level), float(errors[level])
    return level - math.log(wanted / errors[level]) / math.log(errors[level - 1] / errors[level]), wanted


def _cost_at(costs: list[float], level: float) -> float:
    """Cost of a level, interpolated between the costs of levels 0 … n − 1 or extrapolated by `GROWTH`; infinite for
    the level of no error at all."""
    if level == math.inf:
        return math.inf
    known = min(math.floor(level), len(costs) - 1)
    growth = costs[known + 1] / costs[known] if known + 1 < len(costs) else GROWTH
    return float(costs[known] * growth ** (level - known))


def _patches_for(
    scan: _Scan, pairs: Ints, root: Floats, level: int, run: _Light, coarse: Floats, allowed: float, wanted: float,
    least: float, most: _Most,
) -> tuple[int, float]:  # fmt: skip
    """Times that pixels have to be quartered, −1 if that is too often or would cost too much; and the L2 error of the
    footprints.

    level, run, coarse : times that pixels are quartered at first, light with these footprints, and its weighted
        histograms.
    allowed : error that a pair of elements may make. wanted : L2 error asked.
    least : cost of the coarsest level that meets the limit, relative to that of `run`.
    """
    error = math.inf
    while not most.exceeded(least * run.cost):
        if not scan.extended:
            return level, 0.0
        if level == PATCH_LEVELS:
            # Half the error of footprints twice as large: at edges the error is of first order.
            return (level, 0.5 * error) if 0.5 * error <= PATCHES_AT_MOST * wanted else (-1, 0.0)
        run = scan.light(pairs, 1, level + 1, allowed)
        finer = root * run.histogram
        # The error is of second order: it is the sum of all further changes, 1 + 1/4 + 1/16 + … = 4/3 of this one.
        error = 4 / 3 * l2_norm(finer - coarse)
        if error <= PATCHES_SHARE * wanted:
            return level, error
        level, coarse = level + 1, finer
    return -1, 0.0


def _errors_of(histograms: list[Floats]) -> Floats:
    """(n − 1,) estimated L2 error of each of n runs but the last: its difference from the last run, and the error
    that the last run still has."""
    difference = np.array([l2_norm(run - histograms[-1]) for run in histograms[:-1]])
    return np.asarray(difference + (REST - 1) * difference[-1])


@dataclass(frozen=True)
class _Light:
    """Light of n pairs of laser point and pixel.

    Attributes
    ----------
    histogram, photons : (n, T) photons by bin, and (n,) all photons, those outside the window included.
    gain : sum of the pairs' gains.
    caught : mean fraction of an end's light that its elements catch.
    near : photons between clusters and elements that are too near for them to be known.
    pairs, rays : numbers of pairs of elements looked at, and of shadow rays.
    """

    histogram: Floats
    photons: Floats
    gain: float
    caught: float
    near: float
    pairs: int
    rays: int

    @property
    def doubt(self) -> float:
        """Fraction of the light that is not known."""
        return self.near / max(float(self.photons.sum()), self.near, 1e-300)

    @property
    def cost(self) -> float:
        """Cost for each pair of laser point and pixel, in the units of `cost.py`."""
        return (CELL_PAIR * self.pairs + PAIR_RAY * self.rays) / max(len(self.photons), 1)


@dataclass(frozen=True)
class _Scan:
    """A scene and a capture, from which ends and their elements are made as needed."""

    gathering: Gathering
    extended: bool
    """Whether some pixel is larger than a point."""
    patches_to_begin: int
    """Times that pixels are quartered in the first runs."""
    caught: float = 1.0
    """Mean fraction of an end's light that surfaces catch: in the open most of the light meets nothing."""
    too_dear: Callable[[float], bool] = lambda cost: False
    """Whether a cost is too much; the search for pairs ends at twice such a cost."""
    found: Found = field(default_factory=lambda: Found.room(ELEMENT_PAIRS_AT_ONCE))
    """Memory for pairs of elements."""

    @classmethod
    def of(cls, gathering: Gathering) -> _Scan:
        """The scan of a gathering; pixels far smaller than the scene count as points, except at edges."""
        task, at_edge = gathering.task, bool(gathering.at_edge.any())
        small = task.patches.radius.max(initial=0.0) < 1e-3 * task.caster.half_extent_m
        return cls(gathering, not small or at_edge, 2 if at_edge else 0)

    @property
    def task(self) -> Problem:
        """The scene, the capture and the accuracy asked."""
        return self.gathering.task

    def light(self, pairs: Ints, level: float, patches: int, allowed: float, matt: bool = False) -> _Light:
        """The secondary of some pairs (n, 2) of laser point and pixel, by elements of a refinement level.

        patches : times that pixels are quartered. allowed : L2 error that a pair of elements may make.
        matt : whether every surface is taken as Lambertian with its albedo.
        """
        bins = self.task.capture.time.bins
        knots, photons = np.zeros((len(pairs), bins + 3)), np.zeros(len(pairs))
        gain, caught, near, count, rays = 0.0, 0.0, 0.0, 0, 0
        # An end of an exhaustive scan is in many pairs, so that they have fewer ends to hold.
        at_once = VALUES_AT_ONCE // (8192 if self.task.capture.pairing == "confocal" else 1024)
        for start in range(0, len(pairs), at_once):
            run = slice(start, start + at_once)
            gain_of_run, share, doubt, pairs_of_run, shadow_rays = self._add(
                pairs[run], start, LIGHT * LIGHT_FINER**level * self.caught, patches, allowed, matt, knots, photons
            )
            gain, caught, near = gain + gain_of_run, caught + share * len(pairs[run]) / len(pairs), near + doubt
            count, rays = count + pairs_of_run, rays + shadow_rays
        histogram = np.cumsum(np.cumsum(knots, axis=1), axis=1)[:, :bins]
        histogram[histogram < ROUNDING * histogram.max(axis=1, initial=0.0, keepdims=True)] = 0.0
        return _Light(histogram, photons, gain, caught, near, count, rays)

    def _add(
        self, pairs: Ints, first: int, error: float, patches: int, allowed: float, matt: bool, knots: Floats,
        photons: Floats,
    ) -> tuple[float, float, float, int, int]:  # fmt: skip
        """Add the light of some pairs of laser point and pixel to `knots` and `photons`, from row `first` on.

        Returns the sum of their gains, the mean fraction of an end's light that is caught, photons between clusters
        and elements too near to them, the number of pairs of elements looked at, and the number of shadow rays.

        error : error that an element may make, relative to the light of its end.
        """
        task, axis, attenuation = self.task, self.task.capture.time, self.task.scene.attenuation_per_m
        tree, occluders, width = self.gathering.tree, self.gathering.occluders, self.gathering.width
        device, occlusion = axis.origin == "source", task.accuracy.occlusion != "off"
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
        # Without occlusion only the last legs go without shadow rays: the light of the laser always casts shadows.
        ones, rays = elements_of(lit, tree, occluders, optics, Fineness(COARSEST, error, True, seed))
        same = self._same(lit, seen, pairs)
        twos = ones
        if not same:
            twos, more = elements_of(seen, tree, occluders, optics, Fineness(COARSEST, error, occlusion, seed))
            rays += more
        legs = leg1[i] + leg3[p]
        gain = np.exp(-attenuation * leg1[i]) * weight[p]
        per_metre = 1.0 / float(path_from_time(axis.width_s))
        zero = axis.start_s / axis.width_s - (legs * per_metre if device else np.zeros(len(legs)))
        caster, found = task.caster, self.found
        of_ends = EndPairs(
            np.stack([i.reshape(-1), p.reshape(-1)], axis=1), 2.0 * gain if same else gain, zero,
            first + np.arange(len(pairs)),
        )  # fmt: skip
        rules = Rules(
            same, allowed, ELEMENT_PAIRS_AT_ONCE, attenuation, per_metre, caster.offset_m,
            np.array([*caster.center, caster.half_extent_m]),
        )  # fmt: skip
        at, waiting, count, near = (0, -1, -1), np.empty((DEEPEST + 2, 2), np.int64), 0, 0.0
        while at[0] < len(pairs):
            at, joined, looked_at, doubt = join(at, of_ends, lit, ones, seen, twos, optics, rules, found, waiting)
            count, near = count + looked_at, near + doubt
            if occlusion and occluders.triangles > 0:
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
        """Whether each laser point is its own pixel, so that a path and its reverse bring the same light."""
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
        """Some laser points as ends, and their distances from the laser, metres (n,)."""
        points = self.task.points
        one = np.ones((len(lasers), 1))
        ends = Ends.of(
            np.nan_to_num(points.position[lasers])[:, None], points.normal[lasers][:, None],
            points.to_laser[lasers][:, None], points.part[lasers][:, None], one, 0 * one,
        )  # fmt: skip
        return ends, np.nan_to_num(points.leg[lasers])

    def _pixels(self, pixels: Ints, level: int, device: bool) -> tuple[Ends, Floats, Floats]:
        """The finest footprints of some pixels as ends; their weights (n,), attenuation by air included, and their
        mean distances from the sensor, metres (n,)."""
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
