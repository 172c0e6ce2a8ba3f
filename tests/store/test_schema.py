"""The division of a dataset into shards and chunks, which follows from its configuration."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from datagen.config import DatasetConfig, config_from_mapping
from datagen.errors import InputError
from datagen.store import schema_of
from datagen.store.schema import CHUNK_BYTES, SHARD_BYTES, Field
from datagen.store.shard import encoded_value


def scan(rows: int, columns: int, bins: int, scenes: int, pixels: int = 1) -> DatasetConfig:
    capture = {
        "pairing": "exhaustive",
        "scan": {"rows": rows, "columns": columns},
        "field_of_view": {"rows": pixels, "columns": 1},
        "time": {"bins": bins},
    }
    return config_from_mapping({"scenes": scenes, "capture": capture})


@settings(deadline=None)
@given(st.integers(1, 64), st.integers(1, 64), st.integers(1, 2048), st.integers(1, 10**6))
def test_shards_are_a_power_of_two_of_scenes_and_fit_in_memory(
    rows: int, bins: int, pixels: int, scenes: int
) -> None:
    schema = schema_of(scan(rows, 4, bins, scenes, pixels))
    k = schema.scenes_per_shard
    assert k in (1, 2, 4, 8, 16, 32, 64, 128, 256)
    assert k == 1 or k * schema.bytes_per_scene <= SHARD_BYTES
    assert sum(len(schema.scenes_of(shard)) for shard in range(schema.shards)) == scenes
    assert schema.scenes_of(schema.shards - 1).stop == scenes


@settings(deadline=None)
@given(st.lists(st.integers(1, 300), min_size=2, max_size=4), st.sampled_from(["uint8", "uint16", "float32"]))
def test_chunks_are_cut_only_above_their_limit(shape: list[int], dtype: str) -> None:
    field = Field("f", ("scene", *"abcd"[: len(shape)]), tuple(shape), dtype, "1", "")
    size = math.prod(field.chunk) * np.dtype(dtype).itemsize
    assert field.chunk[-1] == shape[-1]
    assert all(1 <= c <= s for c, s in zip(field.chunk, shape, strict=True))
    assert size <= CHUNK_BYTES
    if field.bytes_per_scene <= CHUNK_BYTES:
        assert field.chunk == field.shape
    else:
        cut = [axis for axis in range(len(shape)) if field.chunk[axis] < shape[axis]]
        assert cut, "something is cut"
        assert all(field.chunk[axis] == 1 for axis in range(cut[-1])), (
            "an axis is cut only when those before are at 1"
        )


HISTOGRAM = Field("histogram", ("scene", "laser", "pixel", "bin"), (1, 1, 3), "uint8", "counts", "")
TRANSIENT = Field("transient", ("scene", "laser", "pixel", "bin"), (1, 1, 3), "float32", "1", "")


def test_values_are_stored_as_they_are_or_not_at_all() -> None:
    assert encoded_value(HISTOGRAM, np.array([[[0, 7, 255]]])).tolist() == [[[0, 7, 255]]]
    for bad, message in (
        (np.array([[[0, 7, 256]]]), "256 lies outside 0 … 255 of uint8; set store.histogram_dtype"),
        (np.array([[[0, 7, -1]]]), "-1 lies outside 0 … 255"),
        (np.array([[[0.0, 7.0, 1.0]]]), "float64 made where whole numbers are stored"),
        (np.array([[0, 7, 1]]), r"shape \(1, 3\) made, \(1, 1, 3\) follows"),
    ):
        with pytest.raises(InputError, match=message):
            encoded_value(HISTOGRAM, bad)
    for bad in (np.nan, np.inf, 1e300):
        with pytest.raises(InputError, match=r"at \(0, 0, 1\) is not a finite float32"):
            encoded_value(TRANSIENT, np.array([[[0.0, bad, 1.0]]]))
