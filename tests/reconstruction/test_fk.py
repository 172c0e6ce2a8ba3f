"""f-k migration finds what there is: points in closed form, and the objects of the ready configuration."""

from __future__ import annotations

import numpy as np
import pytest
from fk import depth_of_brightest, migrated

from datagen.config import load_config
from datagen.errors import InputError
from datagen.pipeline import simulate_sample
from datagen.records import TimeAxis
from datagen.records.arrays import Floats
from datagen.units import SPEED_OF_LIGHT_M_PER_S as C

BIN_M = 0.01
AXIS = TimeAxis(256, BIN_M / C, 0.0, "wall")
SIDE_M, POINTS = 1.6, 48
"""A scan whose points are 3.4 cm apart."""


def light_of(points: list[tuple[float, float, float]], axis: TimeAxis = AXIS) -> Floats:
    """(row, column, bin) from small diffuse points (right, up, depth): 1/R⁴ at the time 2R/c."""
    across = np.linspace(-SIDE_M / 2, SIDE_M / 2, POINTS)
    histogram = np.zeros((POINTS, POINTS, axis.bins))
    row, column = np.indices((POINTS, POINTS))
    for right, up, depth in points:
        far = np.sqrt((across[None, :] - right) ** 2 + (-across[:, None] - up) ** 2 + depth**2)
        place = ((2 * far / C - axis.start_s) / axis.width_s).astype(int)
        np.add.at(histogram, (row, column, np.clip(place, 0, axis.bins - 1)), far**-4.0)
    return histogram


@pytest.mark.parametrize(
    ("point", "late"), [((0.3, -0.2, 0.5), 0.0), ((-0.4, 0.4, 0.8), 0.4), ((0.1, 0.5, 0.35), 0.0)]
)
def test_a_point_is_found_where_it_is(point: tuple[float, float, float], late: float) -> None:
    """Its error is at most a column of voxels across and the depth of a bin, for any start of the time axis."""
    axis = TimeAxis(256, BIN_M / C, round(late / BIN_M) * BIN_M / C, "wall")
    volume, depths = migrated(light_of([point], axis), SIDE_M, SIDE_M, axis)
    layer, row, column = np.unravel_index(volume.argmax(), volume.shape)
    step = SIDE_M / (POINTS - 1)
    assert column * step - SIDE_M / 2 == pytest.approx(point[0], abs=step)
    assert SIDE_M / 2 - row * step == pytest.approx(point[1], abs=step)
    assert depths[layer] == pytest.approx(point[2], abs=1.5 * BIN_M)
    assert depth_of_brightest(volume, depths)[row, column] == pytest.approx(point[2], abs=1.5 * BIN_M)


def test_two_points_are_two() -> None:
    points = [(-0.3, 0.0, 0.5), (0.3, 0.1, 0.7)]
    volume, depths = migrated(light_of(points), SIDE_M, SIDE_M, AXIS)
    found = depth_of_brightest(volume, depths)
    step = SIDE_M / (POINTS - 1)
    for right, up, depth in points:
        row, column = round((SIDE_M / 2 - up) / step), round((right + SIDE_M / 2) / step)
        assert found[row, column] == pytest.approx(depth, abs=2 * BIN_M)


def test_nothing_gives_nothing_and_what_it_cannot_take_is_refused() -> None:
    volume, _ = migrated(np.zeros((4, 5, 32)), 1.0, 1.0, TimeAxis(32, BIN_M / C, 0.0, "wall"))
    assert volume.shape[1:] == (4, 5) and not volume.any()
    with pytest.raises(InputError, match="counts from the wall"):
        migrated(np.zeros((4, 4, 8)), 1.0, 1.0, TimeAxis(8, 1e-10, 0.0, "source"))
    with pytest.raises(InputError, match="1 × 4 points"):
        migrated(np.zeros((1, 4, 8)), 1.0, 1.0, TimeAxis(8, 1e-10, 0.0, "wall"))


@pytest.mark.parametrize("scenes", [1, pytest.param(10, marks=pytest.mark.nightly)])
def test_ready_configuration_is_reconstructed_to_two_centimetres(scenes: int) -> None:
    """Its counts, photon noise and all: depth of the brightest voxel against the label, at every label pixel that
    shows the object; the median of each scene, and of those the median."""
    config = load_config("configs/open_space_meshes.yaml")
    scan, axis = config.capture.scan, config.capture.time.axis()
    medians = []
    for index in range(scenes):
        arrays = simulate_sample(config, index).arrays
        counts = arrays["histogram"][:, 0].reshape(64, 64, -1).astype(np.float64)
        found = depth_of_brightest(*migrated(counts, scan.width_m, scan.height_m, axis))  # type: ignore[union-attr, arg-type]
        shown = arrays["depth"] > 0
        assert shown.sum() > 50
        medians.append(np.median(np.abs(found - arrays["depth"])[shown]))
    assert np.median(medians) < 0.02
    assert max(medians) < 0.03
