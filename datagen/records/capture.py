"""The capture of a scene: laser, sensor, time axis, and which laser point goes with which pixel."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Literal, get_args
from warnings import warn

import numpy as np
from numpy.typing import ArrayLike

from datagen.errors import InputError, InputWarning
from datagen.records.arrays import Floats, Ints
from datagen.records.checks import (
    as_points,
    as_rows,
    as_shaped,
    as_weights,
    check_choice,
    check_flag,
    check_integer,
    check_kind,
    check_number,
)  # fmt: skip

Origin = Literal["source", "wall"]
Pairing = Literal["exhaustive", "confocal"]
Illumination = Literal["scan", "flood"]


WIDEST_APERTURE_M = 1.0
WIDEST_BIN_S = 1e-3
"""A larger aperture or bin was most likely given in another unit: users get a warning."""
MOST_BINS = 2**26
MOST_VALUES = 2**36
PERIOD_ACCURACY = 1e-9
"""Relative excess of a time axis over the laser period that counts as rounding of the two."""


def _check_parallelograms(name: str, corners: Floats) -> None:
    """Raise `InputError` unless all quadrilaterals of corners (n, 4, 3) are parallelograms to a millionth."""
    a, b, c, d = corners.swapaxes(0, 1)
    size = np.linalg.norm(c - a, axis=1)
    bad = np.flatnonzero(np.linalg.norm(a + c - b - d, axis=1) > 1e-6 * size)
    if len(bad):
        raise InputError(
            f"{name}[{bad[0]}]: its corners are those of no parallelogram, which footprints and cells of a beam "
            "need; give four corners in order around with a + c = b + d"
        )


def _lattice(name: str, center: ArrayLike, right: ArrayLike, up: ArrayLike, rows: int, columns: int | None) -> Floats:
    """(rows · columns, 4, 3) corners of the equal cells of the rectangle `center ± right ± up`.

    Row 0 is at the top and column 0 at −right; corners go around from the lower left. Raises `InputError` for fewer
    than one row or column, and for `right` and `up` that span no rectangle.
    """
    check_integer(name, "rows", rows, 1, 2**20)
    check_integer(name, "columns", columns, 1, 2**20)
    assert columns is not None
    named = (("center", center), ("right", right), ("up", up))
    c, r, u = (as_points(f"{name}: {key}", value, (3,)) for key, value in named)
    if np.linalg.norm(np.cross(r, u)) <= 1e-9 * np.linalg.norm(r) * np.linalg.norm(u):
        raise InputError(
            f"{name}: right = {r.tolist()} and up = {u.tolist()} span no area; give half the width and half "
            "the height of the rectangle as vectors, neither of them 0 nor along the other"
        )
    across = np.linspace(-1, 1, columns + 1)
    upward = np.linspace(1, -1, rows + 1)
    knots = c + across[None, :, None] * r + upward[:, None, None] * u
    cells = np.stack([knots[1:, :-1], knots[1:, 1:], knots[:-1, 1:], knots[:-1, :-1]], axis=2)
    return cells.reshape(rows * columns, 4, 3)


@dataclass(frozen=True, init=False)
class Laser:
    """A pulsed laser: each laser point is the first surface from `position` towards one of `targets`.

    Attributes
    ----------
    position : (3,) where the light comes from, metres.
    targets : (L, 3) one target for each laser point, metres; only the direction from `position` to it counts.
    weights : (L,) shares of a flood's light that the laser points stand for, ≥ 0, scaled to the sum 1; None for equal
        shares.
    cells : (L, 4, 3) corners, in order around, of the part of a flood's beam that each laser point stands for, metres
        (`Laser.flood` makes them); None for light that goes to the targets alone. Light is spread evenly over a
        cell's quadrilateral, which has to be a parallelogram.

    Raises
    ------
    InputError : another shape, coordinates that are not finite, a target at `position`, weights that are negative or
        all 0, or a cell that is no parallelogram.

    Examples
    --------
    >>> import datagen as dg
    >>> laser = dg.Laser(position=(0, 0, 1), targets=[(3, -0.5, 1), (3, 0.5, 1)])
    >>> laser.targets.shape
    (2, 3)
    """

    position: Floats
    targets: Floats
    weights: Floats | None
    cells: Floats | None

    def __init__(
        self,
        position: ArrayLike,
        targets: ArrayLike,
        weights: ArrayLike | None = None,
        cells: ArrayLike | None = None,
    ) -> None:
        object.__setattr__(self, "position", as_points("Laser.position", position, (3,)))
        object.__setattr__(self, "targets", as_points("Laser.targets", targets, (None, 3)))
        if (np.linalg.norm(self.targets - self.position, axis=1) == 0).any():
            raise InputError("Laser.targets: a target equals the laser position; it gives no direction")
        count = len(self.targets)
        if weights is not None:
            weights = as_weights("Laser.weights", weights, (count,))
            if weights.sum() <= 0:
                raise InputError("Laser.weights: all are 0, so no light is emitted; give positive shares")
            weights = weights / weights.sum()
        object.__setattr__(self, "weights", weights)
        if cells is not None:
            cells = as_points("Laser.cells", cells, (count, 4, 3))
            _check_parallelograms("Laser.cells", cells)
        object.__setattr__(self, "cells", cells)

    @classmethod
    def flood(
        cls, position: ArrayLike, center: ArrayLike, right: ArrayLike, up: ArrayLike, rows: int, columns: int,
        weights: ArrayLike | None = None,
    ) -> Laser:  # fmt: skip
        """One wide beam through the rectangle `center ± right ± up`, as rows × columns laser points in its cells.

        The laser points are the middles of equal cells, row 0 at the top, column 0 at −right; light goes to all of
        the cells, not to their middles alone. `weights` (rows · columns,) are the shares of the light in the cells.
        It goes with `Capture(…, illumination="flood")`.

        Raises `InputError` for fewer than one row or column, and for `right` and `up` that span no rectangle.

        >>> import datagen as dg
        >>> laser = dg.Laser.flood((0, 0, 1), center=(1, 0, 1), right=(0, -0.3, 0), up=(0, 0, 0.3), rows=4, columns=4)
        >>> laser.targets.shape, laser.cells.shape
        ((16, 3), (16, 4, 3))
        """
        cells = _lattice("Laser.flood", center, right, up, rows, columns)
        return cls(position, cells.mean(axis=1), weights, cells)

    def take(self, lasers: Ints | slice) -> Laser:
        """The laser with some of its targets, by number, and their weights and cells; equal shares where all of these
        weights are 0, which say nothing about a scan."""
        lasers = as_rows("Laser.take: lasers", lasers, len(self.targets))
        weights = None if self.weights is None else self.weights[lasers]
        weights = None if weights is None or not weights.any() else weights
        return Laser(self.position, self.targets[lasers], weights, None if self.cells is None else self.cells[lasers])

    @property
    def shares(self) -> Floats:
        """(L,) shares of a flood's light, which sum to 1."""
        return np.full(len(self.targets), 1 / len(self.targets)) if self.weights is None else self.weights


@dataclass(frozen=True, init=False)
class Sensor:
    """A camera of `P` pixels with a small round aperture.

    Attributes
    ----------
    position : (3,) aperture centre, metres.
    pixels : (P, 4, 3) corners, in order around, of each pixel's field of view on (or beyond) the wall as seen from
        `position`: they fix four directions, the wall itself is found by rays.
    aperture_radius_m : radius of the entrance aperture, > 0.
    finite_aperture : count what a disc of that radius receives, a²/(R² + a²), which matters when the sensor stands
        within some ten radii of the wall; False is the small-aperture limit a²/R².
    footprints : (P, R, C) sensitivity of each pixel over its quadrilateral, ≥ 0, on a grid of R × C equal cells, in
        units of the full aperture; row 0 lies at the side from corner 0 to corner 1, column 0 at corner 0. The
        quadrilaterals, which may overlap, have to be parallelograms. None: 1 everywhere.
    crosstalk : share of the light of all other pixels that each pixel receives as well, ≥ 0; for floods only.
    glass : (P,) photons that the sensor's cover glass sends straight back to each pixel at the moment of emission,
        per emitted photon, ≥ 0; part of the direct light of a flood. None: no glass.
    delays_s : (P,) seconds by which all light of a pixel is recorded late (early if negative), from different lengths
        of wire; for floods only. None: no delays.

    Raises
    ------
    InputError : another shape, coordinates that are not finite, a radius that is not positive, or a pixel with a
        footprint that is no parallelogram.
    """

    position: Floats
    pixels: Floats
    aperture_radius_m: float
    finite_aperture: bool
    footprints: Floats | None
    crosstalk: float
    glass: Floats | None
    delays_s: Floats | None

    def __init__(
        self, position: ArrayLike, pixels: ArrayLike, aperture_radius_m: float = 0.02, finite_aperture: bool = False,
        footprints: ArrayLike | None = None, crosstalk: float = 0.0, glass: ArrayLike | None = None,
        delays_s: ArrayLike | None = None,
    ) -> None:  # fmt: skip
        object.__setattr__(self, "position", as_points("Sensor.position", position, (3,)))
        object.__setattr__(self, "pixels", as_points("Sensor.pixels", pixels, (None, 4, 3)))
        check_number("Sensor", "aperture_radius_m", aperture_radius_m, 1e-12, 1e9, "metres; 2 cm is 0.02")
        check_flag("Sensor.finite_aperture", finite_aperture)
        if aperture_radius_m > WIDEST_APERTURE_M:
            warn(
                f"Sensor.aperture_radius_m = {aperture_radius_m:g}: more than a metre; is it in metres?",
                InputWarning, stacklevel=2,
            )  # fmt: skip
        object.__setattr__(self, "aperture_radius_m", float(aperture_radius_m))
        object.__setattr__(self, "finite_aperture", bool(finite_aperture))
        if footprints is not None:
            footprints = as_weights("Sensor.footprints", footprints, (len(self.pixels), None, None))
            _check_parallelograms("Sensor.pixels", self.pixels)
        object.__setattr__(self, "footprints", footprints)
        check_number("Sensor", "crosstalk", crosstalk, 0.0, 1.0, "share of the light of all other pixels")
        object.__setattr__(self, "crosstalk", float(crosstalk))
        glass = None if glass is None else as_weights("Sensor.glass", glass, (len(self.pixels),))
        object.__setattr__(self, "glass", glass)
        if delays_s is not None:
            delays_s = as_shaped("Sensor.delays_s", delays_s, (len(self.pixels),))
            if not (np.abs(delays_s) <= WIDEST_BIN_S).all():
                raise InputError("Sensor.delays_s: holds delays above 1 ms or not finite; give seconds")
        object.__setattr__(self, "delays_s", delays_s)

    def take(self, pixels: Ints | slice) -> Sensor:
        """The sensor with some of its pixels, by number."""
        pixels = as_rows("Sensor.take: pixels", pixels, len(self.pixels))
        return Sensor(
            self.position, self.pixels[pixels], self.aperture_radius_m, self.finite_aperture,
            None if self.footprints is None else self.footprints[pixels], self.crosstalk,
            None if self.glass is None else self.glass[pixels],
            None if self.delays_s is None else self.delays_s[pixels],
        )  # fmt: skip

    @classmethod
    def grid(
        cls, position: ArrayLike, center: ArrayLike, right: ArrayLike, up: ArrayLike, rows: int,
        columns: int | None = None, aperture_radius_m: float = 0.02, *, cols: int | None = None,
    ) -> Sensor:  # fmt: skip
        """rows × columns pixels that tile the rectangle `center ± right ± up`; row 0 at the top, column 0 at −right.

        Raises `InputError` for fewer than one row or column, and for `right` and `up` that span no rectangle.
        `cols` is the former name of `columns`.

        >>> import datagen as dg
        >>> wall_center, right, up = (3, 0, 1), (0, -0.4, 0), (0, 0, 0.3)
        >>> sensor = dg.Sensor.grid((0, 0, 1), wall_center, right, up, rows=3, columns=4)
        >>> sensor.pixels.shape
        (12, 4, 3)
        >>> print(sensor.pixels[0].mean(axis=0))  # the middle of the pixel at the top left
        [3.  0.3 1.2]
        """
        if cols is not None:
            warn("Sensor.grid: cols is now called columns", FutureWarning, stacklevel=2)
            columns = cols
        return cls(position, _lattice("Sensor.grid", center, right, up, rows, columns), aperture_radius_m)

    @property
    def aperture_area_m2(self) -> float:
        """Area of the aperture's disc, m²."""
        return float(np.pi * self.aperture_radius_m**2)


@dataclass(frozen=True)
class TimeAxis:
    """The time bins of a transient: bin `i` covers `[start + i·width, start + (i+1)·width)` seconds.

    Attributes
    ----------
    bins : how many, ≥ 1.
    width_s, start_s : width of a bin and start of the first, seconds.
    origin : `source` counts from laser emission to detection (both device legs); `wall` counts from the laser point
        to the FoV point only.

    Raises
    ------
    InputError : no bins, a width that is not positive, a start that is not finite.

    Examples
    --------
    >>> import datagen as dg
    >>> time = dg.TimeAxis(bins=4, width_s=1e-10, origin="wall")
    >>> print(time.centers_s * 1e12)
    [ 50. 150. 250. 350.]
    """

    bins: int
    width_s: float
    start_s: float = 0.0
    origin: Origin = "source"

    def __post_init__(self) -> None:
        check_integer("TimeAxis", "bins", self.bins, 1, MOST_BINS)
        check_number("TimeAxis", "width_s", self.width_s, 1e-18, 1e9, "seconds; 100 ps is 100e-12")
        check_number("TimeAxis", "start_s", self.start_s, -1e9, 1e9, "seconds; 20 ns is 20e-9")
        check_choice("TimeAxis.origin", self.origin, get_args(Origin))
        if self.width_s > WIDEST_BIN_S:
            warn(
                f"TimeAxis.width_s = {self.width_s:g}: in a bin light goes {299_792.458 * self.width_s:.3g} km; "
                "is it in seconds?",
                InputWarning, stacklevel=3,
            )  # fmt: skip

    def beyond_period(self, repetition_rate_hz: float) -> str:
        """How the axis and a laser's repetition rate disagree, with a remedy; "" where the axis fits into the period.

        Times are measured since the last pulse, so that a histogram ends with the period. The axis may begin at any
        time after the pulse.
        """
        check_number("TimeAxis.beyond_period", "repetition_rate_hz", repetition_rate_hz, 1e-9, 1e18, "10 MHz is 10e6")
        period_s, length_s = 1.0 / repetition_rate_hz, self.bins * self.width_s
        if length_s <= period_s * (1 + PERIOD_ACCURACY):
            return ""
        fitting = math.floor(period_s / self.width_s * (1 + PERIOD_ACCURACY))
        fewer = f"{fitting} bins, " if fitting else ""
        return (
            f"a laser period is {1e9 * period_s:.6g} ns, and {self.bins} bins of {1e12 * self.width_s:.6g} ps are "
            f"{1e9 * length_s:.6g} ns, but no histogram is longer than the period; take at most {fewer}"
            f"{1e12 * period_s / self.bins:.10g} ps a bin, or {1e-6 / length_s:.10g} MHz"
        )

    def merged(self, bins: int) -> TimeAxis:
        """The axis on which each run of so many bins is one bin."""
        check_integer("TimeAxis.merged", "bins", bins, 1, self.bins)
        return replace(self, bins=self.bins // bins, width_s=self.width_s * bins)

    @property
    def edges_s(self) -> Floats:
        """(bins + 1,) bin edges, seconds."""
        return self.start_s + self.width_s * np.arange(self.bins + 1, dtype=np.float64)

    @property
    def centers_s(self) -> Floats:
        """(bins,) bin centres, seconds."""
        return self.start_s + self.width_s * (np.arange(self.bins, dtype=np.float64) + 0.5)

    @property
    def stop_s(self) -> float:
        """End of the last bin, seconds."""
        return self.start_s + self.width_s * self.bins


@dataclass(frozen=True)
class Capture:
    """How a scene is measured: L laser points, P pixels, T time bins, and which of them go together.

    Attributes
    ----------
    laser, sensor, time : where light enters the scene, where it is detected, and the bins of its arrival time.
    pairing : `exhaustive`: every pixel for every laser point; `confocal`: pixel i for laser point i.
    illumination : `scan`: one laser point after the other; `flood`: all at once, each with an equal share of the
        light, as one wide beam: one histogram a pixel.

    Raises
    ------
    InputError : a confocal capture whose laser points and pixels differ in number, or that is a flood.

    Examples
    --------
    >>> import datagen as dg
    >>> laser = dg.Laser((0, 0, 1), [(3, -0.5, 1), (3, 0.5, 1)])
    >>> sensor = dg.Sensor.grid((0, 0, 1), (3, 0, 1), (0, -0.4, 0), (0, 0, 0.3), rows=3, columns=4)
    >>> dg.Capture(laser, sensor, dg.TimeAxis(bins=512, width_s=1e-10)).shape  # laser, pixel, bin
    (2, 12, 512)
    """

    laser: Laser
    sensor: Sensor
    time: TimeAxis
    pairing: Pairing = "exhaustive"
    illumination: Illumination = "scan"

    def __post_init__(self) -> None:
        check_kind("Capture.laser", self.laser, Laser)
        check_kind("Capture.sensor", self.sensor, Sensor)
        check_kind("Capture.time", self.time, TimeAxis)
        check_choice("Capture.pairing", self.pairing, get_args(Pairing))
        check_choice("Capture.illumination", self.illumination, get_args(Illumination))
        if self.illumination == "flood" and self.pairing == "confocal":
            raise InputError(
                "Capture.illumination = 'flood' with pairing = 'confocal': a flood lights all points at once; "
                "take pairing 'exhaustive'"
            )
        whole = self.sensor.crosstalk > 0 or self.sensor.glass is not None or self.sensor.delays_s is not None
        if self.illumination == "scan" and whole:
            raise InputError(
                "Capture.illumination = 'scan' with Sensor.crosstalk, glass or delays_s: they are known for floods "
                "only; leave them out, or take illumination 'flood'"
            )
        lasers, pixels = len(self.laser.targets), len(self.sensor.pixels)
        if self.pairing == "confocal" and lasers != pixels:
            raise InputError(
                f"Capture.pairing = 'confocal' with {lasers} laser targets and {pixels} pixels: "
                "a confocal scan needs exactly one pixel for each laser target"
            )
        if math.prod(self.shape) > MOST_VALUES:
            raise InputError(
                f"Capture.shape = {self.shape}: more than 2^36 values; take fewer points, pixels or bins"
            )

    @property
    def shape(self) -> tuple[int, int, int]:
        """(laser, pixel, bin): the shape of a transient; confocal has pixel = 1, a flood laser = 1."""
        pixels = 1 if self.pairing == "confocal" else len(self.sensor.pixels)
        return 1 if self.illumination == "flood" else len(self.laser.targets), pixels, self.time.bins

    def excerpt(self, lasers: Ints, pixels: Ints | slice = slice(None)) -> Capture:
        """The capture of some laser points and pixels, by number; confocal pixels go with their laser points."""
        seen = lasers if self.pairing == "confocal" else pixels
        return replace(self, laser=self.laser.take(lasers), sensor=self.sensor.take(seen))
