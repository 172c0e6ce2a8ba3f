"""The plan of a build as text."""

from __future__ import annotations

import math
import os
from collections import Counter
from collections.abc import Callable, Iterator
from pathlib import Path

from datagen.building.plan import SECONDS, Plan, Range, plan_build
from datagen.config import DatasetConfig, time_axes
from datagen.config.sequence import sequence_said
from datagen.design.exposure import with_exposure_found
from datagen.errors import InputError, as_line
from datagen.records.checks import as_given
from datagen.store import schema_of
from datagen.store.card import readable
from datagen.store.columns import Columns
from datagen.store.environment import cores, made_with
from datagen.store.files import json_bytes, write_atomically
from datagen.store.info import effect_lines, heading
from datagen.store.summaries import change_lines, effects_of, evidence_lines, missed_lines


def plan(
    config: DatasetConfig, workers: int = 1, seconds: float = SECONDS, json_path: str | Path | None = None
) -> str:
    """The plan as text, which is also written to `json_path` as JSON. Raises `InputError` as `plan_build` does."""
    if json_path is not None:
        _check_file(Path(json_path))
    config = with_exposure_found(config)
    found = plan_build(config, workers, seconds)
    if json_path is not None:
        values = {
            "name": config.name,
            "fingerprint": config.fingerprint(),
            "forecast": found.as_json(),
            "cores": cores(),
            "made_by": made_with(),
        }
        write_atomically(Path(json_path), json_bytes(values))
    return plan_text(config, found)


def plan_text(config: DatasetConfig, found: Plan) -> str:
    """The plan as text: what is configured, a scene's cost and what it shows, the cost of the whole build."""
    blocks = [
        heading(config.name, config.description),
        _config_lines(config),
        _one_scene(config, found),
        _whole_build(found),
        _fields(config, found),
    ]
    return "\n\n".join("\n".join(map(as_line, block)) for block in blocks)


def _config_lines(config: DatasetConfig) -> Iterator[str]:
    """Lines on the scenes, the capture, the transport and the detector."""
    lasers, pixels, bins = config.histogram_shape
    accuracy = config.transport.accuracy()
    bounces = "all bounce orders" if accuracy.max_bounces is None else f"up to {accuracy.max_bounces} bounces"
    how = f"aims at an error of {_percent(accuracy.target or 0.0)}"
    if accuracy.target is None:
        how = f"{_count(accuracy.samples or 0, 'path')} of each pair of laser point and pixel"
    named = "" if config.capture.device is None else f" ({config.capture.device.name})"
    lit = _count(lasers, "laser point")
    if config.capture.illumination == "flood":
        lit = f"a flood of {config.capture.scan.laser_points} points"
    axis = f"{bins} bins of {time_axes(config)['bin'].bin_width_ps:g} ps"
    kind = f", detectors of the class {config.detector.detector_class}" if config.detector.detector_class else ""
    goal = config.detector.found_for
    yield f"scenes       {config.scenes}, seed {config.seed}"
    yield f"capture      {config.capture.pairing}, {lit} × {_count(pixels, 'pixel')} × {axis}{named}"
    if config.sequence is not None:
        said = sequence_said(config.sequence.model_dump(), config.capture.model_dump())
        yield f"sequence     {config.sequence.frames} frames each, {said}"
    yield f"transport    {how}, {bounces}"
    yield f"detector     {config.detector.mode}{kind}"
    if goal is not None:
        what = "objects" if goal.change is None else "changes by objects"
        share = f"{1 - goal.quantile:.0%} of the {what} of pilot scenes have {goal.least:g} σ"
        yield f"exposure     {config.detector.cycles:g} cycles, with which {share}"


def _one_scene(config: DatasetConfig, found: Plan) -> Iterator[str]:
    """Lines on what a scene takes, stores and shows."""
    yield f"one scene, mean (and range) of {_count(len(found.pilots.parameters), 'scene')} simulated in full"
    for scene, reason in found.pilots.failed.items():
        yield f"  scene {scene} cannot be made: {reason}"
    stages = sorted(found.seconds.items(), key=lambda item: -item[1])
    longest = ", ".join(f"{stage} {_digits(taken)}" for stage, taken in stages if taken >= 0.02 * found.scene_s[1])
    yield f"  time       {_mean_and_range(found.scene_s, duration)} of one core: {longest}"
    yield f"  disk       {_size(found.scene_bytes)}; {readable(schema_of(config).bytes_per_scene)} decoded"
    for line in missed_lines(Columns(found.pilots.parameters)):
        yield f"  window     {line}"
    if math.isnan(found.error[1]) and config.transport.accuracy().target is not None:
        yield "  error      not known: no light was met within the time axis"
    elif math.isnan(found.error[1]):
        yield "  error      not known: of a single sample nothing tells it; set transport.samples to 2 or more"
    else:
        error = _mean_and_range(found.error, _percent)
        yield f"  error      {error} of a transient (relative L2), claimed by the simulation"
    of = found.pilots.parameters[0]
    yield (
        f"  detector   PDE {of['detector.pde']:.3g}, {of['exposure.cycles']} cycles at "
        f"{float(of['exposure.repetition_rate_hz']) / 1e6:.3g} MHz; brightest histogram of the first scene: "
        f"{of['sampler.flux_per_cycle']:.2g} events a cycle, {of['sampler.detections']:.2g} detections"
    )
    samplers = Counter(str(each["sampler.name"]) for each in found.pilots.parameters)
    yield f"  counts     drawn by the sampler {', '.join(f'{name} ({n})' for name, n in samplers.items())}"
    for number, line in enumerate(evidence_lines(found.evidence)):
        yield f"  {'' if number else 'evidence':11}{line}"
    parameters = found.pilots.parameters
    for number, line in enumerate(change_lines(Columns(parameters))):
        yield f"  {'' if number else 'change':11}{line}"
    effects = effect_lines(Columns(parameters), Columns(map(effects_of, parameters)))
    yield from (f"  {line}" for line in effects)


def _whole_build(found: Plan) -> Iterator[str]:
    """Lines on the whole build."""
    yield f"whole build ({_count(found.workers, 'worker')}; this machine has {_count(cores(), 'core')})"
    yield f"  time       {duration(found.build_s)} on idle cores, and some seconds until the workers have started"
    yield f"  disk       {_size(found.build_bytes)}"
    idle = found.workers - found.scenes
    unused = f"; {idle} of {found.workers} workers would have nothing to do" if idle > 0 else ""
    yield f"  shards     {found.shards} of {found.scenes_per_shard} scenes{unused}"
    yield f"  memory     {readable(found.shard_memory_bytes)} for a shard, in the worker that writes it"


def _fields(config: DatasetConfig, found: Plan) -> Iterator[str]:
    """The table of the stored fields and their bytes."""
    yield f"{'field':22}{'one scene':22}{'dtype':9}{'decoded':>10}{'on disk':>10}   (all scenes)"
    for field in schema_of(config).fields:
        shape = " × ".join(map(str, field.shape))
        decoded, stored = found.scenes * field.bytes_per_scene, found.scenes * found.pilots.stored[field.name]
        yield f"{field.name:22}{shape:22}{field.dtype:9}{readable(decoded):>10}{_size(stored):>10}"
    yield f"{'commit records':53}{'':>10}{_size(found.scenes * found.pilots.stored['record']):>10}"


def _check_file(path: Path) -> None:
    if path.is_dir():
        raise InputError(f"{as_given('json_path', path)}: is a folder; name a file")
    if not path.parent.is_dir():
        raise InputError(
            f"{as_given('json_path', path)}: there is no folder {path.parent}; make it, or name another file"
        )
    if not os.access(path.parent, os.W_OK):
        raise InputError(f"{as_given('json_path', path)}: {path.parent} cannot be written; name a file elsewhere")


def duration(seconds: float) -> str:
    """Seconds as text, such as `8.1 s`, `12 min`, `3.4 h` or `5.2 days`."""
    for least, size, unit in ((172800, 86400, "days"), (5400, 3600, "h"), (100, 60, "min")):
        if seconds >= least:
            return f"{_digits(seconds / size)} {unit}"
    return f"{_digits(seconds)} s"


def _mean_and_range(values: Range, text: Callable[[float], str]) -> str:
    """A mean, with the range in parentheses if it is wide enough to show."""
    least, mean, most = map(text, values)
    return mean if least == most else f"{mean} ({least} … {most})"


def _digits(value: float) -> str:
    """A number with two significant digits, without an exponent down to a thousandth."""
    if value >= 99.5:
        return f"{value:.0f}"
    return f"{value:.2g}" if value >= 0.01 else f"{value:.3f}"


def _size(size: float) -> str:
    """A size rounded to two digits, as a plan knows no more."""
    return readable(float(f"{size:.2g}"))


def _percent(share: float) -> str:
    return f"{_digits(100 * share)} %"


def _count(number: int, thing: str) -> str:
    return f"{number} {thing}" if number == 1 else f"{number} {thing}s"
