"""Scores of predictions for a small dataset, and every error that predictions can have."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import zarr
from made_suite import COLUMNS, ROWS, VOXELS, made_suite
from refused_predictions import assert_predictions_are_refused

import datagen as dg
from datagen.cli import run
from datagen.labels.frame import image_points
from datagen.scoring.metrics import chamfer_distance, ssim
from datagen.scoring.truth import Truth, read_truth
from datagen.store import read_manifest

pytestmark = pytest.mark.usefixtures("builds_here")

PERFECT = {"depth_rmse_m": 0, "depth_mae_m": 0, "silhouette_iou": 1, "ssim": 1, "chamfer_m": 0,
           "occupancy_iou": 1, "center_m": 0}  # fmt: skip


@pytest.fixture(scope="module")
def suite(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return made_suite(tmp_path_factory.mktemp("scores") / "made.zarr")


@pytest.fixture(scope="module")
def truth(suite: Path) -> Truth:
    return read_truth(suite, read_manifest(suite), "test")


@pytest.fixture
def right(truth: Truth) -> dict[str, Any]:
    """The labels as predictions."""
    assert truth.occupancy is not None
    return {"scene": truth.scenes, "depth": truth.depth, "mask": truth.on_object, "occupancy": truth.occupancy,
            "centers": truth.centers}  # fmt: skip


def test_truth_is_that_of_the_dataset(suite: Path, truth: Truth) -> None:
    data = dg.TransientDataset(suite, ("part_id", "objects"), split="test")
    assert truth.scenes.tolist() == data.scenes.tolist() and len(truth.scenes) == 4
    for k, item in enumerate(data):  # type: ignore[arg-type]
        for row in range(2):
            assert ((truth.shows[k] == row) == (item["part_id"] == item["object_part"][row]).numpy()).all()
        assert np.allclose(truth.sigma[k], item["object_significance"])
    # Both kinds are there, or nothing below tells them apart.
    assert 0 < truth.evident.sum() < truth.evident.size
    assert 0 < truth.on_evident.sum() < truth.on_object.sum()


def test_labels_themselves_are_perfect(suite: Path, right: dict[str, Any]) -> None:
    scores = dg.score(suite, right | {"suite": "made"})
    assert scores.all == pytest.approx(PERFECT, abs=1e-6)
    assert {name: of for name, of in scores.with_evidence.items() if not math.isnan(of)}.items() <= {
        name: pytest.approx(of, abs=1e-6) for name, of in PERFECT.items()
    }.items()
    assert (scores.dataset, scores.published, scores.split, scores.scenes) == ("made", False, "test", 4)


def test_depth_errors_are_those_of_the_predictions(suite: Path, truth: Truth, right: dict[str, Any]) -> None:
    """0.3 m on objects with evidence, 0.1 m on the others, anything elsewhere."""
    off = np.where(truth.on_evident, 0.3, np.where(truth.on_object, 0.1, 7.0))
    scores = dg.score(suite, right | {"depth": truth.depth + off})
    n, m = truth.on_evident.sum(), truth.on_object.sum()
    assert scores.with_evidence["depth_rmse_m"] == pytest.approx(0.3, rel=1e-5)
    assert scores.all["depth_mae_m"] == pytest.approx((0.3 * n + 0.1 * (m - n)) / m, rel=1e-5)
    assert scores.all["depth_rmse_m"] == pytest.approx(math.sqrt((0.09 * n + 0.01 * (m - n)) / m), rel=1e-5)
    assert scores.all["silhouette_iou"] == 1


def test_images_and_points_by_scene(suite: Path, truth: Truth, right: dict[str, Any]) -> None:
    """Depth half a metre too far, without a mask: it shows an object wherever it is more than 0."""
    depth = np.where(truth.on_object, truth.depth + 0.5, 0)
    scores = dg.score(suite, {"scene": truth.scenes, "depth": depth})
    seen = [k for k in range(4) if truth.on_object[k].any()]
    points = [image_points(truth.depth[k], truth.on_object[k], *truth.view[k]) for k in range(4)]
    there = np.mean([chamfer_distance(points[k] + [0, 0, 0.5], points[k]) for k in seen])
    like = np.mean([
        ssim(depth[k] / truth.reach[k], np.where(truth.on_object[k], truth.depth[k], 0) / truth.reach[k])
        for k in range(4)
    ])  # fmt: skip
    assert scores.all["chamfer_m"] == pytest.approx(there) and scores.all["silhouette_iou"] == 1
    assert scores.all["ssim"] == pytest.approx(like) and like < 0.999
    # Points given are taken instead, whatever depth says; rows of NaN are fill.
    cloud = np.full((4, max(map(len, points)) + 2, 3), np.nan)
    for row, of in zip(cloud, points, strict=True):
        row[1 : len(of) + 1] = of
    assert dg.score(suite, {"scene": truth.scenes, "points": cloud}).all == pytest.approx({"chamfer_m": 0}, abs=1e-9)
    assert "occupancy_iou" not in scores.all and "center_m" not in scores.all


def test_a_missed_object_counts_the_diagonal_of_the_hidden_part(suite: Path, truth: Truth) -> None:
    nothing = {"scene": truth.scenes, "depth": truth.depth, "mask": np.zeros(truth.depth.shape, bool)}
    scores = dg.score(suite, nothing | {"centers": np.full((4, 1, 3), np.nan)})
    seen = truth.on_object.any(axis=(1, 2))
    assert scores.all["chamfer_m"] == pytest.approx(truth.span[seen].mean())
    assert scores.all["center_m"] == pytest.approx(truth.span.mean())
    sizes = np.linalg.norm(
        np.diff(dg.TransientDataset(suite, "hidden_bounds", split="test")[0]["hidden_bounds"], axis=0)
    )
    assert truth.span[0] == pytest.approx(sizes)
    assert scores.all["silhouette_iou"] == 0


def test_centres_of_objects_with_evidence(suite: Path, truth: Truth) -> None:
    """The other centres are 1 m too high. The order of centres does not matter."""
    off = np.where(truth.evident[..., None], [0, 0, 0], [0, 1.0, 0])
    found = (truth.centers + off)[:, ::-1]
    assert dg.score(suite, {"scene": truth.scenes, "centers": found}).with_evidence["center_m"] < 0.5
    apart = truth.centers + np.where(truth.evident[..., None], 0, 1e-3)
    scores = dg.score(suite, {"scene": truth.scenes, "centers": apart})
    assert scores.with_evidence["center_m"] == pytest.approx(0, abs=1e-9)
    assert scores.all["center_m"] == pytest.approx(1e-3 * math.sqrt(3) * (~truth.evident).mean())


def test_files_and_groups_are_read_alike(
    suite: Path, right: dict[str, Any], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Rows in any order, with scenes of other splits among them."""
    extra = {name: np.concatenate([np.asarray(of), np.asarray(of)[:1]])[::-1] for name, of in right.items()}
    extra["scene"][0] = next(k for k in range(10) if k not in right["scene"])
    extra["depth"][0] = np.nan
    np.savez(tmp_path / "p.npz", **extra)
    group = zarr.create_group(tmp_path / "p.zarr")
    for name, of in extra.items():
        group.create_array(name, data=np.ascontiguousarray(of))
    assert dg.score(suite, tmp_path / "p.npz") == dg.score(suite, tmp_path / "p.zarr") == dg.score(suite, right)
    assert run(["score", str(suite), str(tmp_path / "p.npz"), "--json"]) == 0
    values = json.loads(capsys.readouterr().out)
    assert values["all"]["silhouette_iou"] == 1 and values["scenes"] == 4 and set(values["all"]) == set(PERFECT)
    assert run(["score", str(suite), str(tmp_path / "p.npz")]) == 0
    table = capsys.readouterr().out
    assert "made (not one of the published suites), split test: 4 scenes" in table
    assert table.count("\n") == 3 + len(PERFECT)


@pytest.mark.parametrize(
    ("change", "piece"),
    [
        ({"scene": None}, "has no `scene`"),
        ({"depht": 0}, "unknown array 'depht'; did you mean 'depth'? Known are scene, depth"),
        ({"depth": None, "mask": None, "occupancy": None, "centers": None}, "holds nothing beside `scene`"),
        ({"depth": None}, "there is no `depth`; give both"),
        ({"scene": [[0]]}, "must be whole numbers of shape (N,)"),
        ({"scene": [0.0, 1.0]}, "scene is float64 (2,); must be whole numbers"),
        ({"scene": [0, 0, 1, 2]}, "scene 0 is there more than once"),
        ({"scene": [0, 1, 2, 10]}, "scene 10 is none of the dataset's 0 … 9"),
        ({"scene": [-1, 1, 2, 3]}, "scene -1 is none"),
        ({"scene": "short"}, "1 of 4 scenes are missing, the first is"),
        ({"depth": np.zeros((4, ROWS, COLUMNS + 1))}, f"must be (4, {ROWS}, {COLUMNS})"),
        ({"depth": np.zeros((3, ROWS, COLUMNS))}, f"has the shape (3, {ROWS}, {COLUMNS}); must be (4, "),
        ({"occupancy": np.zeros((4, *VOXELS[:2]))}, f"must be (4, {', '.join(map(str, VOXELS))})"),
        ({"centers": np.zeros((4, 3))}, "has the shape (4, 3); must be (4, any number, 3)"),
        ({"depth": np.full((4, ROWS, COLUMNS), "a")}, "depth is <U1; must be numbers"),
        ({"depth": np.full((4, ROWS, COLUMNS), np.nan)}, "depth has values that are not finite, in scene"),
        ({"occupancy": np.full((4, *VOXELS), np.inf)}, "occupancy has values that are not finite"),
        ({"depth": np.full((4, ROWS, COLUMNS), -1.0)}, "depth = -1, in scene"),
        ({"mask": np.full((4, ROWS, COLUMNS), 1.5)}, "mask = 1.5, in scene"),
        ({"points": np.array([[[0, 0, np.nan]]] * 4)}, "points has rows that are neither three finite"),
        ({"centers": np.full((4, 1, 3), np.inf)}, "centers has rows that are neither"),
        ({"depth": np.full((4, ROWS, COLUMNS), 900.0)}, "metres are needed"),
        ({"centers": np.full((4, 1, 3), 900.0)}, "metres are needed"),
        ({"suite": "letters-1"}, "predicts 'letters-1', not 'made'"),
    ],
)
def test_wrong_predictions_are_refused_in_a_line(
    suite: Path, right: dict[str, Any], change: dict[str, Any], piece: str, tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:  # fmt: skip
    if change.get("scene") == "short":
        change = {name: np.asarray(of)[:3] for name, of in right.items()}
    values = {name: np.asarray(of) for name, of in (right | change).items() if of is not None}
    assert_predictions_are_refused(suite, values, tmp_path, piece, capsys)


def test_wrong_types_are_refused(suite: Path) -> None:
    for call, name in (
        (lambda: dg.score(3, {}), "suite"),  # type: ignore[arg-type]
        (lambda: dg.score(suite, 3), "predictions"),  # type: ignore[arg-type]
        (lambda: dg.score(suite, {}, split=1), "split"),  # type: ignore[arg-type]
        (lambda: dg.build_suite(3, suite), "name"),  # type: ignore[arg-type]
    ):
        with pytest.raises(dg.InputError, match=rf"^{name} = (3|1): "):
            call()


def test_other_files_are_refused(suite: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "text.npz").write_text("depth")
    (tmp_path / "empty").mkdir()
    np.save(tmp_path / "one.npy", np.zeros(3))
    np.savez(tmp_path / "object.npz", scene=np.array([{}], dtype=object))
    for arguments, piece in (
        ([str(suite), "nowhere.npz"], "nowhere.npz: no such file"),
        ([str(suite), str(tmp_path / "text.npz")], "is no .npz file and no Zarr group"),
        ([str(suite), str(tmp_path / "empty")], "is no .npz file and no Zarr group"),
        ([str(suite), str(tmp_path / "one.npy")], "is no .npz file and no Zarr group"),
        ([str(suite), str(tmp_path / "object.npz")], "is no .npz file and no Zarr group"),
        ([str(suite), str(tmp_path / "one.npy"), "--split", "exam"], "--split exam: "),
        ([str(tmp_path), "p.npz"], "is no dataset"),
    ):
        assert run(["score", *arguments]) == 2
        err = capsys.readouterr().err
        assert piece in err and err.count("\n") == 1, err
