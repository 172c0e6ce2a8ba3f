"""`datagen show` for every class of detector: where the mean is approximate it is drawn, and the page says so."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from datagen.cli import run
from datagen.report.pages import _histogram_caption
from datagen.report.replay import read_scene, replay

DETECTORS: dict[str, dict[str, Any]] = {
    "ideal": {"mode": "ideal"},
    "lab_si": {"detector_class": "lab_si", "mode": "synchronous", "afterpulse_probability": 0},
    "ingaas": {"detector_class": "ingaas", "mode": "free_running"},
    "si_array": {"detector_class": "si_array", "mode": "free_running"},
    "consumer_dtof": {"detector_class": "consumer_dtof", "mode": "synchronous"},
    "saturating": {"mode": "free_running", "counter_max": 3},
}
"""Name → section `detector`; those after lab_si have no exact mean."""
EXACT = ("ideal", "lab_si")


@pytest.fixture(scope="module", params=DETECTORS)
def built(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> tuple[str, Path]:
    name = request.param
    folder = tmp_path_factory.mktemp(name)
    bright = {"photons_per_pulse": 3e8, "cycles": 20_000, "repetition_rate_mhz": 5}
    config = {
        "schema_version": 1,
        "name": name,
        "seed": 2,
        "scenes": 1,
        "capture": {"scan": {"rows": 2, "columns": 2}, "time": {"bins": 64, "bin_width_ps": 800}},
        "transport": {"lookins": 64, "replicates": 2},
        "detector": bright | DETECTORS[name],
        # Nothing left out: a detector without its dead time, say, may have an exact mean.
        "effects": {"tolerance": 0},
        "store": {"fields": ["histogram", "transient"]},
    }
    (folder / "config.yaml").write_text(yaml.safe_dump(config))
    assert run(["build", str(folder / "config.yaml"), str(folder / "set.zarr")]) == 0
    return name, folder / "set.zarr"


def test_show_draws_pages_for_every_detector(built: tuple[str, Path]) -> None:
    name, dataset = built
    if name in EXACT or name == "saturating":
        pytest.skip("the class of detector makes no difference to the other pages, and they take seconds")
    out = dataset.parent / "pictures"
    assert run(["show", str(dataset), "0", "--out", str(out)]) == 0
    assert any("histogram" in path.name for path in out.rglob("*.png"))


def test_the_caption_claims_what_holds(built: tuple[str, Path]) -> None:
    name, dataset = built
    stored = read_scene(dataset, 0)
    again = replay(stored)
    text = _histogram_caption(stored, again)
    assert again.mean_is_exact is (name in EXACT)
    assert ("approximate mean" in text) is not again.mean_is_exact
    assert ("Poisson counts give" in text) is again.is_poisson
    assert again.is_poisson is (name == "ideal")
    np.testing.assert_array_equal(again.counts, stored.arrays["histogram"])
    # The mean is that of these counts: 5 % in the total is far above its spread here, and above the approximation.
    assert again.counts.sum() == pytest.approx(again.expected.sum(), rel=0.05, abs=30)
