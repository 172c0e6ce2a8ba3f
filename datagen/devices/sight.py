"""What each zone of a sensor sees first, by rays over its footprint."""

from __future__ import annotations

import numpy as np

from datagen.records import Capture, Scene
from datagen.records.arrays import Floats
from datagen.records.checks import check_kind
from datagen.transport.fields_of_view import sensitivity
from datagen.transport.rays import Raycaster
from datagen.units import time_from_path

RAYS_ALONG = 16
"""Rays along each side of a zone: the depth of a zone with an edge in it errs by up to a 32nd of the step there."""


def zone_depth(scene: Scene, capture: Capture) -> Floats:
    """Depth by zone: (P,) metres from the sensor along each zone's axis to what the zone sees.

    The axis of a zone is the line from the sensor to the middle of its quadrilateral. The depth is the mean over the
    zone's footprint, weighted by its sensitivity, of the depth along this axis of the first surface in each
    direction; directions without any surface do not count. A zone that sees nothing has NaN. Pixels of a confocal
    scan are zones, too: P is then the number of laser points.

    Parameters
    ----------
    scene, capture : as of `simulate`.

    Examples
    --------
    All zones of a sensor that faces a wall squarely see the wall; those that look aside see it from the side:

    >>> import datagen as dg, numpy as np, trimesh
    >>> wall = trimesh.creation.box((0.1, 9, 9), trimesh.transformations.translation_matrix((0.85, 0, 0)))
    >>> scene = dg.Scene.from_parts([dg.Part("wall", wall, dg.Lambertian(0.8))])
    >>> capture, _, _ = dg.device("vl53l8ch_4x4").at(position=(0, 0, 0), toward=(1, 0, 0))
    >>> depth = dg.zone_depth(scene, capture).reshape(4, 4)
    >>> bool(depth[0, 0] > depth[1, 1] > 0.8)
    True
    """
    check_kind("scene", scene, Scene)
    check_kind("capture", capture, Capture)
    points, weights = _sight(scene, capture)
    axes = (capture.sensor.pixels - capture.sensor.position).mean(axis=1)
    axes /= np.linalg.norm(axes, axis=1, keepdims=True)
    return _mean(np.einsum("pnk,pk->pn", points - capture.sensor.position, axes), weights)


def share_of_late_zones(scene: Scene, capture: Capture) -> float:
    """Share of the zones most of whose first return arrives after the end of the time axis; 0 if none sees anything.

    The path of the light is taken from the laser's position to what the zone sees, and from there to the sensor.
    """
    points, weights = _sight(scene, capture)
    path = sum(np.linalg.norm(points - at, axis=2) for at in (capture.laser.position, capture.sensor.position))
    late = _mean((time_from_path(path) >= capture.time.stop_s).astype(np.float64), weights)
    late = late[np.isfinite(late)]
    return float((late > 0.5).mean()) if len(late) else 0.0


def _mean(values: Floats, weights: Floats) -> Floats:
    """(P,) means of values (P, n) with weights (P, n); NaN where all weights are 0."""
    total = weights.sum(axis=1)
    with np.errstate(invalid="ignore"):
        return np.asarray(
            np.where(weights > 0, weights * values, 0.0).sum(axis=1) / np.where(total > 0, total, np.nan)
        )


def _sight(scene: Scene, capture: Capture) -> tuple[Floats, Floats]:
    """(P, n, 3) first surface along rays through the middles of equal cells of each zone's quadrilateral, NaN where
    there is none; and (P, n) sensitivity along each ray, 0 where it meets nothing."""
    sensor = capture.sensor
    corners = sensor.pixels - sensor.position
    middles = (np.arange(RAYS_ALONG) + 0.5) / RAYS_ALONG
    u, v = (grid.reshape(-1, 1) for grid in np.meshgrid(middles, middles))
    a, b, c, d = (corners[:, None, k] for k in range(4))
    directions = (1 - v) * ((1 - u) * a + u * b) + v * ((1 - u) * d + u * c)
    hits = Raycaster(scene).closest(sensor.position, directions.reshape(-1, 3))
    points = np.where(hits.valid[:, None], hits.position, np.nan).reshape(directions.shape)
    weights = np.ones(directions.shape[:2])
    if sensor.footprints is not None:
        uv = np.broadcast_to(np.hstack([u, v]), (len(corners), len(u), 2))
        weights = sensitivity(sensor.footprints, np.arange(len(corners))[:, None], uv)
    return points, np.where(np.isfinite(points[..., 0]), weights, 0.0)
