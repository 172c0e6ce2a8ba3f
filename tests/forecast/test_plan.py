"""The command `datagen plan` on a tiny configuration, and the time limit of a scene."""

from __future__ import annotations

import json
from pathlib import Path
from types import SimpleNamespace

import pytest
from datasets import write_dataset

from datagen.cli import run
from datagen.config import config_from_mapping, load_config
from datagen.errors import InputError
from datagen.forecast.text import AT_LEAST_S, PILOTS_WORTH, duration, scene_limit

CONFIG = """
name: tiny
scenes: 3
capture: {scan: {rows: 2, columns: 2}, time: {bins: 64, bin_width_ps: 800}}
transport: {lookins: 64, fov_samples: 1}
detector: {photons_per_pulse: 1000.0}
labels: {rows: 8, columns: 8}
store: {scenes_per_shard: 2}
"""


@pytest.fixture
def config(tmp_path: Path) -> Path:
    path = tmp_path / "tiny.yaml"
    path.write_text(CONFIG)
    return path


def test_the_plan_says_what_a_build_takes(config: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The plan has decisions with reasons, seconds, error and bytes, and the actual numbers of a build."""
    dataset, numbers = str(write_dataset(load_config(config), tmp_path / "set")), tmp_path / "plan.json"
    options = ["--workers", "2", "--seconds", "60", "--json", str(numbers), "--against", dataset]
    assert run(["plan", str(config), *options]) == 0
    text = capsys.readouterr().out
    for piece in ("occlusion", "sampler poisson", "of one core", "transport", "relative L2", "compressed",
                  "2 workers", "2 of 2 scenes", "seconds per scene", "bytes per scene", "actual"):  # fmt: skip
        assert piece in text, piece
    values = json.loads(numbers.read_text())
    expected, compared = values["forecast"], {row["name"]: row for row in values["against"]}
    assert expected["scenes"] == 3 and expected["workers"] == 2 and expected["pilots"] == 3
    assert expected["build_s"] > 0 and expected["startup_s"] > 0 and values["cores"] >= 1
    # All three scenes were pilots, so error and size are those of the dataset.
    for name, off in (("relative error", 1e-6), ("bytes per scene", 0.1)):
        assert compared[name]["predicted"] == pytest.approx(compared[name]["actual"], rel=off), name


@pytest.mark.parametrize(
    ("options", "word"),
    [
        (["--workers", "0"], "--workers 0"),
        (["--seconds", "0"], "--seconds 0"),
        (["--seconds", "nan"], "--seconds nan"),
        (["--scenes", "0"], "--scenes 0"),
        (["--json", "nowhere/plan.json"], "no folder nowhere"),
        (["--json", "."], "is a folder"),
        (["--against", "nowhere"], "no such dataset"),
    ],
)
def test_bad_input_is_one_line(
    config: Path, options: list[str], word: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run(["plan", str(config), *options]) == 2
    out, err = capsys.readouterr()
    assert out == "" and word in err and err.count("\n") == 1


@pytest.mark.parametrize(
    ("seconds", "text"),
    [(0.5, "0.5 s"), (43.2, "43 s"), (119.0, "2 min"), (3000.0, "50 min"), (12240.0, "3.4 h"), (1e6, "12 days")],
)
def test_durations_for_people(seconds: float, text: str) -> None:
    assert duration(seconds) == text


def test_the_limit_is_given_or_follows_the_longest_pilot(monkeypatch: pytest.MonkeyPatch) -> None:
    config = config_from_mapping({})
    assert scene_limit("2.5", config) == 2.5
    with pytest.raises(InputError, match="--scene-seconds soon: must be a number of seconds, or forecast"):
        scene_limit("soon", config)
    for longest, limit in ((0.01, AT_LEAST_S), (60.0, 5.0 + 60.0 * PILOTS_WORTH)):
        pilots = SimpleNamespace(startup_s=5.0, scene_s=(0.001, 0.002, longest))
        monkeypatch.setattr("datagen.forecast.text.make_forecast", lambda _, pilots=pilots: pilots)
        assert scene_limit("forecast", config) == limit
