"""Scores of scenes with one object and no images: laws of the metrics, and every error of such predictions."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from datasets import write_dataset
from made_suite import made_suite
from refused_predictions import assert_predictions_are_refused

import datagen as dg
from datagen.cli import run
from datagen.config import config_from_mapping
from datagen.scoring.single_objects import TITLES, SingleObjects, has_single_objects, read_single_objects
from datagen.store import read_manifest

pytestmark = pytest.mark.usefixtures("builds_here")

CONFIG = {
    "name": "plates", "scenes": 20, "seed": 5,
    "scene": {
        "layout": {"kind": "isolated_wall"},
        "contents": [
            {"kind": "library", "name": "plate", "classes": ["letter_a", "digits"],
             "height_m": {"choice": [0.3, 0.6]}, "albedo": {"log_uniform": [1e-4, 0.9]}}
        ],
    },
    "capture": {"scan": {"rows": 2, "columns": 2}, "time": {"bins": 64, "bin_width_ps": 300}},
    "transport": {"samples": 64},
    "detector": {"cycles": 100000, "photons_per_pulse": 1e9},
    "store": {"fields": ["histogram", "objects"]},
    "splits": {"train": 0.4, "val": 0.1, "test": 0.5},
}  # fmt: skip


@pytest.fixture(scope="module")
def suite(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_dataset(config_from_mapping(CONFIG), tmp_path_factory.mktemp("plates") / "plates.zarr")


@pytest.fixture(scope="module")
def truth(suite: Path) -> SingleObjects:
    return read_single_objects(suite, read_manifest(suite), "test")


@pytest.fixture
def right(truth: SingleObjects) -> dict[str, Any]:
    """The labels as predictions."""
    return {"scene": truth.scenes, "places": truth.places, "classes": truth.classes, "heights": truth.heights}


def test_truth_is_what_was_drawn(suite: Path, truth: SingleObjects) -> None:
    data = dg.TransientDataset(suite, ("objects",), split="test")
    names = data.parameters("plate.class")
    assert truth.scenes.tolist() == data.scenes.tolist() and len(truth.scenes) == 10
    assert set(np.round(truth.heights, 5)) == {0.3, 0.6}
    for k, item in enumerate(data):  # type: ignore[arg-type]
        np.testing.assert_array_equal(truth.places[k], item["object_box_center"][0, [0, 2]])
        assert truth.sigma[k] == item["object_significance"][0]
        assert data.classes[truth.classes[k]] == names[k]
    assert 0 < truth.evident.sum() < len(truth.evident)


def test_labels_themselves_are_perfect(suite: Path, right: dict[str, Any]) -> None:
    scores = dg.score(suite, right | {"suite": "plates"})
    for values in (scores.all, scores.with_evidence):
        assert values == {name: float(name.endswith("right")) for name in TITLES}
    assert (scores.dataset, scores.published, scores.split, scores.scenes) == ("plates", False, "test", 10)


def test_what_is_wrong_is_the_score(suite: Path, truth: SingleObjects, right: dict[str, Any]) -> None:
    """Where the object has evidence 3 and 4 cm along both axes; else 0.6 and 0.8 m, and another class and height."""
    evident = truth.evident
    off = np.where(evident[:, None], [0.03, -0.04], [0.6, 0.8])
    wrong = right | {
        "places": truth.places + off,
        "classes": np.where(evident, truth.classes, (truth.classes + 1) % 11),
        "heights": truth.heights * np.where(evident, 1.24, 1.26),
    }
    scores = dg.score(suite, wrong)
    assert scores.with_evidence == pytest.approx(
        {"place_rms_m": 0.05, "place_median_m": 0.05, "place_p90_m": 0.05, "class_right": 1, "height_right": 1}
    )
    share = float(evident.mean())
    assert scores.all["class_right"] == scores.all["height_right"] == pytest.approx(share)
    assert scores.all["place_rms_m"] == pytest.approx(np.sqrt(share * 0.05**2 + (1 - share)))
    assert scores.scenes_with_evidence == evident.sum()


def test_what_was_not_predicted_is_left_out(suite: Path, truth: SingleObjects) -> None:
    scores = dg.score(suite, {"scene": truth.scenes, "classes": truth.classes})
    assert list(scores.all) == ["class_right"]
    nowhere = dg.score(suite, {"scene": truth.scenes, "places": np.full((10, 2), np.nan)})
    assert nowhere.all["place_median_m"] == pytest.approx(np.median(truth.span))


def test_files_and_tables(suite: Path, right: dict[str, Any], tmp_path: Path, capsys: Any) -> None:
    np.savez(tmp_path / "p.npz", **right)
    assert dg.score(suite, tmp_path / "p.npz") == dg.score(suite, right)
    assert run(["score", str(suite), str(tmp_path / "p.npz")]) == 0
    table = capsys.readouterr().out
    assert "split test: 10 scenes, in " in table and "of them the object has 3 σ" in table
    assert all(title in table for title in TITLES.values())


@pytest.mark.parametrize(
    ("change", "piece"),
    [
        ({"places": np.zeros((10, 3))}, "places has the shape (10, 3); must be (10, 2)"),
        ({"places": np.array([[0, np.nan]] * 10)}, "places has rows that are neither two finite numbers nor two NaN"),
        ({"places": np.full((10, 2), 900.0)}, "metres are needed"),
        ({"classes": np.full(10, 11)}, "classes = 11, in scene "),
        ({"classes": np.full(10, 0.5)}, "must be the number of a class, 0 … 10"),
        ({"classes": np.full(10, -1)}, "classes = -1, in scene "),
        ({"classes": np.array(["letter_a"] * 10)}, "must be numbers"),
        ({"heights": np.full(10, -0.3)}, "must be ≥ 0 (m; 0: empty)"),
        ({"heights": np.full(10, np.nan)}, "heights has values that are not finite"),
        ({"place": 0}, "unknown array 'place'; did you mean 'places'?"),
        ({"depth": np.zeros((10, 8, 8))}, "unknown array 'depth'; known are scene, places, classes, heights, suite"),
        ({"places": None, "classes": None, "heights": None}, "holds nothing beside `scene`; give any of places, "),
        ({"suite": "letters-1"}, "predicts 'letters-1', not 'plates'"),
    ],
)
def test_wrong_predictions_are_refused_in_a_line(
    suite: Path, right: dict[str, Any], change: dict[str, Any], piece: str, tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:  # fmt: skip
    values = {name: np.asarray(of) for name, of in (right | change).items() if of is not None}
    assert_predictions_are_refused(suite, values, tmp_path, piece, capsys)


def test_images_of_depth_and_several_objects_are_scored_otherwise(tmp_path: Path, suite: Path) -> None:
    assert has_single_objects(read_manifest(suite))
    assert not has_single_objects(read_manifest(made_suite(tmp_path / "made.zarr", scenes=2)))
    several = {**CONFIG, "scenes": 2, "scene": {"layout": {"kind": "isolated_wall"}, "contents": [
        {"kind": "box", "count": 2, "width_m": 0.3, "depth_m": 0.3, "height_m": 0.3}]}}  # fmt: skip
    other = write_dataset(config_from_mapping(several), tmp_path / "several.zarr")
    with pytest.raises(dg.InputError, match=r"has no depth, part_id; build with store\.fields depth"):
        dg.score(other, {"scene": [0], "places": np.zeros((1, 2))}, "train")
