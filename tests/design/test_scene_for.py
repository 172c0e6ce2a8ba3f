"""Scenes whose objects must have evidence: stored objects have it, and a scene is the same by every way to make
it."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from small_measurement import measurement

import datagen as dg
from datagen.building.resimulate import resimulate
from datagen.pipeline import simulate_sample
from datagen.store.info import info

pytestmark = pytest.mark.usefixtures("builds_here")

FLOOR = 25.0
FLOORED = [{"kind": "pillar"}, {"kind": "box", "evidence_at_least": FLOOR}]


def config(**others: object) -> dg.DatasetConfig:
    return measurement({"cycles": 300_000}, FLOORED, **others)


def test_objects_have_the_least_evidence_and_others_stand_anywhere(tmp_path: Path) -> None:
    """Boxes below the least evidence are frequent without it and absent with it; summaries state how many were
    moved."""
    free = measurement({"cycles": 300_000})
    boxes = [simulate_sample(free, k).parameters["evidence.box.significance"] for k in range(8)]
    assert 2 <= np.sum(np.array(boxes) < FLOOR) <= 7
    result = dg.build(config(scenes=8), tmp_path / "a", progress=False)
    data = dg.TransientDataset(tmp_path / "a", ("histogram",))
    assert data.parameters("evidence.box.significance").min() >= FLOOR
    assert data.parameters("evidence.pillar.significance").min() < FLOOR
    anew = data.parameters("evidence.placed_anew")
    assert anew.max() > 0
    stated = f"in {np.mean(anew > 0):.0%} of scenes objects were placed anew"
    for text in (result.summary(), info(tmp_path / "a"), (tmp_path / "a/README.md").read_text()):
        assert stated in text
    # A scene with enough evidence is not changed.
    met = [k for k in range(8) if boxes[k] > 1.3 * FLOOR]
    assert met
    for k in met:
        one, other = dg.generate_scene(free.scene, free.seed, k), dg.scene_for(config(), k)
        assert np.array_equal(one.vertices, other.vertices)


def test_the_scene_is_the_same_by_every_way_to_make_it(tmp_path: Path) -> None:
    """Built, made on the fly, simulated again, and made alone, the last one first."""
    small = config(store={"fields": ["histogram"], "scenes_per_shard": 1, "histogram_dtype": "uint32"})
    dg.build(small, tmp_path / "set", progress=False)
    alone = [simulate_sample(small, k).arrays["histogram"] for k in reversed(range(4))][::-1]
    data, made = dg.TransientDataset(tmp_path / "set", "histogram"), dg.GeneratedDataset(small, ("histogram",))
    for stored, fresh, other in zip(data, made, alone, strict=True):
        assert (stored["histogram"] == fresh["histogram"]).all()
        assert (stored["histogram"].numpy() == other).all()
    assert resimulate(tmp_path / "set", 4) == ([0, 1, 2, 3], [])


def test_evidence_that_no_placing_gives_is_refused_in_a_line() -> None:
    hopeless = [{"kind": "box", "evidence_at_least": 1e4}]
    with pytest.raises(dg.InputError) as refusal:
        dg.scene_for(measurement({"cycles": 10}, scene={"contents": hopeless, "max_attempts": 10}), 0)
    text = str(refusal.value)
    assert "had less evidence than 10000 σ: raise detector.cycles" in text and "\n" not in text
    with pytest.raises(dg.InputError, match=r"use dg\.scene_for\(config, index\)"):
        dg.generate_scene(config().scene, 0, 0)


def test_a_scene_without_such_objects_needs_no_light() -> None:
    none = [{"kind": "box", "count": 0, "evidence_at_least": 1e4}, {"kind": "pillar"}]
    scene = dg.scene_for(measurement({"cycles": 10}, none), 0)
    assert scene.objects == ("pillar",) and scene.parameters["evidence.placed_anew"] == 0
