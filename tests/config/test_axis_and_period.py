"""A time axis ends with the laser's period: a longer one is refused in one line before anything is built."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
import yaml

import datagen as dg
from datagen.cli import run
from datagen.config import config_from_mapping
from datagen.config.device import DeviceConfig, read_device
from datagen.detector import detector_for


def settings(rate_mhz: Any, bins: int = 512) -> dict[str, Any]:
    return {
        "capture": {"scan": {"rows": 2, "columns": 2}, "time": {"bins": bins, "bin_width_ps": 100, "start_ns": 30}},
        "detector": {"repetition_rate_mhz": rate_mhz},
    }


@pytest.mark.parametrize("mode", ["ideal", "synchronous", "free_running"])
@pytest.mark.parametrize(("rate", "said"), [(80, "= 80 with"), ({"uniform": [5, 80]}, "= 5 … 80 with")])
def test_a_longer_axis_is_refused_in_every_mode(mode: str, rate: Any, said: str) -> None:
    values = settings(rate)
    values["detector"]["mode"] = mode
    with pytest.raises(dg.InputError) as caught:
        config_from_mapping(values)
    line = str(caught.value)
    for words in ("detector.repetition_rate_mhz " + said, "12.5 ns", "51.2 ns", "125 bins", "24.4140625 ps a bin",
                  "19.53125 MHz"):  # fmt: skip
        assert words in line
    # What it allows is taken; the axis may begin at any time.
    config_from_mapping(settings(rate, bins=125))
    config_from_mapping(settings(19.53125))


def test_a_rate_that_is_left_out_makes_room() -> None:
    """Such as for recorded captures, whose laser nobody names."""
    config = config_from_mapping(settings(None, bins=4096))
    _, exposure = detector_for(config.detector, 0, 0, config.capture.time.axis())
    assert exposure.period_s == pytest.approx(409.6e-9)


@pytest.mark.parametrize("command", ["plan", "build"])
def test_commands_say_so_before_they_begin(
    command: str, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("long.yaml").write_text(yaml.safe_dump(settings(80)))
    assert run([command, "long.yaml", *(["out.zarr"] if command == "build" else [])]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert "long.yaml: detector.repetition_rate_mhz = 80 with capture.time" in line
    assert [path.name for path in tmp_path.iterdir()] == ["long.yaml"]


def test_devices_likewise() -> None:
    device = read_device("vl53l1x", DeviceConfig).model_dump(mode="json")
    with pytest.raises(dg.InputError, match=r"device.*counting\.repetition_rate_mhz = 80 with time: .*12\.5 ns"):
        values = device | {"counting": device["counting"] | {"repetition_rate_mhz": 80}}
        config_from_mapping({"capture": {"device": values}})
    with pytest.raises(dg.InputError, match=r"detector\.repetition_rate_mhz = 80 with capture\.time"):
        config_from_mapping({"capture": {"device": "vl53l1x"}, "detector": {"repetition_rate_mhz": 80}})
