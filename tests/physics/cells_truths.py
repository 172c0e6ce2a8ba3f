"""True primaries, computed to an eighth of the target, for a few laser points of scenes of the ready configurations.

`python tests/physics/cells_truths.py` computes `data/cells_truths.npz` anew (a minute): the truths of the daily test.
"""

from __future__ import annotations

from collections.abc import Iterator
from functools import cache
from pathlib import Path

import numpy as np

from datagen import Accuracy, Capture, Scene, capture_for, generate_scene, load_config, simulate
from datagen.bench.promise import some_points
from datagen.errors import InputError
from datagen.transport.brdf import MaterialTable

CONFIGS = Path(__file__).parents[2] / "configs"
STORED = Path(__file__).parent / "data" / "cells_truths.npz"
DAILY, DAILY_COUNT, DAILY_TARGET = (
    ["confocal_scan", "quickstart", "shapes_behind_a_partition", "own_mesh", "letters_on_a_bench"], 10, 0.05
)  # fmt: skip
LASERS, HELD, FINER = 64, 12, 8

Light = dict[str, np.ndarray]
"""(L, 1, T) of the whole, as `total`, and of each object by its name."""


def scenes(names: list[str], count: int) -> Iterator[tuple[Scene, Capture]]:
    """Generated scenes of the named configurations in turn, each with `LASERS` random laser points of its scan."""
    for case in range(count):
        config = load_config(CONFIGS / f"{names[case % len(names)]}.yaml")
        try:
            scene = generate_scene(config.scene, config.seed, 5000 + case)
            whole = capture_for(config, scene, config.seed, 5000 + case)
        except InputError:
            continue
        yield scene, some_points(whole, np.random.default_rng(case).permutation(whole.shape[0])[:LASERS])


def held_points(capture: Capture) -> np.ndarray:
    """The indices of the laser points whose truth is known."""
    return np.arange(0, capture.shape[0], max(capture.shape[0] // HELD, 1))


def truth(scene: Scene, capture: Capture, target: float, seed: int) -> Light:
    """The primary at those laser points, to an eighth of the target; the stored one if it belongs to just this
    scene."""
    of = _numbers(scene, capture, target)
    for k in range(DAILY_COUNT):
        if f"{k}/of" in _stored() and _alike(_stored()[f"{k}/of"], of):
            return {name[2:]: light for name, light in _stored().items() if name.startswith(f"{k}/")}
    return _computed(scene, capture, target, seed)


def _computed(scene: Scene, capture: Capture, target: float, seed: int) -> Light:
    found = simulate(scene, some_points(capture, held_points(capture)), Accuracy(target=target / FINER), seed + 1)
    objects = [name for name, role in zip(scene.part_names, scene.roles, strict=True) if role == "object"]
    return {"total": found.total} | {name: found.parts[name] for name in objects}


@cache
def _stored() -> Light:
    if not STORED.exists():
        return {}
    with np.load(STORED) as arrays:
        return dict(arrays)


def _numbers(scene: Scene, capture: Capture, target: float) -> np.ndarray:
    """All numbers that the light of a scene depends on, to recognise a stored truth by."""
    table, time, sensor = MaterialTable.of(scene.materials), capture.time, capture.sensor
    return np.concatenate([
        scene.vertices.ravel(), scene.triangles.ravel(), scene.face_part, table.kind, table.values.ravel(),
        capture.laser.targets.ravel(), sensor.pixels.ravel(), sensor.position, capture.laser.position,
        [sensor.aperture_area_m2, time.start_s * 1e9, time.width_s * 1e9, scene.attenuation_per_m, target],
    ])  # fmt: skip


def _alike(one: np.ndarray, other: np.ndarray) -> bool:
    # Processors round differently, for instance in a rotation.
    return one.shape == other.shape and np.allclose(one, other, rtol=1e-9, atol=1e-9)


if __name__ == "__main__":
    found: Light = {}
    for k, (scene, capture) in enumerate(scenes(DAILY, DAILY_COUNT)):
        light = _computed(scene, capture, DAILY_TARGET, 10 * k)
        found |= {f"{k}/{name}": values.astype(np.float32) for name, values in light.items()}
        found[f"{k}/of"] = _numbers(scene, capture, DAILY_TARGET)
    np.savez_compressed(STORED, **found)  # type: ignore[arg-type]
