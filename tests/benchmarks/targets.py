"""Whether `Accuracy(target=…)` keeps its promise, and at what cost, on random scenes and captures.

`python tests/benchmarks/targets.py SCENES FIRST COST` prints the figures of docs/figures.md.

*Error*: relative L2 of a run with a target, against a long run of another seed (the truth) with `TRUTH` of the
smallest target, whose own expected squared error is subtracted.
*Cost*: in connections with their shadow rays (`error_control/cost.py`), beside that of the cheapest fixed counts
`Accuracy(lookins=N, fov_samples=M)` whose error is the target on average (root mean square), which half of their runs
miss: what somebody would pay who knew N and M beforehand.

A scene is taken to the smaller targets for as long as a run is expected to cost at most COST connections, so that the
bench ends; how many scenes each target had is part of the table.
"""

from __future__ import annotations

import math
import sys
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

import numpy as np
from benchmarks.cases import KEPT, promises_kept

from datagen.bench.measuring import machine, markdown, processor_seconds
from datagen.capture import capture_for
from datagen.config import DatasetConfig, config_from_mapping
from datagen.design.scene_for import scene_for
from datagen.errors import InputError
from datagen.records import Accuracy, Capture, Scene, Transient
from datagen.records.arrays import l2_norm
from datagen.transport import simulate

TARGETS = (0.10, 0.05, 0.02, 0.01)
TRUTH, TRUTH_IF_DEAR = 0.5, 0.8
"""Error of the truth, in units of the smallest target that a scene was taken to; the second where a run cost more
than COST. Its expected square is known and subtracted, so it need not be much smaller."""
FAIR = 4.0
"""Largest cost, in units of the fixed counts', that should occur."""
REPLICATES, USUAL_REPLICATES = 16, 8
"""Replicates of the runs with fixed counts by which their error is measured, and of those whose cost is stated."""
CONNECTIONS_AT_MOST = 256
"""Connections of a vertex beyond which more FoV points are not tried."""
LAYOUTS = ("l_corridor", "t_corridor", "corridor_room", "z_corridor", "straight_corridor")
WINDOWS = ((32, 2000), (64, 1000), (128, 500), (256, 250), (512, 100))
"""Bins and their width in ps."""
BRDFS: tuple[dict[str, Any], ...] = (
    {"kind": "lambertian"},
    {"kind": "lambertian"},
    {"kind": "phong", "exponent": 20, "specular": 0.5},
    {"kind": "oren_nayar", "sigma_deg": 25},
    {"kind": "ggx", "roughness": 0.4},
)


def random_case(index: int) -> DatasetConfig:
    """Case `index`: a room of any layout with anything in it, of matt or glossy materials, clean or foggy; a confocal
    scan, a pixel array, a scan with several pixels or a single large pixel; coarse to fine bins; 3, 4, 5 or all
    bounces, with or without the direct return. The same index gives the same case."""
    rng = np.random.default_rng(np.random.SeedSequence(0, spawn_key=(index,)))
    groups = ("figures", "furniture", "shapes", "letters", "household")

    def surface() -> dict[str, Any]:
        return {"albedo": float(rng.uniform(0.1, 0.95)), "brdf": BRDFS[rng.integers(len(BRDFS))]}

    bins, width = WINDOWS[rng.integers(len(WINDOWS))]
    return config_from_mapping(
        {
            "name": f"case {index}",
            "seed": int(rng.integers(2**31)),
            "scenes": 1,
            "scene": {
                "layout": {"kind": LAYOUTS[rng.integers(len(LAYOUTS))]},
                "contents": [
                    {"kind": "library", "name": f"thing{k}", "classes": [groups[rng.integers(len(groups))]]}
                    | surface()
                    for k in range(rng.integers(1, 4))
                ],
                "materials": {name: surface() for name in ("relay_wall", "walls", "floor", "ceiling")},
                "attenuation_per_m": float(rng.choice([0.0, 0.0, 0.1])),
            },
            "capture": {**_capture(rng), "time": {"bins": bins, "bin_width_ps": width, "start_ns": 25.0}},
            "transport": {
                "max_bounces": (3, 3, 4, 4, 4, 5, None)[rng.integers(7)],
                "direct": bool(rng.random() < 0.1),
            },
        }
    )


def _capture(rng: np.random.Generator) -> dict[str, Any]:
    kind = rng.integers(4)
    side = float(rng.uniform(0.3, 1.0))
    grid = {"rows": 4, "columns": 4, "width_m": side, "height_m": side}
    if kind == 0:
        small = float(rng.choice([0.02, 0.05, 0.2]))
        return {"pairing": "confocal", "scan": grid, "field_of_view": {"width_m": small, "height_m": small}}
    view = {"width_m": side, "height_m": side}
    scan = {"rows": 2, "columns": 2, **view} if kind == 2 else {"rows": 1, "columns": 1}
    pixels = {1: {"rows": 6, "columns": 6}, 2: {"rows": 3, "columns": 3}}.get(int(kind), {})
    return {"pairing": "exhaustive", "scan": scan, "field_of_view": {**view, **pixels}}


@dataclass(frozen=True)
class Outcome:
    """One scene and target.

    error : true relative L2 error. bound : the error that was claimed. cost, fixed_cost : of the run, and of the
    cheapest fixed counts, in connections; NaN where there is no light. seconds : processor seconds of the run.
    """

    case: int
    target: float
    error: float
    bound: float
    met: bool
    cost: float
    fixed_cost: float
    seconds: float

    @property
    def within(self) -> bool:
        """Whether the true error is at most the target."""
        return self.error <= self.target


def outcomes(cases: Iterable[int], targets: Sequence[float] = TARGETS, cost: float = 2e6) -> Iterator[Outcome]:
    """Run every case, one after the other. Cases whose configuration cannot be furnished are left out."""
    for case in cases:
        config = random_case(case)
        try:
            scene = scene_for(config, 0)
            capture = capture_for(config, scene, config.seed, 0)
        except InputError:
            continue
        base = Accuracy(max_bounces=config.transport.max_bounces, direct=config.transport.direct)
        yield from _outcomes_of(case, scene, capture, base, targets, cost)


def _outcomes_of(
    case: int, scene: Scene, capture: Capture, base: Accuracy, targets: Sequence[float], cost: float
) -> Iterator[Outcome]:
    """The targets in falling order, for as long as the next would not cost more than `cost`."""
    runs: list[tuple[float, Transient, float]] = []
    for target in sorted(targets, reverse=True):
        if runs and _cost(runs[-1][1]) * (runs[-1][0] / target) ** 2 > cost:
            break
        asked, seed = replace(base, target=target), 1000 * case + len(runs)
        runs.append((target, *processor_seconds(lambda a=asked, s=seed: _run(scene, capture, a, s))))  # type: ignore[misc]
    smallest, dearest, _ = runs[-1]
    finer = (TRUTH if _cost(dearest) <= cost else TRUTH_IF_DEAR) * smallest
    truth = _run(scene, capture, replace(base, target=max(finer, 1e-4)), 1000 * case + 999)
    norm = l2_norm(truth.total)
    noise = l2_norm(truth.stderr) / norm if norm > 0 else 0.0
    fixed = fixed_counts_costs(scene, capture, base, [target for target, *_ in runs], norm, 1000 * case + 500)
    for (target, run, seconds), fixed_cost in zip(runs, fixed, strict=True):
        assert run.error_bound is not None and run.met_target is not None
        if norm > 0:
            error = math.sqrt(max((l2_norm(run.total - truth.total) / norm) ** 2 - noise**2, 0.0))
        else:
            error = math.inf if run.total.any() else 0.0
        yield Outcome(case, target, error, run.error_bound, run.met_target, _cost(run), fixed_cost, seconds)


def fixed_counts_costs(
    scene: Scene, capture: Capture, base: Accuracy, targets: Sequence[float], norm: float, seed: int
) -> list[float]:
    """For each target the cost of the cheapest fixed counts with that root mean square error; norm : ‖truth‖.

    For each number of FoV points lookins are quadrupled until the smallest target is met, or others met it for less;
    between two of them cost is read off the straight line of the logarithms.
    """
    cheapest = np.full(len(targets), np.inf)
    for samples in (1, 4, 16, 64) if norm > 0 else ():
        if samples > 1 and samples * capture.shape[1] > CONNECTIONS_AT_MOST:
            break
        lookins, errors, costs = REPLICATES * 4, list[float](), list[float]()
        while not errors or (errors[-1] > min(targets) and costs[-1] < cheapest[-1]):
            counts = replace(base, lookins=lookins, fov_samples=samples, replicates=REPLICATES)
            run = _run(scene, capture, counts, seed)
            errors.append(math.sqrt(REPLICATES / USUAL_REPLICATES) * l2_norm(run.stderr) / norm)
            costs.append(_cost(run) * USUAL_REPLICATES / REPLICATES)
            lookins *= 4
        if all(errors):
            found = np.interp(np.log(targets), np.log(errors[::-1]), np.log(costs[::-1]), left=np.inf)
            cheapest = np.minimum(cheapest, np.exp(found))
    return [float(cost) if np.isfinite(cost) else math.nan for cost in cheapest]


def _run(scene: Scene, capture: Capture, accuracy: Accuracy, seed: int) -> Transient:
    return simulate(scene, capture, accuracy, seed, split_parts=False)


def _cost(run: Transient) -> float:
    assert run.spend is not None
    return run.spend.cost


def table(found: Sequence[Outcome]) -> str:
    """Markdown, a line for each target."""
    head = ["target", "scenes", *KEPT, "cost / fixed counts: median", "95th", f"over {FAIR:g}", "CPU s: median"]
    rows = []
    for target in sorted({one.target for one in found}, reverse=True):
        some = [one for one in found if one.target == target]
        kept = promises_kept([one.error / target for one in some], [one.within for one in some])
        ratio = np.array([one.cost / one.fixed_cost for one in some if one.fixed_cost > 0] or [math.nan])
        costs = f"{np.median(ratio):.2f}", f"{np.quantile(ratio, 0.95):.2f}", f"{(ratio > FAIR).mean():.1%}"
        seconds = f"{np.median([one.seconds for one in some]):.2f}"
        rows.append([f"{target:g}", str(len(some)), *kept, *costs, seconds])
    return markdown(head, rows, words=0)


def main(scenes: int, first: int, cost: float) -> None:
    """Hold accuracy targets against the true error of random scenes."""
    found = list(outcomes(range(first, first + scenes), cost=cost))
    print(f"{len({one.case for one in found})} scenes; {machine()}\n\n{table(found)}\n")
    for one in found:
        if not one.within:
            print(f"beyond its target {one.target:g}: case {one.case}, true {one.error:.4f}, claimed {one.bound:.4f}")


if __name__ == "__main__":
    main(int(sys.argv[1]), int(sys.argv[2]), float(sys.argv[3]))
