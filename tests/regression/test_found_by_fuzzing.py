"""Cases that the fuzzer found, kept as they are."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh
from rooms import bins_of_path, furnished_box, one_point_capture, rectangle, square_pixels
from scipy import stats

from datagen import (
    Accuracy,
    Capture,
    Exposure,
    Lambertian,
    Laser,
    Part,
    Scene,
    Sensor,
    Spad,
    TimeAxis,
    detect,
    simulate,
)
from datagen.errors import InputError, InputWarning


def test_a_laser_that_meets_nothing_has_no_shares_of_work() -> None:
    """No work was done, and the shares of it were divided by zero."""
    floor = Scene.from_parts([Part("floor", rectangle((0, 0, -1.5), (1.5, 0, 0), (0, 1.5, 0)), Lambertian(0.5))])
    capture = Capture(Laser((0, 0, 0.0), [[0.2, 0.2, 0.2]]), Sensor((1.0, 0, 0), square_pixels([[0, 0, 0]], 0.1)),
                      bins_of_path(4, 1.0, 0.0))  # fmt: skip
    with pytest.warns(InputWarning, match="no pixel sees a surface"):
        result = simulate(floor, capture, Accuracy(samples=1, max_bounces=3), seed=0)
    assert not result.total.any() and not result.overflow.any()


def test_a_pixel_around_the_sensor_is_refused() -> None:
    """Seen from within its own plane a pixel covered half of all directions, and the middle one was 0/0."""
    capture = one_point_capture(fov_center=(1.5, 0.17, 1.33))
    with pytest.raises(InputError, match=r"pixels\[0\].*within the pixel"):
        simulate(furnished_box(), capture, Accuracy(samples=1, max_bounces=3))


@pytest.mark.parametrize("mode", ["free_running", "synchronous"])
def test_an_event_that_is_due_after_1e24_cycles(mode: str) -> None:
    """Subtracting 10²⁴ laps of Λ = 10⁻²⁴ left a negative rest: an index far outside the table, a crash."""
    for pixels in (1, 2):
        spad = Spad(1e-12, dead_time_s=1.1e-10, afterpulse_probability=0.05, mode=mode,  # type: ignore[arg-type]
                    crosstalk_probability=0.1)  # fmt: skip
        exposure = Exposure(1 / 2.74e-12, 2, 1.0)
        transient = np.full((200, pixels, 2), 5e-13)
        assert not detect(transient, TimeAxis(2, 1e-12), spad, exposure, tolerance=0.0).any()


def test_rare_events_fall_into_all_bins_alike() -> None:
    """After 10¹¹ empty cycles an event's phase was what rounding left of it. χ² at 10⁻³."""
    flux, cycles = np.full(64, 8e-12 / 64), 2**40
    spad = Spad(1.0, dead_time_s=5e-9)
    counts = detect(np.tile(flux, (2000, 1, 1)), TimeAxis(64, 1e-9), spad, Exposure(1 / 64e-9, cycles, 1.0),
                    tolerance=0.0).sum(axis=(0, 1))  # fmt: skip
    mean = counts.sum() / 64
    assert counts.sum() > 10_000
    assert ((counts - mean) ** 2 / mean).sum() < stats.chi2(63).isf(1e-3)


def test_traps_that_would_take_minutes_to_forget_are_refused() -> None:
    """Eight release times of a second at 30 MHz were run through before two cycles of exposure."""
    spad = Spad(1.0, dead_time_s=1e-9, afterpulse_probability=0.05, afterpulse_times_s=(1.0,))
    with pytest.raises(InputError, match=r"before the exposure.*afterpulse_times_s"):
        detect(np.full(33, 1.0), TimeAxis(33, 1e-9), spad, Exposure(1 / 33e-9, 2, 1.0))


def test_bright_triangles_under_dark_ones_are_hidden() -> None:
    """They took minutes of work, and were given up."""
    ball = trimesh.creation.icosphere(subdivisions=1, radius=0.4)
    ball.apply_translation((0.2, 0.1, 1.0))
    both = [Part(name, ball, Lambertian(albedo), "object") for name, albedo in (("under", 0.5), ("over", 0.0005))]
    wall = Part("wall", rectangle((0, 0, 0), (1.5, 0, 0), (0, 1.5, 0)), Lambertian(0.8), "relay_wall")
    points = np.array([[0.3, 0.2, 0.0], [-0.6, 0.4, 0.0]])
    capture = Capture(
        Laser((0, 0, 2.0), points), Sensor((0, 0, 2.0), square_pixels(points, 0.02)), bins_of_path(32, 0.1, 0.0),
        pairing="confocal",
    )  # fmt: skip
    with pytest.warns(InputWarning, match="'over' is taken to lie on 'under'"):
        found = simulate(Scene.from_parts([wall, *both]), capture, Accuracy(target=0.02, max_bounces=3), seed=0)
    alone = simulate(Scene.from_parts([wall, both[1]]), capture, Accuracy(target=0.02, max_bounces=3), seed=0)
    assert found.parts["under"].sum() == 0.0 < found.parts["over"].sum()
    np.testing.assert_allclose(found.total.sum(), alone.total.sum(), rtol=0.02)
