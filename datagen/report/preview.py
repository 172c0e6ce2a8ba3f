"""`datagen preview`: a whole dataset on one HTML page that needs nothing beside itself."""

from __future__ import annotations

from collections.abc import Iterator
from html import escape
from itertools import islice
from pathlib import Path
from typing import Any
from warnings import warn

from datagen.design.scene_for import scene_for
from datagen.errors import InputError, InputWarning
from datagen.records.checks import as_given, option
from datagen.report.explorer import explorer, scene_data
from datagen.report.html import head, inside, picture, table
from datagen.report.pages import frames_animation, frames_page, pages, stored_pages
from datagen.report.parameter_plots import parameter_page, varying
from datagen.report.replay import config_of, read_scene, replay
from datagen.report.stored import why_roomless
from datagen.report.style import house_style
from datagen.store import Description, each_committed, read_manifest
from datagen.store.files import check_writable, write_atomically
from datagen.store.info import info_of
from datagen.store.record import SceneRecord, scenes_made

ROOMS = 24
"""Rooms in the gallery."""
MOST_SCENES = 100
SCENES = 3
"""Scenes shown in full."""


def preview(dataset: str | Path, out_html: str | Path | None = None, scenes: int = SCENES) -> Path:
    """Write one HTML file about a dataset and return its path: the text of `info`, fields, rooms with their labels to
    turn and filter, some scenes in full with their scans to slide through, and the drawn parameters. Of sequences the
    middle frame is shown, and a strip and an animation of all frames of those in full.

    Pictures, numbers and script are inside the file; it loads nothing else. Of a dataset that is still being built
    the committed scenes are shown.

    out_html : default `DATASET.html` beside the dataset.
    scenes : how many scenes to simulate again and show in full.

    Raises
    ------
    InputError : no dataset, no scene in it yet, a mesh file that has changed, or an output that cannot be written.
    """
    if not 0 <= scenes <= MOST_SCENES:
        raise InputError(f"{as_given('scenes', scenes)}: must lie in 0 … {MOST_SCENES}")
    root = Path(dataset)
    manifest = read_manifest(root)
    described = Description(manifest, each_committed(root, manifest))
    if not described.made:
        raise InputError(f"{dataset}: no scene is there yet; run `datagen build` again, then preview it")
    out = root.resolve().with_name(root.resolve().name + ".html") if out_html is None else Path(out_html)
    check_writable(out.parent, f" with {option('out')}")
    with house_style():
        text = "\n".join(_page(root, described, scenes))
    try:
        out.parent.mkdir(parents=True, exist_ok=True)
        write_atomically(out, text.encode())
    except OSError as error:
        raise InputError(f"{out}: cannot be written ({error.strerror or error}); name another file") from None
    return out


def _page(root: Path, dataset: Description, scenes: int) -> Iterator[str]:
    manifest = dataset.manifest
    made = [*islice(scenes_made(each_committed(root, manifest)), max(ROOMS, scenes))]
    config, missing = config_of(manifest)
    if missing:
        warn(f"{missing}; only what is stored is shown", InputWarning, stacklevel=3)
    roomless = why_roomless(config, missing)
    yield head(config.name)
    full, shown, pictures = [record.index for record in made[:scenes]], list[dict[str, Any]](), list[str]()
    for record in made[: ROOMS if roomless is None else scenes]:
        whole = read_scene(root, record.index)
        stored, strip = whole.at_frame(), frames_page(whole) if record.index in full else None
        if strip is not None:
            pictures.append(inside(strip, f"scene {record.index}, frames"))
        moving = frames_animation(whole) if record.index in full else None
        if moving is not None:
            meaning = f"scene {record.index}, animation of its frames: what moves, and what changes in the light"
            pictures.append(picture(moving, "gif", meaning))
        if roomless is not None:
            for name, figure in stored_pages(stored, roomless):
                pictures.append(inside(figure, f"scene {record.index}, {name}"))
            continue
        replayed = replay(stored) if record.index in full else None
        scene = stored.scene_of(scene_for(config, record.index)) if replayed is None else replayed.scene
        shown.append(scene_data(stored, scene, _error(record), replayed))
        if replayed is not None:
            for name, figure in pages(stored, replayed, ["overview", "light"]):
                pictures.append(inside(figure, f"scene {record.index}, {name}"))
    yield explorer(shown, dataset.made) if roomless is None else f"<p>There are no rooms to show: {roomless}.</p>"
    yield "<h2>Scenes in full</h2>"
    yield from pictures
    drawn_page = parameter_page(varying(dataset.parameters))
    yield f"<h2>What was drawn</h2><p>Over {dataset.made} scenes; parameters that do not vary are left out.</p>"
    if drawn_page is not None:
        yield inside(drawn_page, "histograms of the drawn parameters")
    drawn = [row for row in dataset.ranges() if not row[0].endswith("seed")]
    yield table(("parameter", "least", "median", "most"), drawn)
    yield f"<h2>The dataset</h2><pre>{escape(info_of(root, dataset))}</pre>"
    yield "<h2>Fields</h2>"
    rows = [
        (field.name, ", ".join(field.dims), " × ".join(shape), field.dtype, field.unit, field.meaning)
        for field, shape in dataset.shapes.items()
    ]
    yield table(("field", "axes", "shape", "dtype", "unit", "meaning"), rows)
    yield "<h2>Configuration</h2><details><summary>as stored in <code>dataset.json</code></summary>"
    yield f"<pre>{escape(config.model_dump_json(indent=2))}</pre></details></body></html>"


def _error(record: SceneRecord) -> float | None:
    error = record.parameters.get("transient.relative_error")
    return float(error) if isinstance(error, int | float) else None
