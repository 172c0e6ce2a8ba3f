"""`README.md`, the dataset card for people."""

from __future__ import annotations

import json
import math
from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa

from datagen.errors import printable
from datagen.store.environment import LIBRARIES, mixed
from datagen.store.files import write_if_changed
from datagen.store.manifest import Manifest
from datagen.store.record import ShardRecord, scenes_made
from datagen.store.schema import Schema
from datagen.store.summaries import evidence_by_kind, label_place_line, placed_anew_lines
from datagen.store.table import TABLE, table_of

CARD = "README.md"
_MOST_FILES = 20
"""The largest number of imported files that the card lists; half as many would hide some of a usual session."""
_SIZES = ((1_000, "n<1K"), (10_000, "1K<n<10K"), (100_000, "10K<n<100K"), (1_000_000, "100K<n<1M"))
_TAGS = ["non-line-of-sight", "single-photon", "transient-imaging"]


def write_card(root: Path, manifest: Manifest, records: Sequence[ShardRecord], table: pa.Table | None = None) -> None:
    """Write the card. The card of an incomplete dataset says how many shards are there."""
    write_if_changed(root / CARD, card(manifest, records, table).encode())


def card(manifest: Manifest, records: Sequence[ShardRecord], table: pa.Table | None = None) -> str:
    """The text of the card. It depends on the manifest and the commit records alone, and has no date or duration."""
    schema, config = manifest.schema, manifest.config
    failures = {scene: reason for record in records for scene, reason in record.failures.items()}
    stored = sum(file.bytes for record in records for file in record.files.values())
    whole = len(records) == schema.shards
    if whole and table is None:
        table = table_of(records, (), manifest.splits())
    names = ", ".join(f'"{field.name}"' for field in schema.fields if field.sharded)
    lines = [
        *_front_matter(manifest, whole),
        f"# {config['name']}",
        "",
        *([config["description"], ""] if config["description"] else []),
        *_origin_lines(manifest),
        "",
        "## State",
        "",
        f"Complete: {schema.scenes} scenes in {schema.shards} shards, {readable(stored)} on disk "
        f"({readable(schema.scenes * schema.bytes_per_scene)} decoded)."
        if whole
        else f"**Incomplete**: {len(records)} of {schema.shards} shards are there; "
        "run the same `datagen build` again to go on.",
        "",
        *_failure_lines(failures),
        *(_split_lines(table) if table is not None else []),
        "## Fields",
        "",
        "Zarr v3 arrays in `data.zarr`, one scene along the first axis.",
        "",
        "| field | axes | shape | dtype | unit | meaning |",
        "|---|---|---|---|---|---|",
        *(
            f"| `{f.name}` | {', '.join(f.dims)} | {', '.join(map(str, (schema.scenes, *f.shape)))} | {f.dtype} "
            f"| {f.unit} | {f.meaning} |"
            for f in schema.fields
        ),
        "",
        *_class_lines(schema),
        *_time_lines(manifest),
        "Lengths are metres, in the frame of each file; right-handed."
        if manifest.imported
        else "Lengths are metres, z up, right-handed.",
        "",
        *([place, ""] if (place := label_place_line(scene.parameters for scene in scenes_made(records))) else []),
        *_stats_lines(manifest),
        *(_evidence_lines(table) if table is not None else []),
        *(_parameter_lines(table) if table is not None else []),
        "## Reading it",
        "",
        "```python",
        "import datagen as dg",
        f'data = dg.TransientDataset("PATH", fields=[{names}])',
        "```",
        "",
        "or with any Zarr v3 reader: `zarr.open_group('PATH/data.zarr', mode='r')`. Chunks end in a CRC-32C;",
        "`datagen verify --deep PATH` checks every file and every value against the commit records in `build/`.",
        "",
        "## Provenance",
        "",
        *_made_lines(manifest),
        f"- configuration fingerprint `{manifest.fingerprint}`; the whole configuration stands in `dataset.json`",
        *(f"- mesh `{mesh}`, SHA-256 `{sha}`" for mesh, sha in manifest.meshes.items()),
        f"- licence: {config.get('license') or 'none stated, so all rights are reserved'}",
        f"- code: commit {manifest.made_by['commit']}",
        f"- versions: {', '.join(f'{name} {manifest.made_by[name]}' for name in ('datagen', 'python', *LIBRARIES))}",
        f"- begun on: {manifest.made_by['processor']}, {manifest.made_by['system']}",
        *(f"- shards differ in {difference}" for difference in mixed([record.made_by for record in records])),
        "",
    ]
    return printable("\n".join(lines).replace("\r\n", "\n"))


def _origin_lines(manifest: Manifest) -> list[str]:
    """Sentences that say whether the dataset was simulated or imported."""
    version = manifest.made_by["datagen"]
    if manifest.imported:
        return [
            "Non-line-of-sight captures as files of other programs or of a laboratory hold them, imported by datagen "
            f"{version};",
            "nothing was simulated for this dataset, and what is hidden is not known to it.",
        ]
    return [
        "Simulated non-line-of-sight measurements: a laser lights points on a relay wall, light is followed around",
        "the corner and back, and a single-photon detector counts it. Made by datagen "
        f"{version}; nothing here was measured.",
    ]


def _made_lines(manifest: Manifest) -> list[str]:
    """Lines that name the origin of the scenes: a seed, or the files that were imported."""
    files = manifest.imported
    if not files:
        return [f"- seed {manifest.seed}; each scene depends on (seed, scene index) only"]
    shown = [
        f"- scene {scene}: `{file.name}` ({file.format}), SHA-256 `{file.sha256}`" for scene, file in enumerate(files)
    ]
    more = [f"- and {len(shown) - _MOST_FILES} more, see `dataset.json`"] if len(shown) > _MOST_FILES else []
    given = manifest.config["scene"]["layout"]["options"]
    said = ", ".join(f"{name} {_option(value)}" for name, value in given.items() if value is not None)
    return [*shown[:_MOST_FILES], *more, *([f"- options of the import: {said}"] if said else [])]


def _option(value: Any) -> str:
    if isinstance(value, dict):
        return f"`{value['name']}`, SHA-256 `{value['sha256']}`"
    return " × ".join(map(str, value)) if isinstance(value, list) else str(value)


def _front_matter(manifest: Manifest, whole: bool) -> list[str]:
    """The YAML header for the Hugging Face Hub. It names the table, whose rows the Hub's viewer shows."""
    scenes, terms = manifest.schema.scenes, manifest.config.get("license", "")
    size = next((name for most, name in _SIZES if scenes < most), "n>1M")
    tags = [*_TAGS] if manifest.imported else [*_TAGS, "synthetic"]
    named = {"pretty_name": manifest.config["name"], "size_categories": [size], "tags": tags}
    if terms:
        named |= {"license": "other", "license_link": terms} if "://" in terms else {"license": terms.lower()}
    if whole:
        named["configs"] = [{"config_name": "scenes", "data_files": TABLE}]
    # Each value is written as JSON, which is YAML.
    return ["---", *(f"{key}: {json.dumps(value, ensure_ascii=False)}" for key, value in named.items()), "---", ""]


def readable(size: float) -> str:
    """A number of bytes as text: `12.3 MB`."""
    power = min(int(math.log(max(size, 1.0), 1000)), 4)
    return f"{size / 1000**power:.{3 if power else 12}g} {('bytes', 'kB', 'MB', 'GB', 'TB')[power]}"


def _failure_lines(failures: dict[int, str]) -> list[str]:
    if not failures:
        return []
    shown = [f"- scene {scene}: {reason}" for scene, reason in sorted(failures.items())[:20]]
    shown += [f"- and {len(failures) - 20} more, see `{TABLE}`"] if len(failures) > 20 else []
    return [f"{len(failures)} scenes could not be made; their values are fill values:", "", *shown, ""]


def _split_lines(table: pa.Table) -> list[str]:
    """Lines that state the number of scenes in each split."""
    scenes = Counter(name for name in table["split"].to_pylist() if name is not None)
    counts = ", ".join(f"{name} {count}" for name, count in scenes.most_common())
    return [f"Splits (column `split` of `{TABLE}`; no room is in two): {counts}.", ""]


def _stats_lines(manifest: Manifest) -> list[str]:
    """A table of mean and standard deviation of each field in the split `train`, by which inputs are normalised."""
    fields = (manifest.stats or {}).get("train", {})
    rows = [f"| `{name}` | {s['mean']:.6g} | {s['std']:.6g} | {s['nonzero']:.4g} |" for name, s in fields.items()]
    head = [
        "## Mean and spread",
        "",
        "Of the split `train`; of a histogram log(1 + counts); all in `dataset.json`.",
        "",
    ]
    return [*head, "| field | mean | std | share not 0 |", "|---|---|---|---|", *rows, ""] if rows else []


def _evidence_lines(table: pa.Table) -> list[str]:
    """A table with the significance of the objects of each kind."""
    names = [name for name in table.column_names if name.startswith("evidence.")]
    scenes = table.select(names).to_pylist() if names else []
    kinds, anew = evidence_by_kind(scenes), placed_anew_lines(scenes)
    head = [
        "## Evidence",
        "",
        "Significance of each object's own light, in standard deviations of a matched filter that knows all else;",
        "under 3 a label cannot be learnt from the data.",
        "",
        "| kind | objects | median | share under 3 | share under 1 |",
        "|---|---|---|---|---|",
    ]
    rows = [f"| {k.kind} | {k.objects} | {k.median:.3g} | {k.under_3:.1%} | {k.under_1:.1%} |" for k in kinds]
    return [*head, *rows, "", *(line for sentence in anew for line in (sentence, ""))] if rows else []


def _class_lines(schema: Schema) -> list[str]:
    """A line for each field of classes, with the class that each number stands for."""
    lines: list[str] = []
    for field in schema.fields:
        if field.classes:
            names = ", ".join(f"{k} {name}" for k, name in enumerate(field.classes))
            lines += [f"Classes of `{field.name}`: {names}.", ""]
    return lines


def _time_lines(manifest: Manifest) -> list[str]:
    """A line on the axes of time and the pairing."""
    capture = manifest.config["capture"]
    axis, pairing, merged = capture["time"], capture["pairing"], manifest.bins_merged
    start = f"{axis['start_ns']:g}"
    origin = "laser emission" if axis["origin"] == "source" else "the laser point (device legs left out)"
    pixels = " (pixel i looks at laser point i, so `pixel` has length 1)" if pairing == "confocal" else ""

    def covered(width_ps: float) -> str:
        width = f"{width_ps / 1000:g}"
        return f"[{start} + i · {width}, {start} + (i + 1) · {width}) ns"

    finer = f", and bin `i` of `transient_bin` {covered(axis['bin_width_ps'])}" if merged > 1 else ""
    return [
        f"Bin `i` covers {covered(merged * axis['bin_width_ps'])}{finer}, counted from {origin}. "
        f"Pairing: {pairing}{pixels}.",
    ]


def ranges(table: pa.Table) -> list[tuple[str, str, str, str]]:
    """(name, least, median, most) of every numeric column that varies from scene to scene, in the table's order."""
    rows = []
    for name in table.column_names:
        column = table[name].drop_null()
        if (
            name in ("scene", "shard", "failure")
            or name.startswith("stats.")
            or not pa.types.is_primitive(column.type)
        ):
            continue
        values = np.asarray(column.to_pylist(), np.float64)
        if len(values) and values.min() < values.max():
            rows.append((name, f"{values.min():.4g}", f"{np.median(values):.4g}", f"{values.max():.4g}"))
    return rows


def _parameter_lines(table: pa.Table) -> list[str]:
    """A table of the parameters that vary from scene to scene, with least, median and largest value."""
    rows = [f"| `{name}` | {' | '.join(numbers)} |" for name, *numbers in ranges(table)]
    head = ["## What varies", "", f"From `{TABLE}`, which has a row for every scene.", ""]
    return [*head, "| parameter | least | median | most |", "|---|---|---|---|", *rows, ""] if rows else []
