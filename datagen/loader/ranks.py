"""The place of this process among those of distributed training.

It is that of `torch.distributed` where that runs, else the one that a launcher such as torchrun states in RANK and
WORLD_SIZE, else what the process found that started this one, a loader's worker.
"""

from __future__ import annotations

import os

from torch import distributed


def rank_of_process(found: int | None = None) -> int:
    """Rank of this process; 0 outside of distributed training."""
    if distributed.is_available() and distributed.is_initialized():
        return distributed.get_rank()
    stated = os.environ.get("RANK", "")
    return int(stated) if stated.isdigit() else found or 0


def number_of_ranks(found: int | None = None) -> int:
    """Number of processes that train together, at least 1."""
    if distributed.is_available() and distributed.is_initialized():
        return distributed.get_world_size()
    stated = os.environ.get("WORLD_SIZE", "")
    return max(int(stated) if stated.isdigit() else found or 1, 1)
