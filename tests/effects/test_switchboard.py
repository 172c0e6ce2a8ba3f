"""The switchboard: effects switched off are not simulated, effects switched on always are; decisions are stored and
repeatable, bad settings are refused in one line, and scenes as decided keep the promise of `promise.py`."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from here_and_now import one_worker_here
from promise import EVERYTHING, run_case
from promise_cases import nearly_everything_skipped, nearly_nothing_skipped, random_case

from datagen.building.build import build
from datagen.capture import capture_for
from datagen.config import DatasetConfig, EffectsConfig, config_from_mapping, load_config
from datagen.detector import Exposure, Spad, detect
from datagen.effects import EFFECTS, decide_detector_effects, decide_transport_effects, plan_effects
from datagen.errors import InputError
from datagen.pipeline import simulate_sample
from datagen.records import TimeAxis
from datagen.report.replay import read_scene, replay
from datagen.scene import generate_scene
from datagen.store.info import info
from datagen.transport import simulate

NAMES = [row.name for row in EFFECTS]
AXIS = TimeAxis(64, 0.2e-9, 0.0, "wall")


def switched(**settings: object) -> EffectsConfig:
    return EffectsConfig.model_validate(settings)


def small(**sections: object) -> DatasetConfig:
    given: dict[str, Any] = {
        "capture": {"scan": {"kind": "grid", "rows": 3, "columns": 3}, "time": {"bins": 64, "bin_width_ps": 400}},
        "transport": {"samples": 256, "max_bounces": 5, "direct": True},
        "detector": {"mode": "synchronous", "afterpulse_probability": 0.05, "photons_per_pulse": 1e6, "cycles": 1000},
        "store": {"fields": ["histogram", "transient"]},
    }
    return config_from_mapping(given | sections)


def test_every_setting_has_a_row_and_every_row_a_setting() -> None:
    assert set(NAMES) == set(EffectsConfig.model_fields) - {"tolerance"}
    assert len({row.title for row in EFFECTS}) == len(EFFECTS) == 12
    for row in EFFECTS:
        assert 0 <= row.saves < 1
        assert (row.saves == 0) is (row.change is None), "what saves nothing is not decided"


def world_of(config: DatasetConfig) -> tuple[Any, Any, Any]:
    scene = generate_scene(config.scene, config.seed, 0)
    return scene, capture_for(config, scene, config.seed, 0), config.transport.accuracy()


def test_bounces_off_are_not_followed() -> None:
    scene, capture, accuracy = world_of(small())
    settings = switched(secondary_bounce="off", higher_bounces="off", direct_return="off")
    decided = decide_transport_effects(scene, capture, accuracy, settings)
    reduced_scene, reduced = decided.apply_transport(scene, capture, accuracy)
    assert set(simulate(reduced_scene, capture, reduced, seed=1).components) == {"primary"}


def test_air_off_is_no_part_of_the_scene() -> None:
    scene, capture, accuracy = world_of(small(scene={"attenuation_per_m": 0.05}))
    decided = decide_transport_effects(scene, capture, accuracy, switched(attenuation="off"))
    assert scene.attenuation_per_m > 0 == decided.apply_transport(scene, capture, accuracy)[0].attenuation_per_m


FULL = Spad(
    dark_count_rate_hz=1e4, dead_time_s=30e-9, jitter_fwhm_s=3e-10, afterpulse_probability=0.05,
    crosstalk_probability=0.02, array_columns=2, gate_start_s=2e-9, gate_width_s=8e-9, counter_max=3,
    tdc_dnl=0.2, tdc_period_bins=32,
)  # fmt: skip
LIT = Exposure(repetition_rate_hz=50e6, cycles=1000, photons_per_pulse=3e6, ambient_rate_hz=1e6, pulse_fwhm_s=2e-10)
SIGNAL = np.abs(np.sin(np.arange(4 * 64).reshape(1, 4, 64))) * 1e-8


@pytest.mark.parametrize(
    "effect",
    ["timing_response", "pile_up", "dead_time_across_cycles", "afterpulsing", "crosstalk", "gate", "tdc_nonlinearity",
     "tdc_saturation"],
)  # fmt: skip
def test_detector_effects_off_are_not_there(effect: str) -> None:
    settings = switched(**(dict.fromkeys(NAMES, "on") | {"dead_time_across_cycles": "off"} | {effect: "off"}))
    decided = decide_detector_effects(SIGNAL, AXIS, FULL, LIT, settings)
    spad, exposure, tolerance = decided.apply_detector(FULL, LIT, 1e-3)
    assert tolerance == 0.0
    gone = {
        "timing_response": exposure.pulse_fwhm_s + spad.jitter_fwhm_s,
        "pile_up": spad.dead_time_s, "tdc_saturation": spad.counter_max or 0,
        "dead_time_across_cycles": spad.mode == "free_running", "afterpulsing": spad.afterpulse_probability,
        "crosstalk": spad.crosstalk_probability, "tdc_nonlinearity": spad.tdc_dnl,
    }  # fmt: skip
    assert gone.get(effect, 0) == 0
    counts = detect(SIGNAL, AXIS, spad, exposure, tolerance=tolerance)
    assert bool(counts.max() > 3) is (effect == "tdc_saturation")
    # The gate opens in bin 10; jitter and the uneven TDC put records a few bins before it.
    assert bool(counts[..., :6].sum() > 0) is (effect == "gate")


def test_forced_settings_need_no_trial_run() -> None:
    scene, capture, accuracy = world_of(small(transport={"samples": 65536, "max_bounces": None}))
    kinds = [
        {d.kind for d in plan_effects(scene, capture, accuracy, settings=s).decisions} for s in (EVERYTHING, None)
    ]
    assert kinds[0] <= {"forced", "absent"} and "trial" in kinds[1]


def test_decisions_are_stored_with_samples() -> None:
    sample = simulate_sample(small(effects={"timing_response": "off", "tolerance": 0.02}), 0)
    assert sample.parameters["effect.timing_response.on"] is False
    assert sample.parameters["effect.timing_response.kind"] == "forced"
    assert sample.parameters["effect.crosstalk.kind"] == "absent"
    assert sample.parameters["effect.afterpulsing.on"] is True
    assert sample.parameters["effect.afterpulsing.kind"] == "always"
    assert "effect.afterpulsing.estimate" not in sample.parameters
    assert sample.parameters["sampler.name"] == "events"
    assert sample.parameters["detector.dark_count_rate_hz"] == 100
    assert {f"effect.{name}.on" for name in NAMES} <= set(sample.parameters)


def test_stored_decisions_are_shown_and_repeated(tmp_path: Path) -> None:
    config = small(scenes=1, effects={"secondary_bounce": "off", "direct_return": "on", "higher_bounces": "off"})
    with one_worker_here():
        build(config, tmp_path / "set", progress=False)
    lines = {line.split()[0]: line.split()[1:] for line in info(tmp_path / "set").splitlines() if line.strip()}
    assert lines["secondary_bounce"] == ["0", "1", "configuration"]
    assert lines["direct_return"] == ["1", "0", "configuration"]
    again = replay(read_scene(tmp_path / "set", 0))
    assert again.reproduced and set(again.transient.components) == {"direct", "primary"}


@pytest.mark.parametrize(
    ("effects", "says"),
    [
        ({"tolerance": -0.1}, "effects.tolerance = -0.1: input should be greater than or equal to 0"),
        ({"tolerance": 2}, "effects.tolerance = 2"),
        ({"pile_up": "maybe"}, "effects.pile_up = 'maybe': input should be 'auto', 'on' or 'off'"),
        ({"gate": 3}, "effects.gate = 3"),
        ({"pileup": "on"}, "did you mean 'pile_up'?"),
        ({"secondary_bounce": 0}, "effects.secondary_bounce"),
        ({"pile_up": "off", "dead_time_across_cycles": "on"}, "set pile_up to 'on' or 'auto'"),
    ],
)
def test_bad_settings_get_one_line(effects: dict[str, Any], says: str) -> None:
    with pytest.raises(InputError) as caught:
        config_from_mapping({"effects": effects})
    assert says in str(caught.value)
    assert "\n" not in str(caught.value)


def test_yaml_words_on_and_off_are_understood(tmp_path: Path) -> None:
    """YAML 1.1 takes them for true and false."""
    path = tmp_path / "a.yaml"
    path.write_text("effects: {gate: off, pile_up: on, attenuation: auto, secondary_bounce: off}\n")
    effects = load_config(path).effects
    assert (effects.gate, effects.pile_up, effects.attenuation) == ("off", "on", "auto")
    assert effects.secondary_bounce == "off"
    again = config_from_mapping(json.loads(load_config(path).model_dump_json()))
    assert again.effects == effects


@pytest.mark.parametrize("index", range(3))
def test_random_scenes_keep_the_promise(index: int) -> None:
    """Other scenes than those that `benchmarks/promise_table.py` measures."""
    outcome = run_case(random_case(index, seed=77, samples=128))
    assert outcome.broken(0.01) == []


def test_extreme_scenes_keep_the_promise() -> None:
    most = run_case(nearly_everything_skipped(samples=2048))
    assert most.broken(0.01) == []
    decided = [row.name for row in EFFECTS if row.saves > 0]
    assert [most.states[name] for name in decided] == ["off"] * len(decided)
    least = run_case(nearly_nothing_skipped(samples=128))
    assert least.broken(0.01) == []
    assert "off" not in least.states.values()
