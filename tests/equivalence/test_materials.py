"""`simulate` with surfaces that are not Lambertian, compared with a plain estimate: a sum over points with printed
formulas.

The plain estimate goes over the triangles in numpy, tests every line of sight against every triangle, and writes each
BRDF as its source prints it; the light that a model loses to multiple scattering is integrated numerically.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from functools import cache, partial

import numpy as np
import pytest
from numpy.typing import NDArray
from rooms import bins_of_path, furnished_box, one_point_capture, rectangle, square_pixels
from scipy import stats

from datagen import (
    GGX,
    Accuracy,
    Capture,
    Lambertian,
    Laser,
    OrenNayar,
    Part,
    Phong,
    Retroreflector,
    Scene,
    Sensor,
    simulate,
)
from datagen.records import Material, TimeAxis
from datagen.units import SPEED_OF_LIGHT_M_PER_S as C

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


def hidden(origin: Vectors, target: Vectors, corners: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Whether any triangle lies strictly between origin and target (n, 3), by Möller & Trumbore's test of all against
    all."""
    blocked = np.zeros(len(target), np.bool_)
    span = target - origin
    for a, b, c in corners:
        e1, e2 = b - a, c - a
        p = np.cross(span, e2)
        det = p @ e1
        with np.errstate(divide="ignore", invalid="ignore"):
            s = origin - a
            u = dots(s, p) / det
            q = np.cross(s, e1)
            v, t = dots(span, q) / det, q @ e2 / det
            blocked |= (u >= 0) & (v >= 0) & (u + v <= 1) & (t > 1e-6) & (t < 1 - 1e-6)
    return blocked


def plain_primary(
    scene: Scene, x1: Vectors, x3: Vectors, axis: TimeAxis, brdfs: dict[str, Brdf], cell_m: float, only: str = ""
) -> dict[str, NDArray[np.float64]]:
    """Primary of a laser point and a tiny pixel on the wall x = 0, by part: midpoints of equal elements, all
    pairs."""
    wall = brdfs["relay_wall"]
    normal_1 = np.array([[1.0, 0, 0]])
    omega = (2 * HALF_SIDE) ** 2 * (DEVICE - x3)[0] / np.linalg.norm(DEVICE - x3) ** 3
    parts = {}
    for part, name in enumerate(scene.part_names):
        histogram = np.zeros(axis.bins)
        for a, b, c in scene.corners[scene.face_part == part] if only in ("", name) and name != "relay_wall" else ():
            k = max(1, math.ceil(max(np.linalg.norm(b - a), np.linalg.norm(c - a)) / cell_m))
            i, j = (g.ravel() for g in np.meshgrid(np.arange(k), np.arange(k)))
            whole, upper = i + j < k, i + j < k - 1
            u = np.concatenate([(i[whole] + 1 / 3) / k, (i[upper] + 2 / 3) / k])[:, None]
            v = np.concatenate([(j[whole] + 1 / 3) / k, (j[upper] + 2 / 3) / k])[:, None]
            x2 = a + u * (b - a) + v * (c - a)
            cross = np.cross(b - a, c - a)
            area, n2 = np.linalg.norm(cross) / 2 / k**2, cross / np.linalg.norm(cross)
            d1, d3 = x1 - x2, x3 - x2
            r1, r3 = np.linalg.norm(d1, axis=1), np.linalg.norm(d3, axis=1)
            w1, w3 = d1 / r1[:, None], d3 / r3[:, None]
            n2 = np.where((w1 @ n2 > 0)[:, None], n2, -n2)
            lit = (dots(n2, w1) > 0) & (dots(n2, w3) > 0)
            lit[lit] = ~hidden(x1[None], x2[lit], scene.corners) & ~hidden(x3[None], x2[lit], scene.corners)
            x2, n2, w1, w3, r1, r3 = (q[lit] for q in (x2, n2, w1, w3, r1, r3))
            n1 = np.repeat(normal_1, len(x2), axis=0)
            to_laser, to_sensor = ((DEVICE - x) / np.linalg.norm(DEVICE - x) + 0 * n1 for x in (x1, x3))
            energy = (
                wall(n1, to_laser, -w1) * dots(n1, -w1) * dots(n2, w1) / r1**2
                * brdfs[name](n2, w1, w3) * dots(n2, w3) * dots(n1, -w3) / r3**2
                * wall(n1, -w3, to_sensor) * APERTURE_M2 * omega * area
            )  # fmt: skip
            position = (r1 + r3) / (axis.width_s * C) - axis.start_s / axis.width_s
            np.add.at(histogram, np.floor(position).astype(int), energy)
        parts[name] = histogram
    return parts


def furnished_with(**materials: Material) -> Scene:
    room = furnished_box()
    return replace(
        room, materials=tuple(materials.get(n, m) for n, m in zip(room.part_names, room.materials, strict=True))
    )


CAPTURE = one_point_capture(half_side_m=HALF_SIDE, time=bins_of_path(110, 0.1, 0.0))


def plain(scene: Scene, brdfs: dict[str, Brdf], only: str = "") -> dict[str, NDArray[np.float64]]:
    x1, x3 = np.array([0, -0.8, 1.4]), np.array([0, 0.4, 1.2])
    return plain_primary(scene, x1, x3, CAPTURE.time, brdfs, 0.02, only)


@cache
def plain_lambertian() -> dict[str, NDArray[np.float64]]:
    scene = furnished_with()
    return plain(scene, {n: printed_lambertian(0.7) for n in scene.part_names})


def compare(scene: Scene, truth: dict[str, NDArray[np.float64]], tolerance: float = 2e-3) -> None:
    """Compare the energy of every part and the shape in bins of 0.1 m with the plain estimate, within the stated
    errors."""
    result = simulate(scene, CAPTURE, Accuracy(1 << 16, 1, 3, 16), seed=7)
    for name in ("box", "pillar", "walls", "floor", "ceiling"):
        measured = result.parts[name][0, 0]
        assert measured.sum() == pytest.approx(truth[name].sum(), rel=3 * tolerance), name
    expected = sum(truth.values())
    total, stderr = result.total[0, 0], result.stderr[0, 0]
    assert total.sum() == pytest.approx(expected.sum(), rel=tolerance)
    assert np.abs(total - expected).sum() / expected.sum() < 10 * tolerance
    # Student's t with 15 degrees, Bonferroni over the bins at 10⁻³; 1 % of a bin is left to the plain quadrature.
    filled = expected > 1e-3 * expected.max()
    excess = np.abs(total - expected)[filled] - 0.01 * expected[filled]
    assert (excess / stderr[filled]).max() < stats.t.isf(0.5e-3 / filled.sum(), 15)


@pytest.mark.parametrize(
    ("material", "printed"),
    [
        (Phong(0.5, exponent=20), partial(printed_phong, 0.5, 20, 1.0)),
        (Phong(0.8, exponent=60, specular=0.4), partial(printed_phong, 0.8, 60, 0.4)),
        (OrenNayar(0.8, sigma_rad=0.5), partial(printed_oren_nayar, 0.8, 0.5)),
        (GGX(0.9, roughness=0.4), partial(printed_ggx, 0.9, 0.4)),
        (GGX(0.9, roughness=0.8), partial(printed_ggx, 0.9, 0.8)),
        (Retroreflector(0.8, half_width_rad=0.3), partial(printed_retroreflector, 0.8, 0.3)),
    ],
    ids=("phong", "phong and diffuse", "oren-nayar", "ggx 0.4", "ggx 0.8", "retroreflector"),
)
def test_a_box_of_another_material(material: Material, printed: Callable[[], Brdf]) -> None:
    """In three bounces the box's material changes the box's own light and that of no other part."""
    scene = furnished_with(box=material)
    brdfs = {n: printed_lambertian(0.7) for n in scene.part_names} | {"box": printed()}
    compare(scene, plain_lambertian() | {"box": plain(scene, brdfs, "box")["box"]})


def test_the_wall_and_the_objects_all_different() -> None:
    """Other materials at the laser point and the FoV point, too: a glossy wall, a rough pillar, a metal box."""
    scene = furnished_with(relay_wall=Phong(0.8, 5, 0.5), box=GGX(0.9, 0.5), pillar=OrenNayar(0.6, 0.35))
    special = {
        "relay_wall": printed_phong(0.8, 5, 0.5),
        "box": printed_ggx(0.9, 0.5),
        "pillar": printed_oren_nayar(0.6, 0.35),
    }
    compare(scene, plain(scene, {n: printed_lambertian(0.7) for n in scene.part_names} | special))


def test_reciprocity_of_the_transient() -> None:
    """Swapping laser point and FoV point changes neither three nor four bounces, with hardly a Lambertian surface in
    the room."""
    scene = furnished_with(
        relay_wall=Phong(0.8, 8, 0.5), box=GGX(0.9, 0.35, f0=0.5), pillar=OrenNayar(0.8, 0.6),
        floor=Phong(0.7, 30, 0.6), walls=GGX(0.8, 0.7),
    )  # fmt: skip
    a, b = np.array([0, -0.8, 1.4]), np.array([0, 0.5, 0.9])
    there, back = (
        simulate(scene, one_point_capture(p, q, HALF_SIDE), Accuracy(1 << 16, 1, 4, 16), seed=s)
        for p, q, s in ((a, b, 1), (b, a, 2))
    )
    solid = [(DEVICE - p)[0] / np.linalg.norm(DEVICE - p) ** 3 for p in (b, a)]
    for name in ("primary", "secondary"):
        pair = [r.components[name].sum() / s for r, s in zip((there, back), solid, strict=True)]
        assert pair[0] == pytest.approx(pair[1], rel=1e-2), name
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
    result = simulate(scene, capture, Accuracy(1 << 15, 4, 3, 8), seed=3)
    return result.parts["box"][:, 0].sum(axis=1)


def test_a_retroreflective_box_shines_back_at_a_confocal_scan() -> None:
    """Exactly backwards the lobe is κ/2 / cosθ times Lambert's 1/π (κ of the half width, θ at the box): the gain is
    κ/2 times the mean of 1/cosθ over the box's own return, and never less than κ/2."""
    points = np.array([[0, y, z] for y in (-1.0, 0.2) for z in (0.6, 1.6)])
    half_width = math.radians(2)
    kappa = math.log(2) / (1 - math.cos(half_width))
    gain = scan(furnished_with(box=Retroreflector(0.7, half_width)), points, HALF_SIDE) / scan(
        furnished_with(), points, HALF_SIDE
    )
    assert (gain > 0.999 * kappa / 2).all()
    room, axis = furnished_with(), bins_of_path(40, 0.5, -1.0)
    for point, measured in zip(points, gain, strict=True):
        energies = []
        for printed in (printed_retroreflector(0.7, half_width), printed_lambertian(0.7)):
            brdfs = {"relay_wall": printed_lambertian(0.7), "box": printed}
            energies.append(plain_primary(room, point, point, axis, brdfs, 0.02, "box")["box"].sum())
        assert measured == pytest.approx(energies[0] / energies[1], rel=5e-3)


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
