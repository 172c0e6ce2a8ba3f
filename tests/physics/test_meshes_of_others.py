"""Light of meshes that others made, which once left its claim: a pair of laser point and pixel of a foreign scene."""

from pathlib import Path

import numpy as np
import pytest
from benchmarks.foreign_scenes import foreign_scene

from datagen import Accuracy, simulate
from datagen.bench.plain_check import RUNS, PlainPaths
from datagen.transport.reference import pairs_of

MESHES = Path(__file__).resolve().parents[3] / "shared" / "meshes"
WHOLE = "whole"
SAMPLES = 1 << 19
"""Samples of the truth; they take some seconds. Rare paths need more."""
SEEDS = 6


@pytest.mark.parametrize(
    ("scene", "pair", "what", "samples"),
    [
        # A bunny that holds both the laser point and the pixel: rays that meet it edge-on near by.
        (6951, 8, "object 1", SAMPLES),
        # A glossy teapot beside pixels of 11 cm, which brings 1/2000 of the light.
        (6552, 6, "object 2", SAMPLES),
        # A mirror's lobe of 1 degree that one path in 1 700 meets, and most of a pixel's light comes by it.
        pytest.param(6890, 5, WHOLE, 4 * SAMPLES, marks=pytest.mark.nightly),
    ],
)
def test_light_of_one_pair_errs_as_it_claims(scene: int, pair: int, what: str, samples: int) -> None:
    """Of one pair alone a run knows little of its error: root mean squares over some seeds agree within a half."""
    if not MESHES.is_dir():
        pytest.skip("real meshes are not part of the repository; put them into shared/meshes beside the checkout")
    foreign = foreign_scene(scene, MESHES)
    laser, pixel = pairs_of(foreign.capture)[pair]
    capture = foreign.capture.excerpt(np.array([laser]), np.array([pixel]))
    accuracy = Accuracy(target=0.05, max_bounces=foreign.max_bounces)
    truth = PlainPaths.of(foreign.scene, capture, accuracy, samples // RUNS, 1)
    error2 = claim2 = 0.0
    for seed in range(SEEDS):
        ours = simulate(foreign.scene, capture, accuracy, seed=seed)
        found, claim = (
            (ours.total, ours.claimed_error) if what == WHOLE else (ours.parts[what], ours.part_errors[what])
        )
        assert claim is not None
        error2 += truth.check(found, *(ours.components if what == WHOLE else [what])).square
        claim2 += claim**2
    assert error2 < 1.5**2 * claim2
