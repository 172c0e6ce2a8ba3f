"""Every way to light against plain paths: seconds, the error claimed and found, and energies, on many scenes.

    python tests/benchmarks/acceptance.py ready            # the ready configurations
    python tests/benchmarks/acceptance.py foreign kept     # random rooms with meshes of others; those kept aside
    python tests/benchmarks/acceptance.py hard             # scenes that are hard for one reason each
    python tests/benchmarks/acceptance.py ready --bounces 5 --scenes 3 --paths 400
    python tests/benchmarks/acceptance.py kept --bounces 3 --scenes 200 --first 4000

`found` is the unbiased error of `datagen/bench/plain_check.py`, with the noise of the paths taken out; energies are
those of the simulated light over those of the paths, with the standard error of the latter. The rooms kept aside are
for counting at the end of a change, and nothing is tuned to them. 200 of them take some 40 minutes, nearly all of it
for the paths.

An error is known if the noise of its check, as an error, is below 0.35 of the error claimed or found, whichever is
larger: noise < (0.35 max(claimed, error))², as the noise is that of a square. What is found for a right claim is then
known to 6 %, an error of nothing counts as 0.35 of its claim at most, and a claim that is far too small is known as
soon as the error stands out of the noise. (Noise that is relative to the claim alone leaves out just these.) The
paths of a scene are doubled until all its errors are known, and at least once where a claim looks far too small: few
paths seem to agree where none of them met what is rare.

Each set has a summary of its own. In its quantiles each kind (a configuration, a reason to be hard, a room) weighs
the same, however many scenes or objects of it are known, as those of one kind err alike. Light that claims nothing
because nothing was met, and light without a claim, are counted apart. Interrupted, the summary of what is done so far
is printed all the same.
"""

from __future__ import annotations

import argparse
import math
import sys
import warnings
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

import numpy as np
from benchmarks.foreign_scenes import foreign_scene
from benchmarks.hard_scenes import hard

import datagen as dg
from datagen.bench.measuring import machine, markdown, percent, processor_seconds
from datagen.bench.plain_check import RUNS, Checked, PlainPaths
from datagen.errors import InputWarning
from datagen.records.arrays import Floats, Ints, l2_norm

CONFIGS = Path(__file__).parents[2] / "configs"
READY = (
    "quickstart", "furnished_rooms", "people_behind_doors", "rough_relay_walls", "crooked_corridors", "confocal_scan",
    "spad_array", "sparse_tracking",
)  # fmt: skip
PAIRS = 300
"""Most pairs of laser point and pixel whose paths are drawn."""
DOUBLINGS = 5
"""Most times that the paths of a scene are doubled."""
NOISE = 0.35
"""Noise of a check, as an error, relative to the error claimed or found, up to which that error is known."""
SUSPECT = 1.4
"""True over claimed error from which on a scene gets more paths although it is known."""
TRUE_BY_CLAIM = 1.5
"""True over claimed error that 95 % of scenes should not exceed."""
SOME = 1e-4
"""Light of an object, relative to all, from which on it is looked at."""
WHOLES, OBJECTS = 0.003, 0.01
"""What the energies of wholes and of objects may be off by; those that are known better weigh alike in a mean."""
Named = tuple[str, str, dg.Scene, dg.Capture]


def ready(scenes: int, first: int) -> Iterator[Named]:
    """Scenes of the ready configurations, each with its kind and number."""
    for name in READY:
        config = dg.load_config(CONFIGS / f"{name}.yaml")
        for index in range(first, first + scenes):
            scene = dg.scene_for(config, index)
            yield name, f"{name} {index}", scene, dg.capture_for(config, scene, config.seed, index)


def foreign(scenes: int, first: int) -> Iterator[Named]:
    """Random rooms with meshes of others, random materials and captures, each of its own kind."""
    for number in range(first, first + scenes):
        found = foreign_scene(number)
        yield f"{number}", f"foreign {number}", found.scene, found.capture


def hard_ones(scenes: int, first: int) -> Iterator[Named]:
    """Hard scenes, each with its reason."""
    for name, scene, capture in hard(scenes, first):
        yield name.rsplit(" ", 1)[0], name, scene, capture


SETS = {"ready": ready, "foreign": foreign, "kept": foreign, "hard": hard_ones}
"""Scenes by the name of their set."""


class Judged(NamedTuple):
    """What plain paths say of some light. claimed : error, 0 if nothing was met, NaN without a claim. found : error.
    energy, noise : energy over that of paths, and the standard error of the latter; NaN and 0 if they met nothing.
    """

    claimed: float
    found: Checked
    energy: float
    noise: float

    @classmethod
    def of(cls, claimed: float, light: Floats, truth: PlainPaths, *names: str) -> Judged:
        """The same of light (L, P, T), which should be the sum of some components or parts."""
        true = np.sum([truth.runs[name] for name in names], axis=0).sum(axis=(1, 2))
        own, mean = float(light.reshape(-1, light.shape[-1])[truth.pairs].sum()), float(true.mean())
        energy, noise = (
            (own / mean, float(true.std(ddof=1)) / math.sqrt(RUNS) / mean) if mean > 0 else (math.nan, 0.0)
        )
        return cls(claimed, truth.check(light, *names), energy, noise)

    @property
    def true_by_claim(self) -> float:
        """True over claimed error."""
        return self.found.error / self.claimed

    @property
    def is_known(self) -> bool:
        """Whether the noise of the check is small enough to judge a claim."""
        return self.found.noise < (NOISE * max(self.claimed, self.found.error)) ** 2

    @property
    def energy_cell(self) -> str:
        """The energy and its noise."""
        return f"{self.energy:.4f} ± {self.noise:.4f}"

    @property
    def cell(self) -> str:
        """True over claimed error, with a question mark if it is not known, and the energy."""
        ratio = f"{self.true_by_claim:.2f}{'' if self.is_known else '?'}" if self.claimed > 0 else "no claim"
        return f"{ratio} ({self.energy_cell})"


class Case(NamedTuple):
    """A scene measured. seconds : of one run. whole : of all light. components : of each, and its sampler. objects :
    those with more than `SOME` of the light, as simulated or by paths."""

    kind: str
    name: str
    seconds: float
    whole: Judged
    components: dict[str, tuple[Judged, str]]
    objects: dict[str, Judged]

    @classmethod
    def of(
        cls, kind: str, name: str, seconds: float, light: dg.Transient, truth: PlainPaths, parts: Sequence[str]
    ) -> Case:
        """The same of the light of a scene, some parts of which are objects."""
        names, claims = tuple(light.components), light.part_errors
        components = {
            name: (Judged.of(math.nan, of, truth, name), light.samplers[name])
            for name, of in light.components.items()
        }
        of_all, true = light.total.sum(), sum(truth.runs[name].mean(axis=0).sum() for name in names)
        objects = {
            part: Judged.of(claims.get(part, math.nan), light.parts[part], truth, part)
            for part in parts
            if light.parts[part].sum() > SOME * of_all or truth.runs[part].mean(axis=0).sum() > SOME * true
        }
        whole = Judged.of(light.relative_error, light.total, truth, *names)
        return cls(kind, name, seconds, whole, components, objects)

    @property
    def claims(self) -> list[Judged]:
        """The whole and the objects, those that claim something."""
        return [of for of in (self.whole, *self.objects.values()) if of.claimed > 0]

    def is_done(self, doublings: int) -> bool:
        """Whether the paths are enough after so many doublings: all errors are known, and no claim of the first paths
        looks far too small."""
        is_sure = doublings > 0 or not any(of.true_by_claim > SUSPECT for of in self.claims)
        return doublings == DOUBLINGS or (is_sure and all(of.is_known for of in self.claims))

    def cells(self) -> list[str]:
        """The row of the table."""
        objects = ", ".join(of.cell for of in self.objects.values())
        components = [f"{of.energy_cell} ({way})" for of, way in self.components.values()]
        claimed = (
            percent(self.whole.claimed)
            if self.whole.claimed > 0
            else "nothing"
            if self.whole.claimed == 0
            else "unknown"
        )
        return [self.name, f"{self.seconds:.2f}", claimed, str(self.whole.found), objects or "–", *components]


def measured(kind: str, name: str, scene: dg.Scene, capture: dg.Capture, accuracy: dg.Accuracy, paths: float) -> Case:
    """A scene. paths : thousands of plain paths, over all pairs and runs, that are drawn at first."""
    count = math.prod(capture.shape[:2])
    chosen = np.sort(np.random.default_rng(0).choice(count, min(count, PAIRS), replace=False))
    light, seconds = processor_seconds(lambda: dg.simulate(scene, capture, accuracy, 1))
    samples = max(int(1000 * paths / RUNS / len(chosen)), 1)
    truth = PlainPaths.of(scene, capture, accuracy, samples, 7, chosen)
    for doublings in range(DOUBLINGS + 1):
        if doublings:
            # As many again, independent of those before.
            more = PlainPaths.of(scene, capture, accuracy, samples << (doublings - 1), 7 + doublings, chosen)
            truth = replace(truth, runs={of: 0.5 * (runs + more.runs[of]) for of, runs in truth.runs.items()})
        case = Case.of(kind, name, seconds, light, truth, scene.objects)
        if case.is_done(doublings):
            break
    return case


def quantiles(of: Floats, kind: Ints) -> str:
    """Median, 95 % and the largest of some numbers, where each kind weighs the same."""
    order = np.argsort(of)
    until = np.cumsum((1.0 / np.bincount(kind))[kind[order]]) / (kind.max() + 1)
    median, most = (of[order][np.argmax(until > share - 1e-9)] for share in (0.5, 0.95))
    return f"median {median:.2f}, 95 % {most:.2f}, largest {of.max():.2f}"


def numbered(cases: Sequence[Case]) -> Ints:
    """(n,) number of the kind of each case."""
    return np.unique([case.kind for case in cases], return_inverse=True)[1]


def of_claims(what: str, every: Sequence[tuple[Case, Judged]], target: float) -> list[str]:
    """Lines on the claims of wholes or objects: quantiles of true over claimed error, and of both over the target."""
    claims = [(case, of) for case, of in every if of.claimed > 0]
    known = [(case, of) for case, of in claims if of.is_known]
    # Paths met something if their energy has noise.
    dark = [of.noise > 0 for _, of in every if of.claimed == 0]
    silent = sum(math.isnan(of.claimed) for _, of in every)
    lines = [
        f"{len(known)} of {len(claims)} claims of {what} are known, of {len({case.kind for case, _ in known})} kinds"
    ]
    if dark or silent:
        lines.append(
            f"{len(dark)} more {what} where nothing was met, in {sum(dark)} of which paths met light; "
            f"{silent} without a claim"
        )
    if known:
        kind, ratio = numbered([case for case, _ in known]), np.array([of.true_by_claim for _, of in known])
        beyond = f"{(ratio > TRUE_BY_CLAIM).sum()} beyond {TRUE_BY_CLAIM}"
        true = np.array([of.found.error for _, of in known]) / target
        lines += [
            f"{what}, true/claimed: {quantiles(ratio, kind)} ({known[ratio.argmax()][0].name}); {beyond}",
            f"{what}, true/target: {quantiles(true, kind)}",
        ]
    if claims:
        kind, claimed = numbered([case for case, _ in claims]), np.array([of.claimed for _, of in claims]) / target
        lines.append(f"{what}, claimed/target: {quantiles(claimed, kind)}")
    return lines


def of_energies(what: str, every: Sequence[tuple[Case, Judged]], asked: float) -> list[str]:
    """A line on the energies of a component or of objects over those of paths: their mean, weighted by what is known
    of each, with the standard error that their scatter between kinds tells; and the one that is furthest off."""
    some = [(case, of) for case, of in every if of.noise > 0]
    if not some:
        return []
    energy, noise = np.array([(of.energy, of.noise) for _, of in some]).T
    weight = np.maximum(noise, asked) ** -2
    mean = np.average(energy, weights=weight)
    scatter = np.bincount(numbered([case for case, _ in some]), weight * (energy - mean))
    far = np.argmax(np.abs(energy - 1) - 2 * noise)
    return [
        f"energy of {what} over paths: {mean:.4f} ± {l2_norm(scatter) / weight.sum():.4f}, of {len(some)}; "
        f"furthest {some[far][1].energy_cell} ({some[far][0].name})"
    ]


def summary(cases: Sequence[Case], accuracy: dg.Accuracy) -> str:
    """What became of the claims, targets and energies of a set of scenes."""
    assert accuracy.target is not None
    kinds, seconds = len({case.kind for case in cases}), sum(case.seconds for case in cases)
    objects = [(case, of) for case in cases for of in case.objects.values()]
    lines = [
        f"{len(cases)} scenes of {kinds} kinds, {seconds:.1f} processor s",
        *of_claims("wholes", [(case, case.whole) for case in cases], accuracy.target),
        *of_claims("objects", objects, accuracy.each_part),
    ]
    for component in ("primary", "secondary", "higher"):
        own = [(case, case.components[component][0]) for case in cases if component in case.components]
        lines += of_energies(component, own, WHOLES)
    return "\n".join([*lines, *of_energies("objects", objects, OBJECTS)])


def main() -> None:
    """The table of the cases asked for."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("cases", nargs="+", choices=SETS)
    parser.add_argument("--scenes", type=int, default=1, help="scenes of each kind, or rooms")
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--bounces", type=int, default=4)
    parser.add_argument("--target", type=float, default=0.02)
    parser.add_argument(
        "--paths", type=float, default=500.0, help=f"thousands of paths of a scene, doubled up to {DOUBLINGS} times"
    )
    asked = parser.parse_args()
    accuracy = dg.Accuracy(target=asked.target, max_bounces=asked.bounces)
    head = [
        "scene",
        "processor s",
        "claimed",
        "found",
        "objects: found/claimed (energy)",
        "primary",
        "secondary",
        "higher",
    ]
    head = head[: min(asked.bounces, 5) + 3]
    # Lasers that meet objects, and surfaces in one place, are meant.
    warnings.simplefilter("ignore", InputWarning)
    # Kernels are compiled before anything is timed.
    of_room = next(foreign(1, 0))
    measured(*of_room, accuracy, 1.0)
    print(f"{machine()}; target {percent(asked.target)}, up to {asked.bounces} bounces\n")
    print(markdown(head, []))
    for name in asked.cases:
        # Rooms kept aside have numbers that no test uses.
        first, cases = asked.first + 9000 * (name == "kept"), list[Case]()
        try:
            for scene in SETS[name](asked.scenes, first):
                cases.append(measured(*scene, accuracy, asked.paths))
                print(f"| {' | '.join(cases[-1].cells())} |", flush=True)
        except KeyboardInterrupt:
            pass
        if cases:
            print(f"\n{name}: {summary(cases, accuracy)}\n")


if __name__ == "__main__":
    main()
