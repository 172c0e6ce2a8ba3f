"""Materials: the parameters by which a surface scatters light; `transport/brdf` evaluates and samples them.

Every model is reciprocal, returns no more light than arrives at any incidence, acts on both sides, and is linear in
its albedo: the BRDF is `albedo` times a function of the other parameters.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from datagen.errors import InputError, shown
from datagen.records.checks import check_number


@dataclass(frozen=True)
class Material:
    """What all materials have: the albedo, the share of arriving light that is scattered (0 to 1)."""

    albedo: float

    def __post_init__(self) -> None:
        self._check("albedo", 0.0, 1.0, "more would create light")

    def _check(self, name: str, low: float, high: float, reason: str) -> None:
        """Raise `InputError` unless the field is a real number in low … high."""
        check_number(type(self).__name__, name, getattr(self, name), low, high, reason)


@dataclass(frozen=True)
class Lambertian(Material):
    """A perfectly diffuse surface: BRDF = albedo / π in every direction, on both sides.

    >>> import datagen as dg
    >>> dg.Lambertian(0.8)
    Lambertian(albedo=0.8)
    >>> dg.Lambertian(1.2)
    Traceback (most recent call last):
    datagen.errors.InputError: Lambertian.albedo = 1.2: must be a number in 0 … 1 (more would create light)
    """


@dataclass(frozen=True)
class SinLobe(Material):
    """The |sin θ| lobe of Scholes & Leach, Sensors 24, 6522 (2024), Fig. 5b, made reciprocal and energy-conserving.

    θ is the azimuth in the plane of the surface (Eq. 5), measured from the projection of `axis` on that plane, so
    that light leaves mostly at right angles to the axis: with the vertical, in a plane parallel to the floor.

        f = (albedo / 2) |sin θ_in| |sin θ_out|,  directional albedo = albedo · |sin θ_in|

    As printed, B = sin θ_out is the light that leaves per solid angle, whatever its incidence: B changes sign, is not
    reciprocal, and does not fall off towards grazing. Here the modulus is taken, the incidence has the same factor,
    and the polar dependence is Lambert's. A reciprocal BRDF that scattered all light at every incidence would scatter
    isotropic light isotropically; a lobe that favours one plane must therefore absorb some: |sin θ_in| is 2/π on
    average. Where an azimuth has no meaning (light along the normal; a normal along the axis, as on a floor) |sin θ|
    takes that mean.

    axis : direction (3,) that the lobe avoids, any length > 0; the vertical by default.
    """

    axis: tuple[float, float, float] = (0.0, 0.0, 1.0)

    def __post_init__(self) -> None:
        super().__post_init__()
        try:
            x, y, z = (float(component) for component in self.axis)
        except (TypeError, ValueError):
            x = y = z = math.nan
        length = math.hypot(x, y, z)
        if not 0.0 < length < math.inf:
            raise InputError(
                f"SinLobe.axis = {shown(self.axis)}: must be three finite numbers, not all 0; use (0, 0, 1)"
            )
        object.__setattr__(self, "axis", (x / length, y / length, z / length))


MAX_PHONG_EXPONENT = 10_000.0


@dataclass(frozen=True)
class Phong(Material):
    """A glossy lobe cosⁿα about the mirror direction (α from it, cut at 90°), and Lambert's law for the rest.

        f = albedo · [ specular · (n + 2)/(2π) · cosⁿα + (1 − specular)/π ]

    The physically based form of Lafortune & Willems, "Using the modified Phong reflectance model for physically based
    rendering", KU Leuven Report CW 197 (1994). The lobe scatters all of its share at normal incidence
    and, if narrow, about cosθ_in of it elsewhere: the price of reciprocity. Exponent 0 is Lambert's law exactly.

    exponent : n, 0 … 10 000. The lobe's half width at half maximum is √(2 ln 2 / n): 15° at n = 20, 0.7° at
        10 000; a narrower lobe is a mirror, whose paths random samples hardly ever meet.
    specular : share of the albedo in the lobe, 0 … 1.

    >>> import datagen as dg
    >>> dg.Phong(0.5, exponent=80, specular=0.3)  # varnish: 30 % near the mirror direction
    Phong(albedo=0.5, exponent=80, specular=0.3)
    """

    exponent: float = 20.0
    specular: float = 1.0

    def __post_init__(self) -> None:
        super().__post_init__()
        self._check("exponent", 0.0, MAX_PHONG_EXPONENT, "narrower lobes are mirrors, which sampling does not meet")
        self._check("specular", 0.0, 1.0, "it is a share of the albedo")


@dataclass(frozen=True)
class OrenNayar(Material):
    """A rough matt surface of Lambertian facets: brighter than Lambert's law back towards the light.

    The energy-preserving Oren–Nayar model of Portsmouth, Kutz & Hill, "EON: A practical energy-preserving rough
    diffuse BRDF", JCGT 14(1) (2025), for white facets and scaled by the albedo: every incidence returns `albedo`
    exactly, where the qualitative model of Oren & Nayar (SIGGRAPH 1994) returns more or less. (Scaling leaves out
    that grey facets lose more between them than white ones do, and keeps the transient linear in the albedo.)

    sigma_rad : standard deviation of the facets' slope angle, 0 … π/2 rad; 0 is Lambert's law, 0.35 (20°) plaster.
    """

    sigma_rad: float = 0.35

    def __post_init__(self) -> None:
        super().__post_init__()
        self._check("sigma_rad", 0.0, math.pi / 2, "radians; facets steeper than that face inward")


MIN_GGX_ROUGHNESS = 0.1


@dataclass(frozen=True)
class GGX(Material):
    """A rough interface of mirror facets: GGX distribution, Smith height-correlated masking, multiple scattering.

        f = albedo · [ F D G / (4 cosθ_in cosθ_out) + f_ms ]

    D: Walter et al., EGSR 2007, with α = roughness²; G: Heitz, JCGT 3(2) (2014); F: Schlick, Comput. Graph. Forum
    13(3) (1994), F = f0 + (1 − f0)(1 − cos)⁵; f_ms gives back what single scattering loses, in the separable form of
    Kulla & Conty (SIGGRAPH 2017 course). With f0 = 1 every incidence returns `albedo`, to 2·10⁻⁴ and never more.

    roughness : 0.1 … 1; the lobe's half width at half maximum is about 1.3 α rad at normal incidence, 0.7° at
        0.1; a narrower lobe is a mirror, whose paths random samples hardly ever meet.
    f0 : Fresnel reflectance at normal incidence, 0 … 1: 1 leaves out Fresnel's law, 0.04 is paint, glass or plastic.
    """

    roughness: float = 0.3
    f0: float = 1.0

    def __post_init__(self) -> None:
        super().__post_init__()
        self._check("roughness", MIN_GGX_ROUGHNESS, 1.0, "smoother is a mirror, which sampling does not meet")
        self._check("f0", 0.0, 1.0, "it is a reflectance")


MAX_ANGLES = 64


@dataclass(frozen=True)
class MeasuredByAngle(Material):
    """A surface whose reflectance was measured by angle, such as `compare(fit=("angles",))` finds it.

        f = albedo / π · g(cosθ_in) g(cosθ_out) / (g_max ḡ),  g = √reflectance,  ḡ = ∫ 2 c g(c) dc

    A laser beside its sensor measures f only back to where light comes from, which is in proportion to the
    `reflectance` at this angle. That f is a product of one factor for each direction is an assumption; it is
    reciprocal, and of light at the cosine c the share albedo · g(c) / g_max leaves again.

    albedo : share of the light that leaves at the incidence where it is largest, 0 … 1.
    reflectance : 2 to 64 numbers ≥ 0, not all 0, of which only the ratios count: f(c, c) at the cosines 0 … 1, evenly
        spaced, from grazing incidence to the normal's. Between them g is linear.

    >>> import datagen as dg
    >>> cloth = dg.MeasuredByAngle(0.4, reflectance=(0.2, 0.3, 0.36, 0.4, 0.4))  # darker where it is seen aslant
    >>> dg.MeasuredByAngle(0.4, reflectance=(0.0, 0.0))
    Traceback (most recent call last):
    datagen.errors.InputError: MeasuredByAngle.reflectance = (0.0, 0.0): must be 2 to 64 numbers ≥ 0, not all 0
    """

    reflectance: tuple[float, ...] = (1.0, 1.0)

    def __post_init__(self) -> None:
        super().__post_init__()
        try:
            values = tuple(float(value) for value in self.reflectance)
        except (TypeError, ValueError):
            values = ()
        usable = all(0.0 <= value < math.inf for value in values) and any(values)
        if not (2 <= len(values) <= MAX_ANGLES and usable):
            raise InputError(
                f"MeasuredByAngle.reflectance = {shown(self.reflectance)}: must be 2 to {MAX_ANGLES} numbers "
                "≥ 0, not all 0"
            )
        object.__setattr__(self, "reflectance", values)


HALF_DEGREE = math.pi / 360
MIN_RETRO_HALF_WIDTH = 1e-3


@dataclass(frozen=True)
class Retroreflector(Material):
    """A lobe about the direction the light came from, as of reflective sheeting, and Lambert's law for the rest.

        f = albedo · [ retro · D(angle between in and out) / max(cosθ_in, cosθ_out) + (1 − retro)/π ]

    D is von Mises and Fisher's density on the sphere, κ exp(κ (cos − 1)) / (2π (1 − e^(−2κ))). Dividing by the larger
    cosine makes it reciprocal and keeps the albedo at most 1: ∫ D cosθ_out / max(…) ≤ ∫ D = 1. For a half width w the
    lobe returns all but some 0.5 w tanθ_in of its share, and about half of it at grazing. (Real sheeting also fades
    beyond an entrance angle of some 40°; that is not modelled.)

    half_width_rad : angle at which D has fallen to half, 0.001 … π/4 rad; half a degree by default.
    retro : share of the albedo in the lobe, 0 … 1.
    """

    half_width_rad: float = HALF_DEGREE
    retro: float = 1.0

    def __post_init__(self) -> None:
        super().__post_init__()
        reason = "radians; narrower is not met by samples, wider is no retroreflector"
        self._check("half_width_rad", MIN_RETRO_HALF_WIDTH, math.pi / 4, reason)
        self._check("retro", 0.0, 1.0, "it is a share of the albedo")
