"""The rooms of `tests/labels/handmade_rooms.py` as a plain module, and pictures of few pixels."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

sys.path.insert(0, str(Path(__file__).parents[1] / "labels"))


@pytest.fixture(scope="session", autouse=True)
def few_pixels() -> Iterator[None]:
    """What is drawn, and where, does not depend on the resolution; the time does."""
    from datagen.report import room_plots, style
    from datagen.report.cutaway import shaded

    def coarse(*arguments: Any) -> Any:
        *others, pixels = arguments
        return shaded(*others, pixels // 4)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(style, "DPI", 50)
        patch.setattr(room_plots, "shaded", coarse)
        yield
