"""The place of label images relative to the scan, which is stored with each sample and stated by `info` and the
card."""

from __future__ import annotations

from pathlib import Path

import pytest

import datagen as dg
from datagen.config import config_from_mapping
from datagen.labels.frame import ViewFrame
from datagen.records import Rectangle
from datagen.store.info import info

pytestmark = pytest.mark.usefixtures("builds_here")


@pytest.mark.parametrize(
    ("place", "says"), [("beside", "m beside the scan, middle to"), ("in_front", "lie over the")]
)
def test_datasets_say_where_their_labels_lie(tmp_path: Path, place: str, says: str) -> None:
    config = config_from_mapping(
        {
            "scenes": 2,
            "scene": {"layout": {"kind": "isolated_wall", "place": place}, "contents": [{"kind": "box"}]},
            "capture": {"scan": {"rows": 3, "columns": 3}, "time": {"bins": 32, "bin_width_ps": 800}},
            "transport": {"lookins": 32, "fov_samples": 1},
        }
    )
    dg.build(config, tmp_path / "set", progress=False)
    line = next(line for line in info(tmp_path / "set").splitlines() if line.startswith("Label images"))
    assert says in line
    assert line in (tmp_path / "set/README.md").read_text()
    data = dg.TransientDataset(tmp_path / "set", ("laser_points", "hidden_view"))
    for k, item in enumerate(data):
        frame = ViewFrame.about(Rectangle(*item["hidden_view"].numpy().astype(float)))
        middle = frame.to_view(item["laser_points"].numpy().astype(float)).mean(axis=0)
        found = [data.parameters(f"labels.scan_{way}_m")[k] for way in ("right", "up")]
        assert found == pytest.approx(middle[:2], abs=1e-5)
