"""Devices in configurations: what follows from them, what is refused, and datasets whose sensor merges bins."""

from __future__ import annotations

import json
from dataclasses import fields
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
import yaml
from datasets import write_dataset

import datagen as dg
from datagen.building.input_check import check_inputs
from datagen.capture.device_optics import footprints
from datagen.capture.devices import STEEPEST
from datagen.config import config_from_mapping, load_config, time_axes
from datagen.detector import detector_for
from datagen.devices import device_names
from datagen.errors import InputError, InputWarning
from datagen.formats import export
from datagen.pipeline import simulate_sample
from datagen.store.scenes import Scenes
from datagen.store.schema import schema_of

CONFIGS = Path(__file__).parents[2] / "configs"
FEW = {"transport": {"samples": 8, "max_bounces": 3}}
"""Few paths: only light of more than one bounce depends on them."""


def configured(name: str = "tmf8820", **sections: Any) -> dg.DatasetConfig:
    capture = {"device": name} | sections.pop("capture", {})
    return config_from_mapping({"seed": 4, "capture": capture} | FEW | sections)


@pytest.mark.parametrize("name", device_names())
def test_a_configuration_gives_what_the_device_gives(name: str) -> None:
    """Capture, detector and exposure of a scene are those of `Device.at`, to rounding."""
    config = configured(name)
    scene = dg.scene_for(config, 0)
    capture = dg.capture_for(config, scene)
    assert scene.relay_wall is not None and scene.device_position is not None
    wanted, spad_wanted, exposure_wanted = dg.device(name).at(scene.device_position, scene.relay_wall.center)
    for part in ("laser", "sensor"):
        for key, value in vars(getattr(wanted, part)).items():
            np.testing.assert_array_equal(getattr(getattr(capture, part), key), value)
    assert (capture.pairing, capture.illumination) == (wanted.pairing, wanted.illumination)
    assert capture.shape == wanted.shape == config.capture.shape
    np.testing.assert_allclose(capture.time.edges_s, wanted.time.edges_s, rtol=1e-12, atol=1e-21)
    spad, exposure = detector_for(config.detector, config.seed, 0, capture.time)
    for found, of_device in ((spad, spad_wanted), (exposure, exposure_wanted)):
        for key in (field.name for field in fields(found) if field.name != "hot_pixel_seed"):
            value = getattr(of_device, key)
            assert getattr(found, key) == (pytest.approx(value, rel=1e-12) if isinstance(value, float) else value), (
                key
            )
    assert config.scene.wavelength_nm == dg.device(name).wavelength_nm
    assert config.transport.direct == (capture.illumination == "flood")


@pytest.mark.parametrize("name", ["tmf8820", "galvo_spad"])
def test_a_stored_configuration_holds_the_whole_device(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """It is read again, with the same fingerprint, when the catalogue no longer has the device."""
    config = configured(name, detector={"ambient_rate_hz": {"log_uniform": [1e4, 1e6]}, "pde": 0.1})
    stored = json.loads(json.dumps(config.model_dump(mode="json")))
    monkeypatch.setattr("datagen.config.device.device_names", lambda: ())
    again = config_from_mapping(stored, look_for_files=False)
    assert again == config and again.fingerprint() == config.fingerprint()
    spad, exposure = detector_for(again.detector, 4, 0)
    assert spad.pde == 0.1 and 1e4 <= exposure.ambient_rate_hz <= 1e6


def test_a_file_stands_beside_its_configuration_and_its_map_is_stored(tmp_path: Path) -> None:
    """A path starts at the configuration's folder; the content of `zones.map` becomes part of the configuration."""
    device = dg.device("vl53l1x")
    values = json.loads(device.model_dump_json(exclude_defaults=True)) | {"zones": {"map": "map.npz"}}
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "one.yaml").write_text(json.dumps(values))
    np.savez(tmp_path / "mine" / "map.npz", extent=[-0.2, 0.1, -0.1, 0.3], weights=np.arange(12.0).reshape(1, 3, 4))
    path = tmp_path / "a.yaml"
    path.write_text(yaml.safe_dump({"capture": {"device": "mine/one.yaml"}}))
    config = load_config(path)
    held = config.capture.device
    assert (
        held is not None
        and held.zones.map is None
        and str(tmp_path) not in json.dumps(config.model_dump(mode="json"))
    )
    corners, weights = footprints(held.zones)
    np.testing.assert_array_equal(weights, np.arange(12.0).reshape(1, 3, 4))
    np.testing.assert_allclose(corners[0], [(-0.2, -0.1), (0.1, -0.1), (0.1, 0.3), (-0.2, 0.3)])


@pytest.mark.parametrize(
    ("words", "sections"),
    [
        ("did you mean 'tmf8820_wide'", {"capture": {"device": "tmf8820_wid"}}),
        ("capture.device: nowhere.yaml: no such file", {"capture": {"device": "nowhere.yaml"}}),
        ("pairing beside device 'tmf8820'", {"capture": {"pairing": "confocal"}}),
        ("illumination beside device", {"capture": {"illumination": "scan"}}),
        ("scan beside device", {"capture": {"scan": {"rows": 4}}}),
        ("field_of_view beside device", {"capture": {"field_of_view": {"aperture_radius_mm": 3}}}),
        ("time beside device", {"capture": {"time": {"bins": 64}}}),
        ("laser_offset_m beside device", {"capture": {"laser_offset_m": [0, 0, 0.1]}}),
        (
            "at_objects and sensor_offset_m are both given",
            {"capture": {"at_objects": {}, "sensor_offset_m": [0, 0, 0.1]}},
        ),
        ("scene.wavelength_nm = 532 .* 940 nm", {"scene": {"wavelength_nm": 532}}),
        ("detector_class = 'any' beside capture.device", {"detector": {"detector_class": "any"}}),
        ("bins_merged = 4 beside capture.device", {"detector": {"bins_merged": 4}}),
        ("pulse and pulse_fwhm_ps", {"detector": {"pulse_fwhm_ps": 9, "pulse": {"samples": [1], "sample_ps": 9}}}),
    ],
)
def test_what_contradicts_a_device_is_refused_in_a_line(words: str, sections: dict[str, Any]) -> None:
    with pytest.raises(InputError, match=words) as caught:
        configured(**sections)
    assert "\n" not in str(caught.value)


BLURRED = json.loads(dg.device("vl53l1x").model_dump_json(exclude_defaults=True)) | {
    "zones": {"map": "map.npz", "blur": 0.01}
}
"""A map says how its edges fade."""


@pytest.mark.parametrize(
    ("words", "values"),
    [
        ("weights, map and blur", {"capture": {"device": BLURRED}}),
        ("at_objects without device", {"capture": {"at_objects": {}}}),
        ("take 504 bins", {"capture": {"time": {"bins": 510}}, "detector": {"bins_merged": 8}}),
    ],
)
def test_keys_that_need_others(words: str, values: dict[str, Any]) -> None:
    with pytest.raises(InputError, match=words):
        config_from_mapping(values)


def test_a_given_pulse_replaces_the_measured_one() -> None:
    detector = configured(detector={"pulse_fwhm_ps": 80.0}).detector
    _, exposure = detector_for(detector, 0, 0)
    assert exposure.pulse is None and exposure.pulse_fwhm_s == pytest.approx(80e-12)
    for own in ({"pulse_fwhm_ps": 80.0}, {"exposure_for": {"evidence": 5}}):
        asked = configured(detector=own)
        assert config_from_mapping(asked.model_dump(mode="json")) == asked, "a stored configuration is read again"


def test_a_device_looks_straight_at_an_object() -> None:
    """In the share of scenes asked for it stands as far away and as high as asked for, and its axis meets the middle
    of the object."""
    straight_at = {"share": 0.75, "distance_m": 0.9, "height_m": 0.5, "aside_deg": 0.0}
    config = configured(capture={"at_objects": straight_at})
    straight = 0
    for index in range(24):
        scene = dg.scene_for(config, index)
        sensor = dg.capture_for(config, scene, index=index).sensor
        if np.array_equal(sensor.position, scene.device_position):
            continue
        straight += 1
        middles = []
        for name in scene.objects:
            own = scene.corners[scene.faces_of(name)].reshape(-1, 3)
            middles.append((own.min(axis=0) + own.max(axis=0)) / 2)
        away = np.linalg.norm(np.array(middles) - sensor.position, axis=1)
        assert np.abs(away - 0.9).min() < 1e-9
        near = middles[int(np.abs(away - 0.9).argmin())]
        assert sensor.position[2] == pytest.approx(np.clip(0.5, near[2] - 0.9 * STEEPEST, near[2] + 0.9 * STEEPEST))
        axis = dg.device("tmf8820").at(sensor.position, near)[0].sensor.pixels
        np.testing.assert_allclose(sensor.pixels, axis, atol=1e-9)
    # Binomial(24, 0.75) lies in 11 … 24 with a probability of 99.9 %.
    assert straight >= 11
    assert straight < 24


def test_a_room_without_a_place_to_look_from_is_refused() -> None:
    config = configured(capture={"at_objects": {"distance_m": 50.0}})
    with pytest.raises(InputError, match=r"capture\.at_objects: none of 256 places sees an object") as caught:
        dg.capture_for(config, dg.scene_for(config, 0))
    assert "\n" not in str(caught.value)
    hidden = configured(capture={"sensor_offset_m": [0.0, 9.0, 0.0]})
    with pytest.raises(InputError, match=r"capture\.sensor_offset_m: .* hides 1 of 1 point"):
        dg.capture_for(hidden, dg.scene_for(hidden, 0))


STORED = ["histogram", "transient", "transient_stderr", "objects", "evidence", "background_histogram",
          "background_transient"]  # fmt: skip


@pytest.fixture(scope="module")
def merged(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A dataset of two scenes of a device that merges eight bins."""
    store = {"fields": STORED, "histogram_dtype": "uint32"}
    config = configured(scenes=2, capture={"at_objects": {"distance_m": 0.8}}, store=store)
    return write_dataset(config, tmp_path_factory.mktemp("merged") / "set")


def test_histograms_have_the_sensors_bins_from_build_to_loader(merged: Path) -> None:
    every = ("histogram", "transient", "background_histogram")
    data = dg.TransientDataset(merged, every)
    batch = next(iter(torch.utils.data.DataLoader(data, 2, collate_fn=dg.collate)))
    assert batch["histogram"].shape == batch["background_histogram"].shape == (2, 1, 9, 128)
    assert batch["transient"].shape == (2, 1, 9, 1024)
    coarse, fine = data.time_of("histogram"), data.time_of("transient")
    np.testing.assert_allclose(coarse.edges_s, fine.edges_s[::8], rtol=1e-12, atol=1e-21)
    assert coarse.width_s == pytest.approx(95.1298e-12)
    with pytest.raises(InputError, match="no axis of time"):
        data.time_of("object_box_size")


def test_noise_is_redrawn_with_the_sensors_pulse_and_bins(merged: Path) -> None:
    """The mean of redrawn histograms is that of the device's own detector. The total of each zone lies within 5
    standard errors and the tolerance of 0.2 % for a cheaper sampler: level 1e-6 for each of 18 zones."""
    data = dg.TransientDataset(merged, ("histogram",), redraw_noise=True)
    light = dg.TransientDataset(merged, ("transient",))
    _, spad, exposure = dg.device("tmf8820").at((0, 0, 0), (1, 0, 0))
    for item in range(2):
        draws = torch.stack([data[item]["histogram"] for _ in range(8)]).double().numpy()
        assert draws.shape == (8, 1, 9, 128) and not np.array_equal(draws[0], draws[1])
        time = light.time_of("transient")
        due = dg.expected_histogram(light[item]["transient"].double().numpy(), time, spad, exposure, approximate=True)
        assert (np.abs(draws.mean(axis=0) - due).sum(axis=2) < 3 * np.sqrt(due / 8).sum(axis=2)).all()
        total, wanted = draws.sum(axis=3).mean(axis=0), due.sum(axis=2)
        assert (np.abs(total - wanted) < 5 * np.sqrt(wanted / 8) + 2e-3 * wanted).all()


def test_a_crop_of_bins_cuts_both_axes(merged: Path) -> None:
    whole = dg.TransientDataset(merged, ("histogram", "transient"))
    data = dg.TransientDataset(merged, ("histogram", "transient"), bins=slice(20, 60), pixels=[4, 1])
    assert data.shape("histogram") == (1, 2, 40) and data.shape("transient") == (1, 2, 320)
    np.testing.assert_array_equal(data[1]["histogram"], whole[1]["histogram"][:, [4, 1], 20:60])
    np.testing.assert_array_equal(data[1]["transient"], whole[1]["transient"][:, [4, 1], 160:480])
    assert data.time_of("transient").start_s == pytest.approx(data.time_of("histogram").start_s)
    drawn = dg.TransientDataset(merged, ("histogram",), redraw_noise=True, bins=slice(20, 60), seed=1)
    every = dg.TransientDataset(merged, ("histogram",), redraw_noise=True, seed=1)
    np.testing.assert_array_equal(drawn[0]["histogram"], every[0]["histogram"][..., 20:60])


def test_histograms_are_drawn_where_none_is_stored(tmp_path: Path) -> None:
    root = write_dataset(configured(scenes=1, store={"fields": ["transient"]}), tmp_path / "set")
    data = dg.TransientDataset(root, ("histogram",), redraw_noise=True, bins=slice(8, 24))
    assert data.shape("histogram") == tuple(data[0]["histogram"].shape) == (1, 9, 16)
    assert "bin 16 of 128" in repr(data)


def test_events_and_volumes_of_merged_bins(merged: Path) -> None:
    data = dg.TransientDataset(merged, ("histogram",), representation="events")
    assert int(data[0]["events"][:, 2].max()) < 128
    # Zones look at points, too: at those where their middles meet the scene.
    volume = dg.TransientDataset(merged, ("histogram",), representation="volume", voxels=(4, 5, 6))[0]["volume"]
    assert volume.shape == (4, 5, 6) and bool(torch.isfinite(volume).all()) and float(volume.std()) > 0


def test_exports_have_both_axes_of_time(merged: Path, tmp_path: Path) -> None:
    with np.load(export(merged, tmp_path / "npz", "npz", "0")[0]) as file:
        assert file["histogram"].shape == (1, 9, 128) and len(file["bin_edges_s"]) == 129
        assert len(file["transient_bin_edges_s"]) == 1025
        np.testing.assert_allclose(file["bin_edges_s"], file["transient_bin_edges_s"][::8], rtol=1e-12, atol=1e-21)
    card = (merged / "README.md").read_text(encoding="utf-8")
    assert "+ (i + 1) · 0.0953393) ns, and bin `i` of `transient_bin`" in card and "· 0.0119174) ns, counted" in card
    scene = Scenes(merged).read(0)
    assert scene.time.bins == 128 and scene.manifest.time_of("background_transient").bins == 1024
    xarray = pytest.importorskip("xarray")
    stored = xarray.open_zarr(merged / "data.zarr")
    assert stored.histogram.dims[-1] == "bin" and stored.transient.dims[-1] == "transient_bin"
    np.testing.assert_allclose(stored["bin"].values, 1e12 * (scene.time.centers_s), rtol=1e-9)


def test_evidence_is_that_of_the_merged_histogram(merged: Path) -> None:
    """A sensor that merges all bins has no less detections and no more significance than one that merges eight."""
    config = configured(capture={"at_objects": {"distance_m": 0.8}})
    scene, index = dg.scene_for(config, 0), 0
    capture = dg.capture_for(config, scene, index=index)
    light = dg.simulate(scene, capture, dg.Accuracy(samples=8, max_bounces=3, direct=True))
    _, spad, exposure = dg.device("tmf8820").at((0, 0, 0), (1, 0, 0))
    found = [
        dg.own_evidence(light, dg.Spad(**(vars(spad) | {"bins_merged": merge})), exposure, scene.objects)
        for merge in (1, 8, 1024)
    ]
    for name in scene.objects:
        fine, eight, one = (each[name] for each in found)
        assert fine.detections == pytest.approx(eight.detections) == pytest.approx(one.detections)
        assert fine.significance >= eight.significance >= one.significance


def test_without_merged_bins_histograms_and_transients_share_an_axis() -> None:
    config = load_config(CONFIGS / "zone_sensor.yaml")
    assert config.histogram_shape == config.capture.shape and list(time_axes(config)) == ["bin"]


@pytest.mark.parametrize(
    "name",
    [pytest.param(n, marks=() if n in ("vl53l8ch", "galvo_spad") else pytest.mark.nightly) for n in device_names()],
)
def test_every_device_builds_a_scene_of_the_ready_configuration(name: str) -> None:
    values = yaml.safe_load((CONFIGS / "any_device.yaml").read_text())
    values["capture"]["device"] = name
    values["transport"] |= {"samples": 1, "max_bounces": 3}
    if dg.device(name).light.kind == "scan":
        del values["capture"]["at_objects"]
    config = config_from_mapping(values)
    sample = simulate_sample(config, 0)
    counts, depth = sample.arrays["histogram"], sample.arrays["zone_depth"]
    assert counts.shape == config.histogram_shape and counts.sum() > 0
    assert depth.shape == schema_of(config).by_name["zone_depth"].shape
    assert np.isfinite(depth).all() and (depth > 0.02).all() and (depth < 5).all()


def test_a_sensor_that_looks_too_far_is_warned_of() -> None:
    """A VL53L8CH, whose histogram ends at 0.9 m, sees walls of a corridor at 5 to 7 m; one metre away it does not."""
    far = configured("vl53l8ch", scenes=4)
    with pytest.warns(InputWarning, match=r"in 4 of 4 scenes most zones see things farther .* \(0\.9 m\)"):
        check_inputs(far)
    check_inputs(configured("vl53l1x", scenes=4, capture={"at_objects": {"distance_m": 0.6}}))
    # Without direct light there is nothing to miss.
    check_inputs(configured("vl53l8ch", scenes=4, transport={"direct": False}))
