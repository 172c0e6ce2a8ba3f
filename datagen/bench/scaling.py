"""What a transient costs as each size of the problem grows: `python -m datagen.bench.scaling OUT`.

One size is varied at a time about one problem (a furnished room; for the full secondary, the paper's N lookins, Ñ
observed points and FoV points). Cost is processor time, the median of a few runs;
the exponent is the slope of log cost against log size over the larger half of the sizes, where fixed costs no longer
hide it. Linear or better (an exponent of at most 1) is what is claimed. Peak memory of two large scans is measured in
processes of their own. Prints two tables and writes `scaling.png` and `scaling.md` to the folder OUT.
"""

from __future__ import annotations

import resource
import statistics
import subprocess
import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import click
import numpy as np

from datagen.bench.problems import Problem
from datagen.exit_status import guarded
from datagen.store.environment import cores, processor

LOOKINS_OF_SCANS = 256
"""For the memory table: peak memory does not grow with lookins, which are taken in chunks; time does."""
TRIANGLES = (100, 1_000, 10_000, 100_000, 1_000_000)


@dataclass(frozen=True)
class Sweep:
    """name : what grows; problems : (size, problem) from small to large."""

    name: str
    problems: tuple[tuple[int, Problem], ...]


@dataclass(frozen=True)
class Curve:
    name: str
    sizes: tuple[int, ...]
    seconds: tuple[float, ...]

    @property
    def exponent(self) -> float:
        """Slope of log seconds against log size over the larger half of the sizes."""
        half = len(self.sizes) // 2
        return float(np.polyfit(np.log(self.sizes[half:]), np.log(self.seconds[half:]), 1)[0])


def sweeps() -> tuple[Sweep, ...]:
    full = Problem(lookins=512, observed=512, fov_samples=512, lasers_a_side=1, pixels_a_side=1)
    return (
        Sweep("lookins", tuple((n, Problem(lookins=n)) for n in (256, 1024, 4096, 16384))),
        Sweep(
            "bounces after the second", tuple((n - 2, Problem(bounces=n, lookins=4096)) for n in (3, 4, 6, 10, 18))
        ),
        Sweep("laser points", tuple((n * n, Problem(lasers_a_side=n)) for n in (1, 2, 4, 8))),
        Sweep("confocal points", tuple((n * n, Problem(lasers_a_side=n, confocal=True)) for n in (2, 4, 8, 16, 32))),
        Sweep("pixels", tuple((n * n, Problem(pixels_a_side=n)) for n in (1, 2, 4, 8, 16))),
        Sweep("bins", tuple((n, Problem(bins=n)) for n in (64, 512, 4096, 16384, 65536))),
        *(
            Sweep(f"triangles, {name}", tuple((n, Problem(triangles=n, scene=name)) for n in TRIANGLES))
            for name in ("room", "sphere")
        ),
        Sweep("lookins, full secondary", tuple((n, replace(full, lookins=n)) for n in (64, 256, 1024, 4096))),
        Sweep(
            "observed points, full secondary", tuple((n, replace(full, observed=n)) for n in (64, 256, 1024, 4096))
        ),
        Sweep("FoV points, full secondary", tuple((n, replace(full, fov_samples=n)) for n in (64, 256, 1024, 4096))),
        Sweep("triangles, full secondary", tuple((n, replace(full, triangles=n)) for n in TRIANGLES)),
    )


def measure(sweep: Sweep, repeats: int) -> Curve:
    """Median processor seconds of each size, the sizes taken in turn so that a busy machine disturbs all alike.

    A first round, which compiles, is not counted.
    """
    calls = [problem.prepared() for _, problem in sweep.problems]
    for call in calls:
        call()
    seconds: list[list[float]] = [[] for _ in calls]
    for _ in range(repeats):
        for call, taken in zip(calls, seconds, strict=True):
            began = time.process_time()
            call()
            taken.append(time.process_time() - began)
    return Curve(
        sweep.name, tuple(size for size, _ in sweep.problems), tuple(statistics.median(taken) for taken in seconds)
    )


@dataclass(frozen=True)
class Scan:
    """A large scan and how much memory it may take: `limit_bytes` over the process before it."""

    title: str
    lasers_a_side: int
    pixels_a_side: int
    bins: int
    limit_bytes: int

    @property
    def array_bytes(self) -> int:
        """One array (laser, pixel, bin) of float64."""
        return 8 * (self.lasers_a_side * self.pixels_a_side) ** 2 * self.bins


SCANS = (
    Scan("64 × 64 laser points, 1 pixel, 1024 bins", 64, 1, 1024, 10**9),
    # The arrays that are handed back: total, its standard error, the two components.
    Scan("16 × 16 laser points, 16 × 16 pixels, 512 bins", 16, 16, 512, 4 * 8 * 16**4 * 512 + 500 * 10**6),
)


def peak_bytes(scan: int, lookins: int) -> tuple[int, float]:
    """Peak resident memory of a new process that simulates `SCANS[scan]` with secondary, and the seconds it took."""
    code = f"from datagen.bench.scaling import report_peak; report_peak({scan}, {lookins})"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    peak, seconds = done.stdout.split()
    return int(peak), float(seconds)


def report_peak(scan: int, lookins: int) -> None:
    """Simulate `SCANS[scan]` and print the process's peak resident bytes and the seconds; what `peak_bytes` runs."""
    wanted = SCANS[scan]
    problem = Problem(
        lookins=lookins, lasers_a_side=wanted.lasers_a_side, pixels_a_side=wanted.pixels_a_side, bins=wanted.bins
    )
    call = problem.prepared()
    began = time.perf_counter()
    kept = call()
    seconds = time.perf_counter() - began
    print(_peak_resident_bytes(), seconds)
    del kept


def _peak_resident_bytes() -> int:
    """This process's, and not its parent's, which Linux counts in `ru_maxrss` of a process it started."""
    status = Path("/proc/self/status")
    if status.is_file():
        return 1024 * next(int(line.split()[1]) for line in status.read_text().splitlines() if "VmHWM" in line)
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * (1 if sys.platform == "darwin" else 1024)


def table(curves: Sequence[Curve]) -> str:
    lines = ["| what grows | sizes | processor s | exponent |", "|---|---|---|---:|"]
    for curve in curves:
        sizes, seconds = " · ".join(map(str, curve.sizes)), " · ".join(f"{s:.3g}" for s in curve.seconds)
        lines.append(f"| {curve.name} | {sizes} | {seconds} | {curve.exponent:.2f} |")
    return "\n".join(lines)


def memory_table(lookins: int) -> str:
    lines = ["| scan with secondary | one array | peak memory | limit | seconds |", "|---|---:|---:|---:|---:|"]
    for k, scan in enumerate(SCANS):
        peak, seconds = peak_bytes(k, lookins)
        sizes = " | ".join(f"{n / 1e6:.0f} MB" for n in (scan.array_bytes, peak, scan.limit_bytes))
        lines.append(f"| {scan.title} | {sizes} | {seconds:.1f} |")
    return "\n".join(lines)


def picture(curves: Sequence[Curve], path: Path, machine: str) -> None:
    """Cost against each size, on logarithmic axes, with a straight line of slope 1 for the eye."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt
    from matplotlib.ticker import LogLocator, NullFormatter

    columns = 4
    figure, axes = plt.subplots(
        -(-len(curves) // columns), columns, figsize=(12, 8), constrained_layout=True, squeeze=False
    )
    for axis, curve in zip(axes.flat, curves, strict=False):
        sizes, seconds = np.array(curve.sizes), np.array(curve.seconds)
        axis.loglog(sizes, seconds[-1] * sizes / sizes[-1], color="0.75", lw=1, label="linear")
        axis.loglog(sizes, seconds, "o-", color="tab:blue", ms=4, label=f"exponent {curve.exponent:.2f}")
        axis.set_ylim(min(seconds.min() / 2, seconds.max() / 20), seconds.max() * 2)
        axis.set_xlabel(curve.name)
        axis.yaxis.set_minor_formatter(NullFormatter())
        axis.yaxis.set_major_locator(LogLocator(numticks=4))
        axis.legend(frameon=False, fontsize=8, loc="upper left")
    for axis in axes[:, 0]:
        axis.set_ylabel("processor seconds")
    for axis in axes.flat[len(curves) :]:
        axis.set_axis_off()
    figure.suptitle(f"Cost of a transient as one size grows ({machine})", fontsize=10)
    figure.savefig(path, dpi=130)
    plt.close(figure)


@click.command()
@click.argument("out", type=click.Path(file_okay=False, path_type=Path))
@click.option("--repeats", default=3, show_default=True, type=click.IntRange(1), help="Runs behind each median.")
@click.option("--only", default="", help="Only the sweeps whose name contains this; no memory table then.")
def main(out: Path, repeats: int, only: str) -> None:
    """Measure cost against size; tables to the screen and OUT/scaling.md, picture to OUT/scaling.png."""
    machine = f"{processor()}, {cores()} cores"
    curves = [measure(sweep, repeats) for sweep in sweeps() if only in sweep.name]
    text = f"Medians of {repeats}; {machine}\n\n{table(curves)}\n"
    if not only:
        text += f"\n{memory_table(LOOKINS_OF_SCANS)}\n"
    out.mkdir(parents=True, exist_ok=True)
    (out / "scaling.md").write_text(text)
    picture(curves, out / "scaling.png", machine)
    click.echo(text)


if __name__ == "__main__":
    raise SystemExit(guarded(main))
