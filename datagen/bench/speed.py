"""Error against seconds, ours beside what a user would otherwise pick: `python -m datagen.bench.speed`.

- *Bare plate*: 0.5 m, nothing in the way, 16 × 16 confocal points, 300 bins of 3 mm, three bounces; relative L1 error
  against quadrature. Ours, mitransient at its best there (hidden-geometry sampling), and plain quadrature, which
  knows that there is nothing else in the scene.
- *Furnished room*: closed, with a box and a pillar, three and four bounces; relative L2 error per 0.1 m bin against
  a long run of ours (its own error is printed). Ours and mitransient, seen from one point and from a 4 × 4 grid.
- *The paper's case*: all secondary paths, beside its published times (`datagen.bench.paper_case`).

Times are compared by processor seconds, all threads together, so that a busy machine does not decide; the wall clock
of an idle one is what they come to divided by the threads at work (mitransient takes all cores).
Ours is timed as a user calls it, `simulate` with all its preparation; the peers after theirs (mitransient's scene and
kernels are built before the clock starts). mitransient runs when it is installed; see `datagen.bench.peers`.
"""

from __future__ import annotations

import itertools
import math
import statistics
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import click
import numpy as np
import trimesh
from numpy.typing import NDArray

from datagen.bench import paper_case
from datagen.bench.peers import (
    MitransientPeer,
    grid_points,
    missing_for_mitransient,
    photons_to_radiance,
    plate_quadrature,
    point_capture,
)
from datagen.exit_status import guarded
from datagen.records import Accuracy, Lambertian, Part, Rectangle, Scene, TimeAxis
from datagen.store.environment import cores, processor
from datagen.transport import simulate
from datagen.units import time_from_path

Method = Callable[[int, int], NDArray[np.float64]]
"""(samples, seed) → (pixel, bin)."""


@dataclass(frozen=True)
class Contender:
    """One way to compute a case: `run(samples, seed)`, held against `truth` (pixel, bin), binned as it bins."""

    name: str
    unit: str
    run: Method
    samples: tuple[int, ...]
    truth: NDArray[np.float64]


@dataclass(frozen=True)
class Case:
    """title : what is computed. norm : 1 or 2, of the relative error. target : the error to compare at."""

    title: str
    norm: int
    target: float
    contenders: tuple[Contender, ...]


@dataclass(frozen=True)
class Row:
    """Medians over the repeats: wall-clock and processor seconds (all threads), relative error."""

    contender: str
    samples: int
    unit: str
    seconds: float
    cpu_seconds: float
    error: float


def measure(case: Case, repeats: int) -> list[Row]:
    """Run every contender of a case at each of its sample counts, `repeats` times with other seeds."""
    rows = []
    for contender in case.contenders:
        contender.run(contender.samples[0], 0)
        scale = np.linalg.norm(contender.truth.ravel(), case.norm)
        for samples in contender.samples:
            # Shapes that depend on the number of samples compile anew in mitransient: once before the clock starts.
            contender.run(samples, 0)
            wall, cpu, errors = [], [], []
            for seed in range(1, repeats + 1):
                began, cpu_began = time.perf_counter(), time.process_time()
                result = contender.run(samples, seed)
                wall.append(time.perf_counter() - began)
                cpu.append(time.process_time() - cpu_began)
                errors.append(float(np.linalg.norm((result - contender.truth).ravel(), case.norm) / scale))
            rows.append(
                Row(contender.name, samples, contender.unit, *(statistics.median(x) for x in (wall, cpu, errors)))
            )
    return rows


def seconds_at(rows: Sequence[Row], target: float) -> tuple[float, bool]:
    """Processor seconds to reach an error, and whether that was measured (else it lies beyond the last row).

    Between two rows along the straight line of their logarithms; beyond the last with error ∝ 1/√seconds, which is
    how independent paths converge, so a floor that does not go away with samples is not seen.
    """
    if rows[0].error <= target:
        return rows[0].cpu_seconds, True
    for worse, better in itertools.pairwise(rows):
        if better.error <= target:
            along = math.log(worse.error / target) / math.log(worse.error / better.error)
            return worse.cpu_seconds * (better.cpu_seconds / worse.cpu_seconds) ** along, True
    return rows[-1].cpu_seconds * (rows[-1].error / target) ** 2, False


def table(case: Case, rows: Sequence[Row]) -> str:
    """Markdown: the rows, then the seconds to the target error and their ratios to the first contender's."""
    norm = f"relative L{case.norm} error"
    lines = [f"### {case.title}", "", f"| | samples | seconds | processor s | {norm} |", "|---|---:|---:|---:|---:|"]
    for row in rows:
        cells = [row.contender, f"{row.samples} {row.unit}", f"{row.seconds:.3f}", f"{row.cpu_seconds:.3f}"]
        lines.append(f"| {' | '.join(cells)} | {row.error:.2%} |")
    lines.append("")
    first = None
    for contender in case.contenders:
        seconds, measured = seconds_at([row for row in rows if row.contender == contender.name], case.target)
        first = first or seconds
        how = "" if measured else ", extrapolated as 1/√seconds"
        lines.append(
            f"- {contender.name}: {case.target:.0%} in {seconds:.3g} processor s{how} ({seconds / first:.3g} × ours)"
        )
    return "\n".join(lines)


def bare_plate() -> Case:
    """The plate of DESIGN, sec. 3: 0.5 m, 1 m from a 0.7 m scan."""
    scan = Rectangle.of((0, 0, 0), (0, 0.35, 0), (0, 0, 0.35))
    plate = Rectangle.of((1.0, 0, 0), (0, -0.25, 0), (0, 0, 0.25))
    albedos, device = (0.8, 0.6), np.array([0.5, 0.0, 0.0])
    axis = _axis(300, 0.003, 1.95)
    points = grid_points(scan, 16, 16)
    scene = Scene.from_parts([_part("wall", scan, albedos[0]), _part("plate", plate, albedos[1], "object")])
    capture = point_capture(scan, points, device, points, axis, confocal=True)

    def ours(samples: int, seed: int) -> NDArray[np.float64]:
        accuracy = Accuracy(lookins=samples, fov_samples=1, max_bounces=3, replicates=1)
        photons = simulate(scene, capture, accuracy, seed, split_parts=False).total
        return photons_to_radiance(photons, capture)[:, 0]

    def quadrature(knots: int, _: int) -> NDArray[np.float64]:
        return plate_quadrature(points, scan.normal, plate, albedos, axis, knots)

    shared = quadrature(1200, 0)
    contenders = [
        Contender("ours", "lookins a point", ours, (1 << 11, 1 << 13, 1 << 15), shared),
        Contender("plain quadrature (numba)", "knots a side", quadrature, (32, 64, 128, 192), shared),
    ]
    if missing_for_mitransient() is None:
        peer = MitransientPeer(scene, "wall", scan, device, None, 16, 16, axis, bounces=3, fine=1, aim_at_hidden=True)
        own = plate_quadrature(points, scan.normal, plate, albedos, axis, 1200, shared=False)
        contenders.append(Contender("mitransient", "paths a point", peer.render, (1 << 8, 1 << 10, 1 << 12), own))
    return Case("Bare plate, 16 × 16 confocal points, 300 bins, 3 bounces", 1, 0.01, tuple(contenders))


def furnished_room(points_a_side: int, long_run: int = 1 << 20) -> Case:
    """A closed 4 × 3 × 2.5 m room, one laser point, points on the relay wall, three and four bounces."""
    wall = Rectangle.of((0, 0, 1.25), (0, 1.5, 0), (0, 0, 1.25))
    scene, device, laser_point = _room(wall), np.array([1.5, 0.1, 1.3]), np.array([0, -0.8, 1.4])
    axis = _axis(170, 0.1, 0.0)
    points = grid_points(wall, points_a_side, points_a_side)
    capture = point_capture(wall, points, device, laser_point[None], axis)

    def ours(samples: int, seed: int, replicates: int = 1) -> NDArray[np.float64]:
        accuracy = Accuracy(lookins=samples, fov_samples=1, max_bounces=4, replicates=replicates)
        photons = simulate(scene, capture, accuracy, seed, split_parts=False).total
        return photons_to_radiance(photons, capture)[0]

    halves = [ours(long_run // 2, seed=1000 + k) for k in range(2)]
    truth = (halves[0] + halves[1]) / 2
    uncertain = float(np.linalg.norm(halves[0] - halves[1]) / 2 / np.linalg.norm(truth))
    contenders = [Contender("ours", "walks", ours, (1 << 12, 1 << 14, 1 << 16), truth)]
    if missing_for_mitransient() is None:
        peer = MitransientPeer(
            scene, "relay_wall", wall, device, laser_point, points_a_side, points_a_side, axis, bounces=4
        )
        most = (1 << 20) // points_a_side**2
        contenders.append(
            Contender("mitransient", "paths a point", peer.render, (most // 16, most // 4, most), truth)
        )
    title = (
        f"Furnished room, {points_a_side}² points, 170 bins, 3 + 4 bounces (reference: {long_run} walks of ours, "
        f"uncertain by {uncertain:.2%})"
    )
    return Case(title, 2, 0.02, tuple(contenders))


def _axis(bins: int, width_m: float, start_m: float) -> TimeAxis:
    return TimeAxis(bins, time_from_path(width_m), time_from_path(start_m), "wall")


def _part(name: str, surface: Rectangle, albedo: float, role: str = "structure") -> Part:
    mesh = trimesh.Trimesh(surface.corners, [[0, 1, 2], [0, 2, 3]], process=False)
    return Part(name, mesh, Lambertian(albedo), role)  # type: ignore[arg-type]


def _room(wall: Rectangle) -> Scene:
    shell = trimesh.creation.box((4, 3, 2.5))
    shell.apply_translation((2, 0, 1.25))
    others = shell.submesh([np.flatnonzero(shell.triangles_center[:, 0] > 1e-6)], append=True)
    box = trimesh.creation.box((0.6, 0.5, 0.8))
    box.apply_translation((2.2, -0.7, 0.4))
    pillar = trimesh.creation.box((0.4, 0.4, 2.5))
    pillar.apply_transform(trimesh.transformations.rotation_matrix(math.pi / 4, (0, 0, 1), (0, 0, 0)))
    pillar.apply_translation((2.6, 0.7, 1.25))
    return Scene.from_parts(
        [
            _part("relay_wall", wall, 0.8),
            Part("shell", others, Lambertian(0.65), "structure"),
            Part("box", box, Lambertian(0.5)),
            Part("pillar", pillar, Lambertian(0.7)),
        ]
    )


@click.command()
@click.option("--repeats", default=5, show_default=True, type=click.IntRange(1), help="Runs behind each median.")
def main(repeats: int) -> None:
    """Print error against seconds for a bare plate and a furnished room, ours beside its peers."""
    click.echo(f"Medians of {repeats}; {processor()}, {cores()} cores\n")
    missing = missing_for_mitransient()
    if missing:
        click.echo(f"Without mitransient: {missing}\n")
    cases: tuple[Callable[[], Case], ...] = (bare_plate, lambda: furnished_room(1), lambda: furnished_room(4))
    for make in cases:
        case = make()
        click.echo(table(case, measure(case, repeats)) + "\n")
    # Last, because it keeps the process on one core.
    click.get_current_context().invoke(paper_case.main, repeats=repeats)


if __name__ == "__main__":
    raise SystemExit(guarded(main))
