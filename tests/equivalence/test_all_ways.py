"""Every way of computing light equals the definition (`transport/reference.py`), for every BRDF, shape and scan.

The truth is sampled paths, which `test_paths.py` compares with the definition itself.

Energies of each component are compared: of each part (primary only), of each histogram, and of
windows of time. Reference and path tracing are known from `RUNS` independent runs, so a difference is judged by
Student's t at a family-wise level of `LEVEL` over all numbers of a case. The error that a way claims is allowed on
top: the energy of a part may be off by its relative error; and an L2 error e over histograms lets the sum of n bins
be off by at most e √n (Cauchy & Schwarz). The daily test takes a few cases spread over all, the nightly test all.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache

import numpy as np
import pytest
import trimesh
from numpy.typing import NDArray
from rooms import bins_of_path, rectangle, square_pixels
from scipy import stats

from datagen import GGX, Accuracy, Capture, Lambertian, Laser, Part, Phong, Scene, Sensor, simulate
from datagen.records import Material, OrenNayar, Retroreflector, SinLobe, Transient
from datagen.transport.paths import sample_paths
from datagen.transport.reference import reference

RUNS, LEVEL = 8, 1e-4
"""Level for each case: of 432 nightly cases with three ways each, one in six nights would fail by chance."""
SAMPLES = 1 << 12
SLACK = 5e-4
"""Of all light, what a number may be off by in any case: some paths are so rare and so bright that none
of the runs has one, and their spread tells nothing of it."""
DEVICE = (0.6, -1.1, 2.0)
TIME = bins_of_path(168, 0.1, 0.0)
WINDOW = 8
Numbers = dict[str, NDArray[np.float64]]

MATERIALS: dict[str, Material] = {
    "lambertian 0.2": Lambertian(0.2), "lambertian 0.6": Lambertian(0.6), "lambertian 1": Lambertian(1.0),
    "oren-nayar 0.2": OrenNayar(0.6, sigma_rad=0.2), "oren-nayar 0.5": OrenNayar(0.6, sigma_rad=0.5),
    "oren-nayar 1.2": OrenNayar(0.6, sigma_rad=1.2),
    "phong 2": Phong(0.6, exponent=2.0), "phong 10": Phong(0.6, exponent=10.0, specular=0.6),
    "phong 60": Phong(0.6, exponent=60.0),
    "ggx 1": GGX(0.6, roughness=1.0), "ggx 0.6": GGX(0.6, roughness=0.6, f0=0.2), "ggx 0.4": GGX(0.6, roughness=0.4),
    "retroreflector 0.4": Retroreflector(0.6, half_width_rad=0.4),
    "retroreflector 0.2": Retroreflector(0.6, half_width_rad=0.2, retro=0.5),
    "retroreflector 0.12": Retroreflector(0.6, half_width_rad=0.12),
    "sin lobe x": SinLobe(0.6, axis=(1.0, 0.0, 0.0)), "sin lobe z": SinLobe(0.6, axis=(0.0, 0.0, 1.0)),
    "sin lobe xyz": SinLobe(0.6, axis=(1.0, 1.0, 1.0)),
}  # fmt: skip


def turned(mesh: trimesh.Trimesh, place: tuple[float, float, float] = (0.9, 0.1, 1.0)) -> trimesh.Trimesh:
    mesh.apply_transform(trimesh.transformations.rotation_matrix(0.6, (0.3, 1, 0.5)))
    mesh.apply_translation(place)
    return mesh


def plate() -> list[trimesh.Trimesh]:
    return [turned(rectangle((0, 0, 0), (0.05, 0.3, 0), (0, 0, 0.35)))]


def box() -> list[trimesh.Trimesh]:
    return [turned(trimesh.creation.box((0.4, 0.5, 0.3)))]


def ball() -> list[trimesh.Trimesh]:
    return [turned(trimesh.creation.icosphere(subdivisions=2, radius=0.25))]


def open_mesh() -> list[trimesh.Trimesh]:
    """Half of a torus, whose inner side is seen too."""
    mesh = trimesh.creation.torus(0.3, 0.12, major_sections=16, minor_sections=10)
    mesh.update_faces(mesh.triangles_center[:, 2] < 0.03)
    mesh.apply_transform(trimesh.transformations.rotation_matrix(-1.3, (0, 1, 0)))
    return [turned(mesh)]


def touching() -> list[trimesh.Trimesh]:
    """Two boxes with a common face, the lower one on the floor."""
    lower, upper = trimesh.creation.box((0.4, 0.4, 0.6)), trimesh.creation.box((0.3, 0.4, 0.4))
    lower.apply_translation((1.0, 0.1, 0.3))
    upper.apply_translation((1.0, 0.1, 0.8))
    return [lower, upper]


def coincident() -> list[trimesh.Trimesh]:
    """Two plates in one place."""
    return plate() + plate()


pytestmark = pytest.mark.filterwarnings("ignore:.*lie in one place")

SHAPES: dict[str, Callable[[], list[trimesh.Trimesh]]] = {
    make.__name__: make for make in (plate, box, ball, open_mesh, touching, coincident)
}


def confocal() -> Capture:
    points = np.array([[0, y, z] for y in (-0.5, 0.4) for z in (0.6, 1.3)])
    return Capture(Laser(DEVICE, points), Sensor(DEVICE, square_pixels(points, 0.005)), TIME, "confocal")


def exhaustive() -> Capture:
    lasers, seen = [[0, -0.5, 0.7], [0, 0.6, 1.2]], [[0, 0.2, 0.5], [0, -0.3, 1.3]]
    return Capture(Laser(DEVICE, lasers), Sensor(DEVICE, square_pixels(seen, 0.02)), TIME)


def array() -> Capture:
    sensor = Sensor.grid(DEVICE, (0, 0.1, 1.0), (0, 0.4, 0), (0, 0, 0.4), rows=3, columns=3)
    return Capture(Laser(DEVICE, [[0, -0.5, 0.9]]), sensor, TIME)


def flood() -> Capture:
    lasers, seen = [[0, y, 0.9] for y in (-0.4, 0.0, 0.4)], [[0, 0.3, 0.6], [0, -0.2, 1.3]]
    return Capture(Laser(DEVICE, lasers), Sensor(DEVICE, square_pixels(seen, 0.1)), TIME, illumination="flood")


CAPTURES: dict[str, Callable[[], Capture]] = {make.__name__: make for make in (confocal, exhaustive, array, flood)}


def scene_of(material: str, shape: str) -> Scene:
    """A wall, a floor, and a shape of one material."""
    wall = Part("wall", rectangle((0, 0, 1.1), (0, 1.2, 0), (0, 0, 1.1)), Lambertian(0.8), "relay_wall")
    floor = Part("floor", rectangle((0.9, 0, 0), (0.9, 0, 0), (0, 1.2, 0)), Lambertian(0.5), "structure")
    pieces = [Part(f"piece {k}", mesh, MATERIALS[material]) for k, mesh in enumerate(SHAPES[shape]())]
    return Scene.from_parts([wall, floor, *pieces])


def energies(found: Transient, shape: str) -> Numbers:
    """Energies by component, and by part unless two parts lie on each other, for then either part may have the
    light."""
    numbers = {}
    for name, light in found.components.items():
        numbers[f"{name} by histogram"] = light.sum(axis=2).ravel()
        numbers[f"{name} by time"] = light.sum(axis=(0, 1)).reshape(-1, WINDOW).sum(axis=1)
    if shape != "coincident":
        numbers["primary by part"] = np.array([light.sum() for light in found.parts.values()])
    return numbers


def claims(run: Transient, kind: str) -> NDArray[np.float64]:
    """The largest differences of energies of one kind that a run to a target claims; 0 without a target."""
    if run.error_bound is None:
        return np.zeros(1)
    lit = run.total > 0
    whole = run.error_bound * np.linalg.norm(run.total)
    if kind.endswith("by part"):
        # Parts that are no objects have no claim of their own: they may be off by as much as the whole.
        return np.array([
            run.part_errors[name] * of.sum() if name in run.part_errors else whole * np.sqrt((of > 0).sum())
            for name, of in run.parts.items()
        ])  # fmt: skip
    bins = lit.sum(axis=2).ravel() if kind.endswith("histogram") else lit.sum(axis=(0, 1)).reshape(-1, WINDOW).sum(1)
    return np.asarray(whole * np.sqrt(bins))


def of_runs(runs: list[Numbers]) -> tuple[Numbers, Numbers]:
    """Mean and standard error over runs; the error is 0 for a single run."""
    values = {kind: np.array([run[kind] for run in runs]) for kind in runs[0]}
    scatter = {kind: of.std(axis=0, ddof=min(len(runs) - 1, 1)) for kind, of in values.items()}
    return (
        {kind: of.mean(axis=0) for kind, of in values.items()},
        {kind: of / np.sqrt(len(runs)) for kind, of in scatter.items()},
    )


@lru_cache(maxsize=1)
def truth(material: str, shape: str, capture: str) -> tuple[Numbers, Numbers]:
    scene, seen = scene_of(material, shape), CAPTURES[capture]()
    runs = [
        reference(scene, seen, samples=SAMPLES, replicates=1, max_bounces=5, seed=seed, draw=sample_paths)
        for seed in range(RUNS)
    ]
    assert not sum(run.overflow.sum() for run in runs)
    return of_runs([energies(run, shape) for run in runs])


def by_quadrature(scene: Scene, capture: Capture) -> list[Transient]:
    return [simulate(scene, capture, Accuracy(target=0.01), seed=1)]


def by_blocks(scene: Scene, capture: Capture) -> list[Transient]:
    return [simulate(scene, capture, Accuracy(target=0.1, max_bounces=5), seed=seed) for seed in range(RUNS)]


def by_paths(scene: Scene, capture: Capture) -> list[Transient]:
    return [simulate(scene, capture, Accuracy(samples=SAMPLES, max_bounces=5), seed=seed) for seed in range(RUNS)]


WAYS: dict[str, Callable[[Scene, Capture], list[Transient]]] = {
    "quadrature": by_quadrature, "blocks": by_blocks, "paths": by_paths,
}  # fmt: skip


def hold(way: str, material: str, shape: str, capture: str) -> None:
    scene, seen = scene_of(material, shape), CAPTURES[capture]()
    runs = WAYS[way](scene, seen)
    true, known = truth(material, shape, capture)
    ours, error = of_runs([energies(run, shape) for run in runs])
    count = sum(len(of) for of in ours.values())
    t = stats.t.isf(LEVEL / 2 / count, RUNS - 1)
    slack = SLACK * sum(of.sum() for kind, of in true.items() if kind.endswith("by time"))
    wrong = []
    for kind, of in ours.items():
        allowed = t * np.hypot(error[kind], known[kind]) + claims(runs[0], kind) + slack
        wrong += [
            f"{kind} {k}: {of[k]:.4g}, truth {true[kind][k]:.4g} ± {known[kind][k]:.2g}, allowed {allowed[k]:.2g}"
            for k in np.flatnonzero(np.abs(of - true[kind]) > allowed)
        ]
    assert not wrong, (dict(runs[0].samplers), wrong)
    # The comparison means something only where the light is known well.
    of_primary, noise = true["primary by histogram"], known["primary by histogram"]
    assert np.sqrt((noise**2).sum()) < 0.05 * of_primary.sum()


CASES = [(material, shape, capture) for material in MATERIALS for shape in SHAPES for capture in CAPTURES]
ONCE_WRONG = [
    ("phong 2", "ball", "confocal", "quadrature"), ("phong 60", "ball", "confocal", "quadrature"),
    ("retroreflector 0.12", "touching", "confocal", "quadrature"), ("phong 10", "open_mesh", "confocal", "blocks"),
]  # fmt: skip
"""Cases in which some way lost light, or had too much, when this test was written."""


def spread_share() -> list[tuple[str, str, str, str]]:
    """A case of each material with one of the four ways, or two: every family of three BRDFs meets all ways, and
    every way all shapes and scans."""
    materials, shapes, captures, ways = list(MATERIALS), list(SHAPES), list(CAPTURES), list(WAYS)
    return [
        (material, shapes[(k % 3 + k // 3) % 6], captures[(k // 3) % 4], way)
        for k, material in enumerate(materials)
        for way in (ways[k % 3],)
    ]


@pytest.mark.parametrize(("material", "shape", "capture", "way"), [*spread_share(), *ONCE_WRONG])
def test_some_cases(material: str, shape: str, capture: str, way: str) -> None:
    hold(way, material, shape, capture)


@pytest.mark.nightly
@pytest.mark.parametrize("way", WAYS)
@pytest.mark.parametrize(("material", "shape", "capture"), CASES)
def test_every_case(material: str, shape: str, capture: str, way: str) -> None:
    hold(way, material, shape, capture)
