"""The simulations behind the reproduction: both estimators, two densities, two secondary schemes, and timings."""

from __future__ import annotations

import time as clock
import warnings
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from datagen.capture import capture_for
from datagen.config import DatasetConfig
from datagen.errors import InputError, InputWarning
from datagen.paper.as_printed import AsPrinted, Conserved, simulate_as_printed
from datagen.paper.as_printed_sampling import Grid
from datagen.paper.envelopes import ComponentCurves, component_curves
from datagen.records import Accuracy, Capture, Laser, Scene, Sensor, TimeAxis, Transient
from datagen.scene import generate_scene
from datagen.transport import simulate
from datagen.transport.raycast import Raycaster
from datagen.transport.vertices import LaserPoints

Estimator = Literal["as printed", "radiometric", "converged"]
Scheme = Literal["all", "strongest"]
Progress = Callable[[str], None]

ROOM_UNIT_M, OTHER_UNIT_M = 1e-3, 1.0
GRIDS: tuple[Grid, ...] = ("angles", "solid_angle")
CONSERVED: tuple[Conserved, ...] = ("room", "lookin", "rays")
SCHEMES: tuple[Scheme, ...] = ("all", "strongest")


@dataclass(frozen=True)
class Sizes:
    """How much is simulated.

    Attributes
    ----------
    rays : side of the two grids of rays.
    pixels : side of a lookin's unfolded picture.
    reference : lookins of the converged run.
    seeds : radiometric runs whose spread is the error of a level.
    sweep : sides of the grids over which the level as printed is followed.
    sweep_pixels : `pixels` there.
    """

    rays: tuple[int, int] = (10, 45)
    pixels: int = 60
    reference: int = 1 << 18
    seeds: int = 8
    sweep: tuple[int, ...] = (5, 10, 20, 40, 80)
    sweep_pixels: int = 20


FULL = Sizes()
QUICK = Sizes(rays=(8, 16), pixels=20, reference=1 << 14, seeds=4, sweep=(4, 8, 16), sweep_pixels=8)


@dataclass(frozen=True)
class Simulation:
    """One simulation.

    Attributes
    ----------
    curves : its likelihood envelopes.
    level : component → energy per emitted photon, or what stands for it as printed.
    seconds, processor_s : elapsed and processor time of all of it.
    relative_error : estimated standard error of the transient, relative L2; NaN as printed.
    """

    curves: ComponentCurves
    level: Mapping[str, float]
    seconds: float
    processor_s: float
    relative_error: float

    @property
    def primary(self) -> NDArray[np.float64]:
        """(bin,) envelope of all primary paths."""
        return np.asarray(np.sum(list(self.curves.parts.values()), axis=0), np.float64)

    @property
    def secondary(self) -> NDArray[np.float64]:
        """(bin,) envelope of the secondary paths."""
        return self.curves.orders["secondary"]

    @property
    def total(self) -> NDArray[np.float64]:
        """(bin,) envelope of both."""
        return self.primary + self.secondary

    @property
    def time_ns(self) -> NDArray[np.float64]:
        """(bin,) since the light reached the laser point."""
        return self.curves.time_ns

    @property
    def ratio(self) -> float:
        """Secondary over primary level."""
        return self.level["secondary"] / self.level["primary"] if self.level["primary"] > 0 else float("nan")


@dataclass(frozen=True)
class Level:
    """A level with its standard error (NaN where the samples are a fixed grid)."""

    primary: float
    secondary: float
    primary_error: float = float("nan")
    secondary_error: float = float("nan")


@dataclass(frozen=True)
class Runs:
    """All that was simulated.

    Attributes
    ----------
    cases : (estimator, rays a side, scheme) → Simulation; the converged run has 0 rays.
    choices : (grid, conserved) → Simulation of the sparse grid.
    sweep : rays a side → level as printed.
    radiometric_levels : rays a side → level over several seeds.
    in_metres : the sparse grid as printed with lengths in metres.
    rescaled : levels of the radiometric run of the sparse counts, and of the same with all lengths of room, aperture
        and time axis multiplied as from mm to m.
    """

    config: DatasetConfig
    scene: Scene
    capture: Capture
    sizes: Sizes
    cases: dict[tuple[Estimator, int, Scheme], Simulation] = field(default_factory=dict)
    choices: dict[tuple[Grid, Conserved], Simulation] = field(default_factory=dict)
    sweep: dict[int, Level] = field(default_factory=dict)
    radiometric_levels: dict[int, Level] = field(default_factory=dict)
    in_metres: dict[int, Simulation] = field(default_factory=dict)
    rescaled: list[Level] = field(default_factory=list)

    def case(self, estimator: Estimator, rays: int = 0, scheme: Scheme = "all") -> Simulation:
        """One of the simulations."""
        return self.cases[estimator, rays, scheme]

    @property
    def sparse(self) -> int:
        """Rays a side of the coarser grid."""
        return self.sizes.rays[0]

    @property
    def dense(self) -> int:
        """Rays a side of the finer grid."""
        return self.sizes.rays[1]

    @property
    def laser_point(self) -> NDArray[np.float64]:
        """(3,) where the laser meets the relay wall."""
        points = LaserPoints.of(Raycaster(self.scene), self.scene, self.capture.laser)
        return np.asarray(points.position[0], np.float64)

    @property
    def time_ns(self) -> NDArray[np.float64]:
        """(bin,) since the light reached the laser point."""
        return self.case("converged").time_ns


def run_all(config: DatasetConfig, sizes: Sizes, progress: Progress) -> Runs:
    """Simulate everything that figures and statements need. Raises `InputError` for a room without light."""
    scene = generate_scene(config.scene, config.seed, 0)
    capture = capture_for(config, scene, config.seed, 0)
    if capture.shape[:2] != (1, 1):
        raise InputError(
            f"{config.name}: {capture.shape[0]} laser points and {capture.shape[1]} pixels; the paper's figures are "
            "of one laser point and one field of view"
        )
    runs = Runs(config, scene, capture, sizes)
    progress("compiling")
    for scheme in SCHEMES:
        _printed(runs, AsPrinted(runs.sparse, min(sizes.pixels, 20), secondary=scheme))
    for rays in sizes.rays:
        for scheme in SCHEMES:
            progress(f"as printed, {rays} × {rays} rays, {scheme}")
            settings = AsPrinted(rays, sizes.pixels, ROOM_UNIT_M, scheme)
            runs.cases["as printed", rays, scheme] = _printed(runs, settings)
            progress(f"radiometric, {rays * rays} lookins, {scheme}")
            # Twice: which kernels it needs, and so compiles, depends on room and counts.
            for _ in range(2):
                runs.cases["radiometric", rays, scheme] = _radiometric(runs, rays, sizes.pixels, scheme, 0)
    progress(f"radiometric, converged, {sizes.reference} lookins")
    accuracy = Accuracy(lookins=sizes.reference, fov_samples=16, max_bounces=4, replicates=16)
    runs.cases["converged", 0, "all"] = _timed(runs, lambda: simulate(scene, capture, accuracy, 0))
    if not runs.case("converged").level["primary"] > 0:
        raise InputError(f"{config.name}: no light comes around the corner within the time window; nothing to plot")
    progress("levels against units, rays and choices")
    _levels(runs)
    return runs


def _levels(runs: Runs) -> None:
    sizes, sparse = runs.sizes, AsPrinted(runs.sparse, runs.sizes.pixels)
    runs.in_metres[runs.sparse] = _printed(runs, replace(sparse, unit_m=OTHER_UNIT_M))
    for factor in (1.0, OTHER_UNIT_M / ROOM_UNIT_M):
        runs.rescaled.append(_rescaled(runs, factor))
    for grid in GRIDS:
        for conserved in CONSERVED:
            runs.choices[grid, conserved] = _printed(runs, replace(sparse, grid=grid, conserved=conserved))
    for rays in sizes.sweep:
        case = _printed(runs, AsPrinted(rays, sizes.sweep_pixels))
        runs.sweep[rays] = Level(case.level["primary"], case.level["secondary"])
    for rays in sizes.rays:
        found = [_radiometric(runs, rays, sizes.pixels, "all", seed).level for seed in range(1, sizes.seeds + 1)]
        levels = np.array([[level["primary"], level["secondary"]] for level in found])
        error = levels.std(axis=0, ddof=1) / np.sqrt(len(levels))
        runs.radiometric_levels[rays] = Level(*levels.mean(axis=0).tolist(), *error.tolist())


def _printed(runs: Runs, settings: AsPrinted) -> Simulation:
    return _timed(runs, lambda: simulate_as_printed(runs.scene, runs.capture, settings))


def _radiometric(runs: Runs, rays: int, pixels: int, scheme: Scheme, seed: int) -> Simulation:
    return _timed(runs, lambda: simulate(runs.scene, runs.capture, _counts(rays, pixels, scheme), seed))


def _counts(rays: int, pixels: int, scheme: Scheme) -> Accuracy:
    """As many lookins, observed points and FoV points as the paper counts."""
    return Accuracy(
        lookins=rays * rays, observed=pixels**2, fov_samples=pixels**2, max_bounces=4, replicates=1, secondary=scheme
    )


def _rescaled(runs: Runs, factor: float) -> Level:
    """Every length times `factor`, the aperture and the way of light in a bin too: the same room in another unit."""
    scene, capture, sensor, axis = runs.scene, runs.capture, runs.capture.sensor, runs.capture.time
    larger = replace(scene, vertices=scene.vertices * factor, attenuation_per_m=scene.attenuation_per_m / factor)
    with warnings.catch_warnings():
        # A room of kilometres is absurd, and meant.
        warnings.simplefilter("ignore", InputWarning)
        seen = Capture(
            Laser(capture.laser.position * factor, capture.laser.targets * factor),
            Sensor(sensor.position * factor, sensor.pixels * factor, sensor.aperture_radius_m * factor),
            TimeAxis(axis.bins, axis.width_s * factor, axis.start_s * factor, axis.origin),
        )
    found = simulate(larger, seen, _counts(runs.sparse, runs.sizes.pixels, "all"), 0).components
    return Level(float(found["primary"].sum()), float(found["secondary"].sum()))


def _timed(runs: Runs, run: Callable[[], Transient]) -> Simulation:
    began, began_processor = clock.perf_counter(), clock.process_time()
    transient = run()
    seconds, processor_s = clock.perf_counter() - began, clock.process_time() - began_processor
    curves = component_curves(runs.config, runs.scene, runs.capture, transient)
    level = {name: float(values.sum()) for name, values in transient.components.items()}
    return Simulation(curves, level, seconds, processor_s, transient.relative_error)
