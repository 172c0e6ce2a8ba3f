"""How far modelled histograms are from measured ones, and how far fitted numbers may be from the true ones."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from datagen.records.arrays import Floats


@dataclass(frozen=True)
class Fitted:
    """A number that a fit found, and its standard error (by frame, robust against what the model misses)."""

    value: float
    error: float

    def __str__(self) -> str:
        return f"{self.value:.5g} ± {self.error:.1g}"


class HistogramErrors:
    """The errors of histograms (n, zones, bins), as `modelled` and as `measured`.

    held_out : whether the fit did not see them.
    """

    measured: Floats
    modelled: Floats
    held_out: bool

    @property
    def tested(self) -> str:
        """How many frames are tested, and whether the fit saw them."""
        seen = "which the fit did not see" if self.held_out else "which were fitted, too"
        return f"{len(self.measured)} frames tested, {seen}"

    @cached_property
    def relative_l2(self) -> Floats:
        """(n, zones) ‖modelled − measured‖ / ‖measured‖ of each histogram."""
        return relative_l2(self.modelled, self.measured)

    @cached_property
    def peak_shift(self) -> Floats:
        """(n, zones) modelled minus measured position of the peak, bins."""
        return peak_positions(self.modelled) - peak_positions(self.measured)


def relative_l2(modelled: Floats, measured: Floats) -> Floats:
    """(…) ‖modelled − measured‖ / ‖measured‖ of histograms (…, bins)."""
    return np.asarray(np.linalg.norm(modelled - measured, axis=-1) / np.linalg.norm(measured, axis=-1))


def clustered_covariance(jacobian: Floats, residuals: Floats, frames: int) -> Floats:
    """(k, k) covariance of k numbers of a least-squares fit, from its Jacobian (rows, k) and residuals (rows,).

    The first rows that residuals are given for are those of the frames, one frame after the other; rows beyond them,
    such as those of priors, add information only. The gradients of each frame are summed before they are squared, so
    that a misfit that all zones and bins of a frame share counts once (the sandwich of White, Econometrica 48, 817
    (1980), by clusters).
    """
    data = len(residuals)
    by_frame = (jacobian[:data] * residuals[:, None]).reshape(frames, -1, jacobian.shape[1]).sum(axis=1)
    information = np.linalg.pinv(jacobian.T @ jacobian)
    return np.asarray(information @ (by_frame.T @ by_frame) @ information)


def peak_positions(histograms: Floats) -> Floats:
    """(…) position of the peak of histograms (…, bins), bins: the vertex of a parabola through its three top bins."""
    top = np.clip(histograms.argmax(axis=-1), 1, histograms.shape[-1] - 2)
    low, mid, high = (np.take_along_axis(histograms, (top + k)[..., None], -1)[..., 0] for k in (-1, 0, 1))
    bend = low - 2 * mid + high
    return np.asarray(top + 0.5 * np.divide(low - high, bend, out=np.zeros_like(bend), where=bend != 0) + 0.5)
