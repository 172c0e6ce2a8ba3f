"""Scenes simulated to their targets, and compared with the definition of the transient.

    python tests/benchmarks/promise.py OUT configs/*.yaml
    python tests/benchmarks/promise.py OUT --foreign 200

The scenes are those of configurations, each at some random laser points (pixels, where one laser point has many), as
in a build; or, with `--foreign`, scenes that no configuration would draw (`foreign_scenes.py`). The error of the
whole and of each object's own light is measured against independent runs X₁ … X_K of `transport/paths.py`,
which has no surface elements. With dₖ = ours − Xₖ,

    Σ_{j≠k} dⱼ·dₖ / (K (K − 1))    has the mean    ‖ours − true‖²,

whatever the noise of the runs, which is independent in each and therefore multiplies to 0 on average. The standard
error of that mean follows from leaving out one run after the other. Samples are added until it is known of every
error whether it is within the error asked for, up to `MOST_SAMPLES`; cases that are then still *undecided* are
counted apart. Of a configuration's points `HELD` are compared, drawn with probability by their light and weighted
with its inverse, which estimates the error over all of them.
"""

from __future__ import annotations

import math
import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

import click
import numpy as np
from benchmarks.cases import KEPT, continued, promises_kept
from benchmarks.foreign_scenes import foreign_scene
from scipy import stats

from datagen.bench.measuring import machine, markdown, processor_seconds
from datagen.capture import capture_for
from datagen.config import DatasetConfig, load_config
from datagen.design.light import Light, light_of, transport_effects
from datagen.design.scene_for import scene_for
from datagen.detector import detector_for
from datagen.errors import InputError
from datagen.exit_status import exit_with, guarded
from datagen.records import Accuracy, Capture, Transient
from datagen.records.arrays import Floats, Ints
from datagen.transport.error_control.refinement import by_light
from datagen.transport.paths import sample_paths
from datagen.transport.reference import pairs_of, reference
from datagen.transport.visibility.raycast import Raycaster

TARGETS = (0.02, 0.05)
POINTS, HELD = 64, 16
"""Points simulated of a configuration's scene, and points at which errors are measured."""
WHOLE = "whole"
RUNS = 8
"""Independent runs of the truth: 28 products of two, enough for a standard error of their mean."""
FIRST_SAMPLES, GROWTH, MOST_SAMPLES = 1 << 19, 4, 1 << 23
"""Samples of all runs and histograms together: in the first round, their growth from round to round, and in the last
round, which takes some 12 processor seconds."""
WELL_KNOWN = 0.25
"""Largest standard error of a squared error, relative to the square of the error asked for, that decides a case."""
SURE = 3.0
"""Distance from the error asked for, in standard errors, that decides a case, too."""
DARK = 1e-25
"""Photons per emitted photon below which light is dark, and no case: a watt of green light emits 2e23 in a day. Light
as faint comes by the far tails of lobes, which samples do not resolve."""
MOST_LOOKINS = 1 << 21
"""Rays for each laser point after which a foreign scene may be given up, which the run says: lobes a degree wide
would otherwise take minutes."""


@dataclass(frozen=True)
class Case:
    """A scene to be checked.

    light : what is simulated, to any target.
    traits : "whole" or an object → heading → what it has there, such as BRDF → GGX; the table has a line for each.
    held : most points at which errors are measured; None: all.
    """

    light: Light
    traits: Mapping[str, Mapping[str, str]]
    held: int | None = None


@dataclass(frozen=True)
class Check:
    """The check of a whole scene, or of one of its objects, at one target.

    options : of this command, which repeat it.
    what, traits : "whole" or the object, and what it has there, the method of its light too.
    asked, claimed : relative L2 error asked for, and claimed by the run.
    square, known : measured squared relative error, and its standard error.
    photons : of the truth or the run, the larger, per emitted photon.
    energy, energy_known : photons of the run over those of the truth, and the standard error of that ratio.
    samples : of the truth, for each histogram. seconds : processor seconds of the run.
    """

    options: str
    target: float
    what: str
    traits: dict[str, str]
    asked: float
    claimed: float
    square: float
    known: float
    photons: float
    energy: float
    energy_known: float
    samples: int
    seconds: float

    @property
    def dark(self) -> bool:
        """Whether no exposure would count any of the light."""
        return self.photons < DARK

    @property
    def promised(self) -> bool:
        """Whether the run claimed an error within the one asked for."""
        return self.claimed <= self.asked

    @property
    def decided(self) -> bool:
        """Whether it is known that the error is within the one asked for, or that it is not."""
        far = abs(self.square - self.asked**2) > SURE * self.known
        return self.dark or self.known <= WELL_KNOWN * self.asked**2 or far

    @property
    def within(self) -> bool:
        """Whether the measured error is at most the one asked for."""
        return self.square <= self.asked**2

    @property
    def error(self) -> float:
        """The measured relative error; 0 where noise makes its square negative."""
        return math.sqrt(max(self.square, 0.0))

    @property
    def overclaimed(self) -> bool:
        """Whether the error is, for certain, more than twice what the run claimed."""
        return self.square - SURE * self.known > (2 * self.claimed) ** 2


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
    """Independent runs of the definition of a transient, to which more samples can be added.

    light : name → (K, L, P, T) all light and the light of each part. samples : so far, for each histogram.
    """

    def __init__(self, light: Light, seed: int) -> None:
        self.of, self.seed, self.samples = light, seed, 0
        self.caster = Raycaster(light.scene)
        self.light: dict[str, Floats] = {}

    @property
    def pairs(self) -> int:
        """Number of pairs of laser point and pixel."""
        return len(pairs_of(self.of.capture))

    def add(self, samples: int) -> None:
        """Add samples for each pair of laser point and pixel, `samples` over all runs."""
        each, first, accuracy = max(samples // RUNS, 1), self.seed + 1000 * self.samples, self.of.accuracy
        runs = [
            lights(reference(
                self.of.scene, self.of.capture, samples=each, replicates=1, seed=seed, caster=self.caster,
                max_bounces=accuracy.max_bounces, direct=accuracy.direct, occlusion=accuracy.occlusion != "off",
                draw=sample_paths,
            ))
            for seed in range(first, first + RUNS)
        ]  # fmt: skip
        share = each * RUNS / (self.samples + each * RUNS)
        for name in runs[0]:
            drawn = np.array([run[name] for run in runs])
            self.light[name] = drawn if name not in self.light else self.light[name] * (1 - share) + drawn * share
        self.samples += each * RUNS


def lights(run: Transient) -> dict[str, Floats]:
    """Name → (L, P, T) all light, and the light of each part."""
    return {WHOLE: run.total, **run.parts}


def checks_of(case: Case, targets: Sequence[float], options: str = "") -> list[Check]:
    """The checks of a scene, simulated to each target and compared with one truth: of the whole and each object."""
    light, runs = case.light, []
    for target in targets:
        asked = replace(light, accuracy=replace(light.accuracy, target=target))
        runs.append((asked.accuracy, *processor_seconds(partial(_simulated, asked))))
    points, weight = _compared_points(light.capture, runs[0][1], case.held)
    truth = Truth(replace(light, capture=some_points(light.capture, points)), light.seed % 2**32)
    samples = FIRST_SAMPLES
    while True:
        truth.add(max(samples // truth.pairs, RUNS))
        found = [one for run in runs for one in _compared(options, case, points, weight, truth, *run)]
        samples *= GROWTH
        if samples > MOST_SAMPLES or all(one.decided or not one.promised or _hopeless(one, truth) for one in found):
            return found


def _simulated(light: Light) -> Transient:
    return light.transient()


def _hopeless(one: Check, truth: Truth) -> bool:
    """Whether not even the last round would decide a case: the noise of products falls with the number of samples."""
    growth = 2 * MOST_SAMPLES / (one.samples * truth.pairs)
    return one.known > growth * WELL_KNOWN * one.asked**2


def _claims(run: Transient) -> dict[str, float]:
    return {WHOLE: run.error_bound or 0.0} | {name: error for name, error in run.part_errors.items() if error > 0}


def _point_axis(capture: Capture) -> int:
    """Axis of a transient along which the points of a capture lie: laser points if confocal, else pixels."""
    return 0 if capture.pairing == "confocal" else 1


def _compared_points(capture: Capture, run: Transient, most: int | None) -> tuple[Ints, Floats]:
    """Numbers of the points at which errors are measured, and how many points each of them stands for."""
    axis, found = _point_axis(capture), lights(run)
    norms = np.stack([np.sqrt((found[name] ** 2).sum(axis=(1 - axis, 2))) for name in _claims(run)], axis=1)
    return by_light(norms, len(norms) if most is None else most)


def _compared(
    options: str, case: Case, points: Ints, weight: Floats, truth: Truth, accuracy: Accuracy, run: Transient,
    seconds: float,
) -> list[Check]:  # fmt: skip
    light, found, axis = lights(run), [], _point_axis(case.light.capture)
    weight = weight[:, None, None] if axis == 0 else weight[:, None]
    assert run.spend is not None and accuracy.target is not None
    for name, claim in _claims(run).items():
        ours, runs = light[name].take(points, axis=axis), truth.light[name]
        energies, own = (runs * weight).sum(axis=(1, 2, 3)), float((ours * weight).sum())
        flat, each = (ours * np.sqrt(weight)).ravel(), (runs * np.sqrt(weight)).reshape(len(runs), -1)
        norm, _ = off_square(np.zeros_like(flat), each)
        norm = max(norm, 1e-3 * float((each.mean(axis=0) ** 2).sum())) or 1.0
        square, known = (of / norm for of in off_square(flat, each))
        energy = own / energies.mean() if energies.mean() > 0 else float(own > 0)
        energy_known = stats.sem(energies) / energies.mean() if energies.mean() > 0 else 0.0
        ways = {component: way for component, way in run.spend.way.items() if name == WHOLE or component == "primary"}
        traits = {**case.traits.get(name, {}), "way": ", ".join(f"{c} {w}" for c, w in sorted(ways.items()))}
        found.append(Check(
            options, accuracy.target, name, traits, accuracy.target if name == WHOLE else accuracy.each_part,
            claim, square, known, max(own, float(energies.mean())), float(energy), float(energy_known),
            truth.samples, seconds,
        ))  # fmt: skip
    return found


def some_points(capture: Capture, points: Ints) -> Capture:
    """A capture with some of its pixels, and in confocal scans with their laser points."""
    lasers = points if capture.pairing == "confocal" else np.arange(len(capture.laser.targets))
    return capture.excerpt(lasers, points)


def case_of(config: DatasetConfig, index: int, points: int = POINTS) -> Case:
    """Scene `index` of a configuration, at some laser points or pixels, as a build would simulate it."""
    scene = scene_for(config, index)
    whole = capture_for(config, scene, config.seed, index)
    effects = transport_effects(config, scene, whole, index)
    light = light_of(
        config, index, scene, whole, effects, *detector_for(config.detector, config.seed, index, whole.time)
    )
    count = len(whole.sensor.pixels)
    rng = np.random.default_rng([config.seed, index])
    capture = some_points(whole, np.sort(rng.permutation(count)[:points]))
    return Case(replace(light, capture=capture), {WHOLE: {"configuration": config.name}}, HELD)


def foreign_case(index: int, meshes: Path | None = None) -> Case:
    """Foreign scene `index`."""
    foreign = foreign_scene(index, meshes)
    accuracy = Accuracy(max_bounces=foreign.max_bounces, max_lookins=MOST_LOOKINS)
    traits = {name: {"brdf": foreign.brdfs[name], "shape": shape} for name, shape in foreign.shapes.items()}
    traits[WHOLE] = {"scan": foreign.scan, "surroundings": foreign.surroundings}
    return Case(Light(foreign.scene, foreign.capture, accuracy, index), traits)


def table(found: Sequence[Check]) -> str:
    """Markdown: a line for wholes and objects at each target, then for each of their traits."""
    head = ["of", "target", "cases", "dark", "undecided", "not promised", *KEPT, "beyond twice its claim"]
    rows = []
    for kind, cases in (("whole", [one for one in found if one.what == WHOLE]),
                        ("objects", [one for one in found if one.what != WHOLE])):  # fmt: skip
        headings = dict.fromkeys(name for one in cases for name in one.traits if kind == "whole" or name != "way")
        for heading in (None, *headings):
            for trait, target in sorted({(one.traits.get(heading or "", ""), one.target) for one in cases}):
                some = [one for one in cases if (one.traits.get(heading or "", ""), one.target) == (trait, target)]
                rows.append([f"{kind}, {trait}" if heading else kind, f"{target:g}", *_row(some)])
    return markdown(head, rows, words=1)


def _row(cases: Sequence[Check]) -> list[str]:
    lit = [one for one in cases if not one.dark]
    promised = [one for one in lit if one.promised]
    known = [one for one in promised if one.decided]
    counts = [len(cases), len(cases) - len(lit), len(promised) - len(known), len(lit) - len(promised)]
    overclaimed = str(sum(one.overclaimed for one in promised))
    if not known:
        return [*map(str, counts), *[""] * len(KEPT), overclaimed]
    kept = promises_kept([one.error / one.asked for one in known], [one.within for one in known])
    return [*map(str, counts), *kept, overclaimed]


def line_of(one: Check) -> str:
    """A check in one line, with the options that repeat it."""
    return (
        f"{one.options} --target {one.target:g}: {one.what} ({', '.join(one.traits.values())}): true {one.error:.4f} "
        f"(square {one.square:.1e} ± {one.known:.0e}), asked {one.asked:g}, claimed {one.claimed:.4f}; energy "
        f"{one.energy:.4f} ± {one.energy_known:.4f}"
    )


@click.command()
@click.argument("out")
@click.argument("configs", nargs=-1)
@click.option("--scenes", type=int, default=8, show_default=True, help="How many scenes of each configuration.")
@click.option("--first", type=int, default=0, show_default=True, help="Number of the first.")
@click.option("--points", type=int, default=POINTS, show_default=True, help="Laser points or pixels of each.")
@click.option("--target", "targets", type=float, multiple=True, default=TARGETS, show_default=True)
@click.option("--foreign", type=int, help="Instead: how many scenes that no configuration would draw.")
@click.option("--meshes", type=click.Path(path_type=Path), help="Folder of meshes that foreign scenes may have, too.")
def main(
    out: str, configs: tuple[str, ...], scenes: int, first: int, points: int, targets: tuple[float, ...],
    foreign: int | None, meshes: Path | None,
) -> None:  # fmt: skip
    """Compare scenes of CONFIGS, and each of their objects, with the truth; table and JSON in the folder OUT.

    Running it again goes on with the scenes that OUT does not have yet. Configurations without a target, whose counts
    are fixed, promise nothing and are passed over.

    With --foreign N no CONFIGS are wanted: N scenes of random shapes (and meshes), BRDFs, devices and scans are
    compared in the same way.
    """
    if scenes < 1 or points < 1 or first < 0:
        raise InputError(f"--scenes {scenes} --points {points} --first {first}: must be ≥ 1, and first ≥ 0")
    if foreign is not None and (foreign < 1 or configs):
        raise InputError(f"--foreign {foreign}: must be ≥ 1, and stand without configurations")
    if foreign is None and (meshes is not None or not configs):
        raise InputError("promise: name configurations, or --foreign N, if wanted with --meshes FOLDER")
    name = "promise" if foreign is None else "foreign"
    of_meshes = f" --meshes …/{meshes.name}" if meshes else ""
    ready = {path: config for path in configs if (config := load_config(path)).transport.target is not None}
    # Each case by the options with which this command repeats it.
    cases: Mapping[str, Callable[[], Case]] = {
        f"--foreign 1 --first {index}{of_meshes}": partial(foreign_case, index, meshes)
        for index in range(first, first + (foreign or 0))
    } | {
        f"{path} --scenes 1 --first {index} --points {points}": partial(case_of, config, index, points)
        for index in range(first, first + scenes)
        for path, config in ready.items()
    }
    found = continued(
        Path(out) / f"{name}_checks.json",
        Check,
        lambda one: (one.options, one.target),
        lambda missing: checks_of(cases[missing[0][0]](), [target for _, target in missing], missing[0][0]),
        [[(options, target) for target in targets] for options in cases],
    )
    if not found:
        raise InputError("promise: none of the configurations has a target; name others")
    count = len({one.options for one in found})
    of = "foreign scenes"
    if foreign is None:
        of = f"scenes of {len({one.traits['configuration'] for one in found if one.what == WHOLE})} configurations"
    seconds = sum({(one.options, one.target): one.seconds for one in found}.values())
    text = f"{count} {of}, simulated in {seconds:.0f} processor seconds; {machine()}\n\n{table(found)}\n"
    (Path(out) / f"{name}.md").write_text(text, encoding="utf-8")
    click.echo(text)
    for one in sorted(found, key=lambda one: one.error / one.asked, reverse=True):
        if not one.dark and ((one.promised and one.decided and not one.within) or one.overclaimed):
            click.echo(line_of(one))


if __name__ == "__main__":
    exit_with(lambda: guarded(main))
