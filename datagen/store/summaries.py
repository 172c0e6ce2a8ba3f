"""Sentences about many scenes that `info`, the card, `plan` and `build` share: the significance of objects (evidence)
by kind, how often objects were placed again, and where label images lie relative to the scan."""

from __future__ import annotations

import math
import re
import statistics
from collections.abc import Iterable, Mapping
from dataclasses import dataclass

import numpy as np

from datagen.records.arrays import Floats
from datagen.records.sample import SCAN_PLACE

LEAST = 3.0
"""Significance, in standard deviations, below which a label cannot be learnt from the data. With half as much, one
empty room in 15 would look as if the object were there, instead of one in 700."""
SHARE = 0.9
"""Fraction of the objects that an advice brings over `LEAST`; with half, every other object would stay below."""
NEAR = 5
"""Least number of objects for which a distance is stated; with half as many it could come from one lucky object."""
PLACED_ANEW = "evidence.placed_anew"
"""Parameter of a scene: how often its objects were placed again for want of evidence."""
OVER_M = 0.01
"""Distance of the middles up to which label images count as lying over the scan: a third of a pixel if 64 pixels
cover 2 m. Half as much would report shifts that no pixel shows."""
_SIGNIFICANCE = re.compile(r"evidence\.(.+)\.significance")

Parameters = Iterable[Mapping[str, object]]
"""The parameters of several scenes, as `samples.parquet` has them."""


@dataclass(frozen=True)
class KindEvidence:
    """The significance of all objects of one kind.

    kind : name in `scene.contents`.
    objects : number of objects.
    median : of their significance.
    under_3, under_1 : fractions with a significance below 3 and 1.
    exposure_factor : factor of the exposure that would bring `SHARE` of the objects over `LEAST`, since significance
        grows with the square root of the exposure; 1 if they are over it, infinite if too many bring no light at all.
    within_m : distance up to which `SHARE` of the objects are over `LEAST`; NaN if that many of all objects are, if
        fewer than `NEAR` objects are so near, or if distances are unknown.
    """

    kind: str
    objects: int
    median: float
    under_3: float
    under_1: float
    exposure_factor: float
    within_m: float = math.nan


def evidence_by_kind(scenes: Parameters, together: str | None = None) -> list[KindEvidence]:
    """The evidence of each kind of object, in alphabetical order; empty if no evidence is stored.

    scenes : parameters; `PART.away_m` is the distance of an object.
    together : name under which all kinds are counted as one.
    """
    return [_evidence(kind, *np.array(objects).T) for kind, objects in _objects_by_kind(scenes, together).items()]


def significance_by_kind(scenes: Parameters) -> dict[str, list[float]]:
    """Kind, in alphabetical order → the significance of each of its objects."""
    return {kind: [sigma for sigma, _ in objects] for kind, objects in _objects_by_kind(scenes).items()}


def _objects_by_kind(scenes: Parameters, together: str | None = None) -> dict[str, list[tuple[float, float]]]:
    """Kind → significance and distance of each of its objects."""
    kinds: dict[str, list[tuple[float, float]]] = {}
    for parameters in scenes:
        for name, value in parameters.items():
            match = _SIGNIFICANCE.fullmatch(name)
            if match and isinstance(value, int | float):
                away = parameters.get(f"{match[1]}.away_m")
                one = float(value), float(away) if isinstance(away, float) else math.nan
                # The kind is the name of the part without its number (box_2: box).
                kinds.setdefault(together or re.sub(r"_\d+$", "", match[1]), []).append(one)
    return dict(sorted(kinds.items()))


def _evidence(kind: str, sigma: Floats, away_m: Floats) -> KindEvidence:
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


def evidence_lines(kinds: Iterable[KindEvidence]) -> list[str]:
    """A line for each kind, with its significance and how to raise it."""
    lines = []
    for k in kinds:
        line = f"{k.kind}: {k.median:.2g} σ in the median of {k.objects}, {k.under_3:.0%} under {LEAST:g} σ"
        if k.exposure_factor > 1:
            ways = [f"{k.exposure_factor:.2g} × the exposure" if k.exposure_factor < 1e6 else "no exposure"]
            ways += [] if math.isnan(k.within_m) else [f"at most {k.within_m:.2g} m away,"]
            line += f"; {', or '.join(ways)} would bring {SHARE:.0%} over"
        lines.append(line)
    return lines


def placed_anew_lines(scenes: Parameters) -> list[str]:
    """One line on how often objects were placed again for `evidence_at_least`; no line without that key."""
    times = [value for scene in scenes if isinstance(value := scene.get(PLACED_ANEW), int)]
    if not times:
        return []
    share, mean = sum(count > 0 for count in times) / len(times), sum(times) / len(times)
    return [
        f"evidence_at_least: in {share:.0%} of scenes objects were placed anew, {mean:.2g} times a scene; near, "
        "large and bright ones are more frequent than declared"
    ]


def label_place_line(scenes: Parameters) -> str:
    """One sentence on where label images lie beside the scan; "" for datasets that do not store it (before 0.14)."""
    shifts = []
    for parameters in scenes:
        right, up = (parameters.get(name) for name in SCAN_PLACE)
        if isinstance(right, float) and isinstance(up, float):
            shifts.append((abs(right), abs(up)))
    if not shifts:
        return ""
    aside, above = (max(shift[axis] for shift in shifts) for axis in (0, 1))
    if max(aside, above) <= OVER_M:
        return "Label images lie over the scan: both have the same middle."
    middle, least = statistics.median(right for right, _ in shifts), min(right for right, _ in shifts)
    return (
        f"Label images lie {least:.2g} … {aside:.2g} m beside the scan, middle to middle (median "
        f"{middle:.2g} m), and up to {above:.2g} m above or below it: they show the hidden part, wherever that "
        "is (`hidden_view`; parameters `labels.scan_right_m`, `labels.scan_up_m`)."
    )
