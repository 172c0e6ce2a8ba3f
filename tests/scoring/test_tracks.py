"""Scores of sequences: laws of the metrics, and every error that predictions of tracks can have."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from made_sequences import FRAMES, made_sequences
from refused_predictions import assert_predictions_are_refused

import datagen as dg
from datagen.cli import run
from datagen.scoring.tracks import TITLES, Tracks, matched, read_tracks
from datagen.store import read_manifest

pytestmark = pytest.mark.usefixtures("builds_here")


@pytest.fixture(scope="module")
def suite(tmp_path_factory: pytest.TempPathFactory) -> Path:
    dark_and_light = {"log_uniform": [1e-4, 0.9]}
    return made_sequences(tmp_path_factory.mktemp("tracks") / "walks.zarr", albedo=dark_and_light)


@pytest.fixture(scope="module")
def truth(suite: Path) -> Tracks:
    return read_tracks(suite, read_manifest(suite), "test")


@pytest.fixture
def right(truth: Tracks) -> dict[str, Any]:
    """The labels as predictions."""
    return {"scene": truth.scenes, "centers": truth.centers, "velocities": truth.velocities}


def test_truth_is_what_moves(suite: Path, truth: Tracks) -> None:
    data = dg.TransientDataset(suite, ("objects",), split="test")
    assert truth.scenes.tolist() == data.scenes.tolist() and len(truth.scenes) == 4
    for k, item in enumerate(data):  # type: ignore[arg-type]
        speed = np.linalg.norm(item["object_velocity"].numpy(), axis=-1)
        walks = speed.any(axis=0)
        assert walks.sum() == 2 and not walks[item["object_part"].numpy() < 0].any()
        np.testing.assert_array_equal(truth.centers[k][:, truth.moves[k]], item["object_box_center"][:, walks])
        np.testing.assert_allclose(np.linalg.norm(truth.velocities[k][:, truth.moves[k]], axis=-1), speed[:, walks])
        median = np.median(item["object_change"][1:, walks], axis=0)
        np.testing.assert_allclose(truth.sigma[k][truth.moves[k]], median)
    # Both kinds are there, or nothing below tells them apart.
    assert 0 < truth.evident.sum() < truth.moves.sum()


def test_labels_themselves_are_perfect(suite: Path, right: dict[str, Any]) -> None:
    scores = dg.score(suite, right | {"suite": "walks"})
    for values in (scores.all, scores.with_evidence):
        assert values == {name: float(name == "center_within_25_cm") for name in TITLES}
    assert (scores.dataset, scores.published, scores.split, scores.scenes) == ("walks", False, "test", 4)


def test_a_shift_is_the_score(suite: Path, truth: Tracks, right: dict[str, Any]) -> None:
    """By 0.2 m where the change has evidence, by 0.6 m elsewhere, the velocities by 0.3 and 0.5 m/s."""
    evident = truth.evident[:, None, :, None]
    shift = np.where(evident, [0.0, 0.0, 0.2], [0.6, 0.0, 0.0])
    faster = np.where(evident, [0.0, 0.3, 0.0], [0.0, 0.5, 0.0])
    moved = {"centers": truth.centers + shift, "velocities": truth.velocities + faster}
    scores = dg.score(suite, right | moved)
    assert scores.with_evidence == pytest.approx(
        {"center_median_m": 0.2, "center_p90_m": 0.2, "center_within_25_cm": 1, "velocity_median_m_s": 0.3,
         "velocity_p90_m_s": 0.3}
    )  # fmt: skip
    assert scores.all["center_within_25_cm"] == pytest.approx(truth.evident.sum() / truth.moves.sum())
    assert scores.all["center_p90_m"] == pytest.approx(0.6) and scores.all["velocity_p90_m_s"] == pytest.approx(0.5)
    # The same distance in another direction is the same score; without velocities theirs are left out.
    other = dg.score(suite, {"scene": truth.scenes, "centers": truth.centers + shift[..., [1, 2, 0]]})
    assert other.all == pytest.approx({name: of for name, of in scores.all.items() if name.startswith("center")})


def test_quantiles_are_those_of_all_frames(suite: Path, truth: Tracks, right: dict[str, Any]) -> None:
    rng = np.random.default_rng(1)
    off = rng.exponential(0.1, truth.centers.shape[:3])
    shifted = truth.centers + off[..., None] * [0.0, 1.0, 0.0]
    scores = dg.score(suite, right | {"centers": shifted})
    of_objects = off.transpose(0, 2, 1)[truth.moves]
    assert scores.all["center_median_m"] == pytest.approx(np.median(of_objects), rel=1e-5)
    assert scores.all["center_p90_m"] == pytest.approx(np.quantile(of_objects, 0.9), rel=1e-5)
    assert scores.all["center_within_25_cm"] == pytest.approx((of_objects <= 0.25).mean())


def test_the_order_of_tracks_does_not_matter_and_that_of_frames_does(
    suite: Path, truth: Tracks, right: dict[str, Any]
) -> None:
    turned = {name: of[:, :, ::-1] if name != "scene" else of for name, of in right.items()}
    assert dg.score(suite, turned) == dg.score(suite, right)
    # A track that changes to the other object in the middle has both of them wrong in some frames.
    exchanged = truth.centers.copy()
    for centers, moves in zip(exchanged, truth.moves, strict=True):
        first, second = np.flatnonzero(moves)
        centers[3:, [first, second]] = centers[3:, [second, first]]
    scores = dg.score(suite, right | {"centers": exchanged})
    assert scores.all["center_within_25_cm"] <= 3 / FRAMES
    backward = dg.score(suite, right | {"centers": truth.centers[:, ::-1], "velocities": -truth.velocities})
    assert backward.all["center_median_m"] > 0.1 and backward.all["velocity_median_m_s"] == pytest.approx(2, rel=0.01)


def test_what_is_missing_counts_the_diagonal_and_as_standing(suite: Path, truth: Tracks) -> None:
    nothing = np.full((4, FRAMES, 1, 3), np.nan)
    scores = dg.score(suite, {"scene": truth.scenes, "centers": nothing, "velocities": nothing})
    assert scores.all["center_median_m"] == pytest.approx(np.median(truth.span))
    assert scores.all["velocity_median_m_s"] == pytest.approx(1.0, rel=1e-4)
    # One track for two objects: the other one is missing in every frame.
    one = np.stack([centers[:, moves][:, :1] for centers, moves in zip(truth.centers, truth.moves, strict=True)])
    assert dg.score(suite, {"scene": truth.scenes, "centers": one}).all["center_within_25_cm"] == 0.5


def test_tracks_are_matched_for_the_least_sum() -> None:
    true = np.array([[[0.0, 0, 0], [1.0, 0, 0]], [[0.0, 0, 0], [2.0, 0, 0]]])
    found = np.array([[[1.0, 0, 0], [5.0, 5, 5], [np.nan] * 3], [[2.5, 0, 0], [5.0, 5, 5], [0.1, 0, 0]]])
    distances, match = matched(found, true, 4.0)
    # The third track is missing in the first frame, where it counts 4 m, less than the second is off.
    assert match.tolist() == [2, 0]
    np.testing.assert_allclose(distances, [[4.0, 0.0], [0.1, 0.5]])
    _, none = matched(found[:, :1], true, 4.0)
    assert none.tolist() == [-1, 0]


def test_files_and_tables(suite: Path, right: dict[str, Any], tmp_path: Path, capsys: Any) -> None:
    np.savez(tmp_path / "p.npz", **right)
    assert dg.score(suite, tmp_path / "p.npz") == dg.score(suite, right)
    assert run(["score", str(suite), str(tmp_path / "p.npz"), "--json"]) == 0
    values = json.loads(capsys.readouterr().out)
    assert values["all"]["center_within_25_cm"] == 1 and set(values["all"]) == set(TITLES)
    assert run(["score", str(suite), str(tmp_path / "p.npz")]) == 0
    table = capsys.readouterr().out
    assert "split test: 4 scenes, in " in table and "of them each frame changes by 3 σ" in table
    assert table.count("\n") == 3 + len(TITLES)


@pytest.mark.parametrize(
    ("change", "piece"),
    [
        ({"centers": np.zeros((4, FRAMES + 1, 1, 3))}, f"must be (4, {FRAMES}, any number, 3)"),
        ({"centers": np.zeros((4, 2, 3))}, f"has the shape (4, 2, 3); must be (4, {FRAMES}, any number, 3)"),
        ({"centers": np.zeros((4, FRAMES, 1, 2))}, f"must be (4, {FRAMES}, any number, 3)"),
        ({"velocities": np.zeros((4, FRAMES, 9, 3))}, "velocities of 9 tracks and centers of"),
        ({"velocities": np.zeros((4, FRAMES - 1, 2, 3))}, f"velocities has the shape (4, {FRAMES - 1}, 2, 3)"),
        ({"centers": None}, "`velocities` are those of the tracks in `centers`, which are missing"),
        ({"centers": None, "velocities": None}, "holds nothing beside `scene`; give any of centers, velocities"),
        ({"centers": np.full((4, FRAMES, 1, 3), np.inf)}, "centers has rows that are neither"),
        ({"centers": np.full((4, FRAMES, 2, 3), 900.0)}, "metres are needed"),
        ({"velocities": np.full((4, FRAMES, 2, 3), 900.0)}, "metres a second are needed"),
        ({"velocity": 0}, "unknown array 'velocity'; did you mean 'velocities'? Known are scene, centers"),
        ({"depth": np.zeros((4, 8, 8))}, "unknown array 'depth'; known are scene, centers, velocities, suite"),
        ({"suite": "tracking-1"}, "predicts 'tracking-1', not 'walks'"),
        ({"scene": [0, 0, 1, 2]}, "scene 0 is there more than once"),
    ],
)
def test_wrong_predictions_are_refused_in_a_line(
    suite: Path, right: dict[str, Any], change: dict[str, Any], piece: str, tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:  # fmt: skip
    values = {name: np.asarray(of) for name, of in (right | change).items() if of is not None}
    assert_predictions_are_refused(suite, values, tmp_path, piece, capsys)


def test_a_dataset_without_labels_or_walkers_is_refused(tmp_path: Path, suite: Path) -> None:
    nothing = {"scene": [0], "centers": np.zeros((1, FRAMES, 1, 3))}
    stands = made_sequences(tmp_path / "stands.zarr", scenes=2, walkers=0)
    with pytest.raises(dg.InputError, match=r"split = 'train': nothing moves in .*, and only what moves is scored"):
        dg.score(stands, nothing, "train")
    with pytest.raises(dg.InputError, match=r"split = 'exam': .* has test, train"):
        dg.score(suite, nothing, "exam")
