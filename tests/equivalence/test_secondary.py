"""The factorised secondary equals the plain double sum, closed forms, and path tracing."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
import pytest
import secondary_by_walk
import trimesh
from lobe_sphere import values_along
from numpy.typing import NDArray
from rooms import bins_of_path, furnished_box, one_point_capture, rectangle, square_pixels
from scipy import stats
from secondary_by_walk import PLACES, RUNS, coarse, walked
from sphere_chords import QUAD, SPOT, WIDTH_M, stored, unit_ball

from datagen import Accuracy, Capture, Lambertian, Laser, Part, Scene, Sensor
from datagen.errors import InputError
from datagen.records.materials import Phong
from datagen.transport.brdf import MaterialTable
from datagen.transport.factorised import secondary
from datagen.transport.factorised.convolution import SUB_BINS, Paths, Sums, convolve, double_sum, keep_strongest
from datagen.transport.fields_of_view import PixelCones, fov_pool
from datagen.transport.path_tracing.vertices import (
    AreaTarget,
    LaserPoints,
    continued,
    draw_hidden_vertices,
    scattered_rays,
)
from datagen.transport.sampling import Streams, stream_seeds
from datagen.transport.simulate import prepared
from datagen.transport.visibility.raycast import Raycaster

DEVICE = (1.5, 0.1, 1.3)


class Found(NamedTuple):
    mean: NDArray[np.float64]
    stderr: NDArray[np.float64]
    overflow: NDArray[np.float64]


def secondary_of(
    scene: Scene, capture: Capture, seed: int = 0, observed: int = 64, strongest: int | None = None,
    lookins: int = 256, fov_samples: int = 32, replicates: int = 1, **changes: Any,
) -> Found:  # fmt: skip
    kept = "all" if strongest is None else strongest
    accuracy = Accuracy(lookins, fov_samples, 4, replicates, observed=observed, secondary=kept)
    task = prepared(scene, capture, accuracy, seed, split_parts=False)
    got = secondary.secondary_transient(task, observed, **changes)
    return Found(got.rows[0], got.stderr, got.overflow)


def energies(estimates: list[Found]) -> NDArray[np.float64]:
    return np.array([e.mean.sum() + e.overflow.sum() for e in estimates])


@pytest.mark.parametrize("strongest", [None, 1, 5])
@pytest.mark.parametrize(("low", "bins"), [(0.0, 30), (-9.0, 30), (0.0, 12)])
def test_the_convolution_equals_the_plain_double_sum(low: float, bins: int, strongest: int | None) -> None:
    """From the same half paths, in windows that hold all light or cut its start or end: the energy is the same to
    rounding, and each bin too, apart from pairs near an edge that the displaced grids put on its other side."""
    rng = np.random.default_rng(1)
    lookins, pixels, each = 400, 3, 20
    ins = Paths(
        np.arange(lookins + 1) * each, rng.uniform(4, 14, lookins * each), rng.exponential(size=lookins * each)
    )
    outs = Paths(
        np.arange(lookins * pixels + 1) * each, low + rng.uniform(0, 15, lookins * pixels * each),
        rng.exponential(size=lookins * pixels * each),
    )  # fmt: skip
    if strongest is not None:
        keep_strongest(ins, strongest)
        assert (np.add.reduceat(ins.energy > 0, ins.first[:-1]) == strongest).all()
    u = (rng.permutation(lookins) + 0.5) / lookins
    fast, plain = (Sums(np.zeros((pixels, bins)), np.zeros(pixels)) for _ in range(2))
    in_sub_bins = [paths._replace(position=paths.position * SUB_BINS) for paths in (ins, outs)]
    # The displaced grids round times to the centres of sub-bins.
    in_sub_bins[1] = in_sub_bins[1]._replace(position=in_sub_bins[1].position - 0.5)
    convolve(*in_sub_bins, u, fast)
    double_sum(ins, outs, plain)
    np.testing.assert_allclose(
        fast.transient.sum(axis=1) + fast.overflow, plain.transient.sum(axis=1) + plain.overflow
    )
    assert (plain.overflow > 0).all() == (fast.overflow > 0).all() == (low < 0.0 or bins < 20)
    np.testing.assert_allclose(fast.overflow, plain.overflow, rtol=2e-2)
    difference = np.linalg.norm(fast.transient - plain.transient) / np.linalg.norm(plain.transient)
    assert difference < (0.01 if strongest is None else 0.04)


@pytest.mark.parametrize("after_edge", [-0.7, -0.4, -0.1, 0.0, 0.2, 0.49, 0.6])
def test_pairs_near_an_edge_are_shared_by_its_two_sides_linearly(after_edge: float) -> None:
    """In units of sub-bins, a pair at x behind an edge counts behind the edge with probability ½ + x, clipped to 0 …
    1."""
    count, bins = 1000, 10
    edge = 6 * SUB_BINS
    u = (np.arange(count) + 0.5) / count
    rows = np.arange(count + 1)
    into, out = (
        Paths(rows, np.full(count, position), np.ones(count)) for position in (7.3, edge + after_edge - 7.3 - 0.5)
    )
    sums = Sums(np.zeros((1, bins)), np.zeros(1))
    convolve(into, out, u, sums)
    behind = min(max(0.5 + after_edge, 0.0), 1.0)
    np.testing.assert_allclose(sums.transient[0, 5:7] / count, [1.0 - behind, behind], atol=1.5 / count)


def scan(bins: int, width_m: float, origin: str = "wall") -> Capture:
    """Two laser points and three pixels, one of them partly in shadow."""
    pixels = square_pixels([(0, 0.4, 1.2), (0, -0.3, 0.8), (0, 1.1, 2.0)], 0.2)
    return Capture(
        Laser(DEVICE, [(0, -0.8, 1.4), (0, 1.0, 0.3)]),
        Sensor(DEVICE, pixels),
        bins_of_path(bins, width_m, 0.0, origin),
    )


def in_a_ball(albedo: float) -> tuple[Scene, Capture, float]:
    scene = Scene.from_parts([Part("sphere", unit_ball(5), Lambertian(albedo), "structure")])
    capture = Capture(Laser((0, 0, 0.0), [SPOT]), Sensor((0, 0, 0.0), QUAD), bins_of_path(60, WIDTH_M, 0.0))
    omega = PixelCones.of(capture.sensor).solid_angle[0]
    return scene, capture, albedo**4 / np.pi * np.pi * 0.02**2 * omega / (4 * np.pi)


@pytest.mark.parametrize("albedo", [0.3, pytest.param(1.0, marks=pytest.mark.nightly)])
def test_inside_of_a_sphere_energy(albedo: float) -> None:
    """The energy of the secondary in a sphere is L = ρ⁴/π · A Ω / (4π r²)."""
    scene, capture, expected = in_a_ball(albedo)
    estimate = secondary_of(scene, capture, lookins=8192, observed=64, replicates=2)
    assert estimate.mean.sum() + estimate.overflow.sum() == pytest.approx(expected, rel=1e-3)


def test_inside_of_a_sphere_shape() -> None:
    """Arrival times are distributed as three chords between uniform points: 16 runs, Student's t, family-wise level
    10⁻³ over the bins."""
    scene, capture, expected = in_a_ball(0.8)
    runs = np.array([secondary_of(scene, capture, lookins=512, seed=s).mean[0, 0] for s in range(16)])
    truth, truth_error = (expected * values[:60] for values in stored().of(4))
    mean, error = runs.mean(axis=0), runs.std(axis=0, ddof=1) / 4
    filled = truth > 1e-3 * truth.max()
    error = np.hypot(error, truth_error)
    t = np.abs(mean - truth)[filled] / error[filled]
    assert t.max() < stats.t.ppf(1 - 0.5e-3 / filled.sum(), 15)


@pytest.mark.parametrize("place", PLACES)
def test_agrees_with_the_walk(place: str) -> None:
    """8 runs of each way: energy and every filled bin agree by Student's t with at least 7 degrees, family-wise level
    10⁻³."""
    runs = [secondary_of(furnished_box(), PLACES[place], lookins=1024, seed=s).mean[0, 0] for s in range(8)]
    ours, walk = coarse(np.array(runs)), secondary_by_walk.stored(place)
    worst, limit, error = compared(ours, walk)
    assert worst < limit
    assert error < 0.02 * walk.mean(axis=0)[-1]


@pytest.mark.nightly
@pytest.mark.parametrize("place", PLACES)
def test_the_stored_walks_are_those_of_other_seeds(place: str) -> None:
    worst, limit, _ = compared(walked(place, range(100, 100 + RUNS)), secondary_by_walk.stored(place))
    assert worst < limit


def compared(ours: NDArray[np.float64], walk: NDArray[np.float64]) -> tuple[float, float, float]:
    """Largest t over the filled bins and the sum, the t allowed at 10⁻³ over all of them, and the standard error of
    the sum."""
    error = np.sqrt(ours.var(axis=0, ddof=1) / len(ours) + walk.var(axis=0, ddof=1) / len(walk))
    filled = walk.mean(axis=0) > 3e-3 * walk.mean(axis=0)[:-1].max()
    t = np.abs(ours.mean(axis=0) - walk.mean(axis=0))[filled] / error[filled]
    return float(t.max()), float(stats.t.ppf(1 - 0.5e-3 / filled.sum(), 7)), float(error[-1])


def test_one_sample_is_unbiased_and_bounded() -> None:
    """One hidden vertex, one second hidden vertex, one FoV point, laser point 1 mm from a corner: no sample dominates
    the mean."""
    scene, capture = furnished_box(), PLACES["1 mm from two walls"]
    truth = energies([secondary_of(scene, capture, lookins=1 << 13, seed=9)])[0]
    ones = energies([secondary_of(scene, capture, lookins=1, observed=1, fov_samples=1, seed=s) for s in range(300)])
    assert abs(ones.mean() - truth) < stats.norm.ppf(1 - 0.5e-3) * ones.std(ddof=1) / np.sqrt(len(ones))
    assert ones.max() < 200 * truth


def test_lookins_in_the_laser_point_s_shadow_are_found() -> None:
    """A screen hides a plate from the laser point but not from the field of view: the paper's placement never finds
    that plate."""
    box = furnished_box()
    parts = [
        Part(name, trimesh.Trimesh(box.vertices, box.triangles[box.faces_of(name)], process=False), Lambertian(0.8))
        for name in ("relay_wall", "walls", "floor", "ceiling")
    ]
    screen = rectangle((1.2, 0.2, 1.25), (0, 0.6, 0), (0, 0, 1.25))
    plate = rectangle((3.5, 1.0, 1.3), (0, 0.3, 0), (0, 0, 0.3))
    scene = Scene.from_parts([*parts, Part("screen", screen, Lambertian(0.8)), Part("plate", plate, Lambertian(0.8))])
    capture = one_point_capture((0, -0.2, 1.4), (0, 1.2, 1.2), device=(0.8, 0.1, 1.3))
    plate_only = np.array([name == "plate" for name in scene.part_names])
    settings = {"lookins": 4096, "carriers": plate_only}
    ours = energies([secondary_of(scene, capture, **settings, seed=s) for s in range(8)])
    walk = walk_by_third_vertex(scene, capture, plate_only)
    error = np.sqrt((ours.var(ddof=1) + walk.var(ddof=1)) / 8)
    assert abs(ours.mean() - walk.mean()) < stats.t.ppf(1 - 0.5e-3, 7) * error
    assert ours.mean() > 10 * error


def test_lookins_by_part_add_up_and_other_materials_are_refused() -> None:
    """The parts that carry hidden vertices divide the light among them; a part that does not factorise has to be left
    out by name."""
    scene, capture = furnished_box(), one_point_capture()
    everything = secondary_of(scene, capture).mean.sum()
    some = np.arange(6) % 2 == 0
    halves = [secondary_of(scene, capture, carriers=mask).mean.sum() for mask in (some, ~some)]
    assert sum(halves) == pytest.approx(everything, rel=1e-10)

    mesh = rectangle((1.0, 0.0, 1.0), (0, 0.2, 0), (0, 0, 0.2))
    wall = rectangle((0, 0, 1), (0, 2, 0), (0, 0, 2))
    other = Scene.from_parts(
        [Part("wall", wall, Lambertian(0.8), "relay_wall"), Part("gloss", mesh, Phong(0.5, exponent=20))]
    )
    with pytest.raises(InputError, match=r"gloss.*does not factorise"):
        secondary_of(other, capture)
    with pytest.raises(InputError, match="secondary = 0"):
        secondary_of(scene, capture, strongest=0)


def test_observed_points_and_fov_may_have_any_brdf() -> None:
    """Glossy pillar, box and relay wall: hidden vertices on Lambertian parts agree with path tracing restricted to
    these."""
    base = furnished_box()
    glossy = {"relay_wall", "box", "pillar"}
    parts = [
        Part(
            name, trimesh.Trimesh(base.vertices, base.triangles[base.faces_of(name)], process=False),
            Phong(0.7, exponent=8) if name in glossy else Lambertian(0.7), role,
        )
        for name, role in zip(base.part_names, base.roles, strict=True)
    ]  # fmt: skip
    capture = one_point_capture()
    scene = Scene.from_parts(parts)
    carriers = np.array([name not in glossy for name in scene.part_names])
    ours = energies([secondary_of(scene, capture, lookins=1024, carriers=carriers, seed=s) for s in range(8)])
    walk = walk_by_third_vertex(scene, capture, carriers)
    error = np.sqrt((ours.var(ddof=1) + walk.var(ddof=1)) / 8)
    assert abs(ours.mean() - walk.mean()) < stats.t.ppf(1 - 0.5e-3, 7) * error
    assert error < 0.02 * walk.mean()


def walk_by_third_vertex(scene: Scene, capture: Capture, carriers: NDArray[np.bool_]) -> NDArray[np.float64]:
    """Energies of 8 plain random walks x₁ → o → b, with b on a carrier, connected to one random FoV point: brute
    force."""
    caster, cones = Raycaster(scene), PixelCones.of(capture.sensor)
    materials, points = MaterialTable.of(scene.materials), LaserPoints.of(caster, scene, capture.laser)
    nothing = AreaTarget(0.0, np.empty(0, np.int64), np.empty(0), 1.0, np.zeros(len(caster.corners), np.bool_))
    count = 1 << 15
    out = []
    for seed in range(8):
        alone = Streams.of(seed, np.array([0]), np.array([0]))
        o = draw_hidden_vertices(caster, scene, materials, points, np.array([0]), count, nothing, alone, 2)
        b = continued(scene, o, *scattered_rays(caster, materials, o, o.numbers(0)))
        b = b.take(np.flatnonzero(carriers[b.part]))
        pool = fov_pool(caster, scene, capture.sensor, cones, np.array([0]), 1, count, stream_seeds(seed, 99, 0))
        q = np.random.default_rng(seed).permutation(count)[: len(b.part)]
        span = pool.position[0, q] - b.position
        square = (span**2).sum(axis=1)
        cosines = np.einsum("nk,nk->n", span, b.normal) * -np.einsum("nk,nk->n", span, pool.normal[0, q])
        # The field of view is flat, of one material.
        k, toward = pool.part[0, 0], -span / np.sqrt(square)[:, None]
        f4 = values_along(materials.kind[k], materials.values[k], pool.normal[0, 0], toward, pool.to_sensor[0, q])[0]
        lifted = b.position + caster.offset_m * b.normal
        seen = ~caster.occluded(lifted, pool.position[0, q] + caster.offset_m * pool.normal[0, q])
        form = np.maximum(cosines, 0.0) / square**2 * seen
        f3 = materials.values[b.part, 0] / np.pi
        out.append((b.power * f3 * form * f4 * pool.weight[0, q]).sum())
    return np.array(out)


def test_attenuation_dims_each_bin_by_its_path() -> None:
    """With the same samples and the time origin at the source each bin is one path length, dimmed by exp(−a path)."""
    clear, capture = furnished_box(), scan(800, 0.025, "source")
    hazy = Scene(**{**clear.__dict__, "attenuation_per_m": 0.2})
    estimates = [secondary_of(scene, capture).mean for scene in (clear, hazy)]
    path = (np.arange(800) + 0.5) * 0.025
    expected = estimates[0] * np.exp(-0.2 * path)
    np.testing.assert_allclose(estimates[1].sum(axis=2), expected.sum(axis=2), rtol=1e-3)
    assert np.abs(estimates[1] - expected).sum() < 0.01 * expected.sum()


def test_standard_error_is_that_of_repeated_runs() -> None:
    scene, capture = furnished_box(), one_point_capture()
    estimates = [secondary_of(scene, capture, replicates=8, seed=s) for s in range(12)]
    means = np.array([e.mean[0, 0] for e in estimates])
    filled = means.mean(axis=0) > 0.05 * means.mean(axis=0).max()
    claimed = np.sqrt(np.mean([e.stderr[0, 0, filled] ** 2 for e in estimates], axis=0))
    ratio = (claimed / means.std(axis=0, ddof=1)[filled]).mean()
    assert 0.8 < ratio < 1.25
    assert np.isnan(secondary_of(scene, capture).stderr).all()


def test_nothing_to_see_is_zero() -> None:
    """A bare wall, a laser ray and a pixel that meet nothing, and black walls give zeros."""
    wall = Scene.from_parts([Part("wall", rectangle((0, 0, 1), (0, 2, 0), (0, 0, 2)), Lambertian(0.8), "relay_wall")])
    away = Capture(
        Laser(DEVICE, [(0, 0, 1), (9, 9, 9), (0, 1, 1)]),
        Sensor(DEVICE, square_pixels([(0, 0.4, 1.2), (0, 40.0, 1.2)], 0.2)),
        bins_of_path(50, 0.1, 0.0),
    )
    for scene in (wall, furnished_box(0.0)):
        estimate = secondary_of(scene, away)
        assert (estimate.mean == 0).all()
        assert (estimate.overflow == 0).all()
    lit = secondary_of(furnished_box(), Capture(away.laser, away.sensor, bins_of_path(200, 0.1, 0.0)))
    assert np.isfinite(lit.mean).all()
    assert (lit.mean[[0, 2], 0].sum(axis=1) > 0).all()
