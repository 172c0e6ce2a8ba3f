"""What a transient costs as each size of the problem grows, and the peak memory of two large scans.

`python tests/benchmarks/scaling.py` prints the figures of docs/figures.md. One size is varied at a time about one
problem in a furnished room. The exponent is the slope of log seconds against log size over the larger half of the
sizes, where fixed costs no longer hide it. Peak memory is measured in processes of their own.
"""

from __future__ import annotations

import resource
import statistics
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

import numpy as np
from benchmarks.other_renderers import grid_points
from benchmarks.problems import DEVICE, WALL, furnished_room

from datagen.bench.measuring import machine, markdown, processor_seconds
from datagen.records import Accuracy, Capture, Laser, Rectangle, Sensor, TimeAxis
from datagen.transport import simulate
from datagen.units import time_from_path

REPEATS = 3
SCANNED = Rectangle.of(WALL.center, 0.8 * WALL.right, 0.8 * WALL.up)


def prepared(
    lasers: int = 2, pixels: int = 4, bins: int = 512, cut: int = 1, confocal: bool = False, **accuracy: Any
) -> Callable[[], object]:
    """The call that is timed; the scene and the capture are made beforehand.

    lasers, pixels : on a side. cut : how often each triangle of the room is cut into four.
    """
    points = grid_points(SCANNED, lasers, lasers)
    sensor = Sensor.grid(DEVICE, SCANNED.center, SCANNED.right, SCANNED.up, pixels, pixels)
    if confocal:
        sensor = Sensor(DEVICE, points[:, None] + 0.02 * np.array([[0, -1, -1], [0, 1, -1], [0, 1, 1], [0, -1, 1]]))
    axis = TimeAxis(bins, time_from_path(20.0 / bins), 0.0, "wall")
    capture = Capture(Laser(DEVICE, points), sensor, axis, "confocal" if confocal else "exhaustive")
    scene, wanted = furnished_room(cut), Accuracy(**{"max_bounces": 4, **accuracy})
    return lambda: simulate(scene, capture, wanted, seed=1, split_parts=False)


FIXED: dict[str, Any] = {"samples": 512}
TO_TARGET: dict[str, Any] = {"lasers": 16, "cut": 0, "confocal": True, "target": 0.02, "max_bounces": 3}
SWEEPS: dict[str, list[tuple[int, dict[str, Any]]]] = {
    "samples": [(n, FIXED | {"samples": n}) for n in (256, 1024, 4096, 16384)],
    "bounces after the second": [(n - 2, FIXED | {"max_bounces": n}) for n in (3, 4, 6, 10, 18)],
    "laser points": [(n * n, FIXED | {"lasers": n}) for n in (1, 2, 4, 8)],
    "pixels": [(n * n, FIXED | {"pixels": n}) for n in (1, 2, 4, 8, 16)],
    "bins": [(n, FIXED | {"bins": n}) for n in (64, 512, 4096, 16384, 65536)],
    "triangles": [(36 * 4**n, FIXED | {"cut": n}) for n in (1, 3, 5, 6, 7)],
    "confocal points, to 2 %": [(n * n, TO_TARGET | {"lasers": n}) for n in (8, 16, 32, 64)],
    "bins, to 2 %": [(n, TO_TARGET | {"bins": n}) for n in (64, 256, 1024, 4096)],
    "triangles, to 2 %": [(36 * 4**n, TO_TARGET | {"cut": n}) for n in (0, 1, 2, 3, 4)],
}
"""What grows → its sizes from small to large, each with the problem."""
# Few samples: peak memory does not grow with them, which are taken in chunks; time does.
LARGE_SCANS = {
    "64 × 64 laser points, 1 pixel, 1024 bins": FIXED | {"samples": 64, "lasers": 64, "pixels": 1, "bins": 1024},
    "16 × 16 laser points, 16 × 16 pixels, 512 bins": FIXED | {"samples": 64, "lasers": 16, "pixels": 16},
}


def swept(name: str) -> list[str]:
    """A row of the table: median seconds of each size, the sizes taken in turn so that a busy machine disturbs all
    alike; a first round, which compiles, is not counted."""
    sizes, problems = zip(*SWEEPS[name], strict=True)
    calls = [prepared(**problem) for problem in problems]
    rounds = [[processor_seconds(call)[1] for call in calls] for _ in range(1 + REPEATS)]
    seconds = [statistics.median(taken) for taken in zip(*rounds[1:], strict=True)]
    half = len(sizes) // 2
    exponent = np.polyfit(np.log(sizes[half:]), np.log(seconds[half:]), 1)[0]
    return [name, "; ".join(f"{n}: {s:.3g}" for n, s in zip(sizes, seconds, strict=True)), f"{exponent:.2f}"]


def peak_bytes(scan: str) -> int:
    """Peak resident memory of a new process that simulates a large scan."""
    done = subprocess.run([sys.executable, __file__, scan], capture_output=True, text=True, check=True)
    return int(done.stdout)


def simulate_alone(scan: str) -> None:
    """What `peak_bytes` runs; this process's own memory, not its parent's, which Linux counts in `ru_maxrss`."""
    prepared(**LARGE_SCANS[scan])()
    status = Path("/proc/self/status")
    if status.is_file():
        print(1024 * next(int(line.split()[1]) for line in status.read_text().splitlines() if "VmHWM" in line))
    else:
        print(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * (1 if sys.platform == "darwin" else 1024))


def main() -> None:
    """Print cost against size, and the peak memory of two large scans."""
    print(f"Medians of {REPEATS}; {machine()}\n")
    print(markdown(["size", "size: processor s", "exponent"], map(swept, SWEEPS), 2))
    rows = [[scan, f"{peak_bytes(scan) / 1e6:.0f} MB"] for scan in LARGE_SCANS]
    print(f"\n{markdown(['scan with secondary', 'peak memory'], rows)}")


if __name__ == "__main__":
    simulate_alone(sys.argv[1]) if sys.argv[1:] else main()
