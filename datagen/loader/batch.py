"""Items of a batch, and how they are joined."""

from __future__ import annotations

import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from types import FrameType, MethodType
from typing import Any

import numpy as np
import torch
from torch.utils.data import Subset, default_collate

from datagen.errors import InputError
from datagen.records.checks import check_kind

Item = dict[str, Any]
JOINED = ("events", "counts")
"""Fields whose number of rows differs from sample to sample."""


@dataclass(frozen=True)
class Whole:
    """A batch that was read at once, on its way from a dataset to `collate`."""

    batch: Item


def goes_to_collate(caller: FrameType | None) -> bool:
    """Whether a loader of torch's hands what its dataset returns to `collate`, and to nobody else.

    In a process without workers an epoch takes half the time if a batch is read at once, into memory of the whole
    batch, with several threads. Nobody must notice, so only torch's own code may stand between.

    caller : the frame that called `__getitems__` of the dataset.
    """
    of_parts = getattr(getattr(Subset, "__getitems__", None), "__code__", None)
    while caller is not None and caller.f_code is of_parts:
        caller = caller.f_back
    if caller is None or caller.f_globals.get("__name__") != "torch.utils.data._utils.fetch":
        return False
    return getattr(caller.f_locals.get("self"), "collate_fn", None) is collate


class NotHandedOn:
    """A method that a wrapper's `__getattr__` does not find.

    torch's loader asks a dataset for `__getitems__`, and would get that of the dataset inside, although the wrapper
    changes items in its own `__getitem__`.
    """

    def __init__(self, method: Callable[..., list[Item]]) -> None:
        self.method = method

    def __get__(self, data: object, owner: type | None = None) -> Callable[..., list[Item]]:
        if data is None:
            return self.method
        asks = sys._getframe(1)
        is_wrapper = asks.f_code.co_name in ("__getattr__", "__getattribute__")
        if is_wrapper and asks.f_locals.get(asks.f_code.co_varnames[0]) is not data:
            raise AttributeError("__getitems__ is not handed on, since a wrapper may change items")
        return MethodType(self.method, data)


def collate(items: Sequence[Item]) -> Item:
    """The batch of these items, as torch's own `default_collate` makes it of them. All types of numbers are kept.

    Samples as events are joined: `events` (N, 4) index of the sample in the batch, laser, pixel, bin; `counts` (N,).

    Raises
    ------
    InputError : no list of dictionaries; items with different keys.
    """
    if isinstance(items, Whole):
        return items.batch
    check_kind("items", items, list, tuple, remedy="the items of a batch")
    if not len(items) or not all(isinstance(item, Mapping) for item in items):
        raise InputError(
            "items: a list of a dataset's items is needed, one at least; a loader joins others, such as tuples, "
            "without collate_fn"
        )
    for number, item in enumerate(items):
        if item.keys() != items[0].keys():
            other = sorted(map(str, item.keys() ^ items[0].keys()))
            raise InputError(
                f"items: item {number} and the first differ in {', '.join(other)}; give all the same keys"
            )
    joined = _joined_events(items)
    same = [{name: value for name, value in item.items() if name not in joined} for item in items]
    return (default_collate(same) if same[0] else {}) | joined


def _joined_events(items: Sequence[Item]) -> Item:
    """`events` and `counts` of all items, end to end; nothing where they are not lists of events."""
    values = {name: [_tensor(item[name]) for item in items] for name in JOINED if name in items[0]}
    if not values.get("events") or not all(one is not None and one.ndim == 2 for one in values["events"]):
        return {}
    events = [one for one in values["events"] if one is not None]
    number = torch.repeat_interleave(torch.tensor([len(one) for one in events]))
    rows = torch.cat(events)
    found = {"events": torch.cat([number[:, None].to(rows.device, rows.dtype), rows], dim=1)}
    counts = [one for one in values.get("counts", []) if one is not None and one.ndim]
    if len(counts) == len(events) and all(len(one) == len(of) for one, of in zip(counts, events, strict=True)):
        found["counts"] = torch.cat(counts)
    return found


def _tensor(value: object) -> torch.Tensor | None:
    if isinstance(value, np.ndarray):
        return torch.from_numpy(value)
    return value if isinstance(value, torch.Tensor) else None
