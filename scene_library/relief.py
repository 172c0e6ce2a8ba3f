"""Uneven walls: a height field behind the nominal plane of a wall, closed with its neighbours edge to edge.

Nothing stands out of the nominal plane: the highest places lie in it and the deepest `relief_m` behind it, so
whatever was clear of the flat wall is clear of the uneven one. Towards the wall's edges the relief fades to nothing,
and a flat rim with the wall's own four corners joins it to the neighbouring walls, floor and ceiling.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from scene_library.arrays import Floats
from scene_library.solids import Surface

Lines = NDArray[np.float64]
Shape = Callable[[Floats, Floats], Floats]
"""(across, up) in metres from the lower right corner as the room sees it → depth as a share of the relief, 0 … 1."""

RIM_SHARE = 0.02
"""Width of the flat rim, as a share of the wall's shorter side."""
_WAVES = 96
_CELLS_PER_PERIOD = 8
_CELLS_PER_BUMP = 4
_COARSEST_PER_BUMP = 2
_CURVE_CELLS = 32
_FADE_LINES = 5


class ReliefTooFine(ValueError):
    """The relief cannot be resolved within the triangle budget; the message names numbers and remedy."""


@dataclass(frozen=True)
class Relief:
    """An uneven wall's shape, and the grid lines that resolve it.

    Attributes
    ----------
    shape : depth as a share of the relief.
    across, up : (n,), (m,) places of the grid lines inside the rim, metres.
    """

    shape: Shape
    across: Lines
    up: Lines


def curved(width_m: float, height_m: float) -> Relief:
    """A shallow parabolic niche: deepest in the middle of the wall's width."""

    def shape(u: Floats, _: Floats) -> Floats:
        return 1 - (2 * u / width_m - 1) ** 2

    return Relief(shape, _even(width_m, width_m / _CURVE_CELLS), np.empty(0))


def corrugated(
    width_m: float, height_m: float, period_m: float, phase_rad: float, upright: bool, max_triangles: int
) -> Relief:
    """A sine of `period_m`, its ridges upright or level."""

    def shape(u: Floats, v: Floats) -> Floats:
        return 0.5 - 0.5 * np.cos(2 * np.pi * (u if upright else v) / period_m + phase_rad)

    lines = _even(width_m if upright else height_m, period_m / _CELLS_PER_PERIOD)
    _check_budget(_triangles(len(lines), 0), max_triangles, f"ridges {period_m:.3g} m apart")
    return Relief(shape, lines, np.empty(0)) if upright else Relief(shape, np.empty(0), lines)


def bumpy(
    width_m: float, height_m: float, correlation_m: float, max_triangles: int, rng: np.random.Generator
) -> Relief:
    """A smooth random surface: a Gaussian field of correlation exp(−r²/2ℓ²), ℓ = `correlation_m`, mapped by its own
    distribution function, so that every depth from 0 to the relief is equally frequent."""
    from scipy.special import ndtr

    wave = rng.normal(size=(_WAVES, 2)) / correlation_m
    phase = rng.uniform(0, 2 * np.pi, _WAVES)

    def shape(u: Floats, v: Floats) -> Floats:
        total = np.zeros(np.broadcast(u, v).shape)
        for (ku, kv), p in zip(wave, phase, strict=True):
            total += np.cos(ku * u + kv * v + p)
        return np.asarray(ndtr(total * np.sqrt(2 / _WAVES)))

    for cells in np.linspace(_CELLS_PER_BUMP, _COARSEST_PER_BUMP, 9):
        across, up = _even(width_m, correlation_m / cells), _even(height_m, correlation_m / cells)
        if _triangles(len(across), len(up)) <= max_triangles:
            break
    _check_budget(_triangles(len(across), len(up)), max_triangles, f"bumps of {correlation_m:.3g} m")
    return Relief(shape, across, up)


def stepped(width_m: float, height_m: float, side_m: float, max_triangles: int, rng: np.random.Generator) -> Relief:
    """Square panels of about `side_m`, each at a depth of its own, equally likely from 0 to the relief."""
    columns, rows = (max(1, round(length / side_m)) for length in (width_m, height_m))
    across, up = _pairs(width_m, columns), _pairs(height_m, rows)
    _check_budget(_triangles(len(across), len(up)), max_triangles, f"panels of {side_m:.3g} m")
    depth = rng.uniform(size=(columns, rows))

    def shape(u: Floats, v: Floats) -> Floats:
        i = np.clip((u / width_m * columns).astype(int), 0, columns - 1)
        j = np.clip((v / height_m * rows).astype(int), 0, rows - 1)
        return np.asarray(depth[i, j])

    return Relief(shape, across, up)


def uneven_wall(start: Lines, end: Lines, height_m: float, relief: Relief, relief_m: float) -> Surface:
    """The wall over the plan segment `start` → `end` (2,), room to the left, with `relief` up to `relief_m` deep."""
    width_m = float(np.linalg.norm(end - start))
    rim = RIM_SHARE * min(width_m, height_m)
    fade = min(max(2 * relief_m, rim), 0.25 * min(width_m, height_m))
    across = _lines_with_rims(relief.across, width_m, rim, fade)
    up = _lines_with_rims(relief.up, height_m, rim, fade)
    u, v = np.meshgrid(across, up, indexing="ij")
    depth = relief_m * relief.shape(u, v) * _fade(u, width_m, rim, fade) * _fade(v, height_m, rim, fade)
    corners = np.array([[0.0, 0.0], [width_m, 0.0], [width_m, height_m], [0.0, height_m]])
    flat = np.concatenate([corners, np.stack([u, v], axis=-1).reshape(-1, 2)])
    behind = np.concatenate([np.zeros(4), depth.ravel()])
    along = (end - start) / width_m
    out = np.array([along[1], -along[0]])
    plan = start + flat[:, :1] * along + behind[:, None] * out
    # The corners stay the neighbours' own to the last bit.
    plan[[1, 2]] = end
    return np.column_stack([plan, flat[:, 1]]), _faces(len(across), len(up))


def _faces(n: int, m: int) -> NDArray[np.int64]:
    """Triangles of the grid (n × m vertices from number 4 on) and of the rim about it (corners 0 … 3)."""
    number = 4 + np.arange(n * m).reshape(n, m)
    a, b, c, d = number[:-1, :-1], number[1:, :-1], number[1:, 1:], number[:-1, 1:]
    inner = np.concatenate([np.stack([a, b, c], -1).reshape(-1, 3), np.stack([a, c, d], -1).reshape(-1, 3)])
    rim: list[NDArray[np.int64]] = []
    sides = (number[:, 0], number[-1, :], number[::-1, -1], number[0, ::-1])
    for corner, side in enumerate(sides):
        rim.append(np.array([[corner, (corner + 1) % 4, side[-1]]]))
        rim.append(np.stack([np.full(len(side) - 1, corner), side[1:], side[:-1]], axis=-1))
    return np.concatenate([inner, *rim]).astype(np.int64)


def _lines_with_rims(lines: Lines, length_m: float, rim_m: float, fade_m: float) -> Lines:
    """Grid lines from rim to rim, with those of the shape and some across each fade."""
    steps = rim_m + fade_m * np.linspace(0, 1, _FADE_LINES)
    steps = np.concatenate([steps, length_m - steps])
    inside = lines[(lines > rim_m) & (lines < length_m - rim_m)]
    # Lines nearer to each other than a hundredth of the rim would only make needles.
    apart = np.abs(inside[:, None] - steps).min(axis=1) > 0.01 * rim_m
    return np.sort(np.concatenate([inside[apart], steps]))


def _fade(position: Floats, length_m: float, rim_m: float, fade_m: float) -> Floats:
    """0 at the rim, 1 beyond the fade, smooth between."""
    inward = np.minimum(position, length_m - position)
    t = np.clip((inward - rim_m) / fade_m, 0.0, 1.0)
    # Rounding must not leave the outermost line a hair behind the plane.
    return np.where(t < 1e-9, 0.0, t * t * (3 - 2 * t))


def _even(length_m: float, step_m: float) -> Lines:
    return np.linspace(0, length_m, max(2, int(np.ceil(length_m / step_m)) + 1))


def _pairs(length_m: float, panels: int) -> Lines:
    """Two lines close together at every joint, between which the wall steps."""
    side = length_m / panels
    joints = side * np.arange(1, panels)
    return np.sort(np.concatenate([joints - 0.01 * side, joints + 0.01 * side]))


def _triangles(across: int, up: int) -> int:
    """At most so many triangles has a wall with these numbers of its shape's grid lines, rim and fades included."""
    n, m = across + 2 * _FADE_LINES, up + 2 * _FADE_LINES
    return 2 * (n - 1) * (m - 1) + 2 * (n + m)


def _check_budget(needed: int, budget: int, what: str) -> None:
    if needed > budget:
        raise ReliefTooFine(
            f"relay_wall.max_triangles = {budget}: {what} need {needed} triangles on this wall; raise max_triangles "
            "or length_m"
        )
