"""The hard cases of the transport: what the obvious way makes of each, what we make of it, and the truth."""

from __future__ import annotations

import math
from dataclasses import replace
from unittest import mock

import numpy as np
import trimesh
from measured import HardCase
from rooms import bins_of_path, furnished_box, one_point_capture, rectangle, square_pixels

from datagen import Accuracy, Capture, Lambertian, Laser, OrenNayar, Part, Scene, Sensor, TimeAxis, simulate
from datagen.records import Transient
from datagen.transport.fields_of_view import PixelCones
from datagen.transport.visibility import raycast

APERTURE_M2 = math.pi * 0.02**2
DEVICE = np.array([1.5, 0.1, 1.3])
WINDOW = bins_of_path(100, 0.5, 0.0)
WALL = Part("wall", rectangle((0, 0, 0), (0, 2, 0), (0, 0, 2)), Lambertian(0.8), "relay_wall")


def energy(result: Transient) -> float:
    return float(result.total.sum() + result.overflow.sum())


def moved(scene: Scene, capture: Capture, scale: float, shift: tuple[float, ...]) -> tuple[Scene, Capture]:
    s, axis = np.asarray(shift, float), capture.time
    return replace(scene, vertices=scene.vertices * scale + s), Capture(
        Laser(capture.laser.position * scale + s, capture.laser.targets * scale + s),
        Sensor(capture.sensor.position * scale + s, capture.sensor.pixels * scale + s),
        TimeAxis(axis.bins, axis.width_s * scale, axis.start_s * scale, axis.origin),
        capture.pairing,
    )


def relative_l1(found: np.ndarray, truth: np.ndarray) -> float:
    return float(np.abs(found - truth).sum() / truth.sum())


def contact() -> HardCase:
    """One lookin and one FoV point, laser point and FoV 1 mm above the floor they both look at."""
    gap, half, singles = 1e-3, 0.05, 200
    floor = Part("floor", rectangle((1, 0, 0), (1, 0, 0), (0, 1, 0)), Lambertian(0.6), "structure")
    wall = Part("wall", rectangle((0, 0, 1), (0, 1, 0), (0, 0, 1)), Lambertian(0.8), "relay_wall")
    scene = Scene.from_parts([wall, floor])
    capture = one_point_capture((0, -0.02, gap), (0, 0.02, gap + half), half, bins_of_path(1, 5.0, 0.0))
    mean = energy(simulate(scene, capture, Accuracy(1 << 16, 16, 3, 1), seed=1))
    ours = np.array([energy(simulate(scene, capture, Accuracy(1, 1, 3, 1), seed=s)) for s in range(singles)])
    rng = np.random.default_rng(1)
    u, v, y, z = rng.random((4, 1 << 21))
    radius = np.sqrt(u)
    w = np.stack([np.sqrt(1 - u), radius * np.cos(2 * np.pi * v), radius * np.sin(2 * np.pi * v)], axis=1)
    x1 = np.array([0, -0.02, gap])
    x2 = x1 + w * (-x1[2] / np.minimum(w[:, 2:], -1e-6))
    x3 = np.stack([0 * y, 0.02 + half * (2 * y - 1), gap + half * 2 * z], axis=1)
    d = x3 - x2
    on_floor = (w[:, 2] < 0) & (x2[:, 0] < 2) & (np.abs(x2[:, 1]) < 1)
    weight = np.where(on_floor, x2[:, 0] * x3[:, 2] / (d**2).sum(axis=1) ** 2, 0.0)
    return HardCase(
        "Laser point and field of view 1 mm from a surface they touch, one sample",
        f"a plain connection's cos cos/R²: the largest of {len(weight)} samples, in units of their mean",
        float(weight.max() / weight.mean()),
        "connections and followed rays share by the balance heuristic: the largest sample, in units of the mean",
        float(ours.max() / mean),
        "bound 2ρ₁ρ₂ρ₃A/πR²: no sample beyond it",
        allowed=2 * 0.8 * 0.6 * 0.8 / math.pi * APERTURE_M2 / DEVICE[0] ** 2 / mean,
    )


def edge() -> HardCase:
    """The laser point 1 µm from an edge, nearer than rays are lifted off their surface."""
    scene, accuracy = furnished_box(), Accuracy(4096, 4, 5, 4)

    def later(distance: float) -> float:
        capture = one_point_capture((0, -1.5 + distance, 1.4), time=WINDOW)
        result = simulate(scene, capture, accuracy, seed=1)
        return float(result.components["secondary"].sum() + result.components["higher"].sum())

    # Of the light from 1 µm beside a wall, what meets it below the 4 µm by which a ray's origin is lifted.
    lost = (1 - math.cos(math.atan(4.0))) / 2
    return HardCase(
        "Laser point 1 µm from an edge of a 4 m room",
        "rays from a lifted origin: share of the first bounce that no ray can meet",
        lost,
        "rays are asked from the lifted, hits computed from the true point: 4 bounces and more against their limit",
        abs(later(1e-6) / later(1e-4) - 1),
        "the limit at 0.1 mm",
        allowed=5e-3,
    )


def far_away() -> HardCase:
    """10 km from the origin: float32 knows a millimetre there."""
    scene, shift = furnished_box(), (8000.0, -6000.0, 300.0)
    capture = one_point_capture(time=bins_of_path(2000, 0.01, 0.0))
    accuracy = Accuracy(2048, 4, 4, 4, direct=True)
    near = simulate(scene, capture, accuracy, seed=1)
    far_scene, far_capture = moved(scene, capture, 1.0, shift)
    far = simulate(far_scene, far_capture, accuracy, seed=1)
    coarse = replace(far_scene, vertices=far_scene.vertices.astype(np.float32).astype(np.float64))
    naive = simulate(coarse, far_capture, accuracy, seed=1)
    return HardCase(
        "A room 10 km from the origin, 1 cm bins",
        "vertices kept in float32: relative L1 error",
        relative_l1(naive.total, near.total),
        "float64 outside, centred and scaled for embree: relative L1 error",
        relative_l1(far.total, near.total),
        "the same room at the origin",
        allowed=1e-4,
    )


def window() -> HardCase:
    """A window that ends in the middle of the signal."""
    scene = furnished_box()
    whole = simulate(scene, one_point_capture(time=bins_of_path(400, 0.05, 0.0)), Accuracy(4096, 4, 4, 4), seed=1)
    part = simulate(scene, one_point_capture(time=bins_of_path(80, 0.05, 0.0)), Accuracy(4096, 4, 4, 4), seed=1)
    truth = whole.total[0, 0, :80]
    piled = truth.copy()
    piled[-1] += whole.total[0, 0, 80:].sum()
    return HardCase(
        "Light beyond the window",
        "the index clipped to the last bin: how many times too much it holds",
        float(piled[-1] / truth[-1]),
        "tallied as overflow: relative error of window + overflow",
        abs(energy(part) / energy(whole) - 1),
        "a window that holds everything",
        allowed=1e-12,
    )


def furnace() -> HardCase:
    """Albedo 1 in a closed room with a box: late light fills it evenly, c/(4πV) of radiance, for ever."""
    low, high = np.array([0, -0.5, 0.0]), np.array([1, 0.5, 1.0])
    room = trimesh.creation.box(bounds=[low, high])
    box = trimesh.creation.box((0.3, 0.3, 0.3))
    box.apply_translation((0.6, 0.1, 0.3))
    rough = OrenNayar(1.0, 0.5)
    scene = Scene.from_parts([Part("room", room, Lambertian(1.0), "structure"), Part("box", box, rough, "structure")])
    sensor = Sensor((0.3, -0.2, 0.7), square_pixels([[0, 0.1, 0.5]], 0.2))
    width, first = 0.25, 5.0
    capture = Capture(Laser((0.3, -0.2, 0.7), [[0, -0.3, 0.4]]), sensor, bins_of_path(16, width, first))
    every = simulate(scene, capture, Accuracy(1 << 15, 4, None, 8), seed=3)
    few = simulate(scene, capture, Accuracy(1 << 13, 2, 10, 8), seed=3)
    even = width / (4 * math.pi * (1 - 0.3**3)) * APERTURE_M2 * PixelCones.of(sensor).solid_angle[0]
    return HardCase(
        "Albedo 1 in a closed room of 1 m: light 5 to 9 m after the laser point",
        "ten bounces: share of the light that is missing",
        1 - float(few.total.mean()) / even,
        "all orders, ended by roulette: relative error of the level",
        abs(float(every.total.mean()) / even - 1),
        "c/(4πV) · AΩ in equilibrium",
        allowed=1e-2,
    )


def thin_gap() -> HardCase:
    """Laser, sensor and all light between two plates 1 mm apart and 2 m wide."""
    gap = 1e-3
    places = {"one": 0.0, "other": gap}
    plates = {name: rectangle((x, 0, 0), (0, 1, 0), (0, 0, 1)) for name, x in places.items()}
    scene = Scene.from_parts([Part(name, plate, Lambertian(0.8)) for name, plate in plates.items()])
    one, other, h = np.array([0, -5e-4, 0]), np.array([0, 7e-4, 2e-4]), 1e-6
    eye = np.array([gap / 2, 2e-4, 0.0])
    capture = Capture(Laser(eye, [one]), Sensor(eye, square_pixels([other], h)), bins_of_path(1, 1.0, 0.0))
    found = energy(simulate(scene, capture, Accuracy(1 << 16, 1, 3, 1), seed=1))
    with mock.patch.object(raycast, "SURFACE_OFFSET", 1e-3):
        lifted = energy(simulate(scene, capture, Accuracy(1 << 12, 1, 3, 1), seed=1))
    # Polar about the laser point, dense where the plate is near: ∫∫ (g²/r²)² in closed steps.
    t, a = (np.arange(4000) + 0.5) / 4000, (np.arange(400) + 0.5) / 400 * 2 * np.pi
    radius = gap * np.sqrt(t / (1 - t))[:, None]
    square = ((one[1] + radius * np.cos(a) - other[1]) ** 2 + (radius * np.sin(a) - other[2]) ** 2) + gap**2
    # Uniform in t is the density of a cosine ray: g²/(π (g² + r²)²).
    spread = float((gap**2 / square**2).mean())
    omega = PixelCones.of(capture.sensor).solid_angle[0]
    truth = 0.8**3 / math.pi**2 * spread * APERTURE_M2 * omega
    return HardCase(
        "Laser and sensor in a gap of 1 mm between plates of 2 m",
        "ray ends lifted by 1 mm, usual in single precision: relative error",
        abs(lifted / truth - 1),
        "lifted by 2 µm for the question alone: relative error",
        abs(found / truth - 1),
        "polar quadrature",
        allowed=2e-3,
    )


def many_triangles() -> HardCase:
    """A million triangles in the planes of a dozen."""
    scene = furnished_box()
    capture = one_point_capture(time=WINDOW)
    scene = replace(scene, roles=("structure",) * len(scene.roles))
    parts = []
    for name, material, role in zip(scene.part_names, scene.materials, scene.roles, strict=True):
        mesh = trimesh.Trimesh(scene.vertices, scene.triangles[scene.faces_of(name)], process=False)
        vertices, faces = np.asarray(mesh.vertices), np.asarray(mesh.faces)
        while len(faces) < 100_000:
            vertices, faces = trimesh.remesh.subdivide(vertices, faces)
        parts.append(Part(name, trimesh.Trimesh(vertices, faces, process=False), material, role))
    fine = Scene.from_parts(parts)
    plain = simulate(scene, capture, Accuracy(4096, 4, 4, 4), seed=1)
    result = simulate(fine, capture, Accuracy(4096, 4, 4, 4), seed=1)
    return HardCase(
        f"A mesh of {len(fine.triangles) / 1e6:.1f} million triangles",
        "areas and normals formed in float32: relative error of an area, median",
        _float32_areas(fine),
        "float64 normals, float32 only in embree: relative L1 error",
        relative_l1(result.total, plain.total),
        f"the same surfaces in {len(scene.triangles)} triangles",
        allowed=1e-9,
    )


def _float32_areas(scene: Scene) -> float:
    # Turned, as only walls along the axes have coordinates that float32 holds.
    turned = scene.corners @ trimesh.transformations.rotation_matrix(0.3, (1, 2, 3.0))[:3, :3]
    single, double = (
        np.linalg.norm(np.cross(c[:, 1] - c[:, 0], c[:, 2] - c[:, 0]), axis=1)
        for c in (turned.astype(np.float32), turned)
    )
    return float(np.median(np.abs(single / double - 1)))


def coplanar() -> HardCase:
    """Laser point and field of view on one wall of many triangles in a plane that float64 cannot hold exactly."""
    turn = trimesh.transformations.rotation_matrix(0.7, (0.3, 1.0, -0.4))
    mesh = rectangle((0, 0, 0), (0, 2, 0), (0, 0, 2)).subdivide().subdivide().subdivide()
    mesh.apply_transform(turn)
    rotate = turn[:3, :3]
    scene = Scene.from_parts([Part("wall", mesh, Lambertian(1.0), "relay_wall")])
    eye = rotate @ np.array([1.0, 0, 0])
    pixels = square_pixels([[0, 0.01, 0.0]], 0.2) @ rotate.T
    capture = Capture(Laser(eye, [rotate @ np.array([0, -0.3, 0])]), Sensor(eye, pixels), bins_of_path(10, 1.0, 0.0))
    found = energy(simulate(scene, capture, Accuracy(1 << 14, 4, 5, 4), seed=1))
    heights = mesh.triangles_center @ mesh.face_normals[0]
    return HardCase(
        "Laser point and field of view in one plane that no float holds exactly",
        "distance of the wall's points from their own plane, m: the sign of a cosine is chance",
        float(np.ptp(heights)),
        "rays leave above the surface and must meet a triangle: the primary and all later light",
        found,
        "exactly 0",
        allowed=0.0,
    )


def edge_on() -> HardCase:
    """A pixel seen at 0.006° from its wall: per solid angle it is as bright as from anywhere."""
    patch = rectangle((1.2, 0.3, -0.2), (0, 5e-4, 0), (0, 0, 5e-4))
    scene = Scene.from_parts([WALL, Part("patch", patch, Lambertian(0.6))])
    x1, x2, x3 = np.array([0, -0.4, 0.2]), np.array([1.2, 0.3, -0.2]), np.array([0, 0.9, 0.1])
    eye = x3 + np.array([1e-4, -1.0, 0.0])
    half = 2e-5
    outline = half * np.array([[0.1, 0, -1], [-0.1, 0, -1], [-0.1, 0, 1], [0.1, 0, 1]])
    corners = x3 + outline
    corners = eye + (corners - eye) * 0.5
    capture = Capture(Laser((1.5, 0, 0.9), [x1]), Sensor(eye, [corners]), bins_of_path(400, 0.01, 0.0))
    found = energy(simulate(scene, capture, Accuracy(512, 64, 3, 2), seed=3))
    r12, r23 = np.linalg.norm(x2 - x1), np.linalg.norm(x3 - x2)
    lit = 0.8 / math.pi * 1.2 / r12 * 1.2 / r12 / r12**2 * 1e-6
    irradiance = lit * 0.6 / math.pi * (1.2 / r23) ** 2 / r23**2
    truth = irradiance * 0.8 / math.pi * APERTURE_M2 * PixelCones.of(capture.sensor).solid_angle[0]
    return HardCase(
        "A pixel seen at 0.006° from its wall",
        "the wall sampled by area and the cosine towards the sensor forgotten: factor",
        float(np.linalg.norm(x3 - eye) / 1e-4),
        "solid angle of the cone of directions: relative error",
        abs(found / truth - 1),
        "closed form of a small patch",
        allowed=5e-3,
    )


LIGHT = (contact, edge, coplanar, thin_gap, edge_on, far_away, window, furnace, many_triangles)
