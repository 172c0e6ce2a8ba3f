"""Items of a batch, and how they are joined."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
import torch
from torch.utils.data import default_collate

from datagen.errors import InputError
from datagen.records.checks import check_kind

Item = dict[str, Any]
JOINED = ("events", "counts")
"""Fields whose number of rows differs from sample to sample."""


class Batch(list[Item]):
    """The items of a batch, which are read when anybody looks at the list; then it is a list like any other.

    `collate` reads the batch at once if nobody has looked, into memory of the whole batch, with several threads. In a
    process without workers this makes an epoch 1.9 times as fast as joining items that were read one by one; items
    that somebody may have changed are joined as they are.

    items : reads the items. whole : reads the batch that the unchanged items would give, anew at each call.
    """

    def __init__(self, items: Callable[[], list[Item]], whole: Callable[[], Item]) -> None:
        super().__init__()
        self._items: Callable[[], list[Item]] | None = items
        self._whole = whole

    def read_at_once(self) -> Item | None:
        """The batch of the items, if nobody has looked at them."""
        return None if self._items is None else self._whole()

    def _read(self) -> None:
        if self._items is not None:
            items, self._items = self._items, None
            list.extend(self, items())

    def __reduce_ex__(self, protocol: Any) -> Any:
        """A copy is a plain list of the items."""
        return list, (list(self),)

    def __radd__(self, other: list[Item]) -> list[Item]:
        """Python takes the items of the right list without a look, unless this list adds itself."""
        return other + list(self)


def _looks(name: str) -> Any:
    method = getattr(list, name)

    def looked(self: Batch, *arguments: Any, **options: Any) -> Any:
        self._read()
        return method(self, *arguments, **options)

    return looked


_LOOKS = (
    "__add__ __contains__ __delitem__ __eq__ __ge__ __getitem__ __gt__ __iadd__ __imul__ __iter__ __le__ __len__ "
    "__lt__ __mul__ __ne__ __repr__ __reversed__ __rmul__ __setitem__ append clear copy count extend index insert "
    "pop remove reverse sort"
)
"""Methods of a list that look at its items."""
for _name in _LOOKS.split(" "):
    setattr(Batch, _name, _looks(_name))


def collate(items: Sequence[Item]) -> Item:
    """The batch of these items, as torch's own `default_collate` makes it of them. All types of numbers are kept.

    Samples as events are joined: `events` (N, 4) index of the sample in the batch, laser, pixel, bin; `counts` (N,).

    Raises
    ------
    InputError : no list of dictionaries; items with different keys.
    """
    if isinstance(items, Batch) and (whole := items.read_at_once()) is not None:
        return whole
    check_kind("items", items, list, tuple, remedy="the items of a batch")
    if not len(items) or not all(isinstance(item, Mapping) for item in items):
        raise InputError("items: a list of a dataset's items is needed, one at least")
    for number, item in enumerate(items):
        if item.keys() != items[0].keys():
            other = sorted(map(str, item.keys() ^ items[0].keys()))
            raise InputError(
                f"items: item {number} and the first differ in {', '.join(other)}; give all the same keys"
            )
    joined = _joined(items)
    same = [{name: value for name, value in item.items() if name not in joined} for item in items]
    return (default_collate(same) if same[0] else {}) | joined


def _joined(items: Sequence[Item]) -> Item:
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
