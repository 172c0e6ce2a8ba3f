"""Sampled paths of light obey laws: spheres, dark scenes, seeds, and the scatter they claim.
`tests/equivalence/test_sampled_paths.py` shows that they equal the definition."""

from __future__ import annotations

import numpy as np
from rooms import furnished_box, one_point_capture

from datagen.transport.brdf import MaterialTable
from datagen.transport.reference import pairs_of
from datagen.transport.sampled_paths import sample_paths
from datagen.transport.visibility.raycast import Raycaster


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
