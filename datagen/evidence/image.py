"""The image of evidence: expected detections of the light from the surface that each label pixel shows.

Let y be the point in the middle of a label pixel, A the area of surface that the pixel covers, x a laser point and z
the middle of the footprint of a sensor pixel. The light of three bounces with the second at y is (docs/physics.md)

    A f₁ cosθ₁ cosθ₂ V₁₂/R₁² · f₂ · cosθ₂′ cosθ₃ V₂₃/(R₂² + a/π) · f₃ W

photons, with W the sensor's share and a the area of the footprint. It arrives in one bin, where a photon gives
`detector.own_light.detections_per_photon` detections. Their sum over the scan is the value of the label pixel. A few
representative pairs of laser point and sensor pixel stand for the whole scan (`ScanPairs`); nothing is random.
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
from datagen.records import Capture, Scene
from datagen.records.arrays import Bools, Floats, Ints
from datagen.transport.brdf import MaterialTable, dot
from datagen.transport.fields_of_view import FovPool, PixelCones, fov_points
from datagen.transport.geometry import get, subtract, transmittance
from datagen.transport.laser_points import LaserPoints
from datagen.transport.rays import Raycaster, lifted_and_scaled
from datagen.transport.weights import Brdf, End, brdf_of, weight
from datagen.units import path_from_time

SCAN_PAIRS = 16
"""Number of pairs of laser point and pixel that stand for a scan. More take more time, and
give finer steps to shadows that move over the scan."""


@dataclass(frozen=True)
class ScanPairs:
    """S representative pairs of laser point and pixel.

    lasers, seen : their laser points, and the points in the middle of their pixels' footprints.
    histogram : (S, 2) laser point and pixel of the histogram of each pair.
    times : (S,) number of the scan's pairs for which each stands; of a flood, its share of the light.
    """

    lasers: LaserPoints
    seen: FovPool
    histogram: Ints
    times: Floats


def representative_pairs(caster: Raycaster, scene: Scene, capture: Capture) -> ScanPairs | None:
    """The pairs that stand for a capture; None if no laser ray meets the scene or no pixel sees it."""
    lasers, sensor = LaserPoints.of(caster, scene, capture.laser), capture.sensor
    met = caster.closest(sensor.position, sensor.pixels.mean(axis=1) - sensor.position)
    lit, sees = np.flatnonzero(lasers.part >= 0), np.flatnonzero(met.valid)
    if capture.pairing == "confocal":
        both = np.intersect1d(lit, sees)
        chosen, times = _representatives(lasers.position[both], SCAN_PAIRS)
        pairs = np.stack([both[chosen], both[chosen]], axis=1)
        histogram = np.stack([pairs[:, 0], np.zeros_like(chosen)], axis=1)
    else:
        few = min(len(lit), max(SCAN_PAIRS // max(len(sees), 1), math.isqrt(SCAN_PAIRS)))
        few_lasers, lasers_each = _representatives(lasers.position[lit], few)
        few_pixels, pixels_each = _representatives(met.position[sees], SCAN_PAIRS // max(few, 1))
        pairs = np.stack(np.meshgrid(lit[few_lasers], sees[few_pixels], indexing="ij"), axis=-1).reshape(-1, 2)
        times, histogram = np.outer(lasers_each, pixels_each).reshape(-1), pairs.copy()
        if capture.illumination == "flood":
            times, histogram[:, 0] = times / len(lasers.part), 0
    if not len(pairs):
        return None
    looking = sensor.take(pairs[:, 1])
    middle = np.full((len(pairs), 1, 2), 0.5)
    seen = fov_points(caster, scene, looking, PixelCones.of(looking), np.arange(len(pairs)), middle, 1)
    return ScanPairs(lasers.take(pairs[:, 0]), seen, histogram, times)


def _representatives(points: Floats, most: int) -> tuple[Ints, Floats]:
    """Numbers of at most `most` of the points (n, 3), and the number of points for which each of them stands.

    The largest group of points is halved across its widest extent until there are enough groups. The point nearest to
    the middle of a group stands for it.
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
    wholly in view add up to the object's own detections to some percent, as each pixel is represented by its middle.
    """
    shown = surface.face >= 0
    if scan_pairs is None or not shown.any():
        return np.zeros(shown.shape, np.float32)
    scene, lasers, seen = surface.scene, scan_pairs.lasers, scan_pairs.seen
    materials = MaterialTable.of(scene.materials)
    points = _surface_points(surface, shown)
    bin_m = float(path_from_time(capture.time.width_s))
    first = capture.time.start_s / capture.time.width_s
    to_unit = np.array([*caster.center, caster.half_extent_m])
    total = np.zeros(len(points.part))
    # One pair after the other, which bounds the memory that its rays take.
    for pair, times in enumerate(scan_pairs.times):
        on_wall, in_view = lasers.part[pair], seen.part[pair, 0]
        brdfs = [Brdf(materials.kind[k], materials.values[k, 0], k) for k in (on_wall, in_view)]
        x, n1, to_laser = (tuple(of[pair]) for of in (lasers.position, lasers.normal, lasers.to_laser))
        z, n3, to_sensor = (tuple(of[pair, 0]) for of in (seen.position, seen.normal, seen.to_sensor))
        ends = _Ends(
            End(x, n1, to_laser, brdfs[0]), End(z, n3, to_sensor, brdfs[1]),
            seen.footprint[pair, 0], seen.weight[pair, 0], lasers.leg[pair] + seen.last_leg[pair, 0],
        )  # fmt: skip
        detections = _unoccluded_detections(
            points, ends, materials.kind, materials.values, scene.attenuation_per_m,
            capture.time.origin == "source", detections_per_photon[pair] * times, bin_m, first,
        )  # fmt: skip
        legs = [(lasers.position[pair], lasers.normal[pair])]
        # A laser point within the footprint lights what the footprint sees: one ray tells for both legs.
        if np.sum((lasers.position[pair] - seen.position[pair, 0]) ** 2) > ends.footprint_m2:
            legs.append((seen.position[pair, 0], seen.normal[pair, 0]))
        for end, normal in legs:
            rows = np.flatnonzero(detections > 0)
            if len(rows):
                spans = _spans(rows, points, end, normal, caster.offset_m, to_unit)
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
def _unoccluded_detections(  # type: ignore[no-untyped-def]
    points, ends, kind, values, attenuation, from_source, gain, bin_m, first
):  # fmt: skip
    """(N,) expected detections of the light of each point, if no surface occluded a path.

    kind, values : BRDFs of the parts. from_source : whether the time axis counts the legs to the devices. gain : (T,)
    detections for a photon in each bin. bin_m, first : path length of a bin, and number of the first bin.
    """
    out = np.zeros(len(points.part))
    for i in range(len(out)):
        place, n, p = get(points.position, i, 0), get(points.normal, i, 0), points.part[i]
        # The side of the surface that the label shows is dark if the laser point lies behind it.
        if dot(subtract(ends.lit_from.point, place), n) <= 0.0:
            continue
        brdf = brdf_of(kind, values, p)
        w, r1, r3 = weight(place, n, brdf, ends.lit_from, ends.seen_from, values, ends.footprint_m2, attenuation)
        arrival = math.floor((r1 + r3 + (ends.legs_m if from_source else 0.0)) / bin_m - first)
        if w > 0.0 and 0 <= arrival < len(gain):
            out[i] = (
                points.area[i] * w * ends.sensor_share * transmittance(attenuation, ends.legs_m) * gain[int(arrival)]
            )
    return out


@compiled()
def _spans(rows, points, end, normal, offset, to_unit):  # type: ignore[no-untyped-def]
    """(n, 3) origins and spans, in embree's unit frame, of the rays from `end` to the points `rows` (n,)."""
    origins, spans = np.empty((len(rows), 3), np.float32), np.empty((len(rows), 3), np.float32)
    # Both ends are lifted off their surfaces, or single precision would let these occlude the ray.
    a = lifted_and_scaled(end, normal, offset, to_unit)
    for k in range(len(rows)):
        i = rows[k]
        b = lifted_and_scaled(points.position[i], points.normal[i], offset, to_unit)
        for j in range(3):
            origins[k, j], spans[k, j] = a[j], b[j] - a[j]
    return origins, spans
