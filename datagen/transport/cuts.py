"""The primary (three bounces) by stochastic cuts: unbiased, whatever the effort.

The light of a laser point x and a pixel is the integral over hidden points y and FoV points z. The FoV points of a
pixel are drawn anew in each run and form a tree of clusters. Surfaces, as boxes of triangles and pieces of triangles,
and clusters are cut until every element, a pair of both, is expected to bring at most δ photons. Nothing is left out
but what no FoV point of the cluster can see. Each element gives one sample: a point y drawn by its guessed light, and
a FoV point z; two shadow rays decide. A piece of a triangle spreads its light over the arrival times of its parts.
Guesses steer the effort; the mean does not depend on them. Each of the two replicates of a run has elements of its
own, because errors of those that are shared cannot be seen.

The idea of a cut through a tree of surfaces is that of lightcuts (Walter et al., SIGGRAPH 2005), with a random point
in place of a representative one (stochastic lightcuts: Yuksel, HPG 2019), here for pairs of trees.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from datagen.records import Scene
from datagen.records.arrays import Bools, Floats, Ints, l2_norm
from datagen.seeding import LightStream
from datagen.transport.arrival_times import Work
from datagen.transport.brdf import LAMBERTIAN, lobe_width
from datagen.transport.bvh import ON_PLANE, SMALLEST, Hierarchy
from datagen.transport.cut_elements import CutSetup, Walk
from datagen.transport.cut_steps import Asked, Batch, emit, legs_of, pour_all, widest
from datagen.transport.fov_clusters import FovClusters, squares_of
from datagen.transport.laser_points import LaserPoints
from datagen.transport.memory import VALUES_AT_ONCE
from datagen.transport.problem import Problem
from datagen.transport.sampling import stream_seeds
from datagen.units import path_from_time

LOOKED_AT = 16
"""Histograms that are looked at first, to tell how bright the scene is, about; fewer are looked at several times."""
LOOK = 8
"""Laser points of a flood's histogram in a look, in place of the 64 to 192 of a zone sensor."""
SECOND_LOOK = 256
"""Pairs of laser point and pixel, over all histograms, in a second look where the first met no light: that there is
none is said of what 16 times as many elements did not meet."""
LOOK_PAIRS = 1 << 12
"""Pairs of laser point and pixel up to which the cells of a beam are divided for the looks: those of 64 zones and as
many cells. Of a beam of one cell before one pixel, a look at a single point would tell little."""
FEW = 32
"""Most histograms of a pilot: an eighth of a scan of 256; replicates of 32 tell an error to about a tenth."""
FEWEST = 6
"""Fewest histograms of a pilot; if there are less, each is run several times: the few elements of 1 to 5 histograms
met only shadow with 2 and 6 of 10 seeds of two scenes."""
COARSER = 30.0
"""δ of the first pilot, in units of that with which all elements together would err by their light: the first
pilot of a room then has 1 to 3 times the elements of its last."""
PILOTS = 6
"""Most pilots; 19 rooms of ready configurations took 1 to 4."""
STEP = 6.0
"""Most that δ falls from one pilot to the next, so that what few coarse elements met does not decide alone."""
CLOSE = 1.5
"""How many times finer than that of a pilot δ must be for another pilot: nearer, `FALLS` foretells the error."""
LEAST_CHANCE = 0.02
"""Least chance of an element of a flood to get a sample, which bounds by how much a single one may stand out."""
FALLS = 0.55
"""Power of δ with which errors fall, as measured in rooms of the ready configurations."""
STRAIGHT = 0.25
"""Bend of the times over parts of elements, relative to their span, in units of the relative error asked: a screen of
needles errs by five times its bend."""
SHAPES = 0.15
"""What shapes of light in time may err by, alike in both replicates, relative to the error asked: 0.1 in the median
of rooms, measured with elements of a hundredth of the light."""
SCATTER = 0.55
"""Squared error, over that by which two replicates differ, of what averages out over runs, measured on the foreign
scenes of `tests/benchmarks/acceptance.py`. An error that is claimed is in proportion to its root."""
SHARED = 0.4
"""The same of what all runs have in common, pieces that none of them cuts, measured on the same scenes."""
DEGREES = 6.0
"""Independent histograms, counted by their light, over all runs, from which a claim is the root mean square that
replicates tell; of fewer it is raised, as one in twenty would be exceeded by more."""
DEVIATE = 1.645
"""Normal deviate that is exceeded in 5 % of cases."""
ENOUGH = 0.45
"""Precision that is missing, relative to what is there, up to which a run is not repeated: the error is then up to
1.2 of what is asked, which counts as met."""
COARSEN = 4.0
"""Most that δ rises from the pilot to a run, as the error of small objects may rise steeply."""
LEAST_LIGHT = 1e-100
"""Light that is divided by at least."""
RUNS = 3
"""Most times that all pairs are run with another δ: with 2, light through a slit missed its target."""
NEAR = 0.1
"""Share of elements whose FoV points are far apart for their distance, as guessed, from which on cuts do not know the
light: 0.2 for a plate 1 mm from a laser point, 0.06 at most in rooms with rough walls."""
PARTS = 0.25
"""Fewest elements of a replicate, over `MOST`, up to which the cells of a beam are divided, as what few laser points
leave of an error does not fall with δ: with an eighth, 2 × 2 parts of each cell claimed 6 % of a plate before a
TMF8828 where 5 % were asked; with a half, a reflecting plate had too many elements to be known."""
MOST = 1 << 15
"""Most elements of a histogram in any run, beside those of what is near, taken together for all; for targets down to
`FINE`, and in proportion to 1/target² below, as paths need: two replicates of so many take 131 000 rays, as many as
plain paths to 2 % in rooms of `quickstart`. Beyond, only what is near is cut. If a pilot comes so far, cuts do not
know the light: what lobes might bring, or what is hidden, is taken for far more than all light that there is."""
AT_LEAST = 16
"""Histograms that `MOST` is taken for at least: one alone may need more than the mean of all."""
FINE = 0.02
"""Target down to which `MOST` holds as it is."""
FAINT = 1e-4
"""Light of an object, relative to all, below which it gets no effort of its own."""
SAMPLES = 1 << 12
"""Samples that wait for their rays at once, 3 MiB: of 16 times as many a room took a tenth more time."""
VALUES_IN_CACHE = 1 << 18
"""Values of a replicate that are taken up at once: 2 MiB, which stay in the processor's cache until they are."""


@dataclass(frozen=True)
class PrimaryLight:
    """The primary.

    light : (K, H, T) photons by part, or in one row. total : (H, T) of all. outside : (H,) photons outside the
    window. variance : (H, T) squared standard errors. error : L2 error of the whole, photons. part_errors : object →
    relative L2 error of its own light. rays : shadow rays.
    """

    light: Floats
    total: Floats
    outside: Floats
    variance: Floats
    error: float
    part_errors: dict[str, float]
    rays: float


class Run(NamedTuple):
    """Light of n histograms.

    light : (K, n, T) photons by part, mean of both replicates, and of what was known. outside : (K, n) photons
    outside the window, mean of both. square : (G, n) squared L2 norms of half their difference, by group of parts;
    whole : (n,) of all parts. samples : number of samples. guessed : photons within the window, if nothing stood
    between.
    """

    light: Floats
    outside: Floats
    square: Floats
    whole: Floats
    samples: int
    guessed: float


class Mean(NamedTuple):
    """A mean over runs, photons: light (K, n, T), total (n, T) of all parts, and the share (G,), by group, that the
    next run has in it."""

    light: Floats
    total: Floats
    share: Floats


class Beside(NamedTuple):
    """L2 norms of the light that is known beside the primary, photons: of the whole, and of each part (K,)."""

    whole: float
    parts: Floats


class Cuts:
    """A problem, prepared for runs.

    groups : (K,) the group that the light of each part is judged with: each object by itself, the structure last.
    most : elements of a histogram, with those of what is near. error : (G,) L2 error that is asked of each group in
    a histogram, photons, which decides how exact the shapes of light in time are. expected : (3,) of `emit`, of all
    runs so far. is_limited : whether one had `most` in the mean. sides : parts along a side of each cell of a
    beam, else 1. pairs : of laser points, of a beam in all parts of its cells, and pixels.
    """

    def __init__(self, problem: Problem, target: float, beside: Beside | None = None) -> None:
        self.problem, scene, axis = problem, problem.scene, problem.capture.time
        self.beside = Beside(0.0, np.zeros(len(scene.part_names))) if beside is None else beside
        tree, materials = Hierarchy.of(scene), problem.materials
        self.divide(LOOK_PAIRS / len(problem.pairs.ends))
        width = np.array([lobe_width(material) for material in scene.materials])
        peak = materials.values[:, 0] / math.pi * (1.0 + (materials.kind != LAMBERTIAN) / width**2)
        bin_m = float(path_from_time(axis.width_s))
        self.setup = CutSetup(
            problem.numbers, tree, peak, width, outer_sides(scene), problem.points, self._powers(problem.points),
            1.0 / bin_m, axis.start_s / axis.width_s, float(axis.bins), ON_PLANE * tree.extent,
            SMALLEST * tree.extent, problem.capture.sensor.footprints is not None,
        )  # fmt: skip
        self.squares = squares_of(problem, width, bin_m, np.random.default_rng(self.seed(0)))
        self.of_objects = np.array([role == "object" for role in scene.roles])
        self.groups = np.where(self.of_objects, np.cumsum(self.of_objects) - 1, self.of_objects.sum())
        self.most, self.expected = int(MOST * max(1.0, FINE / target) ** 2), np.zeros(3)
        self.straight = STRAIGHT * target
        self.is_limited, self.error = False, np.full(self.groups.max() + 1, np.inf)
        self.memory = np.zeros(0)
        self.widest, self.work = 0.0, Work.of(axis.bins, 0.0)
        self.batch, self.every = Batch.of(SAMPLES), np.arange(SAMPLES)
        self.origin, self.span = np.empty((SAMPLES, 3), np.float32), np.empty((SAMPLES, 3), np.float32)

    @property
    def knows_little(self) -> bool:
        """Whether a few of very many elements have the light."""
        return self.is_limited or bool(self.expected[1] > NEAR * self.expected[0])

    @property
    def points(self) -> int:
        """Number of laser points of a histogram."""
        return len(self.pairs.ends) // self.pairs.histograms

    def divide(self, parts: float) -> None:
        """Divide the cells of a beam into up to so many equal parts, with a laser point each; a power of 4."""
        is_beam = self.problem.capture.laser.cells is not None
        self.sides = int(2 ** max(math.log2(parts) // 2, 0)) if is_beam else 1
        self.pairs = self.problem.pairs.in_parts(self.sides**2)

    def _powers(self, points: LaserPoints) -> Floats:
        """Shares of the emitted light that arrive at laser points."""
        leg = np.nan_to_num(points.leg)
        return np.asarray(self.pairs.share[: len(leg)] * np.exp(-self.problem.scene.attenuation_per_m * leg))

    def setup_of(self, number: int, replicate: int) -> CutSetup:
        """The setup of a replicate of a run, by number: a beam that states its cells has laser points of its own in
        each."""
        problem = self.problem
        if problem.capture.laser.cells is None:
            return self.setup
        rng = np.random.default_rng(self.seed(4, number, replicate))
        points = LaserPoints.in_cells(problem.caster, problem.scene, problem.capture.laser, self.sides, rng)
        return self.setup._replace(lasers=points, power=self._powers(points))

    def least(self, whole: float) -> float:
        """L2 norm of the light of the faintest object that has an error of its own, photons, if that of all light is
        `whole`."""
        return max(FAINT * whole, self.problem.accuracy.faint_part)

    def worth(self, norms: Floats, whole: float) -> Bools:
        """(K,) whether a part is an object with an error of its own, from the L2 norms of the light of each part (K,)
        and of the whole, photons."""
        return np.asarray(self.of_objects & (norms > self.least(whole)))

    def norm(self, light: Floats, more: float) -> float:
        """L2 norm of the whole light, at least, of which the primary in 1/`more` of the histograms is `light`."""
        return math.hypot(math.sqrt(more) * l2_norm(light), self.beside.whole)

    def norms(self, light: Floats, more: float) -> Floats:
        """(K,) L2 norms of the light of the parts, of which the primary in 1/`more` of the histograms is `light`
        (K, n, T)."""
        return np.asarray(np.hypot(math.sqrt(more) * np.array([l2_norm(of) for of in light]), self.beside.parts))

    def seed(self, *numbers: int) -> int:
        """A seed of random numbers of its own."""
        return int(stream_seeds(self.problem.seed, LightStream.CUTS, *numbers)[0])

    def run(
        self, which: Ints, delta: Floats, number: int, points: Ints | None = None, known: Mean | None = None
    ) -> Run:  # fmt: skip
        """The light of some histograms, of elements that bring at most `delta` (G,) photons; NaN leaves a group out.

        number : of the run; each draws its own random numbers. points : numbers of a flood's laser points that
        are lit; all where none are given. known : light that the run's own is averaged with, in place.
        """
        K, T = len(self.problem.scene.part_names), self.problem.capture.time.bins
        n = len(which)
        mean = Mean(np.zeros((K, n, T)), np.zeros((n, T)), np.ones(len(delta))) if known is None else known
        outside, samples = np.zeros((K, n)), 0
        square, whole = np.zeros((self.groups.max() + 1, n)), np.zeros(n)
        active, before = np.flatnonzero(~np.isnan(delta[self.groups])), self.expected[2]
        slot = np.full(K, -1)
        slot[active] = np.arange(len(active))
        # The elements of one laser point are no more than those that a histogram needs.
        least = max(LEAST_CHANCE, 1.0 / self.points) if points is None else 1.0
        asked = Asked(delta[self.groups], slot, self.error[self.groups], self.straight, least)
        pixel_of = self.pairs.ends[which, 1]
        squares, setups = self.squares[pixel_of], [self.setup_of(number, r) for r in range(2)]
        for count in np.unique(squares):
            every = np.flatnonzero(squares == count)
            pieces = 1 + len(every) * max(int(count) * 32, 2 * len(active) * T) // VALUES_AT_ONCE
            for some in np.array_split(every, pieces):
                pixels, of = np.unique(pixel_of[some], return_inverse=True)
                rng = np.random.default_rng(self.seed(1, number, int(count), int(some[0])))
                pool = FovClusters.of(self.problem, pixels, int(count), rng)
                own, rows = self.pairs.of_histograms(which[some]), np.arange(len(some))
                own = own if points is None else own[:, points]
                lasers, each = self.pairs.ends[own.ravel(), 0], own.shape[1]
                pairs = np.column_stack([lasers, np.repeat(of, each), np.repeat(rows, each)])
                both, over = self._zeros(2, len(active), len(some), T), np.zeros((2, len(active), len(some)))
                for r in range(2):
                    seed = self.seed(2, number, int(some[0]), r)
                    samples += self._add(setups[r], pairs, asked, r, seed, pool, both[r], over[r])
                outside[np.ix_(active, some)] = over.mean(axis=0)
                # Histograms that fit into the processor's cache are averaged, compared and set to zero in one go.
                step = max(VALUES_IN_CACHE // (len(active) * T), 1)
                for at in range(0, len(some), step):
                    few = slice(at, at + step)
                    self._take_up(both[:, :, few], active, some[few], mean, square, whole)
        return Run(mean.light, outside, square, whole, samples, 0.5 * float(self.expected[2] - before))

    def _zeros(self, *shape: int) -> Floats:
        """Zeros of some shape, in memory that is zero again after use."""
        count = math.prod(shape)
        if len(self.memory) < count:
            self.memory = np.zeros(count)
        return self.memory[:count].reshape(shape)

    def _take_up(
        self, both: Floats, active: Ints, rows: Ints, mean: Mean, square: Floats, whole: Floats
    ) -> None:  # fmt: skip
        """Takes two replicates (2, A, m, T) of the light of the `active` parts (A,) in some `rows` (m,) into `mean`,
        `square` and `whole` of `run`, and sets them to zero."""
        (one, two), place, total = both, dict(zip(active, range(len(active)), strict=True)), np.zeros(both.shape[2:])
        for k, group in enumerate(self.groups):
            if k in place:
                new, share = one[place[k]] + two[place[k]], mean.share[group]
                new *= 0.5 * share
                if share < 1.0:
                    new += (1.0 - share) * mean.light[k, rows]
                mean.light[k, rows] = new
            else:
                new = mean.light[k, rows]
            total += new
        mean.total[rows] = total
        one -= two
        total[:] = 0.0
        for group in np.unique(self.groups[active]):
            apart, *others = (one[a] for a in np.flatnonzero(self.groups[active] == group))
            for other in others:
                apart += other
            square[group, rows] = 0.25 * np.einsum("mt,mt->m", apart, apart)
            total += apart
        whole[rows] = 0.25 * np.einsum("mt,mt->m", total, total)
        both[:] = 0.0

    def _add(
        self, setup: CutSetup, pairs: Ints, asked: Asked, replicate: int, seed: int, pool: FovClusters, light: Floats,
        outside: Floats,
    ) -> int:  # fmt: skip
        """Adds a replicate of the light of some pairs to light (A, n, T) and outside (A, n) of the A parts that are
        asked for; returns the number of samples."""
        rows, samples, walk = light.shape[1], 0, Walk.of(np.random.default_rng(seed).random())
        most = self.most * max(rows, AT_LEAST)
        while walk.at[0] < len(pairs):
            used = emit(
                pairs, rows, asked, most, replicate, seed, setup, pool, walk, self.expected, self.batch
            )  # fmt: skip
            visible = self.every[:used]
            samples += used
            for leg in range(2):
                origin, span = self.origin[: len(visible)], self.span[: len(visible)]
                legs_of(self.batch, visible, leg, origin, span)
                visible = visible[~self.problem.caster.occluded_scaled(origin, span)]
            self.pour(visible, light.reshape(-1, light.shape[2]), outside.reshape(-1))
        self.is_limited |= bool(walk.at[3] >= most)
        return samples

    def pour(self, samples: Ints, light: Floats, outside: Floats) -> None:
        """Adds some samples of the batch, by number, to the rows of light (…, T) and outside (…)."""
        if (wide := widest(self.batch, samples)) > self.widest:
            self.widest, self.work = wide, Work.of(light.shape[1], wide)
        pour_all(self.batch, samples, light, outside, self.work)


def outer_sides(scene: Scene) -> Floats:
    """(K,) 1 for parts whose surface is closed with its normals outward, −1 inward, 0 for all others: whether each
    edge is that of two triangles that run along it in opposite directions, and the sign of the volume."""
    sides = np.zeros(len(scene.part_names))
    for k in range(len(sides)):
        triangles = scene.triangles[scene.face_part == k].astype(np.int64)
        start, end = triangles.ravel(), np.roll(triangles, -1, axis=1).ravel()
        there, back = (np.sort(a * len(scene.vertices) + b) for a, b in ((start, end), (end, start)))
        if np.array_equal(there, back) and (np.diff(there) > 0).all():
            a, b, c = (scene.vertices[triangles[:, j]] for j in range(3))
            sides[k] = np.sign(np.einsum("nk,nk->n", a - a[:1], np.cross(b - a[:1], c - a[:1])).sum())
    return sides


class _Found:
    """The runs of all pairs so far. The error of a run of group g is taken for a_g δ^FALLS: runs count with
    δ^(−2 FALLS), and the sum of these weights is the precision W_g, with which the squared error is a_g²/W_g.

    light : (K, H, T), outside : (K, H), weighted means of those of `Run`. total : (H, T) light of all parts. square :
    (G, H) weighted sums of squares, and alike : (G, H) of their roots. precision : (G,). spread : (G,) sum of squared
    differences, and expected : (G,) of δ^(2 FALLS), whose ratio is a².
    """

    def __init__(self, cuts: Cuts, bins: int) -> None:
        K, G, H = len(cuts.groups), cuts.groups.max() + 1, cuts.pairs.histograms
        self.cuts, self.light, self.outside = cuts, np.zeros((K, H, bins)), np.zeros((K, H))
        self.total = np.zeros((H, bins))
        self.square, self.alike = np.zeros((2, G, H))
        self.precision, self.spread, self.expected = np.zeros((3, G))
        self.common, self.runs, self.samples = 1.0, 0, 0

    def add(self, delta: Floats) -> None:
        """Add a run of all pairs, with `delta` (G,); NaN for groups that are left out."""
        weight = np.nan_to_num(delta ** (-2 * FALLS))
        share = weight / np.maximum(self.precision + weight, LEAST_LIGHT)
        every = np.arange(self.cuts.pairs.histograms)
        run = self.cuts.run(every, delta, 2 + self.runs, known=Mean(self.light, self.total, share))
        self.outside += share[self.cuts.groups][:, None] * (run.outside - self.outside)
        self.square += weight[:, None] ** 2 * run.square
        self.alike += weight[:, None] * np.sqrt(run.square)
        self.precision += weight
        self.spread += run.square.sum(axis=1)
        self.expected += np.nan_to_num(delta ** (2 * FALLS))
        # Groups share FoV points, so that their errors need not be independent.
        self.common = float(run.whole.sum() / max(run.square.sum(), 1e-300)) if run.whole.any() else self.common
        self.runs, self.samples = self.runs + 1, self.samples + run.samples

    @property
    def total_weight(self) -> Floats:
        """(G,) precision, above 0 for groups that were never run, too."""
        return np.asarray(np.maximum(self.precision, LEAST_LIGHT))

    def degrees(self, squares: Floats) -> float:
        """Independent differences that tell the error of light whose histograms differ by squares (H,) between
        replicates."""
        return self.runs * float(squares.sum()) ** 2 / max(float(np.square(squares).sum()), LEAST_LIGHT**2)

    def _claim(self, squares: Floats) -> float:
        """The L2 error that is claimed of light whose histograms differ by squares (H,) between replicates."""
        return claimed_times(self.degrees(squares)) * math.sqrt(float(squares.sum()))

    def result(self) -> PrimaryLight:
        """The light, and what is claimed of it."""
        cuts, light, total = self.cuts, self.light, self.total
        weight = self.total_weight[:, None]
        each = SCATTER * self.square / weight**2 + SHARED * np.square(self.alike / weight)
        of_pairs = self.common * each.sum(axis=0)
        # Within a histogram, where elements are of like light, variances go with the light.
        energy = total.sum(axis=1)
        share = np.divide(of_pairs, energy, out=np.zeros_like(energy), where=energy > 0)
        norms, names = cuts.norms(light, 1.0), cuts.problem.scene.part_names
        shapes = SHAPES * math.sqrt(cuts.pairs.histograms) * cuts.error
        errors = {
            names[k]: math.hypot(self._claim(each[cuts.groups[k]]), shapes[cuts.groups[k]]) / float(norms[k])
            for k in np.flatnonzero(cuts.worth(norms, cuts.norm(total, 1.0)))
        }
        outside = self.outside.sum(axis=0)
        rows = light if cuts.problem.split_parts else total[None]
        return PrimaryLight(
            rows, total, outside, share[:, None] * total, math.hypot(self._claim(of_pairs), shapes.max()), errors,
            2.0 * self.samples,
        )  # fmt: skip


def claimed_times(degrees: float) -> float:
    """How many times the root of a mean square with few degrees of freedom is claimed; 1 from `DEGREES` on.

    Half the logarithm of the ratio of two such mean squares, by which replicates differ and by which the light errs,
    is about normal with the variance 1/ν (Fisher's z): raised by exp(1.645 (ν^(−½) − 6^(−½))) a claim is exceeded as
    far, in 5 % of cases, as one with 6.
    """
    return math.exp(DEVIATE * max(max(degrees, 1.0) ** -0.5 - DEGREES**-0.5, 0.0))


class _Known(NamedTuple):
    """What a run has told: light (K, n, T), photons, of 1/`more` of all histograms, its total (n, T), and squared
    errors (G,) of the groups for δ = 1."""

    light: Floats
    total: Floats
    squares: Floats
    more: float


def primary_by_cuts(problem: Problem, target: float, beside: Beside | None = None) -> PrimaryLight | None:
    """The primary with about the relative L2 error `target` of the whole, and that asked of each object; None if much
    of it goes between surfaces that are nearer than FoV points are to one another, of which a few have it all, or if
    it is much less than guesses say.

    A look tells how bright the scene is, and ends the search where no light falls into the window; a pilot of some
    histograms tells how large errors are; all are then run, and up to twice more if that falls short. beside : light
    that is known, which counts in what is asked.
    """
    cuts = Cuts(problem, target, beside)
    seen = _first_look(cuts)
    if not seen.light.any():
        return _dark(cuts, seen)
    per_part, H = seen.least / cuts.sides**2, cuts.pairs.histograms
    cuts.divide(PARTS * cuts.most * max(1.0, AT_LEAST / H) / per_part)
    cuts.most += math.ceil(per_part * cuts.sides**2)
    known, delta, finest = _pilot(cuts, seen, target)
    if cuts.knows_little:
        return None
    # Light of few histograms has few differences that tell its error, so that it is run more often; unless there is
    # less of it than the error that is asked.
    each = np.square(known.total).sum(axis=1)
    histograms = max(known.more * each.sum() ** 2 / max(np.square(each).sum(), LEAST_LIGHT), 1.0)
    times = 1 if _is_faint(cuts, known, target) else math.ceil(DEGREES / min(histograms, DEGREES))
    cuts.error = _errors_asked(cuts, cuts.norms(known.light, known.more), cuts.norm(known.total, known.more), target)
    found, degrees = _Found(cuts, problem.capture.time.bins), histograms * times
    for turn in range(RUNS):
        if turn:
            degrees = found.degrees(found.square.sum(axis=0))
            known = _Known(found.light, found.total, found.spread / np.maximum(found.expected, LEAST_LIGHT), 1.0)
        # The precision of each of so many runs.
        there = found.precision / times
        claimed = (SCATTER / times + SHARED) * claimed_times(degrees) ** 2
        wanted = _precision(cuts, known, claimed, target) - there
        again = (wanted > ENOUGH * there) | (turn == 0)
        if not again.any():
            break
        # Elements are as fine as those of a single run, because what all runs share does not average out; and hardly
        # coarser than what is known, as the error of small objects may rise steeply.
        delta = np.where(again, np.clip(_finer(wanted), finest, delta if turn else COARSEN * delta), delta)
        asked = np.where(again, delta, np.nan)
        for _ in range(times):
            found.add(asked)
    return found.result()


def _is_faint(cuts: Cuts, known: _Known, target: float) -> bool:
    """Whether the light, and that of each object, is less than the error that is asked of all light."""
    total, more, part_target = known.total, math.sqrt(known.more), cuts.problem.accuracy.each_part
    norms, whole = cuts.norms(known.light, known.more), cuts.norm(total, known.more)
    faint = more * np.array([l2_norm(of) for of in known.light]) <= part_target * norms
    return bool(more * l2_norm(total) <= target * whole and faint[cuts.worth(norms, whole)].all())


class _Seen(NamedTuple):
    """What a look has told: light (K, n, T), outside (K, n), square (G, n) and whole (n,) as in `Run`, of the
    histograms `which` (n,); `guessed` photons of all histograms within the window; the number of samples; and how
    many a replicate of a histogram takes, at least."""

    which: Ints
    light: Floats
    outside: Floats
    square: Floats
    whole: Floats
    guessed: float
    samples: int
    least: float


def _first_look(cuts: Cuts) -> _Seen:
    """What is seen at a look at some histograms, of few elements each; at all, if no light falls into the window."""
    H = cuts.pairs.histograms
    some = spread_evenly(cuts, H, FEW)
    some = some[:: max(len(some) // LOOKED_AT, 1)]
    seen = _look(cuts, some, -(-LOOKED_AT // len(some)), LOOK, 0)
    return seen if seen.light.any() else _look(cuts, np.arange(H), 1, max(SECOND_LOOK // H, LOOK), 90)


def spread_evenly(cuts: Cuts, count: int, most: int, *numbers: int) -> Ints:
    """Up to `most` of `count` things, drawn evenly."""
    if count <= most:
        return np.arange(count)
    place = (np.arange(most) + np.random.default_rng(cuts.seed(3, *numbers)).random(most)) * count / most
    return place.astype(np.int64)


def _look(cuts: Cuts, which: Ints, times: int, most: int, number: int) -> _Seen:
    """What some runs tell of a few elements of some histograms, with up to so many of their laser points."""
    coarse, runs = np.full(cuts.groups.max() + 1, np.inf), list[Run]()
    for turn in range(number, number + times):
        points = spread_evenly(cuts, cuts.points, most, turn)
        runs.append(cuts.run(which, coarse, turn, points))
    # Those that are lit stand for all; and means of runs, which are independent.
    more, n = cuts.points / min(most, cuts.points), len(runs)
    light, outside = (more * sum(getattr(run, name) for run in runs) / n for name in ("light", "outside"))
    square, whole = (more**2 * sum(getattr(run, name) for run in runs) / n**2 for name in ("square", "whole"))
    guessed = more * sum(run.guessed for run in runs) / n * cuts.pairs.histograms / len(which)
    samples = sum(run.samples for run in runs)
    return _Seen(which, light, outside, square, whole, guessed, samples, more * samples / (2 * n * len(which)))


def _dark(cuts: Cuts, seen: _Seen) -> PrimaryLight:
    """No light, where a look at all histograms met none: it errs by no more than what it would be if nothing stood
    between."""
    problem, T = cuts.problem, cuts.problem.capture.time.bins
    rows = np.zeros((len(seen.light) if problem.split_parts else 1, cuts.pairs.histograms, T))
    return PrimaryLight(
        rows, rows.sum(axis=0), seen.outside.sum(axis=0), np.zeros(rows.shape[1:]), seen.guessed, {},
        2.0 * seen.samples,
    )  # fmt: skip


def _pilot(cuts: Cuts, seen: _Seen, target: float) -> tuple[_Known, Floats, Floats]:
    """What runs of a few histograms tell; δ (G,) of the last of them, which is not much coarser than what follows, as
    of much finer elements it would tell nothing; and the finest δ (G,) with which a run stays within its elements."""
    H, bins = cuts.pairs.histograms, cuts.problem.capture.time.bins
    few = np.tile(spread_evenly(cuts, H, FEW), -(-FEWEST // H))
    more = H / len(few)
    cuts.error = _errors_from_look(cuts, seen, target)
    delta = COARSER * cuts.error
    light, again = np.zeros((len(cuts.groups), len(few), bins)), delta > 0.0
    known, samples = _Known(light, light.sum(axis=0), np.zeros(len(delta)), more), 0
    for turn in range(PILOTS):
        run = cuts.run(few, np.where(again, delta, np.nan), 100 + turn)
        samples += run.samples
        light[again[cuts.groups]] = run.light[again[cuts.groups]]
        known = known._replace(total=light.sum(axis=0))
        known.squares[again] = more * run.square.sum(axis=1)[again] * delta[again] ** (-2 * FALLS)
        wanted = _precision(cuts, known, SCATTER + SHARED, target)
        finer = _finer(wanted)
        again = CLOSE * finer < delta
        if turn == PILOTS - 1 or not again.any() or cuts.knows_little:
            break
        delta = np.where(again, np.maximum(finer, delta / STEP), delta)
    # Elements grow no faster than 1/δ; all pilots count, as groups were left out of some.
    share = samples / (2 * len(few) * cuts.most * max(1.0, AT_LEAST / H))
    return known, delta, delta * min(share, 1.0)


def _errors_from_look(cuts: Cuts, seen: _Seen, target: float) -> Floats:
    """(G,) L2 error that is asked of each group in a histogram, photons, from a look at a few."""
    root = math.sqrt(cuts.pairs.histograms / len(seen.which))
    # Of all histograms.
    primary = root * _without_noise(seen.light.sum(axis=0), seen.whole)
    squares = seen.square[cuts.groups]
    own = np.array([root * _without_noise(of, square) for of, square in zip(seen.light, squares, strict=True)])
    return _errors_asked(cuts, np.hypot(own, cuts.beside.parts), math.hypot(primary, cuts.beside.whole), target)


def _errors_asked(cuts: Cuts, norms: Floats, whole: float, target: float) -> Floats:
    """(G,) L2 error that is asked of each group in a histogram, photons, from the L2 norms of the light of each part
    (K,) and of the whole."""
    whole = max(whole, LEAST_LIGHT)
    asked = np.full(cuts.groups.max() + 1, target * whole)
    for k in np.flatnonzero(cuts.of_objects):
        # Few elements may miss an object: what is not seen may have as much light as counts.
        own = max(norms[k], cuts.least(whole))
        asked[cuts.groups[k]] = min(target * whole, cuts.problem.accuracy.each_part * own)
    return asked / math.sqrt(cuts.pairs.histograms)


def _without_noise(light: Floats, squares: Floats) -> float:
    """An estimate of the L2 norm that light (n, T) would have without its noise.

    squares : (n,) squared L2 norms of the noise of each histogram, about, which are taken off the square of that of
    the light; at least a tenth of it stays.
    """
    norm = l2_norm(light) ** 2
    return math.sqrt(max(norm - float(squares.sum()), 0.1 * norm))


def _finer(precision: Floats) -> Floats:
    """(G,) the δ with which one run has some precision (G,), by `FALLS`."""
    return np.asarray(np.maximum(precision, LEAST_LIGHT) ** (-0.5 / FALLS))


def _precision(cuts: Cuts, known: _Known, claimed: float, target: float) -> Floats:
    """(G,) precision with which the whole and each object meet their targets.

    claimed : squared errors that will be claimed, relative to those by which two replicates differ.
    """
    squares = claimed * known.squares
    norms, whole = cuts.norms(known.light, known.more), cuts.norm(known.total, known.more)
    own = np.zeros(len(squares))
    for k in np.flatnonzero(cuts.worth(norms, whole)):
        group, asked = cuts.groups[k], cuts.problem.accuracy.each_part * norms[k]
        own[group] = max(own[group], squares[group] / asked**2)
    # All others alike: an element is worth its rays where it errs by as much as any other.
    left, others = max((target * whole) ** 2, LEAST_LIGHT), np.full(len(own), True)
    while others.any():
        alike = squares[others].sum() / (left - (squares[~others] / own[~others]).sum())
        enough = others & (own >= alike)
        if not enough.any():
            return np.asarray(np.maximum(own, alike))
        others &= ~enough
    return own
