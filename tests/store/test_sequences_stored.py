"""Datasets of sequences: format 2, an axis of frames, and windows of frames that are decoded alone."""

from __future__ import annotations

import json
import shutil
import warnings
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import zarr
from damage import reseal
from datasets import write_dataset
from fake_samples import build_fakes, decoded_from_now, fake_sample, sequence_config, small_config

import datagen as dg
from datagen.building.replay import replay_comparison
from datagen.config import DatasetConfig, config_from_mapping, stored_axes
from datagen.errors import InputError
from datagen.store import DatasetReader, read_manifest, schema, schema_of, verify
from datagen.store import reader as reading
from datagen.store.arrays import block_bytes
from datagen.store.info import info
from datagen.store.manifest import describe
from datagen.store.reader import Part
from datagen.store.verify import dataset_digest
from tests.sequences.rooms_that_move import box, capture, room

pytestmark = pytest.mark.usefixtures("builds_here")

EVERY = ["histogram", "transient", "depth", "occupancy", "objects"]


def fields_of(config: DatasetConfig) -> dict[str, tuple[tuple[str, ...], tuple[int, ...]]]:
    return {name: (field.dims, field.shape) for name, field in schema_of(config).by_name.items()}


def test_what_differs_from_frame_to_frame_has_that_axis() -> None:
    one = fields_of(small_config(store={"fields": EVERY}))
    several = fields_of(sequence_config(store={"fields": [*EVERY, "moving_transient"]}))
    assert {*several} - {*one} == {"laser_time", "moving_transient", "object_velocity", "object_turning",
                                   "object_change", "object_change_floor"}  # fmt: skip
    framed = {name for name, (dims, _) in several.items() if "frame" in dims}
    still = {"object_count", "object_class", "object_part", "object_box_size", "relay_wall", "hidden_view",
             "hidden_bounds", "laser_points", "laser_normals", "laser_position", "sensor_pixels", "sensor_points",
             "sensor_normals", "sensor_position"}  # fmt: skip
    assert {*several} - framed == still
    for name in framed & {*one}:
        dims, shape = one[name]
        assert several[name] == (("scene", "frame", *dims[1:]), (3, *shape))
    assert all(several[name] == one[name] for name in still)


def test_format_2_is_of_sequences_alone(tmp_path: Path) -> None:
    for config, number in ((small_config(), 1), (sequence_config(), 2)):
        root = write_dataset(config, tmp_path / str(number), fake_sample)
        stated = json.loads((root / "dataset.json").read_text())
        assert stated["format"] == number and ("sequence" in stated["config"]) == (number == 2)
        assert read_manifest(root).frames == (3 if number == 2 else None)
        assert json.loads((root / "croissant.json").read_text())["version"] == f"{number}.12.0"
        assert verify(root, deep=True).problems == () and "scenes       12 of 12" in info(root)
        assert ("frames       3 of each scene, 10 a second, laser points in the order raster" in info(root)) is (
            number == 2
        )
        assert ("`f` begins f / 10 s" in (root / "README.md").read_text()) is (number == 2)


@pytest.mark.parametrize(("number", "axes"), [(1, {"bin"}), (2, {"bin", "frame"})])
def test_datasets_of_a_format_are_so_to_the_byte(number: int, axes: set[str]) -> None:
    """The manifest and all metadata of the dataset of each format that is kept, written anew."""
    kept = Path(__file__).parents[1] / f"regression/format_{number}/dataset"
    old = read_manifest(kept)
    config = config_from_mapping(old.config, look_for_files=False)
    new = describe(config, schema_of(config, old.schema.scenes_per_shard))
    assert new.metadata == old.metadata and {*stored_axes(config)} == axes
    written = replace(new, made_by=old.made_by, stats=old.stats).to_bytes()
    # Words about the table may change, as they have since version 1.0.
    stated = [json.loads(text) for text in (written, (kept / "dataset.json").read_bytes())]
    for values in stated:
        del values["samples"]["columns"], values["checksum"]
    assert json.dumps(stated[0]) == json.dumps(stated[1])


def test_a_format_that_is_not_that_of_its_settings_is_refused(tmp_path: Path) -> None:
    ones, twos = (write_dataset(of, tmp_path / of.name, fake_sample) for of in (
        small_config(name="one"), sequence_config(name="two")))  # fmt: skip

    def changes(values: dict[str, Any]) -> None:
        values["config"]["sequence"]["frames"] = 4

    for root, change, words in (
        (ones, lambda values: values.update(format=2), "format = 2 with no sequence"),
        (twos, lambda values: values.update(format=1), "format = 1 with a sequence"),
        (twos, lambda values: values.update(format=3), "format = 3, this datagen reads formats 1 and 2"),
        (twos, changes, "their frames are not those of its settings"),
    ):
        copy = shutil.copytree(root, tmp_path / "copy")
        reseal(copy / "dataset.json", change)
        with pytest.raises(InputError, match=words):
            read_manifest(copy)
        shutil.rmtree(copy)


def test_zarr_and_xarray_read_the_same(tmp_path: Path) -> None:
    config = sequence_config(store={"fields": [*EVERY, "moving_transient"], "scenes_per_shard": 4})
    root = write_dataset(config, tmp_path / "set", fake_sample)
    manifest, group = read_manifest(root), zarr.open_group(root / "data.zarr", mode="r")
    ours = DatasetReader(root, manifest, manifest.schema.by_name)
    for name in manifest.schema.by_name:
        np.testing.assert_array_equal(group[name][:], ours.read(name, range(12)))  # type: ignore[index]
    np.testing.assert_allclose(np.asarray(group["frame"][:], float), [0, 0.1, 0.2])  # type: ignore[index, arg-type]
    xarray = pytest.importorskip("xarray", reason="xarray is not installed (extra `tests`)")
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        opened = xarray.open_zarr(root / "data.zarr", chunks=None)
    assert opened.histogram.dims == ("scene", "frame", "laser", "pixel", "bin")
    assert opened.depth.sel(frame=0.1).shape == (12, 4, 5) and opened.frame.attrs["units"] == "s"
    assert {"frame", "bin", "laser_time", "laser_points"} <= set(opened.coords)
    assert set(opened.data_vars) | set(opened.coords) == {"frame", "bin", *manifest.schema.by_name}


@pytest.mark.parametrize(
    ("bins", "chunk_bytes", "frames_a_chunk", "is_block"),
    [(512, 2**22, 8, True), (512, 3 * 8 * 512 * 2, 3, True), (512, 1024, 1, False)],
    ids=["all frames in a chunk", "three frames in each", "parts of frames"],
)
def test_a_window_of_frames_decodes_its_own_blocks_alone(
    bins: int, chunk_bytes: int, frames_a_chunk: int, is_block: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(schema, "CHUNK_BYTES", chunk_bytes)
    monkeypatch.setattr(reading, "MEMORY_BYTES", 0)
    config = sequence_config(
        scenes=2, sequence={"frames": 8, "rate_hz": 10},
        capture={"scan": {"rows": 2, "columns": 4}, "time": {"bins": bins, "bin_width_ps": 50}},
    )  # fmt: skip
    root = write_dataset(config, tmp_path / "set", fake_sample)
    manifest, frame_bytes = read_manifest(root), 8 * bins * 2
    field = manifest.schema.by_name["histogram"]
    assert field.frame_bytes == frame_bytes and field.chunk[0] == frames_a_chunk
    assert (block_bytes(field) == frame_bytes) is is_block
    values = np.asarray(zarr.open_group(root / "data.zarr", mode="r")["histogram"][:])  # type: ignore[index]
    decoded = decoded_from_now(monkeypatch)
    for first, count in ((0, 1), (3, 2), (5, 3), (0, 8), (7, 1)):
        part = Part((np.arange(first, first + count), np.arange(8), np.arange(1)), slice(0, bins))
        reader = DatasetReader(root, manifest, ["histogram"], check=False)
        decoded.clear()
        np.testing.assert_array_equal(reader.read("histogram", [1], part)[0], values[1, first : first + count])
        assert sum(decoded) == count * frame_bytes
    # The digest is that of all frames: the first read of a checking reader takes them all, later ones their own.
    reader, part = DatasetReader(root, manifest, ["histogram"]), Part((np.arange(2, 4), *part.axes[1:]), part.last)
    for is_first in (True, False):
        decoded.clear()
        np.testing.assert_array_equal(reader.read("histogram", [1], part)[0], values[1, 2:4])
        assert sum(decoded) >= 8 * frame_bytes if is_first else sum(decoded) == 2 * frame_bytes


def test_it_grows_is_mended_and_has_one_digest(tmp_path: Path) -> None:
    root, whole = tmp_path / "set", tmp_path / "whole"
    build_fakes(sequence_config(), root, shards="0,2")
    assert build_fakes(sequence_config(), root).built == 1
    build_fakes(sequence_config(), root, scenes=16)
    (root / "dataset.json").unlink()
    build_fakes(sequence_config(), root, scenes=16)
    (root / "data.zarr/frame/c/0").write_bytes(b"")
    assert any(problem.startswith("data.zarr/frame/c/0") for problem in verify(root).problems)
    build_fakes(sequence_config(), root, scenes=16)
    store = {"fields": ["histogram", "transient", "depth"], "scenes_per_shard": 2}
    build_fakes(sequence_config(scenes=16, store=store), whole)
    assert verify(root, deep=True).problems == () and dataset_digest(root) == dataset_digest(whole)
    with pytest.raises(InputError, match=r"sequence.frames = 3, this configuration has 4"):
        build_fakes(sequence_config(sequence={"frames": 4, "rate_hz": 10}, scenes=16), root)
    with pytest.raises(InputError, match=r"sequence = .*this configuration has nothing"):
        build_fakes(small_config(scenes=16, detector=sequence_config().detector.model_dump(mode="json")), root)


WALK = {"kind": "walk", "speed_m_s": 1.0}


def real_config(**changes: Any) -> DatasetConfig:
    return config_from_mapping({
        "scenes": 2, "seed": 4, "transport": {"target": 0.2}, "sequence": {"frames": 3, "rate_hz": 5},
        "scene": {"contents": [{"kind": "box", "motion": WALK}]},
        "capture": {"scan": {"rows": 2, "columns": 2}, "time": {"bins": 64, "bin_width_ps": 800}},
        "detector": {"cycles": 10_000}, "labels": {"rows": 6, "columns": 6},
        "store": {"fields": ["histogram", "depth", "objects"]},
    } | changes)  # fmt: skip


def test_a_sequence_is_built_replayed_and_read(tmp_path: Path) -> None:
    root = tmp_path / "set"
    assert dg.build(real_config(), root, progress=False).complete
    assert verify(root, deep=True).problems == ()
    found = replay_comparison(root, 1)
    assert found.problem() is None and {row.verdict for row in found.rows} == {"same", "not stored"}
    sample = dg.replay(root, 1)
    data = dg.TransientDataset(root, ("histogram", "depth", "objects", "laser_time"), counts="stored")
    for name, values in data[1].items():
        if name != "scene":
            np.testing.assert_array_equal(values.numpy(), sample.arrays[name])
    assert data.shape("histogram") == (3, 4, 1, 64) and data.shape("object_velocity") == (3, 1, 3)
    parameters = data.parameters("evidence.box.change")
    assert parameters.shape == (2,) and (np.asarray(parameters, float) > 0).all()
    # Splits know a room by its own parameters, among them how things move.
    assert {*data.parameters("split").tolist()} <= {"train", "val", "test"}
    assert dg.GeneratedDataset(real_config()).sample(1)["histogram"].shape == (3, 4, 1, 64)


def given(clock: dg.Clock, *, shift: float = 0.0) -> tuple[dg.Scene, dg.Capture, dg.Clock]:
    path = dg.Path((0.0, 1.0), [(1.5, 0.3 + shift, 1.2), (1.6, -0.5, 1.2)], (0, 40))
    return room(dg.Part("box", box(), dg.Lambertian(0.4), path=path)), capture(bins=64, width_s=4e-10), clock


def test_own_scenes_with_paths_become_sequences(tmp_path: Path) -> None:
    clock = dg.Clock(frames=3, rate_hz=3, order="serpentine")
    settings = {"transport": {"target": 0.2}, "detector": {"cycles": 100_000}}
    scenes = [given(clock), given(clock, shift=0.1)]
    root = tmp_path / "set"
    assert dg.build_from(scenes, root, settings=settings, progress=False).complete
    assert dg.build_from(scenes, root, settings=settings, progress=False).built == 0
    data = dg.TransientDataset(root, ("transient", "laser_time"))
    np.testing.assert_array_equal(data[1]["laser_time"], clock.times(9, 0.01))
    assert data[0]["transient"].shape == (3, 9, 1, 64) and verify(root, deep=True).problems == ()
    assert read_manifest(root).parsed_config().sequence is not None
    for wrong, words in (
        ([scenes[0][:2]], r"scenes\[0\]: 'box' moves, and nothing says when"),
        ([given(dg.Clock(1, 3))], "a clock of 1 frame"),
        ([scenes[0], given(dg.Clock(3, 2))], r"scenes\[1\]: its clock is .*rate_hz=2"),
        ([scenes[0], (scenes[0][0].at(0.0), scenes[0][1])], r"scenes\[1\]: its clock is None"),
    ):
        with pytest.raises(InputError, match=words):
            dg.build_from(wrong, tmp_path / "other", settings=settings, progress=False)
    with pytest.raises(InputError, match=r"sequence.rate_hz = 3: a frame lasts"):
        dg.build_from(scenes, tmp_path / "other", settings={"detector": {"cycles": 400_000}}, progress=False)
    assert not (tmp_path / "other").exists()
