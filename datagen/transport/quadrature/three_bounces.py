"""The primary of a scan without noise: light of three bounces, found by cutting surfaces into elements.

What a pixel receives by way of the hidden surface is an integral over that surface, and one whose integrand is smooth
wherever nothing hides it. So it is not sampled: each triangle is halved until an element is small against its
distance from the laser point and the pixel, and until the error that it can still make in the histogram is small
(`three_bounce_kernel.py`); elements that are partly hidden are halved further. How large an element may be is one
number for each object and one for all else, the L2 error that it may make, and an accuracy target chooses these
numbers: some laser points are gathered with ever smaller elements, until the difference that this makes is small in
the whole and in each object's own light (`refinement.py`). The error of what is chosen is thus known without noise, a
function of the scene alone.

Clusters of small triangles, whose light would be lost in the rest, are seen through one random point each.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from datagen.records.arrays import Bools, Floats, Ints
from datagen.transport.error_control.refinement import Asked, Choice, Quartering, Trial, choose, quarter
from datagen.transport.quadrature.gathering import Gathering, TooMuchWork
from datagen.transport.reference import pairs_of

MOST_TRIALS = 3
"""Most trials of a scan: each is drawn by the light that the one before found. With half as many, the second trial's
own oversights stay."""


@dataclass(frozen=True)
class Primary:
    """The primary of all laser points and pixels.

    Attributes
    ----------
    rows : one (L, P, T) array for each row of the task's splits.
    overflow : (L, P) photons outside the window.
    error : relative L2 error of the whole primary, as estimated.
    part_errors : part → that of its own light, for the objects that bring any.
    cells, rays : how many of them, the trials' with them.
    """

    rows: list[Floats]
    overflow: Floats
    error: float
    part_errors: Mapping[str, float]
    cells: int
    rays: int


def primary_by_cells(gathering: Gathering, target: float, part_target: float, faint: float = 0.0) -> Primary | None:
    """The primary with a relative L2 error of at most `target`, and of `part_target` in each object's own light.

    Returns nothing if that would take more work than `refinement.MOST_WORK`, or no light is found.

    faint : photons, per emitted photon and over all histograms, under which an object's light is not held to that.
    """
    task = gathering.task
    pairs = pairs_of(task.capture)
    asked = Asked(target, part_target, faint, np.array([role == "object" for role in task.scene.roles]))
    lit, found = task.points.part[pairs[:, 0]] >= 0, None
    for _ in range(MOST_TRIALS):
        try:
            tried = _tried(Trial.of(gathering, pairs[lit], asked, found), asked, len(pairs))
        except TooMuchWork:
            return None
        if tried is None:
            return None
        trial, choice, quartering = tried
        primary = _of_all_pairs(trial, choice, quartering, pairs, lit)
        found = _squares(primary.rows, trial.group)[lit]
        # A pair that has most of the light, and that the trial did not know, may have most of the error.
        if not trial.overlooks(pairs[lit], found[:, np.concatenate([[True], choice.claimed])]):
            break
    return primary


def _squares(rows: list[Floats], group: Ints) -> Floats:
    """(n, 1 + G) square of the L2 norm of each pair's light, in the whole and in each group.

    rows : as in `Primary`: one for each part, or a single one, whose light then stands for that of each group.
    group : (K,) index of each part's group.
    """
    of_groups = [np.flatnonzero(group == g) if len(rows) > 1 else [0] for g in range(group.max() + 1)]

    def square(some: Sequence[int] | Ints) -> Floats:
        # A sum at a time: histograms of a large scan take gigabytes. A group may have no parts.
        light = sum((rows[k] for k in some), start=np.zeros((1, 1, 1)))
        return np.broadcast_to(np.einsum("lpt,lpt->lp", light, light), rows[0].shape[:2]).ravel()

    return np.stack([square(some) for some in [range(len(rows)), *of_groups]], axis=1)


def _tried(trial: Trial, asked: Asked, pairs: int) -> tuple[Trial, Choice, Quartering] | None:
    """The cutting and the quartering that meet the errors asked, with the trial that they are known from; None if
    none does. pairs : number of all pairs."""
    while True:
        choice = choose(trial, asked)
        quartering = None if choice is None else quarter(trial, choice, asked, pairs)
        if choice is None or quartering is None:
            return None
        if quartering.levels <= trial.levels or quartering.change <= asked.target * choice.norm:
            return trial, choice, quartering
        # Smaller footprints see light that those of the trial missed (a narrow lobe passes between their points): how
        # finely its elements have to be cut is not known yet.
        trial = replace(trial, levels=quartering.levels, seen={})


def _of_all_pairs(trial: Trial, choice: Choice, quartering: Quartering, pairs: Ints, lit: Bools) -> Primary:
    """The primary of all pairs (n, 2), of which `lit` (n,) have light, and the errors that the trial found."""
    gathering, task = trial.gathering, trial.gathering.task
    # Errors of the trial's pairs are known for the cutting that was tried: only if others are left, a cheaper cutting
    # in between is worth its uncertainty.
    cutting = choice.tried_cutting if len(trial.pairs) == lit.sum() else choice.cutting
    parts = len(trial.group)
    rows = np.arange(parts) if task.parts else np.zeros(parts, np.int64)
    levels = max(quartering.levels, gathering.ray_levels())
    seen = gathering.seen(pairs, levels, quartering.edge_levels)
    # With the random points of the trial, whose pairs then have the errors that were estimated.
    found = gathering.gathered(pairs, seen, cutting[trial.group], rows, choice.draw[trial.group])
    shape, names = task.capture.shape, task.scene.part_names
    # Errors of elements and of footprints are independent of each other, so their squares add up.
    errors = np.hypot(choice.group_error, quartering.group_error) / np.where(choice.claimed, choice.group_norm, 1.0)
    return Primary(
        [np.ascontiguousarray(found.histogram[:, k]).reshape(shape) for k in range(rows.max() + 1)],
        found.overflow.reshape(shape[:2]), math.hypot(choice.error, quartering.error) / choice.norm,
        {names[k]: float(errors[g]) for k, g in enumerate(trial.group) if choice.claimed[g]},
        trial.work.cells + int(found.cells.sum()), trial.work.rays + int(found.rays.sum()),
    )  # fmt: skip
