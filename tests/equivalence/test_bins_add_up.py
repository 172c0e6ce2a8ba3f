"""A bin is the integral of the flux between its edges: narrow bins add up to wide ones, whatever way computes the
light."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray
from rooms import bins_of_path, furnished_box, one_point_capture, square_pixels

from datagen import Accuracy, Capture, Laser, Sensor, TimeAxis, simulate
from datagen.paper.as_printed import AsPrinted, simulate_as_printed

FACTOR = 4
SCENE = furnished_box()


def axis(bins: int, width_m: float, origin: str = "wall") -> TimeAxis:
    """A time axis that begins after the first light has arrived and ends before the last."""
    return bins_of_path(bins, width_m, 1.2 if origin == "wall" else 3.2, origin)


def scan(time: TimeAxis) -> Capture:
    """A confocal scan, so that each pixel sees its laser point."""
    points = np.array([(0, -0.8, 1.4), (0, 0.4, 1.2)])
    device = (1.5, 0.1, 1.3)
    return Capture(Laser(device, points), Sensor(device, square_pixels(points, 0.2)), time, "confocal")


def added_up(narrow: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.asarray(narrow.reshape(*narrow.shape[:-1], -1, FACTOR).sum(axis=-1))


@pytest.mark.parametrize("origin", ["wall", "source"])
def test_walks_add_up_exactly(origin: str) -> None:
    """Path tracing, all orders: direct, primary, secondary and higher, and the light outside the window."""
    accuracy = Accuracy(samples=512, max_bounces=5, direct=True)
    wide, narrow = (simulate(SCENE, scan(axis(40 * n, 0.2 / n, origin)), accuracy, seed=3) for n in (1, FACTOR))
    assert wide.components.keys() >= {"direct", "primary", "secondary", "higher"}
    for name, transient in wide.components.items():
        np.testing.assert_allclose(added_up(narrow.components[name]), transient, rtol=1e-11)
        assert transient.any() or (name == "direct" and origin == "wall")
    np.testing.assert_allclose(narrow.overflow, wide.overflow, rtol=1e-11)
    assert wide.overflow.all()


def test_a_target_adds_up_to_within_itself() -> None:
    """The width of bins decides how finely surfaces are cut, so two runs differ, each within its target of the same
    truth."""
    target = 0.02
    wide, narrow = (
        simulate(SCENE, scan(axis(40 * n, 0.2 / n)), Accuracy(target=target, max_bounces=3), seed=3).total
        for n in (1, FACTOR)
    )
    assert np.linalg.norm(added_up(narrow) - wide) < 2 * target * np.linalg.norm(wide)


def test_the_paper_s_estimator_adds_up_exactly() -> None:
    wide, narrow = (
        simulate_as_printed(SCENE, one_point_capture(time=axis(40 * n, 0.2 / n)), AsPrinted(6, 12))
        for n in (1, FACTOR)
    )
    for name, transient in wide.components.items():
        np.testing.assert_allclose(added_up(narrow.components[name]), transient, rtol=1e-11)
        assert transient.any()
    np.testing.assert_allclose(narrow.overflow, wide.overflow, rtol=1e-11)
