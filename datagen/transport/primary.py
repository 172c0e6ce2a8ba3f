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
from dataclasses import dataclass

import numpy as np

from datagen.records.arrays import Bools, Floats, Ints
from datagen.records.materials import GGX, Material, Phong, Retroreflector
from datagen.transport.cells.hierarchy import Hierarchy
from datagen.transport.cells.light import COARSEST, Clock, Cutting, Lasers, gather
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
SETTLED = 0.05
"""Share of the error to be met below which a finer cutting of a part is not tried again."""
UNSEEN = 1e-4
"""Norm that a part is taken to have at least, relative to the whole, when it is cut."""
PATCH_LEVELS, MOST_PATCHES = (1, 2, 3, 4, 5), 1 << 21
PATCHES_SHARE = 0.3
"""Share of the error to be met that patches of the pixels may make where they end: it is four thirds of what
quartering them once more changes."""
_QUARTERED = 4 / 3


@dataclass(frozen=True)
class Primary:
    """The primary of all laser points and pixels.

    Attributes
    ----------
    rows : one (L, P, T) array for each row of the task's splits.
    overflow : (L, P) photons outside the window.
    error : relative L2 error of the whole primary, as estimated.
    part_errors : part → that of its own light, for the objects that bring any.
    met : whether both are as asked.
    cells, rays : how many of them, the trials' with them.
    """

    rows: list[Floats]
    overflow: Floats
    error: float
    part_errors: Mapping[str, float]
    met: bool
    cells: int
    rays: int


def smooth(task: WalkTask) -> bool:
    """Whether every BRDF of the scene varies slowly enough for cells."""
    return min(_width(material) for material in task.scene.materials) >= NARROWEST_RAD


def _width(material: Material) -> float:
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
    """Histograms (pair, row, bin) and overflow (pair,) in photons; squared errors of what the patches were too coarse
    for (K,); cells and rays."""

    histogram: Floats
    overflow: Floats
    coarse: Floats
    cells: int
    rays: int


@dataclass(frozen=True)
class _Gathering:
    """A scene and a capture as the compiled loop wants them."""

    task: WalkTask
    tree: Hierarchy
    lasers: Lasers
    clock: Clock
    coarsest: Floats
    peak: Floats

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
        width = np.array([_width(material) for material in task.scene.materials])
        seen = width[np.unique(points.part[points.part >= 0])].min(initial=1.0)
        peak = task.materials.values[:, 0] / (math.pi * width**2)
        return cls(task, Hierarchy.of(task.scene), lasers, clock, COARSEST * np.minimum(width, seen), peak)

    def patches(self, pixels: Ints, levels: int) -> Patches:
        task = self.task
        return Patches.of(task.caster, task.scene, task.capture.sensor, task.cones, pixels, levels)

    def gathered(self, pairs: Ints, patches: Patches, error: Floats, row_of_part: Ints) -> _Gathered:
        """The light of some pairs of laser point and pixel, with each part in its row."""
        task, rows = self.task, int(row_of_part.max()) + 1
        histogram = np.zeros((len(pairs) * rows, task.capture.time.bins))
        overflow, coarse = np.zeros(len(histogram)), np.zeros(len(error))
        seed = int(stream_seeds(task.seed, CLUSTER_STREAM, 0, np.zeros(1, np.int64))[0])
        cutting = Cutting(error, self.coarsest, self.peak, task.accuracy.occlusion != "off", seed)
        cells, rays = gather(
            pairs, np.arange(len(pairs)) * rows, self.tree, self.lasers, patches, task.materials.kind,
            task.materials.values, cutting, self.clock, row_of_part, histogram, overflow, coarse,
        )  # fmt: skip
        of_pairs = histogram.reshape(len(pairs), rows, -1)
        return _Gathered(of_pairs, overflow.reshape(len(pairs), rows).sum(axis=1), coarse, cells, rays)


def primary_by_cells(task: WalkTask, target: float, part_target: float, faint: float = 0.0) -> Primary:
    """The primary with a relative L2 error of at most `target`, and of `part_target` in each object's own light.

    faint : photons, per emitted photon and over all histograms, under which an object's light is not held to that.
    """
    gathering, pairs = _Gathering.of(task), _pairs(task)
    every = np.arange(len(task.scene.materials))
    lit = pairs[task.points.part[pairs[:, 0]] >= 0]
    few = lit[_spread(len(lit), _trials(len(lit), len(task.scene.materials) * task.capture.time.bins))]
    pixels, own = np.unique(few[:, 1], return_inverse=True)
    tried = np.stack([few[:, 0], own.reshape(-1)], axis=1)
    left = math.sqrt(1 - PATCHES_SHARE**2)
    asked = _Asked(left * target, left * part_target, faint * len(few) / max(len(lit), 1), _objects(task))
    all_pixels, cells, rays = np.unique(pairs[:, 1]), 0, 0
    for levels in PATCH_LEVELS:
        patches, finer = gathering.patches(pixels, levels), gathering.patches(pixels, levels + 1)
        choice = _choose(gathering, tried, patches, asked)
        one, other = (gathering.gathered(tried, some, choice.cutting, every) for some in (patches, finer))
        cells, rays = cells + choice.cells + one.cells + other.cells, rays + choice.rays + one.rays + other.rays
        norms, whole = _norms(other.histogram), float(np.linalg.norm(other.histogram.sum(axis=1)))
        patchy = _QUARTERED * float(np.linalg.norm((one.histogram - other.histogram).sum(axis=1)))
        patchy_parts = _QUARTERED * _norms(one.histogram - other.histogram)
        patches_do = patchy <= PATCHES_SHARE * target * whole and all(
            patchy_parts[k] <= PATCHES_SHARE * part_target * norms[k] for k in choice.part_errors
        )
        affordable = len(all_pixels) * 4 ** (levels + 2) // 3 <= MOST_PATCHES
        if (patches_do and not finer.missed) or not affordable:
            break
    rows = np.arange(len(choice.cutting)) if task.splits.parts else np.zeros(len(choice.cutting), np.int64)
    found = gathering.gathered(pairs, gathering.patches(all_pixels, levels), choice.cutting, rows)
    shape = task.capture.shape
    errors = {
        task.scene.part_names[k]: math.hypot(error, patchy_parts[k] / max(norms[k], 1e-300))
        for k, error in choice.part_errors.items()
    }
    error = math.hypot(choice.error, patchy / whole if whole > 0 else 0.0)
    return Primary(
        [np.ascontiguousarray(found.histogram[:, k]).reshape(shape) for k in range(rows.max() + 1)],
        found.overflow.reshape(shape[:2]), error, errors, choice.met and patches_do, cells + found.cells,
        rays + found.rays,
    )  # fmt: skip


@dataclass(frozen=True)
class _Asked:
    """The errors asked for, and which parts (K,) are objects."""

    target: float
    part_target: float
    faint: float
    objects: Bools


@dataclass(frozen=True)
class _Choice:
    """The error that a cell of each part may make (K,), and what error that leaves."""

    cutting: Floats
    error: float
    part_errors: Mapping[int, float]
    met: bool
    cells: int
    rays: int


def _choose(gathering: _Gathering, pairs: Ints, patches: Patches, asked: _Asked) -> _Choice:
    """The coarsest cutting of each part that does, found on some laser points and pixels with ever finer ones."""
    parts = len(asked.objects)
    every, settled = np.arange(parts), np.zeros(parts, np.bool_)
    first = gathering.gathered(pairs, patches, np.full(parts, COARSE), every)
    runs, cuttings = [first.histogram], [np.full(parts, COARSE)]
    cells, rays = first.cells, first.rays
    whole = float(np.linalg.norm(first.histogram.sum(axis=1)))
    own = _norms(first.histogram)
    if whole == 0.0:
        return _Choice(cuttings[0], 0.0, {}, True, cells, rays)
    scale = np.maximum(own, UNSEEN * whole) / math.sqrt(len(pairs))
    while True:
        cuttings.append(FIRST * FINER ** (len(runs) - 1) * scale)
        found = gathering.gathered(pairs, patches, np.where(settled, np.inf, cuttings[-1]), every)
        cells, rays = cells + found.cells, rays + found.rays
        found.histogram[:, settled] = runs[-1][:, settled]
        runs.append(found.histogram)
        whole, own = float(np.linalg.norm(runs[-1].sum(axis=1))), _norms(runs[-1])
        held = asked.objects & (own > 0) & (runs[-1].sum(axis=(0, 2)) >= asked.faint)
        still = np.array([_norms(run - runs[-1]) for run in runs[:-1]])
        still += (REST - 1) * still[-1]
        limit = np.where(held, asked.part_target * own, np.inf)
        level = np.argmax(np.vstack([still <= limit, np.ones(parts, np.bool_)]), axis=0)
        error = _whole_error(runs, level)
        while error > asked.target * whole and (level < len(runs) - 1).any():
            worst = int(
                np.argmax(np.where(level < len(runs) - 1, still[np.minimum(level, len(still) - 1), every], -1))
            )
            level[worst] += 1
            error = _whole_error(runs, level)
        met = bool((level < len(runs) - 1).all())
        # A finer cutting takes four times the cells where surfaces are partly hidden, and less where they are not.
        beyond = cells + rays + (found.cells + found.rays) / FINER > gathering.task.accuracy.max_lookins * len(pairs)
        if met or len(runs) > LEVELS or beyond:
            break
        settled |= (still[-1] <= SETTLED * asked.target * whole) & (still[-1] <= SETTLED * limit)
    level = np.minimum(level, len(still) - 1)
    errors = {int(k): float(still[level[k], k] / own[k]) for k in np.flatnonzero(held)}
    cutting = np.array(cuttings)[level, every]
    return _Choice(cutting, error / whole, errors, met, cells, rays)


def _whole_error(runs: list[Floats], level: Ints) -> float:
    """L2 error of the sum over parts, each as it is in the run of its level."""
    last, before = runs[-1], runs[-2]
    chosen = sum(runs[n][:, k] for k, n in enumerate(level))
    return float(np.linalg.norm(chosen - last.sum(axis=1)) + (REST - 1) * np.linalg.norm((before - last).sum(axis=1)))


def _norms(histograms: Floats) -> Floats:
    """(K,) L2 norm over laser points, pixels and bins of (n, K, T)."""
    return np.asarray(np.sqrt((histograms**2).sum(axis=(0, 2))))


def _objects(task: WalkTask) -> Bools:
    return np.array([role == "object" for role in task.scene.roles])


def _trials(pairs: int, values: int) -> int:
    """On how many of so many pairs a cutting is tried, each with so many values of histograms."""
    return int(np.clip(min(pairs // 20, MOST_TRIED // values), *TRIALS))


def _pairs(task: WalkTask) -> Ints:
    """(n, 2) laser point and pixel of each histogram, in their order; laser rays that met nothing with them."""
    lasers, pixels, _ = task.capture.shape
    if task.capture.pairing == "confocal":
        return np.stack([np.arange(lasers), np.arange(lasers)], axis=1)
    return np.stack(np.divmod(np.arange(lasers * pixels), pixels), axis=1)


def _spread(count: int, wanted: int) -> Ints:
    """At most `wanted` of `count` indices, in no step with the rows of a scan."""
    if count <= wanted:
        return np.arange(count)
    return np.unique(((np.arange(wanted) * (math.sqrt(5) - 1) / 2 + 0.5) % 1.0 * count).astype(np.int64))
