"""The text of `datagen info`: what a dataset holds and how its build went."""

from __future__ import annotations

import statistics
from collections import Counter
from collections.abc import Iterator, Sequence

from datagen.errors import InputError, printable
from datagen.store.card import readable
from datagen.store.environment import mixed
from datagen.store.location import Location, location_of
from datagen.store.manifest import Manifest, read_manifest
from datagen.store.record import SceneRecord, ShardRecord
from datagen.store.summaries import evidence_by_kind, evidence_lines, label_place_line, placed_anew_lines
from datagen.store.verify import committed

STAGES = (
    "read", "scene", "effects", "transport", "detector", "background", "evidence", "presence", "labels", "store",
)  # fmt: skip
"""The stages of `Sample.seconds`, in the order in which a scene goes through them."""


def info(path: str | Location) -> str:
    """What, shapes, sizes, seconds per scene by stage, scenes per second, decisions. Hashes are left to `verify`.

    Raises `InputError` when the folder is no dataset, or its records hold what datagen does not write.
    """
    root = location_of(path)
    manifest = read_manifest(root)
    try:
        return printable(_description(manifest, committed(root, manifest)))
    except (KeyError, IndexError, TypeError, ValueError, OverflowError) as error:
        what = f"{type(error).__name__}: {error}"
        raise InputError(f"{root}: its commit records hold what datagen does not write ({what})") from None


def _description(manifest: Manifest, records: Sequence[ShardRecord]) -> str:
    schema, config = manifest.schema, manifest.config
    scenes = sum(len(record.scenes) for record in records)
    stored = {field.name: 0 for field in schema.fields}
    for record in records:
        for name, file in record.files.items():
            stored[name.split("/")[1]] += file.bytes
    lines = [f"{config['name']}: {config['description']}".rstrip(": "), ""]
    whole = len(records) == schema.shards
    lines += [
        f"scenes       {scenes} of {schema.scenes}{'' if whole else ' (incomplete: build again to go on)'}",
        f"shards       {len(records)} of {schema.shards}, {schema.scenes_per_shard} scenes each",
        f"seed         {manifest.seed}",
        f"fingerprint  {manifest.fingerprint[:12]}",
        f"made by      datagen {manifest.versions['datagen']}, schema {manifest.schema_version}, commit "
        f"{(manifest.commit or 'unknown')[:12]}, on {manifest.hardware['processor']}, "
        f"{manifest.hardware['cores']} cores",
        *_imported(manifest),
        *(f"mixed        shards differ in {what}" for what in mixed([record.environment for record in records])),
        "",
        f"{'field':22}{'shape':26}{'dtype':9}{'decoded':>10}{'on disk':>10}  unit",
    ]
    for field in schema.fields:
        shape = " × ".join(map(str, (schema.scenes, *field.shape)))
        decoded = readable(scenes * field.bytes_per_scene)
        lines.append(
            f"{field.name:22}{shape:26}{field.dtype:9}{decoded:>10}{readable(stored[field.name]):>10}  {field.unit}"
        )
    lines += [f"{name}: {', '.join(field.classes)}" for name, field in schema.by_name.items() if field.classes]
    parts = (_label_place, _times, _accuracy, _evidence, _decisions, _effects, _failures)
    return "\n".join([*lines, "", *(line for part in parts for line in part(records))])


def _imported(manifest: Manifest) -> Iterator[str]:
    """The files that captures were imported from; nothing for simulated ones."""
    files = manifest.imported
    if files:
        kinds = ", ".join(dict.fromkeys(of.format for of in files))
        names = ", ".join(of.name for of in files[:3])
        yield f"imported     from {len(files)} files ({kinds}): {names}{', …' if len(files) > 3 else ''}"


def scenes_made(records: Sequence[ShardRecord]) -> list[SceneRecord]:
    """The scenes of the shards that could be made."""
    return [scene for record in records for scene in record.scenes if scene.failure is None]


def seconds_by_stage(records: Sequence[ShardRecord]) -> dict[str, float]:
    """Stage → median seconds per scene; of writing, each scene's share of its shard. Stages not run are left out."""
    taken = {
        stage: [scene.seconds[stage] for scene in scenes_made(records) if stage in scene.seconds] for stage in STAGES
    }
    taken["store"] = [record.seconds["store"] / len(record.scenes) for record in records]
    return {stage: statistics.median(values) for stage, values in taken.items() if values}


def _label_place(records: Sequence[ShardRecord]) -> Iterator[str]:
    """The position of label images beside the scan."""
    line = label_place_line(scene.parameters for scene in scenes_made(records))
    if line:
        yield from (line, "")


def _times(records: Sequence[ShardRecord]) -> Iterator[str]:
    made = scenes_made(records)
    if not made:
        return
    yield "seconds per scene (median; store: shard's share)"
    for stage, taken_s in seconds_by_stage(records).items():
        yield f"  {stage:11}{taken_s:9.4f}"
    working = _covered([(record.started, record.finished) for record in records])
    at_once = sum(record.finished - record.started for record in records) / working if working > 0 else 0.0
    yield f"{len(made) / max(working, 1e-9):.2f} scenes/s, with {at_once:.1f} shards under way at a time"
    yield ""


def _covered(intervals: list[tuple[float, float]]) -> float:
    """The length of the union of intervals: time when something was being made, interruptions left out."""
    total, reached = 0.0, float("-inf")
    for start, stop in sorted(intervals):
        total += max(0.0, stop - max(start, reached))
        reached = max(reached, stop)
    return total


def _accuracy(records: Sequence[ShardRecord]) -> Iterator[str]:
    """The transients' relative L2 errors, whether their target was met, and where the work went."""
    made = [scene.parameters for scene in scenes_made(records)]
    errors = [float(of["transient.relative_error"]) for of in made if "transient.relative_error" in of]
    if not errors:
        return
    yield f"relative error of the transients: median {statistics.median(errors):.4f}, largest {max(errors):.4f}"
    targeted = [bool(of["transient.target_met"]) for of in made if "transient.target_met" in of]
    if targeted:
        yield f"  target met in {sum(targeted)} of {len(targeted)} scenes (upper bounds of the error, at 95 %)"
    shares: dict[str, list[float]] = {}
    for of in made:
        for name, value in of.items():
            if name.startswith("transport.spend.") and name.endswith(".share"):
                shares.setdefault(name.split(".")[2], []).append(float(value))
    if shares:
        parts = (f"{name} {statistics.median(values):.0%}" for name, values in shares.items())
        yield "  share of the transport's cost (median): " + ", ".join(parts)
    yield ""


def _evidence(records: Sequence[ShardRecord]) -> Iterator[str]:
    """The significance of objects against the noise."""
    made = [scene.parameters for scene in scenes_made(records)]
    lines = [*evidence_lines(evidence_by_kind(made)), *placed_anew_lines(made)]
    if lines:
        yield "evidence of objects (significance of an ideal matched filter)"
        yield from (f"  {line}" for line in lines)
        yield ""


def _decisions(records: Sequence[ShardRecord]) -> Iterator[str]:
    """Decisions by name: how many scenes have each value of the parameters `decision.*`."""
    counted: dict[str, Counter[str]] = {}
    for scene in (scene for record in records for scene in record.scenes):
        for name, value in scene.parameters.items():
            if name.startswith("decision."):
                counted.setdefault(name.removeprefix("decision."), Counter())[str(value)] += 1
    if counted:
        yield "decisions (scenes)"
        for name, values in counted.items():
            yield f"  {name:18}" + ", ".join(f"{value} ({count})" for value, count in sorted(values.items()))
        yield ""


def _effects(records: Sequence[ShardRecord]) -> Iterator[str]:
    """Effects by name: in how many scenes each was simulated or left out, and the range of its estimates."""
    made = [scene.parameters for scene in scenes_made(records)]
    names = dict.fromkeys(name.split(".")[1] for of in made for name in of if name.startswith("effect."))
    lines = []
    for name in names:
        there = [of for of in made if of.get(f"effect.{name}.kind", "absent") != "absent"]
        if not there:
            continue
        on = sum(bool(of[f"effect.{name}.on"]) for of in there)
        estimates = [float(of[f"effect.{name}.estimate"]) for of in there if f"effect.{name}.estimate" in of]
        span = f"{min(estimates):9.2g} … {max(estimates):.2g}" if estimates else ""
        lines.append(f"  {name:25}{on:>9}{len(there) - on:>10}  {span}".rstrip())
    if lines:
        yield f"{'effects (scenes)':27}{'simulated':>9}{'left out':>10}    leaving out changes the answer by ≤"
        yield from lines
        yield ""


def _failures(records: Sequence[ShardRecord]) -> Iterator[str]:
    failures = {scene: reason for record in records for scene, reason in record.failures.items()}
    if failures:
        yield f"{len(failures)} scenes could not be made"
        for scene, reason in sorted(failures.items())[:10]:
            yield f"  scene {scene}: {reason}"
