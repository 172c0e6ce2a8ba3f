"""A second opinion on computed light: a few unbiased samples of its energy, by part and time window.

Differences between two cuttings of one method show errors of discretisation and nothing of what both cuttings miss.
So some pairs of laser point and pixel are drawn at random, and paths of light (`paths.py`, which uses no
surface elements) measure how much more or less energy arrives than was computed, by part and in coarse windows of
time. With chance q to draw a pair, x its sampled energy and m its computed energy,

    D = ⟨(x − m)/q⟩     has the mean  Σ over all pairs of (truth − computed),

so D measures the missing energy of the whole scan, and its scatter over the pairs drawn gives its standard error σ.
The light is accepted unless |D| exceeds the claimed error by more than chance allows.

A first look takes few samples and calls for a second one easily (`LOOK_AGAIN`); the second, of `MORE` times as many
new samples, decides at `LEVEL`. Samples that meet a rare bright path scatter so much that they call for nothing.
Samples that missed such a path claim too little light: only many samples (`ENOUGH`) may dispute computed light as
too much.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from scipy.special import ndtri

from datagen.records.arrays import Bools, Floats, Ints
from datagen.seeding import LightStream
from datagen.transport.error_control.cost import SAMPLE
from datagen.transport.paths import sample_paths
from datagen.transport.problem import Problem
from datagen.transport.reference import pairs_of
from datagen.transport.sampling import stream_seeds
from datagen.units import time_from_path

PAIRS, SAMPLES, SHARE = (128, 1024), 16, 0.04
"""Fewest and most pairs drawn in a first look; samples of each pair; and, in between, the cost of a first look
relative to that of computing the light. Half the pairs would only see losses √2 times as large."""
MORE = 16
"""Pairs of a second look, relative to the fewest pairs of a first one (it has at least four times those of its own
first look). With half of it, more of the losses that a first look suspects stay unproven."""
WINDOWS = 4
"""Windows of time that are tested, each with an equal share of the computed light, beside all of it. With half as
many, light in the wrong place hides behind other light."""
LOOK_AGAIN = 1.75
"""Standard errors beyond the claimed error from which a first look calls for a second. Half of it does so for
many more scenes."""
LEVEL = 1e-4
"""Chance that a second look disputes light that is right, over all its parts and windows."""
ENOUGH = 64
"""Effective number of samples, (Σx)²/Σx², from which samples may dispute computed light as too much: in a window, and
in all windows together. With half of it a few missed bright paths dispute light that is right."""
EVENLY = 0.25
"""Weight of drawing pairs evenly, beside drawing them by their computed light. Half of it seldom looks where nothing
was computed."""


@dataclass(frozen=True)
class Claim:
    """Computed light, and the error that is claimed of it.

    light : (L, P, T) photons. error : most photons, summed over all histograms, by which the light may be wrong.
    order : bounces of the light's paths. part : index of the part that the light comes from last, −1 for all parts.
    """

    light: Floats
    error: float
    order: int
    part: int = -1


@dataclass(frozen=True)
class Opinion:
    """Result of comparing claims with samples.

    Attributes
    ----------
    agrees : whether all light is within its claimed error, as far as chance allows.
    worst : name of the claim that is farthest off; `off`, `known`, `sigmas` and `missing` are of its worst window.
    off : computed minus sampled energy, relative to all energy of the claim.
    known : standard error of `off`.
    sigmas : standard errors by which the difference exceeds the claimed error; negative if it does not.
    missing : sampled minus computed photons.
    samples : number of samples over all looks.
    """

    agrees: bool
    worst: str
    off: float
    known: float
    sigmas: float
    samples: int
    missing: float = 0.0

    def __str__(self) -> str:
        verdict = "agrees" if self.agrees else "disagrees"
        return f"{verdict}: of {self.samples} samples, farthest off {self.worst}, {self.off:+.1%} ± {self.known:.1%}"


def second_opinion(problem: Problem, claims: Mapping[str, Claim], cost: float = 0.0, turn: int = 0) -> Opinion:
    """Whether unbiased samples of the energy agree with computed light.

    claims : name → light and its claimed error. cost : cost of computing the light, in units of `cost.py`.
    turn : index of this opinion among those on a scene; each has random numbers of its own.
    """
    order = max(claim.order for claim in claims.values())
    count = int(np.clip(SHARE * cost / (SAMPLE * SAMPLES), *PAIRS))
    first = _look(problem, claims, count, order, 2 * turn)
    if first.sigmas <= LOOK_AGAIN:
        return first
    second = _look(problem, claims, max(MORE * PAIRS[0], 4 * count), order, 2 * turn + 1)
    tests = (WINDOWS + 1) * len(claims)
    agrees = second.sigmas <= -float(ndtri(LEVEL / (2 * tests)))
    return replace(second, agrees=agrees, samples=first.samples + second.samples)


def _look(problem: Problem, claims: Mapping[str, Claim], count: int, last_order: int, look: int) -> Opinion:
    """The comparison with samples of `count` pairs; whether that difference is too large is left to the caller, so
    `agrees` is true.

    last_order : most bounces of sampled paths. look : index of the look, which selects its random numbers.
    """
    time = problem.capture.time
    seed = int(stream_seeds(problem.seed, LightStream.SECOND_OPINION, 0, np.array([look]))[0])
    all_pairs = pairs_of(problem.capture)
    lit = np.flatnonzero(problem.points.part[all_pairs[:, 0]] >= 0)
    computed = {name: claim.light.reshape(-1, time.bins) for name, claim in claims.items()}
    which, chance = _drawn([light[lit].sum(axis=1) for light in computed.values()], count, seed)
    rows = lit[which]
    paths = sample_paths(
        problem.caster, problem.scene, problem.materials, problem.capture, all_pairs[rows], SAMPLES,
        max_bounces=last_order, seed=seed,
    )  # fmt: skip
    bins = np.floor((time_from_path(paths.path_m) - time.start_s) / time.width_s)
    inside = (bins >= 0) & (bins < time.bins)
    worst = Opinion(True, next(iter(claims)), 0.0, 0.0, -np.inf, count * SAMPLES)
    for name, claim in claims.items():
        edges = _windows(computed[name].sum(axis=0))
        of_claim = inside & (paths.order == claim.order) & ((claim.part < 0) | (paths.part == claim.part))
        cell = paths.pair[of_claim] * len(edges) + np.searchsorted(edges, bins[of_claim], side="right") - 1
        photons = np.bincount(cell, paths.photons[of_claim], count * len(edges))
        sampled: Floats = photons.reshape(count, -1) / chance[:, None]
        expected = np.add.reduceat(computed[name][rows], edges, axis=1) / chance[:, None]
        missing, sigma, enough = _compared(_with_sum(sampled), _with_sum(expected))
        energy = max(float(expected.mean(axis=0).sum()), float(sampled.mean(axis=0).sum()), 1e-300)
        known = (sigma > 0) & ((missing > 0) | enough)
        excess = np.abs(missing) - claim.error
        sigmas = np.divide(excess, sigma, out=np.full_like(excess, -np.inf), where=known)
        k = int(np.argmax(sigmas))
        if sigmas[k] > worst.sigmas:
            worst = Opinion(
                True,
                name,
                float(-missing[k] / energy),
                float(sigma[k] / energy),
                float(sigmas[k]),
                count * SAMPLES,
                missing=float(missing[k]),
            )
    return worst


def _with_sum(energy: Floats) -> Floats:
    """(n, W + 1) energy in each window (n, W), followed by the sum over all windows."""
    return np.concatenate([energy, energy.sum(axis=1, keepdims=True)], axis=1)


def _drawn(lights: list[Floats], count: int, seed: int) -> tuple[Ints, Floats]:
    """(count,) indices drawn partly evenly and partly in proportion to each of several lights (n,), and (count,) the
    chance of each at one draw."""
    shares = [light / light.sum() for light in lights if light.sum() > 0]
    share = np.full(len(lights[0]), (EVENLY if shares else 1.0) / len(lights[0]))
    share += (1 - EVENLY) * sum(shares) / max(len(shares), 1)
    running = np.cumsum(share)
    # One draw in each of `count` equal steps of the running sum: strata lower the scatter at no cost.
    within = np.random.default_rng([LightStream.SECOND_OPINION, seed]).random(count)
    steps = (np.arange(count) + within) / count * running[-1]
    places = np.minimum(np.searchsorted(running, steps, side="right"), len(share) - 1)
    return places, share[places] / running[-1]


def _windows(light: Floats) -> Ints:
    """(W,) first bins of at most `WINDOWS` windows with equal shares of the light (T,); the first window starts at
    bin 0."""
    if not light.sum() > 0:
        return np.zeros(1, np.int64)
    running = np.cumsum(light) / light.sum()
    inner = np.searchsorted(running, np.arange(1, WINDOWS) / WINDOWS, side="right")
    return np.unique(np.concatenate([[0], np.minimum(inner, len(light) - 1)]))


def _compared(sampled: Floats, expected: Floats) -> tuple[Floats, Floats, Bools]:
    """(W,) mean missing energy, its standard error, and whether samples were `ENOUGH` to dispute light as too much.

    sampled, expected : (n, W) sampled and computed energy of each pair drawn, divided by the chance to draw it.
    """
    difference = sampled - expected
    sigma = difference.std(axis=0, ddof=1) / np.sqrt(len(difference))
    squares = (sampled**2).sum(axis=0)
    effective = np.divide(sampled.sum(axis=0) ** 2, squares, out=np.zeros_like(squares), where=squares > 0)
    # The last column is the sum of all windows. If a few bright paths dominate it, others like them may be missing
    # from any window.
    return difference.mean(axis=0), sigma, np.asarray(np.minimum(effective, effective[-1]) >= ENOUGH)
