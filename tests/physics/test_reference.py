"""Sampled paths of light obey laws: spheres, the direct return, fog, reciprocity, dark scenes.
`tests/equivalence/test_sampled_paths.py` shows that they equal the definition."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh
from rooms import bins_of_path, furnished_box, one_point_capture, rectangle, square_pixels
from scipy import stats
from sphere_chords import BINS, QUAD, SPOT, WIDTH_M, stored, unit_ball

from datagen import Capture, Lambertian, Laser, Part, Phong, Scene, Sensor
from datagen.transport.brdf import MaterialTable
from datagen.transport.fields_of_view import PixelCones
from datagen.transport.reference import pairs_of, reference
from datagen.transport.sampled_paths import sample_paths
from datagen.transport.visibility.raycast import Raycaster

APERTURE_M2 = np.pi * 0.02**2


@pytest.mark.parametrize("albedo", [0.3, 1.0])
def test_inside_of_a_sphere(albedo: float) -> None:
    """Every vertex after a bounce is uniform on the sphere, so b bounces bring ρᵇ/π · A Ω / (4π r²) for any b ≥ 3."""
    scene = Scene.from_parts([Part("sphere", unit_ball(5), Lambertian(albedo), "structure")])
    capture = Capture(Laser((0, 0, 0.0), [SPOT]), Sensor((0, 0, 0.0), QUAD), bins_of_path(100, 0.1, 0.0))
    primary = albedo**3 / np.pi / (4 * np.pi) * APERTURE_M2 * PixelCones.of(capture.sensor).solid_angle[0]
    found = reference(scene, capture, draw=sample_paths, samples=1 << 14, replicates=2, max_bounces=6, seed=1)
    by_order = [found.components["primary"].sum(), found.components["secondary"].sum()]
    assert by_order == pytest.approx([primary, primary * albedo], rel=2e-3)
    assert found.components["higher"].sum() == pytest.approx(primary * (albedo**2 + albedo**3), rel=4e-3)
    if albedo < 1:
        everything = reference(
            scene, capture, draw=sample_paths, samples=1 << 12, replicates=8, max_bounces=None, seed=1
        )
        assert everything.total.sum() == pytest.approx(primary / (1 - albedo), rel=1e-2)


def test_paths_in_a_sphere_arrive_when_chords_say() -> None:
    """Arrival times are distributed as the length of two chords that meet in a uniform point: 16 runs, level 10⁻³
    over the bins."""
    scene = Scene.from_parts([Part("sphere", unit_ball(6), Lambertian(0.8), "structure")])
    capture = Capture(Laser((0, 0, 0.0), [SPOT]), Sensor((0, 0, 0.0), QUAD), bins_of_path(BINS, WIDTH_M, 0.0))
    runs = np.array(
        [
            reference(scene, capture, draw=sample_paths, samples=4096, replicates=1, seed=s).total[0, 0]
            for s in range(16)
        ]
    )
    primary = 0.8**3 / np.pi / (4 * np.pi) * APERTURE_M2 * PixelCones.of(capture.sensor).solid_angle[0]
    share, error = stored().of(3)
    measured, stderr = runs.mean(axis=0), runs.std(axis=0, ddof=1) / 4
    filled = measured > 1e-3 * measured.max()
    t2 = (measured - primary * share)[filled] ** 2 / (stderr[filled] ** 2 + (primary * error[filled]) ** 2)
    # Each term is about F(1, 15): mean 15/13, variance 2·15²·14 / (13²·11).
    z = (t2.sum() - filled.sum() * 15 / 13) / np.sqrt(filled.sum() * 2 * 15**2 * 14 / (13**2 * 11))
    assert z < stats.norm.ppf(1 - 1e-3)


def test_laser_point_and_pixel_may_change_places() -> None:
    """A small pixel and the laser point change places: the light is the same order by order, apart from the device
    legs. Both points are equally far from the device and equally oblique."""
    places, device = [(0, -0.4, 1.2), (0, 0.4, 1.2)], (1.5, 0.0, 1.2)
    box = trimesh.creation.box(bounds=[(0.9, -1.2, 0.4), (1.3, -0.6, 1.3)])
    wall = Part("wall", rectangle((0, 0, 1.2), (0, 1.5, 0), (0, 0, 1.2)), Lambertian(0.8), "relay_wall")
    floor = Part("floor", rectangle((1, 0, 0), (1, 0, 0), (0, 1.5, 0)), Phong(0.6, exponent=5.0), "structure")
    scene = Scene.from_parts([wall, floor, Part("box", box, Phong(0.5, exponent=8.0, specular=0.5))])
    time = bins_of_path(40, 0.2, 0.0)
    runs = []
    for a, b in (places, places[::-1]):
        capture = Capture(Laser(device, [a]), Sensor(device, square_pixels([b], 1e-4)), time)
        runs.append(
            reference(scene, capture, draw=sample_paths, samples=1 << 13, replicates=8, max_bounces=4, seed=len(runs))
        )
    for name in ("primary", "secondary"):
        there, back = (run.components[name].sum() for run in runs)
        assert there > 0
        noise = np.hypot(*(np.sqrt((run.stderr**2).sum()) for run in runs))
        assert abs(there - back) < 5 * noise


def test_where_there_is_no_light() -> None:
    """A laser ray or a pixel that meets nothing, and a wall alone, give zeros and no warning."""
    wall = Part("wall", rectangle((0, 0, 1), (0, 1, 0), (0, 0, 1)), Lambertian(0.8), "relay_wall")
    alone = Scene.from_parts([wall])
    for laser, seen in (((0, 0.2, 1), (0, -0.2, 1)), ((0, 5.0, 1), (0, 0, 1)), ((0, 0, 1), (0, 5.0, 1))):
        capture = one_point_capture(laser, seen, 0.05)
        found = reference(alone, capture, draw=sample_paths, samples=256, max_bounces=4)
        assert not found.total.any() and not found.overflow.any()
        assert found.total.shape == capture.shape


def test_the_same_seed_gives_the_same_paths_whatever_else_is_asked() -> None:
    """The paths of one pair do not depend on other pairs in the same call, and sums over all paths equal the
    histograms of `reference`."""
    room, capture = furnished_box(), one_point_capture()
    caster, materials = Raycaster(room), MaterialTable.of(room.materials)
    one, again, other = (
        sample_paths(caster, room, materials, capture, pairs_of(capture), 512, max_bounces=4, seed=seed)
        for seed in (1, 1, 2)
    )
    assert np.array_equal(one.photons, again.photons) and not np.array_equal(one.photons, other.photons)
    assert set(np.unique(one.order)) == {3, 4} and (one.photons > 0).all() and (one.sample < 512).all()


def test_what_samples_scatter_is_what_the_mean_is_off_by() -> None:
    """The standard error from the spread of samples is at least that of the mean over 64 runs (samples are
    stratified), and not several times as large."""
    room, capture = furnished_box(), one_point_capture()
    caster, materials = Raycaster(room), MaterialTable.of(room.materials)
    samples, energy, told = 256, [], []
    for seed in range(64):
        paths = sample_paths(caster, room, materials, capture, pairs_of(capture), samples, seed=seed)
        each = np.bincount(paths.sample, paths.photons, samples)
        energy.append(each.sum())
        told.append(samples * each.var(ddof=1))
    # 64 runs know their variance to 18 %: at most 1.6 of it at a level of 10⁻³.
    assert np.var(energy, ddof=1) < 1.6 * np.mean(told)
