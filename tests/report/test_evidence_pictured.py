"""A reader sees which object is in the data: in the pictures of a scene, and over the kinds of a dataset."""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
import pytest
from handmade_rooms import l_corridor
from matplotlib.figure import Figure
from test_show_pictures import replayed, scan, words

import datagen as dg
from datagen.evidence.own import significance_in_time
from datagen.records import Transient
from datagen.report.evidence_pictures import evidence_page, kinds_report, stated_significance, verdict
from datagen.report.explorer import scene_data
from datagen.report.replay import Replay, StoredScene
from datagen.report.style import house_style

SIGMA = {"pillar": 0.91, "box": 98.0}


def scene_of(parameters: dict[str, float], shares: dict[str, float] = SIGMA) -> tuple[StoredScene, Replay]:
    room = l_corridor()
    stored, again = replayed(room, scan(room))
    shape = np.exp(-(((np.arange(again.capture.time.bins) - 60) / 9.0) ** 2))
    own = {name: sigma * shape / np.sqrt((shape**2).sum()) for name, sigma in shares.items()}
    return replace(stored, parameters=parameters), replace(again, own=own)


def page(parameters: dict[str, float], shares: dict[str, float] = SIGMA) -> Figure:
    with house_style():
        figure = evidence_page(*scene_of(parameters, shares))
        assert figure is not None
        figure.set_dpi(40)
        figure.set_layout_engine("none")
        figure.canvas.draw()
    return figure


def known(**more: float) -> dict[str, float]:
    return {f"evidence.{name}.significance": sigma for name, sigma in SIGMA.items()} | more


def test_a_page_says_of_each_object_whether_it_is_in_the_data() -> None:
    parameters = known() | {"evidence.box.detections": 13_200.0, "evidence.pillar.detections": 69.0}
    said = words(page(parameters))
    assert "98 σ: in the data" in said and "13,200 detections" in said
    assert "0.91 σ: not in the data" in said and "Diamonds" not in said
    seen = words(page(parameters | {"evidence.pillar.presence": 9.0, "evidence.pillar.presence_floor": 2.0}))
    assert "0.91 σ: in the data by its shadow" in seen and "Diamonds" in seen
    unsure = words(page(parameters | {"evidence.pillar.presence": 9.0, "evidence.pillar.presence_floor": 13.0}))
    assert "0.91 σ: not in the data" in unsure


def test_a_dataset_without_evidence_shows_that_of_the_simulation() -> None:
    assert "98 σ: in the data" in words(page({}))
    stored, again = scene_of({})
    with house_style():
        assert evidence_page(stored, replace(again, own={})) is None
        # Nothing but what is stored, since the light is not known apart.
        assert evidence_page(replace(stored, parameters=known()), replace(again, own={})) is not None


def test_light_of_no_significance_looks_like_none() -> None:
    """Axes reach to 1 σ per bin at least, and to the top of what is more."""
    faint, bright = (
        page(known(), {"pillar": sigma, "box": sigma / 2}).axes[1].get_ylim()[1] for sigma in (0.9, 98.0)
    )
    assert faint == 1.0 and bright > 10.0


@pytest.mark.parametrize("seed", range(3))
def test_significance_in_time_adds_up(seed: int) -> None:
    rng = np.random.default_rng(seed)
    time = dg.TimeAxis(bins=40, width_s=2e-10)
    parts = {name: rng.random((3, 2, 40)) * 1e-12 for name in ("wall", "box")}
    nothing = np.zeros((3, 2, 40))
    t = Transient(time, {"primary": parts["wall"] + parts["box"]}, parts, nothing, nothing[..., 0], np.zeros((3, 3)))
    spad = dg.Spad(pde=0.4, mode="synchronous", dead_time_s=4e-8, jitter_fwhm_s=3e-10)
    exposure = dg.Exposure(cycles=10_000, photons_per_pulse=1e9)
    curve = significance_in_time(t, spad, exposure, ["box"])["box"]
    assert curve.shape == (40,)
    assert np.isclose((curve**2).sum(), dg.own_evidence(t, spad, exposure, ["box"])["box"].significance ** 2)


def test_words_follow_the_limits() -> None:
    assert [verdict(sigma) for sigma in (0.99, 1.0, 2.99, 3.0)] == [
        "not in the data",
        *2 * ["doubtful"],
        "in the data",
    ]


def test_kinds_are_counted_on_their_side_of_the_limit() -> None:
    scenes = [
        {"evidence.box.significance": sigma, "evidence.cone_2.significance": 50.0} for sigma in (0.5, 1.0, 20.0)
    ]
    box, cone = kinds_report(scenes).split("<p>")[1:]
    assert box.startswith("box: 1 σ in the median of 3, 67% under 3 σ")
    heights = {color: sum(float(h) for h in re.findall(rf'height="([\d.]+)" fill="{color}"', box)) for color in
               ("#A33030", "#0072B2")}  # fmt: skip
    assert heights["#A33030"] == pytest.approx(2 * heights["#0072B2"]) and heights["#0072B2"] > 0
    assert "#A33030" not in cone and cone.startswith("cone: 50 σ")
    assert kinds_report([{"evidence.ghost.significance": 0.0}]).count("<rect") == 2
    assert kinds_report([{"scene": 1.0}]) == ""


def test_the_explorer_has_it_beside_each_object() -> None:
    stored, again = scene_of(known())
    parts = {part["name"]: part for part in scene_data(stored, again.scene, None, None)["parts"]}
    assert parts["box"]["sigma"] == 98.0 and parts["pillar"]["sigma"] == 0.91 and "sigma" not in parts["relay_wall"]
    assert (
        stated_significance(replace(stored, parameters={"evidence.box.significance": float("nan")}), again.scene)
        == {}
    )
