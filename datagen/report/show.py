"""`datagen show`: the pictures of one stored scene."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from warnings import warn

from matplotlib.figure import Figure

from datagen.errors import InputWarning
from datagen.labels import IMAGE_FIELDS, VOLUME_FIELDS, make_labels
from datagen.report import pages as drawn
from datagen.report.evidence_pictures import evidence_page
from datagen.report.label_plots import boxes_of
from datagen.report.replay import Replay, StoredScene, read_scene, replay
from datagen.report.room_plots import RoomPicture
from datagen.report.roomless import roomless_pages, why_roomless
from datagen.report.style import house_style, save_png

PAGES = ("overview", "transient", "histogram", "evidence", "labels", "scan")
"""The pictures of a scene, in the order in which they are made."""


def show(dataset: str | Path, index: int, out: str | Path | None = None) -> list[Path]:
    """Draw scene `index` of a dataset as PNGs and return their paths, the overview first.

    An overview with the room in plan and opened in 3D, the transient stacked by part, counts over their expectation,
    each object's light over the noise with its significance, the labels, and slices of the scan where it has several
    channels. For geometry and light by part, which a dataset does not hold, the scene is simulated again from the
    stored configuration and seed; counts, labels and significances are the stored ones. Where a room cannot be drawn
    (scenes made in Python, imported captures, mesh files that are gone) only stored measurements and labels are
    drawn.

    out : folder for the pictures; default `DATASET.show` beside the dataset, never inside it.

    Raises
    ------
    InputError : no dataset, no such scene, a shard not committed, a scene that failed, a mesh file that has changed,
        an output that cannot be written.
    """
    stored = read_scene(dataset, index)
    if stored.missing:
        warn(f"{stored.missing}; only what is stored is drawn", InputWarning, stacklevel=2)
    root = Path(dataset).resolve()
    folder = root.with_name(f"{root.name}.show") if out is None else Path(out)
    stem = f"scene-{index:06d}"
    with house_style():
        roomless = why_roomless(stored.config, stored.missing)
        made = pages(stored, replay(stored)) if roomless is None else roomless_pages(stored)
        return [save_png(figure, folder / f"{stem}-{name}.png") for name, figure in made]


def pages(stored: StoredScene, again: Replay, names: Sequence[str] = PAGES) -> Iterator[tuple[str, Figure]]:
    """(name, figure) of the pictures in `names`, made one at a time; `scan` only where there are several channels,
    `evidence` only where there are objects.

    To be used within `house_style()`.
    """
    # Depth is drawn in any case.
    names_known = (*IMAGE_FIELDS, "evidence", *VOLUME_FIELDS)
    wanted = [name for name in names_known if name in stored.arrays or name == "depth"]
    kept = {name: stored.arrays[name] for name in wanted if name in stored.arrays}
    made = make_labels(stored.config.labels, again.scene, [name for name in wanted if name not in kept])
    labels = {name: (kept | made)[name] for name in wanted}
    room = RoomPicture(again.scene, again.capture, again.transient.laser_points, boxes=boxes_of(stored))
    makers: dict[str, Callable[[], Figure | None]] = {
        "overview": lambda: drawn.overview_page(stored, again, room, labels),
        "transient": lambda: drawn.transient_page(stored, again),
        "histogram": lambda: drawn.histogram_page(stored, again),
        "evidence": lambda: evidence_page(stored, again),
        "labels": lambda: drawn.labels_page(stored, again, labels),
        "scan": lambda: drawn.scan_page(stored, again),
    }
    for name in names:
        figure = makers[name]()
        if figure is not None:
            yield name, figure
