"""Paths of light obey laws: spheres, dark scenes, seeds, and the scatter they claim.
`tests/equivalence/test_paths.py` shows that they equal the definition."""

from __future__ import annotations

import numpy as np
import pytest
from rooms import bins_of_path, furnished_box, one_point_capture, rectangle
from sphere_chords import QUAD, SPOT, unit_ball

from datagen import Capture, Lambertian, Laser, Part, Scene, Sensor
from datagen.transport.brdf import MaterialTable
from datagen.transport.fields_of_view import PixelCones
from datagen.transport.paths import sample_paths
from datagen.transport.rays import Raycaster
from datagen.transport.reference import pairs_of, reference

APERTURE_M2 = np.pi * 0.02**2


@pytest.mark.parametrize("albedo", [0.3, pytest.param(1.0, marks=pytest.mark.nightly)])
def test_inside_of_a_sphere(albedo: float) -> None:
    """Every vertex after a bounce is uniform on the sphere, so b bounces bring ρᵇ/π · A Ω / (4π r²) for any b ≥ 3."""
    scene = Scene.from_parts([Part("sphere", unit_ball(5), Lambertian(albedo), "structure")])
    capture = Capture(Laser((0, 0, 0.0), [SPOT]), Sensor((0, 0, 0.0), QUAD), bins_of_path(100, 0.1, 0.0))
    primary = albedo**3 / np.pi / (4 * np.pi) * APERTURE_M2 * PixelCones.of(capture.sensor).solid_angle[0]
    found = reference(scene, capture, draw=sample_paths, samples=1 << 14, replicates=2, max_bounces=6, seed=1)
    by_order = [found.components["primary"].sum(), found.components["secondary"].sum()]
    assert by_order == pytest.approx([primary, primary * albedo], rel=2e-3, abs=0)
    assert found.components["higher"].sum() == pytest.approx(primary * (albedo**2 + albedo**3), rel=4e-3, abs=0)
    if albedo < 1:
        everything = reference(
            scene, capture, draw=sample_paths, samples=1 << 12, replicates=8, max_bounces=None, seed=1
        )
        assert everything.total.sum() == pytest.approx(primary / (1 - albedo), rel=1e-2, abs=0)


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
