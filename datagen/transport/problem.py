"""The problem that every integrator solves: scene, capture, accuracy, and the scene as arrays for compiled loops."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from datagen.records import Accuracy, Capture, Scene
from datagen.records.arrays import Bools, Ints
from datagen.transport.brdf import MaterialTable
from datagen.transport.fields_of_view import PixelCones, PixelPatches
from datagen.transport.path_tracing.vertices import AreaTarget, LaserPoints
from datagen.transport.visibility.raycast import Raycaster
from datagen.units import path_from_time

COMPONENTS: tuple[str, ...] = ("direct", "primary", "secondary", "higher")


def component_of(order: int) -> str:
    """Name of the component that paths of `order` bounces belong to."""
    return "direct" if order < 3 else "primary" if order == 3 else "secondary" if order == 4 else "higher"


def components_asked(accuracy: Accuracy) -> tuple[str, ...]:
    """Names of the components that an accuracy asks for, in the order of `COMPONENTS`."""
    orders = accuracy.max_bounces or 5
    requested = {
        "direct": accuracy.direct,
        "primary": orders >= 3,
        "secondary": orders >= 4 and accuracy.secondary != "none",
        "higher": orders >= 5,
    }
    return tuple(name for name in COMPONENTS if requested[name])


@dataclass(frozen=True)
class TallyRows:
    """Histogram rows for each laser point and pixel.

    The primary comes first, with one row for each part of the scene, or one row if it is not split by part. Then
    there is one row for each other component.

    Attributes
    ----------
    parts : names of the scene's parts if the primary is split by part, else empty.
    components : names of the components to be computed.
    all_parts : number of parts of the scene.
    """

    parts: tuple[str, ...]
    components: tuple[str, ...]
    all_parts: int

    @property
    def primary(self) -> int:
        """Number of rows of the primary."""
        return max(len(self.parts), 1) if "primary" in self.components else 0

    @property
    def others(self) -> tuple[str, ...]:
        """Names of the components other than the primary, in the order of their rows."""
        return tuple(name for name in self.components if name != "primary")

    @property
    def count(self) -> int:
        """Number of rows for each laser point and pixel."""
        return self.primary + len(self.others)

    def of_part(self, order: int) -> Ints:
        """(K,) row of a path of `order` bounces, by the part that its last vertex before the FoV point lies on."""
        name = component_of(order)
        if name == "primary":
            return np.arange(self.all_parts) if self.parts else np.zeros(self.all_parts, np.int64)
        return np.full(self.all_parts, self.primary + self.others.index(name))


@dataclass(frozen=True)
class Problem:
    """A transient to be computed: scene, capture and accuracy, and the same as arrays for compiled loops.

    `capture`, `cones`, `patches` and `points` may be those of some laser points (and, confocally, of their pixels) of
    a larger capture. The components to be computed are those of `tally_rows`.
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
    """Returns the small parts on which path tracing draws hidden vertices by area. Trial rays choose these parts at
    the first call, which quadrature never makes."""
    seed: int
    tally_rows: TallyRows
    walked: Bools
    """(K,) whether path tracing finds the paths of four bounces whose second hidden vertex lies on a part. The paths
    of other parts are left out, or left to the factorised form (`factorised/secondary.py`)."""

    @property
    def last_order(self) -> int | None:
        """The highest number of bounces of paths that path tracing follows; None for no limit."""
        requested = self.tally_rows.components
        if "higher" in requested:
            return self.accuracy.max_bounces
        return 4 if "secondary" in requested and self.walked.any() else 3

    def for_lasers(self, lasers: Ints) -> Problem:
        """The same problem for some of its laser points, and confocally for their pixels.

        lasers : indices of laser points, which may repeat.
        """
        sensor, cones, patches = self.capture.sensor, self.cones, self.patches
        if self.capture.pairing == "confocal":
            sensor = sensor.take(lasers)
            cones, patches = cones.take(lasers), patches.take(lasers)
        capture = Capture(self.capture.laser.take(lasers), sensor, self.capture.time, self.capture.pairing)
        return replace(self, capture=capture, cones=cones, patches=patches, points=self.points.take(lasers))

    def patch_detail(self, pixels: Ints) -> float:
        """Width of the largest patch of some pixels, over the size of the smallest detail that matters.

        Arrival times matter to a bin's length of path, and amplitudes vary over some hundredth of the scene.
        """
        detail_m = min(float(path_from_time(self.capture.time.width_s)), self.caster.half_extent_m / 50)
        return 2 * float(self.patches.radius[pixels].max()) / detail_m
