"""What the first scene after an installation takes, nearly all of it compiling, and that of a later process.

`python tests/benchmarks/first_scene.py [CONFIG …]` makes scene 0 of each configuration in two processes one after the
other, which share a cache of kernels that is empty at first, and prints the processor seconds of both, imports and
start of Python included.
"""

from __future__ import annotations

import os
import resource
import subprocess
import sys
import tempfile
from pathlib import Path

from datagen.bench.measuring import machine, markdown

ROOT = Path(__file__).resolve().parents[2]
SCENE = """
import sys
import datagen as dg
from datagen.pipeline import simulate_sample
simulate_sample(dg.load_config(sys.argv[1]), 0)
"""


def processor_seconds_of(program: str, argument: str, cache: Path) -> float:
    """Processor seconds of a process that runs a Python program with a cache of kernels."""
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    subprocess.run(
        [sys.executable, "-c", program, argument], check=True, env=os.environ | {"NUMBA_CACHE_DIR": str(cache)}
    )
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return after.ru_utime - before.ru_utime + after.ru_stime - before.ru_stime


def measured(program: str, argument: str) -> tuple[float, float, int]:
    """Processor seconds of the first process and of a second one, and how many kernels the first one stored."""
    with tempfile.TemporaryDirectory() as folder:
        first = processor_seconds_of(program, argument, Path(folder))
        stored = len(list(Path(folder).rglob("*.nbi")))
        return first, processor_seconds_of(program, argument, Path(folder)), stored


def main() -> None:
    """Print the table."""
    configs = sys.argv[1:] or [str(ROOT / "configs" / "quickstart.yaml")]
    rows = list[list[str]]()
    for config in configs:
        first, second, stored = measured(SCENE, config)
        rows.append([Path(config).stem, f"{first:.1f}", f"{second:.1f}", str(stored)])
    head = ["processor s", "first scene", "that of a second process", "functions compiled"]
    print(f"{machine()}\n\n{markdown(head, rows)}")


if __name__ == "__main__":
    main()
