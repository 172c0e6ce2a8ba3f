"""One random stream for each (seed, laser point, pixel), whatever the batching."""

from __future__ import annotations

import numpy as np

from datagen.errors import InputError
from datagen.seeding import Purpose


class Streams:
    """Philox streams that differ in their counter: 2¹²⁸ draws for each (laser point, pixel).

    One generator is moved from stream to stream, which takes a few µs where building one takes tens.
    """

    def __init__(self, seed: int) -> None:
        if not isinstance(seed, (int, np.integer)) or isinstance(seed, bool) or seed < 0:
            raise InputError(f"seed = {seed!r}: must be an integer ≥ 0")
        key = np.random.SeedSequence(int(seed), spawn_key=(int(Purpose.DETECTOR),)).generate_state(2, np.uint64)
        self._bits = np.random.Philox(key=key)
        self._generator = np.random.Generator(self._bits)
        self._start = self._bits.state

    def at(self, laser: int, pixel: int) -> np.random.Generator:
        """The generator, at the start of the stream of this laser point and pixel; the former stream is lost."""
        self._start["state"]["counter"][:] = (0, 0, pixel, laser)
        self._bits.state = self._start
        return self._generator
