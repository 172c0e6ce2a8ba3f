"""The simulations behind the figures, and the likelihood envelopes of one pixel by part and by number of bounces.

Both estimators, two densities of samples, two secondary schemes, and the seconds that each takes. The radiometric
primary is that of `simulate`, to the same small error in all cases: what depends on counts and schemes is the
secondary.
"""

from __future__ import annotations

import time as clock
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from itertools import cycle
from typing import Literal

import numpy as np

from datagen.capture import capture_for
from datagen.config import DatasetConfig
from datagen.detector import detector_for
from datagen.detector.irf import response_kernel, spread
from datagen.errors import InputError
from datagen.paper.as_printed import AsPrinted, simulate_as_printed
from datagen.paper.radiometric import secondary
from datagen.records import Accuracy, Capture, Scene, TimeAxis, Transient
from datagen.records.arrays import Floats
from datagen.report.curves import busy_window
from datagen.scene import generate_scene
from datagen.transport import simulate
from datagen.units import time_from_path

Estimator = Literal["as printed", "radiometric", "converged"]
Scheme = Literal["all", "strongest"]

PEAKS_NS = {"walls, floor, ceiling": 25.6, "box": 24.9, "pillar": 35.3}
"""Part → time of its peak in the paper's Fig. 7, since the light reached the laser point."""
ROOM, SECONDARY = "#1F5FB4", "#D62728"
TIME_LABEL = "time since the light reached the laser point (ns)"
_PAPER_COLORS = {"box": "#7B3FA0", "pillar": "#E8820C"}
_OTHER_COLORS = ("#1B9E77", "#C51B7D", "#8C6D31", "#35978F", "#E6AB02", "#666666")


@dataclass(frozen=True)
class ComponentCurves:
    """The signal of one pixel in the limit of infinite exposure: events per emitted photon and bin.

    time_ns : (bin,) middles of the bins, since the light reached the laser point.
    parts : the primary by part, objects one by one, all surfaces of the room together.
    orders : the other components, `secondary`, `higher`, `direct`.
    total : their sum, all (bin,).
    """

    time_ns: Floats
    parts: dict[str, Floats]
    orders: dict[str, Floats]
    total: Floats


def component_curves(config: DatasetConfig, scene: Scene, capture: Capture, transient: Transient) -> ComponentCurves:
    """Likelihood envelopes L(t) = q · (transient ⊛ IRF) of the first laser point and pixel.

    q is the detection efficiency and the IRF the laser pulse with the detector's jitter, as `config.detector` gives
    them for scene 0 (the paper's L(t); light beyond the time window is left out). The transient must hold the split
    by part.
    """
    spad, exposure = detector_for(config.detector, config.seed, 0, capture.time)
    width = capture.time.width_s
    pulse = response_kernel(width, exposure.pulse_fwhm_s, spad.jitter_tail_s, spad.jitter_tail_fraction)

    def seen(transients: Floats) -> Floats:
        curve = transients[0, 0]
        for kernel in (pulse, response_kernel(width, spad.jitter_fwhm_s)):
            curve = spread(curve, kernel)[kernel.before : kernel.before + len(curve)]
        return np.asarray(spad.pde * curve, np.float64)

    objects = scene.objects
    room = [name for name in scene.part_names if name not in objects]
    # A flat relay wall scatters no light to itself, so it is not named.
    label = ", ".join([name for name in room if name != "relay_wall"] or room)
    parts = {label: np.sum([seen(transient.parts[name]) for name in room], axis=0)} if room else {}
    parts |= {name: seen(transient.parts[name]) for name in objects}
    orders = {name: seen(values) for name, values in transient.components.items() if name != "primary"}
    point, leg_s = transient.laser_points[0], 0.0
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


@dataclass(frozen=True)
class Sizes:
    """Sides of the two grids of rays, side of a lookin's unfolded picture, relative error of the converged light."""

    rays: tuple[int, int] = (10, 45)
    pixels: int = 60
    target: float = 0.01


FULL, QUICK = Sizes(), Sizes(rays=(8, 16), pixels=20, target=0.03)


@dataclass(frozen=True)
class Simulation:
    """One simulation.

    curves : its likelihood envelopes. level : component → energy per emitted photon, or the printed equations' sum in
    its place. seconds, processor_s : elapsed and processor time.
    """

    curves: ComponentCurves
    level: dict[str, float]
    seconds: float
    processor_s: float


@dataclass(frozen=True)
class Runs:
    """All that was simulated. cases : (estimator, rays a side, scheme) → Simulation; the converged run has 0 rays."""

    config: DatasetConfig
    scene: Scene
    capture: Capture
    sizes: Sizes
    cases: dict[tuple[Estimator, int, Scheme], Simulation] = field(default_factory=dict)

    @property
    def converged(self) -> Simulation:
        """The radiometric run with which the others are compared."""
        return self.cases["converged", 0, "all"]


def run_all(config: DatasetConfig, sizes: Sizes, progress: Callable[[str], None]) -> Runs:
    """Simulate everything that the figures need. Raises `InputError` for a room without light."""
    scene = generate_scene(config.scene, config.seed, 0)
    capture = capture_for(config, scene, config.seed, 0)
    if capture.shape[:2] != (1, 1):
        raise InputError(
            f"{config.name}: {capture.shape[0]} laser points and {capture.shape[1]} pixels; the paper's figures are "
            "of one laser point and one field of view"
        )
    runs = Runs(config, scene, capture, sizes)

    def timed(run: Callable[[], Transient]) -> tuple[Transient, Simulation]:
        began, began_processor = clock.perf_counter(), clock.process_time()
        transient = run()
        taken = clock.perf_counter() - began, clock.process_time() - began_processor
        level = {name: float(values.sum()) for name, values in transient.components.items()}
        return transient, Simulation(component_curves(config, scene, capture, transient), level, *taken)

    def printed(rays: int, pixels: int, scheme: Scheme) -> Simulation:
        return timed(lambda: simulate_as_printed(scene, capture, AsPrinted(rays, pixels, secondary=scheme)))[1]

    def radiometric(rays: int, scheme: Scheme) -> Simulation:
        # As many lookins and observed points as the paper counts.
        counts = rays**2, sizes.pixels**2, None if scheme == "all" else 1

        def run() -> Transient:
            light = {"primary": whole.components["primary"], "secondary": secondary(scene, capture, *counts)}
            return replace(whole, components=light)

        return timed(run)[1]

    progress("compiling")
    schemes: tuple[Scheme, ...] = ("all", "strongest")
    for scheme in schemes:
        printed(sizes.rays[0], min(sizes.pixels, 20), scheme)
    secondary(scene, capture, 1, 8)
    simulate(scene, capture, Accuracy(target=0.2, max_bounces=4))
    progress(f"converged, to {100 * sizes.target:g} %")
    whole, runs.cases["converged", 0, "all"] = timed(
        lambda: simulate(scene, capture, Accuracy(target=sizes.target, max_bounces=4))
    )
    if not runs.converged.level["primary"] > 0:
        raise InputError(f"{config.name}: no light comes around the corner within the time window; nothing to plot")
    for rays in sizes.rays:
        for scheme in schemes:
            progress(f"as printed, {rays} × {rays} rays, {scheme}")
            runs.cases["as printed", rays, scheme] = printed(rays, sizes.pixels, scheme)
            progress(f"radiometric, {rays * rays} lookins, {scheme}")
            runs.cases["radiometric", rays, scheme] = radiometric(rays, scheme)
    return runs
