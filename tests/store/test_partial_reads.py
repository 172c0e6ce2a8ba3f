"""Samples and parts of them: what is read equals what zarr reads, cut, for any division into chunks and blocks."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import google_crc32c
import numpy as np
import pytest
import torch
import zarr
from datasets import write_dataset
from fake_samples import fake_sample, noisy_config, sequence_config

import datagen as dg
from datagen.config import DatasetConfig, config_from_mapping
from datagen.errors import CheckError, InputError
from datagen.store import DatasetReader, read_manifest, schema
from datagen.store.reader import Part

FIELDS = ("histogram", "transient", "transient_stderr", "laser_points", "sensor_pixels", "depth")


def config_of(
    pairing: str, rows: int, columns: int, pixels: tuple[int, int], bins: int, frames: int | None = None
) -> DatasetConfig:
    """frames : of each scene, if they are sequences."""
    sequence = {"sequence": {"frames": frames, "rate_hz": 10}, "detector": {"cycles": 1000}} if frames else {}
    return config_from_mapping({
        **sequence,
        "scenes": 3,
        "capture": {
            "pairing": pairing,
            "scan": {"rows": rows, "columns": columns},
            "field_of_view": {"rows": pixels[0], "columns": pixels[1]},
            "time": {"bins": bins},
        },
        "labels": {"rows": 3, "columns": 3},
        "store": {"fields": ["histogram", "transient", "transient_stderr", "depth"], "scenes_per_shard": 2},
    })  # fmt: skip


@pytest.fixture(
    scope="module",
    params=["several blocks", "chunks of pixels", "chunks of parts of frames", "confocal, small", "sequences, small"],
)
def dataset(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """Chunks of two and more blocks, of which rows of 2000 bytes lie in two; the others of one block each. The last
    ones have the usual chunks, which later tests write too."""
    config, chunk_bytes = {
        "several blocks": (config_of("exhaustive", 8, 16, (2, 1), 1000), 2**22),
        "chunks of pixels": (config_of("exhaustive", 3, 4, (2, 3), 50), 250),
        "confocal, small": (config_of("confocal", 4, 5, (1, 1), 24), 2**22),
        "sequences, small": (config_of("confocal", 4, 5, (1, 1), 24, frames=3), 2**22),
        "chunks of parts of frames": (config_of("exhaustive", 3, 4, (2, 3), 50, frames=3), 250),
    }[request.param]
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(schema, "CHUNK_BYTES", chunk_bytes)
        yield write_dataset(config, tmp_path_factory.mktemp("parts") / "set", fake_sample)


@pytest.fixture(params=["from shards", "in memory"])
def way(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("datagen.store.reader.MEMORY_BYTES", 0 if request.param == "from shards" else 2**28)


def crops(rng: np.random.Generator, lasers: int, pixels: int, bins: int) -> list[dict[str, Any]]:
    """Usual crops, and unusual ones that are allowed."""
    mask = rng.random(lasers) < 0.3
    mask[rng.integers(lasers)] = True
    return [
        {"lasers": slice(1, None, 2)},
        {"lasers": slice(None, None, -1), "bins": slice(-7, None)},
        {"lasers": mask},
        {"lasers": rng.integers(-lasers, lasers, 9).tolist(), "bins": slice(3, 11)},
        {"lasers": np.s_[1:3, ::2]},
        {"lasers": np.s_[:2, -2:], "pixels": rng.permutation(pixels)},
        {"pixels": [pixels - 1, 0], "bins": slice(5, 6)},
        {"pixels": slice(None), "lasers": (3,)},
        {},
    ]


def cut(whole: np.ndarray, dims: tuple[str, ...], crop: dict[str, Any], grid: tuple[int, int]) -> np.ndarray:
    """The crop of the values of several scenes, made by numpy axis by axis."""
    for axis, name in enumerate(dims, 1):
        chosen = crop.get({"laser": "lasers", "pixel": "pixels", "bin": "bins"}.get(name, ""))
        if isinstance(chosen, tuple) and isinstance(chosen[0], slice):
            chosen = np.arange(grid[0] * grid[1]).reshape(grid)[chosen].reshape(-1)
        if isinstance(chosen, tuple):
            chosen = list(chosen)
        if chosen is not None:
            whole = np.moveaxis(np.moveaxis(whole, axis, 0)[chosen], 0, axis)
    return whole


def test_fields_whose_last_axis_is_that_of_pixels_are_cut_too(tmp_path: Path) -> None:
    config = config_of("exhaustive", 2, 2, (2, 3), 24)
    store = config.store.model_copy(update={"fields": ("histogram", "zone_depth")})
    path = write_dataset(config.model_copy(update={"store": store}), tmp_path / "set", fake_sample)
    whole = np.asarray(zarr.open_group(path / "data.zarr", mode="r")["zone_depth"][:])  # type: ignore[index]
    for pixels in ([4, 0, 5], slice(1, 4), np.s_[:, ::2]):
        chosen = np.arange(6).reshape(2, 3)[pixels].ravel() if isinstance(pixels, tuple) else np.arange(6)[pixels]
        data = dg.TransientDataset(path, ("zone_depth",), pixels=pixels)
        assert np.array_equal(data[2]["zone_depth"].numpy(), whole[2][chosen])
        assert data.shape("zone_depth") == (len(chosen),)


@pytest.mark.usefixtures("way")
def test_a_part_is_the_whole_cut(dataset: Path) -> None:
    manifest = read_manifest(dataset)
    group = zarr.open_group(dataset / "data.zarr", mode="r")
    whole = {name: np.asarray(group[name][:]) for name in FIELDS}  # type: ignore[index]
    capture = manifest.config["capture"]
    grid, confocal = (capture["scan"]["rows"], capture["scan"]["columns"]), capture["pairing"] == "confocal"
    sizes = manifest.schema.by_name["histogram"].shape[-3:]
    for crop in crops(np.random.default_rng(0), *sizes):
        data = dg.TransientDataset(dataset, FIELDS, counts="stored", **crop)
        order = [2, 0, 1, 2]
        items = data.__getitems__(order)
        floats = dg.TransientDataset(dataset, ("histogram",), **crop).__getitems__(order)
        for name in FIELDS:
            dims = manifest.schema.by_name[name].dims[1:]
            if name == "sensor_pixels":
                dims = ("laser" if confocal else "pixel", *dims[1:])
            due = cut(whole[name][order], dims, crop, grid)
            for item, value in zip(items, due, strict=True):
                assert item[name].shape == value.shape == data.shape(name), (name, crop)
                assert np.array_equal(item[name].numpy(), value), (name, crop)
        assert all(torch.equal(a["histogram"].float(), b["histogram"]) for a, b in zip(items, floats, strict=True))


@pytest.fixture(scope="module", params=[noisy_config, sequence_config], ids=["scenes", "sequences"])
def one(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_dataset(request.param(), tmp_path_factory.mktemp("parts") / "one", fake_sample)


def test_redrawn_noise_is_that_of_the_whole_cut(one: Path) -> None:
    fields, crop = ("histogram", "transient"), {"lasers": np.s_[:, 1:], "bins": slice(2, 9)}
    whole = dg.TransientDataset(one, fields, redraw_noise=True, seed=7)
    data = dg.TransientDataset(one, fields, redraw_noise=True, seed=7, **crop)
    events = dg.TransientDataset(one, fields, redraw_noise=True, seed=7, representation="events", **crop)
    for _ in range(2):
        batch, as_events, due = (dg.collate(of.__getitems__(range(12))) for of in (data, events, whole))
        counts = dg.dense(as_events["events"], as_events["counts"], (12, *data.shape("histogram")))
        assert torch.equal(counts, batch["histogram"]) and counts.sum() > 0
        for name in fields:
            assert torch.equal(batch[name], due[name][..., [1, 3], :, 2:9])


def test_parts_are_checked(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The first read compares the digest of the whole value; later reads check the checksums of chunks."""
    monkeypatch.setattr("datagen.store.reader.MEMORY_BYTES", 0)
    root = write_dataset(config_of("confocal", 4, 4, (1, 1), 64), tmp_path / "set", fake_sample)
    first = root / "data.zarr/histogram/c/0/0/0/0"
    sound, manifest = first.read_bytes(), read_manifest(root)
    part = Part((np.arange(3), np.arange(1)), slice(0, 64))
    seen = {"histogram": np.zeros(3, bool)}
    checking = DatasetReader(root, manifest, ["histogram"], seen=seen)
    value = checking.read("histogram", [1], part=part)
    assert seen["histogram"].tolist() == [False, True, False]
    assert np.array_equal(checking.read("histogram", [1], part=part), value)

    def refused(message: str, check: bool = True) -> None:
        with pytest.raises(CheckError, match=message):
            DatasetReader(root, manifest, ["histogram"], check).read("histogram", [1], part=part)

    # Two chunks exchanged within a file, the index with them: no checksum is wrong.
    index = np.frombuffer(sound[-4 - 32 :][:32], "<u8").reshape(2, 2).copy()
    index[[0, 1]] = index[[1, 0]]
    table = index.tobytes()
    first.write_bytes(sound[:-36] + table + google_crc32c.value(table).to_bytes(4, "little"))
    refused("decodes to other values than were written")
    swapped = DatasetReader(root, manifest, ["histogram"], check=False).read("histogram", [0], part=part)
    assert np.array_equal(swapped, value), "found by the digest alone"
    flipped = bytearray(sound)
    flipped[int(index[0, 0]) + 20] ^= 1
    first.write_bytes(flipped)
    refused("scene 1: the checksum does not match", check=False)


def test_a_table_of_blocks_that_points_elsewhere_is_refused_though_its_checksum_is_right(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As a hostile file, or a faulty writer, would have it: before the blocks, into the table itself, and past the
    end. Nothing is decoded that no block holds."""
    monkeypatch.setattr("datagen.store.reader.MEMORY_BYTES", 0)
    root = write_dataset(config_of("exhaustive", 8, 16, (2, 1), 1000), tmp_path / "set", fake_sample)
    file, manifest = root / "data.zarr/transient/c/0/0/0/0", read_manifest(root)
    sound, part = file.read_bytes(), Part((np.arange(70, 75), np.arange(2)), slice(0, 9))
    offset, size = np.frombuffer(sound[-4 - 32 :][:32], "<u8").reshape(2, 2)[0].tolist()
    frame = sound[offset : offset + size - 4]
    decoded, block, stored = np.frombuffer(frame[4:16], "<u4").tolist()
    count = -(-decoded // block)
    assert count > 2 and stored == len(frame)
    reader = DatasetReader(root, manifest, ["transient"], check=False)

    def read() -> np.ndarray | str:
        try:
            return reader.read("transient", [0], part=part)
        except CheckError as error:
            return str(error)

    due = read()
    assert isinstance(due, np.ndarray)
    for at in (-1, 0, 15, 16 + 4 * count - 1, stored, stored + 1, 2**31 - 1, -(2**31)):
        for one in (0, count // 2, count - 1):
            table = np.frombuffer(frame, "<i4", count, 16).copy()
            table[one] = at
            body = frame[:16] + table.tobytes() + frame[16 + 4 * count :]
            changed = sound[:offset] + body + google_crc32c.value(body).to_bytes(4, "little")
            file.write_bytes(changed + sound[offset + size :])
            said = read()
            assert isinstance(said, str) and "blocks outside of it" in said
    file.write_bytes(sound)
    assert np.array_equal(read(), due)


def test_wrong_crops_are_refused(one: Path, tmp_path: Path) -> None:
    config = noisy_config().model_dump(mode="json")
    config["capture"]["scan"] = {"kind": "points", "points_m": [[0.1 * k, 0.0] for k in range(4)]}
    no_grid = write_dataset(config_from_mapping(config), tmp_path / "set", fake_sample)
    assert dg.TransientDataset(no_grid, ("histogram",), lasers=[3, 1]).shape("histogram") == (2, 1, 16)
    for root, crop, piece in (
        (one, {"lasers": 3}, "lasers = 3: must choose of 4, such as slice"),
        (one, {"lasers": [4]}, "lasers: 4 is not in 0 … 3"),
        (one, {"lasers": [True, False]}, "must choose of 4"),
        (one, {"lasers": slice(4, 9)}, "none of 4 is left"),
        (one, {"lasers": slice(None, None, 0)}, "must be a slice of whole numbers"),
        (one, {"lasers": (slice(1), 1)}, "rows and columns must both be slices"),
        (one, {"bins": [1, 2]}, "bins = .*: must be a slice of step 1"),
        (one, {"bins": slice(16, 20)}, "none of 16 is left"),
        (no_grid, {"lasers": np.s_[:1, :1]}, "these are no grid of rows and columns"),
    ):
        with pytest.raises(InputError, match=piece) as error:
            dg.TransientDataset(root, ("histogram",), **crop)  # type: ignore[arg-type]
        assert "\n" not in str(error.value)
