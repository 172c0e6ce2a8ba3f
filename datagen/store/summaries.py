"""Sentences about many scenes that `info`, the card, `plan` and `build` share: the significance of objects (evidence)
by kind, light that the time axis misses, how often objects were placed again, and where label images lie relative to
the scan."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass

import numpy as np

from datagen.records import Scalar
from datagen.records.arrays import Floats
from datagen.records.sample import SCAN_PLACE
from datagen.store.columns import Columns

LEAST = 3.0
"""Significance, in standard deviations, below which a label cannot be learnt from the data: one empty room in 700
looks as if the object were there."""
SHARE = 0.9
"""Fraction of the objects that an advice brings over `LEAST`."""
PLACED_ANEW = "evidence.placed_anew"
"""Parameter of a scene: how often its objects were placed again for want of evidence."""
OVER_M = 0.01
"""Distance of the middles up to which label images count as lying over the scan: a third of a pixel if 64 pixels
cover 2 m."""
MISSED = 0.9
"""Share of a scene's light outside of the time axis from which on its histograms miss the scene."""
SIGNIFICANCE = re.compile(r"evidence\.(.+)\.significance")
"""Name of the parameter that has the significance of an object's own light."""
CHANGE, CHANGE_FLOOR = (re.compile(rf"evidence\.(.+)\.{name}") for name in ("change", "change_floor"))
"""Names of the parameters that have the change from frame to frame by an object, and its floor."""


@dataclass(frozen=True)
class KindEvidence:
    """The significance of all objects of one kind.

    kind : name in `scene.contents`.
    objects : number of objects.
    median : of their significance.
    under_3, under_1 : fractions with a significance below 3 and 1.
    exposure_factor : factor of the exposure that would bring `SHARE` of the objects over `LEAST`, since significance
        grows with the square root of the exposure; 1 if they are over it, infinite if too many bring no light at all.
    """

    kind: str
    objects: int
    median: float
    under_3: float
    under_1: float
    exposure_factor: float


def evidence_by_kind(parameters: Columns, as_one: str | None = None) -> list[KindEvidence]:
    """The evidence of each kind of object, in alphabetical order; empty if no evidence is stored.

    as_one : name under which all kinds are counted as one.
    """
    kinds: dict[str, list[Floats]] = {}
    for name, column in parameters.items():
        match = SIGNIFICANCE.fullmatch(name)
        if match and not column.is_text:
            # The kind is the name of the part without its number (box_2: box).
            kinds.setdefault(as_one or re.sub(r"_\d+$", "", match[1]), []).append(column.numbers)
    return [_evidence(kind, np.concatenate(sigma)) for kind, sigma in sorted(kinds.items())]


def _evidence(kind: str, sigma: Floats) -> KindEvidence:
    weak = float(np.quantile(sigma, 1 - SHARE, method="lower"))
    factor = float("inf") if weak <= 0 else max((LEAST / weak) ** 2, 1.0)
    under_3, under_1 = (float((sigma < limit).mean()) for limit in (LEAST, 1.0))
    return KindEvidence(kind, len(sigma), float(np.median(sigma)), under_3, under_1, factor)


CLIPPED = 1e-3
"""Share of the light that moving parts block which may be clipped without a warning: its shadow is known to no
better than some per cent."""


def missed_lines(parameters: Columns) -> list[str]:
    """A line on the scenes whose light arrives outside of the time axis, and what to change; none if there are
    none."""
    share = parameters.numbers("transient.overflow")
    missed = int((share >= MISSED).sum())
    if not missed:
        return []
    return [
        f"in {missed} of {len(share)} scenes {MISSED:.0%} of the light or more arrives outside of the time axis; "
        "bring the device nearer (at_objects.distance_m, layout.relay_distance_m), or take more or wider bins "
        "(capture.time)"
    ]


def clipped_lines(parameters: Columns) -> list[str]:
    """A line on the sequences whose light is below 0 where moving parts block it, by more than what may be clipped
    unnoticed; none if there are none."""
    share = parameters.numbers("transient.clipped")
    beyond = int((share > CLIPPED).sum())
    if not beyond:
        return []
    return [
        f"in {beyond} of {len(share)} sequences light below 0 was clipped when counts were drawn, up to "
        f"{share.max():.2g} of what moving parts block (transient.clipped); lower transport.target"
    ]


def evidence_lines(kinds: Iterable[KindEvidence]) -> list[str]:
    """A line for each kind, with its significance and how to raise it."""
    lines = []
    for k in kinds:
        line = f"{k.kind}: {k.median:.2g} σ in the median of {k.objects}, {k.under_3:.0%} under {LEAST:g} σ"
        if k.exposure_factor > 1:
            times = f"{k.exposure_factor:.2g} × the exposure" if k.exposure_factor < 1e6 else "no exposure"
            line += f"; {times} would bring {SHARE:.0%} over"
        lines.append(line)
    return lines


def change_lines(parameters: Columns) -> list[str]:
    """A line for each kind of object that moves: the change from frame to frame by it, and how well that is known."""
    found: dict[str, tuple[list[Floats], list[Floats]]] = {}
    for name, column in parameters.items():
        for place, pattern in enumerate((CHANGE, CHANGE_FLOOR)):
            match = pattern.fullmatch(name)
            if match and not column.is_text:
                kind = re.sub(r"_\d+$", "", match[1])
                found.setdefault(kind, ([], []))[place].append(column.numbers)
    lines = []
    for kind, of in sorted(found.items()):
        change, floor = map(np.concatenate, of)
        lines.append(
            f"{kind}: from frame to frame {np.median(change):.2g} σ in the median of {len(change)}, of which errors "
            f"of the simulation may make {np.median(floor):.2g} σ"
        )
    return lines


def effects_of(parameters: Mapping[str, Scalar]) -> dict[str, Scalar]:
    """The parameters of a scene about the effects that it has at all, left out or not."""
    names = (name for name in parameters if name.startswith("effect.") and name.endswith(".kind"))
    there = [name.removesuffix("kind") for name in names if parameters[name] != "absent"]
    keys = [stem + key for stem in there for key in ("kind", "on", "estimate")]
    return {key: parameters[key] for key in keys if key in parameters}


def placed_anew_lines(parameters: Columns) -> list[str]:
    """One line on how often objects were placed again for `evidence_at_least`; no line without that key."""
    column = parameters.get(PLACED_ANEW)
    if column is None or column.kinds != {int}:
        return []
    times = column.numbers
    share, mean = float((times > 0).mean()), float(times.mean())
    return [
        f"evidence_at_least: in {share:.0%} of scenes objects were placed anew, {mean:.2g} times a scene; near, "
        "large and bright ones are more frequent than declared"
    ]


def label_place_line(parameters: Columns) -> str:
    """One sentence on where label images lie beside the scan; "" if no scene says so, as in imports."""
    if any(name not in parameters or parameters[name].kinds != {float} for name in SCAN_PLACE):
        return ""
    right, up = (np.abs(parameters[name].numbers) for name in SCAN_PLACE)
    aside, above = right.max(), up.max()
    if max(aside, above) <= OVER_M:
        return "Label images lie over the scan: both have the same middle."
    middle, least = np.median(right), right.min()
    return (
        f"Label images lie {least:.2g} … {aside:.2g} m beside the scan, middle to middle (median "
        f"{middle:.2g} m), and up to {above:.2g} m above or below it: they show the hidden part, wherever that "
        "is (`hidden_view`; parameters `labels.scan_right_m`, `labels.scan_up_m`)."
    )
