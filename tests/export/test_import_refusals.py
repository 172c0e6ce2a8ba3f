"""Captures that are damaged, or lack something, are refused in a line, and nothing is made."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import scipy.io
from foreign_files import grid, stanford, tal

import datagen as dg
from datagen.cli import run
from datagen.export import export
from datagen.store import read_manifest

h5py = pytest.importorskip("h5py", reason="h5py is not installed (extra `export`)")


def damaged(kind: str, folder: Path) -> tuple[list[Path], dict[str, Any]]:
    """Files, and the options of their import."""
    seen, h = grid(3, 3), np.ones((8, 3, 3), np.float32)
    path, options = folder / "c.hdf5", dict[str, Any]()
    match kind:
        case "truncated":
            tal(path, np.random.default_rng(0).random((64, 3, 3)), 1, seen, seen)
            path.write_bytes(path.read_bytes()[:-2000])
        case "noise":
            path.write_bytes(bytes(range(256)) * 8)
        case "empty":
            path.write_bytes(b"")
        case "no H":
            with h5py.File(path, "w") as file:
                file["G"], file["sensor_grid_xyz"], file["laser_grid_xyz"] = h, seen, seen
        case "Zaragoza":
            with h5py.File(path, "w") as file:
                file["data"], file["cameraGridPositions"] = h, seen
        case "unknown layout":
            tal(path, h, 0, seen, seen)
        case "other layout":
            tal(path, h, 2, seen, seen)
        case "other grid":
            tal(path, h[..., :2], 1, seen, seen)
        case "points in a plane":
            tal(path, h, 1, seen[..., :2], seen[..., :2])
        case "a point at infinity":
            tal(path, h, 1, seen, np.where(seen > 0.9, np.inf, seen).astype(np.float32))
        case "no bin width":
            tal(path, h, 1, seen, seen, delta_t=None)
        case "another bin width":
            tal(path, h, 1, seen, seen)
            options = {"bin_width": "4ps"}
        case "a bin width of 0":
            tal(path, h, 1, seen, seen, delta_t=0.0)
        case "no place of the laser":
            tal(path, h, 1, seen, seen, laser_xyz=None)
        case "negative":
            tal(path, h - 2, 1, seen, seen)
        case "NaN":
            tal(path, h * np.float32("nan"), 1, seen, seen)
        case "fractions as counts":
            tal(path, h / 2, 1, seen, seen)
            options = {"field": "histogram"}
        case "counts beyond 32 bits":
            tal(path, h.astype(np.float64) * 2.0**33, 1, seen, seen)
        case "complex":
            tal(path, h * 1j, 1, seen, seen)
        case "text for H":
            tal(path, h, 1, seen, seen)
            with h5py.File(path, "a") as file:
                del file["H"]
                file["H"] = "light"
        case "objects":
            tal(path, h, 1, seen, seen)
            with h5py.File(path, "a") as file:
                del file["H"]
                file.create_dataset("H", (8, 3, 3), dtype=h5py.special_dtype(ref=h5py.Reference))
        case "a link":
            tal(path, h, 1, seen, seen)
            tal(folder / "other.hdf5", h, 1, seen, seen)
            with h5py.File(path, "a") as file:
                del file["H"]
                file["H"] = h5py.ExternalLink("other.hdf5", "/H")
        case "values in another file":
            tal(path, h, 1, seen, seen)
            (folder / "secret").write_bytes(bytes(8 * 9 * 4))
            with h5py.File(path, "a") as file:
                del file["H"]
                file.create_dataset("H", (8, 3, 3), "f4", external=[(str(folder / "secret"), 0, 8 * 9 * 4)])
        case "huge":
            tal(path, h, 1, seen, seen)
            with h5py.File(path, "a") as file:
                del file["H"]
                file.create_dataset("H", (10**6, 10**4, 10**4), "f4", chunks=(1, 100, 100))
        case "declared and not there":
            tal(path, h, 1, seen, seen)
            with h5py.File(path, "a") as file:
                del file["H"]
                file.create_dataset("H", (2**20, 3, 3), "f4", chunks=(1024, 3, 3))
        case "two shapes":
            files = [tal(path, h, 1, seen, seen), tal(folder / "d.hdf5", h[:4], 1, seen, seen)]
            return files, options
        case "counts and light":
            files = [tal(path, h, 1, seen, seen), tal(folder / "d.hdf5", h / 2, 1, seen, seen)]
            return files, options
        case "too few bins":
            tal(path, h, 1, seen, seen)
            options = {"bins": 9}
        case "no suffix":
            path = tal(folder / "capture", h, 1, seen, seen)
        case "a wall for y-tal":
            tal(path, h, 1, seen, seen)
            options = {"wall": "2m"}
        case "mat without a bin width":
            path = stanford(folder)[0]
        case "mat without a wall":
            path, options = folder / "m.mat", {"bin_width": "4ps", "tof": "none"}
            scipy.io.savemat(path, {"meas": h})
        case "mat without delays":
            path, options = folder / "m.mat", {"bin_width": "4ps", "wall": 2.0}
            scipy.io.savemat(path, {"meas": h})
        case "other delays":
            path, options = folder / "m.mat", {"bin_width": "4ps", "wall": 2.0}
            scipy.io.savemat(path, {"meas": h, "tofgrid": np.zeros((2, 2))})
        case "delays beyond all":
            path, options = folder / "m.mat", {"bin_width": "4ps", "wall": 2.0}
            scipy.io.savemat(path, {"meas": h, "tofgrid": np.full((3, 3), 1e4)})
        case "another wall":
            path, options = stanford(folder)[0], {"bin_width": "4ps", "wall": "2m"}
        case "frames":
            path, options = folder / "m.mat", {"bin_width": "4ps", "wall": 2.0, "tof": "none"}
            scipy.io.savemat(path, {"meas": np.ones((2, 3, 3, 8))})
        case "cells":
            path, options = folder / "m.mat", {"bin_width": "4ps"}
            scipy.io.savemat(path, {"rect_data": np.array([h, "x"], object), "width": 1.0})
        case "another program's mat":
            path = folder / "m.mat"
            scipy.io.savemat(path, {"dataset": h})
        case "truncated mat":
            path, options = stanford(folder)[0], {"bin_width": "4ps"}
            path.write_bytes(path.read_bytes()[:3000])
        case "pairs that do not fit":
            path, options = folder / "m.mat", {"bin_width": "4ps"}
            scipy.io.savemat(path, {"trans_data": h[0], "camera_points": h[0], "laser_points": np.ones((2, 3))})
    return [path], options


REFUSED = {
    "truncated": "damaged", "noise": "damaged", "empty": "damaged", "no H": "H: missing; the file has G",
    "Zaragoza": "Zaragoza", "unknown layout": "H_format = 0", "other layout": "no T_Lx_Ly_Sx_Sy",
    "other grid": "does not fit H", "points in a plane": "(…, 3) needed", "a point at infinity": "sensor_grid_xyz",
    "no bin width": "--bin", "another bin width": "--bin 4ps", "a bin width of 0": "bin_width_ps",
    "no place of the laser": "laser_xyz", "negative": "negative", "NaN": "NaN",
    "fractions as counts": "--field histogram", "counts beyond 32 bits": "--field transient", "complex": "complex",
    "text for H": "H", "objects": "not numbers", "a link": "link", "values in another file": "another file",
    "huge": "at most", "declared and not there": "and 0 there", "two shapes": "--bins 4",
    "counts and light": "--field transient", "too few bins": "--bins 9", "no suffix": "--format",
    "a wall for y-tal": "--wall", "mat without a bin width": "--bin 4ps", "mat without a wall": "--wall",
    "mat without delays": "--tof", "other delays": "(2, 2)", "delays beyond all": "ps", "another wall": "--wall",
    "frames": "(2, 3, 3, 8)", "cells": "cell array", "another program's mat": "rect_data",
    "truncated mat": "damaged|data_s_u", "pairs that do not fit": "(N, 3)",
}  # fmt: skip


@pytest.mark.parametrize("kind", REFUSED)
def test_it_is_refused_in_a_line_and_nothing_is_made(kind: str, tmp_path: Path) -> None:
    files, options = damaged(kind, tmp_path)
    before = sorted(tmp_path.iterdir())
    with pytest.raises(dg.InputError) as told:
        dg.import_captures(files, tmp_path / "set", progress=False, **options)
    message = str(told.value)
    assert "\n" not in message and len(message) < 400
    assert any(piece in message for piece in REFUSED[kind].split("|")), message
    assert sorted(tmp_path.iterdir()) == before


def test_the_command_refuses_in_a_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path, out = str(stanford(tmp_path)[0]), str(tmp_path / "set")
    for arguments, piece in (
        ([path, out], "--bin 4ps"),
        ([path, out, "--bin", "4 parsecs"], "--bin 4 parsecs"),
        ([path, out, "--bin", "4ps", "--wall", "big"], "--wall big"),
        ([path, out, "--bin", "4ps", "--axes", "abc"], "--axes"),
        ([path, out, "--bin", "4ps", "--bins", "0"], "--bins 0"),
        ([path, out, "--bin", "4ps", "--field", "light"], "--field"),
        ([path, out, "--bin", "4ps", "--tof", "nowhere.mat"], "nowhere.mat"),
        ([path, out, "--format", "doc"], "--format doc"),
        (["nowhere.mat", out], "no such file"),
        ([str(tmp_path), out], "directory"),
        ([path, "", "--bin", "4ps"], "OUT"),
        ([out], "missing argument"),
    ):
        assert run(["import", *arguments]) == 2
        err = capsys.readouterr().err
        assert err.count("\n") == 1 and piece in err, err
    assert not Path(out).exists()


def test_a_configuration_cannot_ask_for_it(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Nor can what draws rooms draw one of an imported capture."""
    path, _ = stanford(tmp_path)
    dg.import_captures(path, tmp_path / "set", bin_width="4ps", progress=False)
    config = read_manifest(tmp_path / "set").parsed_config()
    assert config.capture.shape == (30, 1, 40)
    for call in (
        lambda: dg.scene_for(config, 0),
        lambda: dg.build(config, tmp_path / "again", progress=False),
        lambda: export(tmp_path / "set", tmp_path / "glb", "glb"),
    ):
        with pytest.raises(dg.InputError, match="imported, and have no room to draw"):
            call()
    assert run(["verify", "--resimulate", "1", str(tmp_path / "set")]) == 2
    assert "no room to draw" in capsys.readouterr().err


def test_a_file_that_changes_meanwhile_is_told(tmp_path: Path) -> None:
    path, _ = stanford(tmp_path)
    dg.import_captures(path, tmp_path / "set", bin_width="4ps", progress=False)
    from datagen.importing.captures import ImportedSamples

    config = read_manifest(tmp_path / "set").parsed_config()
    path.write_bytes(path.read_bytes() + b"\0")
    with pytest.raises(dg.InputError, match="has changed"):
        ImportedSamples((str(path),), None)(config, 0)
