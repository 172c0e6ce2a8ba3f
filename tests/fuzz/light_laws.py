"""What holds of every transient, whatever the scene: the laws that the fuzzer holds each case against."""

from __future__ import annotations

import math

import numpy as np
import trimesh
from every_brdf import kind_of
from random_light import Case

from datagen import simulate
from datagen.records import Scene, Sensor, Transient

ROUNDING = 1e-9
"""Sums of the same numbers in another order may differ by this share."""


def assert_lawful(case: Case, result: Transient) -> None:
    """No NaN, nothing negative, sums that add up, no more energy than came in."""
    shape, accuracy = case.capture.shape, case.accuracy
    for name, values in {**result.components, **result.parts, "overflow": result.overflow}.items():
        assert values.shape == (shape[:2] if name == "overflow" else shape), name
        assert np.isfinite(values).all(), f"{name}: not finite"
        assert (values >= 0).all(), f"{name}: negative, {values.min():g}"
    if accuracy.samples != 1:
        assert np.isfinite(result.stderr).all() and (result.stderr >= 0).all(), "standard error"
    else:
        assert np.isnan(result.stderr).all() or not result.total.any(), "one sample knows no standard error"
    _adds_up(result.total, result.components.values(), "components")
    if result.parts:
        _adds_up(result.components["primary"], result.parts.values(), "parts")
    missed = np.isnan(result.laser_points).any(axis=1)
    assert not result.total[missed].any() and not result.overflow[missed].any(), "light without a laser point"
    _bounded(case, result)


def _adds_up(total: np.ndarray, pieces: object, what: str) -> None:
    np.testing.assert_allclose(sum(pieces), total, rtol=1e-12, atol=0, err_msg=what)  # type: ignore[call-overload]


def energy(result: Transient) -> np.ndarray:
    """(L, P) in the window and outside it."""
    return np.asarray(result.total.sum(axis=2) + result.overflow)


def _bounded(case: Case, result: Transient) -> None:
    """At most the share ρ^(b−1) of the photon lights a pixel's patch for the b-th bounce, and no point of it sends
    more than max(f cosθ) · A/R² of that into the aperture; R is at least the distance to the nearest surface."""
    scene, accuracy = case.scene, case.accuracy
    albedo = max(material.albedo for material in scene.materials)
    last = accuracy.max_bounces
    if last is None and albedo > 0.99:
        return
    into_aperture = most_into_aperture(scene, case.capture.sensor)
    if not np.isfinite(into_aperture):
        # The sensor touches a surface: A/R² has no bound.
        return
    orders = range(1 if accuracy.direct else 3, (last or 200) + 1)
    share = sum(albedo ** (b - 1) for b in orders) * into_aperture
    if accuracy.samples is None or accuracy.samples >= 64:
        # The errors of all bins added: more than the error of their sum.
        allowed = share * (1 + 1e-6) + 10 * result.stderr.sum(axis=2)
        # What lies beyond the window has no standard error.
        assert (result.total.sum(axis=2) <= allowed).all(), "more energy than came in"


def most_into_aperture(scene: Scene, sensor: Sensor) -> float:
    """max(f cosθ) · A/R², or A/(R² + a²) for a finite aperture; inf where the sensor touches a surface."""
    corners = scene.corners
    nearest = trimesh.triangles.closest_point(corners, np.tile(sensor.position, (len(corners), 1)))
    square = float(((nearest - sensor.position) ** 2).sum(axis=1).min()) * (1 - 1e-6)
    square += sensor.aperture_radius_m**2 if sensor.finite_aperture else 0.0
    lobe = max(material.albedo * kind_of(material).highest(material) for material in scene.materials)
    return lobe * sensor.aperture_area_m2 / square if square > 1e-30 else math.inf


def simulated(case: Case) -> Transient:
    return simulate(case.scene, case.capture, case.accuracy, seed=case.seed)
