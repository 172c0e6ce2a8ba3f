"""`README.md`, the dataset card for people."""

from __future__ import annotations

import json
import math
import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from datagen.errors import printable
from datagen.store.description import Description
from datagen.store.environment import LIBRARIES
from datagen.store.files import write_if_changed
from datagen.store.manifest import Manifest
from datagen.store.table import TABLE

CARD = "README.md"
_MOST_LINES = 20
"""The largest number of imported files, and of scenes that could not be made, that the card lists."""
_SIZES = ((1_000, "n<1K"), (10_000, "1K<n<10K"), (100_000, "10K<n<100K"), (1_000_000, "100K<n<1M"))
_TAGS = ["non-line-of-sight", "single-photon", "transient-imaging"]


def write_card(root: Path, dataset: Description) -> None:
    """Write the card. The card of an incomplete dataset says how many shards are there."""
    write_if_changed(root / CARD, card(dataset).encode())


def card(dataset: Description) -> str:
    """The text of the card. It depends on the manifest and the commit records alone, and has no date or duration."""
    manifest, config = dataset.manifest, dataset.manifest.config
    names = ", ".join(f'"{field.name}"' for field in dataset.shapes if field.sharded)
    fields = [
        (f"`{field.name}`", ", ".join(field.dims), ", ".join(shape), field.dtype, field.unit, field.meaning)
        for field, shape in dataset.shapes.items()
    ]
    frame = ", in the frame of each file; right-handed" if manifest.imported else ", z up, right-handed"
    paragraphs = [
        _front_matter(dataset),
        f"# {_plain(config['name'])}",
        _without_tags(config["description"]),
        f"{dataset.origin} Made by datagen {manifest.made_by['datagen']}.",
        "## State",
        *_state(dataset),
        "## Fields",
        "Zarr v3 arrays in `data.zarr`, one scene along the first axis.",
        _table(("field", "axes", "shape", "dtype", "unit", "meaning"), fields),
        *(
            f"Classes of `{field.name}`: {', '.join(f'{k} {_plain(name)}' for k, name in enumerate(field.classes))}."
            for field in dataset.shapes
            if field.classes
        ),
        f"{_time(manifest)}\nLengths are metres{frame}.",
        dataset.label_place(),
        *(_values(dataset) if dataset.is_whole else []),
        "## Reading it",
        f'```python\nimport datagen as dg\ndata = dg.TransientDataset("PATH", fields=[{names}])\n```',
        "or with any Zarr v3 reader: `zarr.open_group('PATH/data.zarr', mode='r')`. Chunks end in a CRC-32C;\n"
        "`datagen verify --deep PATH` checks every file and every value against the commit records in `build/`.",
        "## Provenance",
        "\n".join(f"- {line}" for line in _provenance(dataset)),
    ]
    text = "\n\n".join(filter(None, paragraphs)) + "\n"
    return printable(text.replace("\r\n", "\n"))


def readable(size: float) -> str:
    """A number of bytes as text: `12.3 MB`."""
    power = min(int(math.log(max(size, 1.0), 1000)), 4)
    return f"{size / 1000**power:.{3 if power else 12}g} {('bytes', 'kB', 'MB', 'GB', 'TB')[power]}"


def _plain(text: str) -> str:
    """Text as one line of Markdown that shows it as it is: no tag, link or emphasis in it acts."""
    return re.sub(r"([\\`*\[\]])", r"\\\1", " ".join(text.split())).replace("&", "&amp;").replace("<", "&lt;")


def _code(text: str) -> str:
    """Text as code within a line of Markdown."""
    return f"`{' '.join(text.split()).replace('`', chr(0xB4))}`"


def _without_tags(text: str) -> str:
    """Markdown whose HTML is shown, and does not act; links in angle brackets stay."""
    return re.sub(r"<(?=[A-Za-z/!?])(?!https?://)", "&lt;", text)


def _table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """A Markdown table; an empty text without rows."""
    cells = [[cell.replace("|", "\\|") for cell in row] for row in (head, ["---"] * len(head), *rows)]
    lines = [f"| {' | '.join(row)} |" for row in cells]
    return "\n".join(lines) if rows else ""


def _front_matter(dataset: Description) -> str:
    """The YAML header for the Hugging Face Hub. It names the table, whose rows the Hub's viewer shows."""
    manifest = dataset.manifest
    scenes, terms = manifest.schema.scenes, manifest.config["license"]
    size = next((name for most, name in _SIZES if scenes < most), "n>1M")
    tags = [*_TAGS] if manifest.imported else [*_TAGS, "synthetic"]
    named = {"pretty_name": manifest.config["name"], "size_categories": [size], "tags": tags}
    if terms:
        named |= {"license": "other", "license_link": terms} if "://" in terms else {"license": terms.lower()}
    if dataset.is_whole:
        named["configs"] = [{"config_name": "scenes", "data_files": TABLE}]
    # Each value is written as JSON, which is YAML.
    lines = [f"{key}: {json.dumps(value, ensure_ascii=False)}" for key, value in named.items()]
    return "\n".join(["---", *lines, "---"])


def _state(dataset: Description) -> list[str]:
    """Paragraphs on what is there, what could not be made, and the splits."""
    schema, failures, paragraphs = dataset.manifest.schema, len(dataset.failures), list[str]()
    if dataset.is_whole:
        stored, decoded = map(readable, (dataset.stored_bytes.total(), dataset.scenes * schema.bytes_per_scene))
        paragraphs += [
            f"Complete: {dataset.scenes} scenes in {schema.shards} shards, {stored} on disk ({decoded} decoded)."
        ]
    else:
        there = f"{dataset.shards} of {schema.shards} shards are there"
        paragraphs += [f"**Incomplete**: {there}; run the same `datagen build` again to go on."]
    if failures:
        more = [f"and {failures - _MOST_LINES} more, see `{TABLE}`"] if failures > _MOST_LINES else []
        paragraphs += [
            f"{failures} scenes could not be made; their values are fill values:",
            "\n".join(f"- {line}" for line in (*map(_plain, dataset.failure_lines(_MOST_LINES)), *more)),
        ]
    if dataset.is_whole:
        counts = ", ".join(f"{name} {count}" for name, count in dataset.scenes_by_split().most_common())
        paragraphs += [f"Splits (column `split` of `{TABLE}`; no room is in two): {counts}."]
    return paragraphs


def _time(manifest: Manifest) -> str:
    """A sentence on the axes of time and the pairing."""
    capture = manifest.config["capture"]
    axis, pairing, merged = capture["time"], capture["pairing"], manifest.bins_merged
    start = f"{axis['start_ns']:g}"
    origin = "laser emission" if axis["origin"] == "source" else "the laser point (device legs left out)"
    pixels = " (pixel i looks at laser point i, so `pixel` has length 1)" if pairing == "confocal" else ""

    def covered(width_ps: float) -> str:
        width = f"{width_ps / 1000:g}"
        return f"[{start} + i · {width}, {start} + (i + 1) · {width}) ns"

    finer = f", and bin `i` of `transient_bin` {covered(axis['bin_width_ps'])}" if merged > 1 else ""
    frames = ""
    if manifest.frames is not None:
        sequence = manifest.config["sequence"]
        frames = (
            f" Each scene is a sequence: frame `f` begins f / {sequence['rate_hz']:g} s after the first, "
            "`laser_time` says when each laser point is measured, and labels show the middle of a frame's exposures."
        )
    return (
        f"Bin `i` covers {covered(merged * axis['bin_width_ps'])}{finer}, counted from {origin}. "
        f"Pairing: {pairing}{pixels}.{frames}"
    )


def _values(dataset: Description) -> list[str]:
    """Paragraphs on the values of a complete dataset: mean and spread of fields, evidence of objects, parameters."""
    fields = (dataset.manifest.stats or {}).get("train", {})
    stats = [
        (f"`{name}`", f"{of['mean']:.6g}", f"{of['std']:.6g}", f"{of['nonzero']:.4g}") for name, of in fields.items()
    ]
    varying = [(_code(name), *numbers) for name, *numbers in dataset.ranges()]
    sections = (
        ("## Mean and spread", "Of the split `train`; of a histogram log(1 + counts); all in `dataset.json`.",
         _table(("field", "mean", "std", "share not 0"), stats)),
        ("## Evidence",
         "Significance of each object's own light, in standard deviations (σ) of a matched filter that knows all\n"
         "else; under 3 σ a label cannot be learnt from the data.",
         "\n".join(f"- {_plain(line)}" for line in dataset.evidence())),
        ("## What varies", f"From `{TABLE}`, which has a row for every scene.",
         _table(("parameter", "least", "median", "most"), varying)),
    )  # fmt: skip
    return [paragraph for section in sections if section[-1] for paragraph in section]


def _provenance(dataset: Description) -> list[str]:
    """Lines on the origin of the scenes, the configuration, the licence, the code and the machine."""
    manifest, made_by = dataset.manifest, dataset.manifest.made_by
    versions = ", ".join(f"{name} {made_by[name]}" for name in ("datagen", "python", *LIBRARIES))
    return [
        *(_import_lines(manifest) or [f"seed {manifest.seed}; each scene depends on (seed, scene index) only"]),
        f"configuration fingerprint `{manifest.fingerprint}`; the whole configuration stands in `dataset.json`",
        *(f"mesh {_code(mesh)}, SHA-256 `{sha}`" for mesh, sha in manifest.meshes.items()),
        f"licence: {manifest.config['license'] or 'none stated, so all rights are reserved'}",
        f"code: commit {made_by['commit']}",
        f"versions: {versions}",
        f"begun on: {made_by['processor']}, {made_by['system']}",
        *map(_plain, dataset.differences()),
    ]


def _import_lines(manifest: Manifest) -> list[str]:
    """Lines that name the files that were imported, and the options; none of a simulated dataset."""
    files, scene = list[str](), 0
    for file in manifest.imported:
        last = scene + (file.frames or 1) - 1
        scenes = f"scene {scene}" if last == scene else f"scenes {scene} to {last}"
        files.append(f"{scenes}: {_code(file.name)} ({file.format}), SHA-256 `{file.sha256}`")
        scene = last + 1
    if not files:
        return []
    more = [f"and {len(files) - _MOST_LINES} more, see `dataset.json`"] if len(files) > _MOST_LINES else []
    given = manifest.config["scene"]["layout"]["options"]
    taken = [
        f"taken: {_plain(one)}" for one in dict.fromkeys(file.taken for file in manifest.imported) if one is not None
    ]
    options = ", ".join(f"{name} {_option(value)}" for name, value in given.items() if value is not None)
    return [
        *files[:_MOST_LINES],
        *more,
        *taken[:_MOST_LINES],
        *([f"options of the import: {options}"] if options else []),
    ]


def _option(value: Any) -> str:
    if isinstance(value, dict):
        return f"{_code(value['name'])}, SHA-256 `{value['sha256']}`"
    return " × ".join(map(str, value)) if isinstance(value, list) else _plain(str(value))
