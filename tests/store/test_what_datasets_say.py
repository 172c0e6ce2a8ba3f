"""What builds, `info` and cards say of a dataset: its noise, whether its targets were met, where its labels lie."""

from __future__ import annotations

import json
import math
import re
from pathlib import Path
from typing import Any

import pytest

import datagen as dg
from datagen.building.build import build
from datagen.cli import run
from datagen.config import DatasetConfig, config_from_mapping
from datagen.errors import InputError
from datagen.labels.frame import ViewFrame
from datagen.records import Rectangle
from datagen.store.columns import Columns
from datagen.store.info import _accuracy, info

pytestmark = pytest.mark.usefixtures("builds_here")

NOISY = {"samples": 2}
CONFIG: dict[str, Any] = {
    "scenes": 3,
    "capture": {"scan": {"rows": 2, "columns": 2}, "time": {"bins": 64, "bin_width_ps": 400}},
}


def test_a_warning_states_the_noise_and_the_remedy(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    """Also of a quiet build, and of one that finds nothing left to build."""
    (tmp_path / "c.yaml").write_text(json.dumps(CONFIG | {"transport": NOISY}))
    assert run(["build", str(tmp_path / "c.yaml"), str(tmp_path / "set"), "--quiet"]) == 0
    out, line = capfd.readouterr()
    found = re.fullmatch(r"noise: .* is (\d+)% off in the median of 3 scenes .*samples \(2\).*\n", line)
    assert found and "noise" not in out
    errors = dg.TransientDataset(tmp_path / "set").parameters("transient.relative_error")
    assert round(100 * sorted(errors)[1]) == int(found[1]) > 20
    again = dg.build(config_from_mapping(CONFIG | {"transport": NOISY}), tmp_path / "set", progress=False)
    assert (again.built, again.noisy) == (0, line.strip())


@pytest.mark.parametrize("transport", [{"target": 0.1}, {"samples": 1}])
def test_no_warning_if_the_light_is_accurate_or_its_error_unknown(
    tmp_path: Path, capfd: pytest.CaptureFixture[str], transport: dict[str, Any]
) -> None:
    settings = config_from_mapping(CONFIG | {"transport": transport})
    assert dg.build(settings, tmp_path / "set", progress=False).noisy == ""
    assert "noise" not in capfd.readouterr().err


def test_errors_that_are_not_known_are_counted_and_spoil_no_number() -> None:
    """A scene in whose window no light was met has the claim NaN."""
    scene = {"transient.target_met": False, "transient.overflow": 1.0}
    for errors, words in (
        ((0.01, math.nan, 0.03), "median 0.0200, largest 0.0300, not known in 1"),
        ((math.nan, math.nan), "not known in any scene"),
        ((0.01, 0.03), "median 0.0200, largest 0.0300"),
    ):
        lines = _accuracy(Columns([scene | {"transient.relative_error": error} for error in errors]))
        assert lines[0] == f"relative error of the transients: {words}"
        assert f"window: in {len(errors)} of {len(errors)} scenes 90% of the light" in lines[1]


SMALL = {
    "name": "targeted",
    "scenes": 2,
    "capture": {
        "scan": {"rows": 2, "columns": 2, "width_m": 0.5, "height_m": 0.5},
        "time": {"bins": 32, "bin_width_ps": 2000, "start_ns": 20},
    },
    "labels": {"rows": 4, "columns": 4},
    "store": {"fields": ["histogram", "transient"]},
}


def configured(**transport: object) -> DatasetConfig:
    return config_from_mapping({**SMALL, "transport": transport})


def test_counts_beside_a_target_and_impossible_targets_are_refused() -> None:
    with pytest.raises(InputError, match=r"samples = 64: given together with target"):
        configured(target=0.1, samples=64)
    with pytest.raises(InputError, match=r"transport\.lookins: unknown key; .*samples"):
        configured(lookins=64)
    for value in (0.0, 2, -0.1, "fine"):
        with pytest.raises(InputError, match=r"transport\.target"):
            configured(target=value)


def test_a_target_reaches_the_simulation_and_the_fingerprint() -> None:
    config = configured(target=0.1, max_bounces=4)
    assert config.fingerprint() != configured(target=0.2, max_bounces=4).fingerprint()
    accuracy = config.transport.accuracy()
    assert (accuracy.target, accuracy.samples, accuracy.max_bounces) == (0.1, None, 4)


def test_a_dataset_says_whether_its_targets_were_met(tmp_path: Path) -> None:
    build(configured(target=0.3), tmp_path / "targeted", progress=False)
    assert "target met in 2 of 2 scenes" in info(tmp_path / "targeted")


@pytest.mark.parametrize(
    ("place", "says"), [("beside", "m beside the scan, middle to"), ("in_front", "lie over the")]
)
def test_datasets_say_where_their_labels_lie(tmp_path: Path, place: str, says: str) -> None:
    config = config_from_mapping(
        {
            "scenes": 2,
            "scene": {"layout": {"kind": "isolated_wall", "place": place}, "contents": [{"kind": "box"}]},
            "capture": {"scan": {"rows": 3, "columns": 3}, "time": {"bins": 32, "bin_width_ps": 800}},
            "transport": {"samples": 32},
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
