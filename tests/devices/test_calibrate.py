"""Calibration: a simulated sweep gives its own device back; the real one is fitted as closely as the README says."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner
from rooms import ONE_BOUNCE, plane_ahead

import datagen as dg
from datagen.cli import cli
from datagen.devices import Calibration, Device, Frames, calibrate
from datagen.devices.saturation import saturated, unsaturated
from datagen.errors import InputError

REAL = Path(__file__).resolve().parents[3] / "shared" / "real" / "tmf8820_plane.json.gz"
real = pytest.mark.skipif(
    not REAL.is_file(), reason=f"needs the sweep of a real sensor, {REAL.name}, which is not here"
)


FLOORS = (1.2, 0.9, 1.1, 1.1, 0.8, 1.0, 1.2, 0.7, 1.0)
"""Of the zones of the simulated sweep, over their mean."""


def test_saturation_is_that_of_the_detector() -> None:
    """A dead time that blinds the next period alone gives N p / (1 + p), as `expected_histogram` has it exactly."""
    device = dg.device("tmf8820")
    events = np.zeros(device.axis.bins)
    events[300:340] = 0.02
    spad = replace(device.spad, dark_count_rate_hz=0.0, pde=1.0)
    exposure = replace(device.exposure, photons_per_pulse=1.0, pulse=None)
    ours = dg.expected_histogram(events, device.axis, spad, exposure)
    fine = saturated(events, exposure.cycles, 1.0)
    np.testing.assert_allclose(ours, fine.reshape(-1, spad.bins_merged).sum(axis=1), rtol=1e-6, atol=1e-3)
    np.testing.assert_allclose(unsaturated(fine, exposure.cycles, 1.0), events, rtol=1e-9)


@pytest.fixture(scope="module")
def sweep() -> Frames:
    """24 frames of the catalogue's TMF8820, with a floor for each zone, before a plane of albedo 0.8, with counting
    noise."""
    device, distances = dg.device("tmf8820"), np.linspace(0.15, 0.4, 24)
    zones = device.zones.model_copy(update={"dark_count_factors": FLOORS})
    device = device.model_copy(update={"zones": zones})
    rng, histograms = np.random.default_rng(4), []
    for metres in distances:
        capture, spad, exposure = device.at((0, 0, 0), (1, 0, 0))
        light = dg.simulate(plane_ahead(metres), capture, ONE_BOUNCE)
        histograms.append(rng.poisson(dg.expected_histogram(light.total, capture.time, spad, exposure)[0]))
    return Frames("simulated", np.array(histograms, float), None, distances)


def wrong() -> Device:
    """A nominal device that is wrong in all that is fitted."""
    truth = dg.device("tmf8820")
    return truth.model_copy(update={
        "time": truth.time.model_copy(update={"bin_width_ps": 97.0, "zero_bin": 13.6}),
        "counting": truth.counting.model_copy(update={"cycles": 4_000_000, "photons_per_pulse": 1e8}),
    })  # fmt: skip


@pytest.fixture(scope="module")
def found(sweep: Frames) -> Calibration:
    return calibrate(sweep, wrong())


def test_a_simulated_sweep_gives_its_device_back(found: Calibration) -> None:
    truth = dg.device("tmf8820")
    assert abs(found.device.time.bin_width_ps / truth.time.bin_width_ps - 1) < 0.004
    assert abs(found.device.counting.cycles / truth.counting.cycles - 1) < 0.05
    # Only the product with the footprints' gains matters, and those are scaled to the brightest zone.
    assert abs(found.device.counting.photons_per_pulse / truth.counting.photons_per_pulse - 1) < 0.1
    # Poisson noise of 14 counts, of 200, in each of 10 bins of 12 frames: 0.0065. Four times that for nine zones.
    np.testing.assert_allclose(found.device.zones.dark_count_factors, FLOORS, atol=0.03)
    floor = found.device.counting.dark_count_rate_hz / truth.counting.dark_count_rate_hz
    assert abs(floor * found.device.time.bin_width_ps / truth.time.bin_width_ps - 1) < 0.02
    assert np.median(found.relative_l2) < 0.02
    assert np.median(np.abs(found.brightness_error)) < 0.004
    assert np.median(np.abs(found.peak_shift)) < 0.02


def test_a_plane_that_is_darker_aslant_gives_the_same_device_where_its_material_is_named(
    found: Calibration, tmp_path: Path
) -> None:
    """It is half as bright at 29 degrees. Taken for a matt plane, it makes gains of corner zones too small."""
    cloth = dg.MeasuredByAngle(0.7, reflectance=(0.4, 0.4, 0.4, 0.4, 0.4, 0.4, 0.4, 0.4, 0.8))
    device, distances, histograms = dg.device("tmf8820"), np.linspace(0.15, 0.4, 16), []
    for metres in distances:
        scene = plane_ahead(metres)
        capture, spad, exposure = device.at((0, 0, 0), (1, 0, 0))
        light = dg.simulate(replace(scene, materials=(cloth,) * len(scene.materials)), capture, ONE_BOUNCE)
        histograms.append(dg.expected_histogram(light.total, capture.time, spad, exposure)[0])
    frames = Frames("simulated", np.array(histograms), None, distances)
    np.savez(tmp_path / "sweep.npz", hists=frames.histograms, dist_to_plane=distances)
    dg.write_materials({"a": cloth, "b": cloth}, tmp_path / "two.yaml")
    dg.write_materials({"a": cloth}, tmp_path / "one.yaml")
    dg.write_device(wrong(), tmp_path / "nominal.yaml")
    command = ["calibrate", str(tmp_path / "sweep.npz"), "--device", str(tmp_path / "nominal.yaml"), "--out",
               str(tmp_path / "mine.yaml"), "--plane"]  # fmt: skip
    bad = CliRunner().invoke(cli, [*command, str(tmp_path / "two.yaml")])
    assert "holds 2 materials; leave the plane's alone" in str(bad.exception)
    CliRunner().invoke(cli, [*command, str(tmp_path / "one.yaml")], catch_exceptions=False)
    matt, named = calibrate(frames, wrong()).device, dg.device(tmp_path / "mine.yaml")
    gains = [np.array(of.zones.gains) / np.array(found.device.zones.gains) for of in (matt, named)]
    assert np.ptp(gains[0]) > 3 * np.ptp(gains[1]) and np.ptp(gains[1]) < 0.06
    assert abs(named.counting.photons_per_pulse / device.counting.photons_per_pulse - 1) < 0.1
    assert "MeasuredByAngle" in named.source_of("counting", "photons_per_pulse")
    with pytest.raises(InputError, match="sends no light back at some angle below 60 degrees"):
        calibrate(frames, wrong(), plane=dg.MeasuredByAngle(0.5, reflectance=(0.0, 0.0, 0.0, 0.0, 1.0)))


def test_frames_that_test_do_not_change_the_fit(sweep: Frames, found: Calibration, tmp_path: Path) -> None:
    """Of every quarter in the order of distance the second and fourth are brighter by half, in frames that are
    shuffled: the command tells of the errors, and writes the same device to the bit."""
    assert sweep.distances_m is not None
    np.testing.assert_array_equal(found.tested_m, np.append(sweep.distances_m[6:12], sweep.distances_m[18:]))
    rows, other = np.random.default_rng(0).permutation(24), np.array(sweep.histograms)
    other[6:12] *= 1.5
    other[18:] *= 1.5
    np.savez(tmp_path / "sweep.npz", hists=other[rows], dist_to_plane=sweep.distances_m[rows])
    dg.write_device(wrong(), tmp_path / "nominal.yaml")
    command = ["calibrate", str(tmp_path / "sweep.npz"), "--device", str(tmp_path / "nominal.yaml"), "--out",
               str(tmp_path / "mine.yaml"), "--picture"]  # fmt: skip
    bad = CliRunner().invoke(cli, [*command, str(tmp_path / "fit.jpg")])
    assert isinstance(bad.exception, InputError) and not (tmp_path / "mine.yaml").exists()
    result = CliRunner().invoke(cli, [*command, str(tmp_path / "fit.png")], catch_exceptions=False)
    assert dg.device(tmp_path / "mine.yaml") == found.device
    assert float(result.output.split("median of |error| ")[1][:6]) > 0.3
    assert (tmp_path / "fit.png").stat().st_size > 10_000


def test_wrong_sweeps_are_refused_in_a_line(sweep: Frames) -> None:
    device = dg.device("tmf8820")
    zones = device.zones.model_copy(update={"weights": (((1.0, 0.5),),) * 9})
    with pytest.raises(InputError, match="a measured map is not fitted"):
        calibrate(sweep, device.model_copy(update={"zones": zones}))
    for frames, named in (
        (replace(sweep, distances_m=None), "no distances"),
        (replace(sweep, histograms=sweep.histograms[:, :4]), "4 zones"),
        (replace(sweep, distances_m=np.full(24, 0.01)), "at least 8"),
    ):
        with pytest.raises(InputError, match=named):
            calibrate(frames, device)


@real
def test_the_real_sweep_is_fitted_within_what_is_stated() -> None:
    """Of every second frame the second and fourth quarter of the distances are held out, and tested."""
    frames = dg.read_frames(REAL)
    every_second = frames.some(np.arange(0, len(frames.histograms), 2))
    found = calibrate(every_second, dg.device("tmf8820"), nearest_m=0.15)
    assert np.median(found.relative_l2) < 0.03
    assert np.median(np.abs(found.brightness_error)) < 0.008
    assert np.median(np.abs(found.peak_shift), axis=0).max() < 0.05
