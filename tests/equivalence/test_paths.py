"""Paths drawn where light is (`transport/paths.py`) equal the definition (`transport/reference.py`).

The definition's vertices are uniform on all surfaces: it has no quasi-random numbers, no sampling of BRDFs and no
weighting of densities. Energies of each order, part, histogram and window of time from `RUNS` runs of both are
compared by Student's t at a family-wise level of `LEVEL` for each case. `test_all_ways.py` does so for every BRDF.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
import trimesh
from benchmarks.ways import CAPTURES, DEVICE, TIME, energies, scene_of
from numpy.typing import NDArray
from rooms import bins_of_path, furnished_box, one_point_capture, rectangle, square_pixels
from scipy import stats

from datagen import Accuracy, Capture, Lambertian, Laser, Part, Scene, Sensor
from datagen.records import Transient
from datagen.seeding import LightStream
from datagen.transport.path_light import Rows
from datagen.transport.paths import AT_ONCE, sample_paths
from datagen.transport.problem import Problem
from datagen.transport.reference import pairs_of, reference
from datagen.transport.sampling import stream_seeds
from datagen.units import time_from_path

RUNS, LEVEL = 16, 1e-4
PLAIN, SAMPLED = 1 << 15, 1 << 11
WELL_KNOWN = 0.05


def numbers(run: Transient) -> NDArray[np.float64]:
    return np.concatenate([list(energies(run, light).values()) for light in (*run.components, *run.parts, "whole")])


def hold(scene: Scene, capture: Capture, plain_samples: int = PLAIN, **asked: object) -> None:
    def runs(samples: int, **how: object) -> NDArray[np.float64]:
        return np.array([
            numbers(reference(scene, capture, samples=samples, replicates=1, seed=seed, **asked, **how))  # type: ignore[arg-type]
            for seed in range(RUNS)
        ])  # fmt: skip

    plain, sampled = runs(plain_samples // len(pairs_of(capture))), runs(SAMPLED, draw=sample_paths)
    # Light that only few runs met has a spread that says nothing about its error.
    often = ((plain > 0).sum(axis=0) >= RUNS - 2) & ((sampled > 0).sum(axis=0) >= RUNS - 2)
    off = plain.mean(axis=0) - sampled.mean(axis=0)
    noise = np.hypot(plain.std(axis=0, ddof=1), sampled.std(axis=0, ddof=1)) / np.sqrt(RUNS)
    t = stats.t.isf(LEVEL / 2 / often.sum(), RUNS - 1)
    # The direct return has no noise, only rounding.
    allowed = t * noise + 1e-12 * plain.max()
    assert (np.abs(off) <= allowed)[often].all(), np.column_stack([plain.mean(0), sampled.mean(0), noise])[often]
    largest = int(np.argmax(sampled.mean(axis=0)))
    assert noise[largest] < WELL_KNOWN * sampled.mean(axis=0)[largest]


@pytest.mark.parametrize(
    ("laser", "origin"),
    [((0.9, 0.4, 0.0), "wall"), ((0.0, 0.2, 1.2), "source")],
    ids=["on the floor", "in the pixel"],
)
def test_in_fog_with_the_direct_return_and_five_bounces(laser: tuple[float, float, float], origin: str) -> None:
    """Away from corners, whose short paths the definition's uniform vertices hardly ever meet."""
    scene = replace(furnished_box(0.8), attenuation_per_m=0.3)
    capture = one_point_capture(laser, (0, 0.2, 1.2), 0.15, bins_of_path(96, 0.25, 0.0))
    hold(scene, replace(capture, time=replace(capture.time, origin=origin)), max_bounces=5, direct=True)


@pytest.mark.parametrize("bounces", [1, 2])
def test_direct_light_alone(bounces: int) -> None:
    capture = one_point_capture((0.9, 0.4, 0.0), (0, 0.2, 1.2), 0.15, bins_of_path(96, 0.25, 0.0))
    if bounces == 1:
        capture = one_point_capture((0.0, 0.2, 1.2), (0, 0.2, 1.2), 0.15, bins_of_path(96, 0.25, 0.0))
    scene = replace(furnished_box(0.8), attenuation_per_m=0.1)
    runs = [
        reference(scene, capture, samples=1 << 14, replicates=8, max_bounces=bounces, direct=True, **how)  # type: ignore[arg-type]
        for how in ({}, {"draw": sample_paths})
    ]
    plain, sampled = (run.components["direct"] for run in runs)
    noise = np.sqrt(sum((run.stderr**2).sum() for run in runs))
    assert plain.sum() > 0 and abs(plain.sum() - sampled.sum()) < 4 * noise + 1e-9 * plain.sum()


def test_pixels_of_uneven_sensitivity() -> None:
    """Also of light that lands in the pixel, and of the laser point's own; a mirror-like plate sends much of both."""
    shares = np.array([[[0.0, 1.0, 2.0], [3.0, 0.5, 1.0]], [[1.0, 0.0, 0.0], [2.0, 4.0, 0.0]]])
    points = np.array([[0, 0.2, 0.7], [0, -0.3, 1.3]])
    sensor = Sensor(DEVICE, square_pixels(points, 0.15), footprints=shares)
    capture = Capture(Laser(DEVICE, [[0, 0.3, 0.75]]), sensor, TIME)
    hold(scene_of("phong 10", "plate"), capture, max_bounces=3, direct=True)


def test_what_stands_before_a_wide_pixel_hides_the_wall_behind() -> None:
    """A shield before half of a pixel: light that lands behind it stays unseen."""
    far, device = np.array([0, 0.2, 0.7]), np.array(DEVICE)
    across = np.array([1.3, 0.6, 0.0]) / np.hypot(1.3, 0.6) * 0.25
    up = np.cross(across, device - far)
    shield = rectangle((far + device) / 2 - across, across, up / np.linalg.norm(up) * 0.4)
    scene = scene_of("phong 60", "plate")
    parts = [
        Part(name, trimesh.Trimesh(scene.vertices, scene.triangles[scene.faces_of(name)], process=False), of, role)
        for name, of, role in zip(scene.part_names, scene.materials, scene.roles, strict=True)
    ]
    scene = Scene.from_parts([*parts, Part("shield", shield, Lambertian(0.5))])
    sensor = Sensor(DEVICE, square_pixels([far], 0.4))
    capture = Capture(Laser(DEVICE, [[0.5, 0.5, 0]]), sensor, TIME)
    # Such light would be 3 % more.
    hold(scene, capture, plain_samples=1 << 18, max_bounces=2, direct=True)


def test_a_beam_lights_all_of_its_cells() -> None:
    """Cells and pixels so large that the middles of the cells would give other light."""
    laser = Laser.flood(DEVICE, (0, 0, 1.0), (0, 0.6, 0), (0, 0, 0.5), rows=1, columns=2, weights=[3.0, 1.0])
    sensor = Sensor.grid(DEVICE, (0, 0, 1.0), (0, 0.6, 0), (0, 0, 0.5), rows=1, columns=2)
    capture = Capture(laser, sensor, TIME, illumination="flood")
    scene = scene_of("lambertian 0.6", "box")
    hold(scene, capture, max_bounces=3, direct=True)
    middles = replace_cells(capture)
    with_cells, without = (
        reference(scene, seen, samples=1 << 13, replicates=4, direct=True, draw=sample_paths)
        for seen in (capture, middles)
    )
    off = np.abs(with_cells.components["direct"] - without.components["direct"]).sum()
    assert off > 0.05 * without.components["direct"].sum()


def replace_cells(capture: Capture) -> Capture:
    laser = Laser(capture.laser.position, capture.laser.targets, capture.laser.weights)
    return replace(capture, laser=laser)


def test_light_is_that_of_the_paths() -> None:
    """`Rows.light` adds up the paths of `sample_paths` by row and bin, also before and after the window."""
    scene, capture = scene_of("ggx 0.6", "box"), CAPTURES["confocal"]()
    time = replace(capture.time, start_s=float(time_from_path(2.0)), bins=20)
    capture = replace(capture, time=time)
    problem = Problem.of(scene, capture, Accuracy(samples=1), seed=3, split_parts=True)
    pairs, parts, samples = pairs_of(capture), len(scene.part_names), 4096
    # Single bounces into row 0, primaries by part, all higher orders into the last row; those of two bounces nowhere.
    table = np.stack([np.zeros(parts), -np.ones(parts), 1 + np.arange(parts), np.full(parts, parts + 1)]).astype(int)
    rows, every = Rows({"all": slice(0, parts + 2)}, table, last=5, direct=True), np.arange(len(pairs))
    light = rows.light(problem, every, len(pairs), samples, (7,))
    paths = sample_paths(
        problem.caster, scene, problem.materials, capture, pairs, samples, max_bounces=5, direct=True,
        seed=int(stream_seeds(3, LightStream.PATHS, 7)[0]),
    )  # fmt: skip
    assert len(pairs) * samples <= AT_ONCE
    expected = np.zeros_like(light)
    row = table[np.minimum(paths.order, 4) - 1, paths.part]
    column = np.clip(np.floor((time_from_path(paths.path_m) - time.start_s) / time.width_s), -1, time.bins) + 1
    np.add.at(expected, (row[row >= 0], paths.pair[row >= 0], column.astype(int)[row >= 0]), paths.photons[row >= 0])
    # There is light before and after the window, and in each row but that of three bounces by way of the wall.
    assert (expected.sum(axis=(0, 1))[[0, -1]] > 0).all() and (expected.sum(axis=(1, 2)) > 0).sum() == parts + 1
    np.testing.assert_allclose(light, expected, rtol=1e-12, atol=0)


@pytest.mark.parametrize("draw", [pytest.param(None, marks=pytest.mark.nightly), sample_paths])
def test_all_orders_in_a_white_room(draw: Callable[..., object] | None) -> None:
    """Orders of three and more, from runs of unlimited bounces, bring at least the light of runs up to six
    bounces."""
    room, capture = furnished_box(0.8), one_point_capture(time=bins_of_path(96, 0.5, 0.0))
    how = {} if draw is None else {"draw": draw}
    every, some = (
        reference(room, capture, samples=PLAIN, replicates=4, max_bounces=last, **how)  # type: ignore[arg-type]
        for last in (None, 6)
    )
    noise = np.sqrt((every.stderr**2).sum() + (some.stderr**2).sum())
    assert every.total.sum() > some.total.sum() - 4 * noise
    assert every.components["higher"].sum() > 1.05 * some.components["higher"].sum() - 4 * noise
