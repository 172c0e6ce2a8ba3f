"""The definition (`transport/reference.py`) equals a plainer estimator that shares no code with it.

Plain: points uniform on every triangle, FoV points uniform on the pixel, brute-force intersection of every segment
with every triangle in numpy, box bins, no Sobol', no balance heuristic, no embree.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from rooms import bins_of_path, furnished_box, one_point_capture
from scipy import stats

from datagen import Scene
from datagen.transport.reference import reference

Points = NDArray[np.float64]
BINS, WIDTH_M = 30, 0.4


def blocked(scene: Scene, start: Points, end: Points) -> NDArray[np.bool_]:
    """Möller–Trumbore of n segments against every triangle; ends within 10⁻⁷ of a segment do not count."""
    hit = np.zeros(len(start), np.bool_)
    d = end - start
    for a, b, c in scene.corners:
        e1, e2 = b - a, c - a
        p = np.cross(d, e2)
        with np.errstate(divide="ignore", invalid="ignore"):
            inverse = 1 / (p @ e1)
            s = start - a
            u = np.einsum("ij,ij->i", s, p) * inverse
            q = np.cross(s, e1)
            v = np.einsum("ij,ij->i", d, q) * inverse
            t = (q @ e2) * inverse
            inside = (u >= 0) & (v >= 0) & (u + v <= 1)
        hit |= inside & (t > 1e-7) & (t < 1 - 1e-7)
    return hit


def geometry(scene: Scene, p: Points, n_p: Points, q: Points, n_q: Points) -> tuple[Points, Points]:
    """|cosθ cosθ′| V / R² between points, two-sided, and R; both (n,)."""
    d = q - p
    r = np.linalg.norm(d, axis=1)
    with np.errstate(divide="ignore", invalid="ignore"):
        cosines = np.abs(np.einsum("ij,ij->i", d, n_p) * np.einsum("ij,ij->i", d, n_q)) / r**2
        kernel = np.where(r > 0, cosines / r**2, 0.0)
    return kernel * ~blocked(scene, p, q), r


def surface_points(scene: Scene, rng: np.random.Generator, n: int) -> tuple[Points, Points, NDArray[np.int32], float]:
    """n points uniform on all triangles, normals, parts and the total area."""
    a, b, c = scene.corners[:, 0], scene.corners[:, 1], scene.corners[:, 2]
    cross = np.cross(b - a, c - a)
    area = np.linalg.norm(cross, axis=1) / 2
    face = rng.choice(len(area), n, p=area / area.sum())
    u, v = rng.random((2, n, 1))
    flip = u + v > 1
    u, v = np.where(flip, 1 - u, u), np.where(flip, 1 - v, v)
    point = a[face] + u * (b - a)[face] + v * (c - a)[face]
    return point, (cross / (2 * area[:, None]))[face], scene.face_part[face], float(area.sum())


def plain(scene: Scene, seed: int, n: int) -> Points:
    """Primary and secondary by coarse bin from n samples, (2, BINS)."""
    rng = np.random.default_rng(seed)
    capture = one_point_capture()
    device, x1 = capture.sensor.position, capture.laser.targets[0]
    albedo = np.array([m.albedo for m in scene.materials])
    wall = np.array([[1.0, 0, 0]])
    quad = capture.sensor.pixels[0]
    low, span = quad.min(axis=0), np.ptp(quad, axis=0)
    x4 = low + span * rng.random((n, 3))
    to_sensor = device - x4
    reach = np.linalg.norm(to_sensor, axis=1)
    received = albedo[0] / np.pi * to_sensor[:, 0] / reach**3 * np.pi * 0.02**2 * span[1] * span[2]
    received *= ~blocked(scene, x4, np.broadcast_to(device, x4.shape))

    x2, n2, part2, total = surface_points(scene, rng, n)
    x3, n3, part3, _ = surface_points(scene, rng, n)
    g12, r12 = geometry(scene, np.broadcast_to(x1, x2.shape), np.broadcast_to(wall, x2.shape), x2, n2)
    g24, r24 = geometry(scene, x2, n2, x4, np.broadcast_to(wall, x2.shape))
    g23, r23 = geometry(scene, x2, n2, x3, n3)
    g34, r34 = geometry(scene, x3, n3, x4, np.broadcast_to(wall, x2.shape))
    lit = albedo[0] / np.pi * g12 * total * albedo[part2] / np.pi
    primary = lit * g24 * received
    secondary = lit * g23 * total * albedo[part3] / np.pi * g34 * received
    means = []
    for energy, path in ((primary, r12 + r24), (secondary, r12 + r23 + r34)):
        row = np.floor(path / WIDTH_M).astype(int)
        means.append(np.bincount(row, energy, BINS + 99)[:BINS] / n)
    return np.array(means)


def test_primary_and_secondary_equal_the_plain_estimator() -> None:
    """Energy by component, and by coarse bin, from 16 batches each: Student's t at a family-wise level of 10⁻³."""
    scene, batches = furnished_box(0.8), 16
    capture = one_point_capture(time=bins_of_path(BINS, WIDTH_M, 0.0))
    plainly, ours = np.empty((batches, 2, BINS)), np.empty((batches, 2, BINS))
    for k in range(batches):
        plainly[k] = plain(scene, k, 16_000)
        result = reference(scene, capture, samples=1 << 13, replicates=1, max_bounces=4, seed=k)
        for c, name in enumerate(("primary", "secondary")):
            ours[k, c] = result.components[name][0, 0]
    filled = (plainly > 0).sum(axis=0) > batches // 2
    assert filled.sum() > 30
    difference = ours.mean(axis=0) - plainly.mean(axis=0)
    error = np.hypot(ours.std(axis=0, ddof=1), plainly.std(axis=0, ddof=1)) / np.sqrt(batches)
    assert np.abs(difference[filled] / error[filled]).max() < stats.t.ppf(1 - 0.25e-3 / filled.sum(), batches - 1)
    energies = ours.sum(axis=2) - plainly.sum(axis=2)
    t = energies.mean(axis=0) / (energies.std(axis=0, ddof=1) / np.sqrt(batches))
    assert np.abs(t).max() < stats.t.ppf(1 - 0.25e-3 / 2, batches - 1)
    precision = plainly.sum(axis=2).std(axis=0, ddof=1) / np.sqrt(batches) / plainly.sum(axis=2).mean(axis=0)
    assert precision.max() < 0.05
