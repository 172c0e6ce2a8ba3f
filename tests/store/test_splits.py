"""Splits: no room is in two, growing moves no scene, and held-out scenes are in no other split."""

from __future__ import annotations

import dataclasses
import re
from itertools import chain
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from datasets import write_dataset
from fake_samples import fake_sample, small_config
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.stats import chi2_contingency

import datagen as dg
from datagen.building.build import build
from datagen.config import DatasetConfig, SplitsConfig, config_from_mapping
from datagen.config.yaml_text import parse_yaml
from datagen.errors import InputError
from datagen.records import Sample
from datagen.store import verify
from datagen.store.splits import splits_of

pytestmark = pytest.mark.usefixtures("builds_here")

SPLITS = ("train", "val", "test")


def rooms(numbers: list[int]) -> list[dict[str, Any]]:
    """Parameters of scenes that show these rooms, each with a detector of its own."""
    return [{"layout.height_m": 2.0 + n, "detector.pde": k / 1e6} for k, n in enumerate(numbers)]


@settings(deadline=None)
@given(st.lists(st.integers(0, 30), min_size=1, max_size=60), st.integers(0, 60))
def test_no_room_is_on_two_sides_and_growing_moves_none(numbers: list[int], more: int) -> None:
    small = splits_of(rooms(numbers), SplitsConfig())
    assert all(len({small[k] for k, n in enumerate(numbers) if n == room}) == 1 for room in numbers)
    grown = splits_of(rooms(numbers + list(range(100, 100 + more))), SplitsConfig())
    assert grown[: len(numbers)] == small and set(grown) <= set(SPLITS)


def test_shares_are_kept_in_small_and_large_datasets() -> None:
    for scenes in (10, 100):
        found = splits_of(rooms(list(range(scenes))), SplitsConfig())
        assert [found.count(name) for name in SPLITS] == [scenes * 8 // 10, scenes // 10, scenes // 10]
    uneven = splits_of(rooms(list(range(20_000))), SplitsConfig(train=0.615, val=0.0, test=0.385))
    assert uneven.count("val") == 0
    # 20 000 numbers, of which only those of one tenth in ten are random: five standard deviations of their binomial.
    assert abs(uneven.count("train") - 12_300) < 5 * np.sqrt(2_000 * 0.15 * 0.85)


def test_neighbours_are_dealt_out_at_random() -> None:
    """No pattern of period 2 to 9 shows: χ² of (place in the period, split) at a level of 10⁻⁶ for each."""
    found = np.array(splits_of(rooms(list(range(20_000))), SplitsConfig(train=0.5, val=0.25, test=0.25)))
    for period in range(2, 10):
        place = np.arange(len(found)) % period
        table = [[np.sum((place == p) & (found == name)) for name in SPLITS] for p in range(period)]
        assert chi2_contingency(table).pvalue > 1e-6


HELD_OUT = [
    ("classes", ("chair",), {"a.class": "chair"}, {"a.class": "table", "a.kind": "chair"}),
    ("layouts", ("t_corridor", "left"), {"layout.turn": "left"}, {"layout.kind": "l_corridor"}),
    ("materials", ("plywood",), {"walls.material": "plywood"}, {"walls.material": "brick"}),
    ("files", ("bunny.obj",), {"a.file": "bunny.obj"}, {"a.file": "bunny.ply"}),
    ("along", (0.0, 0.25), {"a.along": 0.25, "a.across": 0.9}, {"a.along": 0.3, "b.along": 0.9}),
]  # fmt: skip


def test_held_out_scenes_are_in_no_other_split() -> None:
    for key, value, shows, does_not in HELD_OUT:
        splits = SplitsConfig.model_validate({"held_out": ({"name": "unseen", key: value},)})
        scenes = [room | (shows if k % 3 else does_not) for k, room in enumerate(rooms([*range(60)]))]
        found = splits_of(scenes, splits)
        assert [name == "unseen" for name in found] == [bool(k % 3) for k in range(60)], key
        assert set(found) == {"unseen", *SPLITS}


def test_a_place_is_that_of_one_object_and_all_keys_must_be_met() -> None:
    rule = {"name": "corner", "along": (0.0, 0.5), "across": (0.0, 0.5), "classes": ("box",)}
    splits = SplitsConfig.model_validate({"held_out": (rule, {"name": "far", "along": (0.0, 0.5)})})
    there = {"a.class": "box", "a.along": 0.1, "a.across": 0.2}
    found = splits_of(
        [there, there | {"a.class": "cone"}, there | {"a.across": 0.9, "b.along": 0.9, "b.across": 0.1}], splits
    )
    assert found == ["corner", "far", "far"]
    assert splits_of([None, {}], splits)[0] is None and splits_of([None, {}], splits)[1] in SPLITS


def chairs(config: DatasetConfig, index: int) -> Sample:
    """Scenes of a chair or a table, each room shown by two scenes one after the other."""
    sample = fake_sample(config, index)
    shown = {"a.class": "chair" if index // 2 % 3 == 0 else "table", "room": index // 2, "detector.pde": index / 100}
    return dataclasses.replace(sample, parameters=shown)


def chair_config(scenes: int = 40, **splits: Any) -> DatasetConfig:
    library = [{"kind": "library", "classes": ["chair", "table"]}]
    return small_config(scenes=scenes, scene={"contents": library}, splits=splits)


def scenes_of(path: Path, split: str, **options: Any) -> list[int]:
    try:
        return [int(s) for s in dg.TransientDataset(path, ("depth",), split=split, **options).scenes]
    except InputError as empty:
        assert f"split = {split!r}: holds no scene" in str(empty)
        return []


def test_a_dataset_is_read_by_split(tmp_path: Path) -> None:
    path = write_dataset(chair_config(), tmp_path / "set", chairs)
    before = {name: scenes_of(path, name) for name in SPLITS}
    assert sorted(chain(*before.values())) == list(range(40)) and len(before["train"]) > len(before["val"]) > 0
    assert all({scene ^ 1 for scene in scenes} == set(scenes) for scenes in before.values()), "two scenes show a room"
    data = dg.TransientDataset(path, ("depth",), split="val")
    assert [int(item["scene"]) for item in data.__getitems__([0, 1])] == before["val"][:2]
    assert data.parameters("room").tolist() == [scene // 2 for scene in before["val"]]
    halves = [scenes_of(path, name, fractions=(0.5, 0.0, 0.5)) for name in ("train", "test")]
    assert sorted(chain(*halves)) == list(range(40)) and set(before["test"]) <= set(halves[1])
    assert "`samples.parquet`; no room is in two): train" in (path / "README.md").read_text()

    held = [{"name": "chairs", "classes": ["chair"]}]
    write_dataset(chair_config(60, held_out=held), path, chairs)
    assert verify(path, deep=True).problems == ()
    assert scenes_of(path, "chairs") == [scene for scene in range(60) if scene // 2 % 3 == 0]
    for name in SPLITS:
        now = scenes_of(path, name)
        assert [s for s in now if s < 40] == [s for s in before[name] if s // 2 % 3], "grown, and held out"
        assert scenes_of(path, name, fractions=(0.8, 0.1, 0.1)) == now, "from the column, and from what scenes show"


def test_changed_splits_make_nothing_anew(tmp_path: Path) -> None:
    build(chair_config(12), tmp_path / "set", progress=False, sample_function=chairs)
    records = {path: path.read_bytes() for path in (tmp_path / "set/build").iterdir()}
    changed = chair_config(12, train=0.5, val=0.25, test=0.25)
    assert build(changed, tmp_path / "set", progress=False, sample_function=chairs).built == 0
    assert {path: path.read_bytes() for path in (tmp_path / "set/build").iterdir()} == records
    assert verify(tmp_path / "set").problems == () and len(scenes_of(tmp_path / "set", "train")) < 9


def test_the_example_of_the_docs_is_one() -> None:
    page = (Path(__file__).parents[2] / "docs/datasets.md").read_text(encoding="utf-8")
    (example,) = re.findall(r"^```yaml\n(.*?)^```", page, re.DOTALL | re.MULTILINE)
    config = chair_config(**parse_yaml(example, "docs/datasets.md")["splits"])
    assert config.splits.names == (*SPLITS, "unseen_chairs", "near_the_wall", "plywood_to_the_left")
    turned = {"layout.turn": "left", "walls.material": "plywood"}
    assert splits_of([turned, {"a.class": "chair"}], config.splits) == ["plywood_to_the_left", "unseen_chairs"]


def test_wrong_splits_are_refused(tmp_path: Path) -> None:
    path = write_dataset(chair_config(12), tmp_path / "set", chairs)
    for options, message in (
        ({"split": "trian"}, r"split = 'trian': .*set has train, val, test$"),
        ({"split": "train", "fractions": (0.5, 0.5)}, r"fractions = \(0.5, 0.5\): must be three numbers"),
        ({"split": "train", "fractions": (0.5, 0.5, 0.5)}, "that add up to 1"),
        ({"fractions": (0.5, 0.25, 0.25)}, "name the one to read"),
        # Six rooms of two scenes each; the random draw of `val` begins at the share 0.99.
        ({"split": "val", "fractions": (0.99, 0.01, 0.0)}, r"split = 'val': holds no scene of .*"),
    ):
        with pytest.raises(InputError, match=message):
            dg.TransientDataset(path, **options)  # type: ignore[arg-type]
    for splits, message in (
        ({"train": 0.9}, "splits: train, val, test = 0.9, 0.1, 0.1: must add up to 1"),
        ({"held_out": [{"name": "test", "classes": ["box"]}]}, "is dealt out by share"),
        ({"held_out": [{"name": "x"}]}, "x: says nothing"),
        ({"held_out": [{"name": "x", "along": [0.5, 0.1]}]}, "the first must not exceed"),
        ({"held_out": [{"name": "x", "classes": ["boxx"]}]}, "'boxx' is not a class of .*; did you mean 'box'"),
        ({"held_out": [{"name": "x", "along": [0, 1]}] * 2}, "a split is named twice"),
    ):
        with pytest.raises(InputError, match=message):
            config_from_mapping({"splits": splits})
