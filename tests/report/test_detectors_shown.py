"""`datagen show` for every class of detector: where the mean is approximate it is drawn, and the page says so."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from datagen.building.build import build
from datagen.config import config_from_mapping
from datagen.report.pages import pages
from datagen.report.replay import read_scene, replay
from datagen.report.style import house_style, save_png

pytestmark = pytest.mark.usefixtures("builds_here", "coarse")

DETECTORS: dict[str, dict[str, Any]] = {
    "lab_si": {"detector_class": "lab_si", "mode": "synchronous", "afterpulse_probability": 0},
    "si_array": {"detector_class": "si_array", "mode": "free_running"},
    "saturating": {"mode": "free_running", "counter_max": 3},
}
"""Name → section `detector`; only the first has an exact mean."""


@pytest.mark.parametrize("name", DETECTORS)
def test_the_caption_claims_what_holds(name: str, tmp_path: Path) -> None:
    """The page of counts is drawn, and its caption says what kind of mean that is."""
    bright = {"photons_per_pulse": 3e8, "cycles": 20_000, "repetition_rate_mhz": 5}
    config = config_from_mapping(
        {
            "name": name,
            "seed": 2,
            "scenes": 1,
            "capture": {"scan": {"rows": 2, "columns": 2}, "time": {"bins": 64, "bin_width_ps": 800}},
            "transport": {"samples": 64},
            "detector": bright | DETECTORS[name],
            # Nothing left out: a detector without its dead time, say, may have an exact mean.
            "effects": {"tolerance": 0},
            "store": {"fields": ["histogram", "transient"]},
        }
    )
    build(config, tmp_path / "set.zarr", progress=False)
    stored = read_scene(tmp_path / "set.zarr", 0)
    again = replay(stored)
    with house_style():
        (figure,) = dict(pages(stored, again, ["histogram"])).values()
        assert save_png(figure, tmp_path / "histogram.png").stat().st_size > 0
    text = figure.axes[0].texts[0].get_text().replace("\n", " ")
    assert again.mean_is_exact is (name == "lab_si")
    assert ("approximate mean" in text) is not again.mean_is_exact
    np.testing.assert_array_equal(again.counts, stored.arrays["histogram"])
    # The mean is that of these counts: 5 % in the total is far above its spread here, and above the approximation.
    assert again.counts.sum() == pytest.approx(again.expected.sum(), rel=0.05, abs=30)
