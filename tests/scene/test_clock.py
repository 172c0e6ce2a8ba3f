"""The times of the laser points of a sequence."""

from __future__ import annotations

from typing import Any, get_args

import numpy as np
import pytest

import datagen as dg
from datagen.errors import InputError
from datagen.records import Order

ORDERS: tuple[Order, ...] = get_args(Order)


@pytest.mark.parametrize("order", ORDERS)
@pytest.mark.parametrize(("rows", "columns"), [(4, 4), (3, 5), (1, 6), (7, 1), (2, 2)])
def test_every_point_is_measured_once_a_frame_and_inside_it(order: Order, rows: int, columns: int) -> None:
    points, rate = rows * columns, 12.5
    clock = dg.Clock(frames=6, rate_hz=rate, order=order, columns=columns)
    exposure = 0.9 / rate / points
    times = clock.times(points, exposure)
    assert times.shape == (6, points)
    within = times - clock.starts_s[:, None]
    assert (within > 0).all() and (within < 1 / rate).all()
    np.testing.assert_allclose(within, within[:1].repeat(6, axis=0), atol=1e-12)
    np.testing.assert_allclose(clock.middles(points, exposure), times.mean(axis=1), rtol=1e-12)
    assert clock.starts_s[0] == 0 and clock.duration_s == pytest.approx(6 / rate)
    if order == "together":
        np.testing.assert_allclose(within, exposure / 2)
        return
    # One after the other without a gap: exposures that do not overlap, in an order that has every number once.
    assert sorted(clock.turns(points)) == [*range(points)]
    np.testing.assert_allclose(np.diff(np.sort(within[0])), exposure)
    np.testing.assert_allclose(within[0].min(), exposure / 2)


def test_orders_are_what_they_are_called() -> None:
    columns, points = 4, 16
    place = np.stack(np.divmod(np.arange(points), columns), axis=1)
    ways = {order: np.argsort(dg.Clock(1, 1.0, order, columns).turns(points), kind="stable") for order in ORDERS}
    np.testing.assert_array_equal(ways["raster"], np.arange(points))
    # A galvo never flies back: each step goes to a neighbour.
    steps = np.abs(np.diff(place[ways["serpentine"]], axis=0)).sum(axis=1)
    assert (steps == 1).all() and (place[ways["serpentine"]][:4, 0] == 0).all()
    # Each quarter of the time covers the whole wall at half of the resolution.
    for quarter in np.split(place[ways["interleaved"]], 4):
        rows, columns_ = np.unique(quarter[:, 0]), np.unique(quarter[:, 1])
        assert len(rows) == len(columns_) == 2
        assert np.diff(rows) == 2 and np.diff(columns_) == 2
    first, second = (place[ways["interleaved"]][k] for k in (0, 4))
    assert (np.abs(second - first) == 1).all()


def test_rows_are_guessed_of_squares_alone() -> None:
    for order in ("serpentine", "interleaved"):
        guessed, given = (dg.Clock(2, 1.0, order, columns).turns(25) for columns in (None, 5))  # type: ignore[arg-type]
        np.testing.assert_array_equal(guessed, given)
        for columns in (None, 5):
            with pytest.raises(InputError, match=f"order = '{order}' and 24 laser points"):
                dg.Clock(2, 1.0, order, columns).turns(24)  # type: ignore[arg-type]
    assert dg.Clock(2, 1.0).turns(24).tolist() == [*range(24)]


def test_exposures_must_fit_into_a_frame() -> None:
    clock = dg.Clock(frames=16, rate_hz=10)
    clock.times(256, 0.1 / 256)
    with pytest.raises(InputError) as caught:
        clock.times(256, 0.1, repetition_rate_hz=10e6)
    message = str(caught.value)
    assert "a frame lasts 100 ms, and 256 exposures of 100 ms take 2.56e+04 ms" in message and "\n" not in message
    assert "3906 cycles (0.3906 ms at 10 MHz) fits for each, or lower rate_hz to 0.03906" in message
    # What the message names fits.
    clock.times(256, 3906 / 10e6)
    with pytest.raises(InputError):
        clock.times(256, 3907 / 10e6)
    with pytest.raises(InputError, match="not one cycle fits"):
        clock.times(256, 1.0, repetition_rate_hz=1e3)
    with pytest.raises(InputError, match=r"0.3906 ms fits for each"):
        clock.middles(256, 0.1)
    # A flash has the whole frame.
    dg.Clock(frames=16, rate_hz=10, order="together").times(256, 0.1)


@pytest.mark.parametrize(
    ("changed", "words"),
    [
        ({"frames": 0}, "Clock.frames = 0: must be an integer in 1 …"),
        ({"frames": 2.5}, "Clock.frames = 2.5"),
        ({"rate_hz": 0}, "Clock.rate_hz = 0"),
        ({"rate_hz": float("nan")}, "Clock.rate_hz = nan"),
        ({"order": "random"}, "must be one of raster, serpentine, interleaved, together"),
        ({"columns": 0}, "Clock.columns = 0"),
    ],
)
def test_bad_clocks_are_refused_in_one_line(changed: dict[str, Any], words: str) -> None:
    with pytest.raises(InputError) as caught:
        dg.Clock(**{"frames": 4, "rate_hz": 10, **changed})
    assert words in str(caught.value) and "\n" not in str(caught.value)
    for points, exposure in ((0, 0.1), (4, -1.0), (4, float("nan"))):
        with pytest.raises(InputError, match=r"Clock\.times"):
            dg.Clock(4, 10).times(points, exposure)
