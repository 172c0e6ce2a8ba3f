"""The paper's secondary with radiometric weights is the light of four bounces, and its convolution the plain double
sum."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from numpy.typing import NDArray
from rooms import bins_of_path, furnished_box, one_point_capture, rectangle, square_pixels
from scipy import stats
from sphere_chords import QUAD, SPOT, WIDTH_M, stored, unit_ball

from datagen import Capture, Lambertian, Laser, Part, Phong, Scene, Sensor
from datagen.errors import InputError
from datagen.paper import secondary
from datagen.paper.convolution import SUB_BINS, Paths, convolve, double_sum, keep_strongest
from datagen.transport.fields_of_view import PixelCones
from datagen.transport.paths import sample_paths
from datagen.transport.reference import reference

RUNS, LEVEL = 8, 1e-3
DEVICE = (1.5, 0.1, 1.3)
AXIS = bins_of_path(40, 0.5, 0.0)


@pytest.mark.parametrize(("low", "bins", "strongest"), [(0.0, 30, 1), (-9.0, 30, None), (0.0, 12, 5)])
def test_the_convolution_equals_the_plain_double_sum(low: float, bins: int, strongest: int | None) -> None:
    """From the same half paths, in windows that hold all light or cut its start or end: each bin is the same, apart
    from pairs near an edge that the displaced grids put on its other side."""
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
        largest = np.sort(ins.energy.reshape(lookins, each), axis=1)[:, -strongest:]
        keep_strongest(ins, strongest)
        np.testing.assert_array_equal(np.sort(ins.energy.reshape(lookins, each), axis=1)[:, -strongest:], largest)
        assert (np.add.reduceat(ins.energy > 0, ins.first[:-1]) == strongest).all()
    u = (rng.permutation(lookins) + 0.5) / lookins
    fast, plain, late = np.zeros((pixels, bins)), np.zeros((pixels, bins)), np.zeros(pixels)
    in_sub_bins = [paths._replace(position=paths.position * SUB_BINS) for paths in (ins, outs)]
    # The displaced grids round times to the centres of sub-bins.
    in_sub_bins[1] = in_sub_bins[1]._replace(position=in_sub_bins[1].position - 0.5)
    convolve(*in_sub_bins, u, fast)
    double_sum(ins, outs, plain, late)
    every = [np.add.reduceat(ins.energy, ins.first[:-1]), np.add.reduceat(outs.energy, outs.first[:-1])]
    np.testing.assert_allclose(plain.sum(axis=1) + late, every[0] @ every[1].reshape(lookins, pixels))
    assert (late > 0).all() == (low < 0.0 or bins < 20)
    difference = np.linalg.norm(fast - plain) / np.linalg.norm(plain)
    assert difference < (0.01 if strongest is None else 0.04)


@pytest.mark.parametrize("after_edge", [-0.7, -0.4, 0.2])
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
    light = np.zeros((1, bins))
    convolve(into, out, u, light)
    behind = min(max(0.5 + after_edge, 0.0), 1.0)
    np.testing.assert_allclose(light[0, 5:7] / count, [1.0 - behind, behind], atol=1.5 / count)


def shadow() -> tuple[Scene, Capture]:
    """All light of four bounces comes by a side wall and a plate, which a black screen hides from the laser point and
    not from the field of view, in haze: the paper's placement never finds that plate."""
    side = rectangle((2, -1.5, 1.25), (2, 0, 0), (0, 0, 1.25))
    plate = rectangle((3.5, 1, 1.3), (0, 0.3, 0), (0, 0, 0.3))
    screen = rectangle((1.2, 0.2, 1.25), (0, 0.6, 0), (0, 0, 1.25))
    wall = Part("wall", rectangle((0, 0, 1.25), (0, 1.5, 0), (0, 0, 1.25)), Lambertian(0.8))
    lit = [Part(name, mesh, Lambertian(0.8)) for name, mesh in (("side", side), ("plate", plate))]
    scene = Scene.from_parts([wall, *lit, Part("screen", screen, Lambertian(0.0))], attenuation_per_m=0.2)
    return scene, one_point_capture((0, -0.2, 1.4), (0, 1.2, 1.2), time=AXIS, device=(0.8, 0.1, 1.3))


def scan(pairing: str, origin: str) -> Capture:
    spots = np.array([[0, -0.9, 0.6], [0, 0.3, 1.7]])
    pixels = square_pixels(spots if pairing == "confocal" else spots + np.array([0, 0.2, -0.1]), 0.1)
    return Capture(Laser(DEVICE, spots), Sensor(DEVICE, pixels), replace(AXIS, origin=origin), pairing)  # type: ignore[arg-type]


PLACES = {
    "open wall": (furnished_box(), one_point_capture(time=AXIS)),
    "1 mm from two walls": (furnished_box(), one_point_capture((0, -1.499, 0.001), time=AXIS)),
    "FoV in the same corner": (furnished_box(), one_point_capture((0, -1.4, 0.1), (0, -1.1, 0.4), 0.2, time=AXIS)),
    "in the laser point's shadow": shadow(),
    "confocal, from the source": (furnished_box(), scan("confocal", "source")),
    "exhaustive": (furnished_box(0.4), scan("exhaustive", "wall")),
}  # fmt: skip


@pytest.mark.parametrize("place", PLACES)
def test_the_mean_is_the_light_of_four_bounces(place: str) -> None:
    """The energy of each pair and every filled bin of 50 cm from 8 runs of each way, by Student's t at 10⁻³ over all
    of them."""
    scene, capture = PLACES[place]

    def numbers(runs: list[NDArray[np.float64]]) -> NDArray[np.float64]:
        light = np.array(runs)
        return np.concatenate([light.sum(axis=(1, 2)), light.sum(axis=3).reshape(RUNS, -1)], axis=1)

    ours = numbers([secondary(scene, capture, 1 << 13, 64, seed=seed) for seed in range(RUNS)])
    paths = numbers([
        reference(scene, capture, samples=1 << 14, replicates=1, max_bounces=4, seed=seed, draw=sample_paths)
        .components["secondary"] for seed in range(RUNS)
    ])  # fmt: skip
    error = np.hypot(stats.sem(ours), stats.sem(paths))
    filled = paths.mean(axis=0) > 3e-3 * paths.mean(axis=0).max()
    off = np.abs(ours.mean(axis=0) - paths.mean(axis=0))
    assert (off < stats.t.isf(LEVEL / 2 / filled.sum(), RUNS - 1) * error)[filled].all()
    assert error[-1] < (0.15 if "shadow" in place else 0.005) * ours[:, -1].mean()


def test_inside_of_a_sphere() -> None:
    """The energy has a closed form, and arrival times are distributed as three chords between uniform points: 16
    runs, Student's t at 10⁻³ over the bins."""
    albedo, runs = 0.8, 16
    scene = Scene.from_parts([Part("sphere", unit_ball(5), Lambertian(albedo), "structure")])
    capture = Capture(Laser((0, 0, 0.0), [SPOT]), Sensor((0, 0, 0.0), QUAD), bins_of_path(60, WIDTH_M, 0.0))
    omega = PixelCones.of(capture.sensor).solid_angle[0]
    expected = albedo**4 / np.pi * np.pi * 0.02**2 * omega / (4 * np.pi)
    found = np.array([secondary(scene, capture, 512, 64, seed=seed)[0, 0] for seed in range(runs)])
    truth, truth_error = (expected * values[:60] for values in stored().of(4))
    filled = truth > 1e-3 * truth.max()
    error = np.hypot(stats.sem(found), truth_error)[filled]
    limit = stats.t.isf(LEVEL / 2 / filled.sum(), runs - 1)
    assert (np.abs(found.mean(axis=0) - truth)[filled] < limit * error).all()
    assert found.sum(axis=1).mean() == pytest.approx(truth.sum(), rel=0.003, abs=0)


def test_one_lookin_and_one_observed_point_have_the_same_mean() -> None:
    scene, capture = furnished_box(), one_point_capture()
    truth = secondary(scene, capture, 1 << 13, 64, seed=9).sum()
    ones = np.array([secondary(scene, capture, 1, 1, seed=seed).sum() for seed in range(100)])
    assert abs(ones.mean() - truth) < stats.norm.isf(LEVEL / 2) * stats.sem(ones)


def test_the_strongest_never_bring_more_than_all() -> None:
    """From the same seed, so in every bin: more of them keep more, and all of them keep all."""
    scene, capture = furnished_box(0.8), scan("exhaustive", "wall")
    kept = [secondary(scene, capture, 256, 64, strongest, seed=1) for strongest in (1, 8, 64, None)]
    for fewer, more in pairwise(kept):
        assert (fewer <= more * (1 + 1e-12)).all()
    assert 0 < kept[0].sum() < 0.5 * kept[1].sum() < 0.5 * kept[2].sum()
    np.testing.assert_allclose(kept[2], kept[3], rtol=1e-12)


def test_narrow_bins_add_up_to_wide_ones() -> None:
    """Except for pairs within half a sub-bin of an edge: smoothing over a sub-bin of width w / SUB_BINS changes a bin
    of width w by w³ f″ / (24 SUB_BINS²)."""
    wide, narrow = (
        secondary(furnished_box(), one_point_capture(time=bins_of_path(40 * n, 0.2 / n, 1.2)), 512, 64, seed=3)
        for n in (1, 4)
    )
    added = narrow.reshape(1, 1, 40, 4).sum(axis=3)
    assert np.linalg.norm(added - wide) < 0.01 * np.linalg.norm(wide)


def test_a_flood_is_the_weighted_mean_of_its_laser_points() -> None:
    scene, exhaustive = furnished_box(), scan("exhaustive", "wall")
    laser = replace(exhaustive.laser, weights=np.array([1.0, 3.0]))
    flood = Capture(laser, exhaustive.sensor, AXIS, illumination="flood")
    one_by_one = secondary(scene, exhaustive, 64, 16)
    np.testing.assert_allclose(secondary(scene, flood, 64, 16), [0.25 * one_by_one[0] + 0.75 * one_by_one[1]])


@pytest.mark.parametrize("pairing", ["exhaustive", "confocal"])
def test_rays_that_meet_nothing_bring_no_light(pairing: str) -> None:
    pixels = square_pixels([(0, 0.4, 1.2), (8, 0, 1)], 0.1)
    outside = Capture(Laser((-3, 0.1, 1.3), [(-50, 0.1, 1.3)]), Sensor((-3, 0.1, 1.3), pixels[:1]), AXIS)
    assert not secondary(furnished_box(), outside, 16, 16).any()
    corner = Scene.from_parts([
        Part("wall", rectangle((0, 0, 1.25), (0, 1.5, 0), (0, 0, 1.25)), Lambertian(0.8)),
        Part("side", rectangle((2, -1.5, 1.25), (2, 0, 0), (0, 0, 1.25)), Lambertian(0.8)),
        Part("floor", rectangle((2, 0, 0), (2, 0, 0), (0, 1.5, 0)), Lambertian(0.8)),
    ])  # fmt: skip
    spots = np.array([[0, -0.8, 1.4], [50, 0.1, 1.3]])
    capture = Capture(Laser(DEVICE, spots), Sensor(DEVICE, pixels), AXIS, pairing)  # type: ignore[arg-type]
    light = secondary(corner, capture, 256, 16)
    assert light[0, 0].any() and not light[1].any() and not light[0, 1:].any()


@pytest.mark.parametrize("counts", [{"lookins": 0}, {"observed": 2.5}, {"strongest": 0}, {"seed": -1}])
def test_wrong_counts_are_refused(counts: dict) -> None:
    with pytest.raises(InputError, match=next(iter(counts))):
        secondary(furnished_box(), one_point_capture(), **counts)


def test_what_does_not_factorise_is_refused() -> None:
    scene = furnished_box()
    glossy = replace(scene, materials=(*scene.materials[:-1], Phong(0.5)))
    with pytest.raises(InputError, match="part 'pillar': Phong does not factorise"):
        secondary(glossy, one_point_capture())
