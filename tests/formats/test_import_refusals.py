"""Captures that are damaged or lack something are refused in one line, and nothing is made."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import scipy.io
from foreign_files import grid, stanford, tal

import datagen as dg
from datagen.cli import run
from datagen.formats import export
from datagen.store import read_manifest

pytestmark = pytest.mark.usefixtures("builds_here")

h5py = pytest.importorskip("h5py", reason="h5py is not installed (extra `export`)")


SEEN, H = grid(3, 3), np.ones((8, 3, 3), np.float32)
FAR = np.where(SEEN > 0.9, np.inf, SEEN).astype(np.float32)
Case = tuple[dict[str, Any], dict[str, Any], str]
TAL: dict[str, Case] = {
    "unknown layout": ({"form": 0}, {}, "H_format = 0"),
    "other layout": ({"form": 2}, {}, "no T_Lx_Ly_Sx_Sy"),
    "other grid": ({"h": H[..., :2]}, {}, "does not fit H"),
    "points in a plane": ({"lit": SEEN[..., :2], "seen": SEEN[..., :2]}, {}, "(…, 3) needed"),
    "a point at infinity": ({"seen": FAR}, {}, "sensor_grid_xyz"),
    "no bin width": ({"delta_t": None}, {}, "bin_width = '4ps'"),
    "another bin width": ({}, {"bin_width": "4ps"}, "bin_width = '4ps'"),
    "a bin width of 0": ({"delta_t": 0.0}, {}, "bin_width_ps"),
    "no place of the laser": ({"laser_xyz": None}, {}, "laser_xyz"),
    "negative": ({"h": H - 2}, {}, "negative"),
    "NaN": ({"h": H * np.float32("nan")}, {}, "NaN"),
    "fractions as counts": ({"h": H / 2}, {"field": "histogram"}, "field = 'histogram'"),
    "counts beyond 32 bits": ({"h": H.astype(np.float64) * 2.0**33}, {}, "field = 'transient'"),
    "complex": ({"h": H * 1j}, {}, "complex"),
    "too few bins": ({}, {"bins": 9}, "bins = 9"),
    "a wall for y-tal": ({}, {"wall": "2m"}, "wall"),
}
"""Kind → what differs from a sound capture, options of the import, a piece of the refusal."""
WALL, WIDTH = {"bin_width": "4ps", "wall": 2.0}, {"bin_width": "4ps"}
MAT: dict[str, Case] = {
    "no wall": ({"meas": H}, WIDTH | {"tof": "none"}, "wall"),
    "no delays": ({"meas": H}, WALL, "tof"),
    "other delays": ({"meas": H, "tofgrid": np.zeros((2, 2))}, WALL, "(2, 2)"),
    "delays beyond all": ({"meas": H, "tofgrid": np.full((3, 3), 1e4)}, WALL, "ps"),
    "too many axes": ({"meas": np.ones((2, 2, 3, 3, 8))}, WALL | {"tof": "none"}, "(2, 2, 3, 3, 8)"),
    "cells": ({"rect_data": np.array([H, "x"], object), "width": 1.0}, WIDTH, "cell array"),
    "another program's": ({"dataset": H}, {}, "rect_data"),
    "pairs that do not fit": ({"trans_data": H[0], "camera_points": H[0], "laser_points": np.ones((2, 3))}, WIDTH,
                              "(N, 3)"),
    "no bin width": ({"rect_data": H, "width": 0.4}, {}, "bin_width = '4ps'"),
    "another wall": ({"rect_data": H, "width": 0.4}, {"bin_width": "4ps", "wall": "2m"}, "wall"),
}  # fmt: skip
"""Kind → variables of the file, options, a piece of the refusal."""


def hdf5_elsewhere(file: Any, folder: Path) -> None:
    (folder / "secret").write_bytes(bytes(8 * 9 * 4))
    file.create_dataset("H", (8, 3, 3), "f4", external=[(str(folder / "secret"), 0, 8 * 9 * 4)])


HDF5: dict[str, tuple[Callable[[Any, Path], object], str]] = {
    "no H": (lambda file, _: None, "of no known layout (H, "),
    "text for H": (lambda file, _: file.create_dataset("H", data="light"), "H"),
    "objects": (
        lambda file, _: file.create_dataset("H", (8, 3, 3), dtype=h5py.special_dtype(ref=h5py.Reference)),
        "not numbers",
    ),
    "a link": (lambda file, _: file.__setitem__("H", h5py.ExternalLink("other.hdf5", "/H")), "link"),
    "values in another file": (hdf5_elsewhere, "another file"),
    "huge": (lambda file, _: file.create_dataset("H", (10**6, 10**4, 10**4), "f4", chunks=(1, 100, 100)), "at most"),
    "declared and not there": (
        lambda file, _: file.create_dataset("H", (2**20, 3, 3), "f4", chunks=(1024, 3, 3)),
        "and 0 there",
    ),
}
"""Kind → what is put in the place of H, a piece of the refusal."""
BYTES: dict[str, Callable[[bytes], bytes]] = {
    "truncated": lambda whole: whole[:-2000], "noise": lambda _: bytes(range(256)) * 8, "empty": lambda _: b"",
}  # fmt: skip


def tal_file(path: Path, h: Any = H, form: int = 1, lit: Any = SEEN, seen: Any = SEEN, **other: Any) -> Path:
    return tal(path, h, form, lit, seen, **other)


def refuse(folder: Path, files: Path | list[Path], piece: str, **options: Any) -> None:
    """Check that an import is refused in one line that contains `piece`, and that nothing is made."""
    before = sorted(folder.iterdir())
    with pytest.raises(dg.InputError) as refused:
        dg.import_captures(files, folder / "set", progress=False, **options)
    message = str(refused.value)
    assert "\n" not in message and len(message) < 400 and piece in message, message
    assert sorted(folder.iterdir()) == before


def test_an_axis_longer_than_the_period_of_the_laser_that_is_named(tmp_path: Path) -> None:
    path, bins = tal_file(tmp_path / "c.hdf5", delta_t=3.0), len(H)
    dg.import_captures(path, tmp_path / "unnamed", progress=False)
    named = {"detector": {"repetition_rate_mhz": 80}}
    refuse(tmp_path, path, f"repetition_rate_mhz = 80 with capture.time: a laser period is 12.5 ns, and {bins} bins",
           settings=named)  # fmt: skip
    dg.import_captures(path, tmp_path / "cut", settings=named, bins=1, progress=False)


@pytest.mark.parametrize("kind", TAL)
def test_captures_of_y_tal(kind: str, tmp_path: Path) -> None:
    changes, options, piece = TAL[kind]
    refuse(tmp_path, tal_file(tmp_path / "c.hdf5", **changes), piece, **options)


@pytest.mark.parametrize("kind", HDF5)
def test_files_of_hdf5(kind: str, tmp_path: Path) -> None:
    path, (put, piece) = tal_file(tmp_path / "c.hdf5"), HDF5[kind]
    with h5py.File(path, "a") as file:
        del file["H"]
        put(file, tmp_path)
    refuse(tmp_path, path, piece)


@pytest.mark.parametrize("kind", MAT)
def test_files_of_matlab(kind: str, tmp_path: Path) -> None:
    variables, options, piece = MAT[kind]
    scipy.io.savemat(tmp_path / "m.mat", variables)
    refuse(tmp_path, tmp_path / "m.mat", piece, **options)


@pytest.mark.parametrize("kind", BYTES)
def test_files_that_are_damaged(kind: str, tmp_path: Path) -> None:
    path = tal_file(tmp_path / "c.hdf5", np.random.default_rng(0).random((64, 3, 3)))
    path.write_bytes(BYTES[kind](path.read_bytes()))
    refuse(tmp_path, path, "damaged")
    matlab = stanford(tmp_path)[0]
    matlab.write_bytes(BYTES[kind](matlab.read_bytes()))
    refuse(tmp_path, matlab, "damaged" if kind == "truncated" else "m", **WIDTH)


def test_files_that_do_not_go_together(tmp_path: Path) -> None:
    one = tal_file(tmp_path / "c.hdf5")
    refuse(tmp_path, [one, tal_file(tmp_path / "d.hdf5", H[:4])], "bins = 4")
    refuse(tmp_path, [one, tal_file(tmp_path / "d.hdf5", H / 2)], "field = 'transient'")
    refuse(tmp_path, tal_file(tmp_path / "capture"), "say format, one of")


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
    """Commands that draw rooms refuse imported captures, too."""
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
    for command in (["verify", "--resimulate", "1", str(tmp_path / "set")], ["replay", str(tmp_path / "set"), "0"]):
        assert run(command) == 2
        assert (
            "cannot be made again: these captures were imported, and have no room to draw\n"
            in capsys.readouterr().err
        )


def test_a_file_that_changes_during_the_import_is_refused(tmp_path: Path) -> None:
    path, _ = stanford(tmp_path)
    dg.import_captures(path, tmp_path / "set", bin_width="4ps", progress=False)
    from datagen.formats.imports import ImportedSamples

    config = read_manifest(tmp_path / "set").parsed_config()
    path.write_bytes(path.read_bytes() + b"\0")
    with pytest.raises(dg.InputError, match="has changed"):
        ImportedSamples((str(path),), None)(config, 0)


def test_other_units_are_refused_or_warned_of(tmp_path: Path) -> None:
    """Delays in seconds would shift nothing; a wall in millimetres is legal, and a doubt."""
    scipy.io.savemat(tmp_path / "m.mat", {"meas": H, "tofgrid": np.full((3, 3), 1e-8)})
    refuse(tmp_path, tmp_path / "m.mat", "Picoseconds are needed", **WALL)
    for changes, piece in (({"delta_t": 1e-12}, "width"), ({"delta_t": 3e8}, "width")):
        refuse(tmp_path, tal_file(tmp_path / "c.hdf5", **changes), piece)
    for width in (32.0, 4.0):
        scipy.io.savemat(tmp_path / "r.mat", {"rect_data": H, "width": 0.4, "bin_resolution": width})
        refuse(tmp_path, tmp_path / "r.mat", "bin_width_ps")
    with pytest.warns(dg.InputWarning, match="are they in metres"):
        dg.import_captures(
            tal_file(tmp_path / "d.hdf5", lit=1000 * SEEN, seen=1000 * SEEN), tmp_path / "set", progress=False
        )


def test_datasets_of_other_times_or_scans_are_not_compared(tmp_path: Path) -> None:
    """Of one shape, so that nothing else tells them apart: bins of another width, start or origin, or pairing."""
    one, four = SEEN[:1, :1], SEEN[:2, :2]
    files: dict[str, dict[str, Any]] = {
        "same": {}, "alike": {"delta_t": 0.003 * (1 + 1e-9)}, "wider": {"delta_t": 0.0033}, "later": {"t_start": 0.6},
        "from the wall": {"t_accounts_first_and_last_bounces": False},
        "one pixel": {"h": H[:, :2, :2].reshape(8, 2, 2, 1, 1), "form": 2, "lit": four, "seen": one},
        "confocal": {"h": H[:, :2, :2], "lit": four, "seen": four},
    }  # fmt: skip
    for name, changes in files.items():
        dg.import_captures(tal_file(tmp_path / f"{name}.hdf5", **changes), tmp_path / name, progress=False)
    for name, other, piece in (
        ("same", "wider", r"bins of 10.0069 ps from 0 ns on \(source\) and of 11.0076 ps"),
        ("same", "later", "from 2.00138 ns on"), ("same", "from the wall", r"\(wall\)"),
        ("one pixel", "confocal", "capture.pairing is exhaustive and confocal"),
    ):  # fmt: skip
        with pytest.raises(dg.InputError, match=piece):
            dg.compare_datasets(tmp_path / name, tmp_path / other)
    assert dg.compare_datasets(tmp_path / "same", tmp_path / "alike").relative_l2.max() < 1e-6
