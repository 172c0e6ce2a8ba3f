"""The text of `datagen info`: the fields of a dataset, its accuracy and effects, and the seconds of its build."""

from __future__ import annotations

import statistics
from collections.abc import Mapping, Sequence
from dataclasses import replace

from datagen.errors import InputError, printable
from datagen.records import Scalar
from datagen.store.card import readable
from datagen.store.description import Description
from datagen.store.location import Location, location_of
from datagen.store.manifest import Manifest, read_manifest
from datagen.store.record import ShardRecord, scenes_made
from datagen.store.verify import each_committed

Parameters = Sequence[Mapping[str, Scalar]]
"""The parameters of each scene that could be made."""

_SAID = ("effect.", "evidence.", "labels.scan_", "transient.", "transport.rays.")
"""Beginnings of the names of parameters of which `info` says something."""

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
    try:
        return printable(_text(manifest, [_outline(record) for record in each_committed(root, manifest)]))
    except (KeyError, IndexError, TypeError, ValueError, OverflowError) as error:
        what = f"{type(error).__name__}: {error}"
        raise InputError(f"{root}: its commit records hold what datagen does not write ({what})") from None


def _outline(record: ShardRecord) -> ShardRecord:
    """A record without what `info` does not say, which is most of its memory."""
    scenes = (
        replace(
            scene, digests={}, stats={},
            parameters={name: value for name, value in scene.parameters.items() if name.startswith(_SAID)},
        )
        for scene in record.scenes
    )  # fmt: skip
    return replace(record, scenes=tuple(scenes))


def _text(manifest: Manifest, records: Sequence[ShardRecord]) -> str:
    dataset = Description(manifest, records)
    failures, evidence = len(dataset.failures), [f"  {line}" for line in dataset.evidence()]
    sections = [
        [f"{manifest.config['name']}: {manifest.config['description']}".rstrip(": ")],
        _origin(dataset),
        _fields(dataset),
        [place] if (place := dataset.label_place()) else [],
        _times(records),
        _accuracy(dataset.made),
        ["evidence of objects (significance of an ideal matched filter)", *evidence] if evidence else [],
        effect_lines(dataset.made),
        [f"{failures} scenes could not be made", *(f"  {line}" for line in dataset.failure_lines(10))]
        if failures
        else [],
    ]
    return "\n\n".join("\n".join(lines) for lines in sections if lines)


def _origin(dataset: Description) -> list[str]:
    """Lines on how many scenes are there, and from what and with which versions they were made."""
    manifest = dataset.manifest
    schema, files, made_by = manifest.schema, manifest.imported, manifest.made_by
    lines = [
        f"scenes       {dataset.scenes} of {schema.scenes}"
        f"{'' if dataset.is_whole else ' (incomplete: build again to go on)'}",
        f"shards       {len(dataset.records)} of {schema.shards}, {schema.scenes_per_shard} scenes each",
        f"seed         {manifest.seed}",
        f"fingerprint  {manifest.fingerprint[:12]}",
        f"made by      datagen {made_by['datagen']}, commit {made_by['commit'][:12]}, on {made_by['processor']}",
    ]
    if files:
        kinds = ", ".join(dict.fromkeys(file.format for file in files))
        names = ", ".join(file.name for file in files[:3])
        lines.append(f"imported     from {len(files)} files ({kinds}): {names}{', …' if len(files) > 3 else ''}")
    return lines + [f"mixed        {difference}" for difference in dataset.differences()]


def _fields(dataset: Description) -> list[str]:
    """A line for each field with its shape and sizes, and one for each field of classes."""
    lines = [f"{'field':22}{'shape':26}{'dtype':9}{'decoded':>10}{'on disk':>10}  unit"]
    for field, shape in dataset.shapes.items():
        decoded, stored = readable(dataset.scenes * field.bytes_per_scene), readable(dataset.stored_bytes[field.name])
        sizes = f"{decoded:>10}{stored:>10}"
        lines.append(f"{field.name:22}{' × '.join(shape):26}{field.dtype:9}{sizes}  {field.unit}")
    return lines + [f"{field.name}: {', '.join(field.classes)}" for field in dataset.shapes if field.classes]


def seconds_by_stage(records: Sequence[ShardRecord]) -> dict[str, float]:
    """Stage → median seconds per scene, of stages that any scene has; "store" is a shard's time over its scenes."""
    taken = {
        stage: [scene.seconds[stage] for scene in scenes_made(records) if stage in scene.seconds] for stage in STAGES
    }
    taken["store"] = [record.seconds["store"] / len(record.scenes) for record in records]
    return {stage: statistics.median(values) for stage, values in taken.items() if values}


def _times(records: Sequence[ShardRecord]) -> list[str]:
    """Lines with the seconds of each stage, and the scenes per second of the time in which any shard was made."""
    made = scenes_made(records)
    if not made:
        return []
    stages = [f"  {stage:11}{taken_s:9.4f}" for stage, taken_s in seconds_by_stage(records).items()]
    working = _covered([(record.started, record.finished) for record in records])
    at_once = sum(record.finished - record.started for record in records) / working if working > 0 else 0.0
    rate = f"{len(made) / max(working, 1e-9):.2f} scenes/s, with {at_once:.1f} shards under way at a time"
    return ["seconds per scene (median; store: shard's share)", *stages, rate]


def _covered(intervals: list[tuple[float, float]]) -> float:
    """The length of the union of intervals (start, stop)."""
    total, reached = 0.0, float("-inf")
    for start, stop in sorted(intervals):
        total += max(0.0, stop - max(start, reached))
        reached = max(reached, stop)
    return total


def _accuracy(made: Parameters) -> list[str]:
    """Lines with the transients' relative L2 errors, the scenes that met their target, and the transport's costs."""
    errors = [float(scene["transient.relative_error"]) for scene in made if "transient.relative_error" in scene]
    if not errors:
        return []
    lines = [f"relative error of the transients: median {statistics.median(errors):.4f}, largest {max(errors):.4f}"]
    targeted = [bool(scene["transient.target_met"]) for scene in made if "transient.target_met" in scene]
    if targeted:
        lines.append(f"  target met in {sum(targeted)} of {len(targeted)} scenes (errors as estimated)")
    rays: dict[str, list[float]] = {}
    for scene in made:
        for name, value in scene.items():
            if name.startswith("transport.rays."):
                rays.setdefault(name.removeprefix("transport.rays."), []).append(float(value))
    if rays:
        parts = (f"{name} {statistics.median(values):.2g}" for name, values in rays.items())
        lines.append("  rays of the transport (median): " + ", ".join(parts))
    return lines


_DECIDED_BY = {"trial": "trial run", "forced": "configuration", "always": "always simulated"}
"""Words for kinds of decisions that say too little."""


def effect_lines(made: Parameters) -> list[str]:
    """A line for each effect: the scenes in which it was simulated or left out, and the range of its estimates."""
    scenes, lines = [*made], list[str]()
    for name in dict.fromkeys(name.split(".")[1] for scene in scenes for name in scene if name.startswith("effect.")):
        there = [scene for scene in scenes if scene.get(f"effect.{name}.kind", "absent") != "absent"]
        if not there:
            continue
        on = sum(bool(scene[f"effect.{name}.on"]) for scene in there)
        estimates = [float(scene[f"effect.{name}.estimate"]) for scene in there if f"effect.{name}.estimate" in scene]
        span = f"{min(estimates):.2g} … {max(estimates):.2g}, " if estimates else ""
        kinds = sorted({str(scene[f"effect.{name}.kind"]) for scene in there})
        by = ", ".join(_DECIDED_BY.get(kind, kind) for kind in kinds)
        lines.append(f"  {name:25}{on:>9}{len(there) - on:>10}    {span}{by}")
    head = f"{'effects (scenes)':27}{'simulated':>9}{'left out':>10}    change if left out ≤, decided by"
    return [head, *lines] if lines else []
