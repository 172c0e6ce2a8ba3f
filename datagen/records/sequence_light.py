"""The light of a sequence: what stands once for all frames, and what moves for each of them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from datagen.records.arrays import Floats, l2_norm
from datagen.records.capture import TimeAxis
from datagen.records.checks import check_integer, check_kind, check_mapping, check_reals
from datagen.records.sample import Transient


@dataclass(frozen=True, repr=False)
class SequenceLight:
    """Expected photons at the aperture per emitted photon and time bin, of F frames.

    The light of frame f is `static + moving[f]`. What stands is simulated once, so that its noise is the same in all
    frames, to the bit, and no noise in what changes from one to the next. `moving` has a sign: it is what moving
    parts bring, less what they block of the static light. Where frames share nothing (`samplers`), `static` is 0 and
    `moving` all light.

    Attributes
    ----------
    time : the time axis of the bins.
    times_s : (F, L) seconds since the first frame began at which each histogram's laser point is measured: the middle
        of its exposure. Where `samplers` says "frames" a component is that of the middle of the frame instead.
    static : (L, P, T) light that is the same in all frames.
    moving : (F, L, P, T) what comes to it in each frame; may be negative.
    parts : object → (F, L, P, T) its own light of three bounces, that with the hidden vertex on it.
    stderr : (F, L, P, T) standard errors of the light of each frame.
    change_stderr : (F, L, P, T) standard errors of its change from the frame before; 0 in the first frame.
    change_errors : (F,) L2 errors of this change that are claimed, photons: estimates; 0 in the first frame.
    overflow : (F, L, P) energy that arrives outside the window.
    laser_points : (F, L, 3) where each laser ray met the scene, metres, as in `Transient`.
    relative_error : (F,) relative L2 error of the light of each frame, as claimed; NaN where it is not known.
    met_target : (F,) whether the target is met, as in `Transient`; None with a number of samples. Of parts that move
        and share their light, `part_target` is of what they bring less what they block, of all frames together.
    part_errors : object → (F,) estimated relative L2 error of its own light; NaN where nothing is claimed.
    samplers : component → how its light was found: "shared cuts" is what stands once, and what moves by itself;
        "frames: " before a sampler of `Transient` is each frame by itself, with the same random numbers.
    rays : component → rays that its light took in all frames.
    seconds : wall-clock seconds by stage, of all frames.
    blocked : (F,) photons that moving parts take from the static light of three bounces; None where frames share no
        light.

    Raises
    ------
    InputError : values of other types, arrays of other shapes.
    """

    time: TimeAxis
    times_s: Floats
    static: Floats
    moving: Floats
    parts: Mapping[str, Floats]
    stderr: Floats
    change_stderr: Floats
    change_errors: Floats
    overflow: Floats
    laser_points: Floats
    relative_error: Floats
    met_target: NDArray[np.bool_] | None = None
    part_errors: Mapping[str, Floats] = field(default_factory=dict)
    samplers: Mapping[str, str] = field(default_factory=dict)
    rays: Mapping[str, float] = field(default_factory=dict)
    seconds: Mapping[str, float] = field(default_factory=dict)
    blocked: Floats | None = None

    def __post_init__(self) -> None:
        check_kind("SequenceLight.time", self.time, TimeAxis)
        check_reals("SequenceLight.moving", self.moving, (None, None, None, self.time.bins))
        shape, frames = self.moving.shape, self.moving.shape[:1]
        check_reals("SequenceLight.static", self.static, shape[1:])
        check_reals("SequenceLight.times_s", self.times_s, shape[:2])
        check_mapping("SequenceLight.parts", self.parts, np.ndarray, remedy="object → (F, L, P, T) light")
        for name, light in self.parts.items():
            check_reals(f"SequenceLight.parts[{name!r}]", light, shape)
        check_reals("SequenceLight.stderr", self.stderr, shape)
        check_reals("SequenceLight.change_stderr", self.change_stderr, shape)
        check_reals("SequenceLight.change_errors", self.change_errors, frames)
        check_reals("SequenceLight.overflow", self.overflow, shape[:3])
        check_reals("SequenceLight.laser_points", self.laser_points, (*frames, None, 3))
        check_reals("SequenceLight.relative_error", self.relative_error, frames)
        check_mapping("SequenceLight.part_errors", self.part_errors, np.ndarray, remedy="object → (F,) errors")
        if self.blocked is not None:
            check_reals("SequenceLight.blocked", self.blocked, frames)
        check_mapping("SequenceLight.samplers", self.samplers, str, remedy="component → sampler")

    def __repr__(self) -> str:
        frames, lasers, pixels, bins = self.moving.shape
        return (
            f"<SequenceLight of {frames} frames, {lasers} laser points × {pixels} pixels × {bins} bins: parts "
            f"{', '.join(self.parts) or 'none'}; relative error {np.nanmax(self.relative_error, initial=0.0):.2g}>"
        )

    @property
    def frames(self) -> int:
        """Number of frames."""
        return len(self.moving)

    def total(self, frame: int) -> Floats:
        """(L, P, T) the light of a frame."""
        self._check(frame, 0)
        return np.asarray(self.static + self.moving[frame])

    def change(self, frame: int) -> Floats:
        """(L, P, T) the light of a frame less that of the frame before; raises `InputError` for the first frame."""
        self._check(frame, 1)
        return np.asarray(self.moving[frame] - self.moving[frame - 1])

    def change_error(self, frame: int) -> float:
        """Claimed relative L2 error ‖error‖ / ‖change‖ of the light's change from the frame before: an estimate; NaN
        where nothing changes, infinite where the change is not known at all. The change that is measured has noise,
        whose share is taken off its norm."""
        self._check(frame, 1)
        error, norm = float(self.change_errors[frame]), l2_norm(self.change(frame))
        if norm == 0.0:
            return float("nan") if error == 0.0 else float("inf")
        known = norm**2 - error**2
        return error / known**0.5 if known > 0.0 else float("inf")

    def frame(self, frame: int) -> Transient:
        """The light of a frame as that of a scene, with all components in one, `all`."""
        self._check(frame, 0)
        errors = {name: float(error[frame]) for name, error in self.part_errors.items()}
        return Transient(
            self.time, {"all": self.total(frame)}, {name: light[frame] for name, light in self.parts.items()},
            self.stderr[frame], self.overflow[frame], self.laser_points[frame],
            {name: seconds / self.frames for name, seconds in self.seconds.items()},
            float(self.relative_error[frame]), None if self.met_target is None else bool(self.met_target[frame]),
            {name: error for name, error in errors.items() if not np.isnan(error)}, self.samplers,
            {name: rays / self.frames for name, rays in self.rays.items()},
        )  # fmt: skip

    def _check(self, frame: int, first: int) -> None:
        check_integer("SequenceLight", "frame", frame, first, self.frames - 1)
