"""A time axis ends with the laser's period: a longer one is refused in one line before anything is built."""

from __future__ import annotations

from typing import Any

import pytest

import datagen as dg
from datagen.config import config_from_mapping
from datagen.config.device import DeviceConfig, read_device
from datagen.detector import detector_for


def settings(rate_mhz: Any, bins: int = 512) -> dict[str, Any]:
    return {
        "capture": {"scan": {"rows": 2, "columns": 2}, "time": {"bins": bins, "bin_width_ps": 100, "start_ns": 30}},
        "detector": {"repetition_rate_mhz": rate_mhz},
    }


@pytest.mark.parametrize("mode", ["ideal", "synchronous", "free_running"])
def test_a_longer_axis_is_refused_in_every_mode(mode: str) -> None:
    for rate, said in ((80, "= 80 with"), ({"uniform": [5, 80]}, "= 5 … 80 with")):
        values = settings(rate)
        values["detector"]["mode"] = mode
        with pytest.raises(dg.InputError, match=f"detector.repetition_rate_mhz {said}.*12.5 ns") as caught:
            config_from_mapping(values)
        assert "\n" not in str(caught.value)
    # What it allows is taken; the axis may begin at any time.
    config_from_mapping(settings(rate, bins=125))
    config_from_mapping(settings(19.53125))


def test_a_rate_that_is_left_out_makes_room() -> None:
    """Such as for recorded captures, whose laser nobody names."""
    config = config_from_mapping(settings(None, bins=4096))
    _, exposure = detector_for(config.detector, 0, 0, config.capture.time.axis())
    assert exposure.period_s == pytest.approx(409.6e-9)


def test_devices_likewise() -> None:
    device = read_device("vl53l1x", DeviceConfig).model_dump(mode="json")
    with pytest.raises(dg.InputError, match=r"device.*counting\.repetition_rate_mhz = 80 with time: .*12\.5 ns"):
        values = device | {"counting": device["counting"] | {"repetition_rate_mhz": 80}}
        config_from_mapping({"capture": {"device": values}})
    with pytest.raises(dg.InputError, match=r"detector\.repetition_rate_mhz = 80 with capture\.time"):
        config_from_mapping({"capture": {"device": "vl53l1x"}, "detector": {"repetition_rate_mhz": 80}})
