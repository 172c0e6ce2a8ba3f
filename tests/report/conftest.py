"""The rooms of `tests/labels/handmade_rooms.py` as a plain module, and pictures of few pixels."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).parents[1] / "labels"))


@pytest.fixture(scope="session", autouse=True)
def small_pictures(few_pixels: None) -> None:
    """In all tests of pictures."""
