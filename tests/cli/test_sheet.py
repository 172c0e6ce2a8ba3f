"""`datagen sheet` as a user types it."""

from __future__ import annotations

from pathlib import Path

import pytest

from datagen.cli import run

ROOT = Path(__file__).resolve().parents[2]


def test_sheet_names_the_key_of_a_bad_mesh(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "flat.obj").write_text("v 0 0 0\nv 1 0 0\nv 0 nan 0\nf 1 2 3\n")
    (tmp_path / "c.yaml").write_text(
        "name: c\nseed: 1\nscenes: 1\nscene:\n  layout: {kind: l_corridor}\n"
        "  contents: [{kind: mesh, name: thing, path: flat.obj}]\n"
        "capture: {pairing: confocal, scan: {rows: 1, columns: 1}}\n"
    )
    assert run(["sheet", str(tmp_path / "c.yaml"), str(tmp_path / "sheet.png")]) == 2
    error = capsys.readouterr().err
    assert "scene.contents[0].path" in error and error.count("\n") == 1
    assert not (tmp_path / "sheet.png").exists()


@pytest.mark.usefixtures("few_pixels")
def test_sheet_draws_rooms(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "sheet.png"
    assert run(["sheet", str(ROOT / "configs/quickstart.yaml"), str(out), "--rooms", "2"]) == 0
    assert out.read_bytes()[:4] == b"\x89PNG"
    assert run(["sheet", str(ROOT / "configs/quickstart.yaml"), str(out), "--rooms", "0"]) == 2
    assert "count" in capsys.readouterr().err
