"""Flood illumination: one wide beam as a weighted sum over laser points.

A flood lights a whole field of view at once, so a pixel has one histogram: the weighted mean over L laser points of
the transients that they would give if each got all of the light,

    transient(t) = Σ_l w_l transient_l(t),    Σ_l w_l = 1  (`Laser.weights`; equal weights where none are given),

which is a quadrature of the integral over the lit patch of wall. If the laser points are the middles of equal cells,
its error is of second order in the size of a cell where the transient varies smoothly over the patch, and of first
order where it has steps (a zone that ends inside a cell, the edge of a shadow). With four laser points in a zone 2 m
away the first return is within 0.2 % of the integral (`tests/capture/test_flood.py` checks the order).

A beam that states the cells of its laser points (`Laser.flood`) has its light of one bounce integrated over the
whole cells instead, with thousands of rays (`one_bounce_of_beam`): that is what a sensor sees that looks straight at
things.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from datagen.records import Capture, Laser, Scene, Sensor, TimeAxis
from datagen.records.arrays import Floats
from datagen.seeding import LightStream
from datagen.transport.brdf import MaterialTable
from datagen.transport.fields_of_view import PixelCones, place_in_pixels, sensitivity
from datagen.transport.problem import Estimate, Problem
from datagen.transport.rays import Raycaster
from datagen.transport.reference import aperture_area, brdf, dots
from datagen.transport.sampling import scrambled_sobol, stream_seeds
from datagen.units import time_from_path

RAYS = 1 << 15
"""Fewest rays of a beam's light of one bounce, 30 ms. Halved, the light of zones of 20 × 20 degrees before objects
with edges errs by up to 0.7 % instead of 0.4 %."""


class Beam(NamedTuple):
    """Light of one bounce of a beam that states its cells: light (K, P, T) by the part that it comes from, and what
    arrives outside the window (P,); photons at the aperture per emitted photon."""

    light: Floats
    outside: Floats


def at_flooded_sensor(problem: Problem, found: Estimate, beam: Beam | None) -> Estimate:
    """The light of a flood as its pixels record it (`at_sensor`), with that of one bounce of its `beam`, which
    `found` lacks, and that of the cover glass."""
    capture = problem.capture
    components = {name: at_sensor(light, capture) for name, light in found.components.items()}
    parts = {name: at_sensor(light, capture) for name, light in found.parts.items()}
    overflow = found.overflow
    if beam is not None:
        components["direct"] += at_sensor(beam.light.sum(axis=0)[None], capture) + glass_light(capture)
        overflow = overflow + beam.outside
        for name, own in zip(problem.scene.part_names if problem.split_parts else (), beam.light, strict=False):
            parts[name] = parts.get(name, 0.0) + at_sensor(own[None], capture)
    return replace(found, components=components, parts=parts, overflow=overflow)


def as_scan(capture: Capture) -> Capture:
    """The scan of a flood's laser points one by one, of which `sum_of_flood` makes the flood."""
    bare = replace(capture.sensor, crosstalk=0.0, glass=None, delays_s=None)
    return replace(capture, illumination="scan", sensor=bare)


def sum_of_flood(light: Floats, capture: Capture) -> Floats:
    """Light (1, P, T) of a whole flood, from the light (L, P, T) that each laser point would give with all of it."""
    return at_sensor(np.einsum("l,lpt->pt", capture.laser.shares, light)[None], capture)


def at_sensor(light: Floats, capture: Capture) -> Floats:
    """Light (1, P, T) as the pixels record it: with the crosstalk of all others, and late by each pixel's delay."""
    share = capture.sensor.crosstalk
    if share > 0:
        light = light + share * (light.sum(axis=1, keepdims=True) - light)
    return delayed(light, capture.sensor, capture.time)


def glass_light(capture: Capture) -> Floats:
    """Light (1, P, T) that the cover glass sends straight back to each pixel, at the moment of emission."""
    sensor, axis = capture.sensor, capture.time
    glass = np.zeros((1, capture.shape[1], axis.bins))
    at = math.floor(-axis.start_s / axis.width_s)
    if sensor.glass is not None and 0 <= at < axis.bins:
        glass[0, :, at] = sensor.glass
    return delayed(glass, sensor, axis)


def delayed(light: Floats, sensor: Sensor, axis: TimeAxis) -> Floats:
    """Light (1, P, T) moved by each pixel's delay (`Sensor.delays_s`).

    A delay between two whole bins shares the light between both, which keeps its mean time. Light that leaves the
    window is lost.
    """
    if sensor.delays_s is None:
        return light
    out = np.zeros_like(light)
    for p, bins in enumerate(sensor.delays_s / axis.width_s):
        whole = math.floor(bins)
        for shift, share in ((whole, 1 - (bins - whole)), (whole + 1, bins - whole)):
            kept = axis.bins - abs(shift)
            if kept > 0:
                late, early = max(shift, 0), max(-shift, 0)
                out[:, p, late : late + kept] += share * light[:, p, early : early + kept]
    return out


def beam_rays(laser: Laser, rays: int = RAYS) -> tuple[Floats, Floats]:
    """Directions (n, 3) of the rays of a beam that states its cells, and their shares (n,) of the light.

    Each cell has equally many, a power of two and so many that there are `rays` or more in all. They are
    quasi-random: all points of a row of a regular grid would lie on the same side of a zone's edge.
    """
    assert laser.cells is not None
    cells = len(laser.cells)
    each = 1 << max(math.ceil(math.log2(rays / cells)), 0)
    uv = scrambled_sobol(stream_seeds(0, LightStream.BEAM, np.arange(cells)), each, 2)
    a, b, _, d = (laser.cells[:, None, k] - laser.position for k in range(4))
    directions = a + uv[..., :1] * (b - a) + uv[..., 1:] * (d - a)
    return directions.reshape(-1, 3), np.repeat(laser.shares / each, each)


def one_bounce_of_beam(
    scene: Scene, capture: Capture, caster: Raycaster, materials: MaterialTable, rays: int = RAYS
) -> Beam:
    """Light of one bounce of a beam that states its cells.

    It is the integral of equation (1) of `reference.py` with B = 1 over the beam, with the sensitivity s of a pixel
    in the direction of the laser point x from the sensor:

        L = Σ_rays share · exp(−κ (R_l + R_s)) f cosθ_s V A / R_s² · s.
    """
    laser, sensor, axis = capture.laser, capture.sensor, capture.time
    directions, power = beam_rays(laser, rays)
    hits = caster.closest(laser.position, directions)
    directions, power = directions[hits.valid], power[hits.valid]
    x, normal = hits.position[hits.valid], hits.normal[hits.valid]
    part = scene.face_part[hits.face[hits.valid]].astype(np.int64)
    back, to_sensor = laser.position - x, sensor.position - x
    leg, r = np.linalg.norm(back, axis=1), np.linalg.norm(to_sensor, axis=1)
    back, w = back / leg[:, None], to_sensor / r[:, None]
    f = brdf(materials.kind, materials.values, part, normal, back, w)
    air = np.exp(-scene.attenuation_per_m * (leg + r))
    photons = power * air * f * np.maximum(dots(normal, w), 0.0) * aperture_area(capture, r) / r**2
    lit = np.flatnonzero(photons > 0)
    lit = lit[~caster.occluded(sensor.position, x[lit] + caster.offset_m * normal[lit])]
    seen = _sensitivities(sensor, -w[lit])
    pixel, ray = np.nonzero(seen)
    photons = photons[lit[ray]] * seen[pixel, ray]
    path = leg[lit] + r[lit] if axis.origin == "source" else np.zeros(len(lit))
    place = np.floor((time_from_path(path[ray]) - axis.start_s) / axis.width_s)
    inside = (place >= 0) & (place < axis.bins)
    parts, pixels = len(scene.part_names), len(sensor.pixels)
    to = (part[lit[ray]] * pixels + pixel) * axis.bins + place.astype(np.int64)
    light = np.bincount(to[inside], photons[inside], parts * pixels * axis.bins).astype(np.float64)
    late = np.bincount(pixel[~inside], photons[~inside], pixels).astype(np.float64)
    return Beam(light.reshape(parts, pixels, axis.bins), late)


def _sensitivities(sensor: Sensor, w: Floats) -> Floats:
    """(P, n) sensitivities of the pixels in directions w (n, 3) from the sensor; 0 outside a pixel."""
    if sensor.footprints is None:
        planes = PixelCones.of(sensor).planes
        return np.asarray((np.einsum("pjk,nk->pnj", planes, w).min(axis=2) >= 0).astype(np.float64))
    uv, inside = place_in_pixels(sensor, w)
    return sensitivity(sensor.footprints, np.arange(len(uv))[:, None], uv) * inside
