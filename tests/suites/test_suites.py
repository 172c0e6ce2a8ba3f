"""Suites: their names, the comparison with what is published of them, and the command."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from datasets import write_dataset

import datagen as dg
from datagen.cli import run
from datagen.config import config_from_mapping
from datagen.config.yaml_text import parse_yaml
from datagen.store import read_manifest
from datagen.suites import catalogue, published
from datagen.suites.building import is_published, suite_of
from datagen.suites.catalogue import SUITES, Suite
from datagen.suites.published import Published, check_agreement, published_of

pytestmark = pytest.mark.usefixtures("builds_here")

TINY = """
name: tiny-1
scenes: 10
scene: {layout: {kind: isolated_wall}, contents: [{kind: box}]}
capture: {scan: {rows: 2, columns: 2}, time: {bins: 32, bin_width_ps: 800}}
transport: {samples: 512}
labels: {rows: 4, columns: 4, voxels: [2, 2, 2]}
store: {fields: [histogram, depth]}
splits: {train: 0.6, val: 0.1, test: 0.3}
"""


def test_rooms_of_every_suite_are_the_published_ones() -> None:
    """Where they change by intention the suite gets another number, and `tools/publish_suites.py` publishes it."""
    assert len(SUITES) == 9
    for name, suite in SUITES.items():
        config = suite.config
        assert re.fullmatch(r"[a-z]+-\d+", name) and config.name == name
        assert len(published_of(suite).scenes) == published.SCENES
        fields, images = set(config.store.fields), {"depth", "part_id", "occupancy"}
        assert {"histogram", "objects"} <= fields
        # Neither sequences nor single objects, of which class, height and place are asked, are scored by images.
        assert images <= fields or not images & fields
        assert config.splits.shares == (0.6, 0.1, 0.3)
        # Seeds are not shared, so that no room is in two sets.
        assert sum(other.config.seed == config.seed for other in SUITES.values()) == 1
        for index, scene in enumerate(published_of(suite).scenes):
            own = published.room_of(config, index)
            assert own.keys() == scene.room.keys()
            for key, value in scene.room.items():
                due = pytest.approx(value, rel=1e-9, abs=1e-9) if isinstance(value, float) else value
                assert own[key] == due, (name, key)


@pytest.fixture(scope="module")
def built(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A tiny suite: its configuration, its published scenes, and the dataset."""
    folder = tmp_path_factory.mktemp("suites")
    (folder / "tiny-1.yaml").write_text(TINY)
    config = dg.load_config(folder / "tiny-1.yaml")
    published.publish(config).write(folder / "tiny-1.json")
    dg.build(config, folder / "built", progress=False)
    return folder


@pytest.fixture
def tiny(built: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setattr(catalogue, "FOLDER", built)
    monkeypatch.setitem(SUITES, "tiny-1", Suite("tiny-1"))
    return built


def test_the_published_set_is_known(tiny: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["suite", "tiny-1", str(tiny / "built"), "--quiet"]) == 0
    line = capsys.readouterr().out
    assert "tiny-1, 10 scenes (train 6, val 1, test 3)" in line and "agrees with the published set" in line
    result = dg.build_suite("tiny-1", tiny / "built", progress=False)
    assert result.difference <= result.allowed
    found = suite_of(read_manifest(tiny / "built"))
    assert found is not None and found.name == "tiny-1"
    assert is_published(tiny / "built", read_manifest(tiny / "built"))


def test_light_within_its_claim_agrees_and_other_light_does_not(tiny: Path, tmp_path: Path) -> None:
    """Of four times as many rays, and so of other last digits; and of half the pulses."""
    config = dg.load_config(tiny / "tiny-1.yaml")
    known = Published.read(tiny / "tiny-1.json")
    finer = config.model_copy(update={"transport": config.transport.model_copy(update={"samples": 2048})})
    agreement = check_agreement(write_dataset(finer, tmp_path / "finer"), known)
    assert 0 < agreement.difference <= agreement.allowed < 0.3
    shorter = config.model_copy(update={"detector": config.detector.model_copy(update={"cycles": 5e5})})
    with pytest.raises(
        dg.CheckError, match=r"first 4 scenes are (49|50|51)\.\d% off those published by datagen .* allow"
    ):
        check_agreement(write_dataset(shorter, tmp_path / "shorter"), known)


def test_rooms_agree_to_rounding(tiny: Path) -> None:
    known = Published.read(tiny / "tiny-1.json")
    first, second = known.scenes[:2]

    def moved(by: float) -> Published:
        room = second.room | {"layout.height_m": float(second.room["layout.height_m"]) * (1 + by)}
        return replace(known, scenes=(first, replace(second, room=room)))

    check_agreement(tiny / "built", moved(1e-12))
    word = next(name for name, value in second.room.items() if isinstance(value, str))
    other = replace(known, scenes=(first, replace(second, room=second.room | {word: "another"})))
    with pytest.raises(dg.CheckError, match=rf"scene 1 has another room .*: {word} = .*, published another"):
        check_agreement(tiny / "built", other)
    moved(1e-6).write(tiny / "tiny-1.json")
    try:
        with pytest.raises(dg.CheckError, match=r"scene 1 has another room than published .*: layout\.height_m = "):
            dg.build_suite("tiny-1", tiny / "built", progress=False)
        assert not is_published(tiny / "built", read_manifest(tiny / "built"))
    finally:
        known.write(tiny / "tiny-1.json")


def test_ways_of_sequences_agree(tmp_path: Path) -> None:
    """Which the drawn numbers of a room do not tell."""
    config = config_from_mapping({
        **parse_yaml(TINY, "tiny"), "scenes": published.SCENES, "sequence": {"frames": 3, "rate_hz": 4},
        "scene": {"layout": {"kind": "isolated_wall"},
                  "contents": [{"kind": "box", "motion": {"kind": "walk", "speed_m_s": 0.5}}]},
        "transport": {"target": 0.2}, "detector": {"cycles": 20_000, "photons_per_pulse": 1e9},
        "store": {"fields": ["histogram", "objects"]},
    })  # fmt: skip
    known = published.publish(config)
    built = write_dataset(config, tmp_path / "built")
    agreement = check_agreement(built, known)
    assert 0 < agreement.difference <= agreement.allowed < 0.5
    centers = [np.reshape(scene.ways, (3, -1, 3))[:, 0] for scene in known.scenes]
    assert all(np.linalg.norm(np.diff(of, axis=0), axis=1) == pytest.approx(0.125, abs=0.03) for of in centers)
    backward = tuple(centers[1][::-1].ravel().tolist())
    other = replace(known, scenes=(known.scenes[0], replace(known.scenes[1], ways=backward)))
    with pytest.raises(dg.CheckError, match="objects of scene 1 go other ways than published by datagen"):
        check_agreement(built, other)


def test_another_number_of_scenes_or_division_is_no_published_suite(tiny: Path) -> None:
    manifest = read_manifest(tiny / "built")
    config = manifest.config
    others = {"scenes": 11}, {"splits": {**config["splits"], "val": 0.2, "test": 0.2}}, {"name": "mine"}, {"seed": 5}
    assert suite_of(manifest) is not None
    assert [suite_of(replace(manifest, config=config | other)) for other in others] == [None] * 4


def test_the_command_lists_and_refuses(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    assert run(["suite"]) == 0
    listed = capsys.readouterr().out
    assert all(name in listed and parse_yaml(suite.path.read_text(), "")["description"] in listed
               for name, suite in SUITES.items())  # fmt: skip
    for arguments, piece in (
        (["suite", "leters-1", str(tmp_path / "x")], "no such suite; did you mean 'letters-1'?"),
        (["suite", "letters-1"], "missing argument 'OUT'"),
        (["suite", "letters-1", str(tmp_path / "x"), "--workers", "0"], "--workers 0: must be ≥ 1"),
    ):
        assert run(arguments) == 2
        err = capsys.readouterr().err
        assert piece in err and err.count("\n") == 1, err
    assert not any(tmp_path.iterdir())
