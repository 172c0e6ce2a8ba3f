"""Redrawn noise is new in every epoch, whoever reads the dataset, without a call; and a function of seed and draw."""

from __future__ import annotations

import gc
import itertools
import multiprocessing
import os
import pickle
import tracemalloc
from collections import Counter
from collections.abc import Iterable
from contextlib import suppress
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from datasets import write_dataset
from fake_samples import fake_sample, noisy_config
from torch.utils.data import (
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
