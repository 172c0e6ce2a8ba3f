"""The order of an epoch: a function of its seed and number."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sized
from typing import Any

import numpy as np
from torch.utils.data import Sampler

from datagen.errors import InputError, shown
from datagen.loader.joined import Found, check_joined, datasets_of
from datagen.records.arrays import Ints
from datagen.records.checks import check_flag, check_integer, check_kind, check_seed
from datagen.seeding import Purpose, generator

UNKNOWN = 2**20
"""Repeats of a scene that each rank has for itself where a user's dataset hides which scenes it reads, or how
often."""
COPY = 2**52
"""Repeats of a scene for each further dataset of the same path and seed; no rank has as many for itself."""


class EpochSampler(Sampler[int]):
    """The order of items in an epoch, a function of (seed, epoch): shuffled, then dealt out to `ranks` processes.

    `rank` is the index of this process. All processes get the same number of items: if the items do not divide
    evenly, some come twice. Every iteration is the next epoch; the first one is 0, or the one that `set_epoch` names.

    When an epoch begins, the redrawn noise of the items becomes a function of (seed of the dataset, epoch, scene, how
    often the scene came before in this epoch), also through `Subset` (`random_split`), `ConcatDataset` and datasets
    that wrap another. So a run can be repeated bit for bit from any epoch and item on, with any number of workers and
    ranks; only of a scene that comes several times in an epoch, two workers or ranks may exchange draws.

    A run that was stopped goes on by `load_state_dict`, or `set_epoch` with the number of items that were done
    (docs/resuming.md).

    Raises
    ------
    InputError : a rank that is none; datasets that are joined by `ConcatDataset` and differ in fields, shapes, units
        or bins.
    """

    def __init__(self, data: Sized, seed: int = 0, *, shuffle: bool = True, rank: int = 0, ranks: int = 1) -> None:
        check_kind("data", data, Sized, remedy="such as a TransientDataset")
        check_seed(seed)
        check_flag("shuffle", shuffle)
        check_integer("EpochSampler", "ranks", ranks, 1, 2**31)
        check_integer("EpochSampler", "rank", rank, -(2**31), 2**31)
        if ranks < 1 or not 0 <= rank < ranks:
            raise InputError(f"rank = {rank}, ranks = {ranks}: rank must lie in 0 … ranks − 1")
        check_joined(data)
        self._data, self._seed, self._shuffle = data, seed, shuffle
        self._rank, self._ranks = rank, ranks
        # The epoch that the next iteration hands out, and how many of its items it leaves out.
        self._epoch, self._done = 0, 0
        # Whether `set_epoch` or `load_state_dict` named them; the iteration that is under way, if any.
        self._is_told = False
        self._running: _Epoch | None = None
        for found in datasets_of(data, np.arange(0)):
            found.draws.separate()

    def set_epoch(self, epoch: int, done: int | None = None) -> None:
        """Set the number of the next epoch; later epochs count on from it.

        done : number of items of this process that are left out at its start, because they were done before a stop.
            None: none, or those of a state that was loaded, if that is of the same epoch.
        """
        check_integer("EpochSampler", "epoch", epoch, 0, 2**62)
        if done is None:
            done = self._done if epoch == self._epoch and self._is_told else 0
        check_integer("EpochSampler", "done", done, 0, len(self))
        self._epoch, self._done, self._is_told, self._running = int(epoch), int(done), True, None

    def state_dict(self, done: int | None = None) -> dict[str, int]:
        """Where the order stands: `epoch`, and `done`, the number of its items that this process was handed; and what
        the order is made from.

        done : the number of items that were used, if a loader has fetched ahead.
        """
        epoch, handed = (self._epoch, self._done) if self._running is None else self._running.place
        if done is not None:
            check_integer("EpochSampler", "done", done, 0, len(self))
        return self._state(epoch, handed if done is None else int(done))

    def load_state_dict(self, state: Mapping[str, Any]) -> None:
        """Make the next iteration go on from a state that `state_dict` returned, here or in another run.

        Raises `InputError` for the state of another order, in the middle of an epoch.
        """
        check_kind("load_state_dict", state, Mapping, remedy="what state_dict of an EpochSampler returned")
        if not {"epoch", "done"} <= state.keys():
            raise InputError(
                "load_state_dict: has no epoch and done; give it what state_dict of an EpochSampler returned"
            )
        self.set_epoch(state["epoch"], self._done_of(state) if state["done"] else state["done"])

    def _done_of(self, state: Mapping[str, Any]) -> int:
        """The number of items of this process that are done in the epoch of a state."""
        here = self._state(0, 0)
        given: dict[str, Any] = {**here, **state}
        for name in ("done", "items", "ranks"):
            check_integer("load_state_dict", name, given[name], 0 if name == "done" else 1, 2**62)
        # All processes have been handed as many items, which were dealt out in turn.
        done = int(given["done"]) * int(given["ranks"])
        if given.keys() <= state.keys() and done >= given["items"]:
            return len(self)
        for name in ("items", "seed", "shuffle"):
            if given[name] != here[name]:
                raise InputError(
                    f"load_state_dict: the state is of an order with {name} = {shown(given[name])}, in which "
                    f"{given['done']} items are done, this one has {here[name]}, and scenes would come twice or "
                    "never; give it the same, or begin the next epoch with set_epoch"
                )
        if done % self._ranks:
            raise InputError(
                f"load_state_dict: {done} items are done in {given['ranks']} processes, which {self._ranks} cannot "
                "share evenly; take as many as before, or begin the next epoch with set_epoch"
            )
        return done // self._ranks

    def _state(self, epoch: int, done: int) -> dict[str, int]:
        order = {"items": len(self._data), "seed": int(self._seed), "shuffle": self._shuffle, "ranks": self._ranks}
        return {"epoch": epoch, "done": done, **order}

    def __len__(self) -> int:
        return -(-len(self._data) // self._ranks)

    def __iter__(self) -> Iterator[int]:
        return _Epoch(self)

    def _begin(self, iteration: _Epoch) -> tuple[int, int, list[int]]:
        """Begin the next epoch: its number, how many of its items are left out, and all items of this process."""
        epoch, done = self._epoch, self._done
        order = np.arange(len(self._data))
        if self._shuffle:
            order = generator(self._seed, epoch, Purpose.LOADER, part=1).permutation(order)
        dealt = np.resize(order, len(self) * self._ranks)
        before: dict[tuple[str, int], list[Ints]] = {}
        for found in datasets_of(self._data, dealt):
            equals = before.setdefault(found.source, [])
            self._begin_noise(found, epoch, done, equals)
            equals.append(found.every_scene())
        self._epoch, self._done, self._is_told, self._running = epoch + 1, 0, False, iteration
        return epoch, done, dealt[self._rank :: self._ranks].tolist()

    def _end(self, iteration: _Epoch) -> None:
        """End an iteration, after which the next epoch is due."""
        if self._running is iteration:
            self._running = None

    def _begin_noise(self, found: Found, epoch: int, done: int, equals: list[Ints]) -> None:
        """Tell a dataset which repeats of its scenes this process is to draw.

        equals : scenes of each dataset of the same path and seed that is told before.
        """

        def apart(scenes: Ints, repeats: Ints | int) -> Ints:
            copies: Ints = np.zeros(len(scenes), np.int64)
            for other in equals:
                copies += np.isin(scenes, other)
            return copies * COPY + repeats

        draws = found.draws
        if draws.loaded_epoch not in (None, epoch, epoch - 1) and not self._is_told:
            raise InputError(
                f"EpochSampler: begins epoch {epoch}, but the state that its dataset loaded is of epoch "
                f"{draws.loaded_epoch}; call set_epoch({draws.loaded_epoch}, done=…), or give the loader sampler= "
                "and not batch_sampler= (docs/resuming.md)"
            )
        rank = self._rank if self._ranks > 1 else draws.rank
        if found.hidden is not None:
            draws.begin_epoch(epoch, found.hidden, apart(found.hidden, rank * UNKNOWN + done))
            return
        number, scenes = found.scenes.max(initial=-1) + 1, found.scenes
        of_rank = found.positions % self._ranks
        elsewhere = np.bincount(scenes[of_rank < self._rank], minlength=number)
        here = np.bincount(
            scenes[(of_rank == self._rank) & (found.positions // self._ranks < done)], minlength=number
        )
        repeats = here + (elsewhere if found.is_once else np.where(elsewhere > 0, rank * UNKNOWN, 0))
        if self._ranks == 1 and rank:
            # Whoever deals out this order to processes, as Accelerate does, is not known here: of scenes that come
            # several times each process has repeats of its own.
            times = np.bincount(scenes, minlength=number)
            repeats += np.where(times > 1, rank * times, 0)
        own = np.unique(scenes[of_rank == self._rank])
        draws.begin_epoch(epoch, own, apart(own, repeats[own]))
        others = np.setdiff1d(found.others, own)
        is_alone = self._ranks == 1 and not rank
        draws.begin_besides(epoch, others, apart(others, done + (0 if is_alone else (self._ranks + rank) * UNKNOWN)))


class _Epoch(Iterator[int]):
    """The items of one epoch, from where the sampler stands when the first one is asked for. Until then workers may
    still be reading for the epoch before, whose noise must not change.

    torchdata's `StatefulDataLoader` saves and loads its state.
    """

    def __init__(self, sampler: EpochSampler) -> None:
        self._sampler = sampler
        self._items: list[int] | None = None
        self.place = 0, 0

    def __next__(self) -> int:
        if self._items is None:
            epoch, done, self._items = self._sampler._begin(self)
            self.place = epoch, done
        epoch, done = self.place
        if done >= len(self._items):
            self._sampler._end(self)
            raise StopIteration
        self.place = epoch, done + 1
        return self._items[done]

    def state_dict(self) -> dict[str, int]:
        """That of the sampler after the items that this iteration handed out."""
        epoch, done = self.place
        return self._sampler.state_dict() if self._items is None else self._sampler._state(epoch, done)

    def load_state_dict(self, state: Mapping[str, Any]) -> None:
        """Go on from a state."""
        self._items = None
        self._sampler.load_state_dict(state)
