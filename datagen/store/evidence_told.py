"""How much evidence the objects of many scenes have, kind by kind: what `info`, the card and `plan` say of it."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass

import numpy as np

LEAST = 3.0
"""Standard deviations under which a label cannot be learnt from the data."""
SHARE = 0.9
_SIGNIFICANCE = re.compile(r"evidence\.(.+)\.significance")


@dataclass(frozen=True)
class KindEvidence:
    """The significance of all objects of one kind.

    Attributes
    ----------
    kind : name in `scene.contents`. objects : how many were found.
    median : of their significance. under_3, under_1 : shares that have less.
    exposure_factor : so many times the exposure brings `SHARE` of them over `LEAST`, since significance grows with
        its root; 1 where they are, infinite where that many have no light at all.
    """

    kind: str
    objects: int
    median: float
    under_3: float
    under_1: float
    exposure_factor: float


def kind_of(part: str) -> str:
    """What an object is called in `scene.contents`: its part's name without its number (box_2: box)."""
    return re.sub(r"_\d+$", "", part)


def evidence_by_kind(scenes: Iterable[Mapping[str, object]]) -> list[KindEvidence]:
    """Of scenes' parameters, the kinds in alphabetical order; none where no evidence is stored."""
    return [_summary(kind, np.array(values)) for kind, values in significance_by_kind(scenes).items()]


def significance_by_kind(scenes: Iterable[Mapping[str, object]]) -> dict[str, list[float]]:
    """Kind, in alphabetical order → the significance of each object of it."""
    found: dict[str, list[float]] = {}
    for parameters in scenes:
        for name, value in parameters.items():
            match = _SIGNIFICANCE.fullmatch(name)
            if match and isinstance(value, int | float):
                found.setdefault(kind_of(match[1]), []).append(float(value))
    return dict(sorted(found.items()))


def _summary(kind: str, sigma: np.ndarray) -> KindEvidence:
    weak = float(np.quantile(sigma, 1 - SHARE, method="lower"))
    factor = float("inf") if weak <= 0 else max((LEAST / weak) ** 2, 1.0)
    under_3, under_1 = (float((sigma < limit).mean()) for limit in (LEAST, 1.0))
    return KindEvidence(kind, len(sigma), float(np.median(sigma)), under_3, under_1, factor)


def evidence_lines(kinds: Iterable[KindEvidence]) -> list[str]:
    """A line for each kind on which a person can act."""
    lines = []
    for of in kinds:
        line = f"{of.kind}: {of.median:.2g} σ in the median of {of.objects}, {of.under_3:.0%} under {LEAST:g} σ"
        if of.exposure_factor > 1:
            more = f"{of.exposure_factor:.2g} × the exposure" if of.exposure_factor < 1e6 else "no exposure"
            line += f"; {more} would bring {SHARE:.0%} over"
        lines.append(line)
    return lines
