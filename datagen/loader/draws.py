"""Which draw of its noise a scene is at: counted by the scene, in memory that all loader workers share."""

from __future__ import annotations

import os
from collections.abc import Sequence
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import distributed

from datagen.errors import InputError


class DrawCounter:
    """Every read of a scene is its next draw; a fixed epoch makes each scene's next read the draw of that number.

    A count belongs to a scene, not to an epoch, since nothing tells a dataset that one begins: wrappers, samplers and
    workers that live on hand it indices, and no more. What a scene is at depends on how often it was read alone, so
    neither workers nor prefetching nor the order of scenes enter.

    The processes of distributed training count each for itself, and which scene meets which process changes from
    epoch to epoch: each draws from streams of its own, save right after an epoch was fixed, when all know the number.
    """

    def __init__(self, scenes: int) -> None:
        self._rank: int | None = None
        # Of each scene: number of the next draw, whether it was fixed.
        state: Any = torch.zeros((scenes, 2), dtype=torch.int64)
        self._state: torch.Tensor = state.share_memory_()

    def fix(self, epoch: int, scenes: NDArray[np.int64]) -> None:
        """The next read of each of these scenes is draw `epoch`, and those that follow count on from there."""
        if not isinstance(epoch, int | np.integer) or epoch < 0:
            raise InputError(f"epoch = {epoch!r}: must be a whole number ≥ 0")
        self._state[torch.from_numpy(scenes)] = torch.tensor([int(epoch), 1])

    def take(self, scenes: Sequence[int]) -> list[tuple[int, int]]:
        """(draw, stream) of each scene of a batch, which are thereby taken: no read after this has them again."""
        rank, state = self._own_rank(), self._state.numpy()
        taken = []
        for scene in scenes:
            draw, fixed = int(state[scene, 0]), bool(state[scene, 1])
            state[scene] = draw + 1, 0
            # Streams 1 and 2 order epochs and deal out splits.
            taken.append((draw, 0 if fixed or rank == 0 else rank + 2))
        return taken

    def __getstate__(self) -> dict[str, Any]:
        """A worker that is started afresh is told the rank of the process that starts it."""
        return self.__dict__ | {"_rank": self._own_rank()}

    def _own_rank(self) -> int:
        if distributed.is_available() and distributed.is_initialized():
            return distributed.get_rank()
        launched = os.environ.get("RANK", "")
        return self._rank or (int(launched) if launched.isdigit() else 0)
