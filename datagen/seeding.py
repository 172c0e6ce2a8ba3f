"""Random streams: a numpy `Generator` is a function of (dataset seed, scene index, purpose) alone.

No stream depends on a worker, an order or the time, so a sample is the same whoever computes it and when.
"""

from __future__ import annotations

from enum import IntEnum

import numpy as np

from datagen.errors import InputError, shown


class Purpose(IntEnum):
    """What a stream is for. The numbers are part of every dataset's identity: add, never renumber."""

    SCENE = 1
    CAPTURE = 2
    TRANSPORT = 3
    DETECTOR = 4
    DETECTOR_PARAMETERS = 5
    LOADER = 7
    EFFECTS = 8
    BACKGROUND = 9
    LOADER_BACKGROUND = 10
    MOTION = 11
    SENSOR_MOTION = 12


class LightStream(IntEnum):
    """What the random numbers of the transport are for, within `Purpose.TRANSPORT` of a scene. The seed of a
    quasi-random sequence is a hash of this number, the scene's seed, and further numbers such as those of laser
    point, pixel and replicate.

    The values are part of every dataset's identity, as those of `Purpose` are. Two names may share a value only where
    their further numbers always differ, or where they are meant to draw alike.
    """

    BEAM = 17
    FACTORISED_FOV_POINTS = 32
    FACTORISED_FIRST = 33
    FACTORISED_SECOND = 34
    FACTORISED_LIT = 35
    CUTS = 66
    BLOCKS = 80
    PATHS = 81
    SAMPLED_PATHS = 96
    # The value of `SAMPLED_PATHS`, which adds one number to the hash, not two.
    REFERENCE = 96
    LATER_PATHS = 97
    PLAIN_REFERENCE = 99


def seed_sequence(
    dataset_seed: int, scene_index: int, purpose: Purpose, attempt: int = 0, part: int = 0, frame: int | None = None
) -> np.random.SeedSequence:
    """numpy's `SeedSequence` of one purpose of one scene; its spawn key is (purpose, scene, attempt, part), and the
    frame of a sequence where each has a stream of its own."""
    for name, value in (("seed", dataset_seed), ("index", scene_index)):
        if not isinstance(value, int | np.integer) or isinstance(value, bool) or value < 0:
            raise InputError(f"{name} = {shown(value)}: must be an integer ≥ 0")
    own = () if frame is None else (frame,)
    return np.random.SeedSequence(dataset_seed, spawn_key=(int(purpose), scene_index, attempt, part, *own))


def generator(
    dataset_seed: int, scene_index: int, purpose: Purpose, attempt: int = 0, part: int = 0
) -> np.random.Generator:
    """A Philox generator for one purpose of one scene; each `attempt` and `part` has a stream of its own."""
    return np.random.Generator(np.random.Philox(seed_sequence(dataset_seed, scene_index, purpose, attempt, part)))


def derived_seed(dataset_seed: int, scene_index: int, purpose: Purpose) -> int:
    """A 64-bit seed for functions that take `seed=`, from the stream of one purpose of one scene."""
    return int(seed_sequence(dataset_seed, scene_index, purpose).generate_state(1, np.uint64)[0])
