"""The file of a shard has a chunk for every scene, and no others."""

from __future__ import annotations

import google_crc32c
import numpy as np
import pytest

from datagen.store import schema
from datagen.store.arrays import chunk_grid, shard_content
from datagen.store.schema import Field, Schema

SCENES, A_SHARD = 10, 4
FIELD = Field("light", ("scene", "laser", "pixel", "bin"), (5, 3, 17), "float32", "photons", "")


@pytest.mark.parametrize("chunk_bytes", [2**22, 700, 90])
def test_every_scene_is_there_and_no_other(monkeypatch: pytest.MonkeyPatch, chunk_bytes: int) -> None:
    """Also scenes of fill values: if zarr left their chunks out, a lost chunk would read as fill values, too."""
    monkeypatch.setattr(schema, "CHUNK_BYTES", chunk_bytes)
    divided = Schema((FIELD,), SCENES, A_SHARD)
    for fill in (0.0, np.nan):
        for shard in range(divided.shards):
            values = np.full((len(divided.scenes_of(shard)), *FIELD.shape), fill, "f4")
            listed = chunks(shard_content(FIELD, values, A_SHARD))
            assert [chunk is None for chunk in listed] == [
                shard == 2 and row >= 2 for row in range(A_SHARD) for _ in range(len(listed) // A_SHARD)
            ]


def chunks(whole: bytes) -> list[bytes | None]:
    """The chunks that the shard's index lists."""
    count = A_SHARD * int(np.prod(chunk_grid(FIELD)))
    table = whole[-16 * count - 4 : -4]
    assert google_crc32c.value(table) == int.from_bytes(whole[-4:], "little")
    index = np.frombuffer(table, "<u8").reshape(-1, 2).tolist()
    return [None if size == 2**64 - 1 else whole[start : start + size] for start, size in index]
