"""Pairs of laser point and pixel that stand for a scan."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from datagen.records import Capture, Scene, Sensor
from datagen.records.arrays import Floats, Ints
from datagen.transport.fov import FovPool, PixelCones, fov_points
from datagen.transport.raycast import Raycaster
from datagen.transport.vertices import LaserPoints

STATIONS = 16
"""Pairs of laser point and pixel that stand for a scan."""


@dataclass(frozen=True)
class Stations:
    """S pairs of laser point and pixel, and for how many of the scan's pairs each stands (of a flood, what share of
    its light).

    histogram : (S, 2) laser and pixel of its histogram.
    """

    lasers: LaserPoints
    seen: FovPool
    histogram: Ints
    times: Floats


def stations_of(caster: Raycaster, scene: Scene, capture: Capture) -> Stations | None:
    """Those of a capture; none where no laser ray meets the scene or no pixel sees it."""
    lasers, sensor = LaserPoints.of(caster, scene, capture.laser), capture.sensor
    met = caster.closest(sensor.position, sensor.pixels.mean(axis=1) - sensor.position)
    lit, sees = np.flatnonzero(lasers.part >= 0), np.flatnonzero(met.valid)
    if capture.pairing == "confocal":
        both = np.intersect1d(lit, sees)
        of, times = _spread_out(lasers.position[both], STATIONS)
        pairs = np.stack([both[of], both[of]], axis=1)
        histogram = np.stack([pairs[:, 0], np.zeros_like(of)], axis=1)
    else:
        few = min(len(lit), max(STATIONS // max(len(sees), 1), math.isqrt(STATIONS)))
        of_laser, lasers_each = _spread_out(lasers.position[lit], few)
        of_pixel, pixels_each = _spread_out(met.position[sees], STATIONS // max(few, 1))
        pairs = np.stack(np.meshgrid(lit[of_laser], sees[of_pixel], indexing="ij"), axis=-1).reshape(-1, 2)
        times, histogram = np.outer(lasers_each, pixels_each).reshape(-1), pairs.copy()
        if capture.illumination == "flood":
            times, histogram[:, 0] = times / len(lasers.part), 0
    if not len(pairs):
        return None
    chosen = LaserPoints(**{name: values[pairs[:, 0]] for name, values in vars(lasers).items()})
    few_pixels = Sensor(
        sensor.position, sensor.pixels[pairs[:, 1]], sensor.aperture_radius_m, finite_aperture=sensor.finite_aperture
    )
    middle = np.full((len(pairs), 1, 2), 0.5)
    seen = fov_points(caster, scene, few_pixels, PixelCones.of(few_pixels), np.arange(len(pairs)), middle, 1)
    return Stations(chosen, seen, histogram, times)


def _spread_out(points: Floats, most: int) -> tuple[Ints, Floats]:
    """At most so many of n points (n, 3), each in the middle of its share of them, and how many these are.

    They are halved across their widest extent until there are enough.
    """
    groups = [np.arange(len(points))] if len(points) else []
    while groups and len(groups) < most:
        sizes = [len(members) for members in groups]
        largest = sizes.index(max(sizes))
        if sizes[largest] < 2:
            break
        members = groups.pop(largest)
        there = points[members]
        along = int((there.max(axis=0) - there.min(axis=0)).argmax())
        ordered = members[there[:, along].argsort(kind="stable")]
        groups[largest:largest] = [ordered[: len(ordered) // 2], ordered[len(ordered) // 2 :]]
    chosen = np.empty(len(groups), np.int64)
    for k, members in enumerate(groups):
        away = points[members] - points[members].mean(axis=0)
        chosen[k] = members[np.einsum("nk,nk->n", away, away).argmin()]
    return chosen, np.array([len(members) for members in groups], np.float64)
