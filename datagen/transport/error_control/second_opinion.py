"""A second opinion on light that was found by cells: a few unbiased samples of its energy, by part and time window.

Differences between two cuttings of one method tell of discretisation and nothing of what both miss. So some pairs of
laser point and pixel are drawn at random, and paths of light (`sampled_paths.py`, which knows of no cells) say how
much more or less energy they bring than was found there, by part and in coarse windows of time. With chance q to draw
a pair, x its sampled energy and m the one found,

    D = ⟨(x − m)/q⟩     has the mean  Σ over all pairs of (truth − found),

so D measures the missing energy of the whole scan, and its scatter over the pairs drawn is its standard error σ. The
light is taken to be as claimed unless |D| exceeds what is claimed by more than chance allows.

A first look takes few samples and calls for a second one easily (`LOOK_AGAIN`); the second, of `MORE` times as many
new samples, decides at `LEVEL`. Samples that meet a rare bright path scatter so much that they call for nothing, and
samples that missed one have to be many before they may say that light found by cells is not there (`ENOUGH`).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from scipy.special import ndtri

from datagen.records.arrays import Bools, Floats, Ints
from datagen.seeding import LightStream
from datagen.transport.error_control.cost import SAMPLE
from datagen.transport.problem import Problem
from datagen.transport.reference import pairs_of
from datagen.transport.sampled_paths import sample_paths
from datagen.transport.sampling import stream_seeds
from datagen.transport.visibility.coincidence import lit_in_one_place
from datagen.units import time_from_path

PAIRS, SAMPLES, SHARE = (128, 1024), 16, 0.04
"""Fewest and most pairs drawn in a first look, samples of each, and the share of the work on the light that a first
look may take in between. Half the pairs would see a loss √2 times as large."""
MORE = 16
"""How many times the fewest pairs a second look has, and four times those of the first at least."""
WINDOWS = 4
"""Windows of time, each with an equal share of the light that was found; all of it is tested, too."""
LOOK_AGAIN = 1.75
"""Standard errors beyond the claim from which a first look calls for a second."""
LEVEL = 1e-4
"""Chance that a second look calls light wrong that is right, over all its parts and windows."""
ENOUGH = 64
"""Independent bright samples, (Σx)²/Σx², from which samples may say that there is less light than was found: in a
window, and in all of them together."""
EVENLY = 0.25
"""Weight of drawing pairs evenly, beside that of all claims' light."""


@dataclass(frozen=True)
class Claim:
    """Light that was found, and how wrong it may be.

    light : (L, P, T) photons. error : photons, over all of them, by which it is claimed to be wrong at most.
    order : bounces of its paths. part : index of the part that it comes from last, −1 for all.
    """

    light: Floats
    error: float
    order: int
    part: int = -1


@dataclass(frozen=True)
class Opinion:
    """What the samples say.

    agrees : whether all light is as claimed, as far as chance allows. worst : name of the claim that is farthest off.
    off : how much more energy was found in its worst window than samples have, relative to all of its energy.
    known : one standard error of that. sigmas : by how many of these it exceeds what is claimed; negative if it does
        not. missing : photons that samples have and the light found has not, in that window. samples : how many were
        drawn, over all looks.
    undecided : whether they disagree where parts lie in one place, of which cells see another than rays do.
    """

    agrees: bool
    worst: str
    off: float
    known: float
    sigmas: float
    samples: int
    undecided: bool = False
    missing: float = 0.0

    def __str__(self) -> str:
        verdict = "agrees" if self.agrees else "disagrees"
        verdict = "undecided, for parts lie in one place" if self.undecided else verdict
        return f"{verdict}: of {self.samples} samples, farthest off {self.worst}, {self.off:+.1%} ± {self.known:.1%}"


def second_opinion(problem: Problem, claims: Mapping[str, Claim], cost: float = 0.0, turn: int = 0) -> Opinion:
    """Whether unbiased samples of the energy agree with the light that was found.

    claims : name → light. cost : what finding it took, in units of
    `cost.py`. turn : number of this opinion on a scene; each has random numbers of its own.
    """
    order = max(claim.order for claim in claims.values())
    count = int(np.clip(SHARE * cost / (SAMPLE * SAMPLES), *PAIRS))
    first = _look(problem, claims, count, order, 2 * turn)
    if first.sigmas <= LOOK_AGAIN:
        return first
    second = _look(problem, claims, max(MORE * PAIRS[0], 4 * count), order, 2 * turn + 1)
    tests = (WINDOWS + 1) * len(claims)
    agrees = second.sigmas <= -float(ndtri(LEVEL / (2 * tests)))
    undecided = not agrees and lit_in_one_place(problem.scene, problem.caster, _lifted(problem))
    return replace(second, agrees=agrees or undecided, undecided=undecided, samples=first.samples + second.samples)


def _lifted(problem: Problem) -> Floats:
    """(n, 3) laser points that lie on a surface, a little above it."""
    lit = problem.points.part >= 0
    return problem.points.position[lit] + problem.caster.offset_m * problem.points.normal[lit]


def _look(problem: Problem, claims: Mapping[str, Claim], count: int, last_order: int, look: int) -> Opinion:
    """One look at `count` pairs; it agrees."""
    time = problem.capture.time
    seed = int(stream_seeds(problem.seed, LightStream.SECOND_OPINION, 0, np.array([look]))[0])
    every = pairs_of(problem.capture)
    lit = np.flatnonzero(problem.points.part[every[:, 0]] >= 0)
    found = {name: claim.light.reshape(-1, time.bins) for name, claim in claims.items()}
    which, chance = _drawn([light[lit].sum(axis=1) for light in found.values()], count, seed)
    rows = lit[which]
    paths = sample_paths(
        problem.caster, problem.scene, problem.materials, problem.capture, every[rows], SAMPLES,
        max_bounces=last_order, occlusion=problem.accuracy.occlusion != "off", seed=seed,
    )  # fmt: skip
    bins = np.floor((time_from_path(paths.path_m) - time.start_s) / time.width_s)
    inside = (bins >= 0) & (bins < time.bins)
    worst = Opinion(True, next(iter(claims)), 0.0, 0.0, -np.inf, count * SAMPLES)
    for name, claim in claims.items():
        edges = _windows(found[name].sum(axis=0))
        of_claim = inside & (paths.order == claim.order) & ((claim.part < 0) | (paths.part == claim.part))
        to = paths.pair[of_claim] * len(edges) + np.searchsorted(edges, bins[of_claim], side="right") - 1
        photons = np.bincount(to, paths.photons[of_claim], count * len(edges))
        sampled: Floats = photons.reshape(count, -1) / chance[:, None]
        expected = np.add.reduceat(found[name][rows], edges, axis=1) / chance[:, None]
        missing, sigma, enough = _compared(_with_sum(sampled), _with_sum(expected))
        energy = max(float(expected.mean(axis=0).sum()), float(sampled.mean(axis=0).sum()), 1e-300)
        known = (sigma > 0) & ((missing > 0) | enough)
        beyond = np.abs(missing) - claim.error
        sigmas = np.divide(beyond, sigma, out=np.full_like(beyond, -np.inf), where=known)
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
    """Energy in each window (n, W), and as one window more in all of them (n, W + 1)."""
    return np.concatenate([energy, energy.sum(axis=1, keepdims=True)], axis=1)


def _drawn(lights: list[Floats], count: int, seed: int) -> tuple[Ints, Floats]:
    """(count,) places drawn evenly and by each of several lights (n,), and the chance of each at one draw."""
    shares = [light / light.sum() for light in lights if light.sum() > 0]
    share = np.full(len(lights[0]), (EVENLY if shares else 1.0) / len(lights[0]))
    share += (1 - EVENLY) * sum(shares) / max(len(shares), 1)
    running = np.cumsum(share)
    # One draw in each of `count` equal steps of the running sum.
    within = np.random.default_rng([LightStream.SECOND_OPINION, seed]).random(count)
    steps = (np.arange(count) + within) / count * running[-1]
    places = np.minimum(np.searchsorted(running, steps, side="right"), len(share) - 1)
    return places, share[places] / running[-1]


def _windows(light: Floats) -> Ints:
    """First bins (W,) of at most `WINDOWS` windows with equal shares of the light (T,), the first from bin 0 on."""
    if not light.sum() > 0:
        return np.zeros(1, np.int64)
    running = np.cumsum(light) / light.sum()
    inner = np.searchsorted(running, np.arange(1, WINDOWS) / WINDOWS, side="right")
    return np.unique(np.concatenate([[0], np.minimum(inner, len(light) - 1)]))


def _compared(sampled: Floats, expected: Floats) -> tuple[Floats, Floats, Bools]:
    """(W,) mean missing energy, its standard error, and whether samples were `ENOUGH` to say that it is too much.

    sampled, expected : (n, W) energy of each pair drawn, over its chance.
    """
    apart = sampled - expected
    sigma = apart.std(axis=0, ddof=1) / np.sqrt(len(apart))
    squares = (sampled**2).sum(axis=0)
    effective = np.divide(sampled.sum(axis=0) ** 2, squares, out=np.zeros_like(squares), where=squares > 0)
    # The last is all windows' sum. Where it hangs on a few bright paths, there are more of them, in any window.
    return apart.mean(axis=0), sigma, np.asarray(np.minimum(effective, effective[-1]) >= ENOUGH)
