"""The order of an epoch, the same for everyone who names its seed and number."""

from __future__ import annotations

from collections.abc import Iterator, Sized

import numpy as np
from torch.utils.data import Sampler

from datagen.errors import InputError
from datagen.loader.dataset import TransientDataset
from datagen.seeding import Purpose, generator


class EpochSampler(Sampler[int]):
    """The order of an epoch, a function of (seed, epoch): shuffled, then dealt out to `ranks` training processes.

    `rank` is the number of this one. Each gets the same number of items: the order is continued from its start where
    the items do not divide evenly. Also gives the dataset the epoch, so that redrawn noise follows.
    """

    def __init__(self, data: Sized, seed: int = 0, *, shuffle: bool = True, rank: int = 0, ranks: int = 1) -> None:
        if ranks < 1 or not 0 <= rank < ranks:
            raise InputError(f"rank = {rank}, ranks = {ranks}: rank must lie in 0 … ranks − 1")
        self._data, self._seed, self._shuffle = data, seed, shuffle
        self._rank, self._ranks, self._epoch = rank, ranks, 0

    def set_epoch(self, epoch: int) -> None:
        """Choose the epoch; call it before iterating."""
        self._epoch = epoch
        if isinstance(self._data, TransientDataset):
            self._data.set_epoch(epoch)

    def __len__(self) -> int:
        return -(-len(self._data) // self._ranks)

    def __iter__(self) -> Iterator[int]:
        order = np.arange(len(self._data))
        if self._shuffle:
            order = generator(self._seed, self._epoch, Purpose.LOADER, part=1).permutation(order)
        dealt = np.resize(order, len(self) * self._ranks)
        return iter(dealt[self._rank :: self._ranks].tolist())
