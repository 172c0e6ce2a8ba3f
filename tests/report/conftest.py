"""The rooms of `tests/labels/handmade_rooms.py` as a plain module."""

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1] / "labels"))
