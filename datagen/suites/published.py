"""What is published of a suite beside its configuration: rooms and expected counts of its first scenes.

A dataset agrees with it whose rooms are the same to rounding, and whose counts are as likely as the claimed errors of
the light and the law of counting allow. So it does not matter which processor or version of a library made it.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import numpy as np
import pydantic

from datagen._version import __version__
from datagen.config import DatasetConfig
from datagen.detector import detector_for, expected_histogram
from datagen.errors import CheckError
from datagen.pipeline import simulate_sample
from datagen.records.agreement import Agreement, counts_agreement, counts_in_spans, same_parameter
from datagen.scene import generate_scene
from datagen.store.files import json_bytes, parsed_json, read_whole
from datagen.store.record import Parameter
from datagen.store.scenes import Scenes
from datagen.suites.catalogue import Suite

SCENES = 4
"""First scenes of a suite that are published: enough to tell other rooms or other light, and made in seconds."""
SAME_M = 1e-5
"""Distance up to which two places are the same, metres: they are stored in single precision."""

_Count = Annotated[float, pydantic.Field(ge=0, allow_inf_nan=False)]


@dataclass(frozen=True)
class PublishedScene:
    """One scene.

    room : what was drawn for the room, by the names of `samples.parquet`.
    counts : expected counts of all pixels and laser points in spans of time (`counts_in_spans`).
    light_error : claimed relative L2 error of the light that they were made from.
    ways : of sequences right, up and depth of the middle of each object's box in each frame, metres; else empty.
    """

    room: dict[str, Parameter]
    counts: tuple[_Count, ...]
    light_error: _Count
    ways: tuple[pydantic.FiniteFloat, ...] = ()


@dataclass(frozen=True)
class Published:
    """The first scenes of a suite, and the version of datagen that made them."""

    datagen: str
    scenes: tuple[PublishedScene, ...]

    @classmethod
    def read(cls, path: Path) -> Published:
        """The content of a file that `write` made."""
        return parsed_json(path, read_whole(path), cls)

    def write(self, path: Path) -> None:
        """Write the file, which people can read."""
        path.write_bytes(json_bytes(self))


def publish(config: DatasetConfig, scenes: int = SCENES) -> Published:
    """Simulate the first scenes of a suite for publication."""
    return Published(__version__, tuple(_published_scene(config, index) for index in range(scenes)))


def room_of(config: DatasetConfig, index: int) -> dict[str, Parameter]:
    """What is drawn for the room of a scene. The seen fraction of an object is counted by rays, of which one may just
    miss an edge on another processor."""
    parameters = generate_scene(config.scene, config.seed, index, clock=config.clock).parameters
    return {name: value for name, value in parameters.items() if not name.endswith(".seen_fraction")}


def _published_scene(config: DatasetConfig, index: int) -> PublishedScene:
    moves = config.sequence is not None
    with_light = config.store.model_copy(update={"fields": ("transient", "objects") if moves else ("transient",)})
    sample = simulate_sample(config.model_copy(update={"store": with_light}), index)
    time = config.capture.time.axis()
    detector = detector_for(config.detector, config.seed, index, time)
    light = np.maximum(sample.arrays["transient"].reshape(-1, *config.capture.shape), 0.0)
    expected = [expected_histogram(frame, time, *detector, approximate=True) for frame in light]
    counts = counts_in_spans(np.array(expected))
    error = float(sample.parameters["transient.relative_error"])
    ways = sample.arrays["object_box_center"].ravel().tolist() if moves else ()
    return PublishedScene(room_of(config, index), tuple(counts.round(3).tolist()), error, tuple(ways))


def published_of(suite: Suite) -> Published:
    """The first scenes of a suite as published."""
    return Published.read(suite.path.with_suffix(".json"))


def check_agreement(dataset: str | Path, published: Published) -> Agreement:
    """The agreement of the counts of the first scenes of a dataset with the published ones.

    Raises `CheckError`, which names the first number of a room that differs, or how far the counts are off; and
    `InputError` if a scene is not there.
    """
    stored, found, due, claimed = Scenes(dataset), [], [], []
    for index, scene in enumerate(published.scenes):
        content = stored.read(index)
        for name, value in scene.room.items():
            own = content.parameters.get(name)
            if not same_parameter(own, value):
                raise CheckError(
                    f"{dataset}: scene {index} has another room than published by datagen {published.datagen}: "
                    f"{name} = {own}, published {value}"
                )
        if scene.ways:
            own_ways = content.arrays["object_box_center"].ravel()
            if not np.allclose(own_ways, scene.ways, rtol=0, atol=SAME_M):
                raise CheckError(
                    f"{dataset}: objects of scene {index} go other ways than published by datagen {published.datagen}"
                )
        due.append(np.array(scene.counts))
        found.append(counts_in_spans(content.arrays["histogram"]))
        claimed.append(scene.light_error + float(content.parameters["transient.relative_error"]))
    # What is published are means, so chance is that of one side alone.
    agreement = counts_agreement(found, due, claimed, drawn=float(np.sum(due)))
    if not agreement.holds:
        raise CheckError(
            f"{dataset}: counts of the first {len(due)} scenes are {agreement.difference:.1%} off those published by "
            f"datagen {published.datagen}; the claimed errors of the light and chance allow {agreement.allowed:.1%}"
        )
    return agreement
