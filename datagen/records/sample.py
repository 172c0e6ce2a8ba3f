"""What the stages hand on: the transient of a capture, and a finished sample."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from datagen.records.capture import TimeAxis

Scalar = float | int | str | bool


@dataclass(frozen=True)
class Transient:
    """Expected photons at the aperture per emitted photon and time bin, as an impulse response.

    Attributes
    ----------
    time : the time axis of the bins.
    components : "direct", "primary", "secondary", "higher" → (L, P, T) float64; only those simulated.
    parts : the primary split by the part that the lookin lies on, part name → (L, P, T).
    stderr : (L, P, T) standard error of `total` from independent scramblings; NaN when there was only one.
    overflow : (L, P) energy that arrives outside the window.
    laser_points : (L, 3) where each laser ray met the scene, metres; NaN where it met nothing.
    seconds : wall-clock seconds of the simulation by stage.
    """

    time: TimeAxis
    components: Mapping[str, NDArray[np.float64]]
    parts: Mapping[str, NDArray[np.float64]]
    stderr: NDArray[np.float64]
    overflow: NDArray[np.float64]
    laser_points: NDArray[np.float64]
    seconds: Mapping[str, float] = field(default_factory=dict)

    @cached_property
    def total(self) -> NDArray[np.float64]:
        """(L, P, T): the sum of the components."""
        first, *rest = self.components.values()
        return sum(rest, start=first) if rest else first

    @property
    def relative_error(self) -> float:
        """Estimated relative L2 error of the whole transient: ‖stderr‖ / ‖total‖ (0 for an empty transient)."""
        norm = float(np.linalg.norm(self.total))
        return float(np.linalg.norm(self.stderr)) / norm if norm > 0 else 0.0


@dataclass(frozen=True)
class Sample:
    """One scene's row of a dataset.

    arrays : field name → array, as `store/schema.py` describes them (no scene axis).
    parameters : scalars for the table `samples.parquet`: what was drawn, the error estimate, the effects decided.
    seconds : wall-clock seconds by stage ("scene", "transport", "detector", "labels").
    """

    index: int
    arrays: Mapping[str, NDArray[np.generic]]
    parameters: Mapping[str, Scalar]
    seconds: Mapping[str, float]
