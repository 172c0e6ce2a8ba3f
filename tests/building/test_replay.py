"""`datagen replay`: a stored scene made again, what is the same and what is not, and the stage where that begins."""

from __future__ import annotations

import json
import os
import pickle
import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from damage import reseal
from datasets import rewritten, write_dataset

import datagen as dg
from datagen import pipeline
from datagen.building import replay as module
from datagen.building.comparison import Again, Comparison
from datagen.building.resimulate import resimulate
from datagen.cli import run
from datagen.config import DatasetConfig, config_from_mapping
from datagen.design import light
from datagen.labels import make
from datagen.pipeline import STAGES, simulate_sample, stage_of_parameter
from datagen.records import Sample
from datagen.records.label_fields import LABEL_FIELDS
from datagen.seeding import Purpose
from datagen.store import read_manifest, schema_of, verify, write_shard
from datagen.store.scenes import Scenes

pytestmark = pytest.mark.usefixtures("builds_here")

FIELDS = ("histogram", "transient", "transient_stderr", "depth", "albedo", "objects", "evidence")
NAMES = [stage.name for stage in STAGES]


def config(**changes: Any) -> DatasetConfig:
    """Two scenes in one shard, of a scan of 2 × 2 points."""
    values = {
        "scenes": 2, "seed": 5, "scene": {"layout": {"kind": "isolated_wall"}, "contents": [{"kind": "box"}]},
        "capture": {"scan": {"rows": 2, "columns": 2}, "time": {"bins": 48, "bin_width_ps": 800}},
        "transport": {"target": 0.1}, "labels": {"rows": 8, "columns": 8, "voxels": [2, 2, 2]},
        "store": {"fields": list(FIELDS), "scenes_per_shard": 2},
    }  # fmt: skip
    return config_from_mapping(values | changes)


@pytest.fixture(scope="module")
def made() -> dict[int, Sample]:
    return {index: simulate_sample(config(), index) for index in range(2)}


@pytest.fixture(scope="module")
def built(made: dict[int, Sample], tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_dataset(config(), tmp_path_factory.mktemp("replay") / "set", lambda _, index: made[index])


@pytest.fixture(scope="module")
def again(built: Path) -> Again:
    """Scene 1, made again; it is sent from one process to another."""
    manifest = read_manifest(built)
    found: Again = pickle.loads(pickle.dumps(module.make_again(config(), manifest.schema, 1)))
    return found


@pytest.fixture(autouse=True)
def no_disk(monkeypatch: pytest.MonkeyPatch) -> None:
    """Nothing here is about power cuts."""
    monkeypatch.setattr(os, "fsync", lambda handle: None)


@pytest.fixture
def known(again: Again, monkeypatch: pytest.MonkeyPatch) -> None:
    """Scene 1 is made again once, for all tests that change what is stored."""
    monkeypatch.setattr(module, "make_again", lambda *_: again)


def stored_as(root: Path, sample: Sample | str, made: dict[int, Sample]) -> Path:
    """A dataset whose scene 1 is another sample, with a record of just that."""
    return write_dataset(config(), root, lambda _, index: sample if index == 1 else made[0])  # type: ignore[arg-type, return-value]


def elsewhere(root: Path) -> Path:
    """The dataset, as if another kind of processor had made it."""
    for record in (root / "build").glob("*.json"):
        reseal(record, lambda values: values["made_by"].update(processor="another"))
    return root


def verdicts(found: Comparison) -> dict[str, set[str]]:
    """Stage → verdicts of its rows."""
    return {stage: {row.verdict for row in found.rows if row.stage == stage} for stage in NAMES}


def changed(values: np.ndarray) -> np.ndarray:
    """Another value in the last place."""
    other = values.copy()
    place = (-1,) * other.ndim
    # Objects fill the first rows of their tables, and other rows are fill.
    other[place] = 1 if other[place] == 0 else other[place] * 2 if other.dtype.kind == "f" else other[place] + 1
    return other


def test_a_scene_is_the_same_as_stored(built: Path, made: Any, capsys: pytest.CaptureFixture[str]) -> None:
    """To the bit, and in the types in which it is stored."""
    assert run(["replay", str(built), "1"]) == 0
    out, err = capsys.readouterr()
    assert err == "" and "scene 1: made again from its configuration and seed 5\n" in out
    assert "this is     the same: all must be the same to the bit\n" in out or "of the same version" in out
    assert "room        draws 1, attempts " in out
    lines = [line.split() for line in out.splitlines()]
    assert sum(line[:1] == [name] for name in NAMES for line in lines) >= len(NAMES)
    sample, content = dg.replay(built, 1), Scenes(built).read(1)
    assert isinstance(sample, dg.Sample) and sample.index == 1 and {*sample.seconds} >= {"scene", "transport"}
    assert sample.arrays.keys() == content.arrays.keys()
    for name, values in content.arrays.items():
        assert sample.arrays[name].dtype == values.dtype and np.array_equal(
            sample.arrays[name], values, equal_nan=True
        )
    assert sample.parameters == content.parameters
    assert resimulate(built, 2) == ([0, 1], [])


def test_every_field_and_parameter_has_its_stage(again: Again) -> None:
    names = [name for stage in STAGES for name in stage.fields]
    everything = (*FIELDS, *dict.fromkeys(of.label for of in LABEL_FIELDS), "background_histogram")
    full = config(store={"fields": [*dict.fromkeys((*everything, "background_transient", "moving_transient"))]},
                  detector={"cycles": 10}, sequence={"frames": 2, "rate_hz": 10})  # fmt: skip
    assert sorted(names) == sorted({*names}) == sorted(schema_of(full).by_name)
    assert {key for stage in STAGES for key in stage.seconds} >= {*again.record.seconds}
    stages = {name: stage_of_parameter(name).name for name in again.record.parameters}
    for name, stage in {
        "box.albedo": "room", "attempts": "room", "labels.scan_up_m": "capture", "detector.pde": "detector",
        "effect.direct_return.on": "light", "effect.pile_up.on": "counts", "transient.relative_error": "light",
        "histogram.counts": "counts", "evidence.weakest": "evidence",
    }.items():  # fmt: skip
        assert stages[name] == stage
    assert stage_of_parameter("evidence.placed_anew").name == "room"


@pytest.mark.usefixtures("known")
def test_one_other_value_is_found_in_its_stage(made: dict[int, Sample], tmp_path: Path) -> None:
    """Of each field, and of a parameter of each stage; files and records fit what is stored."""
    sample, name_of = made[1], "build/shard-000000.json"
    other = replace(sample, arrays={name: changed(values) for name, values in sample.arrays.items()})
    right, wrong = (stored_as(tmp_path / word, one, made) for word, one in (("right", sample), ("wrong", other)))
    record, stated = (right / name_of).read_bytes(), json.loads((wrong / name_of).read_text())

    def only(stage: str, name: str) -> None:
        found = module.replay_comparison(right, 1)
        assert [(row.stage, row.name) for row in found.rows if row.verdict != "same"] == [(stage, name)]
        assert found.first == stage and f"the first stage that differs is {stage} ({name})" in str(found.problem())
        if name != "parameters":
            assert found.differing[0].words.startswith(f"1 of {sample.arrays[name].size} values, most by ")

    cases = [(stage.name, name) for stage in STAGES for name in stage.fields if name in sample.arrays]
    assert len(cases) == len(sample.arrays) > 20
    for stage, name in cases:
        digest = stated["scenes"][1]["digests"][name]
        reseal(right / name_of, lambda values: values["scenes"][1]["digests"].update({name: digest}))  # noqa: B023
        files = [file for file in stated["files"] if f"/{name}/" in file]
        before = {file: (right / file).read_bytes() for file in files}
        for file in files:
            shutil.copy(wrong / file, right / file)
        only(stage, name)
        for file in files:
            (right / file).write_bytes(before[file])
        (right / name_of).write_bytes(record)
    firsts = {stage_of_parameter(name).name: name for name in reversed([*sample.parameters])}
    assert {*firsts} == {*NAMES} - {"labels"}
    for stage, name in firsts.items():
        value = sample.parameters[name]
        another = f"{value}x" if isinstance(value, str) else not value if isinstance(value, bool) else value + 1
        reseal(right / name_of, lambda values: values["scenes"][1]["parameters"].update({name: another}))  # noqa: B023
        only(stage, "parameters")
        (right / name_of).write_bytes(record)


def with_albedo(scene: dg.Scene) -> dg.Scene:
    """Painted anew, as nothing that is stored of the room says."""
    return replace(scene, materials=tuple(dg.Lambertian(0.11) for _ in scene.materials))


def wrong(at: Any, name: str, change: Callable[..., Any]) -> tuple[Any, str, Callable[..., Any]]:
    """A stage that gives something else: `change` gets what the function `name` gives, and its arguments."""
    right = getattr(at, name)
    return at, name, lambda *given, **named: change(right(*given, **named), *given)


def for_another(purpose: Purpose) -> Callable[..., int]:
    return lambda seed, _dataset, _index, asked: seed + (asked is purpose)


@pytest.mark.parametrize(
    ("stage", "fault"),
    [
        ("room", wrong(pipeline, "scene_for", lambda _, given, index: dg.scene_for(given, index + 1))),
        ("capture", wrong(pipeline, "capture_for", lambda capture, *_: replace(
            capture, laser=replace(capture.laser, position=capture.laser.position + 0.01)))),
        ("detector", wrong(pipeline, "detector_for", lambda both, *_: (replace(both[0], pde=0.1), both[1]))),
        ("light", wrong(pipeline, "scene_for", lambda scene, *_: with_albedo(scene))),
        ("light", wrong(light, "derived_seed", for_another(Purpose.TRANSPORT))),
        ("counts", wrong(pipeline, "derived_seed", for_another(Purpose.DETECTOR))),
        ("evidence", wrong(pipeline, "evidence_image", lambda image, *_: image * 2)),
        ("labels", wrong(make, "depth_image", lambda image, *_: image + 1)),
    ],
    ids=["another room", "moved laser", "other detector", "other paint", "other paths", "other counts",
         "other evidence", "other depth"],
)  # fmt: skip
def test_the_stage_at_fault_is_named(
    stage: str, fault: Any, built: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """And what comes before it is the same. Other paint is seen by the labels, which know nothing of light."""
    monkeypatch.setattr(*fault)
    found = module.replay_comparison(built, 1)
    assert found.first == stage
    before = NAMES[: NAMES.index(stage)]
    assert all(verdicts(found)[name] == {"same"} for name in before)
    assert run(["replay", str(built), "1"]) == 1
    out, err = capsys.readouterr()
    assert f"first stage that differs: {stage}\n" in out and err.count("\n") == 1
    assert f"scene 1: the first stage that differs is {stage} (" in err
    is_paint = "albedo" in [row.name for row in found.differing] and stage == "light"
    assert ("so the room differs in shapes or materials" in out) == is_paint
    if stage in ("evidence", "labels"):
        assert {row.stage for row in found.differing} == {stage}
    names = ", ".join(
        "parameters of " + row.stage if row.name == "parameters" else row.name for row in found.differing
    )
    assert f"scene 1: simulated again, {names} differ" in resimulate(built, 2)[1]


def test_light_of_another_processor_agrees_within_its_claims(
    built: Path, made: dict[int, Sample], tmp_path: Path, monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:  # fmt: skip
    """Light of other paths, and all that follows from it, is as good; here, it is other light. No other brightness
    is, wherever it comes from; and of rooms only what rounding makes."""
    monkeypatch.setattr(*wrong(light, "derived_seed", for_another(Purpose.TRANSPORT)))
    there = elsewhere(shutil.copytree(built, tmp_path / "there"))
    assert run(["replay", str(there), "1"]) == 0
    out = capsys.readouterr().out
    assert "differs in  processor another and " in out and "agrees: " in out and "of the whole, claimed are" in out
    found = module.replay_comparison(there, 1)
    assert found.problem() is None and "agrees" in verdicts(found)["light"] & verdicts(found)["counts"]
    assert all(verdicts(found)[name] == {"same"} for name in ("room", "capture", "detector", "labels"))
    assert module.replay_comparison(built, 1).first == "light" and resimulate(there, 2) == ([0, 1], [])
    monkeypatch.undo()

    def other(**changes: float) -> Comparison:
        arrays = {name: np.asarray(made[1].arrays[name]) * factor for name, factor in changes.items()}
        both = [(0, made[0]), (1, replace(made[1], arrays={**made[1].arrays, **arrays}))]
        manifest = read_manifest(there)
        write_shard(there, manifest.schema, 0, manifest.fingerprint, both)
        return module.replay_comparison(elsewhere(there), 1)

    assert other(transient=1.01).first is None and other(transient=1.5).first == "light"
    assert other(histogram=1).first is None and other(histogram=2).first == "counts"
    assert other(relay_wall=1 + 1e-12).first is None and other(relay_wall=1 + 1e-6).first == "room"
    assert other(depth=1 + 1e-7).first is None and other(depth=1.1).first == "labels"


@pytest.mark.usefixtures("known")
def test_damage_is_told_from_another_result(built: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    root = shutil.copytree(built, tmp_path / "set")
    (file,) = (path for path in (root / "data.zarr/depth").rglob("*") if path.is_file() and path.name != "zarr.json")
    before = file.read_bytes()
    for harm in (before[:-9] + bytes([before[-9] ^ 1]) + before[-8:], before[: len(before) // 2], None):
        file.unlink()
        if harm is not None:
            file.write_bytes(harm)
        assert run(["replay", str(root), "1"]) == 1
        out, err = capsys.readouterr()
        (line,) = (line for line in out.splitlines() if " depth " in line)
        assert "damaged: " in line and line.endswith("made again it is what was written")
        assert "depth: damaged; run the same `datagen build` again to make shard 0 anew" in err
        assert "first stage that differs" not in out + err and err.count("\n") == 1
        # What is made again is no less whole.
        assert dg.replay(root, 1).arrays["depth"].shape == (8, 8)
        file.write_bytes(before)
    reseal(root / "build/shard-000000.json", lambda values: values["scenes"][1]["digests"].update(depth="0" * 64))
    assert run(["replay", str(root), "1"]) == 1
    assert "its record states other values than are stored" in capsys.readouterr().out
    other = changed(Scenes(built).read(1).arrays["depth"])
    # Values of a sound file that nobody has recorded.
    elder = rewritten(built, tmp_path / "elder", 1, depth=other)
    shutil.copy(elder / "data.zarr/depth/c/0/0/0", root / "data.zarr/depth/c/0/0/0")
    shutil.copy(built / "build/shard-000000.json", root / "build/shard-000000.json")
    assert run(["replay", str(root), "1"]) == 1
    assert "damaged: stored are other values than were written, and made again it is what was written; 1 of 64" in (
        capsys.readouterr().out
    )


def test_light_that_is_not_stored_is_compared_by_its_energy(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """And `dg.replay` gives it."""
    few = config(scenes=1, store={"fields": ["depth"]})
    sample = simulate_sample(few, 0)
    root = write_dataset(few, tmp_path / "set", lambda *_: sample)
    assert run(["replay", str(root), "0"]) == 0
    out = capsys.readouterr().out
    assert out.count(" not stored\n") == 2 and "histogram " in out
    found = dg.replay(root, 0)
    assert found.arrays["transient"].sum() == pytest.approx(sample.parameters["transient.energy"], rel=1e-5)
    energy = float(sample.parameters["transient.energy"])
    for factor, first in ((1.01, None), (2.0, "light")):
        parameters = {**sample.parameters, "transient.energy": energy * factor}
        other = write_dataset(few, tmp_path / f"{factor}", lambda *_: replace(sample, parameters=parameters))  # noqa: B023
        assert module.replay_comparison(elsewhere(other), 0).first == first and verify(other).problems == ()


def test_a_scene_that_could_not_be_made(
    built: Path, made: dict[int, Sample], tmp_path: Path, monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:  # fmt: skip
    """Then, and not now; or neither; or now alone."""
    root = stored_as(tmp_path / "set", "took longer than 5 s (scene_seconds)", made)
    assert run(["replay", str(root), "1"]) == 1
    err = capsys.readouterr().err
    assert "could not be made when it was built (took longer" in err and "can be made now" in err
    assert np.array_equal(dg.replay(root, 1).arrays["histogram"], made[1].arrays["histogram"])

    def refuse(*_: object) -> Sample:
        raise dg.InputError("no room for the box")

    monkeypatch.setattr(module, "simulate_sample", refuse)
    for dataset, status, piece in (
        (root, 2, "cannot be made now (took longer than 5 s (scene_seconds); now: no room for the box)"),
        (built, 1, "scene 1 cannot be made again: no room for the box"),
    ):
        assert run(["replay", str(dataset), "1"]) == status
        err = capsys.readouterr().err
        assert piece in err and err.count("\n") == 1
    with pytest.raises(dg.InputError, match="no room for the box"):
        dg.replay(root, 1)
    assert resimulate(built, 2)[1] == [
        f"scene {index}: cannot be made again: no room for the box" for index in (0, 1)
    ]


def test_what_cannot_be_made_again_is_refused_in_a_line(
    built: Path, made: dict[int, Sample], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    half = config(scenes=4)
    part = write_dataset(half, tmp_path / "part", lambda _, index: made[index % 2])
    (part / "build/shard-000001.json").unlink()
    assert run(["replay", str(part), "1"]) == 0
    for dataset, scene, piece in (
        (built, "2", "SCENE 2: "), (part, "2", "shard 1 of "), (tmp_path / "none", "0", "no such dataset"),
        (built / "build", "0", "is no dataset"), (built, "x", "'x' is not a valid integer"),
    ):  # fmt: skip
        capsys.readouterr()
        assert run(["replay", str(dataset), scene]) == 2
        out, err = capsys.readouterr()
        assert out == "" and piece in err and err.count("\n") == 1, err
    no_scenes: tuple[Any, ...] = (-1, 2, 1.0, True, "1", None)
    for number in no_scenes:
        with pytest.raises(dg.InputError, match=r"scene .*: .* has the scenes 0 … 1"):
            dg.replay(built, number)
    assert np.array_equal(dg.replay(str(built), np.int64(1)).arrays["depth"], made[1].arrays["depth"].astype("f4"))  # type: ignore[arg-type]


def test_what_the_simulation_warns_of_is_told(built: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(module, "simulate_sample", _warns)
        assert run(["replay", str(built), "1"]) == 0
    assert "warning     the window misses the room\n" in capsys.readouterr().out


def _warns(given: DatasetConfig, index: int) -> Sample:
    import warnings

    warnings.warn("the window\n misses the room", dg.InputWarning, stacklevel=1)
    return simulate_sample(given, index)
