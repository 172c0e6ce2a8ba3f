"""The number of the next draw of each scene, in memory that a dataset shares with the workers of its loaders."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import torch
from numba.core import cgutils
from numba.extending import intrinsic
from torch.utils.data import get_worker_info

from datagen.compiled import compiled
from datagen.errors import InputError, shown
from datagen.loader.ranks import rank_of_process
from datagen.records.arrays import Ints

NUMBER, READS, KIND, BEGIN, FIXES = range(5)
"""Rows of the state: number of the draw that reads count from; reads since then; what `NUMBER` is, one of the kinds
below; `READS` when it was fixed last; how often it was fixed."""
COUNTED, FROM, EPOCH, BESIDES = range(4)
"""Kinds of scenes: never fixed; fixed by `fix`, whose reads are draws `NUMBER`, `NUMBER` + 1 …; fixed by
`begin_epoch`, whose reads are repeats of the epoch `NUMBER`, because the epoch has them, or besides."""
REPEATS = 2**31
"""Streams from here on belong to scenes that come several times in an epoch; no rank is as large."""


class DrawCounter:
    """Counts the draws of each scene. `take` returns (number, stream) of the next draw of a scene and counts it.

    Each scene has a count of its own, because a dataset does not know when an epoch begins: wrappers, samplers and
    workers only pass indices. The number of a draw depends on how often the scene was read, and not on workers,
    prefetching or the order of scenes. In an epoch that a sampler announced (`begin_epoch`), a draw is a function of
    epoch and repeat: the first read of a scene is repeat 0.

    The processes of distributed training count separately, and read the same scene in turns. So each process draws
    from a stream of its own, except for the first read after `fix`, whose number is the same in all of them, and in
    epochs, where each process has repeats of its own.

    The counts lie in shared memory, so that all workers of a loader count together. A copy (by `pickle`, `deepcopy`,
    `torch.save` …) counts for itself, and goes on from where the original stood.
    """

    def __init__(self, scenes: int) -> None:
        self._rank: int | None = None
        self._state = shared_copy(torch.zeros((5, scenes), dtype=torch.int64))
        # One more than the epoch of the state that was loaded last, until an epoch begins; else 0.
        self._loaded = shared_copy(torch.zeros(1, dtype=torch.int64))
        self._process = os.getpid()
        self._own: _OwnReads | None = None
        # Compiled here, once, before workers are forked.
        self.take(())
        _merge(self._rows()[READS], *np.zeros((2, 0), np.int64))

    def fix(self, number: int, scenes: Ints) -> None:
        """Make the next read of each of these scenes draw `number`; later reads count on from there."""
        check_epoch(number)
        self._fix(scenes, number, np.zeros(len(scenes), np.int64), FROM)

    def begin_epoch(self, epoch: int, scenes: Ints, repeats: Ints) -> None:
        """Make the next read of each of these scenes the repeat of `epoch` that `repeats` has for it; later reads are
        the repeats after it."""
        check_epoch(epoch)
        self._loaded[0] = 0
        self._fix(scenes, epoch, repeats, EPOCH)

    def begin_besides(self, epoch: int, scenes: Ints, repeats: Ints) -> None:
        """Make the next read of each of these scenes that repeat of `epoch`, unless somebody else has fixed it. The
        epoch does not have these scenes, but a class of a user's may read them for its items."""
        free = np.isin(self._rows()[KIND, scenes], (COUNTED, BESIDES))
        self._fix(scenes[free], epoch, repeats[free], BESIDES)

    def take(self, scenes: Sequence[int]) -> list[tuple[int, int]]:
        """(number, stream) of the next draw of each scene of a batch; later reads get other ones."""
        rows, wanted = self._rows(), np.array(scenes, np.int64)
        if self._own is not None:
            self._own.count(rows, wanted)
        reads, rank = _next_draws(rows[READS], wanted).tolist(), self.rank
        found = []
        for read, number, kind in zip(reads, rows[NUMBER][wanted].tolist(), rows[KIND][wanted].tolist(), strict=True):
            if kind in (EPOCH, BESIDES):
                found.append((number, REPEATS + read if read else 0))
            else:
                # Streams 1 and 2 belong to the order of epochs and to splits.
                found.append((number + read, 0 if rank == 0 or (kind == FROM and read == 0) else rank + 2))
        return found

    def separate(self) -> None:
        """Count apart from the process that this counter comes from: one of distributed training that is started with
        the dataset of another shares its memory, but has epochs of its own."""
        if self._process != os.getpid() and get_worker_info() is None:
            self._state, self._loaded, self._process = (
                shared_copy(self._state),
                shared_copy(self._loaded),
                os.getpid(),
            )

    def state_dict(self) -> dict[str, Any]:
        """The counts, as the sum of two: `begin`, and `reads`, which in a worker are its own since then. A loader
        collects the states of its workers when they handed over the same batch, while others may have read on."""
        rows = self._rows()
        if get_worker_info() is None:
            begin, reads = rows[READS].copy(), np.zeros(rows.shape[1], np.int64)
        else:
            if self._own is None:
                self._own = _OwnReads(rows, rows[READS].copy(), np.zeros(rows.shape[1], np.int64))
            self._own.renew(rows, np.arange(rows.shape[1]))
            begin, reads = self._own.begin.copy(), self._own.reads.copy()
        parts = {"number": rows[NUMBER].copy(), "kind": rows[KIND].copy(), "begin": begin, "reads": reads}
        return {name: torch.from_numpy(values) for name, values in parts.items()}

    def load_state_dict(self, state: Mapping[str, Any]) -> None:
        """Go on from a state. Each worker of a loader loads that of its predecessor: together they restore the sum.

        Raises `InputError` for a state of anything else.
        """
        rows = self._rows()
        found = [
            state.get(name) if isinstance(state, Mapping) else None for name in ("number", "kind", "begin", "reads")
        ]
        if not all(isinstance(one, torch.Tensor) and one.shape == rows[READS].shape for one in found):
            raise InputError(
                f"load_state_dict: not a state of a dataset with {rows.shape[1]} scenes whose noise is drawn anew"
            )
        number, kind, begin, reads = (one.numpy().astype(np.int64) for one in found if one is not None)
        rows[NUMBER], rows[KIND] = number, kind
        self._loaded[0] = number[kind == EPOCH].max(initial=-1) + 1
        if get_worker_info() is None:
            rows[READS] = rows[BEGIN] = begin + reads
            rows[FIXES] += 1
        else:
            _merge(rows[READS], begin, reads)
            self._own = _OwnReads(rows, begin.copy(), reads.copy())

    @property
    def rank(self) -> int:
        """The rank of this process; in a worker, that of the process that started it."""
        return rank_of_process(self._rank)

    @property
    def loaded_epoch(self) -> int | None:
        """The epoch in which the state was saved that was loaded last; None if an epoch has begun since."""
        return int(self._loaded[0]) - 1 if self._loaded[0] else None

    def __getstate__(self) -> dict[str, Any]:
        """The state with the rank of this process, which a spawned worker takes over."""
        return self.__dict__ | {"_rank": self.rank, "_own": None}

    def __setstate__(self, state: dict[str, Any]) -> None:
        """`multiprocessing`, which starts workers, hands over the shared memory; all others a copy of its values."""
        self.__dict__.update(state)
        if not self._state.is_shared():
            self._state, self._loaded, self._process = (
                shared_copy(self._state),
                shared_copy(self._loaded),
                os.getpid(),
            )

    def _rows(self) -> Ints:
        rows: Ints = self._state.numpy()
        return rows

    def _fix(self, scenes: Ints, number: int, reads: Ints, kind: int) -> None:
        rows = self._rows()
        rows[NUMBER, scenes], rows[KIND, scenes] = int(number), kind
        rows[READS, scenes] = rows[BEGIN, scenes] = reads
        rows[FIXES, scenes] += 1


class _OwnReads:
    """How often this worker read each scene since its count was `begin`; kept for loaders that ask for states."""

    def __init__(self, rows: Ints, begin: Ints, reads: Ints) -> None:
        self.begin, self.reads, self._fixes = begin, reads, rows[FIXES].copy()

    def renew(self, rows: Ints, scenes: Ints) -> None:
        """Begin anew for those of these scenes that were fixed since their last read."""
        fixed = scenes[self._fixes[scenes] != rows[FIXES][scenes]]
        self.begin[fixed], self.reads[fixed], self._fixes[fixed] = rows[BEGIN][fixed], 0, rows[FIXES][fixed]

    def count(self, rows: Ints, scenes: Ints) -> None:
        """Count a read of each of these scenes, some of which may come several times."""
        self.renew(rows, scenes)
        np.add.at(self.reads, scenes, 1)


def shared_copy(values: torch.Tensor) -> torch.Tensor:
    """A copy of `values` in memory that this process shares with workers which it starts."""
    own: torch.Tensor = values.clone().share_memory_()
    return own


def check_epoch(epoch: object) -> None:
    """Raise `InputError` unless `epoch` can be the number of an epoch."""
    if not isinstance(epoch, int | np.integer) or not 0 <= epoch < 2**62:
        raise InputError(f"epoch = {shown(epoch)}: must be a whole number in 0 … 2^62")


@intrinsic
def _fetch_and_add(typing: Any, counts: Any, place: Any, by: Any) -> Any:
    """counts[place], to which `by` is added at the same moment: no other process can read it in between."""
    return _atomic("add", counts, place, by)


@intrinsic
def _raised_to(typing: Any, counts: Any, place: Any, least: Any) -> Any:
    """counts[place], which becomes `least` at the same moment if it is smaller."""
    return _atomic("max", counts, place, least)


def _atomic(operation: str, counts: Any, place: Any, value: Any) -> Any:
    """Signature and code of an operation on an element of an array that no other process can divide."""

    def code(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        array = context.make_array(counts)(context, builder, arguments[0])
        at: Any = cgutils.get_item_pointer
        number = at(context, builder, counts, array, [arguments[1]])
        return builder.atomic_rmw(operation, number, arguments[2], "seq_cst")

    return counts.dtype(counts, place, counts.dtype), code


@compiled()
def _next_draws(counts: Ints, places: Ints) -> Ints:
    """(n,) counts at these places, each of which is raised by one."""
    taken = np.empty(len(places), np.int64)
    for i in range(len(places)):
        taken[i] = _fetch_and_add(counts, places[i], 1)  # type: ignore[call-arg]
    return taken


@compiled()
def _merge(counts: Ints, begin: Ints, reads: Ints) -> None:
    """Make every count `begin` + `reads`, or `reads` more than what other workers have made of it meanwhile.

    Workers do this at once and in any order. All bring the same `begin`, and reads of their own.
    """
    for i in range(len(begin)):
        _raised_to(counts, i, begin[i])  # type: ignore[call-arg]
        _fetch_and_add(counts, i, reads[i])
