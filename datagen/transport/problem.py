"""The problem that all integrators are given: scene, capture and accuracy, and the scene for compiled loops."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from datagen.records import Accuracy, Capture, Laser, Scene, Sensor
from datagen.records.arrays import Bools, Ints
from datagen.transport.brdf import MaterialTable
from datagen.transport.fields_of_view import PixelCones, PixelPatches
from datagen.transport.path_tracing.vertices import AreaTarget, LaserPoints
from datagen.transport.visibility.raycast import Raycaster
from datagen.units import path_from_time

COMPONENTS: tuple[str, ...] = ("direct", "primary", "secondary", "higher")


def component_of(order: int) -> str:
    """The component that paths of `order` bounces belong to."""
    return "direct" if order < 3 else "primary" if order == 3 else "secondary" if order == 4 else "higher"


def components_asked(accuracy: Accuracy) -> tuple[str, ...]:
    """The components that an accuracy asks for, in the order of `COMPONENTS`."""
    orders = accuracy.max_bounces or 5
    asked = {
        "direct": accuracy.direct,
        "primary": True,
        "secondary": orders >= 4 and accuracy.secondary != "none",
        "higher": orders >= 5,
    }
    return tuple(name for name in COMPONENTS if asked[name])


@dataclass(frozen=True)
class TallyRows:
    """Rows of the tally for each laser point and pixel: one for each part of the primary (or one for all of it), then
    one for each other component.

    Attributes
    ----------
    parts : names of the parts that the primary is split by; none for all of it in one row.
    components : those computed.
    all_parts : how many parts the scene has.
    """

    parts: tuple[str, ...]
    components: tuple[str, ...]
    all_parts: int

    @property
    def primary(self) -> int:
        """How many rows the primary takes."""
        return max(len(self.parts), 1) if "primary" in self.components else 0

    @property
    def others(self) -> tuple[str, ...]:
        """The components other than the primary, in order."""
        return tuple(name for name in self.components if name != "primary")

    @property
    def count(self) -> int:
        """Rows for each laser point and pixel."""
        return self.primary + len(self.others)

    def of_part(self, order: int) -> Ints:
        """(K,) the row of a contribution of `order` bounces that comes from a vertex on each part."""
        name = component_of(order)
        if name == "primary":
            return np.arange(self.all_parts) if self.parts else np.zeros(self.all_parts, np.int64)
        return np.full(self.all_parts, self.primary + self.others.index(name))


@dataclass(frozen=True)
class Problem:
    """A transient to be found: what is looked at, how exactly, and the scene as compiled loops want it.

    `capture`, `cones`, `patches` and `points` may be some laser points (and, confocally, their pixels) of a larger
    capture. The components to be found are those of `splits`.
    """

    scene: Scene
    capture: Capture
    accuracy: Accuracy
    caster: Raycaster
    materials: MaterialTable
    cones: PixelCones
    patches: PixelPatches
    points: LaserPoints
    aim: Callable[[], AreaTarget]
    """The small parts that hidden vertices are drawn on by area. Trial rays choose them when this is first called:
    quadrature never does."""
    seed: int
    tally_rows: TallyRows
    walked: Bools
    """(K,) parts whose vertices path tracing connects with the field of view in paths of four bounces; the others are
    left out, or left to the factorised form (`factorised/secondary.py`)."""

    @property
    def last_order(self) -> int | None:
        """The highest order to be followed; None for all."""
        asked = self.tally_rows.components
        if "higher" in asked:
            return self.accuracy.max_bounces
        return 4 if "secondary" in asked and self.walked.any() else 3

    def for_lasers(self, lasers: Ints) -> Problem:
        """The same problem for some of its laser points (confocally, and their pixels), or for several copies of
        them."""
        sensor, cones, patches = self.capture.sensor, self.cones, self.patches
        if self.capture.pairing == "confocal":
            sensor = Sensor(sensor.position, sensor.pixels[lasers], sensor.aperture_radius_m, sensor.finite_aperture)
            cones, patches = cones.take(lasers), patches.take(lasers)
        laser = Laser(self.capture.laser.position, self.capture.laser.targets[lasers])
        capture = Capture(laser, sensor, self.capture.time, self.capture.pairing)
        return replace(self, capture=capture, cones=cones, patches=patches, points=self.points.take(lasers))

    def patch_detail(self, pixels: Ints) -> float:
        """Width of the largest patch of some pixels, in details: arrival times vary by the bin, amplitudes by some
        hundredth of the scene."""
        detail_m = min(float(path_from_time(self.capture.time.width_s)), self.caster.half_extent_m / 50)
        return 2 * float(self.patches.radius[pixels].max()) / detail_m
