"""The primary by quadrature, which has no noise, once unbiased samples agree with it.

`three_bounces.py` decides how finely surfaces are cut. A few unbiased samples are compared with the light found
(`second_opinion.py`); if they disagree, quadrature gets a second try with a quarter of the error. If they still
disagree, or where quadrature is not possible, the primary has to be sampled.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import reduce

import numpy as np

from datagen.records.arrays import Floats, l2_norm
from datagen.transport.error_control.cost import CELL, CELL_RAY
from datagen.transport.error_control.second_opinion import Claim, Opinion, second_opinion
from datagen.transport.problem import Problem
from datagen.transport.quadrature.gathering import Gathering
from datagen.transport.quadrature.three_bounces import Primary, primary_by_cells

TRIES = (1.0, 0.25)
"""Errors that quadrature is tried with, one after the other, relative to those asked for."""
LEAST_CLAIM = 0.4
"""Least error that is claimed of light by quadrature, relative to the error asked for. An estimate comes from a dozen
pairs of laser point and pixel, and is now and then 2.2 times too small; with half of this, one in 400 claims would be
exceeded twofold."""


@dataclass(frozen=True)
class PrimaryLight:
    """The primary by quadrature.

    Attributes
    ----------
    rows : (L, P, T) light of each part, or of all parts in one row.
    error : L2 error of their sum, photons. part_errors : object → relative L2 error of its own light.
    rays : shadow rays and surface elements.
    opinion : how unbiased samples agree, in words.
    """

    rows: list[Floats]
    overflow: Floats
    error: float
    part_errors: Mapping[str, float]
    rays: float
    opinion: str


def primary_by_quadrature(problem: Problem, target: float) -> PrimaryLight | str:
    """The primary with about the relative error `target`; or, where it has to be sampled, why, in words."""
    gathering, opinions, asked = Gathering.of(problem), list[Opinion](), problem.accuracy
    for factor in TRIES:
        found = primary_by_cells(gathering, factor * target, factor * asked.each_part, asked.faint_part)
        if found is None:
            return "; ".join(map(str, opinions))
        cost = CELL * found.cells + CELL_RAY * found.rays
        opinions.append(second_opinion(problem, _claims(problem, found), cost, len(opinions)))
        if opinions[-1].agrees:
            error = max(found.error, LEAST_CLAIM * target) * l2_norm(reduce(np.add, found.rows))
            least = LEAST_CLAIM * asked.each_part
            part_errors = {name: max(own, least) for name, own in found.part_errors.items()}
            words = "; ".join(map(str, opinions))
            return PrimaryLight(found.rows, found.overflow, error, part_errors, found.cells + found.rays, words)
    return "; ".join(map(str, opinions))


def _claims(problem: Problem, primary: Primary) -> dict[str, Claim]:
    """Name → claimed light, for the whole primary and for each part that brings light.

    The light of a part without an error of its own may be wrong by as much as the whole.
    """
    whole = reduce(np.add, primary.rows)
    error_of_whole = primary.error * float(whole.sum())
    claims = {"primary": Claim(whole, error_of_whole, order=3)}
    for k, name in enumerate(problem.parts):
        own_error = primary.part_errors.get(name)
        if own_error is not None or primary.rows[k].any():
            error = error_of_whole if own_error is None else own_error * float(primary.rows[k].sum())
            claims[name] = Claim(primary.rows[k], error, 3, k)
    return claims
