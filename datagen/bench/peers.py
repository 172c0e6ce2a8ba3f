"""Error against processor seconds, ours beside what a user would otherwise pick.

- *Bare plate*: 0.5 m, nothing in the way, 16 × 16 confocal points, 300 bins of 3 mm, three bounces; relative L1 error
  against quadrature. Ours, mitransient at its best there (hidden-geometry sampling), and plain quadrature, which
  knows that there is nothing else in the scene.
- *Scan*: 16 × 16 confocal points of a closed room with a box and a pillar, 512 bins of 3 cm, three bounces; relative
  L2 error against much finer cells (held against the walk by `tests/equivalence`).
- *Furnished room*: the same one, three and four bounces; relative L2 error per 0.1 m bin against
  a long run of ours (its own error is printed). Ours and mitransient, seen from one point and from a 4 × 4 grid.

Ours is timed as a user calls it, `simulate` with all its preparation; the others after theirs (mitransient's scene
and kernels are built before the clock starts). mitransient runs when it is installed (`other_renderers.py`).
"""

from __future__ import annotations

import itertools
import math
import statistics
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import click
import numpy as np
from numpy.typing import NDArray

from datagen.bench import other_renderers as others
from datagen.bench.measuring import machine, markdown, percent, processor_seconds
from datagen.bench.other_renderers import grid_points, missing_for_mitransient
from datagen.bench.problems import DEVICE, WALL, furnished_room, rectangle
from datagen.records import Accuracy, Capture, Rectangle, Scene, TimeAxis
from datagen.transport import simulate
from datagen.units import time_from_path

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Contender:
    """One way to compute a case: `run(samples, seed)` → (pixel, bin), held against `truth`, binned as it bins."""

    name: str
    unit: str
    run: Callable[[int, int], Array]
    samples: tuple[int, ...]
    truth: Array


@dataclass(frozen=True)
class Case:
    """title : what is computed. norm : 1 or 2, of the relative error. target : the error to compare at."""

    title: str
    norm: int
    target: float
    contenders: tuple[Contender, ...]


def measured(case: Case, contender: Contender, repeats: int) -> list[tuple[float, float]]:
    """Processor seconds (all threads) and relative error at each number of samples, medians over other seeds."""
    found, scale = [], np.linalg.norm(contender.truth.ravel(), case.norm)
    for samples in contender.samples:
        # Shapes that depend on the number of samples compile anew in mitransient: once before the clock starts.
        contender.run(samples, 0)
        runs = [processor_seconds(lambda k=seed, n=samples: contender.run(n, k)) for seed in range(1, repeats + 1)]  # type: ignore[misc]
        errors = [float(np.linalg.norm((result - contender.truth).ravel(), case.norm) / scale) for result, _ in runs]
        found.append((statistics.median(seconds for _, seconds in runs), statistics.median(errors)))
    return found


def seconds_at(rows: Sequence[tuple[float, float]], target: float) -> tuple[float, bool]:
    """Processor seconds to reach an error, and whether that was measured (else it lies beyond the last row).

    rows : (seconds, error). Between two of them along the straight line of their logarithms; beyond the last with
    error ∝ 1/√seconds, which is how independent paths converge, so a floor that stays is not seen.
    """
    if rows[0][1] <= target:
        return rows[0][0], True
    for (less_s, worse), (more_s, better) in itertools.pairwise(rows):
        if better <= target:
            return less_s * (more_s / less_s) ** (math.log(worse / target) / math.log(worse / better)), True
    return rows[-1][0] * (rows[-1][1] / target) ** 2, False


def report(case: Case, repeats: int) -> str:
    """Markdown: error and seconds of every contender, then the seconds to the target error beside ours."""
    cells, ends, ours = list[list[str]](), list[str](), None
    for contender in case.contenders:
        rows = measured(case, contender, repeats)
        cells += [
            [contender.name, f"{n} {contender.unit}", f"{seconds:.3f}", percent(error)]
            for n, (seconds, error) in zip(contender.samples, rows, strict=True)
        ]
        seconds, reached = seconds_at(rows, case.target)
        ours = ours or seconds
        how = "" if reached else ", extrapolated as 1/√seconds"
        ratio = f"{seconds / ours:.3g} × ours"
        ends.append(f"- {contender.name}: {percent(case.target)} in {seconds:.3g} processor s{how} ({ratio})")
    head = ["", "samples", "processor s", f"relative L{case.norm} error"]
    return "\n".join([f"### {case.title}", "", markdown(head, cells), "", *ends, ""])


def _ours(scene: Scene, capture: Capture, bounces: int) -> Callable[[int, int], Array]:
    def run(lookins: int, seed: int) -> Array:
        accuracy = Accuracy(lookins=lookins, fov_samples=1, max_bounces=bounces, replicates=1)
        photons = simulate(scene, capture, accuracy, seed, split_parts=False).total
        return others.photons_to_radiance(photons, capture).reshape(-1, capture.time.bins)

    return run


def _by_target(scene: Scene, capture: Capture, bounces: int) -> Callable[[int, int], Array]:
    """Ours as a user asks for it, to an error of one in so many."""

    def run(one_in: int, seed: int) -> Array:
        accuracy = Accuracy(target=1 / one_in, max_bounces=bounces)
        photons = simulate(scene, capture, accuracy, seed, split_parts=False).total
        return others.photons_to_radiance(photons, capture).reshape(-1, capture.time.bins)

    return run


def bare_plate(points_a_side: int = 16, reference_knots: int = 1200) -> Case:
    """A plate of 0.5 m, 1 m from a scan of 0.7 m."""
    scan = Rectangle.of((0, 0, 0), (0, 0.35, 0), (0, 0, 0.35))
    plate = Rectangle.of((1.0, 0, 0), (0, -0.25, 0), (0, 0, 0.25))
    albedos, device = (0.8, 0.6), np.array([0.5, 0.0, 0.0])
    axis = _axis(300, 0.003, 1.95)
    points = grid_points(scan, points_a_side, points_a_side)
    scene = Scene.from_parts([rectangle("wall", scan, albedos[0]), rectangle("plate", plate, albedos[1], "object")])

    def quadrature(knots: int, _: int) -> Array:
        return others.plate_quadrature(points, scan.normal, plate, albedos, axis, knots)

    capture = others.point_capture(scan, points, device, points, axis, confocal=True)
    truth = quadrature(reference_knots, 0)
    contenders = [
        Contender("ours, cells", "1/target", _by_target(scene, capture, 3), (10, 50, 200), truth),
        Contender("ours, walk", "lookins a point", _ours(scene, capture, 3), (1 << 11, 1 << 13, 1 << 15), truth),
        Contender("plain quadrature (numba)", "knots a side", quadrature, (32, 64, 128, 192), truth),
    ]
    if missing_for_mitransient() is None:
        sides = (points_a_side, points_a_side)
        peer = others.MitransientPeer(scene, "wall", scan, device, None, *sides, axis, bounces=3, aim_at_hidden=True)
        contenders.append(Contender("mitransient", "paths a point", peer.render, (1 << 8, 1 << 10, 1 << 12), truth))
    title = f"Bare plate, {points_a_side} × {points_a_side} confocal points, 300 bins, 3 bounces"
    return Case(title, 1, 0.01, tuple(contenders))


def scan(points_a_side: int = 16, reference_one_in: int = 1000) -> Case:
    """A confocal scan of the closed room, three bounces: the main job."""
    scene, axis = furnished_room(), _axis(512, 0.03, 0.0)
    points = grid_points(WALL, points_a_side, points_a_side)
    capture = others.point_capture(WALL, points, DEVICE, points, axis, confocal=True)
    truth = _by_target(scene, capture, 3)(reference_one_in, 1000)
    contenders = [
        Contender("ours, cells", "1/target", _by_target(scene, capture, 3), (10, 50, 200), truth),
        Contender("ours, walk", "lookins a point", _ours(scene, capture, 3), (1 << 9, 1 << 11, 1 << 13), truth),
    ]
    if missing_for_mitransient() is None:
        sides = (points_a_side, points_a_side)
        peer = others.MitransientPeer(scene, "relay_wall", WALL, DEVICE, None, *sides, axis, bounces=3)
        contenders.append(Contender("mitransient", "paths a point", peer.render, (1 << 12, 1 << 14, 1 << 16), truth))
    title = (
        f"Scan of the furnished room, {points_a_side}² confocal points, 512 bins of 3 cm, 3 bounces "
        f"(reference: cells to 1/{reference_one_in})"
    )
    return Case(title, 2, 0.02, tuple(contenders))


def room(points_a_side: int, reference_walks: int = 1 << 20) -> Case:
    """A closed 4 × 3 × 2.5 m room, one laser point, points on the relay wall, three and four bounces."""
    scene, laser_point = furnished_room(), np.array([0, -0.8, 1.4])
    axis = _axis(170, 0.1, 0.0)
    points = grid_points(WALL, points_a_side, points_a_side)
    ours = _ours(scene, others.point_capture(WALL, points, DEVICE, laser_point[None], axis), 4)
    halves = [ours(reference_walks // 2, 1000 + k) for k in range(2)]
    truth = (halves[0] + halves[1]) / 2
    uncertain = float(np.linalg.norm(halves[0] - halves[1]) / 2 / np.linalg.norm(truth))
    contenders = [Contender("ours", "walks", ours, (1 << 12, 1 << 14, 1 << 16), truth)]
    if missing_for_mitransient() is None:
        sides = (points_a_side, points_a_side)
        peer = others.MitransientPeer(scene, "relay_wall", WALL, DEVICE, laser_point, *sides, axis, bounces=4)
        most = (1 << 20) // points_a_side**2
        contenders.append(
            Contender("mitransient", "paths a point", peer.render, (most // 16, most // 4, most), truth)
        )
    title = (
        f"Furnished room, {points_a_side}² points, 170 bins, 3 + 4 bounces (reference: {reference_walks} walks of "
        f"ours, uncertain by {percent(uncertain)})"
    )
    return Case(title, 2, 0.02, tuple(contenders))


def _axis(bins: int, width_m: float, start_m: float) -> TimeAxis:
    return TimeAxis(bins, time_from_path(width_m), time_from_path(start_m), "wall")


CASES: dict[str, Callable[[], Case]] = {
    "plate": bare_plate,
    "scan": scan,
    "room, 1 point": lambda: room(1),
    "room, 4 × 4 points": lambda: room(4),
}


@click.command()
@click.option("--repeats", default=5, show_default=True, type=click.IntRange(1), help="Runs behind each median.")
@click.option("--only", default="", help=f"Only the cases whose name contains this; they are {'; '.join(CASES)}.")
def main(repeats: int, only: str) -> None:
    """Print error against processor seconds for a bare plate and a furnished room, ours beside others."""
    click.echo(f"Medians of {repeats}; processor seconds, {machine()}\n")
    missing = missing_for_mitransient()
    if missing:
        click.echo(f"Without mitransient: {missing}\n")
    for name, case in CASES.items():
        if only in name:
            click.echo(report(case(), repeats))
