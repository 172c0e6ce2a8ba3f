"""Plain shapes and cut plates: what reconstruction benches hang up before a relay wall."""

from __future__ import annotations

import numpy as np

from scene_library.plates import union_plate
from scene_library.polygons import rotation
from scene_library.solids import Solid, ellipsoid, extruded, lathed, rectangle, regular_polygon, rotated, torus


def sphere(rng: np.random.Generator) -> Solid:
    """A ball."""
    r = rng.uniform(0.15, 0.4)
    return Solid.compound([ellipsoid((r, r, r), sides=32)])


def egg(rng: np.random.Generator) -> Solid:
    """An ellipsoid."""
    return Solid.compound([ellipsoid(rng.uniform(0.15, 0.45, 3), sides=28)])


def cube(rng: np.random.Generator) -> Solid:
    """A cube."""
    size = rng.uniform(0.2, 0.7)
    return Solid.compound([extruded(rectangle(size, size), size)])


def pyramid(rng: np.random.Generator) -> Solid:
    """A pyramid of three to six sides."""
    sides, size = int(rng.integers(3, 7)), rng.uniform(0.3, 0.8)
    return Solid.compound([lathed([(0, 0), (size / 2, 0), (0.001, size), (0, size)], sides)])


def cone(rng: np.random.Generator) -> Solid:
    """A round cone."""
    size, height = rng.uniform(0.3, 0.7), rng.uniform(0.4, 1.2)
    return Solid.compound([lathed([(0, 0), (size / 2, 0), (0.001, height), (0, height)], 28)])


def column(rng: np.random.Generator) -> Solid:
    """A round column."""
    size, height = rng.uniform(0.15, 0.5), rng.uniform(0.5, 1.5)
    return Solid.compound([extruded(regular_polygon(size, 28), height)])


def ring(rng: np.random.Generator) -> Solid:
    """A ring standing upright."""
    r = rng.uniform(0.2, 0.5)
    return Solid.compound([rotated(torus(r, rng.uniform(0.12, 0.3) * r), "x", 90)])


def disc(rng: np.random.Generator) -> Solid:
    """A round plate standing upright."""
    return Solid.compound([union_plate([regular_polygon(rng.uniform(0.4, 1.0), 36)], 0.02)])


def panel(rng: np.random.Generator) -> Solid:
    """A rectangular plate standing upright."""
    return Solid.compound([union_plate([rectangle(rng.uniform(0.4, 1.2), rng.uniform(0.5, 1.5))], 0.02)])


def star(rng: np.random.Generator) -> Solid:
    """A star of four to seven points."""
    points, size = int(rng.integers(4, 8)), rng.uniform(0.4, 1.0)
    outline = regular_polygon(size, 2 * points)
    outline[1::2] *= rng.uniform(0.35, 0.6)
    outline = outline @ rotation(np.pi / 2).T
    return Solid.compound([union_plate([outline], 0.03)])


def arrow(rng: np.random.Generator) -> Solid:
    """An arrow along x."""
    length, head, shaft = rng.uniform(0.5, 1.0), rng.uniform(0.3, 0.45), rng.uniform(0.08, 0.18)
    tip = 0.6 * head
    outline = np.array([(0, -shaft / 2), (length - tip, -shaft / 2), (length - tip, -head / 2), (length, 0)])
    outline = np.concatenate([outline, [(x, -y) for x, y in outline[-2::-1]]])
    return Solid.compound([union_plate([outline], 0.03)])


def cross(rng: np.random.Generator) -> Solid:
    """A cross of two bars."""
    size, bar = rng.uniform(0.5, 1.0), rng.uniform(0.12, 0.25)
    return Solid.compound([union_plate([rectangle(size, bar), rectangle(bar, size)], 0.03)])


def frame(rng: np.random.Generator) -> Solid:
    """A picture frame: a plate with a hole."""
    width, height, bar = rng.uniform(0.4, 1.0), rng.uniform(0.4, 1.0), rng.uniform(0.05, 0.12)
    hole = rectangle(width - 2 * bar, height - 2 * bar)[::-1]
    return Solid.compound([union_plate([rectangle(width, height), hole], 0.03)])


def resolution_bars(rng: np.random.Generator) -> Solid:
    """Upright bars of falling width on two rails, as in a resolution target."""
    height, widest, bars = rng.uniform(0.6, 1.2), rng.uniform(0.1, 0.2), int(rng.integers(3, 7))
    outlines, x = [], 0.0
    for k in range(bars):
        wide = widest * 0.8**k
        outlines.append(rectangle(wide, height) + np.array([x + wide / 2, 0.0]))
        x += 2 * wide
    rail = 0.06
    outlines += [rectangle(x, rail) + np.array([x / 2, s * (height - rail) / 2]) for s in (-1, 1)]
    return Solid.compound([union_plate(outlines, 0.02)])
