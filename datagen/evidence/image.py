"""The evidence of each label pixel: expected detections of the light that comes by way of the surface seen there.

With y the point in the middle of a label pixel, which covers the area A of its surface, x a laser point and z the
middle of what a pixel of the sensor sees, the light of three bounces by way of y is (docs/physics.md)

    A f₁ cosθ₁ cosθ₂ V₁₂/R₁² · f₂ · cosθ₂′ cosθ₃ V₂₃/(R₂² + a/π) · f₃ W

photons, W the sensor's share and a the area that it sees, and arrives in one bin; what the detector makes of a photon
there is `detector.own_light.detections_per_photon`. Summed over the scan these are the expected detections from that
surface. Of a scan a few pairs of laser point and pixel stand for the others (`ScanPairs`); no number is drawn.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from datagen.compiled import compiled
from datagen.labels.images import HiddenSurface
from datagen.records import Capture, Scene, Sensor
from datagen.records.arrays import Floats, Ints
from datagen.transport.brdf import MaterialTable, dot
from datagen.transport.fields_of_view import FovPool, PixelCones, fov_points
from datagen.transport.geometry import air, cross, get, less, unit
from datagen.transport.path_tracing.vertices import LaserPoints
from datagen.transport.quadrature.weights import weight
from datagen.transport.visibility.raycast import Raycaster, lifted_and_scaled
from datagen.units import path_from_time

SCAN_PAIRS = 16
"""Pairs of laser point and pixel that stand for a scan. With half as many the image takes half the time, and shadows
that move over the scan get half as many steps."""


@dataclass(frozen=True)
class ScanPairs:
    """S pairs of laser point and pixel, and for how many of the scan's pairs each stands (of a flood, what share of
    its light).

    histogram : (S, 2) laser and pixel of its histogram.
    """

    lasers: LaserPoints
    seen: FovPool
    histogram: Ints
    times: Floats


def representative_pairs(caster: Raycaster, scene: Scene, capture: Capture) -> ScanPairs | None:
    """Pairs that stand for all of a capture; None where no laser ray meets the scene or no pixel sees it."""
    lasers, sensor = LaserPoints.of(caster, scene, capture.laser), capture.sensor
    met = caster.closest(sensor.position, sensor.pixels.mean(axis=1) - sensor.position)
    lit, sees = np.flatnonzero(lasers.part >= 0), np.flatnonzero(met.valid)
    if capture.pairing == "confocal":
        both = np.intersect1d(lit, sees)
        of, times = _spread_out(lasers.position[both], SCAN_PAIRS)
        pairs = np.stack([both[of], both[of]], axis=1)
        histogram = np.stack([pairs[:, 0], np.zeros_like(of)], axis=1)
    else:
        few = min(len(lit), max(SCAN_PAIRS // max(len(sees), 1), math.isqrt(SCAN_PAIRS)))
        of_laser, lasers_each = _spread_out(lasers.position[lit], few)
        of_pixel, pixels_each = _spread_out(met.position[sees], SCAN_PAIRS // max(few, 1))
        pairs = np.stack(np.meshgrid(lit[of_laser], sees[of_pixel], indexing="ij"), axis=-1).reshape(-1, 2)
        times, histogram = np.outer(lasers_each, pixels_each).reshape(-1), pairs.copy()
        if capture.illumination == "flood":
            times, histogram[:, 0] = times / len(lasers.part), 0
    if not len(pairs):
        return None
    chosen = lasers.take(pairs[:, 0])
    few_pixels = Sensor(
        sensor.position, sensor.pixels[pairs[:, 1]], sensor.aperture_radius_m, finite_aperture=sensor.finite_aperture
    )
    middle = np.full((len(pairs), 1, 2), 0.5)
    seen = fov_points(caster, scene, few_pixels, PixelCones.of(few_pixels), np.arange(len(pairs)), middle, 1)
    return ScanPairs(chosen, seen, histogram, times)


def _spread_out(points: Floats, most: int) -> tuple[Ints, Floats]:
    """Numbers of at most `most` of n points (n, 3), and how many points each of them stands for.

    The points are halved across their widest extent until there are enough groups; of each group the point
    nearest to its middle is taken.
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


GRAZING = 0.02
"""Least cosine between view and surface for which the area of a label pixel is taken: of steeper surfaces, down to
1 in 50, one pixel would stand for metres. Halved, they get up to twice the detections."""


def evidence_image(
    caster: Raycaster, found: HiddenSurface, capture: Capture, scan_pairs: ScanPairs | None,
    detections_per_photon: Floats,
) -> NDArray[np.float32]:  # fmt: skip
    """(rows, columns) expected detections of the light of three bounces by way of what each label pixel sees.

    Parameters
    ----------
    caster : of the scene's triangles.
    found : what the label pixels see.
    scan_pairs : of the capture; None: nothing is lit or nothing looked at.
    detections_per_photon : (S, T), expected detections of the exposure for each photon at the aperture per emitted
        photon, of each bin of the pairs' histograms.

    0 where nothing is seen, or no light comes from there. Over the pixels of an object that is wholly in view it adds
    up to the object's own detections, to some percent: of each label pixel only its middle is looked at.
    """
    there = found.face >= 0
    if scan_pairs is None or not there.any():
        return np.zeros(there.shape, np.float32)
    scene, lasers, seen = found.scene, scan_pairs.lasers, scan_pairs.seen
    materials = MaterialTable.of(scene.materials)
    points = _points_seen(found)
    lit = _Lit(lasers.position, lasers.normal, lasers.to_laser, lasers.part, lasers.leg)
    view = _View(
        seen.position[:, 0], seen.normal[:, 0], seen.to_sensor[:, 0], seen.part[:, 0], seen.last_leg[:, 0],
        seen.weight[:, 0], seen.footprint[:, 0],
    )  # fmt: skip
    # Each pair counts for all pairs of laser point and pixel that it stands for.
    gain = detections_per_photon * scan_pairs.times[:, None]
    bin_m = float(path_from_time(capture.time.width_s))
    first = capture.time.start_s / capture.time.width_s
    to_unit = np.array([*caster.center, caster.half_extent_m])
    # What a laser point within it lights, a pixel's own patch sees.
    apart = np.sum((lit.position - view.position) ** 2, axis=1) > view.footprint
    ends = ((lit.position, lit.normal, np.ones_like(apart)), (view.position, view.normal, apart))
    pixels = np.flatnonzero(there)
    image = np.zeros((there.size, len(scan_pairs.times)))
    # One pair after the other, which bounds the rays in memory.
    for pair in range(len(scan_pairs.times)):
        at = np.full(len(pixels), pair)
        brought = _brought(
            pixels, at, points, lit, view, materials.kind, materials.values, scene.attenuation_per_m,
            capture.time.origin == "source", gain, bin_m, first,
        )  # fmt: skip
        for end, up, needed in ends:
            rows = np.flatnonzero((brought > 0) & needed[at])
            if len(rows):
                spans = _spans(pixels[rows], at[rows], points, end, up, caster.offset_m, to_unit)
                brought[rows[caster.occluded_scaled(*spans)]] = 0.0
        image[pixels, pair] = brought
    return np.asarray(image.sum(axis=1).reshape(there.shape), np.float32)


class _Points(NamedTuple):
    """What N label pixels see: points (N, 3) with unit normals that face the view, the area that a pixel covers of
    its surface (m²), and the part, −1 for none."""

    position: Floats
    normal: Floats
    area: Floats
    part: Ints


class _Lit(NamedTuple):
    """The laser points of S scan pairs, (S, 3) or (S,); see `LaserPoints`."""

    position: Floats
    normal: Floats
    to_laser: Floats
    part: Ints
    leg: Floats


class _View(NamedTuple):
    """What the pixels of S scan pairs look at, (S, 3) or (S,); see `FovPool`."""

    position: Floats
    normal: Floats
    to_sensor: Floats
    part: Ints
    last_leg: Floats
    weight: Floats
    footprint: Floats


def _points_seen(found: HiddenSurface) -> _Points:
    """The points in the middles of the label pixels."""
    scene, frame = found.scene, found.frame
    half_m = np.array([frame.half_width_m, frame.half_height_m])
    triangles = (scene.vertices, scene.triangles)
    position, normal, area = _points(found.face, found.depth, frame.center, frame.axes, half_m, *triangles)
    part = np.append(scene.face_part, -1)[found.face].astype(np.int64)
    return _Points(position.reshape(-1, 3), normal.reshape(-1, 3), area.reshape(-1), part.reshape(-1))


@compiled()
def _points(face, depth, center, axes, half_m, vertices, triangles):  # type: ignore[no-untyped-def]
    """`_Points.position`, `.normal` and `.area`, (rows, columns, …)."""
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
            # A tilted surface covers more than the pixel does.
            slant = dot(n, axes[2])
            area[row, column] = pixel_m2 / max(abs(slant), GRAZING)
            right = (2.0 * (column + 0.5) / columns - 1.0) * half_m[0]
            for k in range(3):
                normal[row, column, k] = -n[k] if slant > 0.0 else n[k]
                across = right * axes[0, k] + upward * axes[1, k]
                position[row, column, k] = center[k] + across + depth[row, column] * axes[2, k]
    return position, normal, area


@compiled()
def _brought(  # type: ignore[no-untyped-def]
    of_pixel, at, points, lit, view, kind, values, attenuation, device, gain, bin_m, first
):  # fmt: skip
    """(n,) expected detections if nothing stood in the way, for label pixels `of_pixel` and scan pairs `at`.

    gain : (S, T) detections for a photon of each bin. bin_m, first : length of a bin, and the start in bins.
    """
    out = np.zeros(len(at))
    for k in range(len(at)):
        i, s = of_pixel[k], at[k]
        place, n = get(points.position, i, 0), get(points.normal, i, 0)
        p, p1, p3 = points.part[i], lit.part[s], view.part[s]
        x, normal1, to_laser = get(lit.position, s, 0), get(lit.normal, s, 0), get(lit.to_laser, s, 0)
        lit_from = x, normal1, to_laser, kind[p1], values[p1]
        z, normal3, to_sensor = get(view.position, s, 0), get(view.normal, s, 0), get(view.to_sensor, s, 0)
        seen_from = z, normal3, to_sensor, kind[p3], values[p3]
        # Lit from behind, what the label shows is dark.
        if dot(less(lit_from[0], place), n) <= 0.0:
            continue
        w, r1, r3 = weight(place, n, kind[p], values[p], lit_from, seen_from, view.footprint[s], attenuation)
        legs = lit.leg[s] + view.last_leg[s]
        # A time axis from the source counts the ways of laser and sensor, too.
        arrival = math.floor((r1 + r3 + (legs if device else 0.0)) / bin_m - first)
        if w > 0.0 and 0 <= arrival < gain.shape[1]:
            out[k] = points.area[i] * w * view.weight[s] * air(attenuation, legs) * gain[s, int(arrival)]
    return out


@compiled()
def _spans(of_pixel, at, points, end, up, offset, to_unit):  # type: ignore[no-untyped-def]
    """Rays from the ends of scan pairs to what pixels see, (n, 3) origins and spans in embree's unit frame."""
    origins, spans = np.empty((len(at), 3), np.float32), np.empty((len(at), 3), np.float32)
    for k in range(len(at)):
        i, s = of_pixel[k], at[k]
        a = lifted_and_scaled(end[s], up[s], offset, to_unit)
        b = lifted_and_scaled(points.position[i], points.normal[i], offset, to_unit)
        for j in range(3):
            origins[k, j], spans[k, j] = a[j], b[j] - a[j]
    return origins, spans
