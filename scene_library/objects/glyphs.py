"""Capital letters and digits as upright plates, from strokes of our own (no font file needed).

A glyph is a list of strokes in a unit square: open polylines, or closed rings.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from scene_library.arrays import Floats
from scene_library.plates import union_plate
from scene_library.polygons import Polygon, following, signed_area
from scene_library.solids import Solid

_Stroke = list[tuple[float, float]]


def _arc(cx: float, cy: float, rx: float, ry: float, start_deg: float, end_deg: float) -> _Stroke:
    steps = max(2, round(abs(end_deg - start_deg) / 22.5))
    angles = np.radians(np.linspace(start_deg, end_deg, steps + 1))
    return [(float(cx + rx * np.cos(a)), float(cy + ry * np.sin(a))) for a in angles]


def _ring(cx: float, cy: float, rx: float, ry: float) -> _Stroke:
    return [*_arc(cx, cy, rx, ry, 0, 360)[:-1], (cx + rx, cy)]


_STROKES: dict[str, list[_Stroke]] = {
    "a": [[(0, 0), (0.5, 1), (1, 0)], [(0.2, 0.4), (0.8, 0.4)]],
    "b": [
        [(0, 0), (0, 1)],
        [(0, 1), *_arc(0.6, 0.75, 0.35, 0.25, 90, -90), (0, 0.5)],
        [*_arc(0.6, 0.25, 0.4, 0.25, 90, -90), (0, 0)],
    ],
    "c": [_arc(0.5, 0.5, 0.5, 0.5, 45, 315)],
    "d": [[(0, 0), (0, 1)], [(0, 1), *_arc(0.4, 0.5, 0.6, 0.5, 90, -90), (0, 0)]],
    "e": [[(1, 0), (0, 0), (0, 1), (1, 1)], [(0, 0.5), (0.8, 0.5)]],
    "f": [[(0, 0), (0, 1), (1, 1)], [(0, 0.5), (0.8, 0.5)]],
    "g": [[*_arc(0.5, 0.5, 0.5, 0.5, 45, 360), (0.55, 0.5)]],
    "h": [[(0, 0), (0, 1)], [(1, 0), (1, 1)], [(0, 0.5), (1, 0.5)]],
    "i": [[(0.5, 0), (0.5, 1)], [(0.2, 0), (0.8, 0)], [(0.2, 1), (0.8, 1)]],
    "j": [[(0.8, 1), *_arc(0.4, 0.3, 0.4, 0.3, 0, -180)], [(0.4, 1), (1, 1)]],
    "k": [[(0, 0), (0, 1)], [(1, 1), (0, 0.45)], [(0.25, 0.6), (1, 0)]],
    "l": [[(0, 1), (0, 0), (1, 0)]],
    "m": [[(0, 0), (0, 1), (0.5, 0.4), (1, 1), (1, 0)]],
    "n": [[(0, 0), (0, 1), (1, 0), (1, 1)]],
    "o": [_ring(0.5, 0.5, 0.5, 0.5)],
    "p": [[(0, 0), (0, 1)], [(0, 1), *_arc(0.6, 0.73, 0.4, 0.27, 90, -90), (0, 0.46)]],
    "q": [_ring(0.5, 0.5, 0.5, 0.5), [(0.6, 0.35), (1, 0)]],
    "r": [[(0, 0), (0, 1)], [(0, 1), *_arc(0.6, 0.73, 0.4, 0.27, 90, -90), (0, 0.46)], [(0.45, 0.46), (1, 0)]],
    "s": [[*_arc(0.5, 0.75, 0.5, 0.25, 20, 270), *_arc(0.5, 0.25, 0.5, 0.25, 90, -160)[1:]]],
    "t": [[(0.5, 0), (0.5, 1)], [(0, 1), (1, 1)]],
    "u": [[(0, 1), *_arc(0.5, 0.4, 0.5, 0.4, 180, 360), (1, 1)]],
    "v": [[(0, 1), (0.5, 0), (1, 1)]],
    "w": [[(0, 1), (0.22, 0), (0.5, 0.7), (0.78, 0), (1, 1)]],
    "x": [[(0, 0), (1, 1)], [(0, 1), (1, 0)]],
    "y": [[(0, 1), (0.5, 0.5), (1, 1)], [(0.5, 0.5), (0.5, 0)]],
    "z": [[(0, 1), (1, 1), (0, 0), (1, 0)]],
    "0": [_ring(0.5, 0.5, 0.45, 0.5), [(0.3, 0.3), (0.7, 0.7)]],
    "1": [[(0.15, 0.75), (0.5, 1), (0.5, 0)], [(0.15, 0), (0.85, 0)]],
    "2": [[*_arc(0.5, 0.7, 0.5, 0.3, 165, -30), (0, 0), (1, 0)]],
    "3": [[*_arc(0.45, 0.75, 0.5, 0.25, 150, -90), *_arc(0.45, 0.25, 0.55, 0.25, 90, -150)[1:]]],
    "4": [[(0.75, 0), (0.75, 1), (0, 0.35), (1, 0.35)]],
    "5": [[(0.95, 1), (0.1, 1), (0.05, 0.55), *_arc(0.45, 0.32, 0.55, 0.32, 100, -150)]],
    "6": [_ring(0.5, 0.3, 0.5, 0.3), [(0.8, 1), *_arc(0.7, 0.3, 0.7, 0.6, 120, 180)]],
    "7": [[(0, 1), (1, 1), (0.35, 0)]],
    "8": [_ring(0.5, 0.76, 0.4, 0.24), _ring(0.5, 0.26, 0.5, 0.26)],
    "9": [_ring(0.5, 0.7, 0.5, 0.3), [(0.2, 0), *_arc(0.3, 0.7, 0.7, 0.6, -60, 0)]],
}

GLYPHS = tuple(_STROKES)


def glyph(character: str, width_m: float, height_m: float, stroke_m: float, thickness_m: float) -> Solid:
    """One capital letter or digit, `height_m` high; strokes are `stroke_m` wide, the plate `thickness_m` thick."""
    inset = np.array([stroke_m, stroke_m]) / 2
    size = np.array([width_m, height_m]) - stroke_m
    outlines: list[Polygon] = []
    for stroke in _STROKES[character]:
        points = inset + np.array(stroke, np.float64) * size
        outlines += _ribbon(points, stroke_m / 2)
    return Solid.compound([union_plate(outlines, thickness_m)])


def _ribbon(points: Floats, half: float) -> list[Polygon]:
    """The outline of a stroke `2·half` wide along `points`; a ring has an outer outline and a hole."""
    if np.allclose(points[0], points[-1]):
        ring = points[:-1] if signed_area(points[:-1]) > 0 else points[:-1][::-1]
        normal = _mitre_offsets(ring - np.roll(ring, 1, axis=0), following(ring) - ring)
        return [ring + half * normal, (ring - half * normal)[::-1]]
    along = np.diff(points, axis=0)
    before, after = np.concatenate([along[:1], along]), np.concatenate([along, along[-1:]])
    normal = _mitre_offsets(before, after)
    unit = along / np.linalg.norm(along, axis=1)[:, None]
    points = points.copy()
    # Square ends: strokes that meet there then overlap instead of leaving a notch.
    points[0] -= half * unit[0]
    points[-1] += half * unit[-1]
    return [np.concatenate([points + half * normal, (points - half * normal)[::-1]])]


def _mitre_offsets(before: Floats, after: Floats) -> Floats:
    """Offset directions (to the right) at joints between edges, long enough to keep the width; at most twice."""
    right: Callable[[Floats], Floats] = lambda v: (  # noqa: E731
        np.stack([v[:, 1], -v[:, 0]], axis=1) / np.linalg.norm(v, axis=1)[:, None]
    )
    a, b = right(before), right(after)
    middle = a + b
    middle /= np.maximum(np.linalg.norm(middle, axis=1), 1e-9)[:, None]
    return np.asarray(middle / np.maximum((middle * a).sum(axis=1), 0.5)[:, None])
