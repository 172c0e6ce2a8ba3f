"""The evidence of a change: by how much two frames differ because an object has moved."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from datagen.detector import Exposure, Spad
from datagen.detector.own_light import own_light
from datagen.records import Scalar, Scene, SequenceLight
from datagen.records.arrays import Floats
from datagen.records.label_fields import names_made_by

OBJECT_CHANGE = names_made_by("evidence.change")
"""Names of the stored tables of change and floor, which have a row for each object."""


@dataclass(frozen=True)
class Change:
    """The change of a measurement from one frame to the next by an object.

    With b and b′ the expected detections of both frames and d what changes of them by the object, an ideal matched
    filter on the difference of the counts finds the change with √Σ d²/(b + b′) standard deviations: the most that a
    network on difference frames can see. With 2 b in place of the sum a thing that walks away would count double, as
    its light of the frame before falls on dark bins.

    Attributes
    ----------
    significance : √Σ d²/(b + b′), within `floor` of the truth.
    floor : the significance that the error of the simulation alone would have.
    """

    significance: float
    floor: float


@dataclass(frozen=True)
class FrameDetections:
    """Expected detections of a frame: (L, P, bin) of all light, of the own light of some objects, and the error of
    the change from the frame before."""

    everything: Floats
    own: Mapping[str, Floats]
    error: Floats


def frame_detections(
    light: SequenceLight, frame: int, objects: Sequence[str], spad: Spad, exposure: Exposure
) -> FrameDetections:
    """The expected detections of a frame, and of those `objects` whose own light is known."""
    known = [name for name in objects if name in light.parts]
    # With a single replicate the standard error is NaN, and the floor unknown.
    lights = [*(light.parts[name][frame] for name in known), np.nan_to_num(light.change_stderr[frame])]
    blocks = [*own_light(np.maximum(light.total(frame), 0.0), lights, light.time, spad, exposure)]
    *own, error = (np.concatenate([block.own[k] for block in blocks]) for k in range(len(lights)))
    everything = np.concatenate([block.everything for block in blocks])
    return FrameDetections(everything, dict(zip(known, own, strict=True)), error)


def change_squares(
    scene: Scene, light: SequenceLight, spad: Spad, exposure: Exposure, sensor_moves: bool = False
) -> Iterator[tuple[Floats, dict[str, Floats], Floats]]:
    """For each frame but the first: (L, P, bin) detections of both frames together, object that moves → d²/(b + b′),
    and e²/(b + b′) with e the standard error of the change.

    Where one object moves, all that changes is by it: its own light, what it blocks, and light of more bounces. Of
    several it is not known whose shadow a change is, and d is that of the own light alone; so it is for a sensor that
    moves, which changes all light.
    """
    movers = [name for name in scene.objects if name in scene.moving]
    alone = len(movers) == 1 and not sensor_moves
    before: FrameDetections | None = None
    for frame in range(light.frames):
        now = frame_detections(light, frame, () if alone else movers, spad, exposure)
        if before is not None:
            both = now.everything + before.everything
            weight = np.divide(1.0, both, out=np.zeros_like(both), where=both > 0)
            changes = {name: now.own[name] - before.own[name] for name in now.own}
            if alone:
                changes = {movers[0]: now.everything - before.everything}
            yield both, {name: d * d * weight for name, d in changes.items()}, now.error**2 * weight
        before = now


def changes_of(
    scene: Scene, light: SequenceLight, spad: Spad, exposure: Exposure, sensor_moves: bool = False
) -> dict[str, list[Change]]:
    """Object → its change from the frame before, of each frame: 0 in the first frame and of objects that stand, NaN
    of objects that move and whose own light is not known."""
    still, unknown = Change(0.0, 0.0), Change(math.nan, math.nan)
    found = {name: [still] * light.frames for name in scene.objects}
    if not scene.moving:
        return found
    is_known = bool(np.isfinite(light.change_stderr).all())
    for k, (_, squares, error) in enumerate(change_squares(scene, light, spad, exposure, sensor_moves)):
        floor = math.sqrt(float(error.sum())) if is_known else math.nan
        for name in scene.moving:
            one = squares.get(name)
            found[name][k + 1] = unknown if one is None else Change(math.sqrt(float(one.sum())), floor)
    return found


def change_tables(changes: Mapping[str, Sequence[Change]], rows: int, frames: int) -> dict[str, NDArray[np.float32]]:
    """Field → (F, rows) table of the objects in their order; 0 in rows without an object."""
    tables = np.zeros((2, frames, rows), np.float32)
    for row, every in enumerate(changes.values()):
        tables[0, :, row], tables[1, :, row] = zip(*((of.significance, of.floor) for of in every), strict=True)
    return dict(zip(OBJECT_CHANGE, tables, strict=True))


def change_parameters(changes: Mapping[str, Sequence[Change]], moving: Sequence[str]) -> dict[str, Scalar]:
    """`evidence.PART.change` and `.change_floor` of objects that move: medians over the frames after the first."""
    flat: dict[str, Scalar] = {}
    for name in moving:
        significance, floor = zip(*((of.significance, of.floor) for of in changes[name][1:]), strict=True)
        flat[f"evidence.{name}.change"] = float(np.median(significance))
        flat[f"evidence.{name}.change_floor"] = float(np.median(floor))
    return flat
