"""The plan of a build as text: decisions on effects, expected time, error and size."""

from __future__ import annotations

import math
import os
import time
from collections.abc import Iterator, Sequence
from concurrent.futures import Future, wait
from dataclasses import asdict
from pathlib import Path

from datagen.building.engines import check_workers, started
from datagen.config import DatasetConfig, time_axes
from datagen.design.exposure import with_exposure_found
from datagen.errors import InputError
from datagen.forecast.forecast import Forecast, Outcome, forecast, outcomes, records_of
from datagen.forecast.pilots import run_pilots, startup_seconds
from datagen.store import Schema, schema_of
from datagen.store.card import readable
from datagen.store.environment import cores, made_with
from datagen.store.files import finite, json_bytes, write_atomically
from datagen.store.summaries import evidence_lines

BUDGET_S = 1.5
"""Processor seconds for pilots: three or four scenes of an ordinary scan. Halved, there is often one scene only."""
BUSY = 0.8
"""Fraction of a core below which the plan states that other processes slowed the pilots down. Halved, it is silent on
machines that are half busy."""


def make_forecast(config: DatasetConfig, workers: int = 1, budget_s: float = BUDGET_S) -> Forecast:
    """The forecast of a build with `workers` processes on this machine: seconds, error and bytes.

    Pilot scenes are simulated until `budget_s` processor seconds are spent, but at least one. The start of a worker
    process, and loading kernels (or compiling them, the first time), take further time.

    Raises
    ------
    InputError : whatever a build would refuse; `workers` under 1; a budget that is no positive number.
    """
    from datagen.pipeline import check_inputs

    check_workers(workers)
    config = with_exposure_found(config)
    if not 0 < budget_s < math.inf:
        raise InputError(f"--seconds {budget_s:g}: must be > 0, such as {BUDGET_S:g}")
    check_inputs(config)
    starting = list[Future[float]]()
    with started("local", 1, None) as engine:

        def start_worker(index: int) -> None:
            starting.append(engine.submit(startup_seconds, config, index, time.time()))
            if cores() == 1:
                wait(starting)

        # The worker starts once the kernels are on disk, or both processes would compile them.
        pilots = run_pilots(config, budget_s, compiled=start_worker)
        startup_s = starting[0].result()
    return forecast(schema_of(config), pilots, startup_s, workers, cores())


def plan(
    config: DatasetConfig,
    workers: int = 1,
    budget_s: float = BUDGET_S,
    json_path: str | Path | None = None,
    dataset: str | Path | None = None,
) -> str:
    """The plan as text. It is also written to `json_path` as JSON, and compared with a `dataset` built before.

    Raises `InputError` as `make_forecast` and `records_of` do, if possible before any pilot.
    """
    if json_path is not None:
        _check_file(Path(json_path))
    config = with_exposure_found(config)
    records = None if dataset is None else records_of(config, dataset)
    expected = make_forecast(config, workers, budget_s)
    compared = [] if records is None or dataset is None else outcomes(expected, records, dataset)
    if json_path is not None:
        values = {
            "name": config.name,
            "fingerprint": config.fingerprint(),
            "forecast": expected.as_json(),
            "against": [finite(asdict(row)) for row in compared],
            "cores": cores(),
            "made_by": made_with(),
        }
        write_atomically(Path(json_path), json_bytes(values))
    return plan_text(config, expected, compared)


def plan_text(config: DatasetConfig, expected: Forecast, compared: Sequence[Outcome] = ()) -> str:
    """The plan as text: the scenes, the decisions and their reasons, the cost of one scene and of the whole build.

    compared : numbers of a build (`forecast.outcomes`), which are shown beside the forecast.
    """
    schema = schema_of(config)
    lines = [
        f"{config.name}: {config.description}".rstrip(": "),
        "",
        *_what(config, schema),
        "",
        *_decisions(config),
        "",
        *_one_scene(schema, expected),
        "",
        f"whole build ({_count(expected.workers, 'worker')}; this machine has {_count(cores(), 'core')})",
        *_whole_build(expected),
        "",
        *_fields(config, schema, expected),
        *_outcomes(compared),
    ]
    return "\n".join(lines)


def _what(config: DatasetConfig, schema: Schema) -> Iterator[str]:
    """Lines on the scenes, the capture, the transport and the detector."""
    lasers, pixels, bins = config.histogram_shape
    accuracy = config.transport.accuracy()
    bounces = "all bounce orders" if accuracy.max_bounces is None else f"up to {accuracy.max_bounces} bounces"
    how = (
        f"{accuracy.lookins} lookins a laser point, {accuracy.fov_samples} FoV samples, {accuracy.replicates} "
        "replicates"
        if accuracy.target is None
        else f"as many lookins as an error of {accuracy.target:.3g} needs"
    )
    flood = config.capture.illumination == "flood"
    named = "" if config.capture.device is None else f" ({config.capture.device.name})"
    lit = f"a flood of {config.capture.scan.laser_points} points" if flood else _count(lasers, "laser point")
    yield f"scenes       {config.scenes}, seed {config.seed}"
    yield (
        f"capture      {config.capture.pairing}, {lit} × {_count(pixels, 'pixel')} × "
        f"{bins} bins of {time_axes(config)['bin'].bin_width_ps:g} ps{named}"
    )
    yield f"transport    {how}, {bounces}"
    kind = f", detectors of the class {config.detector.detector_class}" if config.detector.detector_class else ""
    yield f"detector     {config.detector.mode}{kind}"
    goal = config.detector.found_for
    if goal is not None:
        yield (
            f"exposure     {config.detector.cycles:g} cycles, with which {1 - goal.quantile:.0%} of the objects of "
            f"pilot scenes have {goal.evidence:g} σ"
        )


def _decisions(config: DatasetConfig) -> list[str]:
    """Lines on the decisions for scene 0: the effects with their reasons, and the detector's sampler."""
    from datagen.capture import capture_for
    from datagen.design.light import coarse_transient, transport_effects
    from datagen.design.scene_for import scene_for
    from datagen.detector import choose_sampler, detector_for
    from datagen.effects import EFFECTS, EffectDecisions, decision_lines
    from datagen.pipeline import detector_effects

    scene = scene_for(config, 0)
    capture = capture_for(config, scene, config.seed, 0)
    effects = transport_effects(config, scene, capture, 0)
    spad, exposure = detector_for(config.detector, config.seed, 0, capture.time)
    transient = coarse_transient(config, 0, scene, capture, spad, exposure)
    effects += detector_effects(config, transient.total, transient.time, spad, exposure)
    used, conditions, tolerance = effects.apply_detector(spad, exposure, config.detector.tolerance)
    seen = (transient.total, capture.time, used, conditions)
    decided = choose_sampler(*seen, tolerance=tolerance, approximate=config.detector.approximate)
    present = tuple(decision for decision in effects.decisions if decision.kind != "absent")
    titles = {effect.name: effect.title for effect in EFFECTS}
    absent = [titles[decision.effect] for decision in effects.decisions if decision.kind == "absent"]
    brightest = f"{decided.flux_per_cycle:.2g} events a cycle, {decided.detections:.2g} detections"
    return [
        f"decisions for scene 0 (each scene gets its own; all that is left out may change a result by "
        f"{_percent(effects.tolerance)})",
        *(f"  {line}" for line in decision_lines(EffectDecisions(present, effects.tolerance))),
        f"  not there: {', '.join(absent)}",
        f"  sampler {decided.sampler}: {decided.reason}",
        f"  PDE {spad.pde:.3g}, {exposure.cycles} cycles at {exposure.repetition_rate_hz / 1e6:.3g} MHz; in the "
        f"brightest histogram {brightest}",
    ]


def _one_scene(schema: Schema, expected: Forecast) -> Iterator[str]:
    """Lines on the cost of one scene."""
    yield f"one scene ({_measured(expected)})"
    for scene, reason in expected.failed.items():
        yield f"  scene {scene} cannot be made: {reason}"
    stages = sorted(expected.seconds.items(), key=lambda item: -item[1])
    listed = ", ".join(f"{stage} {_digits(taken)}" for stage, taken in stages)
    yield f"  time       {_digits(sum(expected.seconds.values()))} s of one core: {listed}"
    least, _, most = expected.scene_s
    if most > 1.2 * least:
        yield f"             {_digits(least)} … {_digits(most)} s from scene to scene"
    yield f"  error      {_error(expected)}"
    for number, line in enumerate(evidence_lines(expected.evidence)):
        yield f"  {'' if number else 'evidence':11}{line}"
    yield (
        f"  disk       {readable(_two(expected.bytes_per_scene))} compressed, "
        f"{readable(schema.bytes_per_scene)} decoded"
    )


def _measured(expected: Forecast) -> str:
    """The source of the numbers of one scene."""
    if expected.effort == 1.0:
        return f"measured on {_count(expected.pilots, 'pilot scene')}"
    share = _percent(expected.effort)
    return f"from one scene with {share} of the paths and fewer, extrapolated; more --seconds let it have all"


def _error(expected: Forecast) -> str:
    """The expected error of a transient."""
    least, median, most = expected.error
    if math.isnan(median):
        return "not known: with 1 replicate nothing estimates it; set transport.replicates to 2 or more"
    spread = f" ({_percent(least)} … {_percent(most)} from scene to scene)" if most > 1.2 * least else ""
    return f"{_percent(median)}{spread} of a transient, relative L2 over all bins; photon noise comes on top"


def _whole_build(expected: Forecast) -> Iterator[str]:
    """Lines on the cost of the whole build."""
    each = f", of which {_digits(expected.startup_s)} s until each worker is warm"
    yield f"  time       {duration(expected.build_s)}{each if expected.build_s < 1200 else ''}"
    if expected.processor_share < BUSY:
        yield (
            f"             as busy as the machine is now; alone on it about "
            f"{duration(expected.build_s * expected.processor_share)} "
            f"(the pilots had {expected.processor_share:.0%} of a core)"
        )
    yield f"  disk       {readable(_two(expected.build_bytes))}"
    idle = expected.workers - expected.working
    unused = f"; {idle} of {expected.workers} workers would have nothing to do" if idle else ""
    yield f"  shards     {expected.shards} of {expected.scenes_per_shard} scenes{unused}"
    yield f"  memory     {readable(expected.shard_memory_bytes)} for each worker's shard"


def _fields(config: DatasetConfig, schema: Schema, expected: Forecast) -> Iterator[str]:
    """The table of the stored fields and their bytes."""
    yield f"{'field':22}{'one scene':22}{'dtype':9}{'decoded':>10}{'on disk':>10}"
    for field in schema.fields:
        shape = " × ".join(map(str, field.shape))
        decoded, stored = config.scenes * field.bytes_per_scene, config.scenes * expected.stored[field.name]
        yield f"{field.name:22}{shape:22}{field.dtype:9}{readable(decoded):>10}{readable(_two(stored)):>10}"
    decoded = config.scenes * schema.bytes_per_scene
    records = config.scenes * expected.stored["records"]
    yield f"{'commit records and table':51}{'':>10}{readable(_two(records)):>10}"
    yield f"{'all scenes':51}{readable(decoded):>10}{readable(_two(expected.build_bytes)):>10}"


def _outcomes(compared: Sequence[Outcome]) -> Iterator[str]:
    """The table that compares the forecast with a build; empty without a build."""
    if compared:
        yield ""
        yield f"{'against the dataset':22}{'predicted':>12}{'actual':>12}{'ratio':>8}"
    for row in compared:
        predicted, actual = (quantity(value, row.unit) for value in (row.predicted, row.actual))
        yield f"{row.name:22}{predicted:>12}{actual:>12}{row.ratio:8.2f}"


def _check_file(path: Path) -> None:
    if path.is_dir():
        raise InputError(f"--json {path}: is a folder; name a file")
    if not path.parent.is_dir():
        raise InputError(f"--json {path}: there is no folder {path.parent}; make it, or name another file")
    if not os.access(path.parent, os.W_OK):
        raise InputError(f"--json {path}: {path.parent} cannot be written; name a file elsewhere")


def duration(seconds: float) -> str:
    """Seconds as text, such as `8.1 s`, `12 min`, `3.4 h` or `5.2 days`."""
    for least, size, unit in ((172800, 86400, "days"), (5400, 3600, "h"), (100, 60, "min")):
        if seconds >= least:
            return f"{_digits(seconds / size)} {unit}"
    return f"{_digits(seconds)} s"


def _digits(value: float) -> str:
    """A number with two significant digits, without an exponent down to a thousandth."""
    if value >= 99.5:
        return f"{value:.0f}"
    return f"{value:.2g}" if value >= 0.01 else f"{value:.3f}"


def _two(size: float) -> float:
    """A size rounded to two digits, as a forecast knows no more."""
    return float(f"{size:.2g}")


def quantity(value: float, unit: str) -> str:
    """A number of an `Outcome` as text, with its unit."""
    if math.isnan(value):
        return "unknown"
    if unit == "bytes":
        return readable(_two(value))
    return f"{_digits(value)} s" if unit == "s" else _percent(value)


def _percent(share: float) -> str:
    return f"{_digits(100 * share)} %"


def _count(number: int, thing: str) -> str:
    return f"{number} {thing}" if number == 1 else f"{number} {thing}s"


PILOTS_WORTH = 20.0
"""Time limit of a scene over the longest pilot: rooms differ, machines are busy. Halved, it may end sound scenes."""
AT_LEAST_S = 60.0
"""Least time limit of a scene. Halved, it could end a scene that waits for a busy disk."""


def scene_limit(text: str, config: DatasetConfig) -> float:
    """Seconds that the text of `--scene-seconds` means: a number, or `forecast` for the start of a worker, with
    compilation, and `PILOTS_WORTH` times the longest pilot scene.

    Raises `InputError` for any other text, and as a forecast does.
    """
    if text == "forecast":
        expected = make_forecast(config)
        return max(AT_LEAST_S, expected.startup_s + PILOTS_WORTH * expected.scene_s[2])
    try:
        return float(text)
    except ValueError:
        raise InputError(f"--scene-seconds {text}: must be a number of seconds, or forecast") from None
