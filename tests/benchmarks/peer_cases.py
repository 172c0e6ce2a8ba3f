"""The cases of `peers.py`: rooms and captures, the contenders that compute them, and the truth."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from benchmarks import other_renderers as others
from benchmarks.other_renderers import MitransientPeer, grid_points, missing_for_mitransient
from benchmarks.problems import DEVICE, WALL, furnished_room, lump, rectangle

from datagen.bench.measuring import percent
from datagen.records import Accuracy, Capture, Rectangle, Scene, TimeAxis
from datagen.records.arrays import Floats, l2_norm
from datagen.transport import simulate
from datagen.units import time_from_path

LATE_S = 10e-9
"""Light after this has mostly bounced four times."""
OBJECTS, LATE = "worst object", "after 10 ns"
PEER = "mitransient"


@dataclass(frozen=True)
class Contender:
    """One way to compute a case.

    run : (samples, seed) → (row, pixel, bin): the total and, where the case wants objects and the contender knows
        them, each object's own light. takes_error : whether the contender takes an error instead of a number of
        samples; `samples` then is its reciprocal.
    """

    name: str
    unit: str
    run: Callable[[int, int], Floats]
    samples: tuple[int, ...]
    truth: Floats
    takes_error: bool = False

    def effort(self, samples: int) -> str:
        """The number of samples, or the error asked for, in words."""
        return f"to {percent(1 / samples)}" if self.takes_error else f"{samples} {self.unit}"


@dataclass(frozen=True)
class Case:
    """title : what is computed. norm : 1 or 2, for an L1 or L2 error. target : the error at which times are compared.
    late : first bin of the late light whose error is shown, too. most : largest number of runs behind each median."""

    title: str
    norm: int
    target: float
    contenders: tuple[Contender, ...]
    late: int | None = None
    most: int = 100

    def errors(self, result: Floats, truth: Floats) -> dict[str, float]:
        """Relative error of the whole and, where wanted and known, of the worst object and of late light."""
        found = {f"relative L{self.norm} error": self._error(result[0], truth[0])}
        if len(result) > 1:
            found[OBJECTS] = max(self._error(a, b) for a, b in zip(result[1:], truth[1:], strict=True))
        if self.late is not None:
            found[LATE] = self._error(result[0, :, self.late :], truth[0, :, self.late :])
        return found

    def _error(self, result: Floats, truth: Floats) -> float:
        # The threads of numpy's BLAS would take processor time of whatever is measured next.
        norm = l2_norm if self.norm == 2 else lambda values: float(np.abs(values).sum())
        return norm(result - truth) / norm(truth)


def ours(scene: Scene, capture: Capture, accuracy: Accuracy, seed: int, objects: bool = False) -> Floats:
    """(row, pixel, bin) radiance of our transient: the total and, with `objects`, each object's own light."""
    found = simulate(scene, capture, accuracy, seed, split_parts=objects)
    rows = [found.total, *(found.parts[name] for name in scene.objects if objects)]
    return np.stack([others.photons_to_radiance(row, capture).reshape(-1, capture.time.bins) for row in rows])


def to_target(scene: Scene, capture: Capture, bounces: int, objects: bool = False) -> Callable[[int, int], Floats]:
    """A function (n, seed) that runs ours as users do, to an error of 1/n."""
    return lambda one_in, seed: ours(scene, capture, Accuracy(target=1 / one_in, max_bounces=bounces), seed, objects)


def by_paths(scene: Scene, capture: Capture, bounces: int) -> Callable[[int, int], Floats]:
    """A function (n, seed) that runs ours with n plain paths of each pair."""
    return lambda samples, seed: ours(scene, capture, Accuracy(samples=samples, max_bounces=bounces), seed)


COUNTS = (10, 50, 200), (), (1 << 12, 1 << 14, 1 << 16)
"""Reciprocal errors for ours, our plain paths of each pair, and paths of mitransient."""


def bare_plate(points_a_side: int = 16, reference_knots: int = 1200) -> Case:
    """A plate of 0.5 m, 1 m from a scan of 0.7 m."""
    scan = Rectangle.of((0, 0, 0), (0, 0.35, 0), (0, 0, 0.35))
    plate = Rectangle.of((1.0, 0, 0), (0, -0.25, 0), (0, 0, 0.25))
    albedos, device = (0.8, 0.6), np.array([0.5, 0.0, 0.0])
    axis = path_axis(300, 0.003, 1.95)
    points = grid_points(scan, points_a_side, points_a_side)
    scene = Scene.from_parts([rectangle("wall", scan, albedos[0]), rectangle("plate", plate, albedos[1], "object")])

    def quadrature(knots: int, _: int) -> Floats:
        return others.plate_quadrature(points, scan.normal, plate, albedos, axis, knots)[None]

    capture = others.point_capture(scan, points, device, points, axis, confocal=True)
    truth = quadrature(reference_knots, 0)
    contenders = [
        Contender("ours, to a target", "", to_target(scene, capture, 3), (10, 50, 100, 200), truth, takes_error=True),
        Contender("ours, paths", "paths a pair", by_paths(scene, capture, 3), (1 << 8, 1 << 10, 1 << 12), truth),
        Contender("plain quadrature (numba)", "knots a side", quadrature, (32, 64, 128, 192), truth),
    ]
    if missing_for_mitransient() is None:
        sides = (points_a_side, points_a_side)
        peer = MitransientPeer(scene, "wall", scan, device, None, *sides, axis, bounces=3, aim_at_hidden=True)
        counts = (1 << 8, 1 << 10, 1 << 12)
        contenders.append(Contender(PEER, "paths a point", lambda n, seed: peer.render(n, seed)[None], counts, truth))
    title = f"Bare plate, {points_a_side} × {points_a_side} confocal points, 300 bins of 3 mm, 3 bounces"
    return Case(title, 1, 0.01, tuple(contenders))


def in_room(
    what: str, scene: Scene, points_a_side: int = 16, lasers: Floats | None = None, bounces: int = 3, *,
    reference: int = 1000, objects: bool = False,
    counts: tuple[tuple[int, ...], tuple[int, ...], tuple[int, ...]] = COUNTS, most: int = 100,
) -> Case:  # fmt: skip
    """A square grid of points on the wall of a room: a confocal scan, or each seen from every laser point.

    reference : the truth is ours to an error of 1/reference. counts : as `COUNTS`. most : as for `Case`.
    """
    axis, sides = path_axis(512, 0.03, 0.0), (points_a_side, points_a_side)
    errors, walks, paths = counts
    points = grid_points(WALL, *sides)
    lit = points if lasers is None else lasers
    capture = others.point_capture(WALL, points, DEVICE, lit, axis, confocal=lasers is None)
    ours, plain = to_target(scene, capture, bounces, objects), by_paths(scene, capture, bounces)
    truth = ours(reference, 1000)
    contenders = [Contender("ours, to a target", "", ours, errors, truth, takes_error=True)]
    if walks:
        contenders.append(Contender("ours, paths", "paths a pair", plain, walks, truth))
    if missing_for_mitransient() is None:
        each = [None] if lasers is None else list(lasers)
        peers = [MitransientPeer(scene, "relay_wall", WALL, DEVICE, at, *sides, axis, bounces=bounces) for at in each]

        def render(count: int, seed: int) -> Floats:
            return np.concatenate([peer.render(count, seed * len(peers) + k) for k, peer in enumerate(peers)])[None]

        contenders.append(Contender(PEER, "paths a point", render, paths, truth))
    orders = "3 bounces" if bounces == 3 else "3 + 4 bounces"
    seen = f"{points_a_side}² " + ("confocal points" if lasers is None else f"pixels × {len(lit)} laser point(s)")
    title = f"{what}, {seen}, 512 bins of 3 cm, {orders} (truth: ours to 1/{reference})"
    late = int(np.searchsorted(axis.centers_s, LATE_S)) if bounces > 3 else None
    return Case(title, 2, 0.02, tuple(contenders), late, most)


def path_axis(bins: int, width_m: float, start_m: float) -> TimeAxis:
    """A time axis whose bins are `width_m` of path wide and count from the wall."""
    return TimeAxis(bins, time_from_path(width_m), time_from_path(start_m), "wall")


def meshed() -> Scene:
    """The room with two meshes that stand free in it."""
    return furnished_room(more=[lump("small mesh", (1.4, 0.6, 0.9), 0.25, 9), lump(*LARGE, 22)])


ROOM, MESHED = "Furnished room", "Furnished room with meshes of 972 and 5 808 triangles"
LARGE = "large mesh", (1.6, -0.2, 1.7), 0.35
CASES: dict[str, Callable[[], Case]] = {
    "plate": bare_plate,
    "scan": lambda: in_room(ROOM, furnished_room(), counts=(COUNTS[0], (1 << 9, 1 << 11, 1 << 13), COUNTS[2])),
    "scan, meshes": lambda: in_room(MESHED, meshed(), reference=400, objects=True),
}
DEAR: dict[str, Callable[[], Case]] = {
    "exhaustive": lambda: in_room(
        ROOM, furnished_room(), 8, grid_points(WALL, 3, 3), 4, reference=100, counts=((50,), *COUNTS[1:]), most=1
    ),
    "scan, a million triangles": lambda: in_room(
        f"{ROOM} with a mesh of 1 002 252 triangles", furnished_room(more=[lump(*LARGE, 289)]), 32, reference=100,
        counts=((50,), (), (1 << 10, 1 << 12)), most=1,
    ),
}  # fmt: skip
"""Cases that take minutes."""
