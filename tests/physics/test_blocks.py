"""Blocks (`transport/blocks.py`), one by one, without the effort that decides how many are run: closed forms inside
of a sphere, and plain paths where things stand in each other's way, in fog.

Each block is unbiased, and independent of the others: means over `COUNT` blocks are judged by Student's t.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import trimesh
from numpy.typing import NDArray
from rooms import bins_of_path, furnished_box, one_point_capture, rectangle
from scipy import stats
from sphere_chords import QUAD, SPOT, unit_ball

from datagen import Accuracy, Capture, Lambertian, Laser, Part, Scene, Sensor, simulate
from datagen.transport.blocks import LONGEST, Blocks, BlocksOf
from datagen.transport.fields_of_view import PixelCones
from datagen.transport.problem import Problem

COUNT, LEVEL = 200, 1e-3
APERTURE_M2 = np.pi * 0.02**2
ALBEDO = 0.6
BIN_M = 0.5
"""So wide that light half a bin early would be seen."""


def blocks(scene: Scene, capture: Capture, last: int, count: int = COUNT) -> NDArray[np.float64]:
    """(count, T + 2) light of a capture's one histogram by each of some blocks, before, in and after the window: four
    bounces, or all orders from five to `last`."""
    problem = Problem.of(scene, capture, Accuracy(target=0.1, max_bounces=None), 1, split_parts=False)
    source = BlocksOf(Blocks(problem), last)
    light = np.zeros((count, 1, capture.time.bins + 2), np.float32)
    for number in range(count):
        source.add(0, 0, number, light[number])
    return np.asarray(light[:, 0].astype(float) * source.unit)


def in_the_ball() -> tuple[Scene, Capture, float]:
    """The inside of a sphere, and the energy of its primary (`test_all_bounces.py`)."""
    scene = Scene.from_parts([Part("sphere", unit_ball(5), Lambertian(ALBEDO), "structure")])
    capture = Capture(Laser((0, 0, 0.0), [SPOT]), Sensor((0, 0, 0.0), QUAD), bins_of_path(40, BIN_M, 0.0))
    omega = PixelCones.of(capture.sensor).solid_angle[0]
    return scene, capture, ALBEDO**3 / np.pi / (4 * np.pi) * APERTURE_M2 * omega


@pytest.mark.parametrize(
    ("last", "share"),
    [(4, ALBEDO), (5, ALBEDO**2), (6, ALBEDO**2 + ALBEDO**3), (LONGEST, ALBEDO**2 / (1 - ALBEDO))],
    ids=["4", "5", "5 and 6", "all from 5"],
)
def test_energy_inside_of_a_sphere(last: int, share: float) -> None:
    """Each bounce multiplies the energy by ρ; Russian roulette, from the sixth bounce on, changes nothing."""
    scene, capture, primary = in_the_ball()
    energy = blocks(scene, capture, last).sum(axis=1) / primary
    known = stats.sem(energy)
    # The energy in a polyhedron of the sphere's area is right to second order.
    assert abs(energy.mean() - share) < stats.t.isf(LEVEL / 2, COUNT - 1) * known + 2e-3 * share
    assert known < 0.01 * share


@pytest.mark.parametrize("bounces", [4, 5])
def test_arrival_times_inside_of_a_sphere(bounces: int) -> None:
    """A chord between uniform points is 4/3 of the radius long in the mean, and b bounces have b − 1 of them; a bin
    holds what arrives between its edges."""
    scene, capture, _ = in_the_ball()
    light = blocks(scene, capture, bounces)
    assert not light[:, [0, -1]].any()
    middle = BIN_M * (np.arange(capture.time.bins) + 0.5)
    mean = (light[:, 1:-1].mean(axis=0) * middle).sum() / light.mean(axis=0).sum()
    assert mean == pytest.approx((bounces - 1) * 4 / 3, abs=0.1 * BIN_M)


def screened_room() -> Scene:
    """The furnished room in fog, with screens before laser point, pixel and furniture."""
    room = furnished_box()
    parts = [
        Part(name, trimesh.Trimesh(room.vertices, room.triangles[room.faces_of(name)], process=False), of, role)
        for name, of, role in zip(room.part_names, room.materials, room.roles, strict=True)
    ]
    screens = (
        rectangle((0.3, -0.5, 1.3), (0.1, 0.2, 0), (0, 0, 0.4)),
        rectangle((0.3, 0.1, 1.3), (0.1, -0.2, 0), (0, 0, 0.4)),
        rectangle((1.6, 0.0, 0.9), (0, 0.6, 0.1), (0.1, 0, 0.6)),
    )
    screened = [Part(f"screen {k}", mesh, Lambertian(0.3)) for k, mesh in enumerate(screens)]
    return replace(Scene.from_parts([*parts, *screened]), attenuation_per_m=0.3)


@pytest.mark.parametrize("last", [4, 5])
def test_shadows_and_air_are_those_of_plain_paths(last: int) -> None:
    scene, capture = screened_room(), one_point_capture(time=bins_of_path(30, 0.5, 0.0))
    name, runs = ("secondary" if last == 4 else "higher"), 16
    plain = [simulate(scene, capture, Accuracy(samples=1 << 13, max_bounces=last), seed=s) for s in range(runs)]
    theirs = np.array([run.components[name].sum() for run in plain])
    ours = blocks(scene, capture, last)[:, 1:-1].sum(axis=1)
    known = np.hypot(stats.sem(ours), stats.sem(theirs))
    assert abs(ours.mean() - theirs.mean()) < stats.t.isf(LEVEL / 2, runs - 1) * known
    assert known < 0.02 * theirs.mean()
