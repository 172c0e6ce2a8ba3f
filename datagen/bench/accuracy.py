"""What accuracy costs in time: `datagen bench accuracy CONFIG OUT`.

For one scene of a configuration, the true relative L2 error of its transient against processor seconds, one quantity
swept at a time: lookins, observed points, FoV points, bounce orders, k strongest secondary paths, estimator, bin
width, target. The truth is a long run with other seeds, in two halves, whose difference is its own error; that is
subtracted, and printed. It holds all paths of as many bounces as the configuration asks for (four at least, so that
there is a secondary); for the sweep of bounce orders it holds all orders, so that what leaving out costs is seen as
the bias it is. Writes accuracy.md, accuracy.png and accuracy.json to the folder OUT.
"""

from __future__ import annotations

import math
import shutil
import tempfile
from contextlib import suppress
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import click
import numpy as np

from datagen.bench.accuracy_measure import (
    FEWEST_LOOKINS,
    SHARE_OF_REFERENCE,
    SLOWEST_SHARE,
    Problem,
    Reference,
    Row,
    base_lookins,
    converge,
    fewer_laser_points,
    measure,
    with_front,
)
from datagen.bench.accuracy_report import advice, percent, picture, table
from datagen.bench.accuracy_settings import Setting, settings_of
from datagen.capture import capture_for
from datagen.config import DatasetConfig, load_config
from datagen.errors import InputError
from datagen.exit_status import guarded
from datagen.records import Accuracy
from datagen.scene import generate_scene
from datagen.store.environment import commit, cores, environment, hardware, processor
from datagen.store.files import check_writable, json_bytes

RUNS_IN_BUDGET = 250
"""So many runs of the base setting should fit into the budget; its lookins are halved until they do."""


@dataclass(frozen=True)
class Outcome:
    """Everything measured. base : what the sweeps start from. left_out : settings not run, and why."""

    name: str
    scene: int
    laser_points: int
    of_laser_points: int
    base: Accuracy
    reference: Reference
    rows: list[Row]
    left_out: list[str]


def run(
    config: DatasetConfig, scene: int = 0, laser_points: int | None = None, seconds: float = 240.0, repeats: int = 3
) -> Outcome:
    """Measure every sweep for one scene, within about `seconds` processor seconds.

    Raises
    ------
    InputError : the scene cannot be made, or sends no light into the window.
    """
    room = generate_scene(config.scene, config.seed, scene)
    whole = capture_for(config, room, config.seed, scene)
    problem = Problem(room, fewer_laser_points(whole, laser_points))
    configured = config.transport.accuracy()
    orders = None if configured.max_bounces is None else max(configured.max_bounces, 4)
    wanted = Accuracy(
        lookins=1 << round(math.log2(max(configured.lookins, FEWEST_LOOKINS))), fov_samples=configured.fov_samples,
        max_bounces=orders, replicates=4, direct=configured.direct,
    )  # fmt: skip
    base = base_lookins(wanted, problem, seconds / RUNS_IN_BUDGET)
    reference = converge(problem, base, SHARE_OF_REFERENCE * seconds)
    rows, left_out, spent = list[Row](), list[str](), 0.0
    for sweep in settings_of(base):
        _load_kernels(sweep[0], problem)
        for k, setting in enumerate(sweep):
            if spent > seconds:
                left_out.append(f"{setting.quantity} {setting.value}: the budget was spent")
                continue
            try:
                row = measure(setting, problem, reference, repeats, SLOWEST_SHARE * seconds)
            except InputError as error:
                left_out.append(f"{setting.quantity} {setting.value}: {error}")
                continue
            rows.append(row)
            spent += row.seconds * row.repeats
            if row.seconds > SLOWEST_SHARE * seconds:
                left_out += [f"{later.quantity} {later.value}: too slow" for later in sweep[k + 1 :]]
                break
    return Outcome(
        config.name, scene, len(problem.capture.laser.targets), len(whole.laser.targets), base, reference,
        with_front(rows), left_out,
    )  # fmt: skip


def _load_kernels(setting: Setting, problem: Problem) -> None:
    """Run once, so that no compilation is timed; that it cannot be run is found again where it is told."""
    with suppress(InputError):
        setting.run(problem.scene, problem.widened(*setting.widening), 0)


def report(outcome: Outcome) -> str:
    """Markdown: what was measured, the table, what to choose."""
    reference, base = outcome.reference, outcome.base
    orders = "all bounces" if base.max_bounces is None else f"up to {base.max_bounces} bounces"
    own, every = (percent(reference.truths[complete, (1, 1)].relative_error) for complete in (False, True))
    points = (
        f"{outcome.laser_points} laser points"
        if outcome.laser_points == outcome.of_laser_points
        else f"{outcome.laser_points} of its {outcome.of_laser_points} laser points"
    )
    lines = [
        f"### {outcome.name}, scene {outcome.scene}, {points}",
        "",
        f"Base: {base.lookins} lookins, {base.fov_samples} FoV points, {orders}, by the walk. Truth: "
        f"{reference.lookins[False]} lookins with other seeds, its own error of {own} subtracted; for bounce orders "
        f"all of them, {reference.lookins[True]} lookins, {every}. Medians of processor seconds, {processor()}, "
        f"{cores()} cores.",
        "",
        table(outcome.rows),
        "",
        *(f"Not run: {'; '.join(outcome.left_out)}.\n" for _ in outcome.left_out[:1]),
        *advice(outcome.rows),
    ]
    return "\n".join(lines) + "\n"


def numbers(config: DatasetConfig, outcome: Outcome) -> dict[str, Any]:
    """The same for machines."""
    reference = outcome.reference
    return {
        "name": outcome.name,
        "fingerprint": config.fingerprint(),
        "scene": outcome.scene,
        "laser_points": outcome.laser_points,
        "of_laser_points": outcome.of_laser_points,
        "base": asdict(outcome.base),
        "reference": {
            "lookins": reference.lookins[False],
            "lookins_all_bounces": reference.lookins[True],
            "processor_s": reference.seconds,
            "relative_errors": [
                {"all_bounces": complete, "bin_width": f"{p}/{q}", "error": truth.relative_error}
                for (complete, (p, q)), truth in reference.truths.items()
            ],
        },
        "rows": [{key: _plain(value) for key, value in asdict(row).items()} for row in outcome.rows],
        "left_out": outcome.left_out,
        "advice": advice(outcome.rows),
        "machine": hardware(),
        "versions": environment(),
        "commit": commit(),
    }


def _plain(value: object) -> object:
    return None if isinstance(value, float) and not np.isfinite(value) else value


def write(out: Path, config: DatasetConfig, outcome: Outcome) -> None:
    """All three files or none: they are made elsewhere and then moved."""
    out.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(prefix=".accuracy-", dir=out) as folder:
        made = Path(folder)
        (made / "accuracy.md").write_text(report(outcome), encoding="utf-8")
        (made / "accuracy.json").write_bytes(json_bytes(numbers(config, outcome)))
        title = f"{outcome.name}, scene {outcome.scene} ({processor()})"
        picture(outcome.rows, title, made / "accuracy.png")
        for path in sorted(made.iterdir()):
            shutil.move(path, out / path.name)


@click.command()
@click.argument("config")
@click.argument("out", type=click.Path(path_type=Path))
@click.option("--scene", default=0, show_default=True, type=click.IntRange(0), help="Which scene of the dataset.")
@click.option(
    "--laser-points", type=click.IntRange(1), help="Only so many of the laser points, spread over the scan."
)
@click.option("--seconds", default=240.0, show_default=True, type=float, help="Budget, processor seconds.")
@click.option("--repeats", default=3, show_default=True, type=click.IntRange(2), help="Runs behind each median.")
def main(config: str, out: Path, scene: int, laser_points: int | None, seconds: float, repeats: int) -> None:
    """Measure what accuracy costs for one scene of CONFIG; table, picture and numbers go to the folder OUT."""
    loaded = load_config(config)
    if not 1 <= seconds < math.inf:
        raise InputError(f"--seconds {seconds:g}: must be ≥ 1, such as 240")
    if scene >= loaded.scenes:
        raise InputError(f"--scene {scene}: {loaded.name} has the scenes 0 … {loaded.scenes - 1}")
    check_writable(out)
    outcome = run(loaded, scene, laser_points, seconds, repeats)
    write(out, loaded, outcome)
    click.echo(report(outcome))
    click.echo(f"{out / 'accuracy.md'}, accuracy.png and accuracy.json beside it")


if __name__ == "__main__":
    raise SystemExit(guarded(main))
