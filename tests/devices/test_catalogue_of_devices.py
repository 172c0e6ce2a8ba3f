"""The catalogue of devices: every one builds, sees a plane where it is, and states where its numbers come from."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from rooms import ONE_BOUNCE, plane_ahead

import datagen as dg
from datagen.capture.device_optics import zone_boxes
from datagen.devices import device_names
from datagen.devices.model import Device
from datagen.errors import InputError


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
