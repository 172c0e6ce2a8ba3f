"""Frames of a sensor as files hold them: subtracted ambient light, a reference channel, other shapes, what tests."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import datagen as dg
from datagen.capture.device_optics import zone_boxes
from datagen.devices import Frames, recorded_by
from datagen.devices.frames import fitted_and_tested
from datagen.devices.zone_order import ORDERS, grid_of, zones_listed
from datagen.errors import InputError, InputWarning
from datagen.records.arrays import Floats

pytestmark = pytest.mark.usefixtures("builds_here")


def test_a_quarter_of_a_path_tests_what_the_quarter_before_it_fits() -> None:
    for count in (8, 101, 128):
        fitted, tested = fitted_and_tested(count)
        np.testing.assert_array_equal(np.sort(np.append(fitted, tested)), np.arange(count))
        assert abs(len(fitted) - len(tested)) <= 2
        # Two runs of neighbours each, and the first frame is fitted.
        assert [np.sum(np.diff(rows) > 1) for rows in (fitted, tested)] == [1, 1] and fitted[0] == 0


def written(folder: Path, form: str, hists: Floats, ambient: Floats | None) -> Path:
    path = folder / f"frames.{form}"
    given = {} if ambient is None else {"ambient": ambient}
    if form == "npz":
        np.savez(path, hists=hists, **given)
    else:
        frames = [{"hists": hist.tolist()} for hist in hists]
        for frame, told in zip(frames, ambient if ambient is not None else (), strict=False):
            frame["ambient"] = told.tolist()
        path.write_text(json.dumps(frames))
    return path


@pytest.mark.parametrize("form", ["npz", "json"])
def test_ambient_light_that_was_subtracted_is_added_again(form: str, tmp_path: Path) -> None:
    """A chip counts whole events, subtracts a rounded mean of the ambient light from each bin, and tells the mean."""
    rng = np.random.default_rng(0)
    counts, ambient = rng.poisson(30.0, (3, 16, 24)).astype(float), rng.uniform(25, 30, (3, 16))
    sent = counts - np.rint(ambient)[:, :, None]
    assert (sent < 0).any()
    path = written(tmp_path, form, sent, ambient)
    np.testing.assert_array_equal(dg.read_frames(path).histograms, counts)
    dg.import_captures(path, tmp_path / "real", device="vl53l8ch_4x4", progress=False)
    stored = dg.TransientDataset(tmp_path / "real", ("histogram",), counts="stored")
    np.testing.assert_array_equal(stored[2]["histogram"][0], counts[2])
    # Fractions are no whole counts: only the sum is taken.
    found = dg.read_frames(written(tmp_path, form, (counts - ambient[:, :, None]) / 8, ambient / 8)).histograms
    np.testing.assert_allclose(found, counts / 8, atol=1e-12)


@pytest.mark.parametrize(
    ("hists", "ambient", "named"),
    [
        (-np.ones((2, 4, 8)), None, "give what it subtracted beside hists: ambient"),
        (-np.ones((2, 4, 8)), np.zeros((2, 4)), "values down to -1"),
        (np.ones((2, 4, 8)), np.ones((2, 3)), r"ambient of shape \(2, 3\)"),
        (np.ones((2, 4, 8)), -np.ones((2, 4)), "one finite number ≥ 0"),
    ],
)
def test_ambient_light_that_cannot_be_is_refused_in_a_line(
    hists: Floats, ambient: Floats | None, named: str, tmp_path: Path
) -> None:
    with pytest.raises(InputError, match=named):
        dg.read_frames(written(tmp_path, "npz", hists, ambient))


def test_a_leading_reference_channel_is_left_out_with_a_word(tmp_path: Path) -> None:
    sent = np.random.default_rng(0).poisson(9.0, (2, 10, 128)).astype(float)
    with pytest.warns(InputWarning, match=r"10 zones .*the first is taken as the reference channel"):
        frames = recorded_by("sent", Frames("sent", sent), dg.device("tmf8820"), 9)
    np.testing.assert_array_equal(frames.histograms, sent[:, 1:])
    assert frames.reference is not None
    np.testing.assert_array_equal(frames.reference, sent[:, 0])
    np.save(tmp_path / "sent.npy", sent)
    with pytest.warns(InputWarning, match="reference channel"):
        dg.import_captures(tmp_path / "sent.npy", tmp_path / "real", device="tmf8820", progress=False)
    stored = dg.TransientDataset(tmp_path / "real", ("histogram",), counts="stored")[1]["histogram"]
    np.testing.assert_array_equal(stored[0], sent[1, 1:])


@pytest.mark.parametrize(
    ("shape", "likely"),
    [
        ((64, 128), "shape of .*tmf8828.*: name the device"),
        ((65, 128), "shape of .*tmf8828.*: name the device"),
        ((128, 9), "axes look swapped"),
        ((9, 64), "time.bins = 64"),
        ((18, 128), "a mode with other zones"),
        ((5, 7), "name the device that recorded them"),
    ],
)
def test_frames_of_another_shape_are_refused_with_the_likely_cause(shape: tuple[int, int], likely: str) -> None:
    device = dg.device("tmf8820")
    frames = replace(Frames("sent", np.ones((1, 9, 128))), histograms=np.ones((1, *shape)))
    with pytest.raises(InputError, match=f"{shape[0]} zones of {shape[1]} bins, tmf8820 has 9 of 128; .*{likely}"):
        recorded_by("sent", frames, device, 9)


@pytest.mark.parametrize("name", ["tmf8820", "tmf8828", "vl53l8ch", "vl53l8ch_4x4", "phone_dots", "swissspad3"])
def test_zones_are_turned_from_every_order_into_the_device_s(name: str) -> None:
    """A histogram that has its place (right, up) in it comes back at the zone of that place."""
    device = dg.device(name)
    boxes, count, bins = zone_boxes(device.zones), device.zones.count, device.time.bins
    grid = grid_of(device.zones)
    assert grid is not None
    rows, columns = grid.shape
    own = np.zeros((1, count, bins))
    own[0, :, :2] = boxes[:, :2]
    for order in ORDERS:
        places = [(row, column) for row in range(rows) for column in range(columns)]
        if order.startswith("columns"):
            places = [(row, column) for column in range(columns) for row in range(rows)]
        listed = []
        for row, column in places:
            row = row if "top" in order else rows - 1 - row
            column = column if "left" in order else columns - 1 - column
            partner = column ^ 1
            column = partner if "exchanged" in order and partner < columns else column
            listed.append(grid[row, column])
        sent = Frames("sent", own[:, listed], zone_order=order)
        np.testing.assert_array_equal(recorded_by("sent", sent, device, count).histograms, own)
        sent = replace(sent, zone_order=tuple(map(int, listed)))
        np.testing.assert_array_equal(recorded_by("sent", sent, device, count).histograms, own)
    # The zones of a grid as the catalogue has them: the first is at the top left.
    assert boxes[grid[0, 0], 0] < boxes[grid[0, -1], 0] and boxes[grid[0, 0], 1] > boxes[grid[-1, 0], 1]


@pytest.mark.parametrize("form", ["npz", "json"])
def test_an_order_that_a_file_states_is_that_of_its_zones(form: str, tmp_path: Path) -> None:
    """Also beside a reference channel, and as numbers; the dataset has the device's own order."""
    counts, order = np.random.default_rng(0).poisson(9.0, (3, 16, 24)), "rows from top right, pairs exchanged"
    listed = zones_listed("", order, dg.device("vl53l8ch_4x4").zones, 16)
    sent = np.concatenate([counts[:, :1], counts[:, listed]], axis=1)
    for number, stated in enumerate((order, listed.tolist())):
        path = tmp_path / f"{number}.{form}"
        if form == "npz":
            np.savez(path, hists=sent, zone_order=stated)
        else:
            path.write_text(json.dumps([{"zone_order": stated, "hists": hist.tolist()} for hist in sent]))
        with pytest.warns(InputWarning, match="reference channel"):
            dg.import_captures(path, tmp_path / f"real{number}", device="vl53l8ch_4x4", progress=False)
        data = dg.TransientDataset(tmp_path / f"real{number}", ("histogram",), counts="stored")
        np.testing.assert_array_equal(np.stack([data[k]["histogram"][0] for k in range(3)]), counts)


@pytest.mark.parametrize(
    ("order", "named"),
    [
        ("by chance", "rows or columns from top or bottom"), ("rows from top letf", "did you mean"),
        (list(range(15)), "0 … 15"), ([0] * 16, "0 … 15"), (0.5, "zone_order must be"),
        ([0.5] * 16, "zone_order must be"), ([1e300, *range(1, 16)], "0 … 15"), ([-1, *range(15)], "0 … 15"),
    ],
)  # fmt: skip
def test_an_order_that_is_none_is_refused_in_a_line(order: object, named: str, tmp_path: Path) -> None:
    np.savez(tmp_path / "sent.npz", hists=np.ones((2, 16, 24)), zone_order=order)
    with pytest.raises(InputError, match=named) as refused:
        dg.import_captures(tmp_path / "sent.npz", tmp_path / "real", device="vl53l8ch_4x4", progress=False)
    assert "\n" not in str(refused.value) and not (tmp_path / "real").exists()


@pytest.mark.parametrize("order", [(0.5, 1, 2, 3), ("a",) * 4, 5, (), (2**70, 1, 2, 3), (0, 1, 2, None)])
def test_an_order_that_is_given_in_python_is_checked(order: Any) -> None:
    with pytest.raises(InputError, match=r"zone_order lists .*0 … 3 once"):
        zones_listed("sent", order, dg.device("vl53l8ch_4x4").zones, 4)


@pytest.mark.parametrize(
    ("pose", "named"),
    [
        (np.diag([2.0, 2.0, 2.0, 1.0]), "no turn"), (np.diag([1.0, 1.0, 0.0, 1.0]), "no turn"),
        (np.diag([-1.0, 1.0, 1.0, 1.0]), "mirrored"), (np.eye(4) + np.eye(4)[[3]].T @ [[1, 2, 3, 0]], "transposed"),
    ],
)  # fmt: skip
def test_poses_that_are_no_turn_and_shift_are_refused(pose: Floats, named: str, tmp_path: Path) -> None:
    """A mirrored one would exchange left and right without a word; every reader of poses says so."""
    poses = np.stack([np.eye(4), pose])
    np.savez(tmp_path / "sent.npz", hists=np.ones((2, 9, 128)), pose=poses)
    with pytest.raises(InputError, match=rf"sent\.npz: pose: that of frame 1 is {named}"):
        dg.read_frames(tmp_path / "sent.npz")
    with pytest.raises(InputError, match=f"Frames.poses: that of frame 1 is {named}"):
        Frames("sent", np.ones((2, 9, 128)), poses)
    with pytest.raises(InputError, match=f"Device.at_pose: pose: that of frame 0 is {named}"):
        dg.device("tmf8820").at_pose(pose)


def test_lengths_of_frames_are_doubted_in_other_units_than_metres(tmp_path: Path) -> None:
    poses = np.stack([np.eye(4)] * 2)
    poses[1, 0, 3] = 1500.0
    for more, named in (({"pose": poses}, "pose differ by 1500"), ({"dist_to_plane": [300.0, 900.0]}, "reaches 900")):
        np.savez(tmp_path / "sent.npz", hists=np.ones((2, 9, 128)), **more)
        with pytest.warns(InputWarning, match=named):
            dg.read_frames(tmp_path / "sent.npz")


def test_a_key_that_comes_twice_is_refused(tmp_path: Path) -> None:
    (tmp_path / "sent.json").write_text('[{"hists": [[1, 2]], "hists": [[3, 4]]}]')
    with pytest.raises(InputError, match="'hists' comes twice"):
        dg.read_frames(tmp_path / "sent.json")


def test_frames_of_several_orders_are_refused(tmp_path: Path) -> None:
    orders = ("rows from top left", "columns from top left")
    frames = [{"hists": np.ones((16, 24)).tolist(), "zone_order": order} for order in orders]
    (tmp_path / "sent.json").write_text(json.dumps(frames))
    with pytest.raises(InputError, match="several zone_order"):
        dg.read_frames(tmp_path / "sent.json")
