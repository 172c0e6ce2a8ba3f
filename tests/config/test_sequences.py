"""The keys `sequence` and `motion`."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest
from jsonschema import Draft202012Validator

import datagen as dg
from datagen.cli import run
from datagen.config import config_from_mapping, fingerprint_of, json_schema
from datagen.config.detector import USUAL_REPETITION_RATE_HZ
from datagen.config.sequence import sequence_said
from datagen.errors import InputError

SEQUENCE = {"frames": 16, "rate_hz": 10}
DETECTOR = {"cycles": 3000}
POINT = {"time_s": 0, "along": 0.5, "across": 0.5}
MOTIONS: list[dict[str, Any]] = [
    {"kind": "walk", "speed_m_s": {"uniform": [0.5, 1.5]}, "leg_m": {"uniform": [0.5, 2.5]}},
    {"kind": "straight", "speed_m_s": 0.5, "turning_deg_s": 30},
    {"kind": "points", "points": [POINT, {"time_s": 0.8, "distance_m": 1.5, "offset_m": {"uniform": [0, 0.5]}}]},
    {"kind": "jump"},
]


def moving(motion: Any, **item: Any) -> dict[str, Any]:
    scene = {"contents": [{"kind": "library", "classes": ["mannequin"], "motion": motion, **item}, {"kind": "box"}]}
    return {"sequence": SEQUENCE, "detector": DETECTOR, "scene": scene}


def without_sequence(values: dict[str, Any]) -> dict[str, Any]:
    return {key: value for key, value in values.items() if key != "sequence"}


@pytest.mark.parametrize("motion", MOTIONS, ids=lambda motion: motion["kind"])
def test_what_is_written_is_stored_and_read_again(motion: dict[str, Any]) -> None:
    config = config_from_mapping(moving(motion))
    stored = config.model_dump(mode="json")
    assert stored["sequence"] == {**SEQUENCE, "order": "raster"}
    assert stored["scene"]["contents"][0]["motion"]["kind"] == motion["kind"]
    assert "motion" not in stored["scene"]["contents"][1]
    assert config_from_mapping(json.loads(config.model_dump_json())) == config
    Draft202012Validator(json_schema()).validate(moving(motion))
    assert config.clock == dg.Clock(16, 10, "raster", columns=16)


def test_settings_of_scenes_that_stand_are_as_they_were() -> None:
    """Datasets of format 1 have neither key in their settings, nor in what their fingerprint is taken of."""
    config = config_from_mapping({})
    stored = config.model_dump(mode="json")
    assert "sequence" not in stored and "motion" not in json.dumps(stored)
    assert "sequence" not in config.model_dump_json() and "motion" not in config.model_dump_json()
    assert config.fingerprint() == fingerprint_of(stored, {})
    written = json.loads((Path(__file__).parents[1] / "regression/format_1/dataset/dataset.json").read_text())
    old = config_from_mapping(written["config"], look_for_files=False)
    assert old.model_dump(mode="json") == written["config"]
    assert config_from_mapping({**stored, "sequence": None}) == config and config.clock is None
    fingerprints = {config_from_mapping(values).fingerprint() for values in (
        {"detector": DETECTOR}, {"detector": DETECTOR, "sequence": SEQUENCE}, *map(moving, MOTIONS))}  # fmt: skip
    assert len(fingerprints) == 2 + len(MOTIONS)


SCAN = {"kind": "circle", "count": 4}
REFUSED: list[tuple[dict[str, Any], str]] = [
    (without_sequence(moving(MOTIONS[0])), "scene.contents[0].motion without sequence"),
    ({"sequence": 16}, "sequence = 16: a mapping is needed"),
    ({"sequence": {"frames": 16}}, "sequence.rate_hz: missing"),
    ({"sequence": {**SEQUENCE, "frames": 1}}, "sequence.frames = 1"),
    ({"sequence": {**SEQUENCE, "frames": 1.5}}, "sequence.frames = 1.5"),
    ({"sequence": {**SEQUENCE, "rate_hz": 0}}, "sequence.rate_hz = 0"),
    ({"sequence": {**SEQUENCE, "rate_hz": -1}}, "sequence.rate_hz = -1"),
    ({"sequence": {**SEQUENCE, "order": "random"}}, "sequence.order = 'random'"),
    ({"sequence": {**SEQUENCE, "fps": 3}}, "sequence.fps: unknown key"),
    ({"sequence": {**SEQUENCE, "order": "serpentine"}, "capture": {"scan": SCAN}}, "which has no rows"),
    ({"sequence": {**SEQUENCE, "order": "interleaved"}, "capture": {"scan": SCAN}}, "which has no rows"),
    ({"sequence": SEQUENCE}, "3906 cycles (0.3906 ms at 10 MHz) of detector.cycles fit, or lower rate_hz to 0.03906"),
    ({"sequence": SEQUENCE, "detector": {"cycles": {"uniform": [1, 3907]}}}, "sequence.rate_hz = 10: a frame lasts"),
    (moving("walk"), "motion = 'walk': a mapping is needed with the key kind, one of walk, straight, points, jump"),
    (moving({"kind": "wlk"}), "did you mean 'walk'?"),
    (moving({"kind": "walk", "speed": 1}), "motion.speed: unknown key; did you mean 'speed_m_s'?"),
    (moving({"kind": "walk", "speed_m_s": 0}), "motion.speed_m_s: 0 given; must be > 0"),
    (moving({"kind": "walk", "leg_m": {"uniform": [0, 2]}}), "motion.leg_m: 0 … 2 given"),
    (moving({"kind": "walk", "turning_deg_s": 0}), "motion.turning_deg_s: 0 given"),
    (moving({"kind": "straight", "speed_m_s": -1}), "motion.speed_m_s: -1 given; must be ≥ 0"),
    (moving({"kind": "points", "points": []}), "motion.points"),
    (moving({"kind": "points", "points": [{"time_s": 0, "along": 0.5}]}), "across, offset_m: one of them is needed"),
    (moving({"kind": "points", "points": [{**POINT, "distance_m": 1}]}), "along, distance_m: one of them"),
    (moving({"kind": "points", "points": [{**POINT, "along": 1.5}]}), "along: 1.5 given"),
    (moving({"kind": "points", "points": [{**POINT, "time_s": -1}]}), "points[0].time_s = -1"),
    (moving({"kind": "points", "points": [POINT, POINT]}), "points[1].time_s = 0 after 0: times must increase"),
    (moving({"kind": "points", "points": [POINT]}, along=0.3), "along beside motion of kind points"),
    (moving({"kind": "points", "points": [POINT]}, distance_m=1), "distance_m beside motion of kind points"),
    (moving({"kind": "walk"}, placement="wall"), "placement = 'wall' with motion of kind walk"),
]


@pytest.mark.parametrize(("values", "words"), REFUSED)
def test_wrong_values_are_refused_in_one_line(values: dict[str, Any], words: str) -> None:
    with pytest.raises(InputError) as caught:
        config_from_mapping(values, "walks.yaml")
    message = str(caught.value)
    assert message.startswith("walks.yaml: ") and words in message and "\n" not in message


def test_the_exposure_is_that_of_the_detector() -> None:
    """What the configuration takes for the usual rate of pulses is that of `Exposure`; the clock that draws the times
    refuses what the configuration refuses."""
    assert dg.Exposure().repetition_rate_hz == USUAL_REPETITION_RATE_HZ
    for keys, fits in (
        ({"cycles": 3906}, True), ({"cycles": 3907}, False), ({"cycles": 5859, "repetition_rate_mhz": 15}, True),
        ({"cycles": 5860, "repetition_rate_mhz": 15}, False),
    ):  # fmt: skip
        values = {"sequence": SEQUENCE, "detector": keys}
        if fits:
            config_from_mapping(values)
        else:
            with pytest.raises(InputError, match=r"sequence\.rate_hz = 10"):
                config_from_mapping(values)
    together = {"sequence": {**SEQUENCE, "order": "together"}, "detector": {"cycles": 1_000_000}}
    assert config_from_mapping(together).clock == dg.Clock(16, 10, "together", columns=16)


@pytest.mark.parametrize("command", [["build", "{config}", "{out}"], ["plan", "{config}"]])
@pytest.mark.parametrize(
    ("detector", "words"),
    [
        ({"detector_class": "consumer_dtof", "cycles": 10**6}, "sequence.rate_hz = 10: a frame lasts 100 ms"),
        ({"cycles": 20, "mode": "free_running"}, "detector.cycles = 20: in a sequence exposures of 2 µs"),
    ],
)
def test_what_cannot_be_measured_is_refused_before_anything_is_made(
    command: list[str], detector: dict[str, Any], words: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Of an exposure that is drawn it shows when it is drawn."""
    config, out = tmp_path / "walks.yaml", tmp_path / "out.zarr"
    config.write_text(json.dumps({**moving({"kind": "walk"}), "detector": detector, "scenes": 2}))
    assert run([part.format(config=config, out=out) for part in command]) == 2
    said = capsys.readouterr()
    assert words in said.err.strip().splitlines()[-1] and not said.out
    assert not out.exists()


@pytest.mark.parametrize(("order", "illumination", "motion", "said"), [
    ("serpentine", "scan", None, "5 a second, laser points in the order serpentine"),
    ("together", "scan", None, "5 a second, all laser points at once"),
    ("raster", "flood", {"kind": "drive"}, "5 a second, all laser points at once; the sensor moves (drive)"),
])  # fmt: skip
def test_it_is_said_how_frames_are_measured(
    order: str, illumination: str, motion: dict[str, Any] | None, said: str
) -> None:
    capture = {"illumination": illumination} | ({} if motion is None else {"motion": motion})
    assert sequence_said({"order": order, "rate_hz": 5.0}, capture) == said
