"""The instants within an exposure at which the light of what moves is found.

While a laser point is measured things move on. A scan's exposures are so short that this is far less than a bin of a
path's length, and light is that of their middle. An exposure in which the path changes by more than `SHARP` bins, as
that of a flood or of an array which looks for a whole frame, is the mean over instants drawn in equal parts of it,
less than a bin apart. They are the same in all frames and for all laser points.
"""

from __future__ import annotations

import math

import numpy as np

from datagen.records import Capture, Scene
from datagen.records.arrays import Floats
from datagen.units import path_from_time

SHARP = 0.5
"""Change of a path's length in an exposure, bins, up to which things stand in it: they move by a quarter of a bin's
path, there and back."""
MOST = 32
"""Most instants of an exposure."""
MOST_WHOLE = 8
"""Most of them where each is a scene of its own."""


def path_change(scene: Scene, capture: Capture, times: Floats, exposure_s: float) -> float:
    """By how many bins the length of a path by way of what moves changes within an exposure, at most.

    times : (F, L) seconds, the middles of exposures.
    """
    began, ended = float(times.min()) - 0.5 * exposure_s, float(times.max()) + 0.5 * exposure_s
    fastest = max((_speed(scene, name, began, ended) for name in scene.moving), default=0.0)
    return 2.0 * fastest * exposure_s / path_from_time(capture.time.width_s)


def _speed(scene: Scene, name: str, began: float, ended: float) -> float:
    """Greatest speed of any point of a part between two times, m/s, at most; a jump has none."""
    path = scene.paths[name]
    lasts = np.diff(path.times_s)
    met = (lasts > 0) & (path.times_s[:-1] < ended) & (path.times_s[1:] > began)
    if not met.any():
        return 0.0
    arm = scene.vertices[np.unique(scene.triangles[scene.faces_of(name)])] - path.at(0.0).shifts_m
    radius = float(np.linalg.norm(arm[:, :2], axis=1).max())
    ways = np.linalg.norm(np.diff(path.places, axis=0)[met], axis=1)
    turns = np.abs(np.radians(np.diff(path.headings_deg)[met]))
    return float(((ways + radius * turns) / lasts[met]).max())


def instants(times: Floats, exposure_s: float, bins: float, most: int) -> Floats:
    """(S, …) seconds: the middles of S equal parts of exposures in the middle of which are `times` (…), where paths
    change by so many `bins`. S is 1 where that is little, and at most `most`."""
    count = 1 if bins <= SHARP else min(max(math.ceil(bins), 2), most)
    middles = (np.arange(count) + 0.5) / count - 0.5
    return np.asarray(times + exposure_s * middles.reshape(-1, *(1,) * times.ndim))
