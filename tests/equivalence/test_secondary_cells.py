"""The secondary by quadrature over pairs of elements equals path tracing and a sphere's closed form, and obeys the
laws of both.

The mean of path tracing over `RUNS` seeds is compared by Student's t at 10⁻³ over all numbers, with the error asked
of quadrature allowed on top.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import trimesh
from benchmarks.foreign_scenes import foreign_scene
from numpy.typing import NDArray
from rooms import bins_of_path, furnished_box, square_pixels
from scipy import stats
from sphere_chords import unit_ball

from datagen import Accuracy, Capture, Lambertian, Laser, Part, Scene, Sensor, simulate
from datagen.transport.fields_of_view import PixelCones
from datagen.transport.paths import sample_paths
from datagen.transport.quadrature.four_bounces import Secondary, secondary_by_cells
from datagen.transport.quadrature.gathering import Gathering
from datagen.transport.reference import reference
from datagen.transport.simulate import prepared

RUNS, LEVEL, OWN = 8, 1e-3, 0.04
DEVICE = (1.5, 0.1, 1.3)
TIME = bins_of_path(160, 0.1, 0.0)
COARSE = 16
"""Number of bins added up into one, so that each sum holds many paths and its spread is nearly normal."""
SPOTS = np.array([[0, -0.9, 0.6], [0, 0.3, 1.7], [0, 0.9, 1.1]])


def of_cells(scene: Scene, capture: Capture, own: float = OWN) -> Secondary:
    task = prepared(scene, capture, Accuracy(target=0.02, max_bounces=4), 0, split_parts=False)
    found = secondary_by_cells(Gathering.of(task), np.inf, own)
    assert found is not None
    assert (found.histogram >= 0).all()
    return found


def numbers(light: NDArray[np.float64], overflow: NDArray[np.float64]) -> NDArray[np.float64]:
    """All energy, the energy outside the window, that of each laser point and pixel, and that of coarse bins of
    time."""
    by_time = light.sum(axis=(0, 1)).reshape(-1, COARSE).sum(axis=1)
    return np.concatenate([[light.sum()], (light.sum(axis=2) + overflow).ravel(), by_time])


def scan(
    pairing: str, half_side_m: float, origin: str = "wall", device: tuple[float, float, float] = DEVICE
) -> Capture:
    pixels = SPOTS if pairing == "confocal" else SPOTS[:2] + np.array([0, 0.2, -0.1])
    sensor = Sensor(device, square_pixels(pixels, half_side_m))
    return Capture(Laser(DEVICE, SPOTS), sensor, replace(TIME, origin=origin), pairing)  # type: ignore[arg-type]


def with_meshes(times: int = 0) -> Scene:
    """The box with a free-standing ball of 1280 triangles and ring of 2304, each triangle cut into four so many
    times."""
    room = furnished_box()
    ball = trimesh.creation.icosphere(3, radius=0.3)
    ball.apply_translation((1.2, 0.5, 0.9))
    ring = trimesh.creation.torus(0.3, 0.1, major_sections=48, minor_sections=24)
    ring.apply_translation((1.4, -0.5, 1.7))
    for _ in range(times):
        ball, ring = ball.subdivide(), ring.subdivide()
    shell = [
        Part(name, trimesh.Trimesh(room.vertices, room.triangles[room.faces_of(name)], process=False), material, role)
        for name, material, role in zip(room.part_names, room.materials, room.roles, strict=True)
    ]
    return Scene.from_parts([*shell, Part("ball", ball, Lambertian(0.6)), Part("ring", ring, Lambertian(0.6))])


@pytest.mark.parametrize(
    ("scene", "capture"),
    [
        (furnished_box(), scan("confocal", 5e-4)),
        (furnished_box(), scan("confocal", 0.2, "source")),
        (replace(furnished_box(), attenuation_per_m=0.3), scan("exhaustive", 0.02, "source")),
    ],
    ids=["confocal points", "confocal 0.4 m", "attenuation"],
)
def test_the_walk_gives_the_same(scene: Scene, capture: Capture) -> None:
    cells = of_cells(scene, capture)
    walk = Accuracy(1 << 14, 4, 4, 1)
    ours, runs = numbers(cells.histogram, cells.overflow), []
    for seed in range(RUNS):
        both = simulate(scene, capture, walk, seed=seed)
        three = simulate(scene, capture, replace(walk, max_bounces=3), seed=seed)
        runs.append(numbers(both.components["secondary"], both.overflow - three.overflow))
    walked = np.array(runs)
    own = OWN * np.maximum(ours, 0.1 * ours[1:].max())
    allowed = stats.t.isf(LEVEL / 2 / len(ours), RUNS - 1) * stats.sem(walked, axis=0) + own
    off = np.abs(ours - walked.mean(axis=0))
    assert (off <= allowed).all(), np.column_stack([ours, walked.mean(axis=0), allowed])[off > allowed]
    assert stats.sem(walked[:, 0]) < 0.02 * walked[:, 0].mean()


def in_the_ball(albedo: float) -> tuple[Scene, Capture, float]:
    ball = unit_ball(3)
    scene = Scene.from_parts([Part("sphere", ball, Lambertian(albedo), "structure")])
    spot = ball.triangles_center[0]
    across = np.cross(spot, [0, 0, 1.0])
    across /= np.linalg.norm(across)
    up = np.cross(across, spot)
    quad = [spot + 1e-3 * (a * across + b * up) for a, b in ((-1, -1), (1, -1), (1, 1), (-1, 1))]
    device = (0.0, 0.0, 0.0)
    capture = Capture(
        Laser(device, [ball.triangles_center[700]]), Sensor(device, [quad], 0.02), bins_of_path(130, 0.05, 0)
    )
    solid_angle = PixelCones.of(capture.sensor).solid_angle[0]
    return scene, capture, albedo**3 / np.pi / (4 * np.pi) * np.pi * 0.02**2 * solid_angle


@pytest.mark.parametrize("albedo", [0.3, pytest.param(1.0, marks=pytest.mark.nightly)])
def test_in_a_sphere_each_bounce_multiplies_by_the_albedo(albedo: float) -> None:
    """The energy is ρ times the primary's ρ³/π · A Ω/(4π r²), because each bounce is uniform on the sphere."""
    scene, capture, primary = in_the_ball(albedo)
    found = of_cells(scene, capture, own=0.02)
    light = found.histogram[0, 0]
    assert light.sum() + found.overflow.sum() == pytest.approx(primary * albedo, rel=0.01)
    ends = capture.laser.targets[0], capture.sensor.pixels[0].mean(axis=0)
    first, second = np.random.default_rng(1).normal(size=(2, 1 << 21, 3))
    first, second = (v / np.linalg.norm(v, axis=1, keepdims=True) for v in (first, second))
    legs = first - ends[0] / np.linalg.norm(ends[0]), second - first, ends[1] / np.linalg.norm(ends[1]) - second
    path = sum(np.linalg.norm(leg, axis=1) for leg in legs)
    truth = np.histogram(path, 130, (0, 6.5))[0] / len(path) * primary * albedo
    assert np.linalg.norm(light - truth) < 0.03 * np.linalg.norm(truth)


def test_small_triangles_are_taken_together() -> None:
    """Meshes whose triangles are each cut into sixteen cost hardly more and give the same light, apart from the
    random choice of triangles that stand for the others."""
    accuracy = Accuracy(target=0.02, max_bounces=4)
    coarse, fine = (simulate(with_meshes(times), scan("exhaustive", 5e-4), accuracy) for times in (0, 2))
    assert coarse.spend is not None and fine.spend is not None
    assert fine.spend.lookins["secondary"] < 1.2 * coarse.spend.lookins["secondary"]
    pair = [run.components["secondary"] for run in (coarse, fine)]
    assert np.linalg.norm(pair[1] - pair[0]) < OWN * np.linalg.norm(pair[0])
    assert pair[1].sum() == pytest.approx(pair[0].sum(), rel=0.01)


def wall_and(*others: Part) -> Scene:
    wall = trimesh.Trimesh([(0, -1.5, 0), (0, 1.5, 0), (0, 1.5, 2.2), (0, -1.5, 2.2)], [(0, 1, 2), (0, 2, 3)])
    return Scene.from_parts([Part("relay_wall", wall, Lambertian(0.7), "relay_wall"), *others])


def ball_at(place: tuple[float, float, float], radius: float) -> trimesh.Trimesh:
    ball = trimesh.creation.icosphere(4, radius=radius)
    return ball.apply_translation(np.array(place) - [0, 0, ball.bounds[0, 2] + radius])


def truth_of(scene: Scene, capture: Capture) -> tuple[float, float]:
    """Energy of the secondary by the reference, and its largest error by chance at `LEVEL`."""
    runs = [
        reference(scene, capture, samples=1 << 12, replicates=1, max_bounces=4, seed=seed, draw=sample_paths)
        .components["secondary"].sum()
        for seed in range(RUNS)
    ]  # fmt: skip
    return float(np.mean(runs)), float(stats.t.isf(LEVEL / 2, RUNS - 1) * stats.sem(runs))


@pytest.mark.nightly
def test_in_the_open_what_is_small_beside_the_sky_is_cut_too() -> None:
    """Three objects in the open catch 4 in 1000 of the light. Two of them would each be one cluster, which give each
    other no light, unless elements are as fine as the light that is caught requires."""
    foreign = foreign_scene(43)
    true, chance = truth_of(foreign.scene, foreign.capture)
    found = of_cells(foreign.scene, foreign.capture, own=0.3)
    assert chance < 0.3 * true
    assert abs(found.histogram.sum() - true) < 0.4 * true + chance


def test_what_touches_is_claimed_as_far_as_it_is_not_known() -> None:
    """A ball of 5120 triangles, far from the wall, is a few clusters. The light that it gives to a floor on which it
    stands is claimed as unknown however many levels agree; high above the floor it is not."""
    floor = trimesh.Trimesh([(0, -1.5, 0), (2.5, -1.5, 0), (2.5, 1.5, 0), (0, 1.5, 0)], [(0, 1, 2), (0, 2, 3)])
    pixel = square_pixels(SPOTS[:1] + np.array([0, 0.2, -0.1]), 5e-4)
    one = Capture(Laser(DEVICE, SPOTS[2:]), Sensor(DEVICE, pixel), TIME)
    for height, low, high in ((0.13, 0.1, 0.3), (1.5, 0.0, 0.06)):
        ball = Part("ball", ball_at((2.0, 0.9, height), 0.13), Lambertian(0.8))
        scene = wall_and(Part("floor", floor, Lambertian(0.7), "structure"), ball)
        found = of_cells(scene, one)
        assert low <= found.error / np.linalg.norm(found.histogram) < high


def test_light_goes_either_way() -> None:
    """Reciprocity: laser point and pixel change places, and each energy is divided by the gain of its pixel."""
    a, b, h = SPOTS[0], SPOTS[2], 5e-4
    found = []
    for laser, pixel in ((a, b), (b, a)):
        capture = Capture(Laser(DEVICE, [laser]), Sensor(DEVICE, square_pixels([pixel], h)), TIME)
        d = np.array(DEVICE) - pixel
        worth = PixelCones.of(capture.sensor).solid_angle[0]
        assert d[0] > 0
        found.append(of_cells(furnished_box(), capture, own=0.03).histogram[0, 0] / worth)
    assert np.linalg.norm(found[0] - found[1]) < 0.03 * np.linalg.norm(found[0])
    assert found[0].sum() == pytest.approx(found[1].sum(), rel=0.01)


def test_confocal_halves_are_the_whole() -> None:
    """Where a laser point is its own pixel each pair of elements is computed once. With the sensor elsewhere, or with
    another pairing, both ends have elements of their own, and the light is the same."""
    confocal, alone = scan("confocal", 5e-4), []
    together = of_cells(furnished_box(), confocal, own=0.03)
    for k, spot in enumerate(SPOTS):
        one = Capture(Laser(DEVICE, [spot]), Sensor(DEVICE, square_pixels([spot], 5e-4)), TIME)
        alone.append(of_cells(furnished_box(), one, own=0.03).histogram[0, 0])
        assert np.linalg.norm(alone[k] - together.histogram[k, 0]) < 0.03 * np.linalg.norm(alone[k])


def test_a_target_takes_cells_for_both_and_repeats_to_the_byte() -> None:
    capture = scan("confocal", 5e-4)
    found = simulate(furnished_box(), capture, Accuracy(target=0.02, max_bounces=4), seed=3)
    again = simulate(furnished_box(), capture, Accuracy(target=0.02, max_bounces=4), seed=3)
    assert found.spend is not None
    assert found.spend.way == {"primary": "cells", "secondary": "cells"}
    assert sum(found.spend.share.values()) == pytest.approx(1.0)
    assert found.met_target
    assert found.error_bound is not None and found.error_bound <= 0.02
    assert found.total.tobytes() == again.total.tobytes()
    higher = simulate(furnished_box(), capture, Accuracy(target=0.05, max_bounces=5), seed=3)
    assert higher.spend is not None
    assert higher.spend.way == {"primary": "cells", "secondary": "cells", "higher": "walk"}
