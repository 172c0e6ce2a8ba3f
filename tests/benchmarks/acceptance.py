"""Every way to light against plain paths: seconds, the error claimed and found, and energies, on many scenes.

    python tests/benchmarks/acceptance.py ready            # the ready configurations
    python tests/benchmarks/acceptance.py foreign kept     # random rooms with meshes of others; those kept aside
    python tests/benchmarks/acceptance.py ready --bounces 5 --scenes 3 --paths 400

`found` is the unbiased error of `datagen/bench/plain_check.py`, with its noise taken out; energies are those of the
simulated light over those of the paths, with the standard error of the latter. The rooms kept aside are for counting
at the end of a change, and nothing is tuned to them.
"""

from __future__ import annotations

import argparse
import math
import sys
import time
from collections.abc import Iterator
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

import numpy as np
from benchmarks.foreign_scenes import foreign_scene

import datagen as dg
from datagen.bench.measuring import machine, markdown, percent
from datagen.bench.plain_check import RUNS, PlainPaths
from datagen.transport.flood import as_scan
from datagen.transport.reference import pairs_of

CONFIGS = Path(__file__).parents[2] / "configs"
READY = (
    "quickstart", "furnished_rooms", "people_behind_doors", "rough_relay_walls", "crooked_corridors", "confocal_scan",
    "spad_array", "sparse_tracking",
)  # fmt: skip
PAIRS = 300
"""Most pairs of laser point and pixel whose paths are drawn."""


def ready(scenes: int, first: int) -> Iterator[tuple[str, dg.Scene, dg.Capture]]:
    """Scenes of the ready configurations."""
    for name in READY:
        config = dg.load_config(CONFIGS / f"{name}.yaml")
        for index in range(first, first + scenes):
            scene = dg.scene_for(config, index)
            yield f"{name} {index}", scene, dg.capture_for(config, scene, config.seed, index)


def foreign(scenes: int, first: int) -> Iterator[tuple[str, dg.Scene, dg.Capture]]:
    """Random rooms with meshes of others, random materials and captures."""
    for number in range(first, first + scenes):
        found = foreign_scene(number)
        yield f"foreign {number}", found.scene, found.capture


def row(name: str, scene: dg.Scene, capture: dg.Capture, accuracy: dg.Accuracy, paths: float) -> list[str]:
    """Cells of a scene. paths : thousands of plain paths, over all pairs and runs, that the check draws."""
    capture = as_scan(capture) if capture.illumination == "flood" else capture
    count = len(pairs_of(capture))
    chosen = np.sort(np.random.default_rng(0).choice(count, min(count, PAIRS), replace=False))
    samples = max(int(1000 * paths / RUNS / len(chosen)), 1)
    truth = PlainPaths.of(scene, capture, accuracy, samples, 7, chosen)
    dg.simulate(scene, capture, accuracy, 0)
    began = time.process_time()
    light = dg.simulate(scene, capture, accuracy, 1)
    seconds = time.process_time() - began
    names = [name for name in light.components]
    whole = truth.check(light.total, *names)
    cells = [name, f"{seconds:.2f}", percent(light.relative_error), str(whole)]
    for part in ("primary", "secondary", "higher"):
        if part in names:
            energies = truth.runs[part].sum(axis=(1, 2))
            found = light.components[part].reshape(count, -1)[chosen].sum()
            ratio, noise = found / energies.mean(), energies.std(ddof=1) / math.sqrt(RUNS) / energies.mean()
            cells.append(f"{ratio:.3f} ± {noise:.3f} {light.samplers[part][:1]}")
    return cells


def main() -> None:
    """The table of the cases asked for."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("cases", nargs="+", choices=("ready", "foreign", "kept"))
    parser.add_argument("--scenes", type=int, default=1, help="scenes of each configuration, or in all")
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--bounces", type=int, default=4)
    parser.add_argument("--target", type=float, default=0.02)
    parser.add_argument("--paths", type=float, default=2000.0, help="thousands of plain paths of a scene")
    asked = parser.parse_args()
    accuracy = dg.Accuracy(target=asked.target, max_bounces=asked.bounces)
    head = ["scene", "processor s", "claimed", "found", "primary", "secondary", "higher"][: asked.bounces + 2]
    print(f"{machine()}; target {percent(asked.target)}, up to {asked.bounces} bounces\n")
    print(markdown(head, []))
    for case in asked.cases:
        # Rooms kept aside have numbers that no test uses.
        make, first = (ready, asked.first) if case == "ready" else (foreign, asked.first + 9000 * (case == "kept"))
        for name, scene, capture in make(asked.scenes, first):
            print(f"| {' | '.join(row(name, scene, capture, accuracy, asked.paths))} |", flush=True)


if __name__ == "__main__":
    main()
