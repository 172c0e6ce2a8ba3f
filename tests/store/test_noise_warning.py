"""A build whose simulated light is mostly noise says so in one line, whoever starts it."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

import pytest

import datagen as dg
from datagen.cli import run
from datagen.config import config_from_mapping

pytestmark = pytest.mark.usefixtures("builds_here")

NOISY = {"lookins": 16, "fov_samples": 1, "replicates": 4}
CONFIG: dict[str, Any] = {
    "scenes": 3,
    "capture": {"scan": {"rows": 2, "columns": 2}, "time": {"bins": 64, "bin_width_ps": 400}},
}


def test_a_warning_states_the_noise_and_the_remedy(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    """Also of a quiet build, and of one that finds nothing left to build."""
    (tmp_path / "c.yaml").write_text(json.dumps(CONFIG | {"transport": NOISY}))
    assert run(["build", str(tmp_path / "c.yaml"), str(tmp_path / "set"), "--quiet"]) == 0
    out, line = capfd.readouterr()
    found = re.fullmatch(r"noise: .* is (\d+)% off in the median of 3 scenes .*lookins \(16\).*\n", line)
    assert found and "noise" not in out
    errors = dg.TransientDataset(tmp_path / "set").parameters("transient.relative_error")
    assert round(100 * sorted(errors)[1]) == int(found[1]) > 20
    again = dg.build(config_from_mapping(CONFIG | {"transport": NOISY}), tmp_path / "set", progress=False)
    assert (again.built, again.noisy) == (0, line.strip())


@pytest.mark.parametrize("transport", [{"target": 0.1}, NOISY | {"replicates": 1}])
def test_no_warning_if_the_light_is_accurate_or_its_error_unknown(
    tmp_path: Path, capfd: pytest.CaptureFixture[str], transport: dict[str, Any]
) -> None:
    settings = config_from_mapping(CONFIG | {"transport": transport})
    assert dg.build(settings, tmp_path / "set", progress=False).noisy == ""
    assert "noise" not in capfd.readouterr().err
