"""Light of meshes by rays on a lattice: it equals the definition, and its error falls faster than that of samples."""

from __future__ import annotations

import itertools
from dataclasses import replace

import numpy as np
import pytest
import trimesh
from rooms import rectangle

from datagen import (
    Accuracy,
    Capture,
    Lambertian,
    Laser,
    OrenNayar,
    Part,
    Phong,
    Scene,
    Sensor,
    SinLobe,
    TimeAxis,
    simulate,
)
from datagen.records import Material
from datagen.records.arrays import Floats
from datagen.transport.paths import sample_paths
from datagen.transport.problem import Problem
from datagen.transport.quadrature.gathering import Gathering
from datagen.transport.reference import reference

DEVICE = np.array([2.4, -0.9, 1.2])
AXIS = TimeAxis(64, 4e-10, 0.0, "wall")
CORNERS = np.array([[0, -1, -1], [0, 1, -1], [0, 1, 1], [0, -1, 1]])
SPOTS = np.array([[0.0, -0.4, 0.8], [0.0, 0.3, 1.5], [0.0, -0.9, 1.8]])
RUNS, SIGMAS = 8, 5.4
"""Of the definition; and standard errors: by Student's t of 7 degrees one window in a thousand exceeds them."""


def open_torus() -> trimesh.Trimesh:
    torus = trimesh.creation.torus(0.3, 0.1, 48, 32)
    torus.update_faces(torus.triangles_center[:, 0] > -0.15)
    return torus


def scene(material: Material) -> Scene:
    """A wall, half of a torus that hides part of a dented ball, and one wall more."""
    ball = trimesh.creation.icosphere(3, 0.3)
    ball.vertices *= 1.0 + 0.15 * np.sin(17.0 * ball.vertices[:, :1]) * np.sin(13.0 * ball.vertices[:, 1:2])
    return Scene.from_parts([
        Part("wall", rectangle((0, 0, 1.2), (0, 1.5, 0), (0, 0, 1.2)), Lambertian(0.8), "relay_wall"),
        Part("side", rectangle((1, 1.5, 1.2), (1, 0, 0), (0, 0, 1.2)), Lambertian(0.5), "structure"),
        Part("torus", open_torus().apply_translation((0.8, 0.1, 0.9)), material),
        Part("ball", ball.apply_translation((1.4, 0.3, 1.1)), material),
    ])  # fmt: skip


def scan(pairing: str, half_m: float) -> Capture:
    pixels = SPOTS[:, None] + half_m * CORNERS
    return Capture(
        Laser(DEVICE, SPOTS[:2] if pairing == "exhaustive" else SPOTS), Sensor(DEVICE, pixels), AXIS, pairing
    )  # type: ignore[arg-type]


def in_windows(light: Floats) -> Floats:
    """(…, 16) energy of (…, 64)."""
    return light.reshape(*light.shape[:-1], 16, 4).sum(axis=-1)


SCANS = [("confocal", 0.002), ("confocal", 0.1), ("exhaustive", 0.1)]
MATERIALS = [Lambertian(0.7), OrenNayar(0.6, 0.5), SinLobe(0.7, (0, 0, 1))]


@pytest.mark.parametrize(
    ("pairing", "half_m", "material"),
    [
        # By day every scan and every material once.
        pytest.param(*SCANS[i], MATERIALS[k], marks=() if i == k else pytest.mark.nightly)
        for i, k in itertools.product(range(3), range(3))
    ],
    ids=str,
)
def test_light_of_meshes_is_that_of_the_definition(pairing: str, half_m: float, material: Material) -> None:
    """The light of each object in windows of four bins, within chance and half the error asked."""
    room, capture = scene(material), scan(pairing, half_m)
    found = simulate(room, capture, Accuracy(target=0.01, part_target=0.02, max_bounces=3), seed=3)
    assert found.samplers == {"primary": "quadrature"} and found.met_target
    runs = [
        reference(room, capture, samples=1 << 11, replicates=2, seed=s, max_bounces=3, draw=sample_paths)
        for s in range(RUNS)
    ]
    for name in ("torus", "ball"):
        truths = np.array([in_windows(run.parts[name].sum(axis=(0, 1))) for run in runs])
        truth, sigma = truths.mean(axis=0), truths.std(axis=0, ddof=1) / np.sqrt(RUNS)
        assert sigma.max() < 0.03 * truth.max()
        assert (
            np.abs(in_windows(found.parts[name].sum(axis=(0, 1))) - truth) < SIGMAS * sigma + 0.01 * truth.max()
        ).all()


def test_a_laser_point_inside_of_a_mesh_lights_all_of_it() -> None:
    """Where no rectangle frames the mesh, rays go into the whole half space: the energy of a ball about the pixel is
    right."""
    ball = trimesh.creation.icosphere(3, 0.5).apply_translation((0.2, 0.0, 1.0))
    ball.update_faces(np.linalg.norm(ball.triangles_center - DEVICE, axis=1) > 1.95)
    wall = rectangle((0, 0, 1), (0, 0.3, 0), (0, 0, 0.3))
    room = Scene.from_parts([Part("wall", wall, Lambertian(0.8), "relay_wall"), Part("ball", ball, Lambertian(0.7))])
    spots = np.array([[0.0, 0.05, 1.0]])
    capture = Capture(Laser(DEVICE, spots), Sensor(DEVICE, spots[:, None] + 0.05 * CORNERS), AXIS, "confocal")
    runs = [
        reference(room, capture, samples=1 << 13, replicates=2, seed=s, max_bounces=3, draw=sample_paths)
        for s in range(RUNS)
    ]
    truths = np.array([run.parts["ball"].sum() for run in runs])
    found = simulate(room, capture, Accuracy(target=0.01, part_target=0.02, max_bounces=3), seed=3)
    known = truths.std(ddof=1) / np.sqrt(RUNS)
    assert known < 0.005 * truths.mean()
    assert abs(found.parts["ball"].sum() - truths.mean()) < SIGMAS * known + 0.01 * truths.mean()


def test_where_no_rays_are_sent_elements_find_the_same() -> None:
    """A lobe narrower than the lattice resolves is left to elements; a lobe just wide enough for rays gives the same
    light."""
    capture, light = scan("confocal", 0.002), []
    for sharp in (15.5, 16.5):
        exponent = 2 * np.log(2) * sharp
        room = scene(Phong(0.7, exponent=exponent, specular=0.5))
        task = Problem.of(room, capture, Accuracy(target=0.02, max_bounces=3), 0, split_parts=True)
        assert Gathering.of(task).by_rays.any() == (sharp < 16)
        light.append(simulate(room, capture, replace(task.accuracy, target=0.005, part_target=0.02), seed=1))
    for name in ("torus", "ball"):
        one, other = (run.parts[name].sum() for run in light)
        assert one == pytest.approx(other, rel=0.03)


def test_what_a_confocal_pixel_sees_of_a_mesh_is_not_all_that_is_lit() -> None:
    """Where the middle of the pixel stands for all of it, the ball behind the bars is 14 % too bright."""
    bars = [rectangle((0.4, y, 1.0), (0, 0.03, 0), (0, 0, 0.6)) for y in np.linspace(-0.5, 0.5, 9)]
    room = Scene.from_parts([
        Part("wall", rectangle((0, 0, 1.2), (0, 1.5, 0), (0, 0, 1.2)), Lambertian(0.8), "relay_wall"),
        Part("bars", trimesh.util.concatenate(bars), Lambertian(0.3)),
        Part("ball", trimesh.creation.icosphere(3, 0.4).apply_translation((1.2, 0.0, 1.0)), Lambertian(0.7)),
    ])  # fmt: skip
    device, spots = np.array([0.3, -1.2, 1.0]), np.array([[0.0, 0.05, 1.0], [0.0, -0.4, 0.8]])
    capture = Capture(Laser(device, spots), Sensor(device, spots[:, None] + 0.03 * CORNERS), AXIS, "confocal")
    runs = [
        reference(room, capture, samples=1 << 14, replicates=2, seed=s, max_bounces=3, draw=sample_paths)
        for s in range(RUNS)
    ]
    truths = np.array([run.parts["ball"].sum() for run in runs])
    known = truths.std(ddof=1) / np.sqrt(RUNS)
    assert known < 0.002 * truths.mean()
    found = simulate(room, capture, Accuracy(target=0.05, max_bounces=3), seed=1).parts["ball"].sum()
    assert abs(found - truths.mean()) < SIGMAS * known + 0.01 * truths.mean()


def test_light_of_a_large_pixel_near_a_mesh_has_the_right_times() -> None:
    """Light of one footprint arrives over several bins: that of a mesh by rays is that of the same plate of two
    triangles, which has none. If only the mean and the variance of its times counted, it would be 10 % off."""
    plain = rectangle((0.3, 0.1, 1.0), (0, 0.01, 0), (0, 0, 0.01))
    plain.apply_transform(trimesh.transformations.rotation_matrix(-0.3, (0, 0, 1), (0.3, 0.1, 1.0)))
    wall = Part("wall", rectangle((0, 0, 1.2), (0, 1.5, 0), (0, 0, 1.2)), Lambertian(0.8), "relay_wall")
    spot, pixel, time = np.array([[0.0, 0.8, 1.0]]), np.array([[0.0, -0.1, 1.0]]), TimeAxis(256, 2e-11, 0.0, "wall")
    capture = Capture(Laser(DEVICE, spot), Sensor(DEVICE, pixel[:, None] + 0.04 * CORNERS), time, "exhaustive")
    mesh = plain.subdivide().subdivide().subdivide().subdivide()
    found, truth = (
        simulate(
            Scene.from_parts([wall, Part("plate", plate, Lambertian(0.7))]), capture,
            Accuracy(target=target, part_target=2.5 * target, max_bounces=3), seed=1,
        ).parts["plate"]
        for plate, target in ((mesh, 0.05), (plain, 0.005))
    )  # fmt: skip
    assert truth.any()
    assert np.linalg.norm(found - truth) < 0.04 * np.linalg.norm(truth)
