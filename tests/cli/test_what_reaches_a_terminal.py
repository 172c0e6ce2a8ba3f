"""Names in files, configurations and datasets do not steer a terminal, and do not begin lines of their own."""

from __future__ import annotations

import json
import unicodedata
from pathlib import Path

import pytest
import yaml
from damage import reseal, small_dataset

from datagen.building import plan as planning
from datagen.building.plan import Pilots
from datagen.building.progress import Progress
from datagen.cli import run
from datagen.config import config_from_mapping
from datagen.config.device import FOLDER
from datagen.errors import as_line, printable
from datagen.store import schema_of

# ESC and other C0 codes, C1 codes, the bidi controls, what joins or has no width, ends of lines of all kinds.
STEERING = "\x1b[31m\x07\x08\r\x9b2J\x85\u202e\u2066\u200b\u2028\ufeff\x7f\x00"
NAME = f"a{STEERING}b\nall as written"


def shown(capsys: pytest.CaptureFixture[str]) -> str:
    """What a command has printed, after a check that nothing in it steers."""
    text = "".join(capsys.readouterr())
    wrong = [ascii(c) for c in text if c != "\n" and unicodedata.category(c)[0] == "C"]
    assert not wrong and "\u2028" not in text, wrong
    assert not any(line.startswith("all as written") for line in text.split("\n"))
    return text


def test_one_place_makes_text_harmless() -> None:
    assert as_line(NAME).isprintable() and printable(STEERING).isprintable()
    assert as_line("one\r\ntwo") == "one two" and printable("one\ntwo") == "one\ntwo"
    assert printable("漢字 é − σ") == "漢字 é − σ"


def test_plan_prints_names_as_they_are_and_harmless(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / f"c{STEERING.replace(chr(0), '')}.yaml"
    path.write_text(json.dumps({"name": NAME[:100], "description": STEERING, "scenes": 1}))
    parameters = {
        "detector.pde": 0.3, "exposure.cycles": 10, "exposure.repetition_rate_hz": 1e7, "sampler.flux_per_cycle": 0.1,
        "sampler.detections": 1.0, "sampler.name": NAME, "effect.afterpulsing.kind": NAME,
        "effect.afterpulsing.on": True, "effect.afterpulsing.estimate": 0.1, "transient.relative_error": 0.1,
        f"evidence.{NAME}.significance": 4.0,
    }  # fmt: skip
    stored = dict.fromkeys([*schema_of(config_from_mapping({})).by_name, "record"], 9.0)
    pilots = Pilots(({"transport": 1.0, NAME: 1.0},), (parameters,), stored, {1: NAME})
    monkeypatch.setattr(planning, "simulated_scenes", lambda *_: pilots)
    monkeypatch.setattr(planning, "check_inputs", lambda _: None)
    assert run(["plan", str(path)]) == 0
    text = shown(capsys)
    assert "a\\x1b[31m" in text and "\\x9b2J" in text and "\\u202e" in text
    assert run(["plan", str(path.with_name(path.name + "x"))]) == 2
    assert "no such file" in shown(capsys)


def test_commands_on_a_dataset_of_such_names(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    root = tmp_path / f"set{STEERING.replace(chr(0), '')}\nall as written"
    small_dataset(root)
    reseal(root / "dataset.json", lambda values: values["config"].update(name=NAME, description=STEERING))
    reseal(root / "build/shard-000001.json", lambda values: values["scenes"][0].update(failure=NAME))
    for command, status in (("info", 0), ("verify", 1), ("digest", 0)):
        assert run([command, str(root)]) == status
        assert shown(capsys)
    assert run(["show", str(root), "99"]) == 2
    shown(capsys)


def test_progress_of_a_build(capsys: pytest.CaptureFixture[str]) -> None:
    progress = Progress(True)
    progress.say(NAME)
    progress.close()
    assert "a\\x1b[31m" in shown(capsys)


def test_a_device_of_such_a_name(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    values = yaml.safe_load((FOLDER / "tmf8820.yaml").read_text())
    (tmp_path / "d.yaml").write_text(json.dumps(values | {"description": NAME}))
    assert run(["device", str(tmp_path / "d.yaml")]) == 0
    shown(capsys)
