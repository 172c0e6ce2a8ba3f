"""Materials of every kind of BRDF, from which every test of all of them takes its own: a new kind is a row here.

`tests/physics/test_brdf.py` fails where a kind of `datagen/transport/brdf/table.py` has no row.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, Literal

from datagen import GGX, Lambertian, MeasuredByAngle, OrenNayar, Phong, Retroreflector, SinLobe
from datagen.records import Material
from datagen.transport.brdf.retroreflector import concentration


@dataclass(frozen=True)
class Kind:
    """A kind of BRDF as tests see it.

    laws : materials over the whole range of the parameters, each held to every law of a BRDF, and fuzzed.
    broad : materials by name, with lobes so wide that uniform directions meet them; on these, light by every way is
        compared with its definition.
    highest : a bound of f cosθ_out of a material, 1/sr and over its albedo, at any pair of directions.
    read : a material of albedo 0.6, and the keys of a configuration that give it.
    keys : every such key that takes a number, with a range of values that are allowed.
    matt : materials that are Lambert's law.
    axis : direction about which `lobe_sphere.py` lays out its cells: that of the lobe, or the normal.
    """

    laws: tuple[Material, ...]
    broad: dict[str, Material]
    highest: Callable[[Any], float]
    read: tuple[Material, dict[str, Any]]
    keys: dict[str, tuple[float, float]] = field(default_factory=dict)
    matt: tuple[Material, ...] = ()
    axis: Literal["normal", "mirror", "incoming"] = "normal"

    @property
    def record(self) -> type[Material]:
        """The class of its materials."""
        return type(self.laws[0])


KINDS: dict[str, Kind] = {
    "lambertian": Kind(
        (Lambertian(0.6),),
        {"lambertian 0.2": Lambertian(0.2), "lambertian 0.6": Lambertian(0.6), "lambertian 1": Lambertian(1.0)},
        lambda material: 1 / math.pi,
        (Lambertian(0.6), {}),
    ),
    "oren_nayar": Kind(
        (OrenNayar(0.7, sigma_rad=0.35), OrenNayar(1.0, sigma_rad=math.pi / 2)),
        {f"oren-nayar {sigma}": OrenNayar(0.6, sigma_rad=sigma) for sigma in (0.2, 0.5, 1.2)},
        lambda material: 4 / math.pi,
        (OrenNayar(0.6, sigma_rad=math.radians(20)), {"sigma_deg": 20}),
        {"sigma_deg": (0.0, 60.0)},
        (OrenNayar(0.4, 0.0),),
    ),
    "phong": Kind(
        (Phong(0.5, exponent=20), Phong(1.0, exponent=1.5), Phong(0.7, exponent=300, specular=0.4),
         Phong(1.0, exponent=10_000)),
        {"phong 2": Phong(0.6, exponent=2.0), "phong 10": Phong(0.6, exponent=10.0, specular=0.6),
         "phong 60": Phong(0.6, exponent=60.0)},
        lambda material: (material.exponent + 2) / (2 * math.pi) + 1 / math.pi,
        (Phong(0.6, exponent=30, specular=0.4), {"exponent": 30, "specular": 0.4}),
        {"exponent": (0.0, 200.0), "specular": (0.0, 1.0)},
        (Phong(0.4, exponent=0), Phong(0.4, 50, specular=0)),
        "mirror",
    ),
    "ggx": Kind(
        (GGX(0.8, roughness=0.1), GGX(1.0, roughness=0.3), GGX(1.0, roughness=1.0), GGX(0.9, roughness=0.4, f0=0.04)),
        {"ggx 1": GGX(0.6, roughness=1.0), "ggx 0.6": GGX(0.6, roughness=0.6, f0=0.2),
         "ggx 0.4": GGX(0.6, roughness=0.4)},
        # D ≤ 1/(π α²), and with Smith's masking G/(4 cos_in) ≤ 1/(2 α).
        lambda material: 1 / (2 * math.pi * material.roughness**6) + 4 / math.pi,
        (GGX(0.6, roughness=0.3, f0=0.04), {"roughness": 0.3, "f0": 0.04}),
        {"roughness": (0.1, 1.0), "f0": (0.0, 1.0)},
    ),
    "retroreflector": Kind(
        (Retroreflector(1.0), Retroreflector(0.8, half_width_rad=0.3),
         Retroreflector(0.6, half_width_rad=0.02, retro=0.3), Retroreflector(0.9, half_width_rad=0.001),
         Retroreflector(0.9, half_width_rad=math.pi / 4)),
        {"retroreflector 0.4": Retroreflector(0.6, half_width_rad=0.4),
         "retroreflector 0.2": Retroreflector(0.6, half_width_rad=0.2, retro=0.5),
         "retroreflector 0.12": Retroreflector(0.6, half_width_rad=0.12)},
        lambda material: _von_mises_fisher_peak(material.half_width_rad) + 1 / math.pi,
        (Retroreflector(0.6, half_width_rad=math.radians(1), retro=0.8), {"half_width_deg": 1.0, "retro": 0.8}),
        {"half_width_deg": (0.1, 20.0), "retro": (0.0, 1.0)},
        (Retroreflector(0.4, retro=0),),
        "incoming",
    ),
    "sin_lobe": Kind(
        (SinLobe(0.8), SinLobe(1.0, axis=(1.0, 0.3, -0.2))),
        {"sin lobe x": SinLobe(0.6, axis=(1.0, 0.0, 0.0)), "sin lobe z": SinLobe(0.6, axis=(0.0, 0.0, 1.0)),
         "sin lobe xyz": SinLobe(0.6, axis=(1.0, 1.0, 1.0))},
        lambda material: 0.5,
        (SinLobe(0.6), {}),
    ),
    "measured_by_angle": Kind(
        (MeasuredByAngle(0.7, reflectance=(0.2, 0.3, 0.35, 0.5, 0.6)), MeasuredByAngle(1.0, reflectance=(3.0, 1.0)),
         MeasuredByAngle(1.0, reflectance=(0.0, 0.4, 0.0, 0.0, 1.0, 0.2)),
         MeasuredByAngle(0.9, reflectance=(1.0, 0.0, 0.0, 0.0))),
        {"by angle, darker aslant": MeasuredByAngle(0.6, reflectance=(0.1, 0.3, 0.5)),
         "by angle, brighter aslant": MeasuredByAngle(0.6, reflectance=(0.9, 0.5, 0.4, 0.3, 0.3)),
         "by angle, a peak": MeasuredByAngle(0.6, reflectance=(0.0, 0.1, 0.6, 0.1, 0.2))},
        # f cosθ_out ≤ g_max / (π ḡ), and ḡ is least where g falls from 1 at grazing to 0 over the first third.
        lambda material: 27 / math.pi,
        (MeasuredByAngle(0.6, reflectance=(0.3, 0.5, 0.6)), {"reflectance": [0.3, 0.5, 0.6]}),
        matt=(MeasuredByAngle(0.4), MeasuredByAngle(0.4, reflectance=(2.0, 2.0, 2.0))),
    ),
}  # fmt: skip
"""By their names in a configuration."""

LAWS = tuple(material for kind in KINDS.values() for material in kind.laws)
BROAD = {name: material for kind in KINDS.values() for name, material in kind.broad.items()}


def kind_of(material: Material) -> Kind:
    """The row of a material's kind."""
    return next(kind for kind in KINDS.values() if kind.record is type(material))


def _von_mises_fisher_peak(half_width_rad: float) -> float:
    kappa = concentration(half_width_rad)
    return kappa / (2 * math.pi * -math.expm1(-2 * kappa))
