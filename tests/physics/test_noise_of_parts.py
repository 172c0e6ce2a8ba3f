"""What fixed sample counts leave of noise in the light of one object, which is a small part of all."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import datagen as dg
from datagen.transport.brdf import MaterialTable
from datagen.transport.flood import as_scan
from datagen.transport.paths import sample_paths
from datagen.transport.rays import Raycaster
from datagen.transport.reference import pairs_of
from datagen.transport.simulate import transient_of
from datagen.units import time_from_path

CONFIG = Path(__file__).parents[2] / "configs" / "zone_sensor.yaml"
LEVEL_SIGMAS = 4.0
"""Standard errors that a mean may be off: 6·10⁻⁵ for each of the four parts, by Student's law 10⁻³ with 16 seeds."""


@pytest.mark.nightly
def test_an_object_of_a_zone_sensor_has_noise_and_no_loss() -> None:
    """`configs/zone_sensor.yaml`, scene 1, three bounces with its own sample counts: the object, 1.1 % of the light,
    scatters by 5 % from seed to seed, and its mean over seeds is that of plain paths, as are those of the walls."""
    config = dg.load_config(CONFIG)
    scene = dg.scene_for(config, 1)
    capture = dg.capture_for(config, scene, config.seed, 1)
    accuracy = replace(config.transport.accuracy(), direct=False)
    names = ("walls", "floor", "ceiling", "target")
    runs = [transient_of(scene, capture, accuracy, seed, split_parts=True).parts for seed in range(16)]
    found = np.array([[run[name].sum() for name in names] for run in runs])
    plain = np.array([plain_energy(scene, capture, 8, seed) for seed in range(12)])
    plain = plain[:, [scene.part_names.index(name) for name in names]]
    off = found.mean(axis=0) - plain.mean(axis=0)
    known = np.hypot(found.std(axis=0, ddof=1) / 16**0.5, plain.std(axis=0, ddof=1) / 12**0.5)
    assert (np.abs(off) < LEVEL_SIGMAS * known).all(), off / known
    scatter = found.std(axis=0, ddof=1) / plain.mean(axis=0)
    assert 0.025 < scatter[names.index("target")] < 0.1
    assert scatter[names.index("walls")] < 0.01


def plain_energy(scene: dg.Scene, capture: dg.Capture, samples: int, seed: int) -> np.ndarray:
    """(K,) photons of three bounces within the window, by part, of plain paths over all points of a flood."""
    scan, time = as_scan(capture), capture.time
    pairs, share = pairs_of(scan), capture.laser.shares
    paths = sample_paths(Raycaster(scene), scene, MaterialTable.of(scene.materials), scan, pairs, samples, seed=seed)
    bins = np.floor((time_from_path(paths.path_m) - time.start_s) / time.width_s)
    paths = paths.take((paths.order == 3) & (bins >= 0) & (bins < time.bins))
    return np.bincount(paths.part, paths.photons * share[pairs[paths.pair, 0]], len(scene.part_names))
