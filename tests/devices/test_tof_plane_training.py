"""examples/tof_plane_training.py at small size: planes lean as stated, effects are left out, and a network learns."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import tof_plane_training
import torch

import datagen as dg

ROOT = Path(__file__).parents[2]
SCRIPT = ROOT / "examples" / "tof_plane_training.py"
REAL = ROOT.parent / "shared" / "real"
real = pytest.mark.skipif(not (REAL / "tmf8820_plane.json.gz").is_file(), reason="needs a sweep of a real sensor")
made: dict[str, Any] = vars(tof_plane_training)
DEVICE = dg.device("tmf8820")
RIGHT, LEFT = 7, 1
"""Zones in the middle of the right and of the left column of the sensor's histograms."""


@pytest.fixture(scope="module", autouse=True)
def one_thread() -> Iterator[None]:
    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    yield
    torch.set_num_threads(threads)


def mean_bins(light: np.ndarray) -> np.ndarray:
    """(zones,) mean arrival time."""
    return light @ np.arange(light.shape[1]) / light.sum(axis=1)


def test_a_plane_that_leans_to_the_right_is_farther_there() -> None:
    bare = made["bare"](DEVICE)
    boxes = np.array(bare.zones.boxes)
    facing, right, up = (mean_bins(made["light_of"](bare, (0.3, *tilt))) for tilt in ((0, 0), (20, 0), (0, 20)))
    assert boxes[RIGHT, 0] > 0 > boxes[LEFT, 0]
    # Path of the middle of a zone at the tangent u: z / (1 − u tan 20°) instead of z, less what leans to its edges.
    for zone in (LEFT, RIGHT):
        bins = 0.6 / 299_792_458.0 / DEVICE.axis.width_s * (1 / (1 - boxes[zone, 0] * np.tan(np.radians(20))) - 1)
        assert right[zone] - facing[zone] == pytest.approx(bins, rel=0.15)
    top, bottom = int(boxes[3:6, 1].argmax()) + 3, int(boxes[3:6, 1].argmin()) + 3
    assert up[top] > facing[top] and up[bottom] < facing[bottom]


def test_counts_are_those_of_the_plane_and_the_glass() -> None:
    """Crosstalk, delays and cover glass are added to the bare device's light as the simulation adds them."""
    whole, light = (made["light_of"](of, (0.3, 0, 0)) for of in (DEVICE, made["bare"](DEVICE)))
    glass = made["glass_of"](DEVICE)
    counts = made["counts_of"](DEVICE, glass, np.array([1.0]), light)
    exact = dg.expected_histogram(whole[None], DEVICE.axis, DEVICE.spad, DEVICE.exposure)
    np.testing.assert_allclose(counts, exact, rtol=1e-4, atol=1e-2)


def test_each_effect_that_is_left_out_changes_what_it_is_named_after() -> None:
    without = {name: leave(DEVICE) for name, leave in made["LEFT_OUT"].items()}
    assert without["nothing"] == DEVICE
    pulse = np.array(without["the pulse's tail"].pulse.samples)
    measured = np.array(DEVICE.pulse.samples)
    # As wide at half of the maximum, and without what the measured pulse has 40 samples after its peak.
    assert abs((pulse > 0.5).sum() - (measured > 0.5).sum()) <= 1
    assert pulse[50] < 1e-6 < 0.01 < measured[50]
    light = made["light_of"](made["bare"](DEVICE), (0.3, 0, 0))
    counts = {
        name: made["counts_of"](of, np.zeros_like(light), np.ones(1), light)[0].sum()
        for name, of in without.items()
        if name in ("nothing", "pile-up", "floor")
    }
    assert counts["pile-up"] > 1.02 * counts["nothing"] > 1.02 * counts["floor"]
    bare = made["bare"](without["footprints (data sheet's boxes)"])
    other = made["light_of"](bare, (0.3, 0, 0))
    np.testing.assert_allclose(other.sum(axis=1), light.sum(axis=1), rtol=0.05)


def test_a_network_learns_the_distance_of_simulated_planes() -> None:
    planes = made["Planes"].drawn(24, 0)
    counts = made["simulated"]({"nothing": DEVICE}, planes, 1)["nothing"]
    assert counts.shape == (24 * made["ALBEDOS"], 9, 128)
    answers = planes.answers
    truth = answers.double().numpy()[:, 0]
    said = made["said"](made["trained"](counts, answers, 0, 15), counts)
    assert np.median(np.abs(said[:, 0] - truth)) < 0.2 * np.median(np.abs(truth - truth.mean()))


def test_without_the_sweep_the_script_says_so(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(sys, "argv", [str(SCRIPT), str(tmp_path), str(tmp_path / "picture.png")])
    made["main"]()
    assert "no such file" in capsys.readouterr().out and not (tmp_path / "picture.png").exists()


@real
@pytest.mark.nightly
def test_the_table_and_the_picture_of_the_real_sweep(tmp_path: Path) -> None:
    sweep = made["Sweep"].read(REAL / "tmf8820_plane.json.gz")
    assert not set(sweep.told) & set(sweep.tested) and len(sweep.tested) == 60
    found = made["compared"](sweep, 60, 4, 2, 1)
    # Of the sensor's own depths, as ORIGIN has them; a network of so short a training is no match.
    chip = np.median(np.abs(found.answers["the chip's own"] - found.truth))
    assert chip == pytest.approx(0.0125, abs=0.002)
    assert np.median(np.abs(found.networks["nothing"][0, :, 0] - found.truth)) < 0.1
    rows = made["tables"](found).splitlines()
    assert sum(row.startswith("| footprints") for row in rows) == 2
    made["draw"](found, tmp_path / "picture.png")
    assert (tmp_path / "picture.png").stat().st_size > 10_000
