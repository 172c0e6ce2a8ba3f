"""What a long build takes: seconds and memory, by how many of its scenes are there.

    python tests/benchmarks/long_builds.py configs/quickstart.yaml --scenes 2048 --workers 2
    python tests/benchmarks/long_builds.py configs/quickstart.yaml --scan 64x64x512 --scenes 64

prints the figures of docs/figures.md. The build is the command `datagen build` in a process of its own. Memory is the
proportional set size (PSS, Linux) of that process and of its workers, apart, the largest of each part of the build.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
import psutil

from datagen.bench.measuring import machine, markdown
from datagen.bench.stages import with_scan
from datagen.config import load_config
from datagen.store.record import recorded_shards

PARTS = 5
"""Number of rows of the table: parts of a build of about as many scenes each."""
EVERY_S = 1.0
"""Time between two readings of the memory."""


class Reading(NamedTuple):
    """A moment of a build: seconds since its start, number of committed shards, and memory in MB of its own process
    and of the largest worker."""

    seconds: float
    shards: int
    build_mb: float
    worker_mb: float


def memory_mb(process: psutil.Process) -> float:
    """Proportional set size of a process, in thousands of kB as Linux counts them; 0 if it has ended."""
    try:
        return float(process.memory_full_info().pss) / 1.024e6
    except psutil.NoSuchProcess:
        return 0.0


def below(process: psutil.Process) -> list[psutil.Process]:
    """All processes that a process has started, and those that they have; none if it has ended."""
    try:
        return list(process.children(recursive=True))
    except psutil.NoSuchProcess:
        return []


def watched(command: Sequence[str], root: Path, every_s: float = EVERY_S) -> list[Reading]:
    """Readings of a build at `root` from its start to its end; raises CalledProcessError if it fails."""
    began, readings = time.perf_counter(), [Reading(0.0, 0, 0.0, 0.0)]
    with subprocess.Popen(command, stdout=subprocess.DEVNULL) as build:
        process = psutil.Process(build.pid)
        while build.poll() is None:
            time.sleep(every_s)
            memory = memory_mb(process), max(map(memory_mb, below(process)), default=0.0)
            readings.append(Reading(time.perf_counter() - began, len(recorded_shards(root)), *memory))
    if build.returncode:
        raise subprocess.CalledProcessError(build.returncode, command)
    return readings


def rows(readings: Sequence[Reading], scenes: int) -> list[list[str]]:
    """A row for each part of a build of `scenes` scenes: which scenes, seconds for each, and the most memory."""
    shards, found, last = np.array([reading.shards for reading in readings]), [], 0
    for part in range(1, PARTS + 1):
        end = int(np.searchsorted(shards, shards[-1] * part / PARTS))
        first, then = (round(scenes * shards[k] / shards[-1]) for k in (last, end))
        if then > first:
            each = (readings[end].seconds - readings[last].seconds) / (then - first)
            own = readings[last : end + 1]
            memory = (max(reading.build_mb for reading in own), max(reading.worker_mb for reading in own))
            found.append([f"{first} to {then}", f"{each:.3f}", *(f"{most:.0f}" for most in memory)])
            last = end
    return found


def main() -> None:
    """Build, and print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("config")
    parser.add_argument("--scenes", type=int, default=2000)
    parser.add_argument("--workers", type=int, default=1)
    parser.add_argument("--scan", help="rows, columns and bins instead of the configuration's, such as 64x64x512")
    chosen = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        config, root = Path(chosen.config), Path(folder) / "long.zarr"
        if chosen.scan:
            config = Path(folder) / "long.yaml"
            values = with_scan(load_config(chosen.config), chosen.scan).model_dump(mode="json")
            config.write_text(json.dumps(values), encoding="utf-8")
        command = [sys.executable, "-m", "datagen", "build", str(config), str(root)]
        command += ["--workers", str(chosen.workers), "--scenes", str(chosen.scenes)]
        readings = watched(command, root)
    print(f"{chosen.scenes} scenes of {chosen.config}, {chosen.workers} workers; {machine()}\n")
    head = ["scenes", "s a scene", "build (MB)", "largest worker (MB)"]
    print(markdown(head, rows(readings, chosen.scenes)))


if __name__ == "__main__":
    main()
