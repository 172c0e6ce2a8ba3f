"""The order of an epoch: a function of its seed and number."""

from __future__ import annotations

from collections.abc import Iterator, Sized

import numpy as np
from torch.utils.data import ConcatDataset, Sampler, Subset

from datagen.errors import InputError
from datagen.loader.dataset import TransientDataset
from datagen.records.arrays import Ints
from datagen.records.checks import check_flag, check_integer, check_kind, check_seed
from datagen.seeding import Purpose, generator


class EpochSampler(Sampler[int]):
    """The order of items in an epoch, a function of (seed, epoch): shuffled, then dealt out to `ranks` processes.

    `rank` is the index of this process. All processes get the same number of items: if the items do not divide
    evenly, some come twice. Every iteration is the next epoch; the first one is 0, or the one that `set_epoch` names.

    When an epoch begins, the redrawn noise of the items becomes a function of (seed of the dataset, epoch, scene),
    also through `Subset` (`random_split`) and `ConcatDataset`. So a run can be repeated bit for bit from any epoch
    on, with any number of workers and ranks.
    """

    def __init__(self, data: Sized, seed: int = 0, *, shuffle: bool = True, rank: int = 0, ranks: int = 1) -> None:
        check_kind("data", data, Sized, remedy="such as a TransientDataset")
        check_seed(seed)
        check_flag("shuffle", shuffle)
        check_integer("EpochSampler", "ranks", ranks, 1, 2**31)
        check_integer("EpochSampler", "rank", rank, -(2**31), 2**31)
        if ranks < 1 or not 0 <= rank < ranks:
            raise InputError(f"rank = {rank}, ranks = {ranks}: rank must lie in 0 … ranks − 1")
        self._data, self._seed, self._shuffle = data, seed, shuffle
        self._rank, self._ranks, self._epoch = rank, ranks, 0

    def set_epoch(self, epoch: int) -> None:
        """Set the number of the next epoch; later epochs count on from it."""
        check_integer("EpochSampler", "epoch", epoch, 0, 2**62)
        self._epoch = epoch

    def __len__(self) -> int:
        return -(-len(self._data) // self._ranks)

    def __iter__(self) -> Iterator[int]:
        # A generator runs nothing before its first item is requested. Until then workers may still be reading for the
        # epoch before, whose noise must not change.
        epoch, self._epoch = self._epoch, self._epoch + 1
        order = np.arange(len(self._data))
        _fix_noise(self._data, epoch, order)
        if self._shuffle:
            order = generator(self._seed, epoch, Purpose.LOADER, part=1).permutation(order)
        dealt = np.resize(order, len(self) * self._ranks)
        yield from dealt[self._rank :: self._ranks].tolist()


def _fix_noise(data: object, epoch: int, items: Ints) -> None:
    """Call `set_epoch` of the datasets that `data` is made of, for the scenes of these items."""
    if isinstance(data, TransientDataset):
        data.set_epoch(epoch, items.tolist())
    elif isinstance(data, Subset):
        _fix_noise(data.dataset, epoch, np.asarray(data.indices, np.int64)[items])
    elif isinstance(data, ConcatDataset):
        ends = np.asarray(data.cumulative_sizes)
        for part, dataset in enumerate(data.datasets):
            begin = ends[part - 1] if part else 0
            _fix_noise(dataset, epoch, items[(items >= begin) & (items < ends[part])] - begin)
