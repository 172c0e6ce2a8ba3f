"""Suites: their names and digests, the comparison with the published bytes, and the command."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import pytest

import datagen as dg
from datagen.cli import run
from datagen.config.yaml_text import parse_yaml
from datagen.store import read_manifest
from datagen.store.verify import dataset_digest
from datagen.suites import SUITES, Suite, catalogue, suite_of

TINY = """
name: tiny-1
scenes: 10
scene: {layout: {kind: isolated_wall}, contents: [{kind: box}]}
capture: {scan: {rows: 2, columns: 2}, time: {bins: 32, bin_width_ps: 800}}
transport: {lookins: 32, fov_samples: 1, replicates: 2}
labels: {rows: 4, columns: 4, voxels: [2, 2, 2]}
store: {fields: [histogram, depth]}
splits: {train: 0.6, val: 0.1, test: 0.3}
"""


def test_names_carry_versions_and_every_digest_is_pinned() -> None:
    assert set(catalogue.pinned()["digests"]) == set(SUITES) and len(SUITES) == 7
    for name, suite in SUITES.items():
        config = suite.config
        assert re.fullmatch(r"[a-z]+-\d+", name) and config.name == name
        assert re.fullmatch("[0-9a-f]{64}", suite.digest)
        assert {"histogram", "depth", "part_id", "occupancy", "objects"} <= set(config.store.fields)
        assert config.splits.shares == (0.6, 0.1, 0.3)
        # Light of the same name is the same for ever: seeds are not shared, so that no room is in two sets.
        assert sum(other.config.seed == config.seed for other in SUITES.values()) == 1


@pytest.fixture(scope="module")
def tiny(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, str]:
    """A folder with the configuration of a tiny suite, and the digest of its values."""
    folder = tmp_path_factory.mktemp("suites")
    (folder / "tiny-1.yaml").write_text(TINY)
    dg.build(dg.load_config(folder / "tiny-1.yaml"), folder / "built", progress=False)
    return folder, dataset_digest(folder / "built")


@pytest.fixture
def only_tiny(tiny: tuple[Path, str], monkeypatch: pytest.MonkeyPatch) -> Path:
    folder, digest = tiny
    monkeypatch.setattr(catalogue, "FOLDER", folder)
    monkeypatch.setitem(SUITES, "tiny-1", Suite("tiny-1", digest))
    return folder


def test_the_published_bytes_are_known(only_tiny: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["suite", "tiny-1", str(only_tiny / "built"), "--quiet"]) == 0
    line = capsys.readouterr().out
    assert "tiny-1, 10 scenes (train 6, val 1, test 3)" in line and "the published bytes" in line
    result = dg.build_suite("tiny-1", only_tiny / "built", progress=False)
    assert result.as_published and result.digest == dataset_digest(only_tiny / "built")
    found = suite_of(read_manifest(only_tiny / "built"))
    assert found is not None and found.name == "tiny-1"


def test_other_bytes_fail_and_say_why(
    only_tiny: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setitem(SUITES, "tiny-1", Suite("tiny-1", "0" * 64))
    monkeypatch.setattr(catalogue, "differing_versions", lambda: "numpy 1.0 (published with 2.0)")
    assert run(["suite", "tiny-1", str(only_tiny / "built"), "--quiet"]) == 1
    assert "made here with numpy 1.0 (published with 2.0)" in capsys.readouterr().err
    monkeypatch.setattr(catalogue, "differing_versions", lambda: "")
    with pytest.raises(dg.CheckError, match=r"published 000000000000.*one of the two is at fault"):
        dg.build_suite("tiny-1", only_tiny / "built", progress=False)


def test_versions_that_differ_are_named(monkeypatch: pytest.MonkeyPatch) -> None:
    there = catalogue.pinned()["made_with"]
    monkeypatch.setattr(catalogue, "made_with", lambda: there | {"numpy": "1.0", "machine": "riscv"})
    assert catalogue.differing_versions() == (
        f"numpy 1.0 (published with {there['numpy']}), machine riscv (published with {there['machine']})"
    )


def test_another_number_of_scenes_or_division_is_no_published_suite(only_tiny: Path) -> None:
    manifest = read_manifest(only_tiny / "built")
    grown = replace(manifest, schema=replace(manifest.schema, scenes=11))
    divided = replace(manifest, config=manifest.config | {"splits": {**manifest.config["splits"], "test": 0.1}})
    renamed = replace(manifest, config=manifest.config | {"name": "mine"})
    assert suite_of(manifest) is not None
    assert [suite_of(of) for of in (grown, divided, renamed)] == [None, None, None]


def test_the_command_lists_and_refuses(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    assert run(["suite"]) == 0
    listed = capsys.readouterr().out
    assert all(name in listed and parse_yaml(suite.path.read_text(), "")["description"] in listed
               for name, suite in SUITES.items())  # fmt: skip
    for arguments, piece in (
        (["suite", "leters-1", str(tmp_path / "x")], "no such suite; did you mean 'letters-10'?"),
        (["suite", "zzz"], "no such suite; there are letters-10"),
        (["suite", "letters-10"], "missing argument 'OUT'"),
        (["suite", "letters-10", str(tmp_path / "x"), "--workers", "0"], "--workers 0: must be ≥ 1"),
    ):
        assert run(arguments) == 2
        err = capsys.readouterr().err
        assert piece in err and err.count("\n") == 1, err
    assert not any(tmp_path.iterdir())
