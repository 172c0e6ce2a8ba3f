"""The likelihood envelope of one pixel by part of the room and by number of bounces, as in the paper's Fig. 7."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import cycle

import numpy as np
from numpy.typing import NDArray

from datagen.config import DatasetConfig
from datagen.detector import detector_for
from datagen.detector.irf import response_kernel, spread
from datagen.records import Capture, Scene, TimeAxis, Transient
from datagen.report.time_plots import busy_window, clear_channel
from datagen.units import time_from_path

Curve = NDArray[np.float64]

PEAKS_NS = {"walls, floor, ceiling": 25.6, "box": 24.9, "pillar": 35.3}
"""Where the paper's Fig. 7 has its peaks, since the light reached the laser point."""
ROOM, SECONDARY = "#1F5FB4", "#D62728"
TIME_LABEL = "time since the light reached the laser point (ns)"
_PAPER_COLORS = {"box": "#7B3FA0", "pillar": "#E8820C"}
_OTHER_COLORS = ("#1B9E77", "#C51B7D", "#8C6D31", "#35978F", "#E6AB02", "#666666")


@dataclass(frozen=True)
class ComponentCurves:
    """What one pixel would see in the limit of infinite exposure: events per emitted photon and bin.

    Attributes
    ----------
    time_ns : (bin,) middles of the bins, since the light reached the laser point.
    parts : the primary by part, objects one by one, all surfaces of the room together.
    orders : the other components, `secondary`, `higher`, `direct`.
    total : their sum, all (bin,).
    """

    time_ns: Curve
    parts: dict[str, Curve]
    orders: dict[str, Curve]
    total: Curve


def component_curves(config: DatasetConfig, scene: Scene, capture: Capture, transient: Transient) -> ComponentCurves:
    """Likelihood envelopes L(t) = q · (transient ⊛ IRF) of the channel where the objects stand out most.

    q is the detection efficiency and the IRF the laser pulse with the detector's jitter, as `config.detector` gives
    them for scene 0 (the paper's L(t); light beyond the time window is left out). The transient must hold the split
    by part.
    """
    laser, pixel = clear_channel(scene, transient)
    spad, exposure = detector_for(config.detector, config.seed, 0, capture.time)
    width = capture.time.width_s
    pulse = response_kernel(width, exposure.pulse_fwhm_s, spad.jitter_tail_s, spad.jitter_tail_fraction)

    def seen(transients: NDArray[np.float64]) -> Curve:
        curve = transients[laser, pixel]
        for kernel in (pulse, response_kernel(width, spad.jitter_fwhm_s)):
            curve = spread(curve, kernel)[kernel.before : kernel.before + len(curve)]
        return np.asarray(spad.pde * curve, np.float64)

    objects = scene.objects
    room = [name for name in scene.part_names if name not in objects]
    # The relay wall sends nothing back to itself, so it is not named where it is flat.
    label = ", ".join([name for name in room if name != "relay_wall"] or room)
    parts = {label: np.sum([seen(transient.parts[name]) for name in room], axis=0)} if room else {}
    parts |= {name: seen(transient.parts[name]) for name in objects}
    orders = {name: seen(values) for name, values in transient.components.items() if name != "primary"}
    point, leg_s = transient.laser_points[laser], 0.0
    if capture.time.origin == "source" and np.isfinite(point).all():
        leg_s = time_from_path(float(np.linalg.norm(point - capture.laser.position)))
    return ComponentCurves((capture.time.centers_s - leg_s) * 1e9, parts, orders, seen(transient.total))


def colors_of(curves: ComponentCurves) -> dict[str, str]:
    """Part → colour as in the paper's Fig. 7: the room blue, a box purple, a pillar orange; others from a palette."""
    room, *others = curves.parts
    spare = cycle(_OTHER_COLORS)
    return {room: ROOM} | {name: _PAPER_COLORS.get(name) or next(spare) for name in others}


def curve_window(curves: ComponentCurves) -> tuple[float, float]:
    """Nanoseconds between which there is light."""
    time = curves.time_ns
    step = float(time[1] - time[0]) if len(time) > 1 else 1.0
    return busy_window(curves.total, TimeAxis(len(time), step * 1e-9, float(time[0] - step / 2) * 1e-9))
