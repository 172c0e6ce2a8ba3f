"""Redrawn noise is new in every epoch, whoever reads the dataset, without a call; and a function of seed and draw."""

from __future__ import annotations

import gc
import itertools
import multiprocessing
import pickle
import tracemalloc
from collections.abc import Iterable, Iterator
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
    random_split,
)

from datagen.errors import InputError
from datagen.loader import EpochSampler, TransientDataset
from datagen.loader.redrawn_noise import DrawCounter
from datagen.seeding import Purpose, generator

Noise = dict[int, torch.Tensor]
EPOCHS = 3


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
    return a.keys() == b.keys() and all(torch.equal(a[scene], b[scene]) for scene in a)


def all_new(epochs: Iterable[Noise]) -> bool:
    """Whether no scene has the same counts twice."""
    return all(
        not torch.equal(a[scene], b[scene])
        for a, b in itertools.combinations(epochs, 2)
        for scene in a.keys() & b.keys()
    )


class Augmented(Dataset[dict[str, torch.Tensor]]):
    """A wrapper such as people write: items alone, and nothing handed on."""

    def __init__(self, data: TransientDataset) -> None:
        self.data = data

    def __len__(self) -> int:
        return len(self.data)

    def __getitem__(self, item: int) -> dict[str, torch.Tensor]:
        return self.data[item]


def loaders(data: TransientDataset) -> Iterator[tuple[str, Any]]:
    """(name, loaders) of different ways to read a dataset, or some of its scenes, with one loader for each epoch."""

    def alive(loader: Any) -> Iterator[Any]:
        return itertools.repeat(loader, EPOCHS)

    def made_anew(**options: Any) -> Iterator[Any]:
        return (DataLoader(data, 5, **options) for _ in range(EPOCHS))

    fork: dict[str, Any] = {"num_workers": 2, "multiprocessing_context": "fork"}
    yield "plain", alive(DataLoader(data, 5))
    yield "persistent workers", alive(DataLoader(data, 3, shuffle=True, persistent_workers=True, **fork))
    yield "ConcatDataset", alive(DataLoader(ConcatDataset([Subset(data, [0, 5]), Subset(data, [3, 4])]), 3, **fork))
    yield "a wrapper", alive(DataLoader(Augmented(data), 5, persistent_workers=True, **fork))
    # What Lightning does: a loader of the same dataset with a sampler of its own, at every fit.
    yield "an injected sampler", made_anew(sampler=DistributedSampler(data, 1, 0, shuffle=False), **fork)
    # Whoever is handed the dataset after the first epoch, such as a process, is handed where it stands.
    yield "a copy by pickle", (DataLoader(pickle.loads(pickle.dumps(data)) if k else data, 5) for k in range(2))
    spawned = DataLoader(data, 6, num_workers=1, multiprocessing_context="spawn")
    yield "a spawned worker", iter([DataLoader(data, 5), spawned])


@pytest.mark.parametrize("number", [*range(6), pytest.param(6, marks=pytest.mark.nightly)])
def test_every_epoch_has_new_noise_without_a_call(data: TransientDataset, dataset: Path, number: int) -> None:
    name, each_epoch = list(loaders(data))[number]
    epochs = [epoch_of(loader) for loader in each_epoch]
    assert len(epochs) >= 2 and all_new(epochs), name
    for epoch, noise in enumerate(epochs):
        draws = draws_of(dataset, epoch)
        assert alike(noise, {scene: draws[scene] for scene in noise}), name


def test_draws_are_functions_of_seed_number_and_scene(dataset: Path) -> None:
    first = draws_of(dataset, 0)
    assert alike(first, draws_of.__wrapped__(dataset, 0)) and len(first) == 12
    assert all_new([first, draws_of(dataset, 1), draws_of(dataset, 0, seed=1)])
    assert not torch.equal(first[0], first[1])


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
    zeroth = data[5]["histogram"]
    monkeypatch.setattr("torch.distributed.is_initialized", lambda: True)
    monkeypatch.setattr("torch.distributed.get_rank", lambda: 3)
    sent = pickle.dumps(TransientDataset(data.path, ("histogram",), redraw_noise=True))
    monkeypatch.undo()
    assert not torch.equal(pickle.loads(sent)[5]["histogram"], zeroth)


@pytest.mark.parametrize("workers", [0, 2])
def test_a_sampler_of_epochs_makes_order_and_noise_repeatable(dataset: Path, workers: int) -> None:
    """Through a split, with epochs left early while workers were fetching ahead."""

    def run(begin: int, epochs: int, left_early: bool) -> list[dict[int, torch.Tensor]]:
        data = TransientDataset(dataset, ("histogram",), redraw_noise=True)
        train, _ = random_split(data, [9, 3], torch.Generator().manual_seed(0))
        order = EpochSampler(train, seed=4)
        order.set_epoch(begin)
        loader = DataLoader(
            train, 1, sampler=order, num_workers=workers, persistent_workers=workers > 0,
            multiprocessing_context="fork" if workers else None,
        )  # fmt: skip
        return [epoch_of(itertools.islice(iter(loader), 2) if left_early else loader) for _ in range(epochs)]

    whole, early = run(0, 4, False), run(0, 4, True)
    assert all_new(whole) and len({tuple(noise) for noise in whole}) == 4
    for epoch, (noise, some) in enumerate(zip(whole, early, strict=True)):
        draws = draws_of(dataset, epoch)
        assert alike(noise, {scene: draws[scene] for scene in noise})
        assert list(some) == list(noise)[:2] and alike(some, {scene: noise[scene] for scene in some})
    assert all(alike(a, b) for a, b in zip(run(2, 2, False), whole[2:], strict=True))


def test_a_sampler_of_epochs_fixes_the_scenes_it_samples(data: TransientDataset, dataset: Path) -> None:
    """Nested splits, repeated parts, and scenes that another loader is reading."""
    held, rest = Subset(data, [2, 3]), Subset(data, [4, 5, 6])
    joined = Subset(ConcatDataset([rest, Subset(data, [9, 10])]), [0, 2, 3])
    data.set_epoch(7)
    order = EpochSampler(joined)
    order.set_epoch(3)
    noise = epoch_of(DataLoader(joined, 3, sampler=order))
    three, seven = draws_of(dataset, 3), draws_of(dataset, 7)
    assert alike(noise, {scene: three[scene] for scene in (4, 6, 9)})
    assert alike(epoch_of(DataLoader(held, 2)), {scene: seven[scene] for scene in (2, 3)})
    assert torch.equal(data[5]["histogram"], seven[5]) and torch.equal(data[4]["histogram"], draws_of(dataset, 4)[4])


def test_a_scene_read_twice_has_two_draws(data: TransientDataset, dataset: Path) -> None:
    twice = data.__getitems__([3, 3])
    assert all(torch.equal(item["histogram"], draws_of(dataset, k)[3]) for k, item in enumerate(twice))
    replaced = DataLoader(data, 40, sampler=RandomSampler(data, replacement=True, num_samples=40))
    (batch,) = replaced
    counts = [tuple(row.flatten().tolist()) for row in batch["histogram"]]
    assert len(set(counts)) == 40


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
    numbers = sorted(found.get() + found.get())
    for process in both:
        process.join()
    assert numbers == list(range(2 * times))
    assert draws.take([0, 1, 2]) == [(0, 0), (2 * times, 0), (0, 0)]


def test_memory_is_flat_over_epochs(tmp_path: Path) -> None:
    """With measured edges of a TDC, 0.26 MB for each detector that has a copy of its own."""
    edges = np.sort(np.random.default_rng(0).uniform(0, 1, (64, 129)), axis=1)
    edges[:, 0], edges[:, -1] = 0, 1
    edges *= 128 * noisy_config().capture.time.bin_width_ps
    config = noisy_config(tdc_edges_ps=tuple(map(tuple, edges.tolist())))
    data = TransientDataset(write_dataset(config, tmp_path / "set", fake_sample), ("histogram",), redraw_noise=True)
    loader = DataLoader(data, 1, sampler=EpochSampler(data))
    data[0]
    tracemalloc.start()
    try:
        for _ in range(5):
            assert len(epoch_of(loader)) == 12
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
    assert len(streams) == 4 and len(shuffled) == 2 * 6 * 6 * 4
    order = EpochSampler(range(20), seed=5)
    assert shuffled.isdisjoint(tuple(order) for _ in range(6))


def test_workers_that_outlive_an_epoch_see_it_fixed(data: TransientDataset, dataset: Path) -> None:
    loader = DataLoader(data, 12, num_workers=1, persistent_workers=True, multiprocessing_context="fork")
    for epoch in (0, 1, 0):
        data.set_epoch(epoch)
        assert alike(epoch_of(loader), draws_of(dataset, epoch))


def test_epochs_and_items_that_are_none_are_refused(data: TransientDataset) -> None:
    for wrong in (-1, 1.5, 2**70):
        with pytest.raises(InputError, match=f"epoch = {wrong}: must be a whole number"):
            data.set_epoch(wrong)  # type: ignore[arg-type]
    for items in (["a"], 3):
        with pytest.raises(InputError, match=r"^items = .*: must be a list of whole numbers"):
            data.set_epoch(0, items)  # type: ignore[arg-type]
    with pytest.raises(InputError, match=r"^shape: 'hist' is not in .*; it has histogram, "):
        data.shape("hist")
