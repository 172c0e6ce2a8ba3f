"""A beam that states its cells, and pixels with footprints: what a sensor sees that looks straight at things."""

from __future__ import annotations

import warnings

import numpy as np
import pytest
import trimesh
from rooms import ONE_BOUNCE, bins_of_path, furnished_box, plane_ahead, rectangle, square_pixels
from scipy.stats import chi2, sem, t

import datagen as dg
from datagen.errors import InputError
from datagen.records import Capture, Scene
from datagen.transport.brdf import MaterialTable
from datagen.transport.flood import one_bounce_by_angle, one_bounce_of_beam, two_bounces_of_beam
from datagen.transport.rays import Raycaster
from datagen.transport.reference import reference

DEVICE, LASER = np.zeros(3), np.array([0.0, 0.02, 0.01])
at = trimesh.transformations.translation_matrix


def scene() -> Scene:
    """A slanted plate, a glossy ball before it, and a wall beside them, in front of a device that looks along x."""
    plate = trimesh.creation.box((0.02, 1.2, 1.2), trimesh.transformations.rotation_matrix(0.4, (0, 0, 1)))
    parts = [
        dg.Part("plate", plate.apply_translation((0.8, 0, 0)), dg.Lambertian(0.7), role="relay_wall"),
        dg.Part("wall", trimesh.creation.box((1, 0.02, 1), at((0.5, 0.5, 0))), dg.Lambertian(0.6), role="structure"),
        dg.Part("ball", trimesh.creation.icosphere(3, 0.12).apply_translation((0.5, -0.1, 0.05)),
                dg.Phong(0.5, exponent=4)),
    ]  # fmt: skip
    return dg.Scene.from_parts(parts)


def footprints(pixels: int, rows: int = 6, columns: int = 5) -> np.ndarray:
    return np.random.default_rng(3).uniform(0.0, 1.0, (pixels, rows, columns))


def captured(cells: int, bins: int = 40, **sensor: object) -> Capture:
    """A flood of cells × cells, and 2 × 2 zones that overlap."""
    laser = dg.Laser.flood(LASER, (1, 0, 0), (0, -0.4, 0), (0, 0, 0.35), cells, cells,
                           np.linspace(1, 2, cells**2))  # fmt: skip
    middles = [(1, y, z) for z in (0.1, -0.1) for y in (0.12, -0.12)]
    corners = [[(1, y + 0.2, z - 0.2), (1, y - 0.2, z - 0.2), (1, y - 0.2, z + 0.2), (1, y + 0.2, z + 0.2)]
               for _, y, z in middles]  # fmt: skip
    seen = dg.Sensor(DEVICE, np.array(corners), 1e-3, **sensor)  # type: ignore[arg-type]
    axis = dg.TimeAxis(bins, 250e-12, origin="source")
    return dg.Capture(laser, seen, axis, "exhaustive", "flood")


@pytest.mark.parametrize("bounces", [1, 2, 4])
def test_a_beam_with_footprints_equals_the_definition(bounces: int) -> None:
    """χ² of all bins against plain samples, at a level of 10⁻⁶; the bins of all pixels count together."""
    capture, room = captured(3, footprints=footprints(4)), scene()
    accuracy = dg.Accuracy(samples=1024, max_bounces=bounces, direct=True)
    ours = dg.simulate(room, capture, accuracy, seed=1)
    plain = reference(room, capture, samples=1024, replicates=16, max_bounces=bounces, direct=True, seed=2)
    assert set(ours.components) <= set(plain.components)
    stderr = np.hypot(np.nan_to_num(ours.stderr), plain.stderr)
    bright = plain.total > 1e-3 * plain.total.max()
    # Light of one bounce has an error of its own: its rays end in the bins of their own places.
    grain = 0.004 * plain.total.max()
    normal = (ours.total - plain.total)[bright] / np.hypot(stderr, grain)[bright]
    assert bright.sum() > 10
    assert (normal**2).sum() < chi2.isf(1e-6, bright.sum())
    energy, noise = ours.total.sum(axis=2) - plain.total.sum(axis=2), np.sqrt((stderr**2).sum(axis=2))
    assert (np.abs(energy) < 5.5 * noise + 0.005 * plain.total.sum(axis=2)).all()


def test_four_bounces_to_a_target_come_from_all_of_a_beam() -> None:
    """By blocks as by paths: energies of two pixels, means over six seeds. The middle of the beam, which goes into a
    corner, would bring other light."""
    laser = dg.Laser.flood((1.5, 0.1, 1.3), (0, 1.2, 0.6), (0, 1.0, 0), (0, 0, 0.6), 1, 1)
    seen = dg.Sensor((1.5, 0.1, 1.3), square_pixels([[0, 0.5, 1.2], [0, -0.4, 0.7]], 0.2))
    capture = dg.Capture(laser, seen, bins_of_path(160, 0.1, 0.0), "exhaustive", "flood")
    ways = dg.Accuracy(target=0.1, max_bounces=4), dg.Accuracy(samples=4096, max_bounces=4)
    runs = [[dg.simulate(furnished_box(), capture, way, seed=s) for s in range(6)] for way in ways]
    assert runs[0][0].samplers["secondary"] == "blocks"
    ours, paths = (np.array([run.components["secondary"].sum(axis=(0, 2)) for run in of]) for of in runs)
    allowed = t.isf(1e-3, 5) * np.hypot(sem(ours), sem(paths))
    assert (np.abs(ours.mean(axis=0) - paths.mean(axis=0)) < allowed).all()
    middles = dg.Capture(dg.Laser(laser.position, laser.targets), seen, capture.time, "exhaustive", "flood")
    other = dg.simulate(furnished_box(), middles, ways[1]).components["secondary"].sum(axis=(0, 2))
    assert (np.abs(other - paths.mean(axis=0)) > allowed).any()


def test_a_beam_whose_middle_goes_through_a_gap_has_light() -> None:
    """No warning says that it meets nothing, and its light to a target is that of paths."""
    sides = [rectangle((0, y, 0), (0, 0.4, 0), (0, 0, 1)) for y in (-0.6, 0.6)]
    plate = rectangle((0.6, -0.2, 0), (0, 0, 0.1), (0, 0.1, 0))
    parts = [dg.Part(f"wall {k}", side, dg.Lambertian(0.8), "relay_wall") for k, side in enumerate(sides)]
    room = dg.Scene.from_parts([*parts, dg.Part("plate", plate, dg.Lambertian(0.5))])
    laser = dg.Laser.flood((1, 0, 0), (0, 0, 0), (0, 0.6, 0), (0, 0, 0.6), 1, 1)
    seen = dg.Sensor.grid((1, 0, 0), (0, 0.5, 0), (0, 0.1, 0), (0, 0, 0.1), 1, 1)
    capture = dg.Capture(laser, seen, bins_of_path(200, 0.03, 0.0, "source"), "exhaustive", "flood")
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        ours = dg.simulate(room, capture, dg.Accuracy(target=0.05), seed=1)
        paths = dg.simulate(room, capture, dg.Accuracy(samples=1 << 16), seed=1)
    assert ours.samplers["primary"] == "cuts" and ours.total.sum() > 0
    np.testing.assert_allclose(ours.total.sum(), paths.total.sum(), rtol=0.1)


def test_light_of_an_uneven_pixel_arrives_when_its_points_see_it() -> None:
    """Of a pixel that is sensitive in its middle, light of a beam's many laser points is not spread over the times of
    all of it: four runs to 5 % have the shape of paths, in bins of a thirtieth of what the pixel spans."""
    parts = [
        dg.Part("wall", rectangle((0, 0, 0), (0, 1, 0), (0, 0, 1)), dg.Lambertian(0.8), "relay_wall"),
        dg.Part("plate", rectangle((0.4, -0.5, 0.1), (0, 0, 0.05), (0, 0.05, 0)), dg.Lambertian(0.6)),
    ]
    across = np.exp(-0.5 * ((np.arange(24) - 11.5) / 3.0) ** 2)
    laser = dg.Laser.flood((0.5, 0.1, 0.0), (0, 0.1, 0), (0, 0.4, 0), (0, 0, 0.4), 8, 8)
    seen = dg.Sensor((0.5, 0.12, 0.0), square_pixels([[0, 0.2, 0.0]], 0.1), footprints=np.outer(across, across)[None])
    capture = dg.Capture(laser, seen, bins_of_path(600, 0.006, 0.5), "exhaustive", "flood")
    room = dg.Scene.from_parts(parts)
    ours, paths = (
        np.sum([dg.simulate(room, capture, way, seed=s).total for s in range(4)], axis=0)
        for way in (dg.Accuracy(target=0.05), dg.Accuracy(samples=1 << 14))
    )
    assert np.linalg.norm(ours / ours.sum() - paths / paths.sum()) < 0.07 * np.linalg.norm(paths / paths.sum())


def test_light_of_one_bounce_has_its_closed_form() -> None:
    """Before a wide wall that it faces, a narrow zone gets share · ρ/π · A/z² at the time 2 z/c."""
    laser = dg.Laser.flood(DEVICE, (1, 0, 0), (0, -0.5, 0), (0, 0, 0.5), 4, 4)
    sensor = dg.Sensor.grid(DEVICE, (1, 0, 0), (0, -0.05, 0), (0, 0, 0.05), 1, 1, 1e-3)
    capture = dg.Capture(laser, sensor, dg.TimeAxis(100, 200e-12), "exhaustive", "flood")
    found = dg.simulate(plane_ahead(2.0, 0.6), capture, ONE_BOUNCE).total[0, 0]
    share = 0.1**2 / 1.0**2
    np.testing.assert_allclose(found.sum(), share * 0.6 / np.pi * np.pi * 1e-6 / 4, rtol=0.03)
    assert found.argmax() == int(4 / 299_792_458 / 200e-12)


def test_two_bounces_inside_of_a_sphere_have_their_closed_form() -> None:
    """Wherever light met it first, the second vertex is uniform on a sphere: seen from the middle, a zone of solid
    angle Ω gets ρ² Ω / (4π²) · A / r². The mean path has 2 r and the mean chord from the lit square to the zone."""
    radius, albedo = 0.5, 0.7
    ball = trimesh.creation.icosphere(5, radius)
    room = dg.Scene.from_parts([dg.Part("ball", ball, dg.Lambertian(albedo), "relay_wall")])
    laser = dg.Laser.flood(DEVICE, (1, 0, 0), (0, -0.3, 0), (0, 0, 0.3), 2, 2)
    sensor = dg.Sensor.grid(DEVICE, (-1, 0, 0), (0, 0.6, 0), (0, 0, 0.6), 1, 1, 1e-3)
    capture = dg.Capture(laser, sensor, dg.TimeAxis(400, 20e-12), "exhaustive", "flood")
    found = two_bounces_of_beam(room, capture, Raycaster(room), MaterialTable.of(room.materials), 1 << 17)[0, 0, 0]
    omega = 4 * np.arcsin(0.36 / 1.36)
    np.testing.assert_allclose(found.sum(), albedo**2 * omega / (4 * np.pi**2) * np.pi * 1e-6 / radius**2, rtol=0.01)
    metres = (np.arange(400) + 0.5) * 20e-12 * 299_792_458
    assert abs((found * metres).sum() / found.sum() - _mean_path(radius)) < 0.005 * radius


def _mean_path(radius: float) -> float:
    """Mean path from the middle of a sphere by the lit square before it and the zone behind it, by quadrature."""
    across = (np.arange(24) + 0.5) / 24 * 2 - 1
    u, v = (grid.ravel() for grid in np.meshgrid(across, across))
    lit, seen = (np.stack([np.full(u.shape, x), side * u, side * v], 1) for x, side in ((1.0, 0.3), (-1.0, 0.6)))
    unit = [points / np.linalg.norm(points, axis=1, keepdims=True) for points in (lit, seen)]
    # An even beam of flat cells is even over the tangents; the zone is even over the solid angle.
    weight = (1 + 0.36 * (u**2 + v**2)) ** -1.5
    chords = np.linalg.norm(unit[0][:, None] - unit[1], axis=2).mean(axis=0)
    return float(radius * (2 + (chords * weight).sum() / weight.sum()))


def test_two_bounces_of_a_beam_equal_those_of_paths() -> None:
    """Pixel by pixel within 5 standard errors of the paths and 3 %, and each pair of parts that face each other is
    there."""
    room, capture = scene(), captured(3, footprints=footprints(4))
    found = two_bounces_of_beam(room, capture, Raycaster(room), MaterialTable.of(room.materials), 1 << 18)
    once, twice = (dg.simulate(room, capture, dg.Accuracy(samples=8192, max_bounces=b, direct=True)) for b in (1, 2))
    paths, mine = (twice.total - once.total)[0].sum(axis=1), found.sum(axis=(0, 1, 3))
    noise = np.sqrt((np.nan_to_num(twice.stderr[0]) ** 2).sum(axis=1))
    assert (noise < 0.03 * paths).all() and (np.abs(mine - paths) < 5 * noise + 0.03 * paths).all()
    np.testing.assert_array_equal(found.sum(axis=(2, 3)) > 0, [[0, 0, 1], [0, 0, 0], [1, 0, 0]])


def test_light_by_angle_adds_up_and_follows_the_cosine() -> None:
    """Nodes share all light of one bounce; factors that are the cosines themselves weight it with its cosine."""
    room, capture = plane_ahead(1.2, 0.6), captured(3)
    caster, table = Raycaster(room), MaterialTable.of(room.materials)
    whole = one_bounce_of_beam(room, capture, caster, table)
    nodes = np.linspace(0, 1, 5)
    light, outside = one_bounce_by_angle(room, capture, caster, table, nodes)
    np.testing.assert_allclose(light.sum(axis=1), whole.light, rtol=1e-12, atol=1e-30)
    np.testing.assert_array_equal(outside, whole.outside)
    # Before a plane the path is 2 z / cosine, which each bin knows to its width; places of light and sensor differ.
    axis, lit = capture.time, whole.light[0].sum(axis=0) > 0
    metres = 0.5 * (np.flatnonzero(lit) + 0.5) * axis.width_s * 299_792_458
    cosine = np.einsum("n,npt->t", nodes, light[0])[lit] / whole.light[0].sum(axis=0)[lit]
    np.testing.assert_allclose(cosine, np.minimum(1.2 / metres, 1.0), atol=0.02)
    assert lit.sum() >= 3


def test_crosstalk_and_glass_add_to_what_the_pixels_see() -> None:
    room, plain = scene(), captured(4, footprints=footprints(4))
    mixed = captured(4, footprints=footprints(4), crosstalk=0.02, glass=np.arange(4.0))
    accuracy = dg.Accuracy(samples=64, max_bounces=3, direct=True)
    alone, together = dg.simulate(room, plain, accuracy), dg.simulate(room, mixed, accuracy)
    expected = alone.total + 0.02 * (alone.total.sum(axis=1, keepdims=True) - alone.total)
    expected[0, :, 0] += np.arange(4)
    np.testing.assert_allclose(together.total, expected, rtol=1e-12, atol=1e-18)


@pytest.mark.parametrize(
    ("message", "make"),
    [
        ("Laser.weights: all are 0", lambda: dg.Laser(LASER, [(1, 0, 0)], weights=[0.0])),
        ("Laser.weights: holds numbers that are negative", lambda: dg.Laser(LASER, [(1, 0, 0)], weights=[-1.0])),
        ("Laser.flood: right = ", lambda: dg.Laser.flood(LASER, (1, 0, 0), (0, 1, 0), (0, 2, 0), 2, 2)),
        ("Sensor.footprints: shape", lambda: captured(2, footprints=np.ones((3, 2, 2)))),
        ("Sensor.glass: shape", lambda: captured(2, glass=[0.0])),
        ("Sensor.crosstalk = 2", lambda: captured(2, crosstalk=2)),
        (
            "no parallelogram",
            lambda: dg.Sensor(DEVICE, [[(1, 0, 0), (1, 1, 0), (1, 2, 2), (1, 0, 1)]], footprints=np.ones((1, 1, 1))),
        ),
        ("Accuracy.max_bounces = 2", lambda: dg.Accuracy(max_bounces=2)),
    ],
)
def test_wrong_values_are_refused_in_a_line(message: str, make: object) -> None:
    with pytest.raises(InputError, match=message) as caught:
        make()  # type: ignore[operator]
    assert "\n" not in str(caught.value)
