"""A stored scene, and the same scene simulated again for what is not stored: its geometry and the light by part."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from datagen.capture import capture_for
from datagen.config import DatasetConfig
from datagen.design.light import light_of, transport_effects
from datagen.design.scene_for import scene_for
from datagen.detector import Exposure, Spad, detect, detector_for, expected_histogram
from datagen.errors import InputError
from datagen.labels import ViewFrame
from datagen.pipeline import Setup, counts_of, detector_effects, simulated_frames
from datagen.records import Capture, Scalar, Scene, TimeAxis, Transient
from datagen.records.arrays import Floats
from datagen.seeding import Purpose, derived_seed
from datagen.store import Manifest
from datagen.store.manifest import MissingMesh
from datagen.store.scenes import Scenes
from datagen.store.summaries import CHANGE, SIGNIFICANCE

REPRODUCED = 1e-5
"""Relative L2 difference up to which a transient counts as reproduced (storage in float32 costs 1e-7)."""
SAME_PLACE_M = 1e-6
"""Distance up to which a laser point counts as where it was stored: its coordinates are computed anew."""


@dataclass(frozen=True)
class StoredScene:
    """What a dataset holds of one scene.

    arrays : field → values. parameters : drawn numbers and others, by name. classes : names of the numbers in
    `object_class`. missing : a line about a mesh file of its objects that is missing; empty if all are there.
    frames : number of frames of a sequence. framed : names of the arrays that have an axis of frames. frame : the
    frame to which these have been cut (`at_frame`).
    """

    config: DatasetConfig
    index: int
    arrays: Mapping[str, NDArray[Any]]
    parameters: Mapping[str, Scalar] = field(default_factory=dict)
    classes: tuple[str, ...] = ()
    missing: str = ""
    frames: int | None = None
    framed: frozenset[str] = frozenset()
    frame: int | None = None

    @property
    def title(self) -> str:
        """Heading of its pictures: dataset, scene, and frame of a sequence."""
        of = "" if self.frame is None else f", frame {self.frame} of {self.frames}"
        return f"{self.config.name}, scene {self.index}{of}"

    def at_frame(self, frame: int | None = None) -> StoredScene:
        """A frame of a sequence as a scene, left out: the middle one; a scene that is measured once is what it is."""
        if self.frames is None:
            return self
        frame = self.frames // 2 if frame is None else frame
        arrays = {name: of[frame] if name in self.framed else of for name, of in self.arrays.items()}
        return replace(self, arrays=arrays, framed=frozenset(), frame=frame)

    def scene_of(self, drawn: Scene) -> Scene:
        """The drawn scene, of a frame as it stands in the middle of that."""
        return drawn if self.frame is None else drawn.at(float(self.arrays["laser_time"].mean()))

    def significance(self) -> dict[str, float]:
        """Object → stored significance of its own light in the data; objects without one are left out."""
        return self._by_object(SIGNIFICANCE)

    def change(self) -> dict[str, float]:
        """Object that moves → stored significance of what changes by it from frame to frame, the median of all."""
        return self._by_object(CHANGE)

    def _by_object(self, pattern: re.Pattern[str]) -> dict[str, float]:
        """Object → its number among the parameters whose names have such a pattern."""
        return {
            found[1]: float(value)
            for name, value in self.parameters.items()
            if (found := pattern.fullmatch(name)) and isinstance(value, int | float) and value == value
        }


@dataclass(frozen=True)
class Light:
    """Light or counts of a scan, for pictures of them.

    total, objects : (laser, pixel, bin) all, and what objects scattered (0 where that is not known).
    time : the bins. frame : of the label images, in which pictures show places on the wall, too.
    unit : what a bin has.
    """

    capture: Capture
    total: Floats
    objects: Floats
    time: TimeAxis
    frame: ViewFrame | None
    unit: str

    @property
    def clear(self) -> Floats:
        """Light of objects, or all where there is none of them."""
        return self.objects if self.objects.any() else self.total

    @cached_property
    def channel(self) -> tuple[int, int]:
        """(laser, pixel) where objects' light is clearest, by its energy times its share; else the brightest."""
        clear, total = self.clear.sum(axis=2), self.total.sum(axis=2)
        # By the share alone, channels with hardly any light would win.
        best = int(np.argmax(clear * clear / np.maximum(total, np.finfo(np.float64).tiny)))
        laser, pixel = np.unravel_index(best, total.shape)
        return int(laser), int(pixel)


@dataclass(frozen=True)
class Replay:
    """One scene simulated again.

    counts : (laser, pixel, bin) of the stored histogram, or drawn again where none is stored.
    expected : (laser, pixel, bin) its mean.
    mean_is_exact : whether that mean is exact, or the detector's approximate one.
    difference : relative L2 distance of the new transient from the stored one; None where none is stored.
    moved_m : largest distance of a laser point from its stored place, metres.
    """

    scene: Scene
    capture: Capture
    transient: Transient
    counts: NDArray[Any]
    expected: Floats
    difference: float | None
    moved_m: float = 0.0
    mean_is_exact: bool = True

    @property
    def counted(self) -> TimeAxis:
        """The bins of counts and expectation: those of the capture, or of the sensor that merges them."""
        time = self.capture.time
        return time.merged(time.bins // self.counts.shape[-1])

    @cached_property
    def light(self) -> Light:
        """All light, and that of the objects."""
        scene, total = self.scene, self.transient.total
        of_objects = [self.transient.parts[name] for name in scene.objects if name in self.transient.parts]
        frame = None if scene.hidden_view is None else ViewFrame.of(scene)
        objects = np.sum([np.zeros_like(total), *of_objects], axis=0)
        return Light(self.capture, total, objects, self.capture.time, frame, "photons per emitted photon and bin")

    @property
    def reproduced(self) -> bool:
        """Whether the simulation agrees with everything that is stored."""
        return self.moved_m <= SAME_PLACE_M and (self.difference is None or self.difference <= REPRODUCED)


def read_scene(dataset: str | Path, index: int) -> StoredScene:
    """Read everything stored of scene `index`.

    Raises `InputError` when the folder is no dataset, has no such scene, its shard is not committed, or the scene
    could not be made when the dataset was built; `CheckError` for what is missing or damaged.
    """
    stored = Scenes(dataset)
    manifest, names = stored.manifest, stored.manifest.schema.by_name
    content = stored.read(index, "INDEX")
    classes = names["object_class"].classes if "object_class" in names else ()
    config, missing = config_of(manifest)
    framed = frozenset(name for name, field in names.items() if field.frame_bytes is not None)
    return StoredScene(
        config, index, content.arrays, content.parameters, classes, missing, manifest.frames, framed
    )  # fmt: skip


def config_of(manifest: Manifest) -> tuple[DatasetConfig, str]:
    """A dataset's configuration, and a line about a mesh file that is missing; empty if all are there.

    Raises `InputError` for a mesh file that has changed: a room with another object is not the one that was measured.
    """
    try:
        return manifest.parsed_config(), ""
    except MissingMesh as error:
        return manifest.parsed_config(meshes=False), str(error)


def replay(stored: StoredScene) -> Replay:
    """The stored scene, or frame of a sequence, simulated again: a scene depends on (configuration, seed, index)
    alone."""
    if stored.frame is not None:
        return _replay_of_frame(stored, stored.frame)
    config, index = stored.config, stored.index
    scene = scene_for(config, index)
    capture = capture_for(config, scene, config.seed, index)
    effects = transport_effects(config, scene, capture, index)
    given = detector_for(config.detector, config.seed, index, capture.time)
    transient = light_of(config, index, scene, capture, effects, *given).transient()
    effects += detector_effects(config, transient.total, transient.time, *given)
    spad, exposure, tolerance = effects.apply_detector(*given, config.detector.tolerance)
    approximate = config.detector.approximate
    expected, mean_is_exact = _mean(transient.total, capture.time, spad, exposure)
    counts = stored.arrays.get("histogram")
    if counts is None:
        seed = derived_seed(config.seed, index, Purpose.DETECTOR)
        counts = detect(
            transient.total, capture.time, spad, exposure, seed=seed, tolerance=tolerance, approximate=approximate
        )
    difference, moved_m = _difference(stored, transient.total), _moved_m(stored, transient.laser_points)
    return Replay(scene, capture, transient, counts, expected, difference, moved_m, mean_is_exact)


def _replay_of_frame(stored: StoredScene, frame: int) -> Replay:
    """A stored frame, from the whole sequence simulated again."""
    config, index = stored.config, stored.index
    scene = scene_for(config, index)
    capture = capture_for(config, scene, config.seed, index)
    setup = Setup.of(config, index, scene, capture)
    light = simulated_frames(setup)
    counted, one = counts_of(setup, light.at_once()), light.frames.frame(frame)
    seen = replace(one, components={"all": np.maximum(one.total, 0.0)})
    expected, mean_is_exact = _mean(seen.total, capture.time, counted.spad, counted.exposure)
    counts = stored.arrays.get("histogram")
    if counts is None:
        drawn = counted.histogram
        counts = drawn.reshape(light.frames.frames, -1, *drawn.shape[1:])[frame]
    # Laser points of a sensor that stands are stored as they are when the first frame begins.
    moved_m = _moved_m(stored, one.laser_points)
    difference = _difference(stored, one.total)
    return Replay(
        stored.scene_of(scene), setup.at(frame).capture, seen, counts, expected, difference, moved_m, mean_is_exact
    )


def _mean(total: Floats, time: TimeAxis, spad: Spad, exposure: Exposure) -> tuple[Floats, bool]:
    """Expected counts, and whether they are exact: the approximate mean where the detector has no exact one."""
    try:
        return expected_histogram(total, time, spad, exposure), True
    except InputError:
        return expected_histogram(total, time, spad, exposure, approximate=True), False


def _difference(stored: StoredScene, total: Floats) -> float | None:
    kept = stored.arrays.get("transient")
    if kept is None:
        return None
    norm = float(np.linalg.norm(kept))
    return float(np.linalg.norm(total - kept)) / norm if norm > 0 else float(np.linalg.norm(total) > 0)


def _moved_m(stored: StoredScene, points: Floats) -> float:
    kept = stored.arrays.get("laser_points")
    if kept is None:
        return 0.0
    if kept.shape != points.shape or not np.array_equal(np.isnan(kept), np.isnan(points)):
        return float("inf")
    return float(np.nanmax(np.append(np.linalg.norm(points - kept, axis=-1), 0.0)))
