"""What users do to items is in the batch, as with any torch dataset; and an item is an item."""

from __future__ import annotations

import copy
import io
import multiprocessing
import pickle
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from datasets import write_dataset
from fake_samples import fake_sample, noisy_config, small_config
from torch.utils.data import ConcatDataset, DataLoader, Dataset, Subset, default_collate

import datagen as dg
from datagen.errors import InputError
from datagen.loader.batch import Whole

Item = dict[str, Any]


@pytest.fixture(scope="module")
def dataset(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_dataset(noisy_config(), tmp_path_factory.mktemp("kept") / "set", fake_sample)


def doubled(item: Item) -> Item:
    return item | {"histogram": item["histogram"] * 2}


class Overridden(dg.TransientDataset):
    def __getitem__(self, item: int) -> Any:
        return doubled(super().__getitem__(item))


class Mixin:
    def __getitem__(self, item: int) -> Any:
        return doubled(super().__getitem__(item))  # type: ignore[misc]


class Mixed(Mixin, dg.TransientDataset):
    pass


class Several(dg.TransientDataset):
    """Its own way to read several items changes the list in place."""

    def __getitems__(self, items: Any) -> Any:
        found = super().__getitems__(items)
        for number, item in enumerate(found):
            found[number] = doubled(item)
        return found

    def __getitem__(self, item: int) -> Any:
        return self.__getitems__([item])[0]


class Wrapper(Dataset[Any]):
    def __init__(self, data: Any) -> None:
        self.data = data

    def __len__(self) -> int:
        return len(self.data)

    def __getitem__(self, item: int) -> Any:
        return doubled(self.data[item])


class Forwarding(Wrapper):
    def __getitems__(self, items: Any) -> Any:
        return [doubled(item) for item in self.data.__getitems__(items)]


class HandingOn:
    """Whatever it lacks is that of the dataset inside."""

    def __init__(self, data: Any) -> None:
        self.data = data

    def __getattr__(self, name: str) -> Any:
        return getattr(self.data, name)

    def __len__(self) -> int:
        return len(self.data)

    def __getitem__(self, item: int) -> Any:
        return doubled(self.data[item])


class SeveralOfOne(dg.TransientDataset):
    def __getitem__(self, item: int) -> Any:
        found = super().__getitem__(item)
        return found | {"histogram": found["histogram"] / 2}


class SeveralOfSeveral(SeveralOfOne):
    """Two ways of its own, above a class that has one."""

    def __getitems__(self, items: Any) -> Any:
        return [doubled(doubled(item)) for item in super().__getitems__(items)]

    def __getitem__(self, item: int) -> Any:
        return self.__getitems__([item])[0]


class Other(dg.TransientDataset):
    """Other items than there are scenes, in an order of its own."""

    def __len__(self) -> int:
        return 30

    def __getitem__(self, item: int) -> Any:
        return doubled(super().__getitem__(11 - item % 12))


def with_transform(path: Path) -> Any:
    return dg.TransientDataset(path, transform=doubled)


WAYS: dict[str, Callable[[Path], Any]] = {
    "a subclass": Overridden, "a mixin": Mixed, "its own __getitems__": Several, "transform": with_transform,
    "a wrapper that hands on": lambda path: HandingOn(dg.TransientDataset(path)),
    "a part of a wrapper that hands on": lambda path: Subset(HandingOn(dg.TransientDataset(path)), range(12)),
    "two ways above one": SeveralOfSeveral,
    "other items": lambda path: Subset(Other(path), range(23, 11, -1)),
    "a wrapper": lambda path: Wrapper(dg.TransientDataset(path)),
    "a wrapper of several": lambda path: Forwarding(dg.TransientDataset(path)),
    "a part of a subclass": lambda path: Subset(Overridden(path), range(12)),
    "parts joined": lambda path: ConcatDataset([
        Subset(with_transform(path), range(5)), Subset(Mixed(path), range(5, 12))
    ]),
}  # fmt: skip


def read_by(data: Any, workers: int = 0, collate: Any = dg.collate, size: int = 5) -> list[Any]:
    start = {"multiprocessing_context": "fork"} if workers else {}
    return list(DataLoader(data, size, num_workers=workers, collate_fn=collate, **start))


@pytest.mark.parametrize("workers", [0, 1])
@pytest.mark.parametrize("way", WAYS)
def test_what_code_of_users_makes_of_items_is_in_the_batch(dataset: Path, way: str, workers: int) -> None:
    plain = dg.TransientDataset(dataset)
    due = torch.stack([plain[item]["histogram"] * 2 for item in range(12)])
    for collate in (dg.collate, None):
        batches = read_by(WAYS[way](dataset), workers, collate)
        assert torch.equal(torch.cat([batch["histogram"] for batch in batches]), due)


def test_a_patched_class_is_honoured(dataset: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    own = dg.TransientDataset.__getitem__
    monkeypatch.setattr(dg.TransientDataset, "__getitem__", lambda data, item: doubled(own(data, item)))
    data = dg.TransientDataset(dataset)
    assert torch.equal(read_by(data)[0]["histogram"], default_collate([data[i] for i in range(5)])["histogram"])


def in_place(items: list[Item]) -> list[Item]:
    for item in items:
        item["histogram"].add_(1)
    return items


def in_numpy(items: list[Item]) -> list[Item]:
    items[0]["depth"].numpy()[...] = 7
    return items


def key_added(items: list[Item]) -> list[Item]:
    for number, item in enumerate(items):
        item |= {"name": f"item {number}", "weight": number / 2, "number": number, "at": np.arange(3)}
    return items


def key_dropped(items: list[Item]) -> list[Item]:
    for item in items:
        del item["depth"]
    return items


def sorted_in_place(items: list[Item]) -> list[Item]:
    items.sort(key=lambda item: -int(item["scene"]))
    return items


CHANGES: dict[str, Callable[[list[Item]], list[Item]]] = {
    "in place": in_place, "in numpy": in_numpy, "key added": key_added, "key dropped": key_dropped,
    "sorted": sorted_in_place, "replaced": lambda items: [doubled(item) for item in items],
    "reversed": lambda items: items[::-1], "filtered": lambda items: [i for i in items if int(i["scene"]) % 2],
    "repeated": lambda items: items + items, "one": lambda items: items[:1],
    "before": lambda items: [items[1], *items], "added to": lambda items: list.__add__([], []) + items,
    "a tuple": lambda items: tuple(items),  # type: ignore[dict-item, return-value]
    "a copy": copy.deepcopy, "sent": lambda items: pickle.loads(pickle.dumps(items)),
    "popped": lambda items: [items.pop()],
    "a tree": lambda items: torch.utils._pytree.tree_map(lambda values: values[None], items),
    "the same kind": lambda items: type(items)(doubled(item) for item in items),
    "whole first": lambda items: (dg.collate(items)["histogram"].zero_(), items)[1],
}  # fmt: skip


OF_HISTOGRAMS = {"in place", "replaced", "a tree", "the same kind", "whole first"}
"""Changes that items as events cannot have."""


@pytest.mark.parametrize("workers", [0, 1])
@pytest.mark.parametrize(
    ("change", "representation"),
    [(name, "dense") for name in CHANGES] + [(name, "events") for name in CHANGES if name not in OF_HISTOGRAMS],
)
def test_a_batch_is_that_of_the_items_given(dataset: Path, change: str, workers: int, representation: str) -> None:
    """As if the items had been read one by one."""
    data = dg.TransientDataset(dataset, representation=representation)
    (found,) = read_by(Subset(data, [3, 1, 4, 2]), workers, lambda items: dg.collate(CHANGES[change](items)), 4)
    due = dg.collate(CHANGES[change]([data[item] for item in (3, 1, 4, 2)]))
    assert found.keys() == due.keys()
    for name, values in due.items():
        same = torch.equal(found[name], values) if isinstance(values, torch.Tensor) else found[name] == values
        assert same and type(found[name]) is type(values), name


def test_a_batch_that_nobody_can_look_at_is_that_of_its_items(dataset: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """In all representations; and it is read at once."""
    order = [7, 3, 7]
    options: list[dict[str, Any]] = [
        {}, {"counts": "stored"}, {"representation": "events"}, {"redraw_noise": True},
        {"representation": "events", "redraw_noise": True, "counts": "int64"}, {"lasers": [2, 0]},
    ]  # fmt: skip
    read, at_once = dg.TransientDataset._whole, list[int]()

    def counted(data: dg.TransientDataset, scenes: Any, draws: Any) -> Any:
        at_once.append(len(scenes))
        return read(data, scenes, draws)

    monkeypatch.setattr(dg.TransientDataset, "_whole", counted)
    for option in options:
        data, parts, other = (dg.TransientDataset(dataset, **option) for _ in range(3))
        (whole,) = DataLoader(data, 3, sampler=order, collate_fn=dg.collate)
        (part,) = DataLoader(Subset(Subset(parts, range(12)), order), 3, collate_fn=dg.collate)
        assert at_once == [3, 3]
        joined = dg.collate(other.__getitems__(order))
        assert at_once == [3, 3, 1, 1, 1]
        at_once.clear()
        for name, values in joined.items():
            assert torch.equal(whole[name], values) and whole[name].dtype == values.dtype, (option, name)
            assert torch.equal(part[name], values)


@pytest.mark.parametrize("workers", [0, 1])
def test_whoever_looks_gets_a_list(dataset: Path, workers: int) -> None:
    """In a collate function, in a training loop, and by a call."""
    data = dg.TransientDataset(dataset)
    kinds = [type(items) for items in read_by(data, workers, lambda items: items)]
    assert {*kinds, type(data.__getitems__([1, 2]))} == {list}
    assert not isinstance(data.__getitems__([1]), Whole)


@pytest.mark.parametrize(
    "option", [{}, {"representation": "events"}, {"transform": doubled}], ids=["whole", "events", "transform"]
)
def test_an_item_is_saved_as_one_item(option: Any, tmp_path: Path) -> None:
    data = dg.TransientDataset(
        write_dataset(
            small_config(capture={"scan": {"rows": 2, "columns": 2}, "time": {"bins": 4096}}),
            tmp_path / "set",
            fake_sample,
        ),
        **option,
    )
    sizes = []
    for item in (data.__getitems__(range(8))[0], data[0], read_by(data, 0, list)[0][1], read_by(data, 1, list)[0][2]):
        torch.save(item, file := io.BytesIO())
        sizes.append(file.tell())
        for values in item.values():
            assert values.untyped_storage().nbytes() == values.nbytes
    assert max(sizes) < 1.2 * min(sizes)


def test_a_transform_runs_where_the_item_is_read(dataset: Path) -> None:
    here = multiprocessing.current_process().name

    def process(item: Item) -> Item:
        return item | {"process": multiprocessing.current_process().name}

    data = dg.TransientDataset(dataset, transform=process)
    assert data[0]["process"] == here
    for workers in (0, 2):
        names = {name for batch in read_by(data, workers) for name in batch["process"]}
        assert (names == {here}) == (workers == 0) and len(names) == max(1, workers)
    pairs = dg.TransientDataset(dataset, transform=lambda item: (item["histogram"], item["depth"]))
    assert [part.shape[0] for part in read_by(pairs, collate=None)[0]] == [5, 5]


def test_a_bad_transform_gets_a_line(dataset: Path) -> None:
    for wrong in (5, "log", {}):
        with pytest.raises(InputError, match=r"transform = .*: must be a function; it gets an item and returns one"):
            dg.TransientDataset(dataset, transform=wrong)  # type: ignore[arg-type]
    with pytest.raises(InputError, match=r"transform: returned nothing for item 3; it must return the item"):
        dg.TransientDataset(dataset, transform=lambda item: None)[3]
    data = dg.TransientDataset(dataset, transform=lambda item: item)
    with pytest.raises(
        InputError, match=r"transform: cannot be sent to a worker that is started afresh .*; define it at"
    ):
        iter(DataLoader(data, 5, num_workers=1, multiprocessing_context="spawn"))


def test_items_that_cannot_be_joined_get_a_line(dataset: Path) -> None:
    data = dg.TransientDataset(dataset)
    with pytest.raises(InputError, match="items: item 1 and the first differ in weight; give all the same keys"):
        dg.collate([data[0], data[1] | {"weight": 1}])
    with pytest.raises(InputError, match=r"items: a list of a dataset's items is needed, one at least"):
        dg.collate([])


def test_events_that_a_user_changed(dataset: Path) -> None:
    """Without counts, with other columns, and made into something of one shape."""
    data = dg.TransientDataset(dataset, ("histogram",), representation="events")
    items = [data[item] for item in (0, 5)]
    rows = [len(item["events"]) for item in items]
    found = dg.collate([{name: item[name] for name in ("events", "scene")} for item in items])
    assert found.keys() == {"events", "scene"} and found["events"].shape == (sum(rows), 4)
    seconds = [
        item | {"events": item["events"][:, :2].float() * 0.5, "counts": item["counts"].numpy()} for item in items
    ]
    found = dg.collate(seconds)
    assert found["events"].shape == (sum(rows), 3) and found["events"].dtype == torch.float32
    assert torch.equal(found["counts"], torch.cat([item["counts"] for item in items]))
    grids = [item | {"events": torch.ones(2, 3, 4), "counts": len(item["counts"])} for item in items]
    assert dg.collate(grids)["events"].shape == (2, 2, 3, 4) and dg.collate(grids)["counts"].tolist() == rows


def test_joined_datasets_are_alike_or_one_line_says_what_differs(dataset: Path, tmp_path: Path) -> None:
    def built(name: str, **time: Any) -> Path:
        capture = {"scan": {"rows": 2, "columns": 2}, "time": {"bins": 16} | time}
        return write_dataset(small_config(capture=capture), tmp_path / name, fake_sample)

    plain = dg.TransientDataset(dataset)
    other = {
        "bins of histogram": dg.TransientDataset(built("width", bin_width_ps=33)),
        "bins of histogram of .* since wall": dg.TransientDataset(built("origin", origin="source")),
        r"bins of histogram of .* from 2 ns": dg.TransientDataset(built("start", start_ns=2)),
        r"shape of histogram of .* is \(4, 1, 8\)": dg.TransientDataset(built("bins", bins=8)),
        "shape of histogram": dg.TransientDataset(dataset, lasers=[0]),
        "type of histogram": dg.TransientDataset(dataset, counts="int32"),
        "fields": dg.TransientDataset(dataset, ("depth",)), "fields of .* as events": dg.TransientDataset(
            dataset, representation="events"),
    }  # fmt: skip
    for match, one in other.items():
        for joined in (
            ConcatDataset([plain, one]),
            Subset(ConcatDataset([Subset(plain, [1, 2]), ConcatDataset([one])]), [0]),
        ):
            with pytest.raises(InputError, match=f"^ConcatDataset: {match}") as caught:
                dg.EpochSampler(joined)
            assert "\n" not in str(caught.value)
    alike = dg.TransientDataset(built("alike"), transform=doubled)
    for fine in (
        [plain, dg.TransientDataset(built("same"))],
        [alike, other["type of histogram"]],
        [Wrapper(plain), plain],
    ):
        dg.EpochSampler(ConcatDataset(fine))
