"""What a transient costs as each size of the problem grows, and how its error falls with the size of cells.

One size is varied at a time about one problem (a furnished room; for the full secondary, the paper's N lookins, Ñ
observed points and FoV points). The exponent is the slope of log seconds against log size over the larger half of
the sizes, where fixed costs no longer hide it. Linear or better (an exponent of at most 1) is what is claimed. Peak
memory of two large scans is measured in processes of their own. Sweeps "to 2 %" leave the counts to a target.

Error against cell size is that of the primary in the empty room, where nothing hides anything, by cells of at most a
given size relative to their distance, against cells half as large as the smallest.
"""

from __future__ import annotations

import itertools
import math
import resource
import statistics
import subprocess
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import click
import numpy as np
from numpy.typing import NDArray

from datagen.bench.measuring import machine, markdown, percent, processor_seconds
from datagen.bench.other_renderers import grid_points, point_capture
from datagen.bench.peer_cases import path_axis
from datagen.bench.problems import DEVICE, WALL, empty_room, furnished_room
from datagen.records import Accuracy, Capture, Laser, Rectangle, Sensor, TimeAxis
from datagen.records.arrays import l2_norm
from datagen.transport import simulate
from datagen.transport.cells.gathering import Gathering
from datagen.transport.reference import pairs_of
from datagen.transport.solver import prepared
from datagen.units import time_from_path

LOOKINS_OF_SCANS = 256
"""For the memory table: peak memory does not grow with lookins, which are taken in chunks; time does."""
SCANNED = Rectangle.of(WALL.center, 0.8 * WALL.right, 0.8 * WALL.up)


@dataclass(frozen=True)
class Problem:
    """The sizes that are varied, at the values they have while another is.

    observed : points each lookin sees, for the factorised sum of all secondary paths; None for the walk.
    target : error to be met, instead of the counts.
    """

    lookins: int = 2048
    fov_samples: int = 4
    bounces: int = 4
    observed: int | None = None
    lasers_a_side: int = 2
    pixels_a_side: int = 4
    bins: int = 512
    subdivisions: int = 1
    confocal: bool = False
    target: float | None = None

    def prepared(self) -> Callable[[], object]:
        """The call that is timed; the scene and the capture are made beforehand."""
        scene = furnished_room(self.subdivisions)
        points = grid_points(SCANNED, self.lasers_a_side, self.lasers_a_side)
        sensor = Sensor.grid(
            DEVICE, SCANNED.center, SCANNED.right, SCANNED.up, self.pixels_a_side, self.pixels_a_side
        )
        if self.confocal:
            half = np.array([[0, -1, -1], [0, 1, -1], [0, 1, 1], [0, -1, 1]]) * 0.02
            sensor = Sensor(DEVICE, points[:, None] + half)
        axis = TimeAxis(self.bins, time_from_path(20.0 / self.bins), 0.0, "wall")
        capture = Capture(Laser(DEVICE, points), sensor, axis, "confocal" if self.confocal else "exhaustive")
        accuracy = Accuracy(self.lookins, self.fov_samples, self.bounces, replicates=2, observed=self.observed)
        if self.target is not None:
            accuracy = Accuracy(target=self.target, max_bounces=self.bounces)
        return lambda: simulate(scene, capture, accuracy, seed=1, split_parts=False)


Sweep = Sequence[tuple[int, Problem]]
"""(size, problem) from small to large."""


def sweeps() -> dict[str, Sweep]:
    """What grows → the problems."""
    full = Problem(lookins=512, observed=512, fov_samples=512, lasers_a_side=1, pixels_a_side=1)
    fours = (64, 256, 1024, 4096)
    to_target = Problem(bounces=3, lasers_a_side=16, subdivisions=0, confocal=True, target=0.02)
    return {
        "lookins": [(n, Problem(lookins=n)) for n in (256, 1024, 4096, 16384)],
        "bounces after the second": [(n - 2, Problem(bounces=n, lookins=4096)) for n in (3, 4, 6, 10, 18)],
        "laser points": [(n * n, Problem(lasers_a_side=n)) for n in (1, 2, 4, 8)],
        "confocal points": [(n * n, Problem(lasers_a_side=n, confocal=True)) for n in (2, 4, 8, 16, 32)],
        "pixels": [(n * n, Problem(pixels_a_side=n)) for n in (1, 2, 4, 8, 16)],
        "bins": [(n, Problem(bins=n)) for n in (64, 512, 4096, 16384, 65536)],
        "triangles": [(36 * 4**n, Problem(subdivisions=n)) for n in (1, 3, 5, 6, 7)],
        "confocal points, to 2 %": [(n * n, replace(to_target, lasers_a_side=n)) for n in (8, 16, 32, 64)],
        "bins, to 2 %": [(n, replace(to_target, bins=n)) for n in (64, 256, 1024, 4096)],
        "triangles, to 2 %": [(36 * 4**n, replace(to_target, subdivisions=n)) for n in (0, 1, 2, 3, 4)],
        "lookins, full secondary": [(n, replace(full, lookins=n)) for n in fours],
        "observed points, full secondary": [(n, replace(full, observed=n)) for n in fours],
        "FoV points, full secondary": [(n, replace(full, fov_samples=n)) for n in fours],
    }


def measured(sweep: Sweep, repeats: int) -> list[float]:
    """Median processor seconds of each size, the sizes taken in turn so that a busy machine disturbs all alike.

    A first round, which compiles, is not counted.
    """
    calls = [problem.prepared() for _, problem in sweep]
    rounds = [[processor_seconds(call)[1] for call in calls] for _ in range(1 + repeats)]
    return [statistics.median(taken) for taken in zip(*rounds[1:], strict=True)]


def exponent(sizes: Sequence[int], seconds: Sequence[float]) -> float:
    """Slope of log seconds against log size over the larger half of the sizes."""
    half = len(sizes) // 2
    return float(np.polyfit(np.log(sizes[half:]), np.log(seconds[half:]), 1)[0])


LARGE_SCANS: dict[str, tuple[Problem, int]] = {
    # Limits of memory over the process before it; 2³⁰ bytes are the four arrays that the second hands back: total,
    # its standard error, the two components.
    "64 × 64 laser points, 1 pixel, 1024 bins": (Problem(lasers_a_side=64, pixels_a_side=1, bins=1024), 10**9),
    "16 × 16 laser points, 16 × 16 pixels, 512 bins": (
        Problem(lasers_a_side=16, pixels_a_side=16),
        2**30 + 5 * 10**8,
    ),
}


def peak_bytes(scan: str, lookins: int) -> tuple[int, float]:
    """Peak resident memory of a new process that simulates a large scan with secondary, and its processor seconds."""
    code = f"from datagen.bench.scaling import _print_peak; _print_peak({scan!r}, {lookins})"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    peak, seconds = done.stdout.split()
    return int(peak), float(seconds)


def _print_peak(scan: str, lookins: int) -> None:
    """What `peak_bytes` runs."""
    _, seconds = processor_seconds(replace(LARGE_SCANS[scan][0], lookins=lookins).prepared())
    print(_peak_resident_bytes(), seconds)


def _peak_resident_bytes() -> int:
    """This process's, and not its parent's, which Linux counts in `ru_maxrss` of a process it started."""
    status = Path("/proc/self/status")
    if status.is_file():
        return 1024 * next(int(line.split()[1]) for line in status.read_text().splitlines() if "VmHWM" in line)
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * (1 if sys.platform == "darwin" else 1024)


def memory_table(lookins: int) -> str:
    """Markdown: peak memory of the large scans."""
    rows = []
    for title, (problem, limit) in LARGE_SCANS.items():
        peak, seconds = peak_bytes(title, lookins)
        array = 8 * (problem.lasers_a_side * problem.pixels_a_side) ** 2 * problem.bins
        rows.append([title, *(f"{n / 1e6:.0f} MB" for n in (array, peak, limit)), f"{seconds:.1f}"])
    return markdown(["scan with secondary", "one array", "peak memory", "limit", "processor s"], rows)


CELL_SIZES = tuple(0.5 / 2**k for k in range(6))


def error_against_cell_size() -> str:
    """Markdown: cells a histogram, error, and its order between two sizes."""
    points = grid_points(WALL, 4, 4)
    capture = point_capture(WALL, points, DEVICE, points, path_axis(512, 0.03, 0.0), confocal=True)
    gathering = Gathering.of(prepared(empty_room(), capture, Accuracy(), 0, split_parts=False))
    pairs, parts = pairs_of(gathering.task.capture), len(gathering.peak)
    cells, found = list[int](), list[NDArray[np.float64]]()
    for size in (*CELL_SIZES, CELL_SIZES[-1] / 2):
        sized = replace(gathering, coarsest=size)
        # An error that no cell can make: its size alone decides.
        light = sized.gathered(pairs, sized.seen(pairs, 0), np.full(parts, 1e300), np.zeros(parts, np.int64))
        cells.append(int(light.cells.sum()) // len(pairs))
        found.append(light.histogram)
    errors = [l2_norm(one - found[-1]) / l2_norm(found[-1]) for one in found[:-1]]
    orders = ["–", *(f"{math.log2(coarse / fine):.1f}" for coarse, fine in itertools.pairwise(errors))]
    rows = [
        [f"{size:.3g}", str(count), percent(error), order]
        for size, count, error, order in zip(CELL_SIZES, cells, errors, orders, strict=False)
    ]
    return markdown(["cell / distance", "cells a histogram", "relative L2 error", "order"], rows)


@click.command()
@click.option("--repeats", default=3, show_default=True, type=click.IntRange(1), help="Runs behind each median.")
@click.option("--only", default="", help="Only the sweeps whose name contains this; no other table then.")
def main(repeats: int, only: str) -> None:
    """Print cost against size, error against cell size, and the peak memory of two large scans."""
    chosen = {name: sweep for name, sweep in sweeps().items() if only in name}
    if not chosen:
        raise click.UsageError(f"--only {only}: the sweeps are {'; '.join(sweeps())}")
    curves = {name: ([n for n, _ in sweep], measured(sweep, repeats)) for name, sweep in chosen.items()}
    rows = [
        [name, "; ".join(f"{n}: {s:.3g}" for n, s in zip(*curve, strict=True)), f"{exponent(*curve):.2f}"]
        for name, curve in curves.items()
    ]
    click.echo(f"Medians of {repeats}; {machine()}\n\n{markdown(['size', 'size: processor s', 'exponent'], rows, 2)}")
    if not only:
        click.echo(f"\n{error_against_cell_size()}\n\n{memory_table(LOOKINS_OF_SCANS)}")
