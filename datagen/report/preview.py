"""`datagen preview`: a whole dataset on one HTML page that needs nothing beside itself."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from html import escape
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from datagen.capture import capture_for
from datagen.config import DatasetConfig
from datagen.errors import InputError
from datagen.records import Scalar
from datagen.report.contact_sheet import sheet_figure
from datagen.report.html import head, inside, table
from datagen.report.parameter_plots import parameter_page, varying
from datagen.report.replay import read_scene, replay
from datagen.report.room_plots import RoomPicture
from datagen.report.show import pages
from datagen.report.style import house_style
from datagen.scene import generate_scene
from datagen.store import Manifest, read_manifest
from datagen.store.record import SceneRecord, ShardRecord, read_record, recorded_shards

if TYPE_CHECKING:
    from matplotlib.figure import Figure

ROOMS = 24
"""Rooms on the sheet."""
SCENES = 3
"""Scenes shown in full."""


def preview(dataset: str | Path, out_html: str | Path | None = None, scenes: int = SCENES) -> Path:
    """Write one HTML file about a dataset: its card, its fields, rooms, the first scenes in full, what was drawn.

    Pictures are inside the file; it has no script and asks for nothing from anywhere. A dataset that is still being
    built is shown as far as it is committed.

    Parameters
    ----------
    out_html : default `DATASET.html` beside the dataset.
    scenes : how many scenes to simulate again and show in full.

    Raises
    ------
    InputError : no dataset, no scene in it yet, or an output that cannot be written.
    """
    root = Path(dataset)
    manifest = read_manifest(root)
    records = [record for shard in recorded_shards(root) if (record := read_record(root, shard)) is not None]
    made = [scene for record in records for scene in record.scenes if scene.failure is None]
    if not made:
        raise InputError(f"{dataset}: no scene is there yet; run `datagen build` again, then preview it")
    out = root.resolve().with_name(root.resolve().name + ".html") if out_html is None else Path(out_html)
    with house_style():
        text = "\n".join(_page(root, manifest, records, made, scenes))
    try:
        out.parent.mkdir(parents=True, exist_ok=True)
        out.write_text(text, encoding="utf-8")
    except OSError as error:
        raise InputError(f"{out}: cannot be written ({error.strerror or error}); name another file") from None
    return out


def _page(
    root: Path, manifest: Manifest, records: Sequence[ShardRecord], made: Sequence[SceneRecord], scenes: int
) -> Iterator[str]:
    config = manifest.parsed_config()
    yield head(config.name)
    if config.description:
        yield f"<p>{escape(config.description)}</p>"
    yield from _state(manifest, records, made)
    yield "<h2>Fields</h2>"
    shapes = (" × ".join(map(str, (manifest.schema.scenes, *f.shape))) for f in manifest.schema.fields)
    rows = [
        (f.name, ", ".join(f.dims), shape, f.dtype, f.unit, f.meaning)
        for f, shape in zip(manifest.schema.fields, shapes, strict=True)
    ]
    yield _table(("field", "axes", "shape", "dtype", "unit", "meaning"), rows)
    yield "<h2>Rooms</h2>"
    yield inside(_rooms(config, made[:ROOMS]), f"the first {min(len(made), ROOMS)} rooms, plan and opened")
    yield "<h2>Scenes in full</h2>"
    for scene in made[:scenes]:
        yield from _scene(root, scene)
    parameters = [scene.parameters for scene in made]
    columns = varying(parameters)
    figure = parameter_page(columns)
    yield f"<h2>What was drawn</h2><p>Over {len(made)} scenes; parameters that do not vary are left out.</p>"
    if figure is not None:
        yield inside(figure, "histograms of the drawn parameters")
    yield _parameter_table(columns)
    yield "<h2>Configuration</h2><details><summary>as stored in <code>dataset.json</code></summary>"
    yield f"<pre>{escape(config.model_dump_json(indent=2))}</pre></details></body></html>"


def _state(manifest: Manifest, records: Sequence[ShardRecord], made: Sequence[SceneRecord]) -> Iterator[str]:
    schema = manifest.schema
    stored = sum(file.bytes for record in records for file in record.files.values())
    failures = {index: why for record in records for index, why in record.failures.items()}
    seconds = [sum(scene.seconds.values()) for scene in made]
    rows = [
        ("scenes", f"{len(made)} of {schema.scenes}"),
        ("shards", f"{len(records)} of {schema.shards}"),
        ("size", f"{stored / 1e6:.1f} MB stored, {len(made) * schema.bytes_per_scene / 1e6:.1f} MB decoded"),
        ("seconds a scene", f"{np.median(seconds):.2g} (median, one core)"),
        ("seed", str(manifest.seed)),
        ("fingerprint", manifest.fingerprint),
        ("commit", manifest.commit or "unknown"),
        ("versions", ", ".join(f"{name} {version}" for name, version in manifest.versions.items())),
        ("hardware", ", ".join(f"{name}: {value}" for name, value in manifest.hardware.items())),
    ]
    yield _table((), rows)
    if len(records) < schema.shards:
        yield '<p class="warning">Incomplete: run the same <code>datagen build</code> again to go on.</p>'
    if failures:
        shown = "; ".join(f"scene {k}: {why}" for k, why in list(failures.items())[:3])
        yield f'<p class="warning">{len(failures)} scenes could not be made, such as {escape(shown)}</p>'


def _rooms(config: DatasetConfig, chosen: Sequence[SceneRecord]) -> Figure:
    rooms = []
    for record in chosen:
        scene = generate_scene(config.scene, config.seed, record.index)
        targets = capture_for(config, scene, config.seed, record.index).laser.targets
        rooms.append(RoomPicture(scene, laser_points=targets, pixels=180))
    title = f"{config.name}: {len(rooms)} rooms, by scene index"
    return sheet_figure(rooms, [str(record.index) for record in chosen], title, columns=4)


def _scene(root: Path, record: SceneRecord) -> Iterator[str]:
    stored = read_scene(root, record.index)
    for name, figure in pages(stored, replay(stored), ["overview"]):
        yield inside(figure, f"scene {record.index}, {name}")


def _parameter_table(columns: Mapping[str, Sequence[Scalar]]) -> str:
    rows = []
    for name, values in columns.items():
        if all(isinstance(value, (int, float)) for value in values):
            numbers = np.array([float(value) for value in values])
            row = [f"{number:.4g}" for number in (numbers.min(), np.median(numbers), numbers.max())]
        else:
            row = [", ".join(sorted({str(value) for value in values})), "", ""]
        rows.append((name, *row))
    return _table(("parameter", "least", "median", "most"), rows)


def _table(header: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    return table(header, [[escape(cell) for cell in row] for row in rows])
