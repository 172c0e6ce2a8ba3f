"""Stochastic cuts (`transport/cuts.py`): no bias in energy and time, whatever the effort, and errors as claimed.

Means over `SEEDS` seeds of coarse runs are compared with those of sampled paths, which share only the BRDFs and the
rays: energy of each part, of what arrives outside the window, and by windows of time, by Student's t at a family-wise
level of `LEVEL` for each case.
"""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
import trimesh
from rooms import bins_of_path, furnished_box, one_point_capture, rectangle, square_pixels
from scipy import stats

from datagen import GGX, Accuracy, Capture, Lambertian, Laser, Part, Scene, Sensor, Transient, simulate
from datagen.bench.plain_check import PlainPaths
from datagen.transport.cuts import AT_LEAST, Cuts, _Known, outer_sides
from datagen.transport.cuts import _precision as precision_of
from datagen.transport.paths import sample_paths
from datagen.transport.problem import Problem
from datagen.transport.reference import reference

SEEDS, LEVEL = 30, 1e-4
SPREAD = 0.03
"""Share of the light that may arrive in a neighbouring window where 10 % of error are asked."""
FAINT = 2e-3
"""Windows with a smaller share of the light are not compared: few paths find them."""
DEVICE = np.array([1.2, -0.5, 0.1])
WALL = Part("wall", rectangle((0, 0, 0), (0, 2, 0), (0, 0, 2)), Lambertian(0.8), "relay_wall")
TIME = bins_of_path(96, 0.05, 0.0)


def of_objects(**meshes: trimesh.Trimesh) -> Scene:
    return Scene.from_parts([WALL, *(Part(name, mesh, Lambertian(0.6)) for name, mesh in meshes.items())])


def ball(radius: float, *center: float) -> trimesh.Trimesh:
    return trimesh.creation.icosphere(3, radius).apply_translation(center)


def looking_at(*pixel: float, half_m: float = 0.1, laser: tuple[float, ...] = (0, -0.6, 0)) -> Capture:
    return Capture(Laser(DEVICE, [laser]), Sensor(DEVICE, square_pixels([pixel], half_m)), TIME)


def numbers(run: Transient) -> tuple[list[float], list[float]]:
    """Energies of the parts, of what is outside the window, and of all; energies by windows of 8 bins."""
    windows = run.total.sum(axis=(0, 1)).reshape(-1, 8).sum(axis=1)
    parts, outside = [light.sum() for light in run.parts.values()], run.overflow.sum()
    return [*parts, outside, outside + windows.sum()], list(windows)


def coarse(scene: Scene, capture: Capture) -> list[Transient]:
    accuracy = Accuracy(target=0.1, part_target=1.0, max_bounces=3)
    return [simulate(scene, capture, accuracy, seed=s) for s in range(SEEDS)]


def agree(scene: Scene, capture: Capture) -> list[Transient]:
    """Compare coarse runs with sampled paths; returns the runs."""
    runs = coarse(scene, capture)
    assert {run.samplers["primary"] for run in runs} <= {"cuts", "paths"}
    paths = [
        reference(scene, capture, samples=1 << 13, replicates=1, seed=s, draw=sample_paths) for s in range(SEEDS)
    ]
    for kind in (0, 1):
        ours, theirs = (np.array([numbers(run)[kind] for run in of]) for of in (runs, paths))
        a, b, noise = ours.mean(axis=0), theirs.mean(axis=0), np.hypot(stats.sem(ours), stats.sem(theirs))
        bright = a + b > FAINT * b.max()
        allowed = stats.t.isf(LEVEL / 4 / bright.sum(), SEEDS - 1) * noise + SPREAD * b.max()
        assert (np.abs(a - b) <= allowed)[bright].all(), np.column_stack([a, b, noise])[bright]
        assert noise[b.argmax()] < 0.05 * b.max(), "known well enough to tell"
    return runs


SCREEN = rectangle((0.5, 0.4, 0), (0, 0.4, 0), (0, 0, 1.0))
BEHIND = rectangle((1.6, 0.2, 0), (0, 1.0, 0), (0, 0, 0.8))
BARS = trimesh.util.concatenate(
    [rectangle((0.4, y, 0), (0, 0.03, 0), (0, 0, 0.6)) for y in np.linspace(-0.5, 0.5, 9)]
)
PLATE = rectangle((0.3, 0.3, 0), (0.3, 0, 0), (0, 0, 0.5))
BOX = trimesh.creation.box(bounds=[(-0.1, -0.9, -0.3), (0.3, -0.3, 0.3)])
CASES = {
    "a ball behind bars": (of_objects(ball=ball(0.3, 1.2, 0.2, 0.1), bars=BARS, back=BEHIND), looking_at(0, 0.3, 0)),
    "a pixel at an edge": (
        of_objects(screen=SCREEN, behind=BEHIND, ball=ball(0.2, 0.3, 1.1, 0.0)), looking_at(0, -0.1, 0.1, half_m=0.3),
    ),
    "a pixel over the end of the wall": (of_objects(behind=BEHIND), looking_at(0, 1.95, 0.1, half_m=0.2)),
    # A laser point 1 mm from a plate that stands within the pixel: legs of a millimetre have much of the light.
    "a plate that touches": (of_objects(plate=PLATE), looking_at(0, 0.25, 0.0, laser=(0, 0.299, 0.0))),
    "a pixel on both sides of a plate": (of_objects(plate=PLATE), looking_at(0, 0.34, 0)),
    "a laser point in a closed box": (of_objects(box=BOX, behind=BEHIND), looking_at(0, -0.5, 0.1)),
}  # fmt: skip


@cache
def agreed(case: str) -> list[Transient]:
    return agree(*CASES[case])


@pytest.mark.parametrize("case", CASES)
def test_the_mean_over_seeds_is_that_of_paths(case: str) -> None:
    agreed(case)


def test_a_triangle_with_all_corners_hidden_brings_the_light_of_its_middle() -> None:
    """One corner lies below the surface at the laser point, the others below that of the pixel, so that no corner
    has both in sight: each height is to be judged by itself."""
    floor = Part("floor", rectangle((1, 0.5, 0), (1, 0, 0), (0, 1.5, 0)), Lambertian(0.7), "structure")
    corners = np.array([(-0.5, 0.8, 0.9), (1.1, 0.6, -0.3), (0.9, 1.1, -0.4)])
    plate = Part("plate", trimesh.Trimesh(corners, [(0, 1, 2)], process=False), Lambertian(0.6))
    device, pixel = (
        (1.5, -0.5, 1.5),
        [[0.6, 0.2, 0.0]] + 0.1 * np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]]),
    )
    capture = Capture(Laser(device, [(0, 0.2, 0.6)]), Sensor(device, [pixel]), TIME)
    runs = agree(Scene.from_parts([WALL, floor, plate]), capture)
    assert ((corners[:, 0] <= 0) | (corners[:, 2] <= 0)).all() and runs[0].parts["plate"].any()


@pytest.mark.parametrize("inverted", [False, True])
def test_a_device_within_a_closed_ball_loses_no_light(inverted: bool) -> None:
    """All light meets the ball from within, which `outer_sides` expects least, or most."""
    around = ball(1.5, 0.4, 0.0, 0.0)
    if inverted:
        around.invert()
    scene = of_objects(around=around, inner=ball(0.2, 0.8, 0.3, 0.2))
    assert outer_sides(scene)[1] == (-1 if inverted else 1)
    agree(scene, looking_at(0, 0.3, 0))


def test_outer_sides_of_closed_meshes_alone() -> None:
    box = trimesh.creation.box((0.3, 0.3, 0.3))
    inverted, opened = box.copy(), trimesh.Trimesh(box.vertices, box.faces[1:], process=False)
    inverted.invert()
    two = trimesh.util.concatenate([box, box.copy().apply_translation((1, 0, 0))])
    turned = trimesh.Trimesh(box.vertices, np.concatenate([box.faces[:1, ::-1], box.faces[1:]]), process=False)
    scene = of_objects(box=box, inverted=inverted, opened=opened, two=two, turned=turned)
    np.testing.assert_array_equal(outer_sides(scene), [0, 1, -1, 0, 1, 0])


def test_light_after_the_end_of_the_window_is_overflow() -> None:
    """A window that ends within the light has, with its overflow, the energy of a long one."""
    scene, capture = CASES["a ball behind bars"]
    found = agreed("a ball behind bars"), coarse(scene, replace(capture, time=bins_of_path(48, 0.05, 0.6)))
    long, short = (np.array([run.total.sum() + run.overflow.sum() for run in runs]) for runs in found)
    known = np.hypot(stats.sem(long), stats.sem(short))
    assert abs(long.mean() - short.mean()) < stats.t.isf(LEVEL / 2, SEEDS - 1) * known
    assert known < 0.02 * long.mean() and 0.1 < np.mean([run.overflow.sum() for run in found[1]]) / long.mean() < 0.9


def test_an_object_that_few_elements_meet_is_not_lost() -> None:
    """A ball behind a fence with gaps, which brings 1/2300 of the light: coarse elements mostly miss the gaps."""
    fence = trimesh.util.concatenate(
        [rectangle((0.7, y, 0), (0, 0.046, 0), (0, 0, 0.8)) for y in np.linspace(-0.2, 0.6, 9)]
    )
    back = rectangle((0.5, -0.9, 0), (0.5, 0, 0), (0, 0, 1.2))
    parts = [
        Part("fence", fence, Lambertian(0.02), "structure"), Part("back", back, Lambertian(0.4), "structure"),
        Part("ball", ball(0.15, 1.2, 0.2, 0.1), Lambertian(0.9)),
    ]  # fmt: skip
    scene = Scene.from_parts([WALL, *parts])
    capture = looking_at(0, 0.1, 0, half_m=0.05)
    runs = [simulate(scene, capture, Accuracy(target=0.05), seed=s) for s in range(12)]
    energy = np.array([run.parts["ball"].sum() for run in runs])
    assert 2e-4 < energy.mean() / np.mean([run.total.sum() for run in runs]) < 1e-3, "faint, and counted"
    assert (np.abs(energy / energy.mean() - 1) < 0.5).all(), energy / energy.mean()
    assert all(run.part_errors["ball"] < 0.2 for run in runs)


def test_efforts_meet_the_targets_of_the_whole_and_of_objects() -> None:
    """The groups' squared errors a²/W add up to what is asked of the whole, with equal W but for objects that need
    more by themselves."""
    scene, capture = CASES["a ball behind bars"]
    cuts = Cuts(Problem.of(scene, capture, Accuracy(target=0.1, part_target=0.2), 0, split_parts=True), 0.1)
    light = np.zeros((len(scene.part_names), 1, 4))
    light[:, 0, 0] = 0.0, 0.05, 1.0, 2.0
    squares, whole = np.array([1e-6, 3e-4, 5e-4, 0.0]), light.sum()
    ball, bars, back, _ = precision_of(cuts, _Known(light, light.sum(axis=0), squares, 1.0), 1.0, 0.1)
    own = squares[:3] / (0.2 * light[1:, 0, 0]) ** 2
    assert ball == pytest.approx(max(own[0], bars), rel=1e-12, abs=0)
    assert (np.array([ball, bars, back]) >= own * (1 - 1e-12)).all()
    assert (squares[:3] / np.array([ball, bars, back])).sum() == pytest.approx((0.1 * whole) ** 2, rel=1e-9, abs=0)


@pytest.mark.parametrize("glossy", [False, True])
def test_claims_are_the_errors_there_are(glossy: bool) -> None:
    """Root mean square of the true errors of some seeds over that of their claims. Of one pair, half of whose wall is
    behind a box, runs share more than is counted: their claims are short by up to 1.7."""
    scene, capture = furnished_box(), one_point_capture(half_side_m=0.05)
    if glossy:
        scene = replace(scene, materials=(*scene.materials[:-2], *2 * [GGX(0.7, roughness=0.3)]))
    truth = PlainPaths.of(scene, capture, Accuracy(), 1 << 17, 99)
    runs = [simulate(scene, capture, Accuracy(target=0.05), seed=s) for s in range(SEEDS)]
    true = np.mean([truth.check(run.total, "primary").square for run in runs])
    assert 0.7 < np.sqrt(true / np.mean([run.relative_error**2 for run in runs])) < 1.8


def test_a_run_has_a_bounded_number_of_elements_however_little_each_may_bring() -> None:
    """Beside those of what is near, which a run of the coarsest elements has, at most `Cuts.most` for each histogram
    and replicate; the light is still all there."""
    scene, capture = furnished_box(), one_point_capture(half_side_m=0.01, time=TIME)
    cuts = Cuts(Problem.of(scene, capture, Accuracy(target=0.02), 0, split_parts=True), 0.02)
    every, groups = np.arange(1), cuts.groups.max() + 1
    coarse_run = cuts.run(every, np.full(groups, np.inf), 0)
    photons = float(coarse_run.light.sum() + coarse_run.outside.sum())
    fine = cuts.run(every, np.full(groups, 1e-5 * photons), 0)
    cuts.most = 1 << 7
    bound = 2 * (cuts.most * AT_LEAST + coarse_run.samples)
    assert fine.samples > 2 * bound and not cuts.is_limited
    for share in (1e-5, 1e-30):
        run = cuts.run(every, np.full(groups, share * photons), 0)
        assert run.samples <= bound and cuts.is_limited
        assert run.light.sum() + run.outside.sum() == pytest.approx(fine.light.sum() + fine.outside.sum(), rel=0.2)
