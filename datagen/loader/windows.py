"""Windows of frames: what an item holds of a sequence."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from datagen.errors import InputError, shown
from datagen.records.arrays import Ints
from datagen.records.checks import check_integer
from datagen.store import Manifest


@dataclass(frozen=True)
class Windows:
    """The windows of each scene of a dataset.

    firsts : (W,) first frame of each window, one window of all frames if none are asked for. length : frames of a
    window; None of scenes that are measured once. are_asked_for : whether items are windows, and not whole scenes.
    """

    firsts: Ints
    length: int | None
    are_asked_for: bool

    @classmethod
    def of(cls, manifest: Manifest, frames: int | None, frame_step: int | None) -> Windows:
        """Windows of `frames` frames, one every `frame_step` frames (None: one after the other).

        Raises `InputError` for windows of scenes that are measured once, or longer than these are.
        """
        there = manifest.frames
        for name, given in (("frames", frames), ("frame_step", frame_step)):
            if given is not None and there is None:
                raise InputError(f"{name} = {shown(given)}: the dataset has no sequences, and scenes have no frames")
        if frames is None:
            if frame_step is not None:
                raise InputError(f"frame_step = {shown(frame_step)} without frames: say how long a window is")
            return cls(np.zeros(1, np.int64), there, False)
        assert there is not None
        check_integer("TransientDataset", "frames", frames, 1, there)
        if frame_step is not None:
            check_integer("TransientDataset", "frame_step", frame_step, 1, there)
        return cls(np.arange(0, there - frames + 1, frame_step or frames), int(frames), True)

    def frames_of(self, window: int) -> Ints:
        """(length,) the frames of a window of a sequence."""
        assert self.length is not None
        return np.asarray(self.firsts[window] + np.arange(self.length))
