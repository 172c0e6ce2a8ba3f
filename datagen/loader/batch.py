"""Items that were read together, and how they become a batch."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import torch
from torch.utils.data import default_collate, get_worker_info

from datagen.errors import InputError
from datagen.records.checks import check_kind


def room_for(shape: tuple[int, ...], dtype: np.dtype[Any]) -> torch.Tensor:
    """A tensor to be filled; in a loader's worker in shared memory, so that a batch crosses without a copy."""
    size = math.prod(shape) * dtype.itemsize
    if get_worker_info() is None or not size:
        return torch.from_numpy(np.empty(shape, dtype))
    kind = torch.from_numpy(np.empty(0, dtype)).dtype
    shared = torch.empty(0, dtype=kind).untyped_storage()._new_shared(size)
    return torch.empty(0, dtype=kind).set_(shared).view(shape)


class Batch(list[dict[str, torch.Tensor]]):
    """Items whose tensors are rows of `whole`, so that collating them needs no copy.

    events, counts : of all items, by item; an item has its own rows without the column that says whose they are.
    """

    def __init__(
        self, whole: dict[str, torch.Tensor], events: torch.Tensor | None = None, counts: torch.Tensor | None = None
    ) -> None:
        items = [{name: values[row] for name, values in whole.items()} for row in range(len(whole["scene"]))]
        self.whole = whole
        if events is not None and counts is not None:
            self.whole = whole | {"events": events, "counts": counts}
            sizes = torch.bincount(events[:, 0], minlength=len(items)).tolist()
            rows = zip(events[:, 1:].split(sizes), counts.split(sizes), strict=True)
            items = [item | {"events": e, "counts": c} for item, (e, c) in zip(items, rows, strict=True)]
        super().__init__(items)


def collate(items: list[dict[str, torch.Tensor]]) -> dict[str, torch.Tensor]:
    """A `collate_fn` equal to torch's own that hands a batch read as a whole on as it is, and every type of numbers.

    Of samples as events, `events` become (N, 4): sample of the batch, laser, pixel, bin; `counts` (N,) go with them.
    """
    if isinstance(items, Batch):
        return items.whole
    check_kind("items", items, list, tuple, remedy="the items of a batch")
    if not items or not all(isinstance(item, dict) for item in items):
        raise InputError("items: a list of a dataset's items is needed, one at least")
    same = [{name: value for name, value in item.items() if name not in ("events", "counts")} for item in items]
    whole: dict[str, torch.Tensor] = default_collate(same)
    if "events" not in items[0]:
        return whole
    number = torch.repeat_interleave(torch.tensor([len(item["events"]) for item in items]))
    rows = torch.cat([item["events"] for item in items])
    events = torch.cat([number[:, None].to(rows.dtype), rows], dim=1)
    return whole | {"events": events, "counts": torch.cat([item["counts"] for item in items])}
