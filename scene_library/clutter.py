"""Things that stand or hang before a relay wall. Each fills x = ± width/2, y = 0 … reach out of the wall, z up."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from scene_library.solids import Surface, block, cylinder, joined, moved, rectangle


def pillar(width_m: float, reach_m: float, height_m: float, _: np.random.Generator) -> Surface:
    """From floor to ceiling, square-edged."""
    return block(width_m, reach_m, height_m, y=reach_m / 2)


def pipe(width_m: float, reach_m: float, height_m: float, _: np.random.Generator) -> Surface:
    """From floor to ceiling, round, its far side `reach_m` out."""
    diameter = min(width_m, reach_m)
    return cylinder(diameter, height_m, y=reach_m - diameter / 2)


def frame(width_m: float, reach_m: float, height_m: float, rng: np.random.Generator) -> Surface:
    """A hanging frame, open in the middle and as deep as it reaches."""
    high = min(width_m * rng.uniform(0.8, 1.4), 0.5 * height_m)
    bar = rng.uniform(0.1, 0.2) * min(width_m, high)
    middle = rng.uniform(0.2 * height_m + high / 2, 0.9 * height_m - high / 2)
    ring = np.concatenate([rectangle(width_m, high), rectangle(width_m - 2 * bar, high - 2 * bar)])
    # Loops of four corners: outer and inner at the wall, outer and inner in front; neighbouring ones make the faces.
    vertices = np.concatenate([np.insert(ring, 1, 0.0, axis=1), np.insert(ring, 1, reach_m, axis=1)])
    loops = np.arange(16).reshape(4, 4)
    bands = [(loops[0], loops[1]), (loops[1], loops[3]), (loops[3], loops[2]), (loops[2], loops[0])]
    quads = np.concatenate([np.stack([a, np.roll(a, -1), np.roll(b, -1), b], axis=1) for a, b in bands])
    return moved((vertices, np.concatenate([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]])), z=middle)


def shelf(width_m: float, reach_m: float, height_m: float, rng: np.random.Generator) -> Surface:
    """Two to four boards over each other, hung on the wall."""
    boards = int(rng.integers(2, 5))
    thick = 0.02 * min(1.0, height_m)
    step = rng.uniform(0.08, 0.14) * height_m
    bottom = rng.uniform(0.1, 0.85 - 0.14 * boards + 0.14) * height_m
    return joined([block(width_m, reach_m, thick, y=reach_m / 2, z=bottom + k * step) for k in range(boards)])


CLUTTER: dict[str, Callable[[float, float, float, np.random.Generator], Surface]] = {
    "pillar": pillar,
    "pipe": pipe,
    "frame": frame,
    "shelf": shelf,
}
