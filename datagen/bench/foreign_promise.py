"""`datagen bench promise OUT --foreign N`: scenes that no configuration would draw, compared with the definition.

Each scene (`foreign_scenes.py`) is simulated to a target; the error of the whole and of each object's own light is
then measured against independent runs X₁ … X_K of `transport/sampled_paths.py`, which has no surface elements. With
dₖ = ours − Xₖ,

    Σ_{j≠k} dⱼ·dₖ / (K (K − 1))    has the mean    ‖ours − true‖²,

whatever the noise of the runs, which is independent in each and therefore multiplies to 0 on average. The standard
error of that mean follows from leaving out one run after the other. Samples are added until it is known of every
error whether it is within the error asked for, up to `MOST_SAMPLES`; cases that are then still *undecided* are
counted apart.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import click
import numpy as np
from scipy import stats

from datagen.bench.foreign_scenes import ForeignScene, foreign_scene
from datagen.bench.measuring import KEPT, continued, machine, markdown, processor_seconds, promises_kept
from datagen.records import Accuracy, Transient
from datagen.records.arrays import Floats
from datagen.transport.reference import pairs_of, reference
from datagen.transport.sampled_paths import sample_paths
from datagen.transport.simulate import simulate
from datagen.transport.visibility.raycast import Raycaster

WHOLE = "whole"
RUNS = 8
"""Independent runs of the truth. Half as many give 6 products instead of 28, too few for their standard error."""
FIRST_SAMPLES, GROWTH, MOST_SAMPLES = 1 << 19, 4, 1 << 23
"""Samples of all runs and histograms together: in the first round, their growth from round to round, and in the last
round, which takes some 12 processor seconds. With a quarter of those, errors four times as large stay undecided."""
WELL_KNOWN = 0.25
"""Largest standard error of a squared error, relative to the square of the error asked for, that decides a case.
Halved, more cases stay undecided."""
SURE = 3.0
"""Distance from the error asked for, in standard errors, that decides a case, too. Halved, chance would decide one in
eight of the cases whose error is just the one asked for."""
MOST_LOOKINS = 1 << 21
"""Rays for each laser point after which a simulation may give up, and says so: lobes a degree wide would otherwise
take minutes."""


@dataclass(frozen=True)
class ForeignCheck:
    """The check of a whole scene, or of one of its objects, at one target.

    Attributes
    ----------
    what, shape, brdf, way : "whole" or the object; shape and BRDF of an object; method of its light.
    asked, claimed : relative L2 error asked for, and claimed by the run.
    square, known : measured squared relative error, and its standard error.
    energy, energy_known : photons of the run over those of the truth, and the standard error of that ratio.
    samples : of the truth, for each histogram. seconds : processor seconds of the run.
    """

    scene: int
    meshes: str
    target: float
    what: str
    shape: str
    brdf: str
    way: str
    scan: str
    surroundings: str
    bounces: int
    asked: float
    claimed: float
    square: float
    known: float
    energy: float
    energy_known: float
    samples: int
    seconds: float

    @property
    def promised(self) -> bool:
        """Whether the run claimed an error within the one asked for."""
        return self.claimed <= self.asked

    @property
    def decided(self) -> bool:
        """Whether it is known that the error is within the one asked for, or that it is not."""
        return decided(self.square, self.known, self.asked)

    @property
    def within(self) -> bool:
        """Whether the true error is at most the one asked for."""
        return self.square <= self.asked**2

    @property
    def error(self) -> float:
        """The measured relative error; 0 where noise makes its square negative."""
        return math.sqrt(max(self.square, 0.0))

    @property
    def overclaimed(self) -> bool:
        """Whether the error is, for certain, more than twice what the run claimed."""
        return self.square - SURE * self.known > (2 * self.claimed) ** 2


def decided(square: float, known: float, asked: float) -> bool:
    """Whether a squared error with the standard error `known` is known to be within the error asked for, or beyond
    it."""
    return known <= WELL_KNOWN * asked**2 or abs(square - asked**2) > SURE * known


def off_square(ours: Floats, runs: Floats) -> tuple[float, float]:
    """‖ours − true‖² without the noise of the independent runs (K, n), and its standard error.

    The jackknife over runs counts the variance of products of noise with noise twice; the scatter of the products is
    just that variance. With few runs the larger of the two estimates is a fifth too large.
    """
    d = ours - runs
    gram, count = d @ d.T, len(runs)
    pairs = count * (count - 1) / 2
    products = gram[np.triu_indices(count, 1)]
    # The mean without the products of run k.
    without = (products.sum() - gram.sum(axis=1) + np.diag(gram)) / (pairs - count + 1)
    jackknife = (count - 1) / count * float(((without - without.mean()) ** 2).sum())
    scatter = float(products.var(ddof=1)) / pairs
    return float(products.mean()), math.sqrt(max(jackknife - scatter, scatter))


class Truth:
    """Independent runs of the reference for one scene, to which more samples can be added."""

    def __init__(self, foreign: ForeignScene, seed: int) -> None:
        self.foreign, self.seed, self.samples = foreign, seed, 0
        self.caster = Raycaster(foreign.scene)
        self.light: dict[str, Floats] = {}

    @property
    def pairs(self) -> int:
        """Number of histograms."""
        return len(pairs_of(self.foreign.capture))

    def add(self, samples: int) -> None:
        """Add samples for each pair of laser point and pixel, `samples` over all runs."""
        each, first = max(samples // RUNS, 1), self.seed + 1000 * self.samples
        runs = [
            lights(reference(
                self.foreign.scene, self.foreign.capture, samples=each, replicates=1, seed=seed,
                max_bounces=self.foreign.max_bounces, caster=self.caster, draw=sample_paths,
            ))
            for seed in range(first, first + RUNS)
        ]  # fmt: skip
        share = each * RUNS / (self.samples + each * RUNS)
        for name in runs[0]:
            drawn = np.array([run[name] for run in runs])
            self.light[name] = drawn if name not in self.light else self.light[name] * (1 - share) + drawn * share
        self.samples += each * RUNS


def lights(run: Transient) -> dict[str, Floats]:
    """Flat histograms of the whole and of the primary of each part."""
    return {WHOLE: run.total.ravel()} | {name: light.ravel() for name, light in run.parts.items()}


def checks_of_foreign(index: int, targets: Sequence[float], meshes: Path | None = None) -> list[ForeignCheck]:
    """Foreign scene `index`, simulated to each target and compared with one truth."""
    foreign = foreign_scene(index, meshes)
    runs = []
    for target in targets:
        accuracy = Accuracy(target=target, max_bounces=foreign.max_bounces, max_lookins=MOST_LOOKINS)
        runs.append(processor_seconds(lambda asked=accuracy: _simulated(foreign, asked, index)))  # type: ignore[misc]
    truth = Truth(foreign, seed=index)
    samples = FIRST_SAMPLES
    while True:
        truth.add(max(samples // truth.pairs, RUNS))
        found = [
            one
            for target, (run, seconds) in zip(targets, runs, strict=True)
            for one in _compared(index, meshes, foreign, truth, target, run, seconds)
        ]
        samples *= GROWTH
        if samples > MOST_SAMPLES or all(one.decided or not one.promised or _hopeless(one, truth) for one in found):
            return found


def _hopeless(one: ForeignCheck, truth: Truth) -> bool:
    """Whether not even the last round would decide a case: the noise of products falls with the number of samples."""
    growth = 2 * MOST_SAMPLES / (one.samples * truth.pairs)
    return one.known > growth * WELL_KNOWN * one.asked**2


def _simulated(foreign: ForeignScene, accuracy: Accuracy, seed: int) -> Transient:
    return simulate(foreign.scene, foreign.capture, accuracy, seed=seed)


def _compared(
    index: int, meshes: Path | None, foreign: ForeignScene, truth: Truth, target: float, run: Transient,
    seconds: float,
) -> list[ForeignCheck]:  # fmt: skip
    claimed = {WHOLE: run.error_bound or 0.0} | {name: error for name, error in run.part_errors.items() if error > 0}
    each_part = Accuracy(target=target).each_part
    light, found = lights(run), []
    assert run.spend is not None
    for name, claim in claimed.items():
        ours, runs = light[name], truth.light[name]
        norm, _ = off_square(np.zeros_like(ours), runs)
        norm = max(norm, 1e-3 * float((runs.mean(axis=0) ** 2).sum())) or 1.0
        square, known = (of / norm for of in off_square(ours, runs))
        energies = runs.sum(axis=1)
        energy = ours.sum() / energies.mean() if energies.mean() > 0 else float(ours.any())
        energy_known = stats.sem(energies) / energies.mean() if energies.mean() > 0 else 0.0
        ways = {component: way for component, way in run.spend.way.items() if name == WHOLE or component == "primary"}
        case = ForeignCheck(
            index, "" if meshes is None else meshes.name, target, name, foreign.shapes.get(name, ""),
            foreign.brdfs.get(name, ""), ", ".join(f"{c} {w}" for c, w in sorted(ways.items())), foreign.scan,
            foreign.surroundings, foreign.max_bounces, target if name == WHOLE else each_part, claim, square, known,
            float(energy), float(energy_known), truth.samples, seconds,
        )  # fmt: skip
        found.append(case)
    return found


def table(found: Sequence[ForeignCheck]) -> str:
    """Markdown: a line for wholes and objects at each target, then by way, BRDF, shape and scan."""
    head = ["of", "target", "cases", "undecided", "not promised", *KEPT, "beyond twice its claim"]
    wholes, objects = ([one for one in found if (one.what == WHOLE) == whole] for whole in (True, False))
    groups: list[tuple[Sequence[ForeignCheck], str, Callable[[ForeignCheck], str]]] = [
        (wholes, "whole", lambda one: ""), (objects, "objects", lambda one: ""),
        (wholes, "whole, ", lambda one: one.way), (wholes, "whole, ", lambda one: one.scan),
        (wholes, "whole, ", lambda one: one.surroundings), (objects, "objects, ", lambda one: one.brdf),
        (objects, "objects, ", lambda one: one.shape),
    ]  # fmt: skip
    rows = []
    for cases, kind, name in groups:
        for group in sorted({(name(one), one.target) for one in cases}):
            some = [one for one in cases if (name(one), one.target) == group]
            rows.append([f"{kind}{group[0]}", f"{group[1]:g}", *_row(some)])
    return markdown(head, rows, words=1)


def _row(cases: Sequence[ForeignCheck]) -> list[str]:
    promised = [one for one in cases if one.promised]
    known = [one for one in promised if one.decided]
    counts = [str(len(cases)), str(len(promised) - len(known)), str(len(cases) - len(promised))]
    overclaimed = str(sum(one.overclaimed for one in promised))
    if not known:
        return [*counts, *[""] * len(KEPT), overclaimed]
    kept = promises_kept([one.error / one.asked for one in known], [one.within for one in known])
    return [*counts, *kept, overclaimed]


def line_of(one: ForeignCheck) -> str:
    """A case in one line, with the options that repeat it."""
    what = one.what if one.what == WHOLE else f"{one.what} ({one.shape}, {one.brdf})"
    meshes = f" --meshes …/{one.meshes}" if one.meshes else ""
    return (
        f"--foreign 1 --first {one.scene} --target {one.target:g}{meshes}: {what}, {one.scan}, {one.surroundings}, "
        f"{one.bounces} bounces, {one.way}: true {one.error:.4f} (square {one.square:.1e} ± {one.known:.0e}), asked "
        f"{one.asked:g}, claimed {one.claimed:.4f}; energy {one.energy:.4f} ± {one.energy_known:.4f}"
    )


def report_foreign(folder: Path, scenes: range, targets: Sequence[float], meshes: Path | None) -> None:
    """Compare some foreign scenes with the truth; table and cases go to a folder, whose cases so far are kept."""
    of = "" if meshes is None else meshes.name
    found = continued(
        folder / "foreign.json",
        ForeignCheck,
        lambda one: (one.scene, one.meshes, one.target),
        lambda missing: checks_of_foreign(missing[0][0], [target for *_, target in missing], meshes),
        [[(index, of, target) for target in targets] for index in scenes],
    )
    count = len({(one.scene, one.meshes) for one in found})
    seconds = sum({(one.scene, one.meshes, one.target): one.seconds for one in found}.values())
    text = f"{count} foreign scenes, simulated in {seconds:.0f} processor seconds; {machine()}\n\n{table(found)}\n"
    (folder / "foreign.md").write_text(text, encoding="utf-8")
    click.echo(text)
    for one in sorted(found, key=lambda one: one.error / one.asked, reverse=True):
        missed = one.promised and one.decided and not one.within
        if missed or one.overclaimed:
            click.echo(line_of(one))
