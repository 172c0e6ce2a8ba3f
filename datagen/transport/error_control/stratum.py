"""A stratum: components of the transient that are sampled together, with the rounds of samples that they have had."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from datagen.records.arrays import Bools, Floats
from datagen.transport.brdf import lobe_width
from datagen.transport.error_control.confidence import Scatter, disagreement, total_variance
from datagen.transport.error_control.cost import Work
from datagen.transport.error_control.surroundings import CONTACT, surroundings
from datagen.transport.factorised.secondary import factorising, secondary_transient
from datagen.transport.fields_of_view import PixelPatches
from datagen.transport.path_tracing.averages import Average, path_average
from datagen.transport.path_tracing.replicate_spread import Sketch
from datagen.transport.problem import Problem

CONVERGENCE = 1.25
"""α in variance ∝ n^−α, from which the size of a round follows: 1 for independent samples, up to 3 for smooth
integrands, which bins make rough. With half of it, rounds take up to twice the samples that they need; with twice,
rounds fall short."""
OBSERVED = 64
"""Observed points for each lookin in the factorised secondary if `Accuracy.observed` does not say how many. Half as
many halve its cost and nearly double its variance."""
FACTORISED_FROM = 1 << 17
"""`Accuracy.max_lookins` from which light beside the field of view is left to the factorised form: it draws
`OBSERVED` rays for each hidden vertex, too many for a smaller limit."""
FINE_PATCH = 4.0
"""Size of a pixel's patch, in bins or in hundredths of the scene, up to which one FoV point for each vertex is
enough: the light is the same all over the patch. Half of it draws more FoV points without need."""
SCARCE, NOTHING_AFTER = 32, 1 << 16
"""Vertices that could bring light up to which the scatter of a stratum says nothing of its error (half of it claims
too little error where paths with light are rare); and samples after which their light is taken to be all there is.
Half of the second misses light that is up to twice as frequent."""
PER_LOBE = 4.0
"""Fewest samples of a laser point, in units of 1/width² of the narrowest lobe: about one path in 1/width² has the
direction that the lobe sends on, and all light of a laser point may come by that path. With half of it, one laser
point in seven has not met that light when its error is claimed."""
USUAL_FOV_SAMPLES, USUAL_CONNECTIONS = 4, 16
"""FoV points that a vertex connects to in a pixel whose patch is larger, and most of them over all pixels. With half
as many, the same light takes more rays; with twice as many, vertices connect to points that add no information."""


@dataclass(frozen=True)
class Round:
    """Size and scatter of one round.

    Attributes
    ----------
    samples : samples of each laser point, over all replicates.
    each : samples of each laser point in each replicate.
    scatter : variance of the round's mean, with its degrees of freedom.
    """

    samples: float
    each: int
    scatter: Scatter


@dataclass
class Stratum:
    """Some components that are sampled together, with the sums over all their rounds so far.

    Rounds are averaged with their numbers of samples as weights, never with weights from their own scatter: that
    would favour rounds that happened to miss the bright rare paths.

    Attributes
    ----------
    problem : the problem with the components of this stratum alone, and its number of FoV points for each vertex.
    observed : second hidden vertices for each hidden vertex, where the factorised form finds the secondary; None for
        path tracing.
    carriers : (K,) whether the factorised form takes hidden vertices on a part.
    rows : sums over the rounds of samples × mean, one (L, P, T) array for each row of the tally.
    variance : (L, P, T) sum over the rounds of samples² × variance of the mean.
    overflow : (L, P) sum over the rounds of samples × overflow.
    work : all steps so far.
    excess : squared difference between the last round and those before it, relative to what their scatter explains,
        at least 1.
    """

    problem: Problem
    observed: int | None = None
    carriers: Bools | None = None
    rows: list[Floats] = field(init=False)
    variance: Floats = field(init=False)
    overflow: Floats = field(init=False)
    rounds: list[Round] = field(default_factory=list)
    work: Work = field(default_factory=lambda: Work(calls=0))
    excess: float = 1.0

    def __post_init__(self) -> None:
        shape = self.problem.capture.shape
        self.rows = [np.zeros(shape) for _ in range(self.problem.tally_rows.count)]
        self.variance, self.overflow = np.zeros(shape), np.zeros(shape[:2])

    @property
    def samples(self) -> float:
        """Samples of each laser point so far."""
        return sum(one.samples for one in self.rounds)

    @property
    def rays(self) -> float:
        """Rays of each laser point so far, of which `Accuracy.max_lookins` are allowed."""
        return self.rays_per_sample * self.samples

    @property
    def rays_per_sample(self) -> int:
        """Rays that one sample counts as where `Accuracy.max_lookins` limits them."""
        return self.observed or 1

    @property
    def searched(self) -> bool:
        """Whether no more samples are taken in search of light."""
        return self.samples * len(self.problem.points.part) >= NOTHING_AFTER

    @property
    def scarcely_met(self) -> bool:
        """Whether path tracing has met so few vertices that could bring light, or so few in the narrowest lobe, that
        their scatter says nothing of the error."""
        if self.observed is not None or self.problem.tally_rows.components == ("direct",):
            return False
        connections = self.problem.capture.shape[1] * int(self.problem.accuracy.fov_samples)
        narrowest = min(lobe_width(material) for material in self.problem.scene.materials)
        few = self.work.bright <= SCARCE * connections or self.samples < PER_LOBE / narrowest**2
        return few and not self.searched

    @property
    def cost_per_sample(self) -> float:
        """Cost of one sample of each laser point."""
        return self.work.marginal_cost / max(self.samples, 1.0)

    @property
    def cost_per_replicate(self) -> float:
        """Cost of one replicate, whatever its samples."""
        return self.work.fixed_cost / max(sum(one.scatter.replicates for one in self.rounds), 1)

    @property
    def variance_of_one(self) -> float:
        """Variance of one sample: that of the last round's mean times its samples."""
        last = self.rounds[-1]
        return last.scatter.variance * last.samples

    def scatters(self) -> list[Scatter]:
        """The contribution of each round to the variance of the mean over all rounds."""
        total = self.samples
        return [
            replace(one.scatter, variance=(one.samples / total) ** 2 * one.scatter.variance) for one in self.rounds
        ]

    def variance_after(self, each: int, replicates: int) -> float:
        """Variance predicted after one more round of `each` samples of each laser point in each of `replicates`."""
        last, more = self.rounds[-1].scatter, each * replicates
        of_round = last.variance * last.replicates / replicates * (self.rounds[-1].each / max(each, 1)) ** CONVERGENCE
        old = self.samples**2 * total_variance(self.scatters())
        return float(self.excess * (old + more**2 * of_round) / (self.samples + more) ** 2)

    def sample(self, each: int, replicates: int, seed: int) -> None:
        """Add one more round: `each` samples of each laser point in each of `replicates`."""
        sketch, samples, before = Sketch(replicates), each * replicates, self.scatters()
        got = self._average(samples, replicates, seed, sketch)
        variance = float((got.stderr**2).sum())
        scatter = Scatter(variance, sketch.freedom() if variance > 0 else 1.0, replicates)
        if self.rounds:
            change = sum((new - old / self.samples for new, old in zip(got.rows, self.rows, strict=True)), 0.0)
            self.excess = disagreement(float(np.sum(np.square(change))), scatter, before)
        for row, more in zip(self.rows, got.rows, strict=True):
            row += samples * more
        self.variance += (samples * got.stderr) ** 2
        self.overflow += samples * got.overflow
        self.work += got.work
        self.rounds.append(Round(float(samples), each, scatter))

    def _average(self, samples: int, replicates: int, seed: int, sketch: Sketch) -> Average:
        """The mean of one round, by path tracing or by the factorised form; `sketch` takes in its replicates."""
        counts = replace(self.problem.accuracy, target=None, part_target=None, lookins=samples, replicates=replicates)
        problem = replace(self.problem, accuracy=counts, seed=seed)
        if self.observed is None:
            return path_average(problem, sketch)
        return secondary_transient(problem, self.observed, self.carriers, sketch=sketch)


@dataclass(frozen=True)
class Known:
    """Light (L, P, T) that needs no samples because quadrature found it, and its L2 error."""

    light: Floats
    error: float


def square_norm(strata: list[Stratum], known: Known | None = None) -> float:
    """‖mean‖² of the sum of all strata and of the known light, added up laser point by laser point to save memory."""
    norm = 0.0
    for laser in range(strata[0].problem.capture.shape[0]):
        total = 0.0 if known is None else known.light[laser]
        total = total + sum(row[laser] / stratum.samples for stratum in strata for row in stratum.rows)
        norm += float(np.sum(total**2))
    return norm


def strata_of(problem: Problem) -> list[Stratum]:
    """The strata of a problem: the direct return, the factorised secondary, and all light that path tracing finds.

    The secondary is factorised where only the strongest paths are asked for, and where surfaces right beside the
    field of view bring much of it: path tracing seldom goes there, and the scatter of its samples says nothing of
    light that they have missed.
    """
    accuracy, asked = problem.accuracy, problem.tally_rows.components
    assert accuracy.target is not None
    factor = factorising(problem.materials)
    factorised = "secondary" in asked and bool(factor.any())
    if factorised and accuracy.strongest is None:
        few = accuracy.max_lookins < FACTORISED_FROM
        factorised = not few and surroundings(problem, problem.seed) > max(CONTACT, accuracy.target)
    walked = ~factor if factorised else np.ones(len(factor), np.bool_)
    problem = with_usual_fov_samples(problem)
    strata = []
    if "direct" in asked:
        strata.append(Stratum(of_components(problem, ("direct",), walked)))
    if factorised:
        strata.append(Stratum(of_components(problem, ("secondary",), walked), accuracy.observed or OBSERVED, factor))
    traced = tuple(name for name in asked if name != "direct" and (name != "secondary" or walked.any()))
    if traced:
        strata.append(Stratum(of_components(problem, traced, walked)))
    return strata


def of_components(problem: Problem, components: tuple[str, ...], walked: Bools) -> Problem:
    """The same problem for some of its components; `walked` (K,) as in `Problem`."""
    parts = problem.tally_rows.parts if "primary" in components else ()
    return replace(problem, tally_rows=replace(problem.tally_rows, components=components, parts=parts), walked=walked)


def with_usual_fov_samples(problem: Problem) -> Problem:
    """The same problem without a target and with its FoV points for each vertex and pixel chosen: one where patches
    are small, several for few pixels whose patches are large. The other counts are still to be chosen."""
    room, fov_samples = max(USUAL_CONNECTIONS // problem.capture.shape[1], 1), 1
    if problem.patch_detail(np.arange(len(problem.patches.radius))) >= FINE_PATCH:
        fov_samples = min(USUAL_FOV_SAMPLES, 1 << room.bit_length() - 1)
    accuracy = replace(problem.accuracy, target=None, part_target=None, fov_samples=fov_samples)
    patches = PixelPatches.of(problem.caster, problem.capture.sensor, problem.cones, fov_samples)
    return replace(problem, accuracy=accuracy, patches=patches)
