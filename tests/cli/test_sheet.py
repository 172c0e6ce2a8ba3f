"""`datagen sheet` as a user types it."""

from __future__ import annotations

from pathlib import Path

import pytest

from datagen.cli import run

ROOT = Path(__file__).resolve().parents[2]


@pytest.mark.usefixtures("few_pixels")
def test_sheet_draws_rooms(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "sheet.png"
    assert run(["sheet", str(ROOT / "configs/quickstart.yaml"), str(out), "--rooms", "2"]) == 0
    assert out.read_bytes()[:4] == b"\x89PNG"
    assert run(["sheet", str(ROOT / "configs/quickstart.yaml"), str(out), "--rooms", "0"]) == 2
    assert "count" in capsys.readouterr().err
