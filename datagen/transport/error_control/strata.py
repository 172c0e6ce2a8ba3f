"""Strata: components of the transient that get samples of their own, and the rounds in which they got them."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from datagen.records.arrays import Bools, Floats, Ints
from datagen.transport.error_control.confidence import Scatter, disagreement, effective_freedom, total_variance
from datagen.transport.error_control.cost import Work
from datagen.transport.factorised.secondary import secondary_transient
from datagen.transport.fields_of_view import PixelPatches
from datagen.transport.path_tracing.averages import Average, walk_average
from datagen.transport.path_tracing.replicate_spread import Sketch
from datagen.transport.problem import Problem, part_of

EXPONENTS = (0.9, 1.5)
"""Bounds of α in variance ∝ n^−α: 1 for independent samples, up to 3 for smooth integrands; bins make them rough."""

UNKNOWN_EXPONENT = 1.25
"""Taken before any is observed: a round that falls short is completed by the next, one too large is lost."""


@dataclass(frozen=True)
class Round:
    """What one round gave each laser point.

    Attributes
    ----------
    weight : (L,) lookins, over all replicates; 0 for a laser point it left out.
    variance : (L,) of the round's mean, summed over pixels and bins.
    freedom, replicates : as in `Scatter`.
    """

    weight: Floats
    variance: Floats
    freedom: float
    replicates: int


@dataclass
class Stratum:
    """Some components, found together, and all that is known of them so far.

    Rounds are averaged with their lookins as weights, never with weights from their own scatter: that would favour
    rounds that happened to miss the bright rare paths.

    Attributes
    ----------
    task : the whole capture, with the components of this stratum and its FoV points for each vertex.
    observed : observed points for each lookin, where the factorised form finds the secondary; None for the walk.
    carriers : (K,) parts whose lookins the factorised form takes.
    rows : sums over the rounds of weight × mean, one (L, P, T) array for each split.
    variance, overflow : likewise, with squared weights for the variance.
    weight : (L,) lookins.
    scale : (L,) variance of one replicate in the last round.
    points : (L,) its lookins there.
    work : all that was done.
    exponent : the observed α in variance ∝ n^−α.
    excess : by how much the last round disagreed with those before it, ≥ 1.
    """

    task: Problem
    observed: int | None = None
    carriers: Bools | None = None
    rows: list[Floats] = field(init=False)
    variance: Floats = field(init=False)
    overflow: Floats = field(init=False)
    weight: Floats = field(init=False)
    scale: Floats = field(init=False)
    points: Floats = field(init=False)
    rounds: list[Round] = field(default_factory=list)
    work: Work = field(default_factory=lambda: Work(calls=0))
    replicates: int = 0
    exponent: float = UNKNOWN_EXPONENT
    excess: float = 1.0

    def __post_init__(self) -> None:
        shape = self.task.capture.shape
        self.rows = [np.zeros(shape) for _ in range(self.task.splits.count)]
        self.variance, self.overflow = np.zeros(shape), np.zeros(shape[:2])
        self.weight, self.scale, self.points = np.zeros(shape[0]), np.zeros(shape[0]), np.ones(shape[0])

    @property
    def components(self) -> tuple[str, ...]:
        """Those that are found together."""
        return self.task.splits.components

    @property
    def by_laser(self) -> bool:
        """Whether laser points can be given samples one by one; the factorised form shares its lookins."""
        return self.observed is None

    @property
    def rays_per_lookin(self) -> int:
        """Rays that one lookin stands for where lookins are limited."""
        return self.observed or 1

    @property
    def growing(self) -> float:
        """Cost of one lookin of one laser point."""
        return self.work.growing / max(float(self.weight.sum()), 1.0)

    @property
    def standing(self) -> float:
        """Cost of one replicate, whatever its lookins."""
        return self.work.standing / max(self.replicates, 1)

    def mean(self, row: Floats) -> Floats:
        """A sum over rounds (L, …) as their weighted mean."""
        return row / np.maximum(self.weight, 1.0).reshape(-1, *(1,) * (row.ndim - 1))

    def scatters(self) -> list[Scatter]:
        """The rounds' parts in the error of the mean over them."""
        total = np.maximum(self.weight, 1.0)
        return [
            Scatter(float(((one.weight / total) ** 2 * one.variance).sum()), one.freedom, one.replicates)
            for one in self.rounds
        ]

    def sample(self, points: Ints, replicates: int, seeds: list[int]) -> None:
        """One more round: `points` (L,) lookins in each of `replicates`, 0 for none; `seeds` one for each number."""
        square, expected, freedoms, before = 0.0, 0.0, [], self.scatters()
        weight, variance = np.zeros(len(points)), np.zeros(len(points))
        for seed, count in zip(seeds, [n for n in np.unique(points) if n > 0], strict=False):
            lasers = np.flatnonzero(points == count)
            sketch = Sketch(replicates)
            part = self.task if len(lasers) == len(points) else part_of(self.task, lasers)
            got = self._average(part, int(count), replicates, seed, sketch)
            self.work += got.work
            own = (got.stderr**2).sum(axis=(1, 2))
            if self.rounds:
                change = sum(
                    (new - self.mean(old)[lasers] for new, old in zip(got.rows, self.rows, strict=True)), 0.0
                )
                square += float(np.sum(np.square(change)))
                expected += float((self.variance[lasers].sum(axis=(1, 2)) / self.weight[lasers] ** 2).sum())
            weight[lasers], variance[lasers] = count * replicates, own
            freedoms.append(Scatter(float(own.sum()), sketch.freedom(), replicates))
            self._add(lasers, count * replicates, got)
        self.replicates += replicates
        seen = weight > 0
        one = Round(weight, variance, effective_freedom(freedoms), replicates)
        if self.rounds:
            new = Scatter(float(variance.sum()), one.freedom, replicates)
            share = expected / total_variance(before) if total_variance(before) > 0 else 0.0
            self.excess = disagreement(square, new, [replace(b, variance=share * b.variance) for b in before])
            self._learn_exponent(points, variance * replicates)
        self.weight += weight
        self.scale[seen], self.points[seen] = variance[seen] * replicates, points[seen]
        self.rounds.append(one)

    def _average(self, task: Problem, count: int, replicates: int, seed: int, sketch: Sketch) -> Average:
        counts = replace(
            task.accuracy, target=None, part_target=None, lookins=count * replicates, replicates=replicates
        )
        task = replace(task, accuracy=counts, seed=seed)
        if self.observed is None:
            return walk_average(task, sketch)
        return secondary_transient(task, self.observed, self.carriers, sketch=sketch)

    def _add(self, lasers: Ints, weight: float, got: Average) -> None:
        for row, more in zip(self.rows, got.rows, strict=True):
            row[lasers] += weight * more
        self.variance[lasers] += (weight * got.stderr) ** 2
        self.overflow[lasers] += weight * got.overflow

    def _learn_exponent(self, points: Ints, scale: Floats) -> None:
        seen = (points > 0) & (self.scale > 0)
        was, now = float(self.scale[seen].sum()), float(scale[seen].sum())
        if not seen.any() or now <= 0:
            return
        growth = float(np.average(np.log(points[seen] / self.points[seen]), weights=self.scale[seen]))
        if growth > np.log(3):
            self.exponent = float(np.clip(np.log(was / now) / growth, *EXPONENTS))


def with_fov_samples(task: Problem, fov_samples: int) -> Problem:
    """The same task with another number of FoV points for each vertex and pixel."""
    accuracy = replace(task.accuracy, target=None, part_target=None, fov_samples=fov_samples)
    patches = PixelPatches.of(task.caster, task.capture.sensor, task.cones, fov_samples)
    return replace(task, accuracy=accuracy, patches=patches)


@dataclass(frozen=True)
class Known:
    """A part of the transient (L, P, T) that needs no samples, and its L2 error."""

    light: Floats
    error: float


def square_norm(strata: list[Stratum], known: Known | None = None) -> float:
    """‖mean‖² of the sum of all strata and of what is known, laser point by laser point to save memory."""
    norm = 0.0
    for laser in range(len(strata[0].weight)):
        total = 0.0 if known is None else known.light[laser]
        total = total + sum(
            row[laser] / max(stratum.weight[laser], 1.0) for stratum in strata for row in stratum.rows
        )
        norm += float(np.sum(total**2))
    return norm
