"""How much evidence the objects of many scenes have, kind by kind: what `info`, the card and `plan` say of it."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass

import numpy as np

from datagen.records.arrays import Floats

LEAST = 3.0
"""Standard deviations under which a label cannot be learnt from the data."""
SHARE = 0.9
NEAR = 5
"""Objects of which nine in ten must be over `LEAST` for a distance to be told."""
PLACED_ANEW = "evidence.placed_anew"
"""Of a scene: how often its objects were placed anew for want of evidence."""
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
    within_m : of those that are no farther away, `SHARE` are over `LEAST`; NaN where that many are anyway, where
        fewer than `NEAR` objects show it, or where the distances are not known.
    """

    kind: str
    objects: int
    median: float
    under_3: float
    under_1: float
    exposure_factor: float
    within_m: float = math.nan


def kind_of(part: str) -> str:
    """What an object is called in `scene.contents`: its part's name without its number (box_2: box)."""
    return re.sub(r"_\d+$", "", part)


def evidence_by_kind(scenes: Iterable[Mapping[str, object]], together: str | None = None) -> list[KindEvidence]:
    """Of scenes' parameters, the kinds in alphabetical order; none where no evidence is stored.

    `PART.away_m` beside them is how far away an object is.

    together : all kinds as one, of this name.
    """
    return [_summary(kind, *np.array(told).T) for kind, told in _of_kinds(scenes, together).items()]


def significance_by_kind(scenes: Iterable[Mapping[str, object]]) -> dict[str, list[float]]:
    """Kind, in alphabetical order → the significance of each object of it."""
    return {kind: [value for value, _ in told] for kind, told in _of_kinds(scenes).items()}


def _of_kinds(
    scenes: Iterable[Mapping[str, object]], together: str | None = None
) -> dict[str, list[tuple[float, float]]]:
    """Kind → significance and distance of each object of it."""
    found: dict[str, list[tuple[float, float]]] = {}
    for parameters in scenes:
        for name, value in parameters.items():
            match = _SIGNIFICANCE.fullmatch(name)
            if match and isinstance(value, int | float):
                away = parameters.get(f"{match[1]}.away_m")
                told = float(value), float(away) if isinstance(away, float) else math.nan
                found.setdefault(together or kind_of(match[1]), []).append(told)
    return dict(sorted(found.items()))


def _summary(kind: str, sigma: Floats, away_m: Floats) -> KindEvidence:
    weak = float(np.quantile(sigma, 1 - SHARE, method="lower"))
    factor = float("inf") if weak <= 0 else max((LEAST / weak) ** 2, 1.0)
    under_3, under_1 = (float((sigma < limit).mean()) for limit in (LEAST, 1.0))
    within_m = _within_m(sigma, away_m) if under_3 > 1 - SHARE else math.nan
    return KindEvidence(kind, len(sigma), float(np.median(sigma)), under_3, under_1, factor, within_m)


def _within_m(sigma: Floats, away_m: Floats) -> float:
    """The greatest distance within which `SHARE` of the objects are over `LEAST`."""
    order = np.argsort(away_m, kind="stable")
    over = np.cumsum(sigma[order] >= LEAST) / np.arange(1, len(sigma) + 1)
    near = np.flatnonzero(over >= SHARE)
    return float(away_m[order][near[-1]]) if len(near) and near[-1] + 1 >= NEAR else math.nan


def placed_anew_lines(scenes: Iterable[Mapping[str, object]]) -> list[str]:
    """How many scenes had their objects placed anew for the evidence asked of them; none where none is asked."""
    times = [int(of[PLACED_ANEW]) for of in scenes if isinstance(of.get(PLACED_ANEW), int)]  # type: ignore[call-overload]
    if not times:
        return []
    share, mean = sum(count > 0 for count in times) / len(times), sum(times) / len(times)
    return [
        f"evidence_at_least: in {share:.0%} of scenes objects were placed anew, {mean:.2g} times a scene; near, "
        "large and bright ones are more frequent than declared"
    ]


def evidence_lines(kinds: Iterable[KindEvidence]) -> list[str]:
    """A line for each kind on which a person can act."""
    lines = []
    for of in kinds:
        line = f"{of.kind}: {of.median:.2g} σ in the median of {of.objects}, {of.under_3:.0%} under {LEAST:g} σ"
        if of.exposure_factor > 1:
            ways = [f"{of.exposure_factor:.2g} × the exposure" if of.exposure_factor < 1e6 else "no exposure"]
            ways += [] if math.isnan(of.within_m) else [f"at most {of.within_m:.2g} m away,"]
            line += f"; {', or '.join(ways)} would bring {SHARE:.0%} over"
        lines.append(line)
    return lines
