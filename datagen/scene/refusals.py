"""The error message where no room could be drawn: what failed how often, and which range to change."""

from __future__ import annotations

import re
from collections import Counter

from datagen.config.distributions import Distribution, support
from datagen.config.scene import SceneConfig
from datagen.config.scene_contents import Item


def explain(spec: SceneConfig, seed: int, index: int, reasons: Counter[tuple[str, str]]) -> str:
    """The message for a scene that was given up; `reasons` counts the (where, what) of each failed attempt."""
    lines = [_line(spec, where, what, times) for (where, what), times in reasons.most_common(3)]
    others = sum(reasons.values()) - sum(times for _, times in reasons.most_common(3))
    more = f"; {others} × other reasons" if others else ""
    return (
        f"scene {index} (seed {seed}): no room met the constraints in {spec.max_attempts} attempts "
        f"(scene.max_attempts): {'; '.join(lines)}{more}"
    )


def _line(spec: SceneConfig, where: str, what: str, times: int) -> str:
    if where == "layout":
        for key, dimension in spec.layout.dimensions().items():
            what = re.sub(rf"\b{key}\b", f"{key} ({_range(dimension)})", what)
        return f"{times} × scene.layout: {what}"
    i = int(where.removeprefix("contents[").removesuffix("]"))
    item = spec.contents[i]
    sizes = _sizes(i, item)
    across = ("across", item.across) if item.offset_m is None else ("offset_m", item.offset_m)
    along = ("along", item.along) if item.distance_m is None else ("distance_m", item.distance_m)
    height = "" if (given := getattr(item, "height_m", None)) is None else f" ({_range(given)})"
    where_to = f"scene.{where}.{across[0]} ({_range(across[1])}) or {along[0]} ({_range(along[1])})"
    obstacle = {
        "wall": f"did not fit between the walls: lower {sizes}, change {where_to}, or enlarge the hidden part "
        "(scene.layout)",
        "object": f"had no place beside the other objects: lower {sizes}, scene.{where}.count "
        f"({_range(item.count)}) or scene.clearance_m ({spec.clearance_m:g})",
        "sight": f"stood in sight of the device: change {where_to}, lower {sizes}, or enlarge the hidden part "
        "(scene.layout)",
        "height": f"did not fit between floor and ceiling: lower scene.{where}.height_m{height} or elevation_m, or "
        f"raise scene.layout.height_m ({_range(spec.layout.height_m)})",
        "no_wall": "found no wall to stand against: set its placement to floor, or choose another scene.layout.kind",
        "unseen": f"could hardly be seen from the visible part of the relay wall: change {where_to}, remove what "
        f"stands before it, or lower scene.minimum_seen ({spec.minimum_seen:g})",
        **_ways(where, item),
        "dim": f"had less evidence than {item.evidence_at_least or 0:g} σ: raise detector.cycles or "
        f"photons_per_pulse, change {where_to}, or lower scene.{where}.evidence_at_least",
    }[what]
    return f"{times} × scene.{where} ({item.part_name}) {obstacle}"


def _ways(where: str, item: Item) -> dict[str, str]:
    """What is said of an object that found no free way, by what was in the way most often."""
    if item.motion is None:
        return {}
    pace = [key for key in ("speed_m_s", "leg_m") if hasattr(item.motion, key)]
    lower = " and ".join(f"scene.{where}.motion.{key} ({_range(getattr(item.motion, key))})" for key in pace)
    remedy = f"lower {lower} or sequence.frames" if pace else f"change scene.{where}.motion"
    met = {
        "wall": "leads into a wall", "object": "meets another object", "sight": "comes in sight of the device",
        "height": "does not fit between floor and ceiling",
    }  # fmt: skip
    return {
        f"way {what}": f"had no free way, most often because it {why}: {remedy}, or enlarge the hidden part "
        "(scene.layout)"
        for what, why in met.items()
    }


def _sizes(i: int, item: Item) -> str:
    """The keys that decide how much floor an object takes."""
    given = [name for name in item.sizes if getattr(item, name) is not None]
    given = [name for name in given if name != "height_m"] or given
    return " or ".join(f"scene.contents[{i}].{name} ({_range(getattr(item, name))})" for name in given)


def _range(value: Distribution) -> str:
    low, high = support(value)
    return f"{low:g}" if low == high else f"{low:g} … {high:g}"
