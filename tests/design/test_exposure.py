"""The exposure for a requested evidence gives that evidence, under each kind of detector, and is the least that
does."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from small_measurement import measurement

import datagen as dg
from datagen.design import exposure
from datagen.design.light import estimated_evidence
from datagen.detector import detector_for
from datagen.pipeline import simulate_sample
from datagen.report.contact_sheet import first_scenes
from datagen.store import read_manifest

pytestmark = pytest.mark.usefixtures("builds_here")

DETECTORS: dict[str, dict[str, Any]] = {
    "ideal": {},
    "background": {"ambient_rate_hz": 1e5, "dark_count_rate_hz": 1e4},
    "one detection a cycle": {"mode": "synchronous", "photons_per_pulse": 2e10},
    "dead time": {"mode": "free_running", "dead_time_ns": 30, "photons_per_pulse": 2e10},
    "gate": {"gate": {"start_ns": 15, "width_ns": 20}},
    "another for each scene": {"detector_class": "any", "mode": "free_running"},
    "counters": {"counter_max": 2000, "photons_per_pulse": 1e10},
}


@pytest.fixture(autouse=True)
def few_objects(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(exposure, "OBJECTS", 6)


def significances(config: dg.DatasetConfig, scenes: int) -> np.ndarray:
    """Significances of all objects of the first scenes, each under its own detector."""
    found = []
    for index in range(scenes):
        scene = dg.scene_for(config, index)
        capture = dg.capture_for(config, scene, config.seed, index)
        detector = detector_for(config.detector, config.seed, index, capture.time)
        every = estimated_evidence(config, index, scene, capture, *detector)
        found += [of.significance for of in every.values()]
    return np.array(found)


def with_cycles(config: dg.DatasetConfig, cycles: float) -> dg.DatasetConfig:
    return config.model_copy(update={"detector": config.detector.model_copy(update={"cycles": cycles})})


@pytest.mark.parametrize(
    ("kind", "evidence", "quantile"),
    [
        *((kind, 10, 0.5) for kind in DETECTORS if kind not in ("background", "counters")),
        ("background", 3, 0.2),
        ("counters", 30, 0.5),
    ],
)
def test_the_exposure_is_the_least_that_gives_the_evidence(
    kind: str, evidence: float, quantile: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    """With N cycles at most a share of the objects has less; with N/1.1, below what N was rounded up from, more have.

    A significance grows with N as long as no counter is full.
    """
    monkeypatch.setattr(exposure, "OBJECTS", 12)
    request = {"evidence": evidence, "quantile": quantile, "longest_s": 1e3}
    found = dg.with_exposure_found(measurement({**DETECTORS[kind], "exposure_for": request}))
    cycles = found.detector.cycles
    assert isinstance(cycles, float) and cycles == float(f"{cycles:.2g}")
    assert np.mean(significances(found, 6) < evidence) <= quantile
    assert np.mean(significances(with_cycles(found, round(cycles / 1.1)), 6) < evidence) > quantile


def test_the_exposure_is_the_same_for_any_number_of_scenes() -> None:
    request = {"exposure_for": {"evidence": 5}}
    cycles = {dg.with_exposure_found(measurement(request, scenes=n)).detector.cycles for n in (4, 4, 100)}
    assert len(cycles) == 1


def test_a_dataset_holds_plain_cycles_and_its_own_configuration_builds_it_again(tmp_path: Path) -> None:
    """The same request resumes the build; another request is refused."""
    config = measurement({"exposure_for": {"evidence": 5}})
    dg.build(config.with_scenes(2), tmp_path / "a", progress=False)
    stored = read_manifest(tmp_path / "a").parsed_config()
    assert stored.detector.exposure_for is None and stored.detector.cycles > 1
    dg.build(stored.with_scenes(4), tmp_path / "b", progress=False)
    assert dg.build(config, tmp_path / "a", progress=False).kept == 0
    first, second = (sorted(p for p in (tmp_path / n / "data.zarr").rglob("*") if p.is_file()) for n in "ab")
    assert [p.read_bytes() for p in first] == [p.read_bytes() for p in second]
    with pytest.raises(dg.InputError, match=r"exposure is .*'evidence': 5.*name another folder"):
        dg.build(measurement({"exposure_for": {"evidence": 6}}), tmp_path / "a", progress=False)
    with pytest.raises(dg.InputError, match="cycles"):
        dg.build(measurement({"cycles": 77}), tmp_path / "a", progress=False)


def test_scenes_on_the_fly_are_those_of_the_dataset(tmp_path: Path) -> None:
    config = measurement({"exposure_for": {"evidence": 5}}, [{"kind": "box", "evidence_at_least": 4}])
    dg.build(config, tmp_path / "a", progress=False)
    data = dg.TransientDataset(tmp_path / "a", ("histogram",))
    for stored, made in zip(data, dg.GeneratedDataset(config, ("histogram",)), strict=True):
        assert (stored["histogram"] == made["histogram"]).all()
    # A contact sheet finds the exposure first, too.
    ((found, _),) = first_scenes([config], 1)
    assert np.array_equal(dg.scene_for(found, 0).vertices, dg.scene_for(dg.with_exposure_found(config), 0).vertices)


WALK = {"kind": "walk", "speed_m_s": 1.0}
MOVING: dict[str, Any] = {"contents": [{"kind": "box", "motion": WALK}], "sequence": {"frames": 6, "rate_hz": 2}}


def changes(config: dg.DatasetConfig, scenes: int) -> np.ndarray:
    """Changes by the objects of some sequences that move, as they are stored."""
    every = [simulate_sample(config, index).parameters for index in range(scenes)]
    return np.array([value for of in every for name, value in of.items() if name.endswith(".change")], float)


@pytest.mark.parametrize("pairs", [3, 2], ids=["all frames", "some of them"])
def test_the_exposure_is_that_which_makes_changes_visible(pairs: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """Within what some frames tell of all."""
    monkeypatch.setattr(exposure, "PAIRS", pairs)
    request = {"change": 4.0, "longest_s": 1e3}
    config = measurement({"exposure_for": request}, **MOVING, transport={"target": 0.05})
    found = dg.with_exposure_found(config)
    assert found.detector.found_for is not None and found.detector.found_for.change == 4.0
    assert found.detector.model_dump()["found_for"] == {"change": 4.0, "quantile": 0.5, "longest_s": 1e3}
    # Half of the six may have less. A shorter exposure than a frame lasts is a quarter of a metre earlier.
    assert np.sort(changes(found, 6))[3] == pytest.approx(4.0, rel=0.25 if pairs == 3 else 0.5)


def test_what_a_frame_has_no_time_for_is_refused() -> None:
    for request, words in (
        ({"change": 1e4}, r"\{change: 10000, .*s fit into a frame; lower sequence.rate_hz or change"),
        ({"evidence": 1e5}, r"\{evidence: 100000, .*s fit into a frame; lower sequence.rate_hz or evidence"),
    ):
        with pytest.raises(dg.InputError, match=words):
            dg.with_exposure_found(measurement({"exposure_for": request}, **MOVING))
    for asked in ({"change": 5}, {"change": 5, "evidence": 5}, {"longest_s": 1}):
        with pytest.raises(dg.InputError, match=r"nothing changes without sequence|one of them is needed"):
            measurement({"exposure_for": asked})


def test_evidence_of_a_sequence_is_found_where_objects_are_in_it() -> None:
    config = measurement({"exposure_for": {"evidence": 5}}, **MOVING)
    found = dg.with_exposure_found(config).detector
    scene = dg.scene_for(dg.with_exposure_found(config), 0)
    assert found.cycles <= 0.125 * 10e6 and scene.moving == ("box",)
    asking = measurement({"cycles": found.cycles}, [{"kind": "box", "motion": WALK, "evidence_at_least": 4}],
                         sequence=MOVING["sequence"])  # fmt: skip
    own = [simulate_sample(asking, index).parameters for index in range(3)]
    # The estimate is that of three moments, in coarse light.
    assert all(float(of["evidence.box.significance"]) > 3.5 and of["evidence.placed_anew"] >= 0 for of in own)


FOR = r"^detector\.exposure_for = \{evidence: .*"


@pytest.mark.parametrize(
    ("detector", "contents", "words"),
    [
        ({"exposure_for": {"evidence": 5}}, [], FOR + "none of the first 64 scenes has an object"),
        (
            {"exposure_for": {"evidence": 5}, "photons_per_pulse": 0},
            None,
            FOR + "no light is detected; raise photons",
        ),
        ({"exposure_for": {"evidence": 5}, "gate": {"start_ns": 45, "width_ns": 1}}, None, FOR + "move the gate"),
        ({"exposure_for": {"evidence": 1e5, "longest_s": 0.01}}, None, FOR + "s would be needed; raise longest_s"),
        ({"exposure_for": {"evidence": 1e3, "longest_s": 1e5}, "counter_max": 1}, None, FOR + "counters are full"),
        (
            {"exposure_for": {"evidence": 4e4, "longest_s": 1e5}, "photons_per_pulse": 1e10},
            None,
            FOR + "more than uint32 holds; set a wider",
        ),
        ({"exposure_for": {"evidence": 1e6, "longest_s": 1e6}}, None, FOR + "no exposure has more than"),
        ({"exposure_for": {"evidence": 5}, "cycles": 1000}, None, "exposure_for and cycles are both given"),
        ({"found_for": {"evidence": 5}}, None, "set exposure_for"),
        ({"exposure_for": {"evidence": 5, "quantile": 1}}, None, r"detector.exposure_for.quantile = 1"),
        ({"exposure_for": {"evidence": 0}}, None, r"detector.exposure_for.evidence = 0"),
    ],
)
def test_requests_that_cannot_be_met_are_refused_in_a_line(
    detector: dict[str, Any], contents: list[dict[str, Any]] | None, words: str
) -> None:
    with pytest.raises(dg.InputError, match=words) as refusal:
        dg.with_exposure_found(measurement(detector, contents))
    assert "\n" not in str(refusal.value)


def test_a_detector_without_exposure_is_refused_with_the_remedy() -> None:
    config = measurement({"exposure_for": {"evidence": 5}})
    with pytest.raises(dg.InputError, match=r"use dg\.with_exposure_found\(config\)"):
        detector_for(config.detector, 0, 0)
