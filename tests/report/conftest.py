"""Pictures that take less time."""

from __future__ import annotations

from collections.abc import Iterator

import pytest
from matplotlib.layout_engine import ConstrainedLayoutEngine

from datagen.report.rooms import Surfaces


@pytest.fixture(scope="module")
def coarse() -> Iterator[None]:
    """Rooms are drawn with few pixels, and axes stay where they were put: that takes most of the time of a picture.
    `test_show_pictures.py` has both as users have them."""
    seen = Surfaces.seen
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(ConstrainedLayoutEngine, "execute", lambda self, figure: None)
        patch.setattr(Surfaces, "seen", lambda self, camera, pixels: seen(self, camera, min(pixels, 150)))
        yield
