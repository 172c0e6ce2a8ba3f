"""Redrawn noise is new in every epoch, whoever reads the dataset, without a call; and a function of seed and draw."""

from __future__ import annotations

import copy
import gc
import itertools
import multiprocessing
import os
import pickle
import tempfile
import tracemalloc
from collections import Counter
from collections.abc import Callable, Iterable
from contextlib import suppress
from functools import cache
from pathlib import Path
from typing import Any

import cloudpickle
import numpy as np
import pytest
import torch
from datasets import write_dataset
from fake_samples import fake_sample, noisy_config
from torch.utils.data import (
    BatchSampler,
    ConcatDataset,
    DataLoader,
    Dataset,
    DistributedSampler,
    RandomSampler,
    Subset,
    WeightedRandomSampler,
)

from datagen.errors import InputError
from datagen.loader import EpochSampler, TransientDataset, collate
from datagen.loader.draw_counter import DrawCounter
from datagen.seeding import Purpose, generator

Noise = dict[int, torch.Tensor]


@pytest.fixture(scope="module")
def dataset(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_dataset(noisy_config(), tmp_path_factory.mktemp("noise") / "set", fake_sample)


@pytest.fixture
def data(dataset: Path) -> TransientDataset:
    return TransientDataset(dataset, ("histogram",), redraw_noise=True)


def epoch_of(loader: Iterable[dict[str, torch.Tensor]]) -> Noise:
    """Scene → its counts, of one run through a loader."""
    return {int(s): h for batch in loader for s, h in zip(batch["scene"], batch["histogram"], strict=True)}


@cache
def draws_of(path: Path, number: int, seed: int = 0) -> Noise:
    """Draw `number` of every scene."""
    data = TransientDataset(path, ("histogram",), redraw_noise=True, seed=seed)
    data.set_epoch(number)
    return epoch_of(DataLoader(data, 12))


def alike(a: Noise, b: Noise) -> bool:
    """Whether the scenes of `a` have the same counts in `b`."""
    return all(torch.equal(a[scene], b[scene]) for scene in a)


def all_new(epochs: Iterable[Noise]) -> bool:
    """Whether no scene has the same counts twice."""
    return not any(
        torch.equal(a[scene], b[scene]) for a, b in itertools.combinations(epochs, 2) for scene in a.keys() & b.keys()
    )


class Augmented(Dataset[dict[str, torch.Tensor]]):
    """A wrapper such as people write: items alone, and nothing handed on."""

    def __init__(self, data: TransientDataset) -> None:
        self.data = data

    def __len__(self) -> int:
        return len(self.data)

    def __getitem__(self, item: int) -> dict[str, torch.Tensor]:
        return self.data[item]


FORK: dict[str, Any] = {"num_workers": 2, "multiprocessing_context": "fork"}
SPAWN: dict[str, Any] = {"num_workers": 1, "multiprocessing_context": "spawn"}
LOADERS: dict[str, Any] = {
    "one loader": lambda data: itertools.repeat(DataLoader(data, 5)),
    "a wrapper, persistent workers": lambda data: itertools.repeat(
        DataLoader(Augmented(data), 3, shuffle=True, persistent_workers=True, **FORK)
    ),
    "parts joined": lambda data: itertools.repeat(
        DataLoader(ConcatDataset([Subset(data, [0, 5]), Subset(data, [3, 4])]), 3, **FORK)
    ),
    # What Lightning does: a loader of the same dataset with a sampler of its own, at every fit.
    "an injected sampler": lambda data: (
        DataLoader(data, 5, sampler=DistributedSampler(data, 1, 0), **FORK) for _ in itertools.count()
    ),
    # Whoever is handed the dataset after the first epoch, such as a process, is handed where it stands.
    "a copy": lambda data: (DataLoader(pickle.loads(pickle.dumps(data)) if k else data, 5) for k in range(2)),
    "a spawned worker": lambda data: iter([DataLoader(data, 5), DataLoader(data, 6, **SPAWN)]),
}
"""Ways to read a dataset, or some of its scenes: a dataset → a loader for each epoch."""


@pytest.mark.parametrize("way", [*list(LOADERS)[:-1], pytest.param("a spawned worker", marks=pytest.mark.nightly)])
def test_every_epoch_has_new_noise_without_a_call(data: TransientDataset, dataset: Path, way: str) -> None:
    epochs = [epoch_of(loader) for loader in itertools.islice(LOADERS[way](data), 3)]
    assert len(epochs) >= 2 and all_new(epochs)
    assert all(noise and alike(noise, draws_of(dataset, epoch)) for epoch, noise in enumerate(epochs))


def test_a_scene_read_twice_has_two_draws(data: TransientDataset, dataset: Path) -> None:
    """And draws differ with the seed and from scene to scene."""
    first = draws_of(dataset, 0)
    assert all_new([first, draws_of(dataset, 0, seed=1)]) and not torch.equal(first[0], first[1])
    twice = data.__getitems__([3, 3])
    assert all(torch.equal(item["histogram"], draws_of(dataset, k)[3]) for k, item in enumerate(twice))
    (batch,) = DataLoader(data, 40, sampler=RandomSampler(data, replacement=True, num_samples=40))
    assert len({tuple(row.flatten().tolist()) for row in batch["histogram"]}) == 40


def open_files() -> list[str]:
    """What this process has open: files, and pipes to processes that may not have ended yet."""
    found = []
    for link in Path("/proc/self/fd").iterdir():
        # The one that lists the folder is closed by now.
        with suppress(FileNotFoundError):
            found.append(os.readlink(link))
    return found


@pytest.mark.parametrize("workers", [{}, FORK, {**FORK, "persistent_workers": True}], ids=["none", "2", "persistent"])
@pytest.mark.parametrize("weights", [None, [1.0] + 11 * [0.05]], ids=["random", "weighted"])
def test_scenes_drawn_with_replacement_have_a_draw_for_every_read(
    data: TransientDataset, dataset: Path, workers: dict[str, Any], weights: list[float] | None
) -> None:
    """Draws 0, 1, 2 … of each, whichever worker read it; and files that an epoch opens are closed after it."""
    size = 30
    sampler: Any = (
        RandomSampler(data, replacement=True, num_samples=size) if weights is None
        else WeightedRandomSampler(weights, size)
    )  # fmt: skip
    loader = DataLoader(data, 4, sampler=sampler, collate_fn=collate, **workers)
    found: dict[int, set[bytes]] = {scene: set() for scene in range(12)}
    reads, opened = Counter[int](), []
    for _ in range(3):
        for batch in loader:
            for scene, counts in zip(batch["scene"].tolist(), batch["histogram"], strict=True):
                reads[scene] += 1
                found[scene].add(counts.numpy().tobytes())
        opened.append(sum(path.startswith(str(dataset)) for path in open_files()))
    assert sum(reads.values()) == 3 * size and opened[1] == opened[2]
    for scene, times in reads.items():
        due = {draws_of(dataset, number)[scene].numpy().tobytes() for number in range(times)}
        assert len(found[scene]) == times and found[scene] == due


def test_processes_of_distributed_training_draw_apart(dataset: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Scenes change hands between two ranks from epoch to epoch; none has the same counts twice."""
    ranks = [TransientDataset(dataset, ("histogram",), redraw_noise=True) for _ in range(2)]
    epochs = []
    for epoch in range(4):
        for rank, data in enumerate(ranks):
            monkeypatch.setenv("RANK", str(rank))
            sampler: DistributedSampler[Any] = DistributedSampler(data, 2, rank)
            sampler.set_epoch(epoch)
            epochs.append(epoch_of(DataLoader(data, 3, sampler=sampler, num_workers=rank)))
    hands = [{scene for noise in epochs[rank::2] for scene in noise} for rank in range(2)]
    assert len(hands[0] & hands[1]) > 4 and all_new(epochs)


def test_a_worker_started_afresh_keeps_its_rank(data: TransientDataset, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("torch.distributed.is_initialized", lambda: True)
    monkeypatch.setattr("torch.distributed.get_rank", lambda: 3)
    sent = pickle.dumps(TransientDataset(data.path, ("histogram",), redraw_noise=True))
    monkeypatch.undo()
    assert not torch.equal(pickle.loads(sent)[5]["histogram"], data[5]["histogram"])


@pytest.mark.parametrize("workers", [0, 2])
def test_a_sampler_of_epochs_makes_order_and_noise_repeatable(dataset: Path, workers: int) -> None:
    """Through a split, with epochs left early while workers were fetching ahead."""

    def run(begin: int, epochs: int, left_early: bool) -> list[Noise]:
        train = Subset(TransientDataset(dataset, ("histogram",), redraw_noise=True), [7, 2, 11, 5, 0, 3])
        order = EpochSampler(train, seed=4)
        order.set_epoch(begin)
        options = FORK | {"num_workers": workers, "persistent_workers": True} if workers else {}
        loader = DataLoader(train, 1, sampler=order, **options)
        return [epoch_of(itertools.islice(iter(loader), 2) if left_early else loader) for _ in range(epochs)]

    whole, early = run(0, 3, False), run(0, 3, True)
    assert all_new(whole) and len({tuple(noise) for noise in whole}) == 3
    for epoch, (noise, some) in enumerate(zip(whole, early, strict=True)):
        assert alike(noise, draws_of(dataset, epoch)) and alike(some, noise) and list(some) == list(noise)[:2]
    (again,) = run(2, 1, False)
    assert list(again) == list(whole[2]) and alike(again, whole[2])


def test_a_sampler_of_epochs_fixes_only_the_scenes_it_samples(data: TransientDataset, dataset: Path) -> None:
    """Of nested splits and repeated parts."""
    joined = Subset(ConcatDataset([Subset(data, [4, 5, 6]), Subset(data, [9, 10])]), [0, 2, 3])
    data.set_epoch(7)
    order = EpochSampler(joined)
    order.set_epoch(3)
    sampled = epoch_of(DataLoader(joined, 3, sampler=order))
    assert {*sampled} == {4, 6, 9} and alike(sampled, draws_of(dataset, 3))
    assert alike(epoch_of(DataLoader(Subset(data, [2, 3, 5]), 3)), draws_of(dataset, 7))


def test_workers_that_outlive_an_epoch_see_it_fixed(data: TransientDataset, dataset: Path) -> None:
    loader = DataLoader(data, 12, num_workers=1, persistent_workers=True, multiprocessing_context="fork")
    for epoch in (0, 1, 0):
        data.set_epoch(epoch)
        assert alike(epoch_of(loader), draws_of(dataset, epoch))
    for epoch, items in ((-1, None), (1.5, None), (2**70, None), (0, ["a"]), (0, 3)):
        with pytest.raises(InputError, match=r"(epoch|items) = .*: must be"):
            data.set_epoch(epoch, items)  # type: ignore[arg-type]


def test_no_two_processes_get_the_same_draw() -> None:
    """Two processes that read the same scene at once, as workers do when scenes are drawn with replacement."""
    context, draws, times = multiprocessing.get_context("fork"), DrawCounter(3), 10_000
    begin, found = context.Barrier(2), context.Queue()

    def take() -> None:
        begin.wait()
        found.put([number for _ in range(times) for number, _ in draws.take([1])])

    both = [context.Process(target=take) for _ in range(2)]
    for process in both:
        process.start()
    assert sorted(found.get() + found.get()) == list(range(2 * times))
    for process in both:
        process.join()
    assert draws.take([0, 1, 2]) == [(0, 0), (2 * times, 0), (0, 0)]


def saved(data: TransientDataset, **options: Any) -> TransientDataset:
    with tempfile.TemporaryDirectory() as folder:
        torch.save(data, path := Path(folder) / "data.pt")
        found: TransientDataset = torch.load(path, weights_only=False, **options)
    return found


COPIES: dict[str, Callable[[TransientDataset], TransientDataset]] = {
    "pickle": lambda data: pickle.loads(pickle.dumps(data)),
    "an old pickle": lambda data: pickle.loads(pickle.dumps(data, protocol=2)),
    "deepcopy": copy.deepcopy,
    "copy": copy.copy,
    "cloudpickle": lambda data: pickle.loads(cloudpickle.dumps(data)),
    "torch.save": saved,
    "torch.load of a map": lambda data: saved(data, mmap=True),
    "a copy of a copy": lambda data: copy.deepcopy(pickle.loads(pickle.dumps(data))),
    "in a container": lambda data: copy.deepcopy([Subset(data, range(12))])[0].dataset,  # type: ignore[return-value]
}


@pytest.mark.parametrize(
    ("copied", "workers"),
    [*((kind, {}) for kind in COPIES), ("deepcopy", FORK | {"persistent_workers": True}),
     # Ways to memory that workers may share, or may not.
     *((kind, FORK) for kind in ("pickle", "copy", "torch.save", "torch.load of a map"))],
    ids=lambda value: value if isinstance(value, str) else str(len(value)),
)  # fmt: skip
def test_a_copy_has_new_noise_at_every_read(
    data: TransientDataset, dataset: Path, copied: str, workers: dict[str, Any]
) -> None:
    """It goes on from where the original stood. One that is no shallow copy counts for itself."""
    data[5]
    again = COPIES[copied](data)
    loader = DataLoader(again, 5, **workers)
    epochs = [epoch_of(loader) for _ in range(3)]
    assert all_new([draws_of(dataset, 0), *epochs[1:]])
    assert all(torch.equal(epochs[k][5], draws_of(dataset, k + 1)[5]) for k in range(3))
    assert all(torch.equal(epochs[k][6], draws_of(dataset, k)[6]) for k in range(3))
    four = DataLoader(again, 1, sampler=[3] * 4, **workers)
    assert len({batch["histogram"].numpy().tobytes() for batch in four}) == 4
    assert torch.equal(data[5]["histogram"], draws_of(dataset, 4 if copied == "copy" else 1)[5])


def test_values_are_checked_once_for_all_workers_of_a_copy(data: TransientDataset) -> None:
    again = pickle.loads(pickle.dumps(data))
    list(DataLoader(again, 3, **FORK))
    assert all(seen.all() and seen.is_shared() for seen in again._seen.values())


class Often(Dataset[dict[str, torch.Tensor]]):
    """Every item three times, which nobody outside can know."""

    def __init__(self, data: TransientDataset) -> None:
        self.data = data

    def __len__(self) -> int:
        return 3 * len(self.data)

    def __getitem__(self, item: int) -> dict[str, torch.Tensor]:
        return self.data[item % len(self.data)]


class TwoViews(Augmented):
    """A pair of views of each scene, side by side."""

    def __getitem__(self, item: int) -> dict[str, torch.Tensor]:
        pair = [self.data[item]["histogram"] for _ in range(2)]
        return {"scene": torch.tensor([item, item]), "histogram": torch.stack(pair)}


class Mixing(Augmented):
    """A scene with the one after it, as mixup makes of two."""

    def __getitem__(self, item: int) -> dict[str, torch.Tensor]:
        pair = [self.data[number % len(self)] for number in (item, item + 1)]
        return {name: torch.stack([one[name] for one in pair]) for name in pair[0]}


class Thrice(TransientDataset):
    """More items than scenes."""

    def __len__(self) -> int:
        return 3 * len(self.scenes)

    def __getitem__(self, item: int) -> dict[str, torch.Tensor]:
        return super().__getitem__(item % len(self.scenes))


class Chosen(TransientDataset):
    """Fewer items than scenes, which it chooses by itself."""

    def __len__(self) -> int:
        return 4

    def __getitem__(self, item: int) -> dict[str, torch.Tensor]:
        return super().__getitem__([1, 11, 3, 10][item])


def of_class(kind: type[TransientDataset]) -> Callable[[TransientDataset], TransientDataset]:
    return lambda data: kind(data.path, ("histogram",), redraw_noise=True)


REPEATED: dict[str, tuple[Callable[[TransientDataset], Any], int]] = {
    "joined with itself": (lambda data: ConcatDataset([data] * 4), 48),
    "several times in a part": (lambda data: Subset(data, [3, 3, 5, 3, -1, 11]), 6),
    "parts that overlap": (
        lambda data: ConcatDataset([Subset(data, range(8)), Augmented(data), Subset(data, [0, 0])]),
        22,
    ),
    "a wrapper": (Often, 36),
    "two views": (TwoViews, 24),
    "mixed": (Mixing, 24),
    "a part of mixed": (lambda data: Subset(Mixing(data), range(0, 12, 2)), 12),
    "a subclass of more items": (of_class(Thrice), 36),
    "a subclass of fewer items": (of_class(Chosen), 4),
    "copies beside it": (
        lambda data: ConcatDataset(
            [
                Subset(data, [4, 5, 6]),
                copy.deepcopy(data),
                Augmented(pickle.loads(pickle.dumps(data))),
                of_class(Thrice)(data),
                of_class(TransientDataset)(data),
            ]
        ),
        75,
    ),
    "a shallow copy beside it": (lambda data: ConcatDataset([data, copy.copy(data)]), 24),
}
"""A dataset that reads scenes several times in an epoch, and how many reads that are."""


def reads_of(loader: Iterable[dict[str, torch.Tensor]]) -> list[tuple[int, bytes]]:
    """Scene and counts of every read."""
    return [
        (int(scene), counts.numpy().tobytes())
        for batch in loader
        for scene, counts in zip(batch["scene"].flatten(), batch["histogram"].flatten(0, -4), strict=True)
    ]


@pytest.mark.parametrize("workers", [{}, FORK], ids=["none", "2"])
@pytest.mark.parametrize("way", REPEATED)
def test_every_read_of_an_epoch_has_a_draw_of_its_own(dataset: Path, way: str, workers: dict[str, Any]) -> None:
    """The first is the epoch's; an epoch's draws are the same in every run, whoever read them."""

    def run(begin: int, epochs: int, **options: Any) -> list[set[tuple[int, bytes]]]:
        often = REPEATED[way][0](TransientDataset(dataset, ("histogram",), redraw_noise=True))
        order = EpochSampler(often, seed=1)
        order.set_epoch(begin)
        loader = DataLoader(often, 4, sampler=order, **options)
        return [set(reads_of(loader)) for _ in range(epochs)]

    found = run(0, 2, **workers)
    assert len(set().union(*found)) == 2 * REPEATED[way][1]
    for epoch, draws in enumerate(found):
        due = {(scene, counts.numpy().tobytes()) for scene, counts in draws_of(dataset, epoch).items()}
        assert due & draws == {(scene, counts) for scene, counts in due if scene in {scene for scene, _ in draws}}
    assert run(1, 1) == found[1:]


@pytest.mark.parametrize("ranks", [3, 5])
@pytest.mark.parametrize("way", REPEATED)
def test_ranks_share_the_draws_of_an_epoch(dataset: Path, way: str, ranks: int) -> None:
    """Items that come twice because they do not divide evenly have draws of their own, too. Ranks take turns here."""
    draws, reads = set[tuple[int, bytes]](), 0
    loaders = []
    for rank in range(ranks):
        often = REPEATED[way][0](TransientDataset(dataset, ("histogram",), redraw_noise=True))
        loaders.append(DataLoader(often, 3, sampler=EpochSampler(often, rank=rank, ranks=ranks)))
    for _ in range(2):
        shares = [reads_of(loader) for loader in loaders]
        assert len({len(share) for share in shares}) == 1
        draws, reads = draws.union(*map(set, shares)), reads + sum(map(len, shares))
    assert len(draws) == reads
    if way in ("joined with itself", "several times in a part", "a shallow copy beside it"):
        often = REPEATED[way][0](TransientDataset(dataset, ("histogram",), redraw_noise=True))
        alone = DataLoader(often, 3, sampler=EpochSampler(often))
        assert set(reads_of(alone)) | set(reads_of(alone)) <= draws, (
            "those of one process, and what fills up the ranks"
        )


def test_processes_that_others_deal_out_have_draws_of_their_own(
    dataset: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As Accelerate does with the order of one process: every second batch."""
    draws, reads = set(), 0
    for rank in range(2):
        monkeypatch.setenv("RANK", str(rank))
        often = ConcatDataset([TransientDataset(dataset, ("histogram",), redraw_noise=True)] * 3)
        batches = [*BatchSampler(EpochSampler(often), 2, False)][rank::2]
        found = reads_of(DataLoader(often, batch_sampler=batches))
        draws, reads = draws | {*found}, reads + len(found)
    assert len(draws) == reads == 36


def rank_trains(data: TransientDataset, rank: int, step: Any, out: Any) -> None:
    """Epochs of a rank, which begin when `step` says so."""
    loader = DataLoader(data, 3, sampler=EpochSampler(data, rank=rank, ranks=2))
    for _ in range(2):
        step[rank].get()
        out.put((rank, reads_of(loader)))


def test_processes_that_are_sent_a_dataset_have_epochs_of_their_own(dataset: Path) -> None:
    """One rank begins its second epoch before the other begins the first."""
    context = multiprocessing.get_context("fork")
    data = TransientDataset(dataset, ("histogram",), redraw_noise=True)
    step, out = [context.Queue() for _ in range(2)], context.Queue()
    both = [context.Process(target=rank_trains, args=(data, rank, step, out)) for rank in range(2)]
    for process in both:
        process.start()
    found: dict[int, list[Any]] = {0: [], 1: []}
    for turn in (1, 1, 0, 0):
        step[turn].put(None)
        rank, reads = out.get(timeout=60)
        found[rank].append(reads)
    for process in both:
        process.join()
    for epoch in range(2):
        due = {(scene, counts.numpy().tobytes()) for scene, counts in draws_of(dataset, epoch).items()}
        assert {*found[0][epoch], *found[1][epoch]} == due


def test_memory_is_flat_over_epochs(tmp_path: Path) -> None:
    """With measured edges of a TDC, 0.26 MB for each detector that has a copy of its own."""
    edges = np.sort(np.random.default_rng(0).uniform(0, 1, (64, 129)), axis=1)
    edges[:, 0], edges[:, -1] = 0, 1
    edges *= 128 * noisy_config().capture.time.bin_width_ps
    config = noisy_config(tdc_edges_ps=tuple(map(tuple, edges.tolist())))
    data = TransientDataset(write_dataset(config, tmp_path / "set", fake_sample), ("histogram",), redraw_noise=True)
    data[0]
    tracemalloc.start()
    try:
        for _ in range(5):
            assert len(epoch_of(DataLoader(data, 1, sampler=EpochSampler(data)))) == 12
        gc.collect()
        grown, _ = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert grown < 1e6


def test_orders_come_from_a_stream_of_their_own(monkeypatch: pytest.MonkeyPatch) -> None:
    """No order of an epoch is what a stream of the noise, of any scene, draw and process, would shuffle."""
    streams = set()
    for rank in range(4):
        monkeypatch.setenv("RANK", str(rank))
        streams |= {stream for _, stream in DrawCounter(1).take([0, 0])}
    shuffled = {
        tuple(generator(5, scene, purpose, attempt=number, part=stream).permutation(20).tolist())
        for purpose in (Purpose.LOADER, Purpose.LOADER_BACKGROUND)
        for scene, number, stream in itertools.product(range(6), range(6), streams)
    }
    assert len(shuffled) == 2 * 6 * 6 * 4
    order = EpochSampler(range(20), seed=5)
    assert shuffled.isdisjoint(tuple(order) for _ in range(6))
