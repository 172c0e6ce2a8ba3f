"""Where the label images of many scenes lie, seen from the scan: what `info` and the card say of it."""

from __future__ import annotations

import statistics
from collections.abc import Iterable, Mapping

from datagen.records.sample import SCAN_PLACE

OVER_M = 0.01
"""Label images count as lying over the scan up to this distance of both middles: a third of a pixel of 64 in 2 m."""


def label_place_line(scenes: Iterable[Mapping[str, object]]) -> str:
    """One sentence; "" of datasets that do not say, such as those made before version 0.14."""
    away = []
    for of in scenes:
        right, up = (of.get(name) for name in SCAN_PLACE)
        if isinstance(right, float) and isinstance(up, float):
            away.append((right, up))
    if not away:
        return ""
    farthest = [max(abs(of[axis]) for of in away) for axis in (0, 1)]
    if max(farthest) <= OVER_M:
        return "Label images lie over the scan: both have the same middle."
    middle = statistics.median(abs(right) for right, _ in away)
    least = min(abs(right) for right, _ in away)
    return (
        f"Label images lie {least:.2g} … {farthest[0]:.2g} m beside the scan, middle to middle (median "
        f"{middle:.2g} m), and up to {farthest[1]:.2g} m above or below it: they show the hidden part, wherever that "
        "is (`hidden_view`; parameters `labels.scan_right_m`, `labels.scan_up_m`)."
    )
