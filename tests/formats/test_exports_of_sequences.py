"""Exports of sequences: all frames in one file, or a file for each of them."""

from __future__ import annotations

import io
from pathlib import Path

import numpy as np
import pytest
import trimesh
from datasets import write_dataset

from datagen.config import config_from_mapping
from datagen.errors import InputError
from datagen.formats import export
from datagen.store.scenes import Scenes


@pytest.fixture(scope="module")
def walks(tmp_path_factory: pytest.TempPathFactory) -> Path:
    config = config_from_mapping({
        "scenes": 2, "seed": 4, "name": "walks", "transport": {"target": 0.3},
        "sequence": {"frames": 3, "rate_hz": 2},
        "scene": {"contents": [{"kind": "box", "motion": {"kind": "walk", "speed_m_s": 1.0}}]},
        "capture": {"scan": {"rows": 4, "columns": 4}, "time": {"bins": 64, "bin_width_ps": 800}},
        "detector": {"cycles": 10_000}, "labels": {"rows": 6, "columns": 6},
        "store": {"fields": ["histogram", "depth", "part_id", "objects", "occupancy"]},
    })  # fmt: skip
    return write_dataset(config, tmp_path_factory.mktemp("walks") / "set")


def test_files_of_all_frames(walks: Path, tmp_path: Path) -> None:
    stored = Scenes(walks).read(1).arrays
    with np.load(export(walks, tmp_path, "npz", [1])[0]) as file:
        for name, values in stored.items():
            np.testing.assert_array_equal(file[name], values)


def test_a_file_for_each_frame(walks: Path, tmp_path: Path) -> None:
    content = Scenes(walks).read(1)
    h5py = pytest.importorskip("h5py")
    names = [path.name for path in export(walks, tmp_path / "tal", "tal")]
    assert names == [f"scene-00000{s}-frame-0000{f}.hdf5" for s in range(2) for f in range(3)]
    places = list[np.ndarray]()
    for frame in range(3):
        with h5py.File(tmp_path / f"tal/scene-000001-frame-0000{frame}.hdf5") as file:
            assert int(file["H"][()].sum()) == int(content.arrays["histogram"][frame].sum())
        (path,) = export(walks, tmp_path / "glb", "glb", [1], frame=frame)
        room = trimesh.load(path)
        places.append(room.geometry["box"].vertices.mean(axis=0))
    moved = np.linalg.norm(np.diff(places, axis=0), axis=1)
    due = np.linalg.norm(np.diff(content.arrays["object_box_center"][:, 0], axis=0), axis=1)
    np.testing.assert_allclose(moved, due, atol=1e-4)
    assert (due > 0.2).all()


def test_the_hub_shows_frames_side_by_side(walks: Path, tmp_path: Path) -> None:
    pq = pytest.importorskip("pyarrow.parquet")
    image = pytest.importorskip("PIL.Image")
    export(walks, tmp_path, "hub")
    rows = [row for path in (tmp_path / "viewer").glob("*.parquet") for row in pq.read_table(path).to_pylist()]
    assert len(rows) == 2
    size = image.open(io.BytesIO(rows[0]["depth"]["bytes"])).size
    assert size[0] == 3 * size[1]


def test_what_does_not_fit_is_one_line(walks: Path, tmp_path: Path) -> None:
    for options, words in (
        ({"format": "mat", "frame": 3}, "frame = 3: must be one of 0 … 2"),
        ({"format": "mat", "frame": True}, "frame = True"),
        ({"format": "npz", "frame": 0}, "frame = 0: files of this format hold all frames"),
    ):
        with pytest.raises(InputError, match=words):
            export(walks, tmp_path / "no", **options)  # type: ignore[arg-type]
