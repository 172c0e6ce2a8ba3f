"""Paths sampled where light is (`transport/sampled_paths.py`) equal the definition (`transport/reference.py`).

The definition's vertices are uniform on all surfaces: it has no quasi-random numbers, no sampling of BRDFs and no
weighting of densities. Energies of each order, part, histogram and window of time from `RUNS` runs of both are
compared by Student's t at a family-wise level of `LEVEL` for each case.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray
from rooms import bins_of_path, furnished_box, one_point_capture
from scipy import stats
from test_all_ways import CAPTURES, energies, scene_of

from datagen import Capture, Scene
from datagen.records import Transient
from datagen.transport.paths import sample_paths
from datagen.transport.reference import pairs_of, reference

RUNS, LEVEL = 16, 1e-4
PLAIN, SAMPLED = 1 << 15, 1 << 11
WELL_KNOWN = 0.05


def numbers(run: Transient) -> NDArray[np.float64]:
    direct = [light.sum() for name, light in run.components.items() if name == "direct"]
    return np.concatenate([*energies(run, "").values(), direct])


def hold(scene: Scene, capture: Capture, **asked: object) -> None:
    def runs(samples: int, **how: object) -> NDArray[np.float64]:
        return np.array([
            numbers(reference(scene, capture, samples=samples, replicates=1, seed=seed, **asked, **how))  # type: ignore[arg-type]
            for seed in range(RUNS)
        ])  # fmt: skip

    plain, sampled = runs(PLAIN // len(pairs_of(capture))), runs(SAMPLED, draw=sample_paths)
    # Light that only few runs met has a spread that says nothing about its error.
    often = ((plain > 0).sum(axis=0) >= RUNS - 2) & ((sampled > 0).sum(axis=0) >= RUNS - 2)
    off = plain.mean(axis=0) - sampled.mean(axis=0)
    noise = np.hypot(plain.std(axis=0, ddof=1), sampled.std(axis=0, ddof=1)) / np.sqrt(RUNS)
    t = stats.t.isf(LEVEL / 2 / often.sum(), RUNS - 1)
    # The direct return has no noise, only rounding.
    allowed = t * noise + 1e-12 * plain.max()
    assert (np.abs(off) <= allowed)[often].all(), np.column_stack([plain.mean(0), sampled.mean(0), noise])[often]
    largest = int(np.argmax(sampled.mean(axis=0)))
    assert noise[largest] < WELL_KNOWN * sampled.mean(axis=0)[largest]


@pytest.mark.parametrize(
    ("material", "shape", "capture"),
    [("lambertian 0.6", "box", "confocal"), ("oren-nayar 1.2", "ball", "exhaustive"), ("phong 10", "plate", "array"),
     ("ggx 0.6", "open_mesh", "flood"), ("retroreflector 0.4", "touching", "exhaustive"),
     ("sin lobe xyz", "ball", "confocal"), pytest.param("phong 60", "box", "array", marks=pytest.mark.nightly),
     pytest.param("ggx 1", "plate", "exhaustive", marks=pytest.mark.nightly)],
)  # fmt: skip
def test_every_brdf(material: str, shape: str, capture: str) -> None:
    hold(scene_of(material, shape), CAPTURES[capture](), max_bounces=4)


@pytest.mark.parametrize(
    ("laser", "origin"),
    [((0.9, 0.4, 0.0), "wall"), ((0.0, 0.2, 1.2), "source")],
    ids=["on the floor", "in the pixel"],
)
def test_in_fog_with_the_direct_return_and_five_bounces(laser: tuple[float, float, float], origin: str) -> None:
    """Away from corners, whose short paths the definition's uniform vertices hardly ever meet."""
    scene = replace(furnished_box(0.8), attenuation_per_m=0.3)
    capture = one_point_capture(laser, (0, 0.2, 1.2), 0.15, bins_of_path(96, 0.25, 0.0))
    hold(scene, replace(capture, time=replace(capture.time, origin=origin)), max_bounces=5, direct=True)


def test_without_asking_what_stands_before_the_pixel() -> None:
    hold(furnished_box(), one_point_capture(time=bins_of_path(96, 0.25, 0.0)), occlusion=False)


@pytest.mark.parametrize("draw", [pytest.param(None, marks=pytest.mark.nightly), sample_paths])
def test_all_orders_in_a_white_room(draw: Callable[..., object] | None) -> None:
    """Orders of three and more, from runs of unlimited bounces, bring at least the light of runs up to six
    bounces."""
    room, capture = furnished_box(0.8), one_point_capture(time=bins_of_path(96, 0.5, 0.0))
    how = {} if draw is None else {"draw": draw}
    every, some = (
        reference(room, capture, samples=PLAIN, replicates=4, max_bounces=last, **how)  # type: ignore[arg-type]
        for last in (None, 6)
    )
    noise = np.sqrt((every.stderr**2).sum() + (some.stderr**2).sum())
    assert every.total.sum() > some.total.sum() - 4 * noise
    assert every.components["higher"].sum() > 1.05 * some.components["higher"].sum() - 4 * noise
