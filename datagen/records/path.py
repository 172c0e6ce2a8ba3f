"""How a rigid part moves: straight between places that it reaches at given times, and turned about the vertical."""

from __future__ import annotations

import contextlib
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from datagen.errors import InputError, shown
from datagen.records.arrays import Floats, Ints
from datagen.records.checks import as_points, as_reals, as_shaped, check_kind

LONGEST_S = 1e6
"""Largest time of a path, seconds, and farthest from 0: twelve days, at which a double still resolves 0.1 ns."""
MOST_DEG = 1e6
"""Largest heading: some thousand turns."""


@dataclass(frozen=True, eq=False)
class Moves:
    """Rigid moves, one for each of some times: a turn about the z axis of the scene, then a shift.

    A move takes a point x to R x + s. Shapes follow numpy's rules: moves of shape (F, L) take points (L, 3) or
    (F, L, 3) to (F, L, 3), and `moves[:, None]` of shape (F, 1) take points (V, 3) to (F, V, 3).

    Attributes
    ----------
    turns_rad : (…,) angles, counter-clockwise as seen from above.
    shifts_m : (…, 3) metres.
    """

    turns_rad: Floats
    shifts_m: Floats

    def __post_init__(self) -> None:
        turns = as_reals("Moves.turns_rad", self.turns_rad)
        shifts = as_reals("Moves.shifts_m", self.shifts_m)
        if shifts.shape != (*turns.shape, 3):
            raise InputError(
                f"Moves.shifts_m: shape {shifts.shape} given, {(*turns.shape, 3)} needed; one shift for each turn"
            )
        object.__setattr__(self, "turns_rad", turns)
        object.__setattr__(self, "shifts_m", shifts)

    def __getitem__(self, which: Any) -> Moves:
        """Some of the moves, as numpy's indices choose them of `turns_rad`."""
        every = which if isinstance(which, tuple) else (which,)
        rest = slice(None) if any(index is Ellipsis for index in every) else Ellipsis
        return Moves(self.turns_rad[which], self.shifts_m[(*every, rest)])

    def apply(self, points: ArrayLike) -> Floats:
        """(…, 3) points after the moves."""
        return self._rotate("points", points, 1.0) + self.shifts_m

    def undo(self, points: ArrayLike) -> Floats:
        """(…, 3) points before the moves that `points` are the outcome of."""
        return self._rotate("points", self._vectors("points", points) - self.shifts_m, -1.0)

    def turn(self, vectors: ArrayLike) -> Floats:
        """(…, 3) directions after the moves."""
        return self._rotate("vectors", vectors, 1.0)

    def turn_back(self, vectors: ArrayLike) -> Floats:
        """(…, 3) directions before the moves."""
        return self._rotate("vectors", vectors, -1.0)

    def since(self, start: Moves) -> Moves:
        """The moves that take what `start` has moved to where these take it: exactly none where both are equal."""
        check_kind("Moves.since: start", start, Moves)
        self._vectors("start", start.shifts_m)
        turns = Moves(self.turns_rad - start.turns_rad, np.zeros_like(self.shifts_m - start.shifts_m))
        return Moves(turns.turns_rad, self.shifts_m - turns.turn(start.shifts_m))

    def _vectors(self, name: str, value: ArrayLike) -> Floats:
        """(…, 3) numbers that go with the moves; raises `InputError` for others."""
        array = as_reals(name, value)
        with contextlib.suppress(ValueError):
            if array.ndim and array.shape[-1] == 3:
                np.broadcast_shapes(array.shape, self.shifts_m.shape)
                return array
        raise InputError(
            f"{name}: shape {array.shape} given; (…, 3) is needed, with axes that go with {self.shifts_m.shape}, "
            "those of the moves"
        )

    def _rotate(self, name: str, vectors: ArrayLike, way: float) -> Floats:
        """(…, 3) vectors after the turns, or, with `way` −1, before."""
        of = self._vectors(name, vectors)
        cosine, sine = np.cos(self.turns_rad), way * np.sin(self.turns_rad)
        x, y, z = of[..., 0], of[..., 1], of[..., 2]
        first, second = cosine * x - sine * y, sine * x + cosine * y
        return np.stack([first, second, np.broadcast_to(z, first.shape)], axis=-1)


@dataclass(frozen=True, init=False, eq=False)
class Path:
    """The way of a rigid part: places and headings at some times, linear between them. Before the first time and
    after the last the part stands.

    At time t a point x of the part's mesh is at `place + R(heading) x`: the mesh's own origin (0, 0, 0) is taken to
    the place, and with heading 0 the mesh stands as it was made. So give a mesh that stands about its origin, and the
    path says where it stands. Headings count counter-clockwise as seen from above, and are not wrapped: from 350 to
    370 a part turns by 20 degrees, from 350 to 10 by −340. Two equal times are a jump; at that time the part has
    already jumped.

    Attributes
    ----------
    times_s : (K,) seconds since the first frame began; none less than the one before.
    places : (K, 3) metres, in the scene.
    headings_deg : (K,) degrees about the vertical; a single number holds for all times, and 0 if left out.

    Raises
    ------
    InputError : other shapes, numbers that are not finite, times that run backward, or three times that are equal.

    Examples
    --------
    >>> import datagen as dg
    >>> path = dg.Path(times_s=(0, 2, 3), places=[(1, 0, 0), (3, 0, 0), (3, 0, 0)], headings_deg=(0, 0, 90))
    >>> path.at([0.5, 2.5]).shifts_m.tolist(), path.velocity(0.5).tolist()
    ([[1.5, 0.0, 0.0], [3.0, 0.0, 0.0]], [1.0, 0.0, 0.0])
    """

    times_s: Floats
    places: Floats
    headings_deg: Floats

    def __init__(self, times_s: ArrayLike, places: ArrayLike, headings_deg: ArrayLike = 0.0) -> None:
        times = as_shaped("Path.times_s", times_s, (None,))
        if not (np.abs(times) <= LONGEST_S).all():
            raise InputError(f"Path.times_s: holds times that are not finite or beyond {LONGEST_S:g} s; give seconds")
        if (back := np.flatnonzero(np.diff(times) < 0)).size:
            k = int(back[0]) + 1
            raise InputError(
                f"Path.times_s[{k}] = {times[k]:g} after {times[k - 1]:g}: times must not run backward; sort them"
            )
        if (thrice := np.flatnonzero(times[2:] == times[:-2])).size:
            k = int(thrice[0])
            raise InputError(
                f"Path.times_s[{k} … {k + 2}] = {times[k]:g}: two equal times are a jump, a third says nothing; "
                "leave one out"
            )
        headings = as_reals("Path.headings_deg", headings_deg)
        headings = as_shaped(
            "Path.headings_deg", np.full(times.shape, headings) if headings.ndim == 0 else headings, times.shape
        )
        if not (np.abs(headings) <= MOST_DEG).all():
            raise InputError(f"Path.headings_deg: holds numbers that are not finite or beyond {MOST_DEG:g} degrees")
        object.__setattr__(self, "times_s", times)
        object.__setattr__(self, "places", as_points("Path.places", places, (len(times), 3)))
        object.__setattr__(self, "headings_deg", headings)

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, Path):
            return NotImplemented
        return all(np.array_equal(a, b) for a, b in zip(self._arrays, other._arrays, strict=True))

    def __hash__(self) -> int:
        # Of equal arrays that differ in the sign of a zero, too.
        return hash(tuple((array + 0.0).tobytes() for array in self._arrays))

    @property
    def _arrays(self) -> tuple[Floats, Floats, Floats]:
        return self.times_s, self.places, self.headings_deg

    @property
    def stands(self) -> bool:
        """Whether the part is in one place, with one heading, at all times."""
        return bool((self.places == self.places[0]).all() and (self.headings_deg == self.headings_deg[0]).all())

    def at(self, times_s: ArrayLike) -> Moves:
        """The moves, of the shape of `times_s`, that take the part's mesh to where it is at these times."""
        leg, share = self._legs(_as_times(times_s))
        headings = _interpolate(self.headings_deg, leg, share)
        return Moves(np.radians(headings), _interpolate(self.places, leg, share[..., None]))

    def velocity(self, times_s: ArrayLike, at: ArrayLike | None = None) -> Floats:
        """(…, 3) m/s at these times: of the place, or of the points of the part that are `at` (…, 3) in the scene.

        At a time of the path it is that of the leg which begins there; a jump has none.
        """
        times = _as_times(times_s)
        velocity = self._slope(self.places, times)
        if at is None:
            return velocity
        moves = self.at(times)
        arm = moves._vectors("at", at) - moves.shifts_m
        across = np.stack([-arm[..., 1], arm[..., 0], np.zeros_like(arm[..., 0])], axis=-1)
        return np.asarray(velocity + self.turning(times)[..., None] * across)

    def turning(self, times_s: ArrayLike) -> Floats:
        """(…,) rad/s about the vertical at these times, counter-clockwise as seen from above."""
        return np.radians(self._slope(self.headings_deg, _as_times(times_s)))

    def _legs(self, times: Floats) -> tuple[Ints, Floats]:
        """For each time the number of its leg, which begins at the time of that number, and the share of it that has
        passed, 0 … 1."""
        leg = np.searchsorted(self.times_s, times, side="right") - 1
        leg = np.clip(leg, 0, max(len(self.times_s) - 2, 0))
        start, end = self.times_s[leg], self.times_s[np.minimum(leg + 1, len(self.times_s) - 1)]
        lasts = end > start
        share = (times - start) / np.where(lasts, end - start, 1.0)
        return leg, np.where(lasts, np.clip(share, 0.0, 1.0), times >= end)

    def _slope(self, values: Floats, times: Floats) -> Floats:
        """(…,) or (…, 3) changes per second of what stands at the times of the path, during the leg of each time."""
        if len(self.times_s) == 1:
            return np.zeros(times.shape + values.shape[1:])
        lasting = np.diff(self.times_s)
        slope = np.diff(values, axis=0)
        slope[lasting == 0] = 0.0
        slope = (slope.T / np.where(lasting == 0, 1.0, lasting)).T[self._legs(times)[0]]
        stands = (times < self.times_s[0]) | (times >= self.times_s[-1])
        return np.where(stands.reshape(times.shape + (1,) * (values.ndim - 1)), 0.0, slope)


def _interpolate(values: Floats, leg: Ints, share: Floats) -> Floats:
    """Linear between the values at both ends of each leg: exactly these at its ends, and all along if they agree."""
    first, last = values[leg], values[np.minimum(leg + 1, len(values) - 1)]
    return np.asarray(np.where(share == 1.0, last, first + share * (last - first)))


def _as_times(times_s: ArrayLike) -> Floats:
    times = as_reals("times_s", times_s)
    if not np.isfinite(times).all():
        raise InputError(f"times_s = {shown(times_s)}: holds times that are not finite; give seconds")
    return times
