"""Light of frames that share nothing: that of scenes by themselves, as they stand at instants of a frame's exposure.

Of several instants it is the mean. Each has random numbers of its own, so that errors cancel in part and each may
have √S times the error asked; frames have the same.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from datagen.records import Accuracy, Capture, Scene, Transient
from datagen.records.arrays import Floats, l2_norm
from datagen.transport.blocks import BlocksOf
from datagen.transport.coincidence import set_apart
from datagen.transport.problem import Problem
from datagen.transport.simulate import MET, Samples, light_by_samples, transient_of


def transient_of_moments(scenes: Sequence[Scene], capture: Capture, accuracy: Accuracy, seed: int) -> Transient:
    """The mean light of a scene as it stands at some moments."""
    each, n = accuracy, len(scenes)
    if n > 1 and accuracy.target is not None:
        target, of_part = (min(math.sqrt(n) * of, 1.0) for of in (accuracy.target, accuracy.each_part))
        each = replace(accuracy, target=target, part_target=of_part)
    elif n > 1 and accuracy.samples is not None:
        each = replace(accuracy, samples=-(-accuracy.samples // n))
    found = list[Transient]()
    for scene, own_seed in zip(scenes, _seeds(seed), strict=False):
        apart = set_apart(scene, capture)
        found.append(transient_of(apart.scene, capture, each, own_seed, caster=apart.caster))
    return found[0] if n == 1 else _mean(found, accuracy)


def _seeds(seed: int) -> Iterator[int]:
    """Seeds of moments: that of the scene, and others that follow from it."""
    yield seed
    number = 0
    while True:
        number += 1
        yield int(np.random.SeedSequence(seed, spawn_key=(number,)).generate_state(1, np.uint64)[0])


def _mean(found: Sequence[Transient], accuracy: Accuracy) -> Transient:
    """The mean of transients whose errors are independent."""
    first, n = found[0], len(found)
    components = {name: _mean_of(of.components[name] for of in found) for name in first.components}
    parts = {name: _mean_of(of.parts[name] for of in found) for name in first.parts}
    # An object that claims nothing at some moment is faint.
    claims = [name for name in first.part_errors if all(name in of.part_errors for of in found)]
    errors = {
        name: _error_of_mean([of.part_errors[name] * l2_norm(of.parts[name]) for of in found], parts[name])
        for name in claims
    }
    claimed = met = None
    if accuracy.target is not None:
        whole = sum(components.values(), start=np.zeros(first.stderr.shape))
        claimed = _error_of_mean([of.relative_error * l2_norm(of.total) for of in found], whole)
        met = claimed <= MET * accuracy.target
        met &= all(of <= MET * accuracy.each_part for of in errors.values())
    return replace(
        first, components=components, parts=parts, claimed_error=claimed, met_target=met, part_errors=errors,
        stderr=np.sqrt(sum(of.stderr**2 for of in found)) / n, overflow=_mean_of(of.overflow for of in found),
        samplers={name: "/".join(sorted({of.samplers[name] for of in found})) for name in first.samplers},
        rays={name: float(sum(of.rays[name] for of in found)) for name in first.rays},
    )  # fmt: skip


def _mean_of(arrays: Iterable[Floats]) -> Floats:
    """The mean of arrays of one shape."""
    every = [*arrays]
    return np.asarray(sum(every[1:], start=every[0]) / len(every))


def _error_of_mean(errors: Sequence[float], light: Floats) -> float:
    """Relative L2 error of the mean `light` of what has independent L2 errors; NaN if any of them is."""
    norm = l2_norm(light)
    every = math.sqrt(sum(error**2 for error in errors)) / len(errors)
    if norm == 0:
        return 0.0 if every == 0 else math.nan
    return every / norm


class Others(NamedTuple):
    """Light of some components of a frame, photons.

    light, variance, apart : (C, H, T) of each component its light, squared standard error, and half of the difference
    of two replicates. outside : (L, P) outside the window. square : of its L2 error. cost : component → rays.
    """

    light: Floats
    variance: Floats
    apart: Floats
    outside: Floats
    square: float
    cost: dict[str, float]


class OtherComponents:
    """Components that come by samples, of one frame after another, with the effort of the first.

    names : of the components.
    """

    def __init__(self, capture: Capture, accuracy: Accuracy, seed: int, names: Sequence[str]) -> None:
        self.capture, self.accuracy, self.seed, self.names = capture, accuracy, seed, tuple(names)
        self.first: Samples | None = None

    def of(self, scenes: Sequence[Scene], known: Floats, error: float) -> Others:
        """Their mean light in a scene as it stands at some moments, beside `known` light (L, P, T), which has an L2
        error."""
        n, target = len(scenes), self.accuracy.target
        assert target is not None
        each, known = list[Others](), known.reshape(-1, known.shape[-1])
        for scene, own_seed in zip(scenes, _seeds(self.seed), strict=False):
            one = set_apart(scene, self.capture)
            problem = Problem.of(
                one.scene, self.capture, self.accuracy, own_seed, split_parts=False, caster=one.caster
            )
            samples = light_by_samples(
                problem, self.names, known, math.sqrt(n) * error, math.sqrt(n) * target, like=self.first
            )  # fmt: skip
            self.first, found = self.first or samples, samples.found
            light, variance, apart = (
                np.array([of[name] for name in self.names]) for of in (found.light, found.variance, found.apart)
            )
            square = sum(found.error[name] ** 2 for name in self.names)
            outside = found.overflow(self.capture.shape)
            each.append(Others(light, variance, apart, outside, square, dict(found.cost)))
        if n == 1:
            return each[0]
        return Others(
            _mean_of(of.light for of in each), _mean_of(of.variance for of in each) / n,
            _mean_of(of.apart for of in each), _mean_of(of.outside for of in each),
            sum(of.square for of in each) / n**2,
            {name: sum(of.cost[name] for of in each) for name in self.names},
        )  # fmt: skip

    @property
    def samplers(self) -> dict[str, str]:
        """Component → how its light came."""
        assert self.first is not None
        return {name: "blocks" if isinstance(of, BlocksOf) else "paths" for name, of in self.first.sources.items()}
