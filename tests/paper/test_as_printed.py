"""The paper's estimator equals, to rounding, a plain transcription of its Eq. 6 and Eq. 8 that shares no code with
it.

The transcription traces one path after the other in Python, tests each ray against every triangle by Möller &
Trumbore's method, takes angles from the local coordinates of Eq. 3 to 5, and the field of view from where a line of
sight crosses the wall's plane.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
import pytest
from numpy.typing import NDArray
from rooms import bins_of_path, furnished_box, one_point_capture, square_pixels
from scipy import stats

import datagen as dg
from datagen.errors import InputError
from datagen.paper import secondary
from datagen.transport.rays import Raycaster

Vector = NDArray[np.float64]
C_M_PER_S = 299_792_458.0
RAYS, PIXELS = 6, 8


@dataclass
class Met:
    point: Vector
    normal: Vector
    part: int


class PlainRoom:
    """First surfaces and shadows by brute force in double precision."""

    def __init__(self, scene: dg.Scene) -> None:
        self.scene = scene

    def first(self, start: Vector, direction: Vector) -> Met | None:
        t = self._crossings(start, direction)
        face = int(np.argmin(t))
        if not t[face] < math.inf:
            return None
        a, b, c = self.scene.corners[face]
        normal = np.cross(b - a, c - a)
        normal = normal / np.linalg.norm(normal)
        if normal @ direction > 0:
            normal = -normal
        return Met(start + t[face] * direction, normal, int(self.scene.face_part[face]))

    def sees(self, start: Vector, end: Vector) -> bool:
        return not (self._crossings(start, end - start) < 1).any()

    def _crossings(self, start: Vector, direction: Vector) -> Vector:
        """Distances at which the ray crosses each triangle, in units of `direction`, ∞ for a miss (Möller & Trumbore
        1997)."""
        a, b, c = self.scene.corners.transpose(1, 0, 2)
        p = np.cross(direction, c - a)
        with np.errstate(divide="ignore", invalid="ignore"):
            determinant = ((b - a) * p).sum(axis=1)
            u = ((start - a) * p).sum(axis=1) / determinant
            q = np.cross(start - a, b - a)
            v = (q @ direction) / determinant
            t = ((c - a) * q).sum(axis=1) / determinant
            return np.where((u >= 0) & (v >= 0) & (u + v <= 1) & (t > 0), t, math.inf)


def local_axes(normal: Vector) -> tuple[Vector, Vector]:
    """Unit vectors to the right and up within the surface."""
    away = np.array([1.0, 0, 0]) if abs(normal[2]) > 0.999999 else np.array([0, 0, 1.0])
    up = away - (away @ normal) * normal
    up /= np.linalg.norm(up)
    return np.cross(up, normal), up


def brdf(material: object, normal: Vector, direction: Vector) -> float:
    """The BRDF B towards a direction (not of unit length): cosφ of Eq. 4, or |sinθ| with the azimuth of Eq. 5."""
    cosine = float(normal @ direction / np.linalg.norm(direction))
    if cosine <= 0:
        return 0.0
    if isinstance(material, dg.Lambertian):
        return cosine
    axis = np.array(material.axis)  # type: ignore[attr-defined]
    zero = axis - (axis @ normal) * normal
    if np.linalg.norm(zero) < 1e-6:
        return 2 / math.pi
    side = np.cross(normal, zero)
    return abs(math.sin(math.atan2(float(direction @ side), float(direction @ zero))))


def camera(normal: Vector, pixels: int) -> list[Vector]:
    right, up = local_axes(normal)
    half = pixels // 2
    grid = [-1 + (i + 0.5) * 2 / half for i in range(half)]
    deep = [(i + 0.5) * 2 / half for i in range(half // 2)]
    local = [(x, y, 1.0) for x in grid for y in grid]
    for d in deep:
        for s in grid:
            local += [(-1.0, s, d), (1.0, s, d), (s, -1.0, d), (s, 1.0, d)]
    return [x * right + y * up + z * normal for x, y, z in local]


def rays(normal: Vector, count: int, grid: str) -> list[Vector]:
    right, up = local_axes(normal)
    out = []
    for i in range(count):
        theta = 2 * math.pi * (i + 0.5) / count
        for k in range(count):
            phi = math.pi / 2 * (k + 0.5) / count if grid == "angles" else math.acos(1 - (k + 0.5) / count)
            tangent = math.cos(theta) * right + math.sin(theta) * up
            out.append(math.sin(phi) * tangent + math.cos(phi) * normal)
    return out


def plain(scene: dg.Scene, capture: dg.Capture, settings: dg.AsPrinted) -> dict[str, NDArray[np.float64]]:
    """Components and `part:name`, each (P, T), for one laser point and pixels in a plane of constant x."""
    lift = Raycaster(scene).offset_m
    room, unit, sensor = PlainRoom(scene), settings.unit_m, capture.sensor.position
    beta = [1 / math.pi if isinstance(m, dg.Lambertian) else 0.25 for m in scene.materials]
    gamma = [m.albedo for m in scene.materials]
    _, pixels, bins = capture.shape
    out = {name: np.zeros((pixels, bins)) for name in ("secondary", *(f"part:{n}" for n in scene.part_names))}

    def b(part: int, normal: Vector, direction: Vector) -> float:
        return brdf(scene.materials[part], normal, direction)

    def c_atm(metres: float) -> float:
        return math.exp(-scene.attenuation_per_m * metres)

    def add(row: NDArray[np.float64], path_m: float, energy: float) -> None:
        place = math.floor((path_m / C_M_PER_S - capture.time.start_s) / capture.time.width_s)
        if 0 <= place < bins:
            row[place] += energy

    def pixels_seeing(met: Met) -> list[int]:
        span = met.point - sensor
        if -span @ met.normal <= lift or not room.sees(sensor, met.point + lift * met.normal):
            return []
        plane_x = capture.sensor.pixels[0, 0, 0]
        at = sensor + span * (plane_x - sensor[0]) / span[0]
        low, high = capture.sensor.pixels.min(axis=1), capture.sensor.pixels.max(axis=1)
        forward = (plane_x - sensor[0]) * span[0] > 0
        inside = (at[1:] >= low[:, 1:]) & (at[1:] <= high[:, 1:])
        return [p for p in range(pixels) if forward and inside[p].all()]

    spot = room.first(capture.laser.position, capture.laser.targets[0] - capture.laser.position)
    assert spot is not None
    device_leg = float(np.linalg.norm(spot.point - capture.laser.position))
    counted = capture.time.origin == "source"
    x1, n1 = spot.point, spot.normal
    out_rays = rays(n1, settings.rays, settings.grid)
    alpha_1 = 1 / sum(b(spot.part, n1, ray) for ray in out_rays)
    detours: list[tuple[float, float, float, int]] = []
    exits: dict[int, list[tuple[int, float, float]]] = {}
    for j, ray in enumerate(out_rays):
        lookin = room.first(x1 + lift * n1, ray)
        if lookin is None:
            continue
        r_j = float(np.linalg.norm(lookin.point - x1))
        a_1 = gamma[spot.part] * c_atm(r_j) * alpha_1 * b(spot.part, n1, ray) / (r_j / unit) ** 2
        views = camera(lookin.normal, settings.pixels)
        alpha_j = 1 / sum(b(lookin.part, lookin.normal, view) for view in views)
        observed = [(view, room.first(lookin.point + lift * lookin.normal, view)) for view in views]
        exits[j] = []
        for view, n in observed:
            if n is None:
                continue
            r_n, r_s = float(np.linalg.norm(n.point - lookin.point)), float(np.linalg.norm(n.point - sensor))
            a_2 = gamma[lookin.part] * c_atm(r_n) * alpha_j * b(lookin.part, lookin.normal, view) / (r_n / unit) ** 2
            a_3 = gamma[n.part] * c_atm(2 * r_s) * beta[n.part] * b(n.part, n.normal, sensor - n.point)
            a_3 /= (r_s / unit) ** 2
            aperture = math.pi * (capture.sensor.aperture_radius_m / unit) ** 2
            outside = (device_leg + r_s) if counted else 0.0
            for p in pixels_seeing(n):
                add(out[f"part:{scene.part_names[lookin.part]}"][p], r_j + r_n + outside, aperture * a_1 * a_2 * a_3)
                exits[j].append((p, aperture * a_2 * a_3, r_n + outside))
        for _, k in observed:
            if k is None or (k.point - x1) @ n1 <= lift or (x1 - k.point) @ k.normal <= lift:
                continue
            if not room.sees(x1 + lift * n1, k.point + lift * k.normal):
                continue
            r_k, r_kj = float(np.linalg.norm(k.point - x1)), float(np.linalg.norm(lookin.point - k.point))
            b_1 = b(spot.part, n1, k.point - x1)
            a_hat_1 = gamma[spot.part] * c_atm(r_k) * b_1 / (r_k / unit) ** 2
            a_hat_2 = gamma[k.part] * c_atm(r_kj) * beta[k.part] * b(k.part, k.normal, lookin.point - k.point)
            a_hat_2 /= (r_kj / unit) ** 2
            detours.append((b_1, a_hat_1 * a_hat_2, r_k + r_kj, j))
    all_b_1 = sum(b_1 for b_1, *_ in detours)
    for j, ways in exits.items():
        own = [d for d in detours if d[3] == j]
        if not own:
            continue
        own_b_1 = sum(b_1 for b_1, *_ in own)
        alpha = {"room": 1 / all_b_1, "lookin": 1 / own_b_1, "rays": alpha_1}[settings.conserved]
        if settings.secondary == "strongest":
            own = [max(own, key=lambda d: d[1])]
        for _, energy, path, _ in own:
            for p, exit_energy, exit_path in ways:
                add(out["secondary"][p], path + exit_path, alpha * energy * exit_energy)
    return out


def shiny_room(attenuation: float = 0.0) -> dg.Scene:
    """The furnished box with different reflectivities, and |sinθ| on the pillar and the floor."""
    scene = furnished_box()
    albedos = np.linspace(0.9, 0.4, len(scene.materials))
    materials = [dg.Lambertian(float(a)) for a in albedos]
    materials[5], materials[2] = dg.SinLobe(0.5), dg.SinLobe(0.8, axis=(0.3, 0.1, 1.0))
    return replace(scene, materials=tuple(materials), attenuation_per_m=attenuation)


def two_pixels(origin: str) -> dg.Capture:
    capture = one_point_capture((0, -0.8123, 1.4317), device=(1.512, 0.0931, 1.3172))
    pixels = square_pixels([(0, 0.1234, 1.2345), (0, 0.8234, 1.2345)], 0.35)
    return dg.Capture(
        capture.laser,
        dg.Sensor(capture.sensor.position, pixels, 0.02),
        bins_of_path(160, 0.05, 1.0, origin),
    )


CASES = {
    "all": (dg.AsPrinted(RAYS, PIXELS), "wall", 0.0),
    "strongest": (dg.AsPrinted(RAYS, PIXELS, secondary="strongest"), "source", 0.0),
    "equal solid angles, per lookin, in metres, in haze": (
        dg.AsPrinted(RAYS, PIXELS, 1.0, grid="solid_angle", conserved="lookin"), "wall", 0.2
    ),
    "one alpha": (dg.AsPrinted(RAYS, PIXELS, conserved="rays"), "source", 0.05),
}  # fmt: skip


@pytest.mark.parametrize("case", CASES)
def test_equals_the_plain_double_loop(case: str) -> None:
    settings, origin, attenuation = CASES[case]
    scene, capture = shiny_room(attenuation), two_pixels(origin)
    ours, wanted = dg.simulate_as_printed(scene, capture, settings), plain(scene, capture, settings)
    pairs = {f"part:{name}": curve[0] for name, curve in ours.parts.items()}
    pairs["secondary"] = ours.components["secondary"][0]
    for name, curve in pairs.items():
        np.testing.assert_allclose(curve, wanted[name], rtol=1e-9, atol=1e-11 * wanted[name].max(), err_msg=name)
    assert wanted["part:box"].any() and (wanted["secondary"].sum(axis=1) > 0).all()
    assert wanted["part:pillar"].any() or settings.grid != "angles"
    np.testing.assert_allclose(ours.components["primary"], sum(ours.parts.values()), rtol=1e-12)


@pytest.fixture(scope="module")
def room() -> tuple[dg.Scene, dg.Capture]:
    return furnished_box(0.7), one_point_capture(time=bins_of_path(200, 0.1, 0.0))


def energies(transient: dg.records.Transient) -> tuple[float, float]:
    return float(transient.components["primary"].sum()), float(transient.components["secondary"].sum())


def test_levels_carry_a_unit_of_length(room: tuple[dg.Scene, dg.Capture]) -> None:
    """Eq. 6 has three factors 1/R² and one aperture, Eq. 8 four and one: L_p scales as unit⁴, L_s as unit⁶, L_s/L_p
    as unit²."""
    (p_mm, s_mm), (p_m, s_m) = (
        energies(dg.simulate_as_printed(*room, dg.AsPrinted(5, 12, unit))) for unit in (1e-3, 1.0)
    )
    assert p_m / p_mm == pytest.approx(1e12, rel=1e-9, abs=0)
    assert s_m / s_mm == pytest.approx(1e18, rel=1e-9, abs=0)
    assert (s_m / p_m) / (s_mm / p_mm) == pytest.approx(1e6, rel=1e-9, abs=0)


def test_levels_depend_on_the_number_of_rays_where_radiometric_ones_do_not(room: tuple[dg.Scene, dg.Capture]) -> None:
    """As printed, the primary keeps its level because each α is a fraction of the light; the secondary's products of
    1/R² are unbounded towards corners, and more rays come nearer to these.

    The radiometric secondary agrees between the counts: Student's t of 8 seeds at a family-wise level of 10⁻³.
    """
    few, some, many = 8, 16, 48
    printed = np.array([energies(dg.simulate_as_printed(*room, dg.AsPrinted(n, 20))) for n in (few, some, many)])
    assert np.ptp(printed[:, 0]) < 0.15 * printed[:, 0].mean()
    assert printed[:, 1].max() > 4 * printed[:, 1].min()
    runs = np.array([[secondary(*room, n * n, 64, seed=s).sum() for s in range(8)] for n in (few, some, many)])
    mean, error = runs.mean(axis=1), runs.std(axis=1, ddof=1) / math.sqrt(8)
    assert (np.abs(mean[:2] - mean[2]) < stats.t.ppf(1 - 1e-3 / 4, 7) * np.hypot(error[:2], error[2])).all()
    assert (error < 0.1 * mean).all()


def test_a_per_lookin_alpha_makes_the_secondary_grow_with_the_number_of_lookins(
    room: tuple[dg.Scene, dg.Capture],
) -> None:
    """With α for each hidden vertex, every one of N hidden vertices receives all of the laser's light; with α over
    the room they share it, so the ratio is about N."""
    for n in (5, 10):
        one, other = (
            energies(dg.simulate_as_printed(*room, dg.AsPrinted(n, 12, conserved=c)))[1] for c in ("lookin", "room")
        )
        assert one / other == pytest.approx(n * n, rel=0.5, abs=0)


def test_the_strongest_path_is_one_of_all(room: tuple[dg.Scene, dg.Capture]) -> None:
    full, one, none = (
        dg.simulate_as_printed(*room, dg.AsPrinted(6, 12, secondary=kind)) for kind in ("all", "strongest", "none")
    )
    np.testing.assert_array_equal(full.components["primary"], one.components["primary"])
    np.testing.assert_array_equal(full.components["primary"], none.components["primary"])
    assert "secondary" not in none.components
    assert (one.components["secondary"] <= full.components["secondary"] * (1 + 1e-12)).all()
    assert 0 < one.components["secondary"].sum() < 0.2 * full.components["secondary"].sum()


def test_nothing_met_gives_nothing() -> None:
    scene = furnished_box()
    away = dg.Capture(
        dg.Laser((1.5, 0.1, 1.3), [(50, 0.1, 1.3)]),
        dg.Sensor((-3.0, 0.1, 1.3), square_pixels([(-5, 0, 1)], 0.1)),
        bins_of_path(20, 0.1, 0.0),
    )
    result = dg.simulate_as_printed(scene, away, dg.AsPrinted(3, 4))
    assert not result.total.any() and not result.overflow.any()


def test_light_beyond_the_window_is_tallied(room: tuple[dg.Scene, dg.Capture]) -> None:
    scene, capture = room
    settings = dg.AsPrinted(6, 12)
    whole = dg.simulate_as_printed(scene, capture, settings)
    short = dg.simulate_as_printed(scene, replace(capture, time=bins_of_path(30, 0.1, 0.0)), settings)
    assert short.overflow[0, 0] > 0.1 * whole.total.sum()
    assert short.total.sum() + short.overflow.sum() == pytest.approx(
        whole.total.sum() + whole.overflow.sum(), rel=1e-9, abs=0
    )


@pytest.mark.parametrize(
    ("key", "value"),
    [
        ("rays", 0), ("rays", 2.5), ("rays", True), ("pixels", 6), ("pixels", -4), ("unit_m", 0.0),
        ("unit_m", "mm"), ("unit_m", math.nan), ("secondary", "some"), ("grid", "sobol"), ("conserved", "none"),
    ],
)  # fmt: skip
def test_wrong_settings_are_told_in_one_line(key: str, value: object) -> None:
    with pytest.raises(InputError, match=rf"AsPrinted\.{key} = ") as told:
        dg.AsPrinted(**{key: value})  # type: ignore[arg-type]
    assert "\n" not in str(told.value)


def test_other_brdfs_are_refused(room: tuple[dg.Scene, dg.Capture]) -> None:
    scene, capture = room
    glossy = replace(scene, materials=(*scene.materials[:-1], dg.Phong(0.5)))
    with pytest.raises(InputError, match="part 'pillar': Phong is no BRDF of the paper"):
        dg.simulate_as_printed(glossy, capture)
