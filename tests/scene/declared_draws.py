"""Settings in which every number is declared as a distribution, and how each number drawn should be distributed."""

from __future__ import annotations

import re
from collections import defaultdict
from dataclasses import dataclass
from typing import Any

import numpy as np
from random_specs import mesh_folder
from scipy import stats

from datagen.config import SceneConfig, config_from_mapping
from datagen.config.distributions import (
    Choice,
    Distribution,
    LogUniform,
    Normal,
    Uniform,
    support,
)
from datagen.config.scene_contents import Item
from datagen.config.scene_materials import SurfaceMaterial
from datagen.records import Scene
from scene_library.materials import MATERIALS
from scene_library.objects import classes_of

FAMILIES = 4
BRDFS: tuple[dict[str, Any], ...] = (
    {"kind": "phong", "exponent": (2.0, 60.0), "specular": (0.1, 0.9)},
    {"kind": "oren_nayar", "sigma_deg": (5.0, 50.0)},
    {"kind": "ggx", "roughness": (0.15, 0.9), "f0": (0.1, 0.9)},
    {"kind": "retroreflector", "half_width_deg": (0.5, 10.0), "retro": (0.1, 0.9)},
)


def declared_spec(kind: str, family: int) -> SceneConfig:
    """Settings of one layout with every number declared; `family` turns which distribution which number gets.

    The ranges are those of the defaults, and the objects few and small, so that (nearly) every room can be furnished.
    """
    turn = iter(range(family, 10_000))

    def ranged(low: float, high: float) -> dict[str, Any]:
        match next(turn) % FAMILIES:
            case 0:
                return {"uniform": [low, high]}
            case 1 if low > 0:
                return {"log_uniform": [low, high]}
            case 2:
                return {"normal": {"mean": low, "std": (high - low) / 2, "low": low, "high": high}}
            case 3:
                return {"choice": [low, 0.3 * low + 0.7 * high, high], "weights": [2, 1, 5]}
        return {"uniform": [low, (low + high) / 2]}

    def brdf(number: int) -> dict[str, Any]:
        chosen = BRDFS[(number + family) % len(BRDFS)]
        return {key: value if key == "kind" else ranged(*value) for key, value in chosen.items()}

    counts: list[Any] = [
        {"uniform": [0, 2]},
        {"choice": [0, 1, 2], "weights": [1, 3, 2]},
        {"normal": {"mean": 1, "std": 0.8, "low": 0, "high": 2}},
    ]
    closed = kind != "isolated_wall"
    small = {"height_m": (0.15, 0.3), "elevation_m": (0.05, 0.5), "rotation_deg": (-90.0, 200.0)}
    names = ["white_painted_plaster", "pine_wood", "light_skin", "fresh_snow", "black_rubber", "retroreflective_sign"]
    assert set(names) <= set(MATERIALS), "materials named that are not in the catalogue"
    items: list[dict[str, Any]] = [
        {"kind": "pillar", "width_m": (0.05, 0.15), "depth_m": (0.04, 0.2), "rotation_deg": (0.0, 180.0)},
        {"kind": "box", "width_m": (0.05, 0.2), "depth_m": (0.06, 0.2), **small},
        {"kind": "library", "classes": ["digits", "sphere", "chair"], **small, "placement": "hanging"},
        {"kind": "mesh_folder", "path": "meshes", **small},
        {"kind": "mesh", "path": "meshes/hat/hat.ply", **small, "placement": "wall" if closed else "floor"},
    ]
    for i, item in enumerate(items):
        for key, value in item.items():
            if isinstance(value, tuple):
                item[key] = ranged(*value)
        item |= {"name": f"item{i}", "count": counts[(i + family) % 3]}
        item |= {"brdf": brdf(i)} | ({"material": names} if i % 2 else {"albedo": ranged(0.1, 0.9)})
    default = config_from_mapping({"scene": {"layout": {"kind": kind}}}).scene.layout
    layout: dict[str, Any] = {name: ranged(*support(d)) for name, d in default.dimensions().items()}
    layout["relay_wall"] = {
        # Uneven walls take many triangles: half of the families are enough.
        "kind": "corrugated" if family % 2 else "flat",
        "relief_m": ranged(0.01, 0.05),
        "length_m": ranged(1.0, 2.0),
    }
    if closed:
        layout["out_of_square_deg"] = ranged(-1.0, 2.0)
    parts = ("relay_wall", "walls", "floor", "ceiling", "screen")
    surfaces = {part: {"albedo": ranged(0.2, 0.9), "brdf": brdf(k)} for k, part in enumerate(parts)}
    scene = {
        "layout": {"kind": kind, **layout},
        "contents": items,
        "materials": surfaces,
        "wavelength_nm": 905,
        "clearance_m": 0.005,
        "minimum_seen": 0.0,
    }
    return config_from_mapping({"scene": scene}, base_directory=mesh_folder()).scene


@dataclass(frozen=True)
class Draws:
    """All values of one declared parameter: of a distribution, or categories with their probabilities."""

    values: list[Any]
    declared: Distribution | dict[Any, float]

    def p_value(self) -> float:
        """Probability of a departure at least as large: Kolmogorov–Smirnov, or χ² of categories."""
        if isinstance(self.declared, dict):
            return _chi_square(self.values, self.declared)
        if isinstance(self.declared, Choice):
            weights = self.declared.weights or (1.0,) * len(self.declared.choice)
            return _chi_square(
                self.values, dict(zip(self.declared.choice, np.divide(weights, sum(weights)), strict=True))
            )
        return float(stats.kstest(self.values, law_of(self.declared).cdf).pvalue)


def _shares(declared: Choice) -> dict[float, float]:
    weights = declared.weights or (1.0,) * len(declared.choice)
    return {value: w / sum(weights) for value, w in zip(declared.choice, weights, strict=True)}


def _chi_square(values: list[Any], probabilities: dict[Any, float]) -> float:
    keys = list(probabilities)
    if values and isinstance(values[0], float):
        counts = [sum(abs(v - key) < 1e-9 * (1 + abs(key)) for v in values) for key in keys]
    else:
        counts = [values.count(key) for key in keys]
    if sum(counts) != len(values):
        return 0.0
    return float(stats.chisquare(counts, np.array(list(probabilities.values())) * len(values)).pvalue)


def law_of(declared: Distribution) -> Any:
    """The distribution as scipy has it, which shares no code with the one that draws."""
    match declared:
        case Uniform(uniform=(low, high)):
            return stats.uniform(low, high - low)
        case LogUniform(log_uniform=(low, high)):
            return stats.loguniform(low, high)
        case Normal(normal=n):
            return stats.truncnorm((n.low - n.mean) / n.std, (n.high - n.mean) / n.std, n.mean, n.std)
    raise TypeError(f"{declared!r} is not continuous")


def count_law(declared: Distribution) -> dict[int, float]:
    """Probabilities of whole numbers: a normal distribution is rounded, a uniform one covers its ends."""
    low, high = (int(bound) for bound in support(declared))
    numbers = range(low, high + 1)
    match declared:
        case Uniform():
            return dict.fromkeys(numbers, 1 / len(numbers))
        case Choice():
            return {int(n): share for n, share in _shares(declared).items()}
    law = law_of(declared)
    return {n: float(law.cdf(n + 0.5) - law.cdf(n - 0.5)) for n in numbers}


def draws_of(spec: SceneConfig, scenes: list[Scene]) -> dict[str, Draws]:
    """Parameter → everything drawn for it, over all scenes and all objects of one kind."""
    values: dict[str, list[Any]] = defaultdict(list)
    declared: dict[str, Distribution | dict[Any, float]] = {}
    for scene in scenes:
        p = scene.parameters
        for name, distribution in spec.layout.dimensions().items():
            _note(values, declared, f"layout.{name}", p[f"layout.{name}"], distribution)
        _note(values, declared, "layout.turn", p["layout.turn"], {"left": 0.5, "right": 0.5})
        for key in (k for k in p if re.fullmatch(r"layout\.wall_\d+_turned_deg", k)):
            # The wall on the relay wall's line is never turned.
            if p[key] != 0:
                _note(values, declared, "layout.out_of_square_deg", p[key], spec.layout.out_of_square_deg)  # type: ignore[union-attr]
        for key in ("relief_m", "length_m") if "relay_wall.kind" in p else ():
            _note(values, declared, f"relay_wall.{key}", p[f"relay_wall.{key}"], getattr(spec.layout.relay_wall, key))
        for name, role in zip(scene.part_names, scene.roles, strict=True):
            if role != "object":
                _note_surface(values, declared, name, getattr(spec.materials, name), name, spec.wavelength_nm, p)
        for item in spec.contents:
            parts = [n for n in scene.part_names if re.fullmatch(rf"{item.name}(_\d+)?", n)]
            _note(values, declared, f"{item.name}.count", len(parts), count_law(item.count))
            for name in parts:
                _note_item(values, declared, item, name, spec.wavelength_nm, p)
    return {key: Draws(values[key], declared[key]) for key in values}


def _note(values: Any, declared: Any, key: str, value: Any, distribution: Any) -> None:
    if not isinstance(distribution, float):
        values[key].append(value)
        declared[key] = distribution


def _note_item(values: Any, declared: Any, item: Item, name: str, wavelength_nm: float, p: Any) -> None:
    for key in (*item.sizes, "rotation_deg", "elevation_m"):
        asked = getattr(item, key, None)
        against_a_wall = key == "rotation_deg" and p.get(f"{name}.placement") == "wall"
        if asked is not None and not against_a_wall:
            _note(values, declared, f"{item.name}.{key}", p[f"{name}.{key}"], asked)
    match item.kind:  # type: ignore[attr-defined]
        case "library":
            classes = classes_of(item.classes)  # type: ignore[attr-defined]
            _note(
                values, declared, f"{item.name}.class", p[f"{name}.class"], dict.fromkeys(classes, 1 / len(classes))
            )
        case "mesh_folder":
            files = item.files()  # type: ignore[attr-defined]
            _note(values, declared, f"{item.name}.class", p[f"{name}.class"], dict.fromkeys(files, 1 / len(files)))
    _note_surface(values, declared, str(item.name), item, name, wavelength_nm, p)


def _note_surface(
    values: Any, declared: Any, key: str, surface: SurfaceMaterial, name: str, wavelength_nm: float, p: Any
) -> None:
    if surface.material:
        material = MATERIALS[p[f"{name}.material"]]
        names = dict.fromkeys(surface.material, 1 / len(surface.material))
        _note(values, declared, f"{key}.material", material.name, names)
        middle = material.albedo(wavelength_nm)
        tint = (p[f"{name}.albedo"] - middle) / material.spread
        assert 0 < p[f"{name}.albedo"] < 1, f"{material.name}: its spread is cut off, and its tint unknown"
        _note(values, declared, f"{key}.tint", tint, Uniform(uniform=(-1.0, 1.0)))
    else:
        _note(values, declared, f"{key}.albedo", p[f"{name}.albedo"], surface.albedo)
    for field in type(surface.brdf).model_fields:
        if field != "kind":
            stored = p[f"{name}.{field.replace('_deg', '_rad')}"]
            drawn = float(np.degrees(stored)) if field.endswith("_deg") else stored
            _note(values, declared, f"{key}.brdf.{field}", drawn, getattr(surface.brdf, field))
