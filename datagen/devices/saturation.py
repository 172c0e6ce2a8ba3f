"""Saturation of a zone that counts detections: counts from expected events, and back.

A zone that is blind for whole laser periods after each detection counts in bin i, of N cycles,
T_i = N_active h_i exp(−…) as first photons (Coates, J. Phys. E 1, 878 (1968)): with d the blind periods after each of
the T detections,

    λ_i = −ln(1 − T_i / (N − d T − Σ_{j<i} T_j))                                                                  (1)

are the expected events per cycle, linear in the light.
"""

from __future__ import annotations

import numpy as np

from datagen.devices.model import Device
from datagen.records.arrays import Floats


def unsaturated(counts: Floats, cycles: float, blind: float) -> Floats:
    """(…, bins) expected events per cycle λ from counts (…, bins), by equation (1).

    cycles : laser pulses N. blind : periods d that a detection blinds. NaN where more is counted than N allows.
    """
    active = cycles - blind * counts.sum(axis=-1, keepdims=True)
    before = np.cumsum(counts, axis=-1) - counts
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.asarray(-np.log1p(-counts / (active - before)))


def saturated(events: Floats, cycles: float, blind: float) -> Floats:
    """(…, bins) expected counts from expected events per cycle λ (…, bins): the inverse of `unsaturated`."""
    before = np.cumsum(events, axis=-1) - events
    first = -np.expm1(-events) * np.exp(-before)
    return np.asarray(cycles * first / (1 + blind * first.sum(axis=-1, keepdims=True)))


def blind_periods(device: Device) -> float:
    """Whole laser periods that a detection blinds a zone of the device for, beyond the one it falls into."""
    c = device.counting
    return float(np.floor(c.dead_time_ns * 1e-3 * c.repetition_rate_mhz)) if c.mode == "free_running" else 0.0
