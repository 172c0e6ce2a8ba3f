"""A dataset as a folder for the Hugging Face Hub: the dataset itself, unchanged, beside a table for the Hub's viewer.

`dataset/` is the dataset that `TransientDataset` reads; `viewer/SPLIT.parquet` has a row for each scene that could be
made: number, thumbnail, depth label as a picture, what was drawn; `datasets.load_dataset(FOLDER)` reads it.
"""

from __future__ import annotations

import io
import json
import os
import shutil
from collections import Counter
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from numpy.typing import NDArray

from datagen.errors import InputError
from datagen.formats.recording import lattice, recording_of
from datagen.records.arrays import Floats
from datagen.store.card import CARD
from datagen.store.files import read_whole, write_if_changed
from datagen.store.growth import growth_of, is_of_dataset
from datagen.store.scenes import SceneContent, Scenes
from datagen.store.table import TABLE, read_table

VIEWER, DATASET = "viewer", "dataset"
MOST_FILES = 100_000
MOST_IN_A_FOLDER = 10_000
"""Limits of a repository of the Hub: https://huggingface.co/docs/hub/storage-limits."""
_ROWS_AT_ONCE = 100
"""Number of rows whose pictures are in memory together, and in a row group of the file."""
_STRIP = 4
"""Frames of a sequence that its pictures show."""
_THUMBNAIL = 128
"""Pixels of a picture along its longer side, enough to distinguish scenes."""
_IMAGE = {"_type": "Image"}


def write_hub(scenes: Scenes, out: Path) -> list[Path]:
    """Write the folder; returns the paths of its tables and its card. Files of the dataset are linked if possible,
    else copied.

    Raises `InputError` for a dataset that is not complete, or has links or unknown splits, more files than the Hub
    accepts, and an output folder with other files in it.
    """
    root, schema = scenes.root, scenes.manifest.schema
    if not isinstance(root, Path):
        raise InputError(
            f"{root}: a folder for the Hub is made of a dataset in a folder; copy it to this machine first"
        )
    if not (root / TABLE).is_file():
        raise InputError(f"{root}: is not complete; run the same `datagen build` again, then export it")
    there = sorted(root.rglob("*"))
    for path in there:
        if path.is_symlink():
            raise InputError(
                f"{path}: is a symbolic link, and what it leads to may be private; put a copy there (cp -rL copies a "
                "dataset without links), then export it"
            )
    larger = growth_of(root, scenes.manifest)
    if larger is not None and larger.stats is not None:
        raise InputError(
            f"{root}: its growth to {larger.schema.scenes} scenes was interrupted in its last step; run that build "
            "again, then export it"
        )
    files = [path for path in there if path.is_file() and is_of_dataset(root, path, schema)]
    _check_limits(root, files)
    if out.exists() and any(out.iterdir()) and not (out / VIEWER).is_dir():
        raise InputError(f"output {out}: holds other files; name a new or an empty folder")
    card = read_whole(root / CARD).decode("utf-8", "replace")
    table = read_table(root, None, schema.scenes)
    kept = [name for name in table.column_names if not name.startswith(("sha256.", "stats.")) and name != "failure"]
    written = []
    splits, failed = _splits(scenes, table), table["failure"].is_valid().to_pylist()
    for path in files:
        _link(path, out / DATASET / path.relative_to(root))
    (out / VIEWER).mkdir(exist_ok=True)
    names = dict.fromkeys(split for split, no in zip(splits, failed, strict=True) if not no)
    for split in names:
        chosen = [row for row in range(len(splits)) if splits[row] == split and not failed[row]]
        path = out / VIEWER / f"{split}.parquet"
        _write_rows(scenes, table.select(kept), chosen, path)
        written.append(path)
    write_if_changed(out / CARD, _with_configs(card, [str(name) for name in names]).encode())
    return [*written, out / CARD]


def _splits(scenes: Scenes, table: pa.Table) -> list[str | None]:
    """The split of each scene. Files are named after splits, so `InputError` is raised for a split that the dataset
    does not have."""
    splits = table["split"].to_pylist() if "split" in table.column_names else ["train"] * table.num_rows
    known = scenes.manifest.splits().names
    for split in dict.fromkeys(splits):
        if split is not None and split not in known:
            raise InputError(
                f"{scenes.root / TABLE}: split {split!r} is none of {', '.join(known)}; run the same `datagen build` "
                "again to write it anew"
            )
    return splits


def _check_limits(root: Path, files: list[Path]) -> None:
    """Raise `InputError` if a dataset has more files than the Hub accepts."""
    folder, most = max(Counter(path.parent for path in files).items(), key=lambda found: found[1])
    shards = max((len(list(path.iterdir())) for path in root.glob("data.zarr/*/c")), default=0)
    if len(files) > MOST_FILES or max(most, shards) > MOST_IN_A_FOLDER:
        raise InputError(
            f"{root}: {len(files)} files, up to {max(most, shards)} in a folder such as {folder.name}; the Hub takes "
            f"{MOST_FILES} and {MOST_IN_A_FOLDER}: build it with more scenes in a shard (store.scenes_per_shard)"
        )


def _link(path: Path, to: Path) -> None:
    to.parent.mkdir(parents=True, exist_ok=True)
    to.unlink(missing_ok=True)
    try:
        os.link(path, to)
    except OSError:
        shutil.copyfile(path, to)


def _write_rows(scenes: Scenes, table: pa.Table, rows: list[int], path: Path) -> None:
    """Write one Parquet file, a group of rows at a time, because the pictures of all rows may not fit into memory."""
    writer: pq.ParquetWriter | None = None
    for begin in range(0, len(rows), _ROWS_AT_ONCE):
        some = rows[begin : begin + _ROWS_AT_ONCE]
        shown = [_pictures(scenes.read(row)) for row in some]
        part = table.take(some)
        kind = pa.struct([("bytes", pa.binary()), ("path", pa.string())])
        pictures = list(shown[0])
        for place, name in enumerate(pictures):
            images = [
                {"bytes": png[name], "path": f"{name}-{row:06d}.png"} for png, row in zip(shown, some, strict=True)
            ]
            part = part.add_column(1 + place, name, pa.array(images, kind))
        part = part.replace_schema_metadata({"huggingface": json.dumps({"info": {"features": _features(part)}})})
        writer = writer or pq.ParquetWriter(path, part.schema, compression="zstd")
        writer.write_table(part)
    if writer is not None:
        writer.close()


def _features(table: pa.Table) -> dict[str, Any]:
    """Column → its type in the `datasets` library."""
    features: dict[str, Any] = {}
    for column in table.schema:
        if pa.types.is_struct(column.type):
            features[column.name] = _IMAGE
        else:
            kind = {"double": "float64"}.get(str(column.type), str(column.type))
            features[column.name] = {"dtype": kind, "_type": "Value"}
    return features


def _pictures(scene: SceneContent) -> dict[str, bytes]:
    """Name → PNG: `thumbnail`, the detections of each point on the wall (or of each pair over time, if the points
    form no grid), and `depth`; of sequences some frames side by side."""
    frames = scene.manifest.frames
    every = [scene]
    if frames is not None:
        every = [
            scene.at_frame(k) for k in np.unique(np.linspace(0, frames - 1, _STRIP).round().astype(int)).tolist()
        ]
    pictures = {"thumbnail": _png(np.concatenate([_thumbnail(one) for one in every], axis=1), "inferno")}
    if "depth" in scene.arrays:
        depth = np.concatenate([one.arrays["depth"] for one in every], axis=1)
        pictures["depth"] = _png(np.where(depth > 0, depth, np.nan), "viridis_r")
    return pictures


def _thumbnail(scene: SceneContent) -> Floats:
    """(row, column) image of the measurement of a scene."""
    try:
        m = recording_of(scene).on_wall()
    except InputError:
        # A flood and an unknown wall have no points to draw at.
        name = next((name for name in ("histogram", "transient") if name in scene.arrays), None)
        values = scene.arrays[name] if name is not None else np.zeros((1, 1, 1))
        return _streaks(values)
    place = lattice(m.seen_points)
    if place is None or min(place.shape) < 4:
        return _streaks(m.values)
    whole = m.values.sum(axis=-1, dtype=np.float64)
    return np.asarray((whole[:, 0] if m.paired else whole.sum(axis=0))[place.T[::-1]])


def _streaks(values: NDArray[Any]) -> Floats:
    rows = values.reshape(-1, values.shape[-1])[: 4 * _THUMBNAIL].astype(np.float64)
    starts = np.arange(0, rows.shape[1], -(-rows.shape[1] // _THUMBNAIL))
    return np.asarray(np.log1p(np.add.reduceat(rows, starts, axis=1)))


def _png(image: NDArray[Any], colors: str) -> bytes:
    """A PNG of an image in the colours of a colormap; NaN becomes transparent."""
    from matplotlib import colormaps
    from matplotlib.image import imsave

    finite = image[np.isfinite(image)]
    low, high = (float(finite.min()), float(finite.max())) if finite.size else (0.0, 0.0)
    scaled = (image - low) / (high - low) if high > low else np.where(np.isfinite(image), 0.5, np.nan)
    enlarged = max(1, _THUMBNAIL // max(image.shape))
    pixels = colormaps[colors](np.ma.masked_invalid(scaled.repeat(enlarged, 0).repeat(enlarged, 1)), bytes=True)
    sink = io.BytesIO()
    imsave(sink, pixels, format="png", pil_kwargs={"pnginfo": None})
    return sink.getvalue()


def _with_configs(card: str, splits: list[str]) -> str:
    """The card of the dataset, with a header that names the tables in `viewer` as its rows."""
    configs = [
        {
            "config_name": "scenes",
            "default": True,
            "data_files": [{"split": name, "path": f"{VIEWER}/{name}.parquet"} for name in splits],
        }
    ]
    lines = card.replace("PATH", f"PATH/{DATASET}").split("\n")
    return "\n".join(f"configs: {json.dumps(configs)}" if line.startswith("configs: ") else line for line in lines)
