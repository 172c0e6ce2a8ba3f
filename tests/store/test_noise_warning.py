"""A build whose simulated light is mostly noise says so in one line, whoever starts it."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner

import datagen as dg
from datagen.cli import cli
from datagen.config import config_from_mapping
from datagen.store import committed, read_manifest

NOISY = {"lookins": 16, "fov_samples": 1, "replicates": 4}
CONFIG: dict[str, Any] = {
    "scenes": 3,
    "capture": {"scan": {"rows": 2, "columns": 2}, "time": {"bins": 64, "bin_width_ps": 400}},
}


def build(folder: Path, transport: dict[str, Any], progress: bool = True) -> dg.BuildResult:
    return dg.build(config_from_mapping(CONFIG | {"transport": transport}), folder / "set", progress=progress)


def test_a_warning_states_the_noise_and_the_remedy(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    result = build(tmp_path, NOISY)
    lines = [line for line in capfd.readouterr().err.splitlines() if line.startswith("noise: ")]
    assert lines == [result.noisy]
    found = re.search(
        r"is (\d+)% off in the median of 3 scenes .* transport: \{target: 0.05\}.*lookins \(16\)", lines[0]
    )
    assert found
    manifest = read_manifest(tmp_path / "set")
    made = [scene for record in committed(tmp_path / "set", manifest) for scene in record.scenes]
    errors = sorted(float(scene.parameters["transient.relative_error"]) for scene in made)
    assert round(100 * errors[1]) == int(found[1]) > 20
    # Nothing was left to build, and it is no less noisy.
    again = build(tmp_path, NOISY)
    assert (again.built, again.noisy) == (0, result.noisy)


@pytest.mark.parametrize("transport", [{"target": 0.1}, NOISY | {"replicates": 1}])
def test_no_warning_if_the_light_is_accurate_or_its_error_unknown(
    tmp_path: Path, capfd: pytest.CaptureFixture[str], transport: dict[str, Any]
) -> None:
    assert build(tmp_path, transport).noisy == ""
    assert "noise" not in capfd.readouterr().err


def test_quiet_builds_warn_too(tmp_path: Path) -> None:
    config = tmp_path / "config.yaml"
    config.write_text(
        "scenes: 1\ncapture: {scan: {rows: 2, columns: 2}, time: {bins: 64, bin_width_ps: 400}}\n"
        "transport: {lookins: 16, fov_samples: 1, replicates: 4}\n"
    )
    result = CliRunner().invoke(cli, ["build", str(config), str(tmp_path / "set"), "--quiet"])
    assert result.exit_code == 0
    assert [line[:7] for line in result.stderr.splitlines()] == ["noise: "]
    assert "noise" not in result.stdout
