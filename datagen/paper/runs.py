"""The simulations behind the figures: both estimators, two densities, two secondary schemes, and their timings."""

from __future__ import annotations

import time as clock
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Literal

from datagen.capture import capture_for
from datagen.config import DatasetConfig
from datagen.errors import InputError
from datagen.paper.as_printed import AsPrinted, simulate_as_printed
from datagen.paper.envelopes import ComponentCurves, component_curves
from datagen.records import Accuracy, Capture, Scene, Transient
from datagen.scene import generate_scene
from datagen.transport import simulate

Estimator = Literal["as printed", "radiometric", "converged"]
Scheme = Literal["all", "strongest"]


@dataclass(frozen=True)
class Sizes:
    """How much is simulated: sides of the two grids of rays, side of a lookin's unfolded picture, and lookins of the
    converged run."""

    rays: tuple[int, int] = (10, 45)
    pixels: int = 60
    reference: int = 1 << 18


FULL, QUICK = Sizes(), Sizes(rays=(8, 16), pixels=20, reference=1 << 14)


@dataclass(frozen=True)
class Simulation:
    """One simulation.

    curves : its likelihood envelopes. level : component → energy per emitted photon, or what stands for it as
    printed. seconds, processor_s : elapsed and processor time of all of it.
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
        """The radiometric run that the others are held against."""
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

    def timed(run: Callable[[], Transient]) -> Simulation:
        began, began_processor = clock.perf_counter(), clock.process_time()
        transient = run()
        taken = clock.perf_counter() - began, clock.process_time() - began_processor
        level = {name: float(values.sum()) for name, values in transient.components.items()}
        return Simulation(component_curves(config, scene, capture, transient), level, *taken)

    def printed(rays: int, pixels: int, scheme: Scheme) -> Simulation:
        return timed(lambda: simulate_as_printed(scene, capture, AsPrinted(rays, pixels, secondary=scheme)))

    def radiometric(rays: int, pixels: int, scheme: Scheme) -> Simulation:
        # As many lookins, observed points and FoV points as the paper counts.
        counts = Accuracy(rays**2, pixels**2, 4, replicates=1, observed=pixels**2, secondary=scheme)
        return timed(lambda: simulate(scene, capture, counts, 0))

    progress("compiling")
    schemes: tuple[Scheme, ...] = ("all", "strongest")
    for scheme in schemes:
        printed(sizes.rays[0], min(sizes.pixels, 20), scheme)
    for rays in sizes.rays:
        for scheme in schemes:
            progress(f"as printed, {rays} × {rays} rays, {scheme}")
            runs.cases["as printed", rays, scheme] = printed(rays, sizes.pixels, scheme)
            progress(f"radiometric, {rays * rays} lookins, {scheme}")
            # Twice: which kernels it needs, and so compiles, depends on room and counts.
            for _ in range(2):
                runs.cases["radiometric", rays, scheme] = radiometric(rays, sizes.pixels, scheme)
    progress(f"radiometric, converged, {sizes.reference} lookins")
    accuracy = Accuracy(lookins=sizes.reference, fov_samples=16, max_bounces=4, replicates=16)
    runs.cases["converged", 0, "all"] = timed(lambda: simulate(scene, capture, accuracy, 0))
    if not runs.converged.level["primary"] > 0:
        raise InputError(f"{config.name}: no light comes around the corner within the time window; nothing to plot")
    return runs
