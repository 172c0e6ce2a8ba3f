"""Damage is reported, repaired by building again, and never read without an error."""

from __future__ import annotations

import fcntl
import shutil
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from damage import reseal, told
from fake_samples import (
    EITHER,
    build_fakes,
    changed_at_5,
    deaf_at_5,
    fails_at_5,
    fake_sample,
    hangs_at_5,
    small_config,
)
from here_and_now import one_worker_here

from datagen.building import build
from datagen.building.build import BuildResult
from datagen.cli import run
from datagen.config import DatasetConfig
from datagen.errors import CheckError, InputError
from datagen.loader import TransientDataset
from datagen.records import Sample
from datagen.store import committed_records, read_manifest, verify
from datagen.store.environment import made_with
from datagen.store.verify import dataset_digest


def again(root: Path, config: DatasetConfig | None = None, **options: Any) -> BuildResult:
    return build_fakes(config or small_config(), root, **options)


def content(root: Path) -> dict[Path, bytes]:
    return {path: path.read_bytes() for path in root.rglob("*") if path.is_file()}


def counting(tried: list[int], sample: Callable[[DatasetConfig, int], Sample]) -> Callable[..., Sample]:
    """A sample function that notes each scene that is tried."""

    def counted(config: DatasetConfig, index: int) -> Sample:
        tried.append(index)
        return sample(config, index)

    return counted


def test_a_table_that_is_not_vouched_for_gives_no_column(dataset: Path) -> None:
    table, data = dataset / "samples.parquet", TransientDataset(dataset)
    sound = table.read_bytes()
    table.write_bytes(sound[:100] + bytes([sound[100] ^ 1]) + sound[101:])
    with pytest.raises(CheckError, match=r"samples\.parquet: has changed .*build` again"):
        data.parameters("kind")
    table.write_bytes(sound)
    (dataset / "croissant.json").write_text("{}")
    with pytest.raises(CheckError, match=r"croissant\.json: missing or damaged"):
        data.parameters("kind")
    table.unlink()
    assert len(TransientDataset(dataset)) == 12, "the records tell which scenes there are"


HARMS: dict[str, Callable[[dict[str, Any]], object]] = {
    "metadata exchanged": lambda values: values["metadata"].update({"data.zarr/zarr.json": "0" * 64}),
    "described by others": lambda values: values["config"].update(description="one\r\ntwo\x1b[31m"),
    "of another tool": lambda values: values.clear(),
}


@EITHER
@one_worker_here()
def test_what_verify_reports_is_repaired_by_the_next_build(pristine: Path, dataset: Path) -> None:
    config = read_manifest(dataset).parsed_config()
    for name, harm in HARMS.items():
        reseal(dataset / "dataset.json", harm)
        problems = told(lambda: verify(dataset).problems)
        assert problems is None or problems, name
        assert again(dataset, config).built == 0 and verify(dataset, deep=True).problems == ()
        for file in ("dataset.json", "README.md", "samples.parquet", "croissant.json"):
            assert (dataset / file).read_bytes() == (pristine / file).read_bytes(), (name, file)


@one_worker_here()
def test_shards_of_another_configuration_restore_nothing(dataset: Path) -> None:
    (dataset / "dataset.json").unlink()
    with pytest.raises(InputError, match=r"dataset\.json: missing, and there are shards; build the dataset again"):
        TransientDataset(dataset)
    before = set(dataset.rglob("*"))
    with pytest.raises(InputError, match=r"no sound dataset\.json, and shard 0 was made with another configuration"):
        again(dataset, small_config(seed=4))
    with pytest.raises(InputError, match=r"shards up to scene 11; ask for at least scenes = 12"):
        again(dataset, scenes=5)
    shutil.rmtree(dataset / "build")
    with pytest.raises(InputError, match=r"no dataset\.json"):
        again(dataset)
    assert {*dataset.rglob("*")} <= before


@one_worker_here()
def test_a_dataset_that_had_grown_is_restored(tmp_path: Path) -> None:
    root, store = tmp_path / "set", {"fields": ["histogram"]}
    again(root, small_config(scenes=8, store=store))
    again(root, small_config(scenes=20, store=store))
    due = (root / "dataset.json").read_bytes()
    (root / "dataset.json").unlink()
    assert again(root, small_config(scenes=20, store=store)).built == 0
    assert (root / "dataset.json").read_bytes() == due and b'"scenes_per_shard": 8' in due


def made_elsewhere(root: Path, shard: int = 1, **changes: str) -> None:
    reseal(root / f"build/shard-{shard:06d}.json", lambda v: v["made_by"].update(changes))


@one_worker_here()
def test_other_versions_are_mixed_only_if_the_user_accepts_it(dataset: Path) -> None:
    made_elsewhere(dataset, numpy="1.26.0", processor="another")
    before = content(dataset)
    with pytest.raises(
        InputError, match=r"shard 1 and this machine differ in numpy 1\.26\.0 and .*accept_mixed = True"
    ):
        again(dataset, scenes=16)
    assert content(dataset) == before
    assert again(dataset, scenes=16, accept_mixed=True).complete
    assert "shards differ in numpy" in (dataset / "README.md").read_text() and verify(dataset).problems == ()
    made_elsewhere(dataset, numpy=read_manifest(dataset).made_by["numpy"], machine="riscv64")
    with pytest.raises(InputError, match="differ in machine riscv64 and"):
        again(dataset, scenes=16)


def test_only_the_version_that_began_a_build_goes_on_with_it(
    dataset: Path, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    """Neither with its manifest nor, where that is lost, with its shards alone; and nothing in the folder changes."""
    config = tmp_path / "same.yaml"
    config.write_text(small_config().model_dump_json())
    reseal(dataset / "dataset.json", lambda values: values["made_by"].update(datagen="9.9.9"))
    for shard in (0, 1, 2):
        made_elsewhere(dataset, shard, datagen="9.9.9")
    for _ in range(2):
        before = content(dataset)
        assert run(["build", str(config), str(dataset), "--accept-mixed"]) == 2
        (refused,) = capsys.readouterr().err.splitlines()
        assert "holds a dataset that datagen 9.9.9 began, and this is" in refused and content(dataset) == before
        (dataset / "dataset.json").unlink(missing_ok=True)


@one_worker_here()
def test_a_mixture_that_is_accepted_costs_no_sound_scene(tmp_path: Path) -> None:
    root, tried = tmp_path / "set", list[int]()
    with pytest.raises(CheckError):
        again(root, sample_function=fails_at_5)
    made_elsewhere(root, numpy="1.26.0")
    again(root, sample_function=counting(tried, fake_sample), accept_mixed=True)
    assert tried == [5] and verify(root, deep=True).problems == ()
    now = read_manifest(root).made_by["numpy"]
    assert [r.made_by["numpy"] for r in committed_records(root, read_manifest(root))] == [
        now,
        f"1.26.0 and {now}",
        now,
    ]


def test_a_worker_with_other_versions_makes_no_shard(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(build, "made_with", lambda: made_with() | {"numba": "0.1"})
    with pytest.raises(CheckError, match=r"a worker differs in numba 0\.1 and .*accept_mixed = True"):
        again(tmp_path / "set")
    assert not list(tmp_path.glob("set/build/*.json"))


@one_worker_here()
def test_half_written_files_are_removed_unless_another_build_is_writing_them(dataset: Path) -> None:
    (dataset / "data.zarr/depth/zarr.json.4.partial").write_bytes(b"half")
    with (dataset / "croissant.json.5.partial").open("xb") as held:
        fcntl.flock(held, fcntl.LOCK_EX)
        again(dataset)
        assert [path.name for path in dataset.rglob("*.partial")] == ["croissant.json.5.partial"]


@one_worker_here()
def test_a_bad_sample_costs_only_its_scene(tmp_path: Path) -> None:
    bad: dict[str, Callable[[Sample], object]] = {
        "SystemExit: enough": lambda _: sys.exit("enough"),
        "field 'histogram': missing": lambda made: replace(made, arrays={}),
        "not a sample: AttributeError": lambda _: None,
        "parameter odd: list made": lambda made: replace(made, parameters={"odd": [1, 2]}),
    }
    for why, change in bad.items():
        with pytest.raises(CheckError, match=f"1 of 12 scenes.*scene 5: {why}"):
            again(tmp_path / why, sample_function=changed_at_5(change))
        assert len(verify(tmp_path / why, deep=True).problems) == 1


@EITHER
@one_worker_here()
def test_only_scenes_that_failed_are_tried_anew(pristine: Path, tmp_path: Path) -> None:
    root, tried, config = tmp_path / "set", list[int](), read_manifest(pristine).parsed_config()
    with pytest.raises(CheckError, match=r"1 of 12 scenes.*scene 5: ValueError: no room for the box"):
        again(root, config, sample_function=fails_at_5)
    assert "no room for the box" in (root / "README.md").read_text()
    record = (root / "build/shard-000001.json").read_bytes()
    with pytest.raises(CheckError, match="scene 5"):
        again(root, config, sample_function=counting(tried, fails_at_5))
    # A second chance within one build, and nothing written where it did not help.
    assert tried == [5, 5] and (root / "build/shard-000001.json").read_bytes() == record
    assert again(root, config, sample_function=counting(tried, fake_sample)).built == 1 and tried == [5, 5, 5]
    assert verify(root, deep=True).problems == () and dataset_digest(root) == dataset_digest(pristine)
    for path in (pristine / "data.zarr").rglob("*"):
        assert path.is_dir() or path.read_bytes() == (root / path.relative_to(pristine)).read_bytes()


@pytest.mark.parametrize(("sample", "workers"), [(hangs_at_5, 1), (deaf_at_5, 2)])
def test_a_scene_that_hangs_is_given_up(tmp_path: Path, sample: object, workers: int) -> None:
    """One that an exception can reach costs itself alone; one that it cannot, its worker."""
    with pytest.raises(CheckError, match=r"1 of 12 scenes.*scene 5: took longer than 0\.3 s \(scene_seconds\)"):
        again(tmp_path / "set", workers=workers, sample_function=sample, scene_seconds=0.3)
    assert len(verify(tmp_path / "set").problems) == 1


@one_worker_here()
def test_one_digest_for_any_way_of_building(pristine: Path, dataset: Path, tmp_path: Path) -> None:
    due = dataset_digest(pristine)
    one = small_config(name="other", store={"fields": ["histogram", "transient", "depth"], "scenes_per_shard": 1})
    again(tmp_path / "one", one, shards="7-11")
    again(tmp_path / "one", one)
    assert dataset_digest(tmp_path / "one") == due
    again(tmp_path / "seed", small_config(seed=4))
    assert dataset_digest(tmp_path / "seed") != due
    reseal(dataset / "build/shard-000002.json", lambda v: v["scenes"][3]["digests"].update(depth="0" * 64))
    with pytest.raises(CheckError, match="scene 11: field depth decodes to other values"):
        dataset_digest(dataset)
    (dataset / "build/shard-000002.json").unlink()
    with pytest.raises(CheckError, match="1 of 3 shards are missing"):
        dataset_digest(dataset)


@EITHER
@one_worker_here()
def test_damage_is_repaired_in_the_shards_that_are_asked_for(dataset: Path) -> None:
    """The files of other shards are not read: a job of an array need not hash what hundreds of others have made."""
    record = committed_records(dataset, read_manifest(dataset), [1])[0]
    file = dataset / next(iter(record.files))
    file.write_bytes(bytes([file.read_bytes()[0] ^ 1]) + file.read_bytes()[1:])
    config = read_manifest(dataset).parsed_config()
    assert again(dataset, config, shards="0").built == 0 and verify(dataset, deep=True).problems
    assert again(dataset, config, shards="0-1").built == 1 and not verify(dataset, deep=True).problems
