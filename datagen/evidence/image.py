"""The image of evidence: expected detections of the light from the surface that each label pixel shows.

Let y be the point in the middle of a label pixel, A the area of surface that the pixel covers, x a laser point and z
the middle of the footprint of a sensor pixel. The light of three bounces with the second at y is (docs/physics.md)

    A f₁ cosθ₁ cosθ₂ V₁₂/R₁² · f₂ · cosθ₂′ cosθ₃ V₂₃/(R₂² + a/π) · f₃ W

photons, with W the sensor's share and a the area of the footprint. It arrives in one bin, where a photon gives
`detector.own_light.detections_per_photon` detections. Their sum over the scan is the value of the label pixel. A few
representative pairs of laser point and sensor pixel stand for the whole scan (`ScanPairs`), each with the light that
a flood gives to its laser points and the sensitivity of its pixels; nothing is random.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from datagen.compiled import compiled
from datagen.labels.frame import image_points
from datagen.labels.images import HiddenSurface
from datagen.records import Capture, Scene, Sensor
from datagen.records.arrays import Bools, Floats, Ints
from datagen.transport.brdf import MaterialTable, dot
from datagen.transport.fields_of_view import FovPool, PixelCones, fov_points
from datagen.transport.geometry import get, subtract, transmittance
from datagen.transport.laser_points import LaserPoints
from datagen.transport.rays import Raycaster, lifted_and_scaled
from datagen.transport.scene_numbers import SceneNumbers
from datagen.transport.weights import Brdf, End, brdf_of, weight
from datagen.units import path_from_time

SCAN_PAIRS = 16
"""Number of pairs of laser point and pixel that stand for a scan. More take more time, and
give finer steps to shadows that move over the scan."""


@dataclass(frozen=True)
class ScanPairs:
    """S representative pairs of laser point and pixel.

    lasers, seen : their laser points, and the points in the middle of their pixels' footprints, as of pixels that are
        fully sensitive everywhere.
    histogram : (S, 2) laser point and pixel of the histogram of each pair.
    times : (S,) number of the scan's pairs for which each stands, counted by the pixels' mean sensitivity and
        crosstalk and, of a flood, by the laser points' shares of the light.
    late_bins : (S,) bins by which light is recorded late (`Sensor.delays_s`).
    """

    lasers: LaserPoints
    seen: FovPool
    histogram: Ints
    times: Floats
    late_bins: Floats


def representative_pairs(caster: Raycaster, scene: Scene, capture: Capture) -> ScanPairs | None:
    """The pairs that stand for a capture; None if no light enters the scene or no pixel sees it."""
    lasers, sensor = LaserPoints.of(caster, scene, capture.laser), capture.sensor
    is_flood = capture.illumination == "flood"
    # In units of an equal share of a flood's light.
    light = np.ones(len(lasers.part))
    if is_flood and capture.laser.weights is not None:
        light = capture.laser.weights * len(light)
    looks_at, sensitive = _sensitivities(sensor)
    met = caster.closest(sensor.position, sensor.pixels.mean(axis=1) - sensor.position)
    lit, sees = np.flatnonzero((lasers.part >= 0) & (light > 0)), np.flatnonzero(met.valid & (sensitive > 0))
    if capture.pairing == "confocal":
        both = np.intersect1d(lit, sees)
        chosen, times = _representatives(lasers.position[both], sensitive[both], SCAN_PAIRS)
        pairs = np.stack([both[chosen], both[chosen]], axis=1)
        histogram = np.stack([pairs[:, 0], np.zeros_like(chosen)], axis=1)
    else:
        few = min(len(lit), max(SCAN_PAIRS // max(len(sees), 1), math.isqrt(SCAN_PAIRS)))
        few_lasers, of_light = _representatives(lasers.position[lit], light[lit], few)
        few_pixels, of_pixels = _representatives(met.position[sees], sensitive[sees], SCAN_PAIRS // max(few, 1))
        pairs = np.stack(np.meshgrid(lit[few_lasers], sees[few_pixels], indexing="ij"), axis=-1).reshape(-1, 2)
        times, histogram = np.outer(of_light, of_pixels).reshape(-1), pairs.copy()
        if is_flood:
            times, histogram[:, 0] = times / len(light), 0
    if not len(pairs):
        return None
    seen_by = pairs[:, 1]
    # The pixels' sensitivity is counted in `times`.
    looking = Sensor(sensor.position, sensor.pixels[seen_by], sensor.aperture_radius_m, sensor.finite_aperture)
    at = looks_at[seen_by, None]
    seen = fov_points(caster, scene, looking, PixelCones.of(looking), np.arange(len(pairs)), at, 1)
    # Each pixel's light is recorded by all others, too.
    times = times * (1 + sensor.crosstalk * (len(sensor.pixels) - 1))
    late = np.zeros(len(sensor.pixels)) if sensor.delays_s is None else sensor.delays_s / capture.time.width_s
    return ScanPairs(lasers.take(pairs[:, 0]), seen, histogram, times, late[seen_by])


def _sensitivities(sensor: Sensor) -> tuple[Floats, Floats]:
    """Coordinates (P, 2) of the middle of each pixel's sensitivity over its quadrilateral, and its mean (P,)."""
    pixels, footprints = len(sensor.pixels), sensor.footprints
    if footprints is None:
        return np.full((pixels, 2), 0.5), np.ones(pixels)
    total = np.maximum(footprints.sum(axis=(1, 2)), np.finfo(np.float64).tiny)
    v, u = ((np.arange(cells) + 0.5) / cells for cells in footprints.shape[1:])
    middle = np.stack([np.einsum("prc,c->p", footprints, u), np.einsum("prc,r->p", footprints, v)], axis=1)
    return middle / total[:, None], footprints.mean(axis=(1, 2))


def _representatives(points: Floats, weights: Floats, most: int) -> tuple[Ints, Floats]:
    """Numbers of at most `most` of the points (n, 3), and the sum of the weights (n,) > 0 of the points for which
    each of them stands.

    The group of points with most weight is halved across its widest extent until there are enough groups. The point
    nearest to the middle of a group stands for it.
    """
    groups = [np.arange(len(points))] if len(points) else []
    while len(groups) < most:
        sizes = [float(weights[members].sum()) if len(members) > 1 else 0.0 for members in groups]
        largest = sizes.index(max(sizes)) if sizes else 0
        if not sizes or sizes[largest] == 0.0:
            break
        members = groups.pop(largest)
        there = points[members]
        along = int((there.max(axis=0) - there.min(axis=0)).argmax())
        ordered = members[there[:, along].argsort(kind="stable")]
        before = np.cumsum(weights[ordered])
        half = int(np.clip(np.searchsorted(before, before[-1] / 2, side="right"), 1, len(ordered) - 1))
        groups[largest:largest] = [ordered[:half], ordered[half:]]
    chosen = np.empty(len(groups), np.int64)
    for k, members in enumerate(groups):
        away = points[members] - np.average(points[members], axis=0, weights=weights[members])
        chosen[k] = members[np.einsum("nk,nk->n", away, away).argmin()]
    return chosen, np.array([weights[members].sum() for members in groups], np.float64)


GRAZING = 0.02
"""Least cosine between view and surface by which the area of a label pixel is divided: on a steeper surface one pixel
would cover metres."""


def evidence_image(
    caster: Raycaster, surface: HiddenSurface, capture: Capture, scan_pairs: ScanPairs | None,
    detections_per_photon: Floats,
) -> NDArray[np.float32]:  # fmt: skip
    """(rows, columns) expected detections of the light of three bounces from the surface of each label pixel.

    caster : of the scene's triangles.
    surface : the surface that the label pixels show.
    scan_pairs : pairs that stand for the capture; None if it sees no light.
    detections_per_photon : (S, T) expected detections of the exposure for each photon at the aperture per emitted
        photon, in each bin of the pairs' histograms.

    The value is 0 where a label pixel shows no surface, or no light arrives from it. The pixels of an object that is
    wholly in view add up to the object's own detections to some percent, as each pixel is represented by its middle;
    to a fifth near a flood of which few pairs stand for many.
    """
    shown = surface.face >= 0
    if scan_pairs is None or not shown.any():
        return np.zeros(shown.shape, np.float32)
    lasers, seen = scan_pairs.lasers, scan_pairs.seen
    materials = MaterialTable.of(surface.scene.materials)
    scene = SceneNumbers.of(caster, surface.scene, materials, capture.time)
    points = _surface_points(surface, shown)
    bin_m = float(path_from_time(capture.time.width_s))
    first = capture.time.start_s / capture.time.width_s
    total = np.zeros(len(points.part))
    # One pair after the other, which bounds the memory that its rays take.
    for pair, times in enumerate(scan_pairs.times):
        on_wall, in_view = lasers.part[pair], seen.part[pair, 0]
        brdfs = [Brdf(scene.kind[k], scene.values[k, 0], k) for k in (on_wall, in_view)]
        x, n1, to_laser = (tuple(of[pair]) for of in (lasers.position, lasers.normal, lasers.to_laser))
        z, n3, to_sensor = (tuple(of[pair, 0]) for of in (seen.position, seen.normal, seen.to_sensor))
        ends = _Ends(
            End(x, n1, to_laser, brdfs[0]), End(z, n3, to_sensor, brdfs[1]),
            seen.footprint[pair, 0], seen.weight[pair, 0], lasers.leg[pair] + seen.last_leg[pair, 0],
        )  # fmt: skip
        detections = _unoccluded_detections(
            points, ends, scene, detections_per_photon[pair] * times, bin_m, first - scan_pairs.late_bins[pair]
        )
        legs = [(lasers.position[pair], lasers.normal[pair])]
        # A laser point within the footprint lights what the footprint sees: one ray tells for both legs.
        if np.sum((lasers.position[pair] - seen.position[pair, 0]) ** 2) > ends.footprint_m2:
            legs.append((seen.position[pair, 0], seen.normal[pair, 0]))
        for end, normal in legs:
            rows = np.flatnonzero(detections > 0)
            if len(rows):
                spans = _spans(rows, points, end, normal, scene)
                detections[rows[caster.occluded_scaled(*spans)]] = 0.0
        total += detections
    image = np.zeros(shown.shape, np.float32)
    image[shown] = total
    return image


class _Points(NamedTuple):
    """The surface points in the middles of N label pixels: (N, 3) positions and unit normals that face the view, (N,)
    area of the surface that the pixel covers (m²) and part."""

    position: Floats
    normal: Floats
    area: Floats
    part: Ints


class _Ends(NamedTuple):
    """Both ends of the paths of a scan pair: the first and the last vertex, area of the footprint (m²), the sensor's
    share, and the legs to the devices (m)."""

    lit_from: End
    seen_from: End
    footprint_m2: float
    sensor_share: float
    legs_m: float


def _surface_points(surface: HiddenSurface, shown: Bools) -> _Points:
    """The surface points in the middles of the label pixels `shown` (rows, columns)."""
    scene, frame, face = surface.scene, surface.frame, surface.face[shown]
    position = frame.to_world(image_points(surface.depth, shown, frame.half_width_m, frame.half_height_m))
    corners = scene.corners[face]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    slant = normal @ frame.axes[2]
    # The surface behind the pixel is larger than the pixel if it is tilted.
    area = 4.0 * frame.half_width_m * frame.half_height_m / shown.size / np.maximum(abs(slant), GRAZING)
    facing = np.where(slant[:, None] > 0.0, -normal, normal)
    return _Points(position, facing, area, scene.face_part[face].astype(np.int64))


@compiled()
def _unoccluded_detections(points, ends, scene, gain, bin_m, first):  # type: ignore[no-untyped-def]
    """(N,) expected detections of the light of each point, if no surface occluded a path.

    scene : `SceneNumbers`. gain : (T,) detections for a photon in each bin. bin_m, first : path length of a bin, and
    number of the first bin.
    """
    out = np.zeros(len(points.part))
    for i in range(len(out)):
        place, n, p = get(points.position, i, 0), get(points.normal, i, 0), points.part[i]
        # The side of the surface that the label shows is dark if the laser point lies behind it.
        if dot(subtract(ends.lit_from.point, place), n) <= 0.0:
            continue
        brdf = brdf_of(scene, p)
        w, r1, r3 = weight(place, n, brdf, ends.lit_from, ends.seen_from, scene.values, ends.footprint_m2, scene.air)
        arrival = math.floor((r1 + r3 + (ends.legs_m if scene.from_source else 0.0)) / bin_m - first)
        if w > 0.0 and 0 <= arrival < len(gain):
            clear = transmittance(scene.air, ends.legs_m)
            out[i] = points.area[i] * w * ends.sensor_share * clear * gain[int(arrival)]
    return out


@compiled()
def _spans(rows, points, end, normal, scene):  # type: ignore[no-untyped-def]
    """(n, 3) origins and spans, in embree's unit frame, of the rays from `end` to the points `rows` (n,)."""
    origins, spans = np.empty((len(rows), 3), np.float32), np.empty((len(rows), 3), np.float32)
    # Both ends are lifted off their surfaces, or single precision would let these occlude the ray.
    a = lifted_and_scaled(end, normal, scene.offset, scene.frame)
    for k in range(len(rows)):
        i = rows[k]
        b = lifted_and_scaled(points.position[i], points.normal[i], scene.offset, scene.frame)
        for j in range(3):
            origins[k, j], spans[k, j] = a[j], b[j] - a[j]
    return origins, spans
