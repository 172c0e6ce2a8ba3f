"""Ours against mitransient, an independent path tracer: `pip install '.[peers]'`, LLVM ≥ 19, `pytest -m peers -s`.

Both are run `RUNS` times with independent seeds. If they estimate the same radiance, the differences run by run are
as likely with either sign, so the sum of all differences is compared with that of every choice of signs (a
test whatever the correlation between bins). Ten such tests at 10⁻³: family-wise under 10⁻².

mitransient lifts the origin of a traced ray off its surface by 9·10⁻⁵ (1 + |p|) m and measures the path from there,
so its paths are short by about 0.1 mm a bounce (a bare plate by 0.17 ± 0.03 mm against quadrature, ours by
0.001 ± 0.002): bins here are hundreds of times wider.
"""

from __future__ import annotations

import itertools
from dataclasses import replace

import numpy as np
import pytest
from benchmarks.other_renderers import (
    MitransientPeer,
    grid_points,
    missing_for_mitransient,
    photons_to_radiance,
    plate_quadrature,
    point_capture,
)
from numpy.typing import NDArray
from rooms import bins_of_path, furnished_box, rectangle
from scipy import stats

from datagen.records import Accuracy, Capture, Lambertian, Part, Rectangle, Scene
from datagen.transport import simulate

RUNS = 12
LEVEL = 1e-3
WALL = Rectangle.of((0, 0, 1.25), (0, 1.5, 0), (0, 0, 1.25))
DEVICE = np.array([1.5, 0.1, 1.3])
LASER_POINT = np.array([0.0, -0.8, 1.4])
AXIS = bins_of_path(170, 0.1, 0.0)
COLUMNS = ROWS = 4

needs_mitransient = pytest.mark.skipif(missing_for_mitransient() is not None, reason=str(missing_for_mitransient()))


def room() -> Scene:
    """The furnished box with an albedo of its own for every part."""
    scene = furnished_box()
    return replace(scene, materials=tuple(Lambertian(a) for a in (0.8, 0.65, 0.4, 0.9, 0.5, 0.7)))


def room_capture() -> Capture:
    return point_capture(WALL, grid_points(WALL, COLUMNS, ROWS), DEVICE, LASER_POINT[None], AXIS)


def ours_in_room(bounces: int) -> NDArray[np.float64]:
    """(run, component, pixel, bin): the primary, then the secondary if asked for."""
    capture = room_capture()
    accuracy = Accuracy(samples=1 << 15, max_bounces=bounces)
    names = ("primary", "secondary")[: bounces - 2]
    runs = [simulate(room(), capture, accuracy, seed=seed, split_parts=False) for seed in range(RUNS)]
    return np.array([[photons_to_radiance(run.components[name], capture)[0] for name in names] for run in runs])


def theirs_in_room(bounces: int) -> NDArray[np.float64]:
    """(run, pixel, bin)."""
    peer = MitransientPeer(
        room(), "relay_wall", WALL, DEVICE, LASER_POINT, columns=COLUMNS, rows=ROWS, axis=AXIS, bounces=bounces
    )
    return np.array([peer.render(1 << 16, seed=100 * bounces + run) for run in range(RUNS)])


def sign_test(differences: NDArray[np.float64]) -> float:
    """Share of all choices of signs of the runs under which ‖Σ ± difference‖ is no smaller than as measured."""
    rows = differences.reshape(len(differences), -1)
    gram = rows @ rows.T
    signs = np.array([(1, *rest) for rest in itertools.product((1, -1), repeat=len(rows) - 1)])
    norms = np.einsum("si,ij,sj->s", signs, gram, signs)
    return float((norms >= norms[0] * (1 - 1e-9)).mean())


def compare(
    name: str,
    ours: NDArray[np.float64],
    theirs: NDArray[np.float64],
    energy_tolerance: float = 2e-3,
    largest_noise: float = 0.02,
) -> None:
    """Print energy ratio and relative L2, and hold both against the tolerance and the two standard errors."""
    mean_o, mean_t = ours.mean(axis=0), theirs.mean(axis=0)
    norm = np.linalg.norm(mean_t)
    noise_o, noise_t = (np.linalg.norm(x.std(axis=0, ddof=1)) / np.sqrt(RUNS) / norm for x in (ours, theirs))
    distance = np.linalg.norm(mean_o - mean_t) / norm
    energies = ours.sum(axis=(1, 2)), theirs.sum(axis=(1, 2))
    ratio = energies[0].mean() / energies[1].mean()
    ratio_error = np.hypot(*(stats.sem(e) / e.mean() for e in energies))
    differences = ours - theirs
    # Bins that are well filled, by their own noise; where paths are rare the runs are too skew for a test of signs.
    filled = mean_t > 0.02 * mean_t.max()
    scaled = differences[:, filled] / np.sqrt((differences[:, filled] ** 2).mean(axis=0))
    p_plain, p_scaled = sign_test(differences), sign_test(scaled)
    print(
        f"\n{name}: energy ours / mitransient = {ratio:.5f} ± {ratio_error:.5f}; relative L2 per bin {distance:.4%}, "
        f"standard errors {noise_o:.4%} (ours) and {noise_t:.4%}; sign tests p = {p_plain:.3f}, {p_scaled:.3f}"
    )
    # The comparison means something only where the noise is small against the tolerance.
    assert ratio_error < energy_tolerance / 3
    assert np.hypot(noise_o, noise_t) < largest_noise
    assert abs(ratio - 1) < energy_tolerance
    assert distance < 2 * np.hypot(noise_o, noise_t)
    assert p_plain >= LEVEL
    assert p_scaled >= LEVEL


@pytest.mark.peers
@needs_mitransient
def test_three_bounces_in_a_furnished_room() -> None:
    compare("3 bounces", ours_in_room(3)[:, 0], theirs_in_room(3))


@pytest.mark.peers
@needs_mitransient
def test_three_and_four_bounces_in_a_furnished_room() -> None:
    ours, both, three = ours_in_room(4), theirs_in_room(4), theirs_in_room(3)
    compare("3 + 4 bounces", ours.sum(axis=1), both)
    compare("4 bounces alone", ours[:, 1], both - three, energy_tolerance=1e-2, largest_noise=0.1)


@pytest.mark.peers
@needs_mitransient
def test_confocal_plate_three_ways() -> None:
    """A bare plate scanned confocally: quadrature, mitransient at its best, and ours."""
    scan = Rectangle.of((0, 0, 0), (0, 0.4, 0), (0, 0, 0.4))
    # Its normal towards the wall: mitransient's hidden-geometry sampling sees front faces only.
    plate = Rectangle.of((1, 0.05, -0.1), (-0.05, -0.25, 0), (0, 0, 0.25))
    parts = (("wall", scan, 0.8), ("plate", plate, 0.6))
    scene = Scene.from_parts(
        Part(name, rectangle(r.center, r.right, r.up), Lambertian(albedo)) for name, r, albedo in parts
    )
    axis = bins_of_path(12, 0.1, 1.65)
    points, device = grid_points(scan, 4, 4), np.array([0.5, 0.0, 0.0])
    truth = plate_quadrature(points, scan.normal, plate, (0.8, 0.6), axis, 1500)
    peer = MitransientPeer(scene, "wall", scan, device, None, 4, 4, axis, bounces=3, aim_at_hidden=True)
    theirs = np.array([peer.render(1 << 14, seed=run) for run in range(RUNS)])
    capture = point_capture(scan, points, device, points, axis, confocal=True)
    accuracy = Accuracy(samples=1 << 14, max_bounces=3)
    ours = np.array(
        [
            photons_to_radiance(simulate(scene, capture, accuracy, s, split_parts=False).total, capture)[:, 0]
            for s in range(RUNS)
        ]
    )
    compare("bare plate, confocal", ours, theirs)
    for runs in (ours, theirs):
        assert runs.mean(axis=0).sum() == pytest.approx(truth.sum(), rel=5e-4)
        noise = np.linalg.norm(runs.std(axis=0, ddof=1)) / np.sqrt(RUNS)
        assert np.linalg.norm(runs.mean(axis=0) - truth) < 2 * noise
