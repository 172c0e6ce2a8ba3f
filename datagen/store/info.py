"""The text of `datagen info`: the fields of a dataset, its accuracy and effects, and the seconds of its build."""

from __future__ import annotations

import numpy as np

from datagen.config.sequence import sequence_said
from datagen.errors import InputError, as_line
from datagen.store.card import readable
from datagen.store.columns import Columns
from datagen.store.description import Description
from datagen.store.growth import growth_line
from datagen.store.location import Location, location_of
from datagen.store.manifest import Manifest, read_manifest
from datagen.store.summaries import missed_lines
from datagen.store.verify import each_committed

_RAYS = "transport.rays."
"""Beginning of the names of parameters that say what the transport took."""
STAGES = (
    "read", "scene", "effects", "transport", "detector", "background", "evidence", "presence", "labels", "store",
)  # fmt: skip
"""Keys of `Sample.seconds`, in the order of the stages."""


def info(path: str | Location) -> str:
    """A description of a dataset for people: shapes, sizes, seconds per scene by stage, errors, effects. Hashes are
    not compared; `verify` does that.

    Raises `InputError` if the folder is no dataset, or its records hold values that datagen does not write.
    """
    root = location_of(path)
    manifest = read_manifest(root)
    return info_of(root, Description(manifest, each_committed(root, manifest)), growth_line(root, manifest))


def info_of(root: Location, dataset: Description, growth: str = "") -> str:
    """The text of `info`. Raises `InputError` if the records hold values that datagen does not write.

    growth : words on a growth of the dataset that is not complete.
    """
    try:
        return _text(dataset, growth)
    except (KeyError, IndexError, TypeError, ValueError, OverflowError) as error:
        what = f"{type(error).__name__}: {error}"
        raise InputError(f"{root}: its commit records hold what datagen does not write ({what})") from None


def _text(dataset: Description, growth: str) -> str:
    manifest = dataset.manifest
    failures, evidence = len(dataset.failures), [f"  {line}" for line in dataset.evidence()]
    sections = [
        heading(manifest.config["name"], manifest.config["description"]),
        [*_origin(dataset), *([f"unfinished   {growth}"] if growth else [])],
        _fields(dataset),
        [place] if (place := dataset.label_place()) else [],
        _times(dataset),
        _accuracy(dataset.parameters),
        ["detectability of objects (σ of an ideal matched filter)", *evidence] if evidence else [],
        effect_lines(dataset.parameters, dataset.effects),
        [f"{failures} scenes could not be made", *(f"  {line}" for line in dataset.failure_lines(10))]
        if failures
        else [],
    ]
    return "\n\n".join("\n".join(map(as_line, lines)) for lines in sections if lines)


def heading(name: str, description: str) -> list[str]:
    """Lines with the name of a dataset and its description, which may have several lines."""
    first, *others = description.rstrip().splitlines() or [""]
    return [f"{as_line(name)}: {first}".rstrip(": "), *others]


def _origin(dataset: Description) -> list[str]:
    """Lines on how many scenes are there, and from what and with which versions they were made."""
    manifest = dataset.manifest
    schema, files, made_by = manifest.schema, manifest.imported, manifest.made_by
    lines = [
        f"scenes       {dataset.scenes} of {schema.scenes}"
        f"{'' if dataset.is_whole else ' (incomplete: build again to go on)'}",
        *([] if manifest.frames is None else [f"frames       {manifest.frames} of each scene, {_rate(manifest)}"]),
        f"shards       {dataset.shards} of {schema.shards}, {schema.scenes_per_shard} scenes each",
        f"seed         {manifest.seed}",
        f"fingerprint  {manifest.fingerprint[:12]}",
        f"made by      datagen {made_by['datagen']}, commit {made_by['commit'][:12]}, on {made_by['processor']}",
    ]
    if files:
        kinds = ", ".join(dict.fromkeys(file.format for file in files))
        names = ", ".join(file.name for file in files[:3])
        lines.append(f"imported     from {len(files)} files ({kinds}): {names}{', …' if len(files) > 3 else ''}")
        taken = dict.fromkeys(file.taken for file in files if file.taken is not None)
        lines += [f"taken        {sentence}" for sentence in list(taken)[:3]]
    return lines + [f"mixed        {difference}" for difference in dataset.differences()]


def _rate(manifest: Manifest) -> str:
    return sequence_said(manifest.config["sequence"], manifest.config["capture"])


def _fields(dataset: Description) -> list[str]:
    """A line for each field with its shape and sizes, and one for each field of classes."""
    lines = [f"{'field':22}{'shape':26}{'dtype':9}{'decoded':>10}{'on disk':>10}  unit"]
    for field, shape in dataset.shapes.items():
        decoded, stored = readable(dataset.scenes * field.bytes_per_scene), readable(dataset.stored_bytes[field.name])
        sizes = f"{decoded:>10}{stored:>10}"
        lines.append(f"{field.name:22}{' × '.join(shape):26}{field.dtype:9}{sizes}  {field.unit}")
    return lines + [f"{field.name}: {', '.join(field.classes)}" for field in dataset.shapes if field.classes]


def seconds_by_stage(seconds: Columns) -> dict[str, float]:
    """Stage → median seconds per scene, of stages that any scene has; "store" is a shard's time over its scenes."""
    return {stage: float(np.median(seconds[stage].numbers)) for stage in STAGES if stage in seconds}


def _times(dataset: Description) -> list[str]:
    """Lines with the seconds of each stage, and the scenes per second of the time in which any shard was made."""
    if not dataset.made:
        return []
    stages = [f"  {stage:11}{taken_s:9.4f}" for stage, taken_s in seconds_by_stage(dataset.seconds).items()]
    working = _union_length(dataset.times)
    at_once = sum(finished - started for started, finished in dataset.times) / working if working > 0 else 0.0
    rate = f"{dataset.made / max(working, 1e-9):.2f} scenes/s, with {at_once:.1f} shards under way at a time"
    return ["seconds per scene (median; store: shard's share)", *stages, rate]


def _union_length(intervals: list[tuple[float, float]]) -> float:
    """The length of the union of intervals (start, stop)."""
    total, reached = 0.0, float("-inf")
    for start, stop in sorted(intervals):
        total += max(0.0, stop - max(start, reached))
        reached = max(reached, stop)
    return total


def _accuracy(parameters: Columns) -> list[str]:
    """Lines with the transients' relative L2 errors, the scenes that met their target, and the transport's costs."""
    errors = parameters.numbers("transient.relative_error")
    if not len(errors):
        return []
    known = errors[np.isfinite(errors)]
    lines = ["relative error of the transients: not known in any scene"]
    if len(known):
        lines = [f"relative error of the transients: median {np.median(known):.4f}, largest {known.max():.4f}"]
        lines[0] += f", not known in {len(errors) - len(known)}" if len(known) < len(errors) else ""
    lines += [f"  window: {line}" for line in missed_lines(parameters)]
    met = parameters.numbers("transient.target_met") != 0
    if len(met):
        lines.append(f"  target met in {met.sum()} of {len(met)} scenes (errors as estimated)")
    costs = {name: column.numbers for name, column in parameters.items() if name.startswith(_RAYS)}
    if costs:
        parts = (f"{name.removeprefix(_RAYS)} {np.median(values):.2g}" for name, values in costs.items())
        lines.append("  rays of the transport (median): " + ", ".join(parts))
    return lines


_DECIDED_BY = {"trial": "trial run", "forced": "configuration", "always": "always simulated"}
"""Words for kinds of decisions that say too little."""


def effect_lines(parameters: Columns, effects: Columns) -> list[str]:
    """A line for each effect: the scenes in which it was simulated or left out, and the range of its estimates.

    effects : of each scene `effects_of` its parameters.
    """
    lines = []
    for name in dict.fromkeys(name.split(".")[1] for name in parameters if name.startswith("effect.")):
        kinds = effects[key].words if (key := f"effect.{name}.kind") in effects else None
        if not kinds:
            continue
        on = int((effects[f"effect.{name}.on"].numbers != 0).sum())
        estimates = effects.numbers(f"effect.{name}.estimate")
        span = f"{estimates.min():.2g} … {estimates.max():.2g}, " if len(estimates) else ""
        by = ", ".join(_DECIDED_BY.get(kind, kind) for kind in sorted(kinds))
        lines.append(f"  {name:25}{on:>9}{kinds.total() - on:>10}    {span}{by}")
    head = f"{'effects (scenes)':27}{'simulated':>9}{'left out':>10}    change if left out (estimate), decided by"
    return [head, *lines] if lines else []
