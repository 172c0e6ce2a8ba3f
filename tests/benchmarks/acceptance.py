"""Every way to light against plain paths: seconds, the error claimed and found, and energies, on many scenes.

    python tests/benchmarks/acceptance.py ready            # the ready configurations
    python tests/benchmarks/acceptance.py foreign kept     # random rooms with meshes of others; those kept aside
    python tests/benchmarks/acceptance.py hard             # scenes that are hard for one reason each
    python tests/benchmarks/acceptance.py ready --bounces 5 --scenes 3 --paths 400

`found` is the unbiased error of `datagen/bench/plain_check.py`, with its noise taken out; energies are those of the
simulated light over those of the paths, with the standard error of the latter. The rooms kept aside are for counting
at the end of a change, and nothing is tuned to them. A scene whose check is too noisy, or says that a claim is far
off, is checked again by more paths that are independent of the first: few paths seem to agree where none of them met
what is rare. Interrupted, the summary of what is done so far is printed all the same.
"""

from __future__ import annotations

import argparse
import math
import sys
import time
import warnings
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

import numpy as np
from benchmarks.foreign_scenes import foreign_scene
from benchmarks.hard_scenes import hard

import datagen as dg
from datagen.bench.measuring import machine, markdown, percent
from datagen.bench.plain_check import RUNS, Checked, PlainPaths
from datagen.errors import InputWarning
from datagen.records.arrays import Floats

CONFIGS = Path(__file__).parents[2] / "configs"
READY = (
    "quickstart", "furnished_rooms", "people_behind_doors", "rough_relay_walls", "crooked_corridors", "confocal_scan",
    "spad_array", "sparse_tracking",
)  # fmt: skip
PAIRS = 300
"""Most pairs of laser point and pixel whose paths are drawn."""
CHECKS, MORE = 3, 4
"""Most checks of a scene, and how many times as many paths each further one draws."""
SUSPECT = 1.4
"""True over claimed error from which on a scene is checked again."""
TRUE_BY_CLAIM = 1.5
"""True over claimed error that 95 % of scenes should not exceed."""


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


SETS = {"ready": ready, "foreign": foreign, "kept": foreign, "hard": hard}
"""Scenes by the name of their set."""


class Case(NamedTuple):
    """A scene measured. seconds, claimed : of one run. found : true error of the whole. energies : component → ratio
    of its energy to that of paths, standard error of the latter, and sampler. objects : claimed and true error of
    each object with more than 1e-4 of the light."""

    name: str
    seconds: float
    claimed: float
    found: Checked
    energies: dict[str, tuple[float, float, str]]
    objects: list[tuple[float, Checked]]

    @property
    def claims(self) -> list[tuple[float, Checked]]:
        """Claimed and true errors of the whole and of each object."""
        return [(self.claimed, self.found), *self.objects]

    def is_done(self, checks: int) -> bool:
        """Whether so many checks are enough: one if all is known and no claim looks far off, two if none does."""
        known = checks > 1 or all(is_known(true, of) for of, true in self.claims if of > 0)
        return checks == CHECKS or (known and all(true.error <= SUSPECT * of for of, true in self.claims))

    def cells(self) -> list[str]:
        """The row of the table."""
        energies = [f"{ratio:.3f} ± {noise:.3f} ({way})" for ratio, noise, way in self.energies.values()]
        objects = ", ".join(f"{true.error / of:.2f}" if is_known(true, of) else "?" for of, true in self.objects)
        return [self.name, f"{self.seconds:.2f}", percent(self.claimed), str(self.found), objects or "–", *energies]


def measured(name: str, scene: dg.Scene, capture: dg.Capture, accuracy: dg.Accuracy, paths: float) -> Case:
    """A scene. paths : thousands of plain paths, over all pairs and runs, that the first check draws."""
    count = math.prod(capture.shape[:2])
    chosen = np.sort(np.random.default_rng(0).choice(count, min(count, PAIRS), replace=False))
    dg.simulate(scene, capture, accuracy, 0)
    began = time.process_time()
    light = dg.simulate(scene, capture, accuracy, 1)
    seconds = time.process_time() - began
    of_all = light.total.sum()
    for turn in range(CHECKS):
        samples = max(int(1000 * paths * MORE**turn / RUNS / len(chosen)), 1)
        truth = PlainPaths.of(scene, capture, accuracy, samples, 7 + turn, chosen)
        energies = {}
        for component, of in light.components.items():
            true = truth.runs[component].sum(axis=(1, 2))
            if true.mean() > 0:
                ratio = of.reshape(count, -1)[chosen].sum() / true.mean()
                noise = true.std(ddof=1) / math.sqrt(RUNS) / true.mean()
                energies[component] = (ratio, noise, light.samplers[component])
        objects = [
            (claimed, truth.check(light.parts[part], part))
            for part, claimed in light.part_errors.items()
            if light.parts[part].sum() > 1e-4 * of_all
        ]
        whole = truth.check(light.total, *light.components)
        case = Case(name, seconds, light.relative_error, whole, energies, objects)
        if case.is_done(turn + 1):
            break
    return case


def is_known(found: Checked, claimed: float) -> bool:
    """Whether the noise of the check is small enough to judge a claim."""
    return found.noise < 0.3 * claimed**2


def quantiles(of: Floats) -> str:
    """Median, 95 % and the largest."""
    return f"median {np.median(of):.2f}, 95 % {np.quantile(of, 0.95):.2f}, largest {of.max():.2f}"


def summary(cases: list[Case], accuracy: dg.Accuracy) -> str:
    """What became of claims and targets: quantiles of true over claimed error, and of both over what was asked."""
    assert accuracy.target is not None
    lines = [f"{len(cases)} scenes, {sum(c.seconds for c in cases):.1f} processor s"]
    wholes = [(c.claimed, c.found) for c in cases if c.claimed > 0]
    objects = [pair for c in cases for pair in c.objects]
    for what, every, target in (("wholes", wholes, accuracy.target), ("objects", objects, accuracy.each_part)):
        pairs = [(claimed, found.error) for claimed, found in every if is_known(found, claimed)]
        lines.append(f"{len(pairs)} of {len(every)} {what} are known")
        if pairs:
            claimed, true = np.array(pairs).T
            beyond = f"{(true > TRUE_BY_CLAIM * claimed).sum()} beyond {TRUE_BY_CLAIM}"
            lines += [
                f"{len(pairs)} {what}, true/claimed: {quantiles(true / claimed)}; {beyond}",
                f"{len(pairs)} {what}, true/target: {quantiles(true / target)}",
            ]
    claims = np.array([c.claimed for c in cases]) / accuracy.target
    lines.append(f"{len(cases)} wholes, claimed/target: {quantiles(claims)}")
    for component in ("primary", "secondary", "higher"):
        known = [c.energies[component][:2] for c in cases if component in c.energies]
        if known:
            weights = 1 / np.array([max(noise, 1e-3) ** 2 for _, noise in known])
            mean = np.average([ratio for ratio, _ in known], weights=weights)
            lines.append(f"energy of {component} over paths: {mean:.4f} (mean, weighted by what is known)")
    return "\n".join(lines)


def main() -> None:
    """The table of the cases asked for."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("cases", nargs="+", choices=SETS)
    parser.add_argument("--scenes", type=int, default=1, help="scenes of each configuration, or in all")
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--bounces", type=int, default=4)
    parser.add_argument("--target", type=float, default=0.02)
    parser.add_argument("--paths", type=float, default=2000.0, help="thousands of plain paths of a scene")
    asked = parser.parse_args()
    accuracy = dg.Accuracy(target=asked.target, max_bounces=asked.bounces)
    head = ["scene", "processor s", "claimed", "found", "objects: found/claimed", "primary", "secondary", "higher"]
    head = head[: min(asked.bounces, 5) + 3]
    # Lasers that meet objects, and surfaces in one place, are meant.
    warnings.simplefilter("ignore", InputWarning)
    print(f"{machine()}; target {percent(asked.target)}, up to {asked.bounces} bounces\n")
    print(markdown(head, []))
    for case in asked.cases:
        # Rooms kept aside have numbers that no test uses.
        first, cases = asked.first + 9000 * (case == "kept"), []
        try:
            for name, scene, capture in SETS[case](asked.scenes, first):
                cases.append(measured(name, scene, capture, accuracy, asked.paths))
                print(f"| {' | '.join(cases[-1].cells())} |", flush=True)
        except KeyboardInterrupt:
            pass
        print(f"\n{summary(cases, accuracy)}\n")


if __name__ == "__main__":
    main()
