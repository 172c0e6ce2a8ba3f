"""Flood illumination: one wide beam as a weighted sum over laser points.

A flood lights a whole field of view at once, so a pixel has one histogram: the weighted mean over L laser points of
the transients that they would give if each got all of the light,

    transient(t) = Σ_l w_l transient_l(t),    Σ_l w_l = 1  (`Laser.weights`; equal weights where none are given),

which is a quadrature of the integral over the lit patch of wall. If the laser points are the middles of equal cells,
its error is of second order in the size of a cell where the transient varies smoothly over the patch, and of first
order where it has steps (a zone that ends inside a cell, the edge of a shadow). With four laser points in a zone 2 m
away the first return is within 0.2 % of the integral (`tests/capture/test_flood.py` checks the order).

A beam that states the cells of its laser points (`Laser.flood`) is integrated over the whole cells instead: light of
one bounce, which is what a sensor sees that looks straight at things, with thousands of rays (`one_bounce_of_beam`),
light of more bounces from random laser points in all cells (`laser_points.py`), whose error is part of the claim. Its
light of two bounces is an integral over the same rays (`two_bounces_of_beam`), by which captures are compared with
their simulation; `simulate` has it from paths.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from datagen.records import Capture, Laser, Scene, Sensor, TimeAxis
from datagen.records.arrays import Floats, Ints
from datagen.seeding import LightStream
from datagen.transport.brdf import MaterialTable, cosine_directions
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


def light_at_flooded_sensor(problem: Problem, found: Estimate, beam: Beam | None) -> Estimate:
    """The light of a flood as its pixels record it (`light_at_sensor`), with that of one bounce of its `beam`, which
    `found` lacks, and that of the cover glass."""
    capture = problem.capture
    components = {name: light_at_sensor(light, capture) for name, light in found.components.items()}
    parts = {name: light_at_sensor(light, capture) for name, light in found.parts.items()}
    overflow = found.overflow
    if beam is not None:
        components["direct"] += light_at_sensor(beam.light.sum(axis=0)[None], capture) + glass_light(capture)
        overflow = overflow + beam.outside
        for name, own in zip(problem.scene.part_names if problem.split_parts else (), beam.light, strict=False):
            parts[name] = parts.get(name, 0.0) + light_at_sensor(own[None], capture)
    return replace(found, components=components, parts=parts, overflow=overflow)


def as_scan(capture: Capture) -> Capture:
    """The scan of a flood's laser points one by one, of which `sum_of_flood` makes the flood."""
    bare = replace(capture.sensor, crosstalk=0.0, glass=None, delays_s=None)
    return replace(capture, illumination="scan", sensor=bare)


def sum_of_flood(light: Floats, capture: Capture) -> Floats:
    """Light (1, P, T) of a whole flood, from the light (L, P, T) that each laser point would give with all of it."""
    return light_at_sensor(np.einsum("l,lpt->pt", capture.laser.shares, light)[None], capture)


def light_at_sensor(light: Floats, capture: Capture) -> Floats:
    """Light (1, P, T) as the pixels record it: with the crosstalk of all others, and late by each pixel's delay."""
    share = capture.sensor.crosstalk
    if share > 0:
        light = light + share * (light.sum(axis=1, keepdims=True) - light)
    return with_delays(light, capture.sensor, capture.time)


def glass_light(capture: Capture) -> Floats:
    """Light (1, P, T) that the cover glass sends straight back to each pixel, at the moment of emission."""
    sensor, axis = capture.sensor, capture.time
    glass = np.zeros((1, capture.shape[1], axis.bins))
    at = math.floor(-axis.start_s / axis.width_s)
    if sensor.glass is not None and 0 <= at < axis.bins:
        glass[0, :, at] = sensor.glass
    return with_delays(glass, sensor, axis)


def with_delays(light: Floats, sensor: Sensor, axis: TimeAxis) -> Floats:
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


def beam_rays(laser: Laser, rays: int = RAYS) -> tuple[Floats, Floats, Floats]:
    """Directions (n, 3) of the rays of a beam that states its cells, their shares (n,) of the light, and two numbers
    (n, 2) of each in 0 … 1 for what it does where it arrives.

    Each cell has equally many, a power of two and so many that there are `rays` or more in all. They are
    quasi-random: all points of a row of a regular grid would lie on the same side of a zone's edge.
    """
    assert laser.cells is not None
    cells = len(laser.cells)
    each = 1 << max(math.ceil(math.log2(rays / cells)), 0)
    uv = scrambled_sobol(stream_seeds(0, LightStream.BEAM, np.arange(cells)), each, 4)
    a, b, _, d = (laser.cells[:, None, k] - laser.position for k in range(4))
    directions = a + uv[..., :1] * (b - a) + uv[..., 1:2] * (d - a)
    return directions.reshape(-1, 3), np.repeat(laser.shares / each, each), uv[..., 2:].reshape(-1, 2)


class _Vertices(NamedTuple):
    """n points where rays of a beam meet surfaces.

    x (n, 3); normal (n, 3) on the side of the light; part (n,) indices; back (n, 3) unit directions to where light
    comes from; power (n,) photons that arrive per emitted photon; length_m (n,) of the path so far, and legs_m (n,),
    what of it counts for the time axis.
    """

    x: Floats
    normal: Floats
    part: Ints
    back: Floats
    power: Floats
    length_m: Floats
    legs_m: Floats


def one_bounce_of_beam(
    scene: Scene, capture: Capture, caster: Raycaster, materials: MaterialTable, rays: int = RAYS
) -> Beam:
    """Light of one bounce of a beam that states its cells.

    It is the integral of equation (1) of `reference.py` with B = 1 over the beam, with the sensitivity s of a pixel
    in the direction of the laser point x from the sensor:

        L = Σ_rays share · exp(−κ (R_l + R_s)) f cosθ_s V A / R_s² · s.
    """
    light, outside = one_bounce_by_angle(scene, capture, caster, materials, (1.0,), rays)
    return Beam(light[:, 0], outside)


def one_bounce_by_angle(
    scene: Scene, capture: Capture, caster: Raycaster, materials: MaterialTable, cosines: Sequence[float],
    rays: int = RAYS,
) -> tuple[Floats, Floats]:  # fmt: skip
    """`one_bounce_of_beam`, divided among angles: light (K, N, P, T) by part and node, and what arrives outside (P,).

    cosines : (N,) nodes, rising. Both nodes about the mean of the cosines of incidence and exitance share the light,
        as linear interpolation does. So a BRDF of r(cosine) times that of `materials`, with r linear between nodes,
        gives Σ r(node) light(node).
    """
    vertices, _ = _hits_of_beam(scene, capture, caster, rays)
    kept, pixel, photons, place = _deposits(scene, capture, caster, materials, vertices)
    to_sensor = capture.sensor.position - vertices.x
    cosine = dots(vertices.normal, vertices.back)
    cosine = 0.5 * (cosine + dots(vertices.normal, to_sensor) / np.linalg.norm(to_sensor, axis=1))
    node = np.interp(cosine, cosines, np.arange(len(cosines)))[kept]
    axis, pixels, count = capture.time, len(capture.sensor.pixels), len(cosines)
    inside = (place >= 0) & (place < axis.bins)
    size = len(scene.part_names) * count * pixels * axis.bins
    light, low = np.zeros(size), node.astype(np.int64)
    for at, share in ((low, 1 - (node - low)), (np.minimum(low + 1, count - 1), node - low)):
        to = ((vertices.part[kept] * count + at) * pixels + pixel) * axis.bins + place
        light += np.bincount(to[inside], (photons * share)[inside], size)
    late = np.bincount(pixel[~inside], photons[~inside], pixels).astype(np.float64)
    return light.reshape(-1, count, pixels, axis.bins), late


def two_bounces_of_beam(
    scene: Scene, capture: Capture, caster: Raycaster, materials: MaterialTable, rays: int = RAYS
) -> Floats:
    """Light (K, K, P, T) of two bounces of a beam that states its cells, by the part of the first and of the second.

    It is the integral of equation (1) of `reference.py` with B = 2. From where a ray of the beam meets the scene it
    goes on in a direction with the density cosθ / π about the normal, and what it meets is joined to the sensor:

        L = Σ_rays share · exp(−κ (R_l + R + R_s)) π f₁ f₂ cosθ_s V A / R_s² · s.
    """
    first, uv = _hits_of_beam(scene, capture, caster, rays)
    out = cosine_directions(first.normal, uv)
    hits = caster.closest(first.x + caster.offset_m * first.normal, out)
    met = hits.valid
    power = first.power * np.pi * brdf(materials.kind, materials.values, first.part, first.normal, first.back, out)
    x = hits.position[met]
    between = np.linalg.norm(x - first.x[met], axis=1)
    second = _Vertices(
        x, hits.normal[met], scene.face_part[hits.face[met]].astype(np.int64), -out[met],
        power[met] * np.exp(-scene.attenuation_per_m * between), first.length_m[met] + between,
        first.legs_m[met] + between,
    )  # fmt: skip
    kept, pixel, photons, place = _deposits(scene, capture, caster, materials, second)
    axis, pixels, parts = capture.time, len(capture.sensor.pixels), len(scene.part_names)
    inside = (place >= 0) & (place < axis.bins)
    pair = first.part[met] * parts + second.part
    to = (pair[kept] * pixels + pixel) * axis.bins + place
    light = np.bincount(to[inside], photons[inside], parts**2 * pixels * axis.bins)
    return np.asarray(light.reshape(parts, parts, pixels, axis.bins), np.float64)


def _hits_of_beam(scene: Scene, capture: Capture, caster: Raycaster, rays: int) -> tuple[_Vertices, Floats]:
    """Where the rays of a beam meet the scene, and two numbers (n, 2) of each for the direction in which it goes
    on."""
    laser, source = capture.laser, capture.time.origin == "source"
    directions, power, uv = beam_rays(laser, rays)
    hits = caster.closest(laser.position, directions)
    met = hits.valid
    x = hits.position[met]
    leg = np.linalg.norm(laser.position - x, axis=1)
    vertices = _Vertices(
        x, hits.normal[met], scene.face_part[hits.face[met]].astype(np.int64), (laser.position - x) / leg[:, None],
        power[met] * np.exp(-scene.attenuation_per_m * leg), leg, leg * source,
    )  # fmt: skip
    return vertices, uv[met]


def _deposits(
    scene: Scene, capture: Capture, caster: Raycaster, materials: MaterialTable, vertices: _Vertices
) -> tuple[Ints, Ints, Floats, Ints]:
    """What the pixels get from vertices: of each pair of a vertex and a pixel that sees it, the number of the vertex
    and of the pixel, the photons, and the number of the bin, which may lie outside the window. (m,) each."""
    sensor, axis = capture.sensor, capture.time
    to_sensor = sensor.position - vertices.x
    r = np.linalg.norm(to_sensor, axis=1)
    w = to_sensor / r[:, None]
    f = brdf(materials.kind, materials.values, vertices.part, vertices.normal, vertices.back, w)
    photons = vertices.power * np.exp(-scene.attenuation_per_m * r) * f * np.maximum(dots(vertices.normal, w), 0.0)
    photons *= aperture_area(capture, r) / r**2
    lit = np.flatnonzero(photons > 0)
    lit = lit[~caster.occluded(sensor.position, vertices.x[lit] + caster.offset_m * vertices.normal[lit])]
    seen = _sensitivities(sensor, -w[lit])
    pixel, row = np.nonzero(seen)
    path = vertices.legs_m + r * (axis.origin == "source")
    place = np.floor((time_from_path(path[lit[row]]) - axis.start_s) / axis.width_s).astype(np.int64)
    return lit[row], pixel, photons[lit[row]] * seen[pixel, row], place


def _sensitivities(sensor: Sensor, w: Floats) -> Floats:
    """(P, n) sensitivities of the pixels in directions w (n, 3) from the sensor; 0 outside a pixel."""
    if sensor.footprints is None:
        planes = PixelCones.of(sensor).planes
        return np.asarray((np.einsum("pjk,nk->pnj", planes, w).min(axis=2) >= 0).astype(np.float64))
    uv, inside = place_in_pixels(sensor, w)
    return sensitivity(sensor.footprints, np.arange(len(uv))[:, None], uv) * inside
