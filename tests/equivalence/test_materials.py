"""Surfaces that are not Lambertian: every BRDF is what its source prints, and what follows from that for transients.

The light that a model loses to multiple scattering is integrated numerically; that every way of computing transients
uses these BRDFs is the subject of `test_all_ways.py`.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from lobe_sphere import about, row_of, values_along
from numpy.typing import NDArray
from rooms import bins_of_path, furnished_box, one_point_capture, rectangle, square_pixels
from scipy import stats

from datagen import (
    GGX,
    Accuracy,
    Capture,
    Lambertian,
    Laser,
    MeasuredByAngle,
    OrenNayar,
    Part,
    Phong,
    Retroreflector,
    Scene,
    Sensor,
    SinLobe,
    simulate,
)
from datagen.records import Material
from datagen.transport.brdf import MODELS

Vectors = NDArray[np.float64]
Brdf = Callable[[Vectors, Vectors, Vectors], NDArray[np.float64]]
DEVICE = np.array([1.5, 0.1, 1.3])
HALF_SIDE = 1e-3
APERTURE_M2 = np.pi * 0.02**2


def dots(a: Vectors, b: Vectors) -> NDArray[np.float64]:
    return np.einsum("ij,ij->i", a, b)


def printed_phong(albedo: float, exponent: float, specular: float) -> Brdf:
    """Lafortune & Willems (1994)."""

    def f(n: Vectors, w_in: Vectors, w_out: Vectors) -> NDArray[np.float64]:
        mirror = 2 * dots(n, w_in)[:, None] * n - w_in
        lobe = (exponent + 2) / (2 * np.pi) * np.maximum(dots(mirror, w_out), 0) ** exponent
        return albedo * (specular * lobe + (1 - specular) / np.pi)

    return f


def with_what_is_lost(albedo: float, single: Brdf) -> Brdf:
    """The BRDF with (1 − E)(1 − E)/(π (1 − Ē)) added, where E and Ē of a white `single` come from numerical
    integrals."""
    cosines = np.linspace(0, 1, 61) ** 2
    theta = (np.arange(600) + 0.5) / 600 * np.pi / 2
    # Half of the directions: the other half is their mirror image in the plane of incidence.
    phi = (np.arange(150) + 0.5) / 150 * np.pi
    t, p = (g.ravel() for g in np.meshgrid(theta, phi, indexing="ij"))
    out = np.stack([np.sin(t) * np.cos(p), np.sin(t) * np.sin(p), np.cos(t)], axis=1)
    area = np.sin(t) * (np.pi / 2 / 600) * (2 * np.pi / 150) * out[:, 2]
    up = np.tile([0.0, 0.0, 1.0], (len(out), 1))
    returned = np.empty(len(cosines))
    for i, c in enumerate(np.maximum(cosines, 1e-6)):
        w_in = np.tile([math.sqrt(1 - c * c), 0.0, c], (len(out), 1))
        returned[i] = (single(up, w_in, out) * area).sum()
    fine = (np.arange(20_000) + 0.5) / 20_000
    mean = (2 * fine * np.interp(fine, cosines, returned)).mean()

    def f(n: Vectors, w_in: Vectors, w_out: Vectors) -> NDArray[np.float64]:
        lost = [1 - np.interp(dots(n, w), cosines, returned) for w in (w_in, w_out)]
        return albedo * (single(n, w_in, w_out) + lost[0] * lost[1] / (np.pi * (1 - mean)))

    return f


def printed_oren_nayar(albedo: float, sigma: float) -> Brdf:
    """Single scattering of Portsmouth et al. (2025), A and B in the proportion of Oren & Nayar (1994), Eq. 30."""
    a, b = 1 - 0.5 * sigma**2 / (sigma**2 + 0.33), 0.45 * sigma**2 / (sigma**2 + 0.09)
    scale = 1 / (1 + (0.5 - 2 / (3 * np.pi)) * b / a)

    def single(n: Vectors, w_in: Vectors, w_out: Vectors) -> NDArray[np.float64]:
        c_in, c_out = dots(n, w_in), dots(n, w_out)
        s = dots(w_in, w_out) - c_in * c_out
        return scale / np.pi * (1 + b / a * np.where(s > 0, s / np.maximum(c_in, c_out), s))

    return with_what_is_lost(albedo, single)


def printed_ggx(albedo: float, roughness: float) -> Brdf:
    """D of Walter et al. (2007), Eq. 33; Λ and the height-correlated G₂ of Heitz (2014), Eq. 72 and 99."""
    alpha = roughness**2

    def lam(c: NDArray[np.float64]) -> NDArray[np.float64]:
        return (-1 + np.sqrt(1 + alpha**2 * (1 - c**2) / c**2)) / 2

    def single(n: Vectors, w_in: Vectors, w_out: Vectors) -> NDArray[np.float64]:
        h = w_in + w_out
        h /= np.linalg.norm(h, axis=1, keepdims=True)
        c_in, c_out, c_h = dots(n, w_in), dots(n, w_out), dots(n, h)
        tan2 = (1 - c_h**2) / c_h**2
        d = alpha**2 / (np.pi * c_h**4 * (alpha**2 + tan2) ** 2)
        return d / (1 + lam(c_in) + lam(c_out)) / (4 * c_in * c_out)

    return with_what_is_lost(albedo, single)


def printed_retroreflector(albedo: float, half_width: float) -> Brdf:
    kappa = math.log(2) / (1 - math.cos(half_width))

    def f(n: Vectors, w_in: Vectors, w_out: Vectors) -> NDArray[np.float64]:
        lobe = kappa / (2 * np.pi) * np.exp(-kappa * np.sum((w_in - w_out) ** 2, axis=1) / 2)
        return albedo * lobe / np.maximum(dots(n, w_in), dots(n, w_out))

    return f


def printed_lambertian(albedo: float) -> Brdf:
    return lambda n, w_in, w_out: np.full(len(n), albedo / np.pi)


def printed_sin_lobe(albedo: float, axis: tuple[float, float, float]) -> Brdf:
    """Scholes & Leach (2024), Eq. 5, with the modulus and the same factor at the incidence."""

    def sine(n: Vectors, w: Vectors) -> NDArray[np.float64]:
        along, across = (v - dots(v, n)[:, None] * n for v in (np.tile(axis, (len(n), 1)), w))
        cosine = dots(along, across) / np.linalg.norm(along, axis=1) / np.linalg.norm(across, axis=1)
        return np.sqrt(np.maximum(1 - cosine**2, 0))

    return lambda n, w_in, w_out: albedo / 2 * sine(n, w_in) * sine(n, w_out)


def printed_by_angle(albedo: float, reflectance: tuple[float, ...]) -> Brdf:
    """Back to the light in proportion to the table, and the largest directional albedo by a numerical integral."""
    cosines = np.linspace(0, 1, len(reflectance))
    fine = (np.arange(100_000) + 0.5) / 100_000

    def root(c: NDArray[np.float64]) -> NDArray[np.float64]:
        return np.interp(c, cosines, np.sqrt(reflectance))

    most = max(root(fine)) * (2 * np.pi * fine * root(fine)).mean()
    return lambda n, w_in, w_out: albedo * root(dots(n, w_in)) * root(dots(n, w_out)) / most


PRINTED: list[tuple[Material, Brdf]] = [
    (Lambertian(0.8), printed_lambertian(0.8)),
    (SinLobe(0.8, (0.3, 0.1, 1.0)), printed_sin_lobe(0.8, (0.3, 0.1, 1.0))),
    (Phong(0.8, exponent=60, specular=0.4), printed_phong(0.8, 60, 0.4)),
    (OrenNayar(0.8, sigma_rad=0.5), printed_oren_nayar(0.8, 0.5)),
    (GGX(0.9, roughness=0.4), printed_ggx(0.9, 0.4)),
    (GGX(0.9, roughness=0.8), printed_ggx(0.9, 0.8)),
    (Retroreflector(0.8, half_width_rad=0.3), printed_retroreflector(0.8, 0.3)),
    (MeasuredByAngle(0.8, reflectance=(0.1, 0.2, 0.6, 0.5)), printed_by_angle(0.8, (0.1, 0.2, 0.6, 0.5))),
]


def test_every_brdf_is_compared_with_its_source() -> None:
    assert {type(material) for material, _ in PRINTED} == {model.record for model in MODELS}


@pytest.mark.parametrize(
    ("material", "printed"),
    PRINTED,
    ids=lambda value: str(value) if isinstance(value, Material) else "printed",
)
def test_a_brdf_is_what_its_source_prints(material: Material, printed: Brdf) -> None:
    """At random pairs of directions, a third about the mirror direction and a third about the incoming one; not at
    grazing, where the numerical integrals of what is lost are coarse."""
    rng, count = np.random.default_rng(4), 3000
    n = np.array([-0.6, 0.64, -0.48])
    w_in, w_out = (about(n, rng.uniform(0, 0.8, count), rng.uniform(0, 2 * np.pi, count)) for _ in range(2))
    near = 0.2 * rng.normal(size=(count // 3, 3))
    w_out[: count // 3] = 2 * (w_in[: count // 3] @ n)[:, None] * n - w_in[: count // 3] + near
    w_out[-count // 3 :] = w_in[-count // 3 :] + near
    w_out /= np.linalg.norm(w_out, axis=1, keepdims=True)
    above = w_out @ n > 0.2
    w_in, w_out = w_in[above], w_out[above]
    found, _ = values_along(*row_of(material), n, w_in, w_out)
    np.testing.assert_allclose(found, printed(np.tile(n, (len(w_in), 1)), w_in, w_out), rtol=2e-3)


def furnished_with(**materials: Material) -> Scene:
    room = furnished_box()
    return replace(
        room, materials=tuple(materials.get(n, m) for n, m in zip(room.part_names, room.materials, strict=True))
    )


def test_reciprocity_of_the_transient() -> None:
    """Swapping laser point and FoV point changes neither three nor four bounces, with hardly a Lambertian surface in
    the room."""
    scene = furnished_with(
        relay_wall=Phong(0.8, 8, 0.5), box=GGX(0.9, 0.35, f0=0.5), pillar=OrenNayar(0.8, 0.6),
        floor=Phong(0.7, 30, 0.6), walls=GGX(0.8, 0.7),
    )  # fmt: skip
    a, b = np.array([0, -0.8, 1.4]), np.array([0, 0.5, 0.9])
    there, back = (
        simulate(scene, one_point_capture(p, q, HALF_SIDE), Accuracy(samples=1 << 16, max_bounces=4), seed=s)
        for p, q, s in ((a, b, 1), (b, a, 2))
    )
    solid = [(DEVICE - p)[0] / np.linalg.norm(DEVICE - p) ** 3 for p in (b, a)]
    for name in ("primary", "secondary"):
        pair = [r.components[name].sum() / s for r, s in zip((there, back), solid, strict=True)]
        assert pair[0] == pytest.approx(pair[1], rel=1e-2, abs=0), name
    e = [r.total[0, 0] / s for r, s in zip((there, back), solid, strict=True)]
    sigma = np.hypot(there.stderr[0, 0] / solid[0], back.stderr[0, 0] / solid[1])
    filled = e[0] > 1e-3 * e[0].max()
    # Two estimates of 16 replicates each: about 30 degrees of freedom, Bonferroni over the bins at 10⁻³.
    assert (np.abs(e[0] - e[1])[filled] / sigma[filled]).max() < stats.t.isf(0.5e-3 / filled.sum(), 30)


def scan(
    scene: Scene, points: NDArray[np.float64], half_side: float, device: Vectors = DEVICE
) -> NDArray[np.float64]:
    """(L,) confocal primary energy of the hidden object."""
    pixels, axis = square_pixels(points, half_side), bins_of_path(40, 0.5, -1.0)
    capture = Capture(Laser(device, points), Sensor(device, pixels), axis, "confocal")
    result = simulate(scene, capture, Accuracy(samples=1 << 15, max_bounces=3), seed=3)
    return result.parts["box"][:, 0].sum(axis=1)


def test_retroreflected_light_falls_with_the_square_of_distance_not_its_fourth_power() -> None:
    """A pixel that holds the whole lobe gets all that a small patch a at range R returns (O'Toole, Lindell &
    Wetzstein, Nature 2018): (ρ₁/π) a/R² · ρ₂ · (ρ₃/π) A/Rₛ², head on; a Lambertian patch sends back R⁻⁴."""
    side, device, ranges = 0.02, np.array([0.4, 0.0, 0.0]), np.array([0.7, 1.4, 2.8])
    returned = {}
    for material in (Retroreflector(0.9), Lambertian(0.9)):
        energies = []
        for distance in ranges:
            patch = rectangle((distance, 0, 0), (0, side / 2, 0), (0, 0, side / 2))
            wall = rectangle((0, 0, 0), (0, 2, 0), (0, 0, 2))
            scene = Scene.from_parts(
                [Part("wall", wall, Lambertian(0.8), "relay_wall"), Part("box", patch, material)]
            )
            energies.append(scan(scene, np.zeros((1, 3)), 0.2, device)[0])
        returned[type(material)] = np.array(energies)
    retro = 0.8 / np.pi * side**2 / ranges**2 * 0.9 * 0.8 / np.pi * APERTURE_M2 / device[0] ** 2
    # The lobe spreads to 4 cm at the far end, over which cosθ₃/Rₛ² from 0.4 m falls by up to some 3 %.
    np.testing.assert_allclose(returned[Retroreflector], retro, rtol=0.04)
    slope = np.polyfit(np.log(ranges), np.log(returned[Retroreflector]), 1)[0]
    assert slope == pytest.approx(-2, abs=0.03)
    diffuse = np.polyfit(np.log(ranges), np.log(returned[Lambertian]), 1)[0]
    assert diffuse == pytest.approx(-4, abs=0.15)
