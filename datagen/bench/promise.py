"""`datagen bench promise`: scenes of configurations, simulated to their targets and compared with the truth.

For each scene some laser points of its scan (pixels, where one laser point has many) are taken at random and
simulated to a target, as in a build. The error of the whole and of every object's own light is measured at `HELD` of
them, drawn with probability by their light and weighted with its inverse, which estimates the error over all of them.

*Truth*: the same light to 1/`FINER` of the target with another seed, which draws all surface elements and samples
anew. *Independent truth*: path tracing, which has no surface elements. For two runs of it, A and B, with independent
noise, Σ (truth − A)(truth − B) has the mean ‖truth − true‖², so that even noisy runs measure small errors of the
truth.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import click
import numpy as np

from datagen.bench.foreign_promise import report_foreign
from datagen.bench.measuring import KEPT, continued, machine, markdown, processor_seconds, promises_kept
from datagen.capture import capture_for
from datagen.config import DatasetConfig, load_config
from datagen.design.light import Light, light_of, transport_effects
from datagen.design.scene_for import scene_for
from datagen.detector import detector_for
from datagen.errors import InputError
from datagen.records import Accuracy, Capture, Transient
from datagen.records.arrays import Floats, Ints
from datagen.transport.error_control.refinement import by_light

TARGETS = (0.02, 0.05)
POINTS, HELD, FINER = 64, 16, 3
"""Points simulated, points at which errors are measured, and how many times more accurate the truth is. With half of
`HELD` the measured errors scatter 1.4 times as much; with half of `FINER` the truth is nearly as wrong as the run."""
WALKED, WALKED_FOV = 1 << 13, 4
"""Hidden vertices of each of two runs by path tracing, and their FoV points. With half, the truth's error is known
half as well."""
WHOLE = "whole"


@dataclass(frozen=True)
class Check:
    """The check of a whole scene, or of one of its objects.

    Attributes
    ----------
    error, claimed, asked : relative L2 error as measured, as claimed by the run, and as asked for.
    truth_claimed : error that the truth claims for itself.
    truth_off, known : squared relative error of the truth as measured by path tracing, and its standard error.
    seconds : processor seconds of the run.
    """

    config: str
    scene: int
    target: float
    what: str
    error: float
    claimed: float
    asked: float
    truth_claimed: float
    truth_off: float
    known: float
    seconds: float

    @property
    def promised(self) -> bool:
        """Whether the run claimed an error within the one asked for."""
        return self.claimed <= self.asked

    @property
    def disputed(self) -> bool:
        """Whether, by path tracing, the truth is off by more than a third of the error asked for, at four σ."""
        return self.truth_off - 4 * self.known > (self.asked / 3) ** 2

    @property
    def within(self) -> bool:
        """Whether the measured error is at most the one asked for."""
        return self.error <= self.asked


def checks_of(config: DatasetConfig, index: int, target: float, points: int = POINTS) -> list[Check]:
    """The checks of scene `index` of a configuration: of the whole and of each object."""
    light = _light(config, index, points)
    run, seconds = processor_seconds(replace(light, accuracy=replace(light.accuracy, target=target)).transient)
    claimed = {WHOLE: run.error_bound or 0.0} | {name: error for name, error in run.part_errors.items() if error > 0}
    ours = _parts(run, claimed)
    places, weight = by_light(np.stack([np.linalg.norm(ours[name], axis=1) for name in claimed], axis=1), HELD)
    some = replace(light, capture=some_points(light.capture, places), seed=light.seed + 1)
    finer = replace(light.accuracy, target=target / FINER, faint_part=0.0)
    truth = replace(some, accuracy=finer).transient()
    true = _parts(truth, claimed)
    counts = Accuracy(
        lookins=WALKED, fov_samples=WALKED_FOV, max_bounces=light.accuracy.max_bounces, direct=light.accuracy.direct,
        occlusion=light.accuracy.occlusion,
    )  # fmt: skip
    walks = [replace(some, accuracy=counts, seed=light.seed + 2 + k).transient() for k in range(2)]
    one, other = (_parts(walk, claimed) for walk in walks)
    found = []
    for name, error in claimed.items():
        square = float(weight @ (true[name] ** 2).sum(axis=1)) or 1.0
        off = weight @ ((ours[name][places] - true[name]) ** 2).sum(axis=1) / square
        cross = (true[name] - one[name]) * (true[name] - other[name])
        each = weight * cross.sum(axis=1) / square
        noise = (true[name] - one[name]) ** 2 * (true[name] - other[name]) ** 2
        known = math.sqrt(float((weight**2 * noise.sum(axis=1)).sum())) / square
        asked = target if name == WHOLE else replace(light.accuracy, target=target).each_part
        itself = (truth.error_bound if name == WHOLE else truth.part_errors.get(name)) or 0.0
        errors = math.sqrt(off), error, asked, itself, float(each.sum()), known
        found.append(Check(config.name, index, target, name, *errors, seconds))
    return found


def _light(config: DatasetConfig, index: int, points: int) -> Light:
    """The light that a build would simulate, at some laser points or pixels."""
    scene = scene_for(config, index)
    whole = capture_for(config, scene, config.seed, index)
    effects = transport_effects(config, scene, whole, index)
    light = light_of(
        config, index, scene, whole, effects, *detector_for(config.detector, config.seed, index, whole.time)
    )
    count = len(whole.sensor.pixels)
    rng = np.random.default_rng([config.seed, index])
    return replace(light, capture=some_points(whole, np.sort(rng.permutation(count)[:points])))


def some_points(capture: Capture, points: Ints) -> Capture:
    """A capture with some of its pixels, and in confocal scans with their laser points."""
    laser = capture.laser
    if capture.pairing == "confocal":
        laser = laser.take(points)
    return replace(capture, laser=laser, sensor=capture.sensor.take(points))


def _parts(run: Transient, names: Mapping[str, float]) -> dict[str, Floats]:
    """(n, T) histograms of the whole and of objects."""
    found = {name: run.total if name == WHOLE else run.parts[name] for name in names}
    return {name: values.reshape(-1, values.shape[-1]) for name, values in found.items()}


def table(found: Sequence[Check]) -> str:
    """Markdown, a line for each target and kind."""
    head = ["target", "of", "cases", "not promised", *KEPT, "claimed / true: median", "truth by walks: median",
            "beyond 4 σ"]  # fmt: skip
    rows = []
    for target in sorted({one.target for one in found}):
        for kind in (WHOLE, "each object"):
            every = [one for one in found if one.target == target and (one.what == WHOLE) == (kind == WHOLE)]
            some = [one for one in every if one.promised]
            if not some:
                continue
            kept = promises_kept([one.error / one.asked for one in some], [one.within for one in some])
            claimed = np.median([one.claimed / max(one.error, 1e-9) for one in some])
            off = math.sqrt(max(float(np.median([one.truth_off for one in some])), 0.0))
            counts = str(len(some)), str(len(every) - len(some))
            beyond = str(sum(one.disputed for one in some))
            rows.append([f"{target:g}", kind, *counts, *kept, f"{claimed:.2f}", f"{off:.2%}", beyond])
    return markdown(head, rows, words=2)


def _line(one: Check) -> str:
    """One check in a line."""
    return (
        f"{one.config} scene {one.scene}, target {one.target:g}, {one.what}: true {one.error:.4f}, claimed "
        f"{one.claimed:.4f}; the truth claims {one.truth_claimed:.4f} of itself, walks {one.truth_off:.1e} ± "
        f"{one.known:.1e} of its square"
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
    compared with the definition of the transient.
    """
    if scenes < 1 or points < 1 or first < 0:
        raise InputError(f"--scenes {scenes} --points {points} --first {first}: must be ≥ 1, and first ≥ 0")
    if foreign is not None:
        if foreign < 1 or configs:
            raise InputError(f"--foreign {foreign}: must be ≥ 1, and stand without configurations")
        return report_foreign(Path(out), range(first, first + foreign), targets, meshes)
    if meshes is not None or not configs:
        raise InputError("datagen bench promise: name configurations, or --foreign N, if wanted with --meshes FOLDER")
    ready = {one.name: one for one in map(load_config, configs) if one.transport.target is not None}

    def measure(missing: list[tuple[str, int, float]]) -> list[Check]:
        return [one for name, index, target in missing for one in checks_of(ready[name], index, target, points)]

    jobs = [[(name, index, target)] for index in range(first, first + scenes) for target in targets for name in ready]
    file = Path(out) / "promise.json"
    found = continued(file, Check, lambda one: (one.config, one.scene, one.target), measure, jobs)
    if not found:
        raise InputError("datagen bench promise: none of the configurations has a target; name others")
    cases = {(one.config, one.scene) for one in found}
    text = (
        f"{len(cases)} scenes of {len({name for name, _ in cases})} configurations; {machine()}\n\n{table(found)}\n"
    )
    (Path(out) / "promise.md").write_text(text, encoding="utf-8")
    click.echo(text)
    for one in found:
        if one.disputed or (one.promised and not one.within):
            click.echo(_line(one))
