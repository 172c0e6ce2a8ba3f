"""Random scene settings: every range drawn anew, so that the laws are met by more than the defaults."""

from __future__ import annotations

from typing import Any

import numpy as np

from datagen.config import SceneConfig, config_from_mapping


def _range(rng: np.random.Generator, low: float, high: float) -> dict[str, Any]:
    a, b = sorted(rng.uniform(low, high, 2))
    kind = rng.integers(4)
    if kind == 0:
        return {"uniform": [a, b]}
    if kind == 1 and low > 0:
        return {"log_uniform": [a, b]}
    if kind == 2:
        return {"normal": {"mean": (a + b) / 2, "std": (b - a) / 3 + 1e-3, "low": a, "high": b}}
    return {"choice": [a, b, (a + b) / 2]}


_CORRIDOR = {"relay_distance_m": (5.0, 9.0), "corridor_width_m": (1.0, 2.5), "corridor_behind_m": (0.2, 3.0)}
_DIMENSIONS: dict[str, dict[str, tuple[float, float]]] = {
    "straight_corridor": {
        **_CORRIDOR,
        "corridor_width_m": (3.0, 6.0),
        "device_offset": (0.1, 0.35),
        "partition_distance_m": (1.8, 4.0),
        "partition_reach": (0.45, 0.62),
        "partition_thickness_m": (0.02, 0.3),
    },
    "l_corridor": {**_CORRIDOR, "room_length_m": (2.0, 4.5), "room_width_m": (2.5, 6.0)},
    "t_corridor": {**_CORRIDOR, "arm_width_m": (1.5, 4.0), "left_arm_m": (2.5, 6.0), "right_arm_m": (2.5, 6.0)},
    "z_corridor": {
        **_CORRIDOR,
        "middle_width_m": (1.8, 4.0),
        "middle_length_m": (4.0, 7.0),
        "last_width_m": (1.0, 3.0),
        "last_length_m": (0.5, 6.0),
    },
    "corridor_room": {
        **_CORRIDOR,
        "room_length_m": (2.5, 4.5),
        "room_width_m": (5.0, 9.0),
        "opening_offset": (0.0, 1.0),
    },
    "doorway_room": {
        "relay_distance_m": (5.0, 9.0),
        "height_m": (2.4, 4.0),
        "door_width_m": (0.7, 1.4),
        "door_height_m": (2.1, 2.3),
        "wall_thickness_m": (0.05, 0.5),
        "hall_width_m": (1.5, 5.0),
        "hall_behind_m": (0.2, 3.0),
        "room_length_m": (2.5, 4.5),
        "room_width_m": (4.0, 9.0),
        "opening_offset": (0.0, 1.0),
    },
    "isolated_wall": {
        "relay_distance_m": (3.0, 5.0),
        "wall_width_m": (1.5, 4.0),
        "screen_to_wall_m": (1.5, 2.8),
        "screen_offset_m": (0.1, 0.6),
        "space_width_m": (2.0, 4.0),
    },
}
LAYOUTS = tuple(_DIMENSIONS)


def _layout(rng: np.random.Generator, kind: str) -> dict[str, Any]:
    common = {"height_m": (2.2, 4.0), "device_height_m": (0.3, 2.0), "device_offset": (0.1, 0.9)}
    drawn = {name: _range(rng, *bounds) for name, bounds in (common | _DIMENSIONS[kind]).items()}
    layout = {"kind": kind, "turn": str(rng.choice(["left", "right", "random"])), **drawn}
    if kind != "isolated_wall" and rng.random() < 0.5:
        layout["out_of_square_deg"] = _range(rng, -4.0, 4.0)
    return layout


def _item(rng: np.random.Generator, walls: bool) -> dict[str, Any]:
    kind = str(rng.choice(["pillar", "box", "library"], p=[0.3, 0.4, 0.3]))
    if kind == "library":
        group = str(rng.choice(["household", "figures", "shapes", "letters", "digits", "chair", "shelf"]))
        placement = str(rng.choice(["floor", "wall", "hanging"] if walls else ["floor", "hanging"]))
        return {"kind": kind, "classes": [group], "height_m": _range(rng, 0.3, 0.8), "placement": placement}
    item = {"kind": kind, "count": int(rng.integers(1, 3)), "albedo": _range(rng, 0.0, 1.0)}
    item["width_m"] = _range(rng, 0.1, 0.6)
    if kind == "pillar":
        item["shape"] = str(rng.choice(["square", "round"]))
    if rng.random() < 0.7 or kind == "box":
        item["depth_m"] = _range(rng, 0.1, 0.6)
    if kind == "box":
        item["height_m"] = _range(rng, 0.1, 1.0)
        if rng.random() < 0.3:
            item |= {"elevation_m": _range(rng, 0.0, 0.8), "placement": str(rng.choice(["floor", "hanging"]))}
    return item


def random_spec(rng: np.random.Generator, kind: str) -> SceneConfig:
    contents = [_item(rng, kind != "isolated_wall") for _ in range(int(rng.integers(1, 4)))]
    materials = {name: {"albedo": _range(rng, 0.0, 1.0)} for name in ("relay_wall", "walls", "floor", "ceiling")}
    clearance = float(rng.choice([0.001, 0.02, 0.1]))
    scene = {"layout": _layout(rng, kind), "contents": contents, "materials": materials, "clearance_m": clearance}
    return config_from_mapping({"scene": scene}).scene
