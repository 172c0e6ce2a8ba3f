"""The problem that every sampler solves, as arrays for compiled loops; and the form of its answer."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from datagen.records import Accuracy, Capture, Scene
from datagen.records.arrays import Floats, Ints
from datagen.transport.brdf import MaterialTable
from datagen.transport.fields_of_view import PixelCones
from datagen.transport.laser_points import LaserPoints, parts_lit
from datagen.transport.memory import in_calls
from datagen.transport.rays import Raycaster
from datagen.transport.reference import pairs_of
from datagen.transport.scene_numbers import SceneNumbers

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
        "secondary": orders >= 4 and accuracy.secondary,
        "higher": orders >= 5,
    }
    return tuple(name for name in COMPONENTS if requested[name])


class Pairs(NamedTuple):
    """The pairs of laser point and pixel. Light of pair i goes to histogram i mod H: in a scan each has its own, and
    a flood adds all laser points up.

    ends : (n, 2) laser point and pixel. histograms : their number H. share : (L,) of the light that each laser point
    stands for; 1 in a scan.
    """

    ends: Ints
    histograms: int
    share: Floats

    @classmethod
    def of(cls, capture: Capture) -> Pairs:
        """The pairs of a capture."""
        share = capture.laser.shares if capture.illumination == "flood" else np.ones(len(capture.laser.targets))
        return cls(pairs_of(capture), math.prod(capture.shape[:2]), share)

    def in_parts(self, parts: int) -> Pairs:
        """The pairs of so many equal parts of each laser point, whose numbers follow those of all before."""
        ends = np.tile(self.ends, (parts, 1))
        ends[:, 0] += np.repeat(np.arange(parts) * len(self.share), len(self.ends))
        return Pairs(ends, self.histograms, np.tile(self.share / parts, parts))

    def of_histograms(self, which: Ints) -> Ints:
        """(m, k) numbers of all k pairs of some histograms (m,)."""
        return np.asarray(which[:, None] + np.arange(0, len(self.ends), self.histograms))

    def in_calls(self, numbers: int) -> Iterator[tuple[slice, Ints]]:
        """Slices of the histograms, each with the numbers of all pairs, laser point by laser point, that take so many
        numbers of memory for each histogram."""
        for some in in_calls(self.histograms, numbers):
            yield some, self.of_histograms(np.arange(self.histograms)[some]).T.ravel()


@dataclass(frozen=True)
class Problem:
    """A transient to be computed: scene, capture and accuracy, and the same as arrays for compiled loops.

    Attributes
    ----------
    numbers : of the scene. points : the laser points. cones : of the pixels. pairs : of both.
    seed : of all random numbers.
    split_parts : whether the primary is split by part.
    """

    scene: Scene
    capture: Capture
    accuracy: Accuracy
    caster: Raycaster
    materials: MaterialTable
    numbers: SceneNumbers
    cones: PixelCones
    points: LaserPoints
    pairs: Pairs
    seed: int
    split_parts: bool

    @classmethod
    def of(
        cls, scene: Scene, capture: Capture, accuracy: Accuracy, seed: int, *, split_parts: bool,
        caster: Raycaster | None = None,
    ) -> Problem:  # fmt: skip
        """The problem of a scene and a capture. caster : of the scene's triangles, if there is one already."""
        caster = Raycaster(scene) if caster is None else caster
        materials = MaterialTable.of(scene.materials)
        return cls(
            scene, capture, accuracy, caster, materials, SceneNumbers.of(caster, scene, materials, capture.time),
            PixelCones.of(capture.sensor), LaserPoints.of(caster, scene, capture.laser), Pairs.of(capture), seed,
            split_parts,
        )  # fmt: skip

    @property
    def is_lit(self) -> bool:
        """Whether a laser ray meets the scene; of a beam that states its cells any one of several in each."""
        if (self.points.part >= 0).any():
            return True
        return bool((parts_lit(self.points, self.caster, self.scene, self.capture.laser) >= 0).any())

    @property
    def components(self) -> tuple[str, ...]:
        """Names of the components that are asked for."""
        return components_asked(self.accuracy)

    @property
    def parts(self) -> tuple[str, ...]:
        """Names of the parts by which the primary is split; none if it is not."""
        return self.scene.part_names if self.split_parts and "primary" in self.components else ()


@dataclass(frozen=True)
class Estimate:
    """The light of a problem; fields have the names and meanings of those of `Transient`."""

    components: dict[str, Floats]
    parts: dict[str, Floats]
    stderr: Floats
    overflow: Floats
    claimed_error: float | None = None
    met_target: bool | None = None
    part_errors: Mapping[str, float] = field(default_factory=dict)
    samplers: Mapping[str, str] = field(default_factory=dict)
    rays: Mapping[str, float] = field(default_factory=dict)


def nothing(problem: Problem) -> Estimate:
    """The estimate where no laser ray meets the scene: exactly zero."""
    shape = problem.capture.shape
    zeros = {name: np.zeros(shape) for name in problem.components}
    parts = {name: np.zeros(shape) for name in problem.parts}
    known = problem.accuracy.target is not None
    return Estimate(
        zeros, parts, np.zeros(shape), np.zeros(shape[:2]), 0.0 if known else None, True if known else None,
        samplers=dict.fromkeys(problem.components, "nothing visible"), rays=dict.fromkeys(problem.components, 0.0),
    )  # fmt: skip
