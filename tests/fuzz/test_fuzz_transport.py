"""The transport against its laws on random scenes: see `light_laws.py` for what every transient obeys."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from fuzz_profile import NIGHTLY, assume, fuzzed, st
from light_laws import ROUNDING, assert_lawful, energy, simulated
from random_light import Case, cases, points, resized, rewindowed, scenes, seeds
from scipy import stats

from datagen import Accuracy, Capture, Laser, Sensor, TimeAxis, simulate
from datagen.errors import InputError
from datagen.records import Transient
from datagen.transport.fields_of_view import PixelCones

# Windows, devices and parts are drawn at random, too: laws hold whatever is most likely not meant.
pytestmark = pytest.mark.filterwarnings("ignore:simulate. :datagen.InputWarning")
FAMILY_LEVEL = 1e-3
"""Probability that the statistical tests of this file fail by chance in one run, nightly or not."""
FAINTEST = 1e18 * float(np.finfo(float).tiny)
"""Energies below it, as left by metres of dense fog, are products of numbers too small to have all their digits."""
RECIPROCITY_CASES = 100 if NIGHTLY else 5


def simulated_or_refused(case: Case) -> Transient:
    """A random pixel may lie behind the sensor, or be seen edge-on: that is refused, in one line."""
    try:
        return simulated(case)
    except InputError as error:
        assert "\n" not in str(error) and str(error).startswith("Sensor.pixels")
        assume(False)
        raise


@fuzzed(60, 900, cases())
def test_every_transient_obeys_the_laws(case: Case) -> None:
    result = simulated_or_refused(case)
    assert_lawful(case, result)
    again = simulated(case)
    for name, values in result.components.items():
        assert values.tobytes() == again.components[name].tobytes(), f"{name}: same seed, other bytes"
    assert result.overflow.tobytes() == again.overflow.tobytes()


@fuzzed(20, 200, cases(counts=True), st.integers(-8, 10))
def test_a_scene_twice_as_large_is_the_same_to_the_last_bit(case: Case, exponent: int) -> None:
    """Energy × 4⁻ᵏ, times × 2ᵏ; powers of two round alike, so nothing else may depend on the unit of length."""
    sensor = replace_aperture(case.capture.sensor)
    case = replace(case, capture=replace(case.capture, sensor=sensor))
    result, larger = simulated_or_refused(case), simulated(resized(case, exponent))
    for name, values in result.components.items():
        again = larger.components[name] * 4.0**exponent
        np.testing.assert_allclose(again, values, rtol=1e-9, atol=FAINTEST, err_msg=name)
    np.testing.assert_allclose(larger.overflow * 4.0**exponent, result.overflow, rtol=1e-9, atol=FAINTEST)


def replace_aperture(sensor: Sensor) -> Sensor:
    """With a small aperture, whose share A/R² is homogeneous."""
    return Sensor(sensor.position, sensor.pixels, sensor.aperture_radius_m)


@fuzzed(20, 200, cases(counts=True), st.sampled_from([1, 3, 50]), st.sampled_from([-2.0, 0.0, 0.5, 3.0, 20.0, 1e4]))
def test_no_energy_is_lost_or_made_by_the_window(case: Case, bins: int, start_m: float) -> None:
    """What is in no bin is in the overflow: their sum is the same for every window.

    Of all orders it is so in the mean only, for the roulette that ends them spares light within the window.
    """
    case = replace(case, accuracy=replace(case.accuracy, max_bounces=case.accuracy.max_bounces or 6))
    result = simulated_or_refused(case)
    other = simulated(rewindowed(case, bins, start_m / 299792458.0))
    whole, windowed = energy(result), energy(other)
    np.testing.assert_allclose(windowed, whole, rtol=ROUNDING, atol=ROUNDING * whole.max(initial=0.0))


@fuzzed(
    RECIPROCITY_CASES,
    RECIPROCITY_CASES,
    scenes(smooth=True),
    points,
    points,
    points,
    seeds,
)
def test_laser_point_and_field_of_view_may_be_swapped(
    scene: object, eye: tuple, one: tuple, other: tuple, seed: int
) -> None:
    """Per solid angle the energy between two points is the same both ways, whatever the materials.

    Student's t of 16 replicates each, at FAMILY_LEVEL over all cases; a case beyond it is decided by 32 times the
    samples, as rare bright paths make the first estimate's own error too small.
    """
    # Off the lattice, another way along each axis: half of a pixel at the edge of a wall looks past it.
    off = np.array([(0.0371, 0.0289, 0.0333), (0.0513, 0.0467, 0.0391), (-0.0419, -0.0283, -0.0357)])
    device, a, b = np.array([eye, one, other]) + off
    assume(np.linalg.norm(a - device) > 0.2 and np.linalg.norm(b - device) > 0.2)
    for samples in (256, 1 << 13):
        accuracy = Accuracy(samples=samples, max_bounces=5)
        there = np.array([between(scene, device, a, b, accuracy, seed + 7 * s) for s in range(16)])
        back = np.array([between(scene, device, b, a, accuracy, seed + 7 * s + 3) for s in range(16)])
        # Behind many metres of dense fog so little is left that its square is no number any more.
        scale = max(there.max(), back.max()) or 1.0
        there, back = there / scale, back / scale
        error = math.hypot(stats.sem(there), stats.sem(back))
        gap = abs(there.mean() - back.mean())
        if gap <= ROUNDING * there.mean() + error * stats.t.isf(FAMILY_LEVEL / 2 / RECIPROCITY_CASES, 30):
            return
    pytest.fail(f"{there.mean():g} one way, {back.mean():g} the other, ± {error:g}, in units of {scale:g}")


def between(
    scene: object, device: np.ndarray, start: np.ndarray, end: np.ndarray, accuracy: Accuracy, seed: int
) -> float:
    """Energy per solid angle from a laser point to a tiny field of view, both looked at from one place."""
    along = (end - device) / np.linalg.norm(end - device)
    across = np.cross(along, np.eye(3)[np.abs(along).argmin()])
    across *= 1e-5 / np.linalg.norm(across)
    up = np.cross(along, across)
    corners = device + along + np.array([-across - up, across - up, across + up, up - across])
    sensor = Sensor(device, [corners])
    capture = Capture(Laser(device, [start]), sensor, TimeAxis(1, 1e-6))
    result = simulate(scene, capture, accuracy, seed=seed)  # type: ignore[arg-type]
    return float(energy(result)[0, 0] / PixelCones.of(sensor).solid_angle[0])
