"""The evidence of each label pixel: expected detections of the light that comes by way of the surface seen there.

With y the point in the middle of a label pixel, which covers the area A of its surface, x a laser point and z the
middle of what a pixel of the sensor sees, the light of three bounces by way of y is (docs/physics.md)

    A f₁ cosθ₁ cosθ₂ V₁₂/R₁² · f₂ · cosθ₂′ cosθ₃ V₂₃/(R₂² + a/π) · f₃ W

photons, W the sensor's share and a the area that it sees, and arrives in one bin; what the detector makes of a photon
there is `detector.own_light.detections_per_photon`. Summed over the scan these are the expected detections from that
surface. Of a scan a few pairs stand for the others (`stations`), and of the label pixels on a plane those between a
few get what lies between (`refined`); no number is drawn.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from datagen.compiled import compiled
from datagen.evidence.refined import first_step, refined
from datagen.evidence.stations import Stations
from datagen.labels.images import HiddenSurface
from datagen.records import Capture, Scene
from datagen.records.arrays import Floats, Ints
from datagen.transport.brdf import MaterialTable, dot
from datagen.transport.cells.geometry import air, cross, get, less, unit
from datagen.transport.cells.weights import weight
from datagen.transport.raycast import Raycaster, lifted_and_scaled
from datagen.units import path_from_time

GRAZING = 0.02
"""Cosine up to which a surface seen at a slant covers more of itself."""


@dataclass(frozen=True)
class _Surface:
    """What label pixels see: points (rows, columns, 3) with unit normals that face the view, the area of each (m²),
    and its part, −1 for none."""

    position: Floats
    normal: Floats
    area: Floats
    part: Ints


def evidence_image(
    caster: Raycaster, found: HiddenSurface, capture: Capture, stations: Stations | None,
    detections_per_photon: Floats, step: int | None = None,
) -> NDArray[np.float32]:  # fmt: skip
    """(rows, columns) expected detections of the light of three bounces by way of what each label pixel sees.

    Parameters
    ----------
    caster : of the scene's triangles.
    found : what the label pixels see.
    stations : of the capture; None: nothing is lit or nothing looked at.
    detections_per_photon : (S, T), expected detections of the exposure for each photon at the aperture per emitted
        photon, of each bin of the stations' histograms.
    step : label pixels along a block before any is halved (`refined`); 1 asks each one. Left out, by the size.

    0 where nothing is seen, or no light comes from there. Over the pixels of an object that is wholly in view it adds
    up to the object's own detections, to some percent: of each label pixel only its middle is looked at.
    """
    there = found.face >= 0
    if stations is None or not there.any():
        return np.zeros(there.shape, np.float32)
    surface = _surface_of(found)
    ask = _asking(caster, found.scene, capture, surface, stations, detections_per_photon)
    step = first_step(*there.shape) if step is None else step
    each = refined(ask, there, surface.position, surface.normal, surface.part, len(stations.times), step)
    return np.asarray(each.sum(axis=2), np.float32)


def _surface_of(found: HiddenSurface) -> _Surface:
    """What the middles of the label pixels see."""
    scene, frame = found.scene, found.frame
    half_m = np.array([frame.half_width_m, frame.half_height_m])
    triangles = (scene.vertices, scene.triangles)
    position, normal, area = _points(found.face, found.depth, frame.center, frame.axes, half_m, *triangles)
    return _Surface(position, normal, area, np.append(scene.face_part, -1)[found.face].astype(np.int64))


@compiled()
def _points(face, depth, center, axes, half_m, vertices, triangles):  # type: ignore[no-untyped-def]
    """`_Surface.position`, `.normal` and `.area`."""
    rows, columns = face.shape
    position, normal, area = np.zeros((rows, columns, 3)), np.zeros((rows, columns, 3)), np.zeros(face.shape)
    pixel_m2 = 4.0 * half_m[0] * half_m[1] / (rows * columns)
    for row in range(rows):
        upward = (1.0 - 2.0 * (row + 0.5) / rows) * half_m[1]
        for column in range(columns):
            if face[row, column] < 0:
                continue
            a, b, c = triangles[face[row, column]]
            n = unit(cross(less(vertices[b], vertices[a]), less(vertices[c], vertices[a])))
            slant = dot(n, axes[2])
            area[row, column] = pixel_m2 / max(abs(slant), GRAZING)
            right = (2.0 * (column + 0.5) / columns - 1.0) * half_m[0]
            for k in range(3):
                normal[row, column, k] = -n[k] if slant > 0.0 else n[k]
                across = right * axes[0, k] + upward * axes[1, k]
                position[row, column, k] = center[k] + across + depth[row, column] * axes[2, k]
    return position, normal, area


def _asking(
    caster: Raycaster, scene: Scene, capture: Capture, surface: _Surface, stations: Stations, per_photon: Floats
) -> Callable[[Ints, Ints], Floats]:
    """For `refined`: the detections that label pixels bring at stations, each for the pairs that it stands for."""
    materials, lasers, seen = MaterialTable.of(scene.materials), stations.lasers, stations.seen
    gain = per_photon * stations.times[:, None]
    y, normal = surface.position.reshape(-1, 3), surface.normal.reshape(-1, 3)
    area, part = surface.area.reshape(-1), surface.part.reshape(-1)
    bin_m = float(path_from_time(capture.time.width_s))
    first = capture.time.start_s / capture.time.width_s
    to_unit = np.array([*caster.center, caster.half_extent_m])
    # What a laser point within it lights, a pixel's own patch sees.
    apart = np.sum((lasers.position - seen.position[:, 0]) ** 2, axis=1) > seen.footprint[:, 0]
    ends = ((lasers.position, lasers.normal, np.ones_like(apart)), (seen.position[:, 0], seen.normal[:, 0], apart))

    def ask(of_pixel: Ints, at: Ints) -> Floats:
        brought = _brought(
            of_pixel, at, y, normal, area, part, lasers.position, lasers.normal, lasers.to_laser, lasers.part,
            lasers.leg, seen.position[:, 0], seen.normal[:, 0], seen.to_sensor[:, 0], seen.part[:, 0],
            seen.last_leg[:, 0], seen.weight[:, 0], seen.footprint[:, 0], materials.kind, materials.values,
            scene.attenuation_per_m, capture.time.origin == "source", gain, bin_m, first,
        )  # fmt: skip
        for end, up, asked in ends:
            rows = np.flatnonzero((brought > 0) & asked[at])
            if len(rows):
                spans = _spans(of_pixel[rows], at[rows], y, normal, end, up, caster.offset_m, to_unit)
                brought[rows[caster.occluded_scaled(*spans)]] = 0.0
        return np.asarray(brought)

    return ask


@compiled()
def _brought(  # type: ignore[no-untyped-def]
    of_pixel, at, y, normal, area, part, x, normal1, to_laser, part1, leg1, z, normal3, to_sensor, part3, leg3, share,
    footprint, kind, values, attenuation, device, gain, bin_m, first,
):  # fmt: skip
    """(n,) expected detections if nothing stood in the way."""
    out = np.zeros(len(at))
    for k in range(len(at)):
        i, s = of_pixel[k], at[k]
        place, n, p, p1, p3 = get(y, i, 0), get(normal, i, 0), part[i], part1[s], part3[s]
        lit_from = get(x, s, 0), get(normal1, s, 0), get(to_laser, s, 0), kind[p1], values[p1]
        seen_from = get(z, s, 0), get(normal3, s, 0), get(to_sensor, s, 0), kind[p3], values[p3]
        # Lit from behind, what the label shows is dark.
        if dot(less(lit_from[0], place), n) <= 0.0:
            continue
        w, r1, r3 = weight(place, n, kind[p], values[p], lit_from, seen_from, footprint[s], attenuation)
        arrival = math.floor((r1 + r3 + (leg1[s] + leg3[s] if device else 0.0)) / bin_m - first)
        if w > 0.0 and 0 <= arrival < gain.shape[1]:
            out[k] = area[i] * w * share[s] * air(attenuation, leg1[s] + leg3[s]) * gain[s, int(arrival)]
    return out


@compiled()
def _spans(of_pixel, at, y, normal, end, up, offset, to_unit):  # type: ignore[no-untyped-def]
    """Rays from stations to what pixels see, (n, 3) origins and spans in embree's unit frame."""
    origins, spans = np.empty((len(at), 3), np.float32), np.empty((len(at), 3), np.float32)
    for k in range(len(at)):
        i, s = of_pixel[k], at[k]
        a = lifted_and_scaled(end[s], up[s], offset, to_unit)
        b = lifted_and_scaled(y[i], normal[i], offset, to_unit)
        for j in range(3):
            origins[k, j], spans[k, j] = a[j], b[j] - a[j]
    return origins, spans
