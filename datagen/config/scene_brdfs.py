"""How surfaces of a scene scatter: the key `brdf`, one kind each, with parameters that may be distributions."""

from __future__ import annotations

import math
from typing import Annotated, ClassVar, Literal

import numpy as np
from pydantic import AfterValidator, Field

from datagen.config.base import Settings
from datagen.config.distributions import Distribution, Fraction, draw, within
from datagen.errors import InputError
from datagen.records import GGX, Lambertian, Material, MeasuredByAngle, OrenNayar, Phong, Retroreflector, SinLobe
from scene_library.materials import MATERIALS


class _Brdf(Settings):
    """A kind of material, its parameters named as those of its record, angles in degrees."""

    record: ClassVar[type[Material]]

    def material(self, albedo: float, rng: np.random.Generator) -> Material:
        """The material, its parameters drawn in the order in which they are declared."""
        drawn = {key: draw(getattr(self, key), rng) for key in type(self).model_fields if key != "kind"}
        radians = {key.replace("_deg", "_rad"): math.radians(drawn.pop(key)) for key in [*drawn] if "_deg" in key}
        return self.record(albedo, **drawn, **radians)


class LambertianBrdf(_Brdf):
    """Perfectly diffuse."""

    record = Lambertian
    kind: Literal["lambertian"] = "lambertian"


class CatalogueBrdf(Settings):
    """The lobe that the catalogue gives for the drawn `material`: glossy (Phong), retroreflecting, or none."""

    kind: Literal["catalogue"] = "catalogue"

    def of(self, name: str, albedo: float) -> Material:
        """The material with the lobe of the catalogue's material `name`."""
        lobe = MATERIALS[name].brdf
        if lobe.retro > 0:
            return Retroreflector(albedo, retro=lobe.retro)
        if lobe.specular > 0:
            return Phong(albedo, exponent=lobe.exponent, specular=lobe.specular)
        return Lambertian(albedo)


class SinLobeBrdf(_Brdf):
    """The paper's |sin θ| lobe about the vertical: most light leaves in a plane parallel to the floor."""

    record = SinLobe
    kind: Literal["sin_lobe"] = "sin_lobe"


class PhongBrdf(_Brdf):
    """A glossy lobe about the mirror direction."""

    record = Phong
    kind: Literal["phong"] = "phong"
    exponent: Annotated[Distribution, within(0, 10_000)] = 20.0
    """Narrowness of the lobe; 0 is Lambertian."""
    specular: Fraction = 1.0
    """Share of the albedo in the lobe, the rest is diffuse."""


class OrenNayarBrdf(_Brdf):
    """A rough matt surface."""

    record = OrenNayar
    kind: Literal["oren_nayar"] = "oren_nayar"
    sigma_deg: Annotated[Distribution, within(0, 90)] = 20.0
    """Standard deviation of the facets' slope angle; 0 is Lambertian."""


class GGXBrdf(_Brdf):
    """A rough interface of mirror facets: metal (f0 = 1) or paint, glass, plastic (f0 = 0.04)."""

    record = GGX
    kind: Literal["ggx"] = "ggx"
    roughness: Annotated[Distribution, within(0.1, 1)] = 0.3
    """0.1 (glossy) to 1 (matt)."""
    f0: Fraction = 1.0
    """Fresnel reflectance at normal incidence."""


class RetroreflectorBrdf(_Brdf):
    """Reflective sheeting: a narrow lobe back towards the light."""

    record = Retroreflector
    kind: Literal["retroreflector"] = "retroreflector"
    half_width_deg: Annotated[Distribution, within(0.0573, 45)] = 0.5
    """Angle from the direction of the light at which the lobe has fallen to half."""
    retro: Fraction = 1.0
    """Share of the albedo in the lobe, the rest is diffuse."""


def _is_table(reflectance: tuple[float, ...]) -> tuple[float, ...]:
    try:
        return MeasuredByAngle(1.0, reflectance).reflectance
    except InputError as error:
        raise ValueError(str(error)) from None


class MeasuredByAngleBrdf(_Brdf):
    """Reflectance by angle as measured, such as `datagen compare --fit angles --materials FILE` finds it."""

    record = MeasuredByAngle
    kind: Literal["measured_by_angle"] = "measured_by_angle"
    reflectance: Annotated[tuple[float, ...], AfterValidator(_is_table)]
    """2 to 64 numbers ≥ 0, not all 0, for evenly spaced cosines from 0, grazing incidence, to 1; only their ratios
    count, since `albedo` says how much light leaves at the angle where it is most."""

    def material(self, albedo: float, rng: np.random.Generator) -> Material:
        """The material; nothing is drawn."""
        return MeasuredByAngle(albedo, self.reflectance)


BrdfSettings = Annotated[
    LambertianBrdf
    | CatalogueBrdf
    | SinLobeBrdf
    | PhongBrdf
    | OrenNayarBrdf
    | GGXBrdf
    | RetroreflectorBrdf
    | MeasuredByAngleBrdf,
    Field(discriminator="kind"),
]
