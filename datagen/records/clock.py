"""When the laser points of a sequence of frames are measured."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, get_args

import numpy as np

from datagen.errors import InputError
from datagen.records.arrays import Floats, Ints
from datagen.records.checks import check_choice, check_integer, check_number

Order = Literal["raster", "serpentine", "interleaved", "together"]
"""`raster`: laser points by their numbers, row by row; `serpentine`: every second row backwards; `interleaved`: four
coarse scans, each of every second point of every second row; `together`: all points of a frame at once."""

MOST_FRAMES = 100_000
MOST_POINTS = 2**22
"""Laser points of a frame."""
SPARE = 1e-9
"""Share of a frame by which its exposures may exceed it: rounding."""


@dataclass(frozen=True)
class Clock:
    """Frames of a sequence: frame f begins at f / rate, and its laser points follow one another without a gap.

    Attributes
    ----------
    frames : how many.
    rate_hz : frames in a second.
    order : in which laser points are measured: `raster`, `serpentine`, `interleaved`, `together`.
    columns : laser points in a row of the scan, which `serpentine` and `interleaved` need to know; left out: as many
        as there are rows.

    Raises
    ------
    InputError : no frames, a rate that is not positive, an unknown order.

    Examples
    --------
    >>> import datagen as dg
    >>> clock = dg.Clock(frames=2, rate_hz=10, order="serpentine", columns=2)
    >>> clock.times(points=4, exposure_s=0.02).round(3).tolist()
    [[0.01, 0.03, 0.07, 0.05], [0.11, 0.13, 0.17, 0.15]]
    """

    frames: int
    rate_hz: float
    order: Order = "raster"
    columns: int | None = None

    def __post_init__(self) -> None:
        check_integer("Clock", "frames", self.frames, 1, MOST_FRAMES)
        check_number("Clock", "rate_hz", self.rate_hz, 1e-3, 1e9, "frames per second")
        check_choice("Clock.order", self.order, get_args(Order))
        if self.columns is not None:
            check_integer("Clock", "columns", self.columns, 1, 2**20)

    @property
    def starts_s(self) -> Floats:
        """(frame,) seconds at which the frames begin; the first at 0."""
        return np.arange(self.frames) / self.rate_hz

    @property
    def duration_s(self) -> float:
        """Seconds of all frames together."""
        return self.frames / self.rate_hz

    def times(self, points: int, exposure_s: float, repetition_rate_hz: float | None = None) -> Floats:
        """(frame, laser) seconds: the middle of each laser point's exposure.

        Parameters
        ----------
        points : number of laser points.
        exposure_s : how long each of them is measured; with the order `together`, all of them.
        repetition_rate_hz : of the laser, so that a refusal can name the number of cycles that fits.

        Raises
        ------
        InputError : the exposures of a frame do not fit into it; points that fill no rows of `columns`.
        """
        self._check_fits("Clock.times", points, exposure_s, repetition_rate_hz)
        return self.starts_s[:, None] + (self._turns(points) + 0.5) * exposure_s

    def middles(self, points: int, exposure_s: float) -> Floats:
        """(frame,) seconds: the middle of each frame's measurement, which labels are made for. It is the mean of the
        frame's `times`, and earlier than the middle of the frame where exposures do not fill it."""
        self._check_fits("Clock.middles", points, exposure_s, None)
        return self.starts_s + 0.5 * self._exposures(points) * exposure_s

    def turns(self, points: int) -> Ints:
        """(laser,) the number of laser points that are measured before each one in its frame."""
        check_integer("Clock.turns", "points", points, 1, MOST_POINTS)
        return self._turns(points)

    def _turns(self, points: int) -> Ints:
        every = np.arange(points)
        if self.order == "together":
            return np.zeros_like(every)
        if self.order == "raster":
            return every
        columns = self._columns(points)
        row, column = np.divmod(every, columns)
        if self.order == "serpentine":
            return np.asarray(row * columns + np.where(row % 2 == 1, columns - 1 - column, column))
        # Every coarse scan covers the whole wall; the second lies diagonally between the points of the first.
        coarse = np.array([[0, 2], [3, 1]])[row % 2, column % 2]
        turns = np.empty_like(every)
        turns[np.lexsort((column, row, coarse))] = every
        return turns

    def _columns(self, points: int) -> int:
        columns = round(points**0.5) if self.columns is None else self.columns
        if points % columns or (self.columns is None and columns**2 != points):
            given = "left out" if self.columns is None else f"{self.columns}"
            raise InputError(
                f"Clock.columns {given} with order = {self.order!r} and {points} laser points: rows of equal length "
                "are needed; give the number of points in a row, or take order = 'raster'"
            )
        return columns

    def _exposures(self, points: int) -> int:
        """How many exposures follow one another in a frame."""
        return 1 if self.order == "together" else points

    def _check_fits(self, call: str, points: int, exposure_s: float, repetition_rate_hz: float | None) -> None:
        check_integer(call, "points", points, 1, MOST_POINTS)
        check_number(call, "exposure_s", exposure_s, 0.0, 1e9, "seconds")
        if repetition_rate_hz is not None:
            check_number(call, "repetition_rate_hz", repetition_rate_hz, 1e-3, 1e13, "pulses per second")
        number, frame_s = self._exposures(points), 1.0 / self.rate_hz
        if number * exposure_s <= frame_s * (1 + SPARE):
            return
        fits = f"{1e3 * frame_s / number:.4g} ms"
        if repetition_rate_hz is not None:
            cycles = int(frame_s / number * repetition_rate_hz * (1 + SPARE))
            fits = f"{cycles} cycles ({fits} at {1e-6 * repetition_rate_hz:g} MHz)" if cycles else "not one cycle"
        raise InputError(
            f"Clock.rate_hz = {self.rate_hz:g}: a frame lasts {1e3 * frame_s:.4g} ms, and {number} exposures of "
            f"{1e3 * exposure_s:.4g} ms take {1e3 * number * exposure_s:.4g} ms; {fits} fits for each, or lower "
            f"rate_hz to {1 / (number * exposure_s):.4g}"
        )
