"""The evidence of each label pixel: expected detections of the light that comes by way of the surface seen there.

With y the point in the middle of a label pixel, which covers the area A of its surface, x a laser point and z the
middle of what a pixel of the sensor sees, the light of three bounces by way of y is (docs/physics.md)

    A f₁ cosθ₁ cosθ₂ V₁₂/R₁² · f₂ · cosθ₂′ cosθ₃ V₂₃/(R₂² + a/π) · f₃ W

photons, W the sensor's share and a the area that it sees, and arrives in one bin; what the detector makes of a photon
there is `detector.own_light.detections_per_photon`. Summed over the scan these are the expected detections from that
surface. Of a scan `STATIONS` pairs stand for the others, each for a patch of neighbours; no number is drawn.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, fields

import numpy as np
from numba import njit
from numpy.typing import NDArray

from datagen.config import LabelsConfig
from datagen.labels.frame import image_points
from datagen.labels.images import HiddenSurface, hidden_surface
from datagen.records import Capture, Scene
from datagen.records.arrays import Bools, Floats, Ints
from datagen.transport.brdf import MaterialTable, dot
from datagen.transport.cells.geometry import get, less
from datagen.transport.cells.weights import weight
from datagen.transport.fov import FovPool, PixelCones, fov_points
from datagen.transport.raycast import Raycaster
from datagen.transport.vertices import LaserPoints
from datagen.units import path_from_time

STATIONS = 16
"""Pairs of laser point and pixel that stand for a scan."""
GRAZING = 0.02
"""Cosine up to which a surface seen at a slant covers more of itself."""


@dataclass(frozen=True)
class _Surface:
    """What label pixels see: n points with unit normals that face the view, the area of each (m²), and its part."""

    position: Floats
    normal: Floats
    area: Floats
    part: Ints


def evidence_image(
    scene: Scene, capture: Capture, labels: LabelsConfig, detections_per_photon: Floats
) -> NDArray[np.float32]:
    """(rows, columns) expected detections of the light of three bounces by way of what each label pixel sees.

    Parameters
    ----------
    labels : rows and columns of the image, which lies over `depth` and the other label images.
    detections_per_photon : (L, P, T), expected detections of the exposure for each photon at the aperture per emitted
        photon, of a bin and histogram; L = 1 for a flood.

    0 where nothing is seen, or no light comes from there. Over the pixels of an object that is wholly in view it adds
    up to the object's own detections, to some percent: of each label pixel only its middle is looked at.

    Raises
    ------
    InputError : a scene without `hidden_view`.
    """
    found = hidden_surface(scene, labels.rows, labels.columns)
    image = np.zeros(found.face.shape, np.float32)
    there = found.face >= 0
    caster = Raycaster(scene)
    surface, stations = _surface_of(found, there), _stations(caster, scene, capture)
    if len(surface.part) and stations is not None:
        light, path = _unhidden(scene, surface, stations, capture)
        light *= _lit_and_seen(caster, surface, stations, light > 0)
        image[there] = _detected(light, path, stations, detections_per_photon, capture)
    return image


def _surface_of(found: HiddenSurface, there: Bools) -> _Surface:
    """What the middles of the label pixels that see anything see."""
    frame, corners = found.frame, found.scene.corners[found.face[there]]
    in_view = image_points(found.depth, there, frame.half_width_m, frame.half_height_m)
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    slant = normal @ frame.axes[2]
    normal[slant > 0] *= -1
    pixel_m2 = 4 * frame.half_width_m * frame.half_height_m / there.size
    return _Surface(
        frame.to_world(in_view), normal,
        pixel_m2 / np.maximum(np.abs(slant), GRAZING), found.scene.face_part[found.face[there]].astype(np.int64),
    )  # fmt: skip


@dataclass(frozen=True)
class _Stations:
    """S pairs of laser point and pixel, and for how many of the scan's pairs each stands (of a flood, what share of
    its light).

    histogram : (S, 2) laser and pixel of its histogram.
    """

    lasers: LaserPoints
    seen: FovPool
    histogram: Ints
    times: Floats


def _stations(caster: Raycaster, scene: Scene, capture: Capture) -> _Stations | None:
    """Those of a capture; none where no laser ray meets the scene or no pixel sees it."""
    lasers = LaserPoints.of(caster, scene, capture.laser)
    pixels = np.arange(len(capture.sensor.pixels))
    middle = np.full((len(pixels), 1, 2), 0.5)
    pool = fov_points(caster, scene, capture.sensor, PixelCones.of(capture.sensor), pixels, middle, 1)
    lit, sees = np.flatnonzero(lasers.part >= 0), np.flatnonzero(pool.part[:, 0] >= 0)
    if capture.pairing == "confocal":
        both = np.intersect1d(lit, sees)
        of, times = _spread_out(lasers.position[both], STATIONS)
        pairs = np.stack([both[of], both[of]], axis=1)
        histogram = np.stack([pairs[:, 0], np.zeros_like(of)], axis=1)
    else:
        few = min(len(lit), max(STATIONS // max(len(sees), 1), math.isqrt(STATIONS)))
        of_laser, lasers_each = _spread_out(lasers.position[lit], few)
        of_pixel, pixels_each = _spread_out(pool.position[sees, 0], STATIONS // max(few, 1))
        pairs = np.stack(np.meshgrid(lit[of_laser], sees[of_pixel], indexing="ij"), axis=-1).reshape(-1, 2)
        times, histogram = np.outer(lasers_each, pixels_each).reshape(-1), pairs.copy()
        if capture.illumination == "flood":
            times, histogram[:, 0] = times / len(lasers.part), 0
    if not len(pairs):
        return None
    chosen = LaserPoints(**{name: values[pairs[:, 0]] for name, values in vars(lasers).items()})
    seen = FovPool(*(getattr(pool, f.name)[pairs[:, 1]] for f in fields(pool) if f.name != "sets"))
    return _Stations(chosen, seen, histogram, times)


def _spread_out(points: Floats, most: int) -> tuple[Ints, Floats]:
    """At most so many of n points (n, 3), each in the middle of its share of them, and how many these are.

    They are halved across their widest extent until there are enough.
    """
    groups = [np.arange(len(points))] if len(points) else []
    while groups and len(groups) < most:
        largest = max(range(len(groups)), key=lambda k: len(groups[k]))
        if len(groups[largest]) < 2:
            break
        members = groups.pop(largest)
        along = np.ptp(points[members], axis=0).argmax()
        ordered = members[np.argsort(points[members, along], kind="stable")]
        groups[largest:largest] = [ordered[: len(ordered) // 2], ordered[len(ordered) // 2 :]]
    middles = [np.linalg.norm(points[m] - points[m].mean(axis=0), axis=1).argmin() for m in groups]
    chosen = np.array([m[k] for m, k in zip(groups, middles, strict=True)], np.int64)
    return chosen, np.array([len(m) for m in groups], np.float64)


def _unhidden(scene: Scene, surface: _Surface, stations: _Stations, capture: Capture) -> tuple[Floats, Floats]:
    """(n, S) photons at the aperture per emitted photon if nothing stood in the way, and their paths, m."""
    materials, lasers, seen = MaterialTable.of(scene.materials), stations.lasers, stations.seen
    light, path = _light(
        surface.position, surface.normal, surface.area, surface.part, lasers.position, lasers.normal,
        lasers.to_laser, lasers.part, lasers.leg, seen.position[:, 0], seen.normal[:, 0], seen.to_sensor[:, 0],
        seen.part[:, 0], seen.last_leg[:, 0], seen.weight[:, 0], seen.footprint[:, 0], materials.kind,
        materials.values, scene.attenuation_per_m, capture.time.origin == "source",
    )  # fmt: skip
    return light, path


@njit(cache=True, error_model="numpy")
def _light(  # type: ignore[no-untyped-def]
    y, normal, area, part, x, normal1, to_laser, part1, leg1, z, normal3, to_sensor, part3, leg3, share, footprint,
    kind, values, attenuation, device,
):  # fmt: skip
    light, path = np.zeros((len(y), len(x))), np.zeros((len(y), len(x)))
    for i in range(len(y)):
        at, n, p = get(y, i, 0), get(normal, i, 0), part[i]
        for s in range(len(x)):
            p1, p3 = part1[s], part3[s]
            lit_from = get(x, s, 0), get(normal1, s, 0), get(to_laser, s, 0), kind[p1], values[p1]
            seen_from = get(z, s, 0), get(normal3, s, 0), get(to_sensor, s, 0), kind[p3], values[p3]
            # Lit from behind, what the label shows is dark.
            if dot(less(lit_from[0], at), n) <= 0.0:
                continue
            w, r1, r3 = weight(at, n, kind[p], values[p], lit_from, seen_from, footprint[s])
            if w > 0.0:
                air = math.exp(-attenuation * (leg1[s] + r1 + r3 + leg3[s]))
                light[i, s] = area[i] * w * share[s] * air
                path[i, s] = r1 + r3 + (leg1[s] + leg3[s] if device else 0.0)
    return light, path


def _lit_and_seen(caster: Raycaster, surface: _Surface, stations: _Stations, asked: Bools) -> Bools:
    """(n, S) whether the laser point lights a point and the pixel sees it; only where asked."""
    free, lift = asked.copy(), caster.offset_m
    points = surface.position + lift * surface.normal
    lasers, seen = stations.lasers, stations.seen
    for s in range(asked.shape[1]):
        ends = [(lasers.position[s], lasers.normal[s])]
        # What a laser point within it lights, a pixel's own patch sees.
        if np.sum((lasers.position[s] - seen.position[s, 0]) ** 2) > seen.footprint[s, 0]:
            ends.append((seen.position[s, 0], seen.normal[s, 0]))
        for end, up in ends:
            rows = np.flatnonzero(free[:, s])
            free[rows, s] = ~caster.occluded(end + lift * up, points[rows])
    return free


def _detected(light: Floats, path: Floats, stations: _Stations, per_photon: Floats, capture: Capture) -> Floats:
    """(n,) expected detections of all stations' light, each for those that it stands for."""
    axis = capture.time
    at = np.floor(path / float(path_from_time(axis.width_s)) - axis.start_s / axis.width_s).astype(np.int64)
    within = (at >= 0) & (at < axis.bins)
    laser, pixel = stations.histogram.T
    gain = np.where(within, per_photon[laser, pixel, np.where(within, at, 0)], 0.0)
    return np.asarray((light * gain) @ stations.times)
