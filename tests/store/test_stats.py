"""Statistics of a dataset's fields, its description, and errors of items."""

from __future__ import annotations

import json
from dataclasses import astuple
from pathlib import Path

import numpy as np
import pytest
import zarr
from damage import reseal
from datasets import write_dataset
from fake_samples import build_fakes, fake_sample, sequence_config, small_config
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

import datagen as dg
from datagen.store import verify
from datagen.store.stats import QUANTITIES, FieldStats, pooled_stats, stats_of

pytestmark = pytest.mark.usefixtures("builds_here")

FIELDS = ["histogram", "transient", "depth", "normal", "occupancy", "sdf"]


@pytest.fixture(scope="module", params=[small_config, sequence_config], ids=["scenes", "sequences"])
def dataset(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Path:
    config = request.param(
        store={"fields": FIELDS, "scenes_per_shard": 4}, labels={"rows": 4, "columns": 5, "voxels": [2, 2, 2]}
    )
    return write_dataset(config, tmp_path_factory.mktemp("stats") / "set", fake_sample)


def plain(values: np.ndarray, name: str) -> list[float]:
    seen = np.log1p(values.astype(float)) if name == "histogram" else values.astype(float)
    return [float(seen.mean()), float(seen.std()), float((values != 0).mean())]


@settings(deadline=None, max_examples=40)
@given(arrays(np.uint16, (3, 2, 7)), arrays(np.float32, (3, 4), elements=st.floats(-1e4, 1e4, width=32)))
def test_statistics_are_mean_and_standard_deviation(counts: np.ndarray, label: np.ndarray) -> None:
    for name, values in (("histogram", counts), ("sdf", label), ("sdf", label * np.float32(1e15))):
        scenes = [stats_of(name, scene) for scene in values]
        scale = 1e-5 * max(1.0, float(np.abs(values.astype(float)).max()))
        for scene, of in zip(values, scenes, strict=True):
            assert np.allclose(astuple(of), plain(scene, name), rtol=1e-5, atol=scale)
        assert np.allclose(
            list(pooled_stats(*np.transpose([astuple(of) for of in scenes])).values()),
            plain(values, name),
            rtol=1e-5,
            atol=scale,
        )


def test_almost_equal_values_zeros_and_the_largest_counts_have_statistics() -> None:
    for value in (0.03, 1e-12, 3e7, 1e30):
        same = np.full(1000, value, np.float32)
        assert stats_of("sdf", same).std <= 1e-7 * value
        spread = same.astype(float) * np.linspace(0.999, 1.001, 1000)
        assert stats_of("sdf", spread).std == pytest.approx(spread.std(), rel=1e-6)
    assert stats_of("histogram", np.array([0, 4_000_000_000], np.uint32)).nonzero == 0.5
    assert stats_of("depth", np.zeros((2, 2), np.float32)) == FieldStats(0.0, 0.0, 0.0)


def test_statistics_are_those_of_a_split(dataset: Path) -> None:
    stored = {name: np.asarray(zarr.open_array(dataset / "data.zarr" / name, mode="r")[:]) for name in FIELDS}
    described = json.loads((dataset / "dataset.json").read_text())
    for split in (None, "train", "test"):
        data = dg.TransientDataset(dataset, ("histogram",), split=split)
        assert set(data.stats) == {*FIELDS} - {"transient"}
        for name, of in data.stats.items():
            assert np.allclose(
                [of[q] for q in QUANTITIES], plain(stored[name][data.scenes], name), rtol=1e-5, atol=1e-6
            )
        assert split is None or described["stats"][split] == data.stats
    assert data.parameters("stats.depth.mean")[0] == pytest.approx(stored["depth"][data.scenes[0]].mean(), abs=1e-5)
    assert "transient.relative_error" in described["samples"]["columns"]
    card = (dataset / "README.md").read_text()
    assert f"| `depth` | {described['stats']['train']['depth']['mean']:.6g} |" in card


def test_statistics_are_verified_and_kept(dataset: Path, tmp_path: Path) -> None:
    build_fakes(small_config(), tmp_path / "set")
    described = tmp_path / "set/dataset.json"
    content, when = described.read_bytes(), described.stat().st_mtime_ns
    build_fakes(small_config(), tmp_path / "set")
    assert (described.read_bytes(), described.stat().st_mtime_ns) == (content, when)
    reseal(described, lambda values: values["stats"]["train"]["depth"].update(mean=7.0))
    found = verify(tmp_path / "set").problems
    assert found[0] == "dataset.json: its stats differ from what the commit records say" and len(found) == 2
    build_fakes(small_config(), tmp_path / "set")
    assert described.read_bytes() == content and verify(tmp_path / "set").problems == ()
    build_fakes(small_config(), tmp_path / "set", scenes=24)
    assert described.read_bytes() != content and verify(tmp_path / "set").problems == ()


def test_a_dataset_says_what_it_is(dataset: Path) -> None:
    data = dg.TransientDataset(dataset, ("histogram", "depth"), split="train", redraw_noise=True)
    depth, counts = data.shape("depth"), data.shape("histogram")
    assert repr(data) == (
        f"TransientDataset('{dataset}': {len(data)} scenes of split 'train'; "
        f"histogram, drawn anew at every read {counts}, depth {depth})"
    )
    assert "\n" not in repr(data) and f"12 scenes; depth {depth}" in repr(dg.TransientDataset(dataset, ("depth",)))
