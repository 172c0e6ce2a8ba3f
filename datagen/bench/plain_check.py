"""The one measure of every way to light: its squared error against plain paths, with the paths' own noise taken out.

Paths are drawn in R independent runs h_1 … h_R of the same pairs of laser point and pixel. For light o, each product
(o − h_r)(o − h_s) with r ≠ s has the mean (o − truth)², so

    error² = [(Σ_r (o − h_r))² − Σ_r (o − h_r)²] / (R (R − 1)),    summed over all entries.

It may come out negative where the light is right within the noise. It shares nothing with the way under test, and
sees what that way's own replicates have in common.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from datagen.bench.measuring import percent
from datagen.records import Accuracy, Capture, Scene
from datagen.records.arrays import Floats, Ints
from datagen.transport.path_light import Rows
from datagen.transport.problem import Problem

RUNS = 8
"""Independent runs of paths, from which the noise of the check is known to a quarter."""


@dataclass(frozen=True)
class Checked:
    """A squared error by plain paths, relative to ‖truth‖². noise : its standard error."""

    square: float
    noise: float

    @property
    def error(self) -> float:
        """The relative L2 error; 0 where it is lost in noise."""
        return math.sqrt(max(self.square, 0.0))

    def __str__(self) -> str:
        least = math.sqrt(2 * self.noise)
        return percent(self.error) if self.error > least else f"< {percent(least)}"


@dataclass(frozen=True)
class PlainPaths:
    """Light of some pairs of laser point and pixel by plain paths.

    runs : component or part of the primary → (R, n, T) photons. pairs : (n,) indices of histograms.
    """

    runs: dict[str, Floats]
    pairs: Ints

    @classmethod
    def of(
        cls,
        scene: Scene,
        capture: Capture,
        accuracy: Accuracy,
        samples: int,
        seed: int = 0,
        pairs: Ints | None = None,
    ) -> PlainPaths:  # fmt: skip
        """The components of an accuracy, and the primary by part, with `samples` paths of each pair in each run."""
        problem = Problem.of(scene, capture, accuracy, seed, split_parts=True)
        rows = Rows.of_components(problem, problem.components)
        which = np.arange(problem.pairs.histograms) if pairs is None else pairs
        some = problem.pairs.of_histograms(which).T.ravel()
        found = np.stack([rows.light(problem, some, len(which), samples, (9, run))[..., 1:-1] for run in range(RUNS)])
        runs = {name: found[:, of].sum(axis=1) for name, of in rows.names.items()}
        return cls(runs | {name: found[:, k] for k, name in enumerate(problem.parts)}, which)

    def check(self, light: Floats, *names: str) -> Checked:
        """The error of light (…, T) of all histograms, which should be the sum of some components or parts."""
        truth = np.sum([self.runs[name] for name in names], axis=0)
        apart = light.reshape(-1, light.shape[-1])[self.pairs] - truth
        square = cross_products(apart)
        norm = float(np.mean(cross_products(truth)))
        # Leaving out one run after the other tells the noise (jackknife), up to half as much again as there is.
        noise = math.sqrt((RUNS - 1) * float(square.var())) if RUNS > 2 else math.nan
        return Checked(float(square.mean()) / norm, noise / norm) if norm > 0 else Checked(0.0, 0.0)


def cross_products(runs: Floats) -> Floats:
    """(R,) mean product of two different runs (R, …), summed over all entries, without each run in turn."""
    R, flat = len(runs), runs.reshape(len(runs), -1)
    products = flat @ flat.T
    own, every = np.diag(products), products.sum()
    without = every - 2 * products.sum(axis=1) + own
    return np.asarray((without - (own.sum() - own)) / ((R - 1) * (R - 2)))
