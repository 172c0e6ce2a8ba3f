"""The secondary by path tracing and by the factorised form is the same light, and the options select what they
say."""

from __future__ import annotations

import numpy as np
import pytest
from rooms import bins_of_path, furnished_box, one_point_capture

from datagen import Accuracy, simulate
from datagen.errors import InputError

AXIS = bins_of_path(40, 0.5, 0.0)


def test_strongest_keep_less_and_more_of_them_keep_more() -> None:
    scene, capture = furnished_box(0.8), one_point_capture(time=AXIS)
    energy = [
        simulate(scene, capture, Accuracy(512, 8, 4, 2, observed=64, secondary=kept), seed=1)
        .components["secondary"]
        .sum()
        for kept in ("strongest", 1, 8, 64, "all")
    ]
    assert energy[0] == energy[1]
    assert energy[1] < energy[2] < energy[3]
    assert energy[3] == pytest.approx(energy[4], rel=1e-9)


def test_none_leaves_the_secondary_out_and_the_rest_alone() -> None:
    scene, capture = furnished_box(0.8), one_point_capture(time=AXIS)
    everything = simulate(scene, capture, Accuracy(1024, 4, 5, 2), seed=1)
    without = simulate(scene, capture, Accuracy(1024, 4, 5, 2, secondary="none"), seed=1)
    assert "secondary" not in without.components
    np.testing.assert_array_equal(without.components["higher"], everything.components["higher"])
    np.testing.assert_array_equal(without.components["primary"], everything.components["primary"])


@pytest.mark.parametrize(
    "kwargs", [{"secondary": "strongest"}, {"secondary": 0}, {"secondary": "some"}, {"observed": 0}]
)
def test_choices_that_mean_nothing_are_refused(kwargs: dict) -> None:
    with pytest.raises(InputError, match=r"Accuracy\.(secondary|observed)"):
        Accuracy(max_bounces=4, **kwargs)
