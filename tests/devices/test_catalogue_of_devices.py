"""The catalogue of devices: every one builds, sees a plane where it is, and states where its numbers come from."""

from __future__ import annotations

import itertools
import json
import math
import re
from pathlib import Path

import numpy as np
import pytest
from rooms import ONE_BOUNCE, plane_ahead

import datagen as dg
from datagen.capture.device_optics import zone_boxes
from datagen.devices import device_names
from datagen.devices.model import Device
from datagen.errors import InputError

ROOT = Path(__file__).resolve().parents[2]


def before_a_plane(device: Device, metres: float) -> tuple[np.ndarray, dg.Capture]:
    """(laser, pixel, bin) expected histograms before a white plane that a device faces, with one bounce of light."""
    capture, spad, exposure = device.at((0, 0, 0), (1, 0, 0))
    few = np.arange(min(len(capture.laser.targets), 4))
    if capture.illumination == "scan":
        capture = capture.excerpt(few)
    light = dg.simulate(plane_ahead(metres), capture, ONE_BOUNCE)
    return dg.expected_histogram(light.total, capture.time, spad, exposure, approximate=True), capture


@pytest.mark.parametrize("name", device_names())
def test_a_device_sees_a_plane_where_it_is(name: str) -> None:
    """The brightest histogram peaks where 2 z / c lies, to the width of the pulse and the slant of its direction."""
    device = dg.device(name)
    gated = device.counting.gate_ns is not None and device.counting.gate_ns != "histogram"
    metres = 0.8
    counts, capture = before_a_plane(device, metres)
    assert counts.shape[:2] == capture.shape[:2] and counts.shape[2] == device.time.bins
    if gated:
        metres = 299_792_458 * 5.5e-9 / 2
        counts, _ = before_a_plane(device, metres)
    assert counts.max() > 10
    *_, peak = np.unravel_index(counts.argmax(), counts.shape)
    width = device.time.bin_width_ps * 1e-12
    expected = device.time.zero_bin + 2 * metres / 299_792_458 / width
    blur_s = 1e-12 * max(device.pulse.fwhm_ps or 0.0, 250) + (1e-9 if gated else 0.0)
    slant = 0.15 * 2 * metres / 299_792_458
    assert abs(peak + 0.5 - expected) < 1 + (blur_s + slant) / width


@pytest.mark.parametrize("name", device_names())
def test_every_number_has_its_source(name: str) -> None:
    device = dg.device(name)
    for section in ("zones", "light", "time", "pulse", "counting"):
        for key in getattr(device, section).model_dump(exclude_defaults=True):
            assert device.source_of(section, key), f"{name}: {section}.{key} has no source"
    assert all(line in str(device) for line in ("wavelength_nm", "counting.pde"))


def said_otherwise(device: Device) -> list[str]:
    """What a device's description says of it that its numbers do not."""
    text, boxes = device.description, zone_boxes(device.zones)
    low, high = boxes[:, :2] - boxes[:, 2:] / 2, boxes[:, :2] + boxes[:, 2:] / 2
    field = np.degrees(np.arctan(high.max(axis=0)) - np.arctan(low.min(axis=0)))
    mode = rf"in ({' × '.join(map(str, [math.isqrt(device.zones.count)] * 2))}) mode"
    said: dict[str, tuple[list[float], list[float]]] = {}
    # Zones, and the dots of a telephone; modes that other chips have are beside the point.
    if found := re.search(r"(\d+) × (\d+) (zones|dots)", re.sub(mode, "", text)):
        said[found[0]] = [math.prod(map(float, found.groups()[:2]))], [float(device.zones.count)]
    if found := re.search(r"(\d+)° × (\d+)°", text):
        said[found[0]] = [*map(float, found.groups())], [*map(float, field)]
    elif found := re.search(r"in (\d+)°", text):
        said[found[0]] = [float(found[1])], [math.hypot(*field)]
    if found := re.search(r"(\d+) frames a second", text):
        said[found[0]] = [float(found[1])], [1e6 * device.counting.repetition_rate_mhz / device.counting.cycles]
    if found := re.search(r"(\d+) nm light", text):
        said[found[0]] = [float(found[1])], [device.wavelength_nm]
    if found := re.search(r"gated for ([\d.]+) ns", text):
        gate = device.counting.gate_ns
        said[found[0]] = [float(found[1])], [gate[1] if isinstance(gate, tuple) else math.nan]
    if found := re.search(r"(\d+) × (\d+) pixels.* blocks of (\d+) × (\d+)", text):
        rows, columns, high_, wide = map(float, found.groups())
        said[found[0]] = [rows * columns / (high_ * wide)], [float(device.zones.count)]
    # Fields are those of data sheets, of which fitted zones are up to a seventh more.
    return [what for what, (one, other) in said.items() if not np.allclose(one, other, rtol=0.15)]


@pytest.mark.parametrize("name", device_names())
def test_a_device_is_what_its_description_says(name: str) -> None:
    device = dg.device(name)
    assert device.name == name
    assert said_otherwise(device) == []


def test_a_copy_with_another_name_is_found_out() -> None:
    """No two devices have the same numbers, and no device has the description of another."""
    devices = [dg.device(name) for name in device_names()]
    numbers = [device.model_dump_json(exclude={"name", "description", "sources"}) for device in devices]
    assert len(set(numbers)) == len({device.description for device in devices}) == len(devices)
    narrow, wide = dg.device("tmf8820"), dg.device("tmf8820_wide")
    assert said_otherwise(narrow.model_copy(update={"description": wide.description})) == ["52° × 41°"]
    zones = dg.device("vl53l8ch_4x4").model_copy(update={"description": dg.device("vl53l8ch").description})
    assert said_otherwise(zones) == ["8 × 8 zones", "15 frames a second"]


def test_pages_have_every_device() -> None:
    """The README their number, and the table their bins and what its words say."""
    words = dict(zip(range(8, 17), ("Eight", "Nine", "Ten", "Eleven", "Twelve", "Thirteen", "Fourteen", "Fifteen",
                                    "Sixteen"), strict=True))  # fmt: skip
    assert f"{words[len(device_names())]} sensors are in the catalogue" in (ROOT / "README.md").read_text("utf-8")
    lines = (ROOT / "docs/devices.md").read_text("utf-8").split("## In a configuration")[0].splitlines()
    rows = [line.split("|") for line in lines if line.startswith("| `")]
    names = [re.findall(r"`(\w+)`", row[1]) for row in rows]
    assert sorted(itertools.chain(*names)) == sorted(device_names())
    for row, of in zip(rows, names, strict=True):
        devices = [dg.device(name) for name in of]
        assert {device.time.bins for device in devices} == {int(row[4])}, of
        # Of a row with two devices each has its part of the words.
        assert len(of) > 1 or said_otherwise(devices[0].model_copy(update={"description": row[2]})) == []


def test_a_measured_map_is_a_footprint(tmp_path: Path) -> None:
    """A map that holds one box gives what the box gives; a device that was read holds its map."""
    box = dg.device("vl53l1x")
    *_, w, h = zone_boxes(box.zones)[0]
    np.savez(tmp_path / "map.npz", extent=[-w / 2, w / 2, -h / 2, h / 2], weights=np.ones((1, 3, 4)))
    values = json.loads(box.model_dump_json(exclude_defaults=True))
    values["zones"] = {"map": "map.npz"}
    mapped = dg.device(_written(tmp_path / "mapped.yaml", json.dumps(values)))
    dg.write_device(mapped, tmp_path / "elsewhere" / "mapped.yaml")
    assert dg.device(tmp_path / "elsewhere" / "mapped.yaml") == mapped
    even = box.model_copy(update={"zones": box.zones.model_copy(update={"blur": 0.0})})
    np.testing.assert_allclose(before_a_plane(mapped, 1.0)[0], before_a_plane(even, 1.0)[0], rtol=1e-9)


@pytest.mark.parametrize(
    ("message", "make"),
    [
        ("did you mean 'linospad2'", lambda folder: dg.device("linospad")),
        ("no such file", lambda folder: dg.device(folder / "none.yaml")),
        ("no orientation", lambda folder: dg.device("tmf8820").at((0, 0, 0), (0, 0, 1))),
        ("4 × 4 matrix", lambda folder: dg.device("tmf8820").at_pose(np.eye(3))),
        ("ends in .yaml", lambda folder: dg.write_device(dg.device("tmf8820"), folder / "mine.txt")),
        ("holds no frames", lambda folder: dg.read_frames(_written(folder / "a.json", "{}"))),
        ("holds no frames", lambda folder: dg.read_frames(_written(folder / "a.npz", "PK\x03\x04 cut off"))),
        ("holds no frames", lambda folder: dg.read_frames(_written(folder / "a.json.gz", "\x1f"))),
        ("cannot be read as UTF-8", lambda folder: dg.device(_written(folder / "latin.yaml", b"name: \xe9"))),
        ("is a directory", lambda folder: dg.device(_folder(folder / "d.yaml"))),
        ("'pose' is in 1 of 2", lambda folder: dg.read_frames(
            _written(folder / "b.json", '[{"hists": [[1]], "pose": [[1]]}, {"hists": [[1]]}]'))),
        ("exactly one of boxes", lambda folder: dg.device(_written(
            folder / "c.yaml", "{name: c, description: c, wavelength_nm: 940, zones: {rows: 2}, light: {field_deg: "
            "[9, 9]}, time: {bins: 9, bin_width_ps: 9}, pulse: {fwhm_ps: 9}, counting: {pde: 0.1, "
            "repetition_rate_mhz: 1, cycles: 9, photons_per_pulse: 9}}"))),
    ],
)  # fmt: skip
def test_wrong_values_are_refused_in_a_line(tmp_path: Path, message: str, make: object) -> None:
    with pytest.raises(InputError, match=message) as caught:
        make(tmp_path)  # type: ignore[operator]
    assert "\n" not in str(caught.value)


def _written(path: Path, text: str | bytes) -> Path:
    path.write_bytes(text if isinstance(text, bytes) else text.encode("latin-1"))
    return path


def _folder(path: Path) -> Path:
    path.mkdir()
    return path
