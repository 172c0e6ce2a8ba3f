"""The sheet of devices: a picture and a table in which each device sees the things of the room where they are."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import datagen as dg
from datagen.cli import run
from datagen.devices import device_names
from datagen.errors import InputError
from datagen.report.device_sheet import FRONTS_M, device_sheet, seen_by, sheet_room
from datagen.units import SPEED_OF_LIGHT_M_PER_S

pytestmark = pytest.mark.usefixtures("coarse")


def test_the_sheet_is_a_picture_and_a_table(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["device", "--sheet", str(tmp_path / "a.png"), "vl53l1x", "swissspad3"]) == 0
    head, _, *rows, _, shared = capsys.readouterr().out.strip().splitlines()
    assert head.startswith("| device | zones × bins | s a scene | counts |")
    assert [row.split("`")[1] for row in rows] == ["vl53l1x", "swissspad3"]
    assert "dead time across cycles" in rows[0] and "laser /" in rows[1]
    assert shared.startswith("Effects simulated for all: direct return") and "pile-up" in shared
    assert (tmp_path / "a.png").read_bytes().startswith(b"\x89PNG")
    with pytest.raises(InputError, match=r"pictures are PNG files"):
        device_sheet([dg.device("vl53l1x")], tmp_path / "a.pdf")


@pytest.mark.parametrize("name", ["vl53l8ch", "linospad2"])
def test_the_brightest_zone_peaks_at_a_thing_of_the_room(name: str) -> None:
    """Its histogram's peak lies within a bin and half of the pulse of the depth of what the zone sees."""
    seen = seen_by(dg.device(name), sheet_room())
    curves = seen.counts.sum(axis=0)
    *_, peak = np.unravel_index(curves.argmax(), curves.shape)
    device = seen.device
    width_m = device.time.bin_width_ps * 1e-12 * SPEED_OF_LIGHT_M_PER_S / 2
    blur_m = 0.5e-12 * float(device.pulse.fwhm_ps or 0) * SPEED_OF_LIGHT_M_PER_S / 2
    found = (peak + 0.5 - device.time.zero_bin) * width_m
    assert min(abs(found - depth) for depth in FRONTS_M.values()) < width_m + blur_m + 0.05
    assert (seen.attenuation > 1) == (device.light.kind == "scan")


def test_without_names_the_catalogue_is_listed(capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["device"]) == 0
    listed = capsys.readouterr().out
    assert [line.split()[0] for line in listed.splitlines()] == list(device_names())
