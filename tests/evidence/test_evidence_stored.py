"""Evidence in a built dataset: in its table, its fields and its card, and as a condition on scenes."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import datagen as dg
from datagen.config import config_from_mapping
from datagen.pipeline import simulate_sample
from datagen.store.info import info

pytestmark = pytest.mark.usefixtures("builds_here")


def config() -> dg.DatasetConfig:
    return config_from_mapping(
        {
            "seed": 4,
            "scenes": 6,
            "scene": {
                "layout": {"kind": "isolated_wall"},
                "contents": [{"kind": "box", "count": {"choice": [0, 1, 2]}, "albedo": {"uniform": [0.05, 0.9]}}],
            },
            "capture": {"scan": {"rows": 2, "columns": 2}, "time": {"bins": 64, "bin_width_ps": 800}},
            "transport": {"target": 0.2},
            "detector": {"cycles": 20000, "ambient_rate_hz": 1.0e6},
            "labels": {"rows": 6, "columns": 8},
            "store": {"fields": ["histogram", "depth", "objects", "evidence"], "scenes_per_shard": 2},
        }
    )


@pytest.fixture(scope="module")
def built(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("evidence") / "set.zarr"
    dg.build(config(), path, workers=1, progress=False)
    return path


def test_table_and_fields_say_the_same(built: Path) -> None:
    data = dg.TransientDataset(built, fields=("objects", "evidence"))
    weakest = data.parameters("evidence.weakest")
    for index in range(len(data)):
        item, sample = data[index], simulate_sample(config(), index)
        count = int(item["object_count"])
        found = item["object_significance"].numpy()
        assert (found[:count] > 0).all() and not found[count:].any()
        for row, name in enumerate(("box", "box_2")[:count]):
            for quantity in ("detections", "brightest_bin", "significance"):
                stored = item[f"object_{quantity}"].numpy()[row]
                assert np.isclose(stored, sample.parameters[f"evidence.{name}.{quantity}"], rtol=1e-6)
        assert np.isnan(weakest[index]) if count == 0 else np.isclose(weakest[index], found[:count].min(), rtol=1e-6)
        assert np.array_equal(item["evidence"].numpy(), sample.arrays["evidence"])
        assert (item["evidence"].numpy() >= 0).all()


def test_scenes_with_too_little_evidence_are_left_out(built: Path) -> None:
    every = dg.TransientDataset(built, fields=("histogram",))
    weakest = np.asarray(every.parameters("evidence.weakest"), np.float64)
    limit = float(np.nanmedian(weakest))
    kept = dg.TransientDataset(built, fields=("histogram",), evidence_at_least=limit)
    assert kept.scenes.tolist() == [k for k, found in enumerate(weakest) if not found < limit]
    assert 0 < len(kept) < len(every) == 6
    # A scene without objects has no label without evidence.
    alone = dg.TransientDataset(built, fields=("histogram",), evidence_at_least=2 * float(np.nanmax(weakest)))
    assert alone.scenes.tolist() == np.flatnonzero(np.isnan(weakest)).tolist()


def test_bad_conditions_are_refused(built: Path) -> None:
    for least in (-1.0, float("nan"), "3", [3]):
        with pytest.raises(dg.InputError, match=r"evidence_at_least = .*: must be a number in 0 … 1e\+09"):
            dg.TransientDataset(built, fields=("histogram",), evidence_at_least=least)  # type: ignore[arg-type]


def test_info_and_card_state_evidence_by_kind(built: Path) -> None:
    objects = int(np.sum([int(item["object_count"]) for item in dg.TransientDataset(built, fields=("objects",))]))
    for text in (info(built), (built / "README.md").read_text()):
        assert "box: " in text and f"σ in the median of {objects}, " in text
