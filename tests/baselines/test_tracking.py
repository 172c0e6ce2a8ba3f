"""Baselines of sequences: a walker is found where the light says, and better than by the mean."""

from __future__ import annotations

import sys
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import pytest
import torch
from example_runs import run_example
from made_sequences import FRAMES, made_sequences
from made_suite import made_suite
from PIL import Image

import datagen as dg
from datagen.baselines import write_baseline
from datagen.baselines.plan_network import PlanNetwork, learnt_ways
from datagen.baselines.tracking import STEP_M, kalman_ways, place_and_spread
from datagen.baselines.walks import PLANS, VOXELS, Walks, floor_plans, read_walks
from datagen.cli import run
from datagen.records.arrays import Floats

pytestmark = pytest.mark.usefixtures("builds_here")

SCRIPT = Path(__file__).parents[2] / "examples" / "tracking_training.py"
LOW, HIGH = np.array([-2.0, 0.0]), np.array([2.0, 3.0])


def walks(count: int, seed: int, brightness: float = 12.0, frames: int = 6) -> Walks:
    """Straight walks at about 1 m/s, each a bright patch on plans of unit noise."""
    rng = np.random.default_rng(seed)
    start = rng.uniform(LOW + 0.8, HIGH - 0.8, (count, 1, 2))
    speed = rng.normal(0, 0.7, (count, 1, 2))
    places = start + speed * 0.1 * np.arange(frames)[:, None]
    right, depth = (low + (np.arange(32) + 0.5) / 32 * (high - low) for low, high in zip(LOW, HIGH, strict=True))
    apart = (right - places[..., 0, None, None]) ** 2 + (depth[:, None] - places[..., 1, None, None]) ** 2
    noise = rng.normal(size=(count, frames, len(PLANS), 32, 32))
    plans = noise + brightness * np.exp(-apart / (2 * 0.12**2))[:, :, None]
    centers = np.insert(places, 1, -0.4, axis=2)
    velocities = np.insert(np.broadcast_to(speed, places.shape), 1, 0.0, axis=2)
    corners = (np.tile(of, (count, 1)) for of in (LOW, HIGH))
    return Walks(
        Path(), np.arange(count), plans.astype(np.float32), *corners, centers, velocities, np.ones(count), 0.1
    )


def off(found: Floats, true: Floats) -> float:
    """The median distance, metres, or difference, metres a second."""
    return float(np.median(np.linalg.norm(found - true[..., [0, 2]], axis=-1)))


def test_places_and_shares_are_inverse() -> None:
    of = walks(3, 1)
    np.testing.assert_allclose(of.metres(of.shares), of.centers[..., [0, 2]])
    corner = of.metres(np.zeros((3, 1, 2)))
    np.testing.assert_allclose(corner[:, 0], of.low)


def test_plans_of_noise_have_its_size() -> None:
    """Of independent voxels."""
    volumes = np.random.default_rng(2).normal(size=(40, *VOXELS)).astype(np.float32)
    plans = floor_plans(volumes)
    assert plans.shape == (40, len(PLANS), VOXELS[0], VOXELS[2])
    assert plans.std(axis=(0, 2, 3)) == pytest.approx(1, abs=0.01)
    volumes[:, :, : VOXELS[1] // 2] += 1
    means = floor_plans(volumes).mean(axis=(0, 2, 3))
    assert means[PLANS.index("upper")] > 2 and abs(means[PLANS.index("lower")]) < 0.05


def test_a_likelihood_is_measured_by_its_moments() -> None:
    """A Gaussian's logarithm gives its mean and covariance."""
    right, depth = ((np.arange(n) + 0.5) / n for n in (80, 60))
    mean, width = np.array([0.3, 1.2]), np.array([0.25, 0.4])
    x, y = LOW[0] + right * 4 - mean[0], depth[:, None] * 3 - mean[1]
    log = -0.5 * ((x / width[0]) ** 2 + (y / width[1]) ** 2)
    place, covariance = place_and_spread(log[None] / 2.0, LOW, HIGH, sharpness=2.0)
    np.testing.assert_allclose(place[0], mean, atol=0.01)
    np.testing.assert_allclose(covariance[0], np.diag(width**2 + STEP_M**2), atol=0.01)
    # Without any light all places are as likely.
    flat, wide = place_and_spread(np.zeros((1, 60, 80)), LOW, HIGH, sharpness=4.0)
    np.testing.assert_allclose(flat[0], (LOW + HIGH) / 2, atol=1e-9)
    np.testing.assert_allclose(np.diag(wide[0]), (HIGH - LOW) ** 2 / 12, rtol=0.02)


def test_the_filter_follows_a_patch_and_its_speed() -> None:
    train, test = walks(20, 1), walks(30, 2)
    places, velocities = kalman_ways(train, test)
    blind = np.broadcast_to(train.centers[..., [0, 2]].mean(axis=(0, 1)), places.shape)
    assert off(places, test.centers) < 0.06 < 0.1 * off(blind, test.centers)
    assert off(velocities, test.velocities) < 0.5 * off(np.zeros_like(velocities), test.velocities)
    # Of noise alone nothing is learnt, and what is found stays near the mean.
    dark = walks(30, 2, brightness=0.0)
    lost, _ = kalman_ways(walks(20, 1, brightness=0.0), dark)
    assert off(lost, dark.centers) < 1.5 * off(blind, dark.centers)


def test_the_network_learns_a_patch() -> None:
    train, test = walks(48, 1, frames=3), walks(16, 2, frames=3)
    places, velocities = learnt_ways(train, test, seed=0, epochs=6)
    blind = np.broadcast_to(train.centers[..., [0, 2]].mean(axis=(0, 1)), places.shape)
    assert off(places, test.centers) < 0.4 * off(blind, test.centers)
    assert velocities.shape == places.shape


def test_a_network_sees_the_frames_of_its_sequence_and_no_other() -> None:
    of = walks(2, 3)
    single = of.apart
    assert single.plans.shape == (12, 1, len(PLANS), 32, 32)
    np.testing.assert_array_equal(single.plans[7, 0], of.plans[1, 1])
    np.testing.assert_array_equal(single.metres(single.shares)[:, 0], of.metres(of.shares).reshape(12, 2))
    plans = of.plans.copy()
    plans[0, 3] += 1
    other = replace(of, plans=plans)
    torch.manual_seed(0)
    model = PlanNetwork()
    for same, pair in (([False] * 6, (of, other)), ([True] * 3 + [False] + [True] * 2, (single, other.apart))):
        with torch.no_grad():
            places = [model(torch.from_numpy(walk.plans).transpose(1, 2))[0].reshape(2, 6, 2) for walk in pair]
        equal = (places[0] == places[1]).all(dim=-1)
        assert equal[0].tolist() == same and equal[1].all()


@pytest.fixture(scope="module")
def suite(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return made_sequences(
        tmp_path_factory.mktemp("walks") / "walks.zarr", scenes=20, walkers=1, side=8, photons=1e11, cycles=20_000
    )


def test_walks_are_those_of_the_dataset(suite: Path) -> None:
    found = read_walks(suite, "test")
    data = dg.TransientDataset(suite, ("objects", "hidden_bounds"), split="test")
    assert found.scene.tolist() == data.scenes.tolist() and found.step_s == 0.2
    assert found.plans.shape == (len(data), FRAMES, len(PLANS), VOXELS[0], VOXELS[2])
    moved = np.diff(found.centers, axis=1) / found.step_s
    assert np.median(np.linalg.norm(moved - found.velocities[:, 1:], axis=-1)) < 0.2
    assert ((found.shares > 0) & (found.shares < 1)).all()


def test_the_command_writes_what_is_scored(
    suite: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("datagen.baselines.plan_network.learnt_ways", partial(learnt_ways, epochs=2))
    median = {}
    for method in ("mean", "tracking", "network"):
        out = tmp_path / f"{method}.npz"
        assert run(["baseline", method, str(suite), str(out)]) == 0
        assert capsys.readouterr().out == f"{out}\n"
        scores = dg.score(suite, out)
        assert len(scores.all) == 5 and np.isfinite(list(scores.all.values())).all()
        median[method] = scores.all["center_median_m"]
    # Changes of many σ.
    assert scores.scenes_with_evidence == scores.scenes and median["tracking"] < 0.6 * median["mean"]


def test_the_example_prints_scores_and_draws(
    suite: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Its figures are those of `datagen score`."""
    run_example(SCRIPT, tmp_path / "picture.png", "--dataset", suite, "--epochs", 2)
    lines = capsys.readouterr().out.splitlines()
    rows = {cells[1].strip(): cells[2:5] for line in lines if len(cells := line.split("|")) > 5}
    for name, method in (("always the mean", "mean"), ("Kalman filter", "tracking")):
        write_baseline(method, suite, tmp_path / "p.npz")
        scores = dg.score(suite, tmp_path / "p.npz").all
        due = [f"{scores[of]:.2f}" for of in ("center_median_m", "center_p90_m")]
        assert [cell.strip() for cell in rows[name]] == [*due, f"{scores['center_within_25_cm']:.0%}"]
    assert {"network", "network, single frames"} <= rows.keys()
    with Image.open(tmp_path / "picture.png") as picture:
        assert picture.width == 880


def test_what_does_not_fit_is_one_line(
    suite: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    still = made_suite(tmp_path / "still.zarr", scenes=4)
    several = made_sequences(tmp_path / "several.zarr", scenes=4)
    monkeypatch.setitem(sys.modules, "filterpy.kalman", None)
    for method, dataset, piece in (
        ("backprojection", suite, "holds sequences; must be one of mean, tracking, network"),
        ("tracking", still, "holds single scenes; must be one of mean, backprojection, network"),
        ("guess", suite, "METHOD = 'guess': must be one of mean, backprojection, network, tracking"),
        ("mean", several, "2 objects move in scene"),
        ("tracking", suite, "filterpy's, which is not installed; pip install 'nlos-datagen[tracking]'"),
    ):
        assert run(["baseline", method, str(dataset), str(tmp_path / "x.npz")]) == 2
        err = capsys.readouterr().err
        assert piece in err and err.count("\n") == 1, err
