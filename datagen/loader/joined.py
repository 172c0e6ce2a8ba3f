"""The datasets that `Subset`, `ConcatDataset` and datasets of users are made of."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from torch.utils.data import ConcatDataset, Dataset, Subset

from datagen.errors import InputError
from datagen.loader.dataset import TransientDataset
from datagen.loader.draw_counter import DrawCounter
from datagen.records.arrays import Ints

NONE: Ints = np.zeros(0, np.int64)


@dataclass(frozen=True)
class Found:
    """The scenes that some items read from a dataset whose noise is drawn anew; of sequences, the windows.

    positions : (n,) places of these items among those given. scenes : (n,) the scene that each reads.
    hidden : scenes that a dataset of a user's, which has another length, reads in a way of its own; else None.
    is_once : whether each item is one read; a class of a user's may read a scene several times for an item.
    others : scenes that a class of a user's may read besides, such as those that it mixes into an item.
    source : the path and seed that the noise comes from: datasets with the same one draw the same noise.
    """

    draws: DrawCounter
    positions: Ints
    scenes: Ints
    hidden: Ints | None = None
    is_once: bool = True
    others: Ints = field(default_factory=lambda: NONE)
    source: tuple[str, int] = ("", 0)

    def every_scene(self) -> Ints:
        """All scenes that may be read."""
        return np.unique(np.concatenate([self.scenes, self.others, NONE if self.hidden is None else self.hidden]))


def datasets_of(data: object, items: Ints) -> list[Found]:
    """What `items` of `data` read, for each dataset whose noise is drawn anew, once for all its places in `data`."""
    by_counter: dict[int, list[Found]] = {}
    for one in _places_within(data, np.arange(len(items)), items, ()):
        by_counter.setdefault(id(one.draws), []).append(one)
    merged = []
    for several in by_counter.values():
        hidden = [one.hidden for one in several if one.hidden is not None]
        positions = np.concatenate([one.positions for one in several])
        scenes = np.concatenate([one.scenes for one in several])
        unknown = np.unique(np.concatenate(hidden)) if hidden else None
        others = np.unique(np.concatenate([one.others for one in several]))
        is_once = all(one.is_once for one in several)
        merged.append(Found(several[0].draws, positions, scenes, unknown, is_once, others, several[0].source))
    return merged


def _places_within(data: object, positions: Ints, items: Ints, within: tuple[int, ...]) -> Iterator[Found]:
    if id(data) in within:
        return
    within = (*within, id(data))
    if isinstance(data, TransientDataset):
        if data._draws is not None:
            source = str(data.path), data.seed
            if data.reads_its_items or _size(data) == len(data.scenes):
                once = data.reads_its_items
                others = NONE if once else data.drawn
                yield Found(data._draws, positions, data.drawn[items], None, once, others, source)
            else:
                yield Found(data._draws, NONE, NONE, np.unique(data.drawn), source=source)
    elif isinstance(data, Subset):
        yield from _places_within(data.dataset, positions, np.asarray(data.indices, np.int64)[items], within)
    elif isinstance(data, ConcatDataset):
        ends = np.asarray(data.cumulative_sizes)
        for part, dataset in enumerate(data.datasets):
            begin = ends[part - 1] if part else 0
            here = (items >= begin) & (items < ends[part])
            yield from _places_within(dataset, positions[here], items[here] - begin, within)
    else:
        for dataset in _parts_of(data):
            every = np.arange(_size(dataset))
            whole = [*_places_within(dataset, every, every, within)]
            if _size(dataset) == _size(data):
                # A dataset of the same length reads the same items, as wrappers do that change what is read.
                for one, of_all in zip(_places_within(dataset, positions, items, within), whole, strict=True):
                    yield replace(one, is_once=False, others=of_all.every_scene())
            else:
                for one in whole:
                    yield Found(one.draws, NONE, NONE, one.every_scene(), source=one.source)


def _parts_of(data: object) -> Iterator[Any]:
    """The datasets among the attributes of an object, and in the lists and mappings there, each once."""
    seen = set[int]()
    for value in vars(data).values() if hasattr(data, "__dict__") else ():
        several = list(value.values()) if isinstance(value, Mapping) else value
        for one in several if isinstance(several, list | tuple) else (several,):
            if isinstance(one, Dataset) and hasattr(one, "__len__") and id(one) not in seen:
                seen.add(id(one))
                yield one


def _size(data: Any) -> int:
    return len(data)


def check_joined(data: object) -> None:
    """Raise `InputError` if datasets that `ConcatDataset` joins differ in their fields, shapes, units or bins.

    Datasets of users, subclasses, and datasets with a transform may convert what they read, and are left alone.
    """
    if isinstance(data, Subset):
        check_joined(data.dataset)
    if not isinstance(data, ConcatDataset):
        return
    for dataset in data.datasets:
        check_joined(dataset)
    plain = [one for dataset in data.datasets for one in _plain(dataset)]
    for other in plain[1:]:
        for what, here in other.layout().items():
            first = plain[0].layout().get(what)
            if here != first:
                raise InputError(
                    f"ConcatDataset: {what} of {other.path} is {here or 'missing'}, that of {plain[0].path} is "
                    f"{first or 'missing'}; choose the same fields and parts, or convert with transform="
                )


def _plain(data: object) -> Iterator[TransientDataset]:
    """The datasets whose items come through `Subset` and `ConcatDataset` as they were stored."""
    if isinstance(data, Subset):
        yield from _plain(data.dataset)
    elif isinstance(data, ConcatDataset):
        for dataset in data.datasets:
            yield from _plain(dataset)
    elif isinstance(data, TransientDataset) and data.gives_stored_items:
        yield data
