"""How surfaces of a scene scatter: the key `brdf`, one kind each, with parameters that may be distributions."""

from __future__ import annotations

import math
from typing import Annotated, Literal

import numpy as np
from pydantic import Tag

from datagen.config.base import Settings, tag
from datagen.config.distributions import Distribution, Fraction, draw, within
from datagen.config.scene_kinds import kind_of, unknown_kind
from datagen.records import GGX, Lambertian, Material, OrenNayar, Phong, Retroreflector, SinLobe
from datagen.records.materials import MIN_RETRO_HALF_WIDTH
from scene_library.materials import MATERIALS

Exponent = Annotated[Distribution, within(0, 10_000)]
Roughness = Annotated[Distribution, within(0.1, 1)]
SlopeAngle = Annotated[Distribution, within(0, 90)]
LobeAngle = Annotated[Distribution, within(0.0573, 45)]


class LambertianBrdf(Settings):
    """Perfectly diffuse."""

    kind: Literal["lambertian"] = "lambertian"

    def material(self, albedo: float, rng: np.random.Generator) -> Material:
        return Lambertian(albedo)


class CatalogueBrdf(Settings):
    """The lobe that the catalogue gives for the drawn `material`: glossy (Phong), retroreflecting, or none."""

    kind: Literal["catalogue"] = "catalogue"

    def of(self, name: str, albedo: float) -> Material:
        lobe = MATERIALS[name].brdf
        if lobe.retro > 0:
            return Retroreflector(albedo, retro=lobe.retro)
        if lobe.specular > 0:
            return Phong(albedo, exponent=lobe.exponent, specular=lobe.specular)
        return Lambertian(albedo)


class SinLobeBrdf(Settings):
    """The paper's |sin θ| lobe about the vertical: most light leaves in a plane parallel to the floor."""

    kind: Literal["sin_lobe"] = "sin_lobe"

    def material(self, albedo: float, rng: np.random.Generator) -> Material:
        return SinLobe(albedo)


class PhongBrdf(Settings):
    """A glossy lobe about the mirror direction."""

    kind: Literal["phong"] = "phong"
    exponent: Exponent = 20.0
    """Narrowness of the lobe; 0 is Lambertian."""
    specular: Fraction = 1.0
    """Share of the albedo in the lobe, the rest is diffuse."""

    def material(self, albedo: float, rng: np.random.Generator) -> Material:
        return Phong(albedo, exponent=draw(self.exponent, rng), specular=draw(self.specular, rng))


class OrenNayarBrdf(Settings):
    """A rough matt surface."""

    kind: Literal["oren_nayar"] = "oren_nayar"
    sigma_deg: SlopeAngle = 20.0
    """Standard deviation of the facets' slope angle; 0 is Lambertian."""

    def material(self, albedo: float, rng: np.random.Generator) -> Material:
        return OrenNayar(albedo, sigma_rad=math.radians(draw(self.sigma_deg, rng)))


class GGXBrdf(Settings):
    """A rough interface of mirror facets: metal (f0 = 1) or paint, glass, plastic (f0 = 0.04)."""

    kind: Literal["ggx"] = "ggx"
    roughness: Roughness = 0.3
    """0.1 (glossy) to 1 (matt)."""
    f0: Fraction = 1.0
    """Fresnel reflectance at normal incidence."""

    def material(self, albedo: float, rng: np.random.Generator) -> Material:
        return GGX(albedo, roughness=draw(self.roughness, rng), f0=draw(self.f0, rng))


class RetroreflectorBrdf(Settings):
    """Reflective sheeting: a narrow lobe back towards the light."""

    kind: Literal["retroreflector"] = "retroreflector"
    half_width_deg: LobeAngle = 0.5
    """Angle from the direction of the light at which the lobe has fallen to half."""
    retro: Fraction = 1.0
    """Share of the albedo in the lobe, the rest is diffuse."""

    def material(self, albedo: float, rng: np.random.Generator) -> Material:
        width = max(math.radians(draw(self.half_width_deg, rng)), MIN_RETRO_HALF_WIDTH)
        return Retroreflector(albedo, half_width_rad=width, retro=draw(self.retro, rng))


_KINDS = ("lambertian", "catalogue", "sin_lobe", "phong", "oren_nayar", "ggx", "retroreflector")
BrdfSettings = Annotated[
    Annotated[LambertianBrdf, Tag(tag("lambertian"))]
    | Annotated[CatalogueBrdf, Tag(tag("catalogue"))]
    | Annotated[SinLobeBrdf, Tag(tag("sin_lobe"))]
    | Annotated[PhongBrdf, Tag(tag("phong"))]
    | Annotated[OrenNayarBrdf, Tag(tag("oren_nayar"))]
    | Annotated[GGXBrdf, Tag(tag("ggx"))]
    | Annotated[RetroreflectorBrdf, Tag(tag("retroreflector"))]
    | Annotated[LambertianBrdf, *unknown_kind(*_KINDS)],
    kind_of(*_KINDS),
]
