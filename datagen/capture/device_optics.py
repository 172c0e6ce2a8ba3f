"""The optics of a device at a place: where its zones look, how sensitive each is over its footprint, and its light.

Directions are tangents of the angle from the sensor's axis, (right, up) as the device sees it.
"""

from __future__ import annotations

import numpy as np
from scipy.special import ndtr

from datagen.config.device import DeviceConfig, Light, Zones
from datagen.errors import InputError
from datagen.records import Capture, Laser, Sensor
from datagen.records.arrays import Floats

FOOTPRINT_CELLS = 24
"""Cells along each side of a blurred zone's footprint; with fewer its sensitivity has higher steps."""
BLURS_BESIDE = 3.0
"""Standard deviations of the blur that a footprint extends beyond its zone's box; there it has fallen to 0.1 %."""


def capture_at(device: DeviceConfig, place: Floats, target: Floats, vertical: Floats) -> Capture:
    """The capture of the device at `place` (3,), whose axis passes through `target` (3,); the sensor's vertical is
    the direction nearest to `vertical` (3,).

    Raises `InputError` where `target` is at the place, or `vertical` along the axis.
    """
    forward = target - place
    right = np.cross(forward, vertical)
    if np.linalg.norm(right) <= 1e-9 * np.linalg.norm(forward) * np.linalg.norm(vertical):
        raise InputError(
            f"Device.at: toward = {target.tolist()} and up = {vertical.tolist()} give no orientation: "
            "toward must differ from position, and up must not lie along the axis"
        )
    forward, right = forward / np.linalg.norm(forward), right / np.linalg.norm(right)
    above = np.cross(right, forward)
    laser = _laser(device.light, place, right, above, forward)
    corners, sensitivity = footprints(device.zones)
    corners = place + forward + corners[..., :1] * right + corners[..., 1:] * above
    if device.light.confocal:
        # The one pixel is carried along with the beam.
        corners = corners + (laser.targets - (place + forward))[:, None]
    zones = device.zones
    delays = np.array(zones.delays_ps) * 1e-12 if zones.delays_ps else None
    radius = 1e-3 * zones.aperture_radius_mm
    sensor = Sensor(place, corners, radius, False, sensitivity, zones.crosstalk, zones.glass or None, delays)
    return Capture(laser, sensor, device.axis, device.pairing, "flood" if device.is_flood else "scan")


def _laser(light: Light, place: Floats, right: Floats, above: Floats, forward: Floats) -> Laser:
    """The light of a device at a place, by its unit vectors (3,)."""
    lit_from = place + 1e-3 * (light.baseline_mm[0] * right + light.baseline_mm[1] * above)
    half_width, half_height = half_tangents(light.field_deg)
    grid = Laser.flood(
        lit_from, lit_from + forward, half_width * right, half_height * above, light.rows, light.columns
    )
    weights = None
    if light.spread is not None:
        aside = grid.targets - lit_from
        weights = np.exp(-0.5 * ((aside @ right) ** 2 + (aside @ above) ** 2) / light.spread**2)
    return Laser(lit_from, grid.targets, weights, grid.cells if light.kind == "flood" else None)


def half_tangents(field_deg: tuple[float, float]) -> tuple[float, float]:
    """tan(angle / 2) of the width and the height of a field of view."""
    width, height = np.tan(np.radians(field_deg) / 2)
    return float(width), float(height)


def zone_boxes(zones: Zones) -> Floats:
    """(P, 4) box of each zone in tangents: (right, up) of its middle, its width and height."""
    if zones.field_deg is None:
        return np.array(zones.boxes)
    width, height = (2 * half for half in half_tangents(zones.field_deg))
    w, h = width / zones.columns, height / zones.rows
    return np.array([
        ((c + 0.5) * w - width / 2, height / 2 - (r + 0.5) * h, w, h)
        for r in range(zones.rows)
        for c in range(zones.columns)
    ])  # fmt: skip


def footprints(zones: Zones) -> tuple[Floats, Floats | None]:
    """Corners (P, 4, 2) of each zone in tangents, and its sensitivity over them (P, R, C), None if it is even."""
    boxes, weights = zone_boxes(zones), np.array(zones.weights) if zones.weights else None
    if zones.blur > 0:
        boxes, weights = _blurred_footprints(boxes, zones.blur)
    if zones.gains:
        weights = np.ones((len(boxes), 1, 1)) if weights is None else weights
        weights = weights * np.array(zones.gains)[:, None, None]
    x, y, w, h = boxes.T
    left, right, low, high = x - w / 2, x + w / 2, y - h / 2, y + h / 2
    corners = [(left, low), (right, low), (right, high), (left, high)]
    return np.stack([np.stack(corner, axis=-1) for corner in corners], axis=1), weights


def _blurred_footprints(boxes: Floats, blur: float) -> tuple[Floats, Floats]:
    """Boxes (P, 4) with room for the blur, and the sensitivity of each over them (P, R, C).

    A box convolved with a Gaussian is, along each side, Φ((x − low)/σ) − Φ((x − high)/σ).
    """
    wider = boxes.copy()
    wider[:, 2:] += 2 * BLURS_BESIDE * blur
    middles = (np.arange(FOOTPRINT_CELLS) + 0.5) / FOOTPRINT_CELLS - 0.5
    along = []
    for side in (2, 3):
        x, half = middles * wider[:, side, None], boxes[:, side, None] / 2
        along.append(ndtr((x + half) / blur) - ndtr((x - half) / blur))
    return wider, along[1][:, :, None] * along[0][:, None, :]
