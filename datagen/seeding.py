"""Random streams: (dataset seed, scene index, purpose) → numpy Generator, and nothing else.

No stream depends on a worker, an order or the time, so a sample is the same whoever computes it and when.
"""

from __future__ import annotations

from enum import IntEnum

import numpy as np

from datagen.errors import InputError


class Purpose(IntEnum):
    """What a stream is for. The numbers are part of every dataset's identity: add, never renumber."""

    SCENE = 1
    CAPTURE = 2
    TRANSPORT = 3
    DETECTOR = 4
    DETECTOR_PARAMETERS = 5
    LABELS = 6
    LOADER = 7
    EFFECTS = 8
    BACKGROUND = 9
    LOADER_BACKGROUND = 10


def seed_sequence(
    dataset_seed: int, scene_index: int, purpose: Purpose, attempt: int = 0, part: int = 0
) -> np.random.SeedSequence:
    """The seed sequence of one purpose of one scene (numpy's `SeedSequence`, spawn key as path)."""
    for name, value in (("seed", dataset_seed), ("index", scene_index)):
        if not isinstance(value, int | np.integer) or isinstance(value, bool) or value < 0:
            raise InputError(f"{name} = {value!r}: must be an integer ≥ 0")
    return np.random.SeedSequence(dataset_seed, spawn_key=(int(purpose), scene_index, attempt, part))


def generator(
    dataset_seed: int, scene_index: int, purpose: Purpose, attempt: int = 0, part: int = 0
) -> np.random.Generator:
    """A Philox generator for one purpose of one scene; `attempt` and `part` split it further."""
    return np.random.Generator(np.random.Philox(seed_sequence(dataset_seed, scene_index, purpose, attempt, part)))


def derived_seed(dataset_seed: int, scene_index: int, purpose: Purpose) -> int:
    """A 64-bit seed for functions that take `seed=`, drawn from the stream of that purpose."""
    return int(seed_sequence(dataset_seed, scene_index, purpose).generate_state(1, np.uint64)[0])
