"""A part of a field's values: which laser points, pixels and bins are read."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Indices = NDArray[np.int64]


@dataclass(frozen=True, eq=False)
class Part:
    """A part of one scene's value.

    axes : the indices that are read of each axis but the last, in their order.
    last : what is read of the last axis, a slice of step 1, since that axis is never cut into chunks.
    """

    axes: tuple[Indices, ...]
    last: slice

    @property
    def shape(self) -> tuple[int, ...]:
        """The shape of the part."""
        return *map(len, self.axes), self.last.stop - self.last.start

    def of(self, values: NDArray[np.generic]) -> NDArray[np.generic]:
        """The part of a whole value; a copy."""
        taken: NDArray[np.generic] = values[..., self.last][np.ix_(*self.axes)] if self.axes else values[self.last]
        return np.ascontiguousarray(taken)
