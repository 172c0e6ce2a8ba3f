"""A dataset in use: read while a build makes it grow, and where nothing may be written."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
import tempfile
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import torch
from damage import told
from fake_samples import build_fakes, fake_sample, noisy_config, sequence_config, small_config
from here_and_now import one_worker_here

from datagen.config import DatasetConfig
from datagen.errors import InputError
from datagen.loader import TransientDataset
from datagen.records import Sample
from datagen.store import reader, shard, verify
from datagen.store.info import info

FIELDS = ("histogram", "depth", "laser_points")


def values(data: TransientDataset) -> list[dict[str, torch.Tensor]]:
    return [data[item] for item in range(len(data))]


def same(found: list[dict[str, torch.Tensor]], due: list[dict[str, torch.Tensor]]) -> bool:
    return all(torch.equal(a[name], b[name]) for a, b in zip(found, due, strict=True) for name in a)


@pytest.mark.parametrize("made_of", [small_config, sequence_config], ids=["scenes", "sequences"])
@pytest.mark.parametrize("memory", [0, reader.MEMORY_BYTES])
def test_an_opened_dataset_stays_as_it_was_when_it_grows(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, memory: int, made_of: Callable[..., DatasetConfig]
) -> None:
    """Its last shard is then made anew, with more scenes. One is read before that, and one first read after it."""
    monkeypatch.setattr(reader, "MEMORY_BYTES", memory)
    root = tmp_path / "set"
    with one_worker_here():
        build_fakes(made_of(scenes=10), root)
        read, unread = TransientDataset(root, FIELDS), TransientDataset(root, FIELDS, split="train")
        due, kinds, stats = values(read), read.parameters("kind").tolist(), TransientDataset(root, FIELDS).stats
        build_fakes(made_of(scenes=18), root)
    assert len(TransientDataset(root)) == 18 and len(read) == 10
    assert same(values(read), due) and same(values(unread), [due[scene] for scene in unread.scenes])
    assert read.parameters("kind").tolist() == kinds and read.stats == stats


@one_worker_here()
def test_reading_beside_a_build_gives_right_values_or_one_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """At every scene that is made, and before every file of a shard is written."""
    root, found = tmp_path / "set", Counter[str]()
    build_fakes(small_config(scenes=10), root)
    due = values(TransientDataset(root, FIELDS))
    opened = [TransientDataset(root, FIELDS) for _ in range(2)]
    values(opened[0])

    def look() -> None:
        opened[1]._reader = None  # as a worker that begins now
        for name, call in {
            "open": lambda: same(values(TransientDataset(root, FIELDS))[:10], due),
            "read before": lambda: same(values(opened[0]), due),
            "read first now": lambda: same(values(opened[1]), due),
            "info": lambda: bool(info(root)),
            "verify": lambda: verify(root, deep=True).problems == (),
            "parameters": lambda: len(opened[1].parameters("kind")) == 10,
        }.items():
            outcome = told(call)
            assert outcome in (True, None), name
            found[f"{name}: {'right' if outcome else 'one line'}"] += 1

    def sample(config: DatasetConfig, index: int) -> Sample:
        look()
        return fake_sample(config, index)

    def write(path: Path, content: bytes) -> Any:
        look()
        return written(path, content)

    written = shard._write_new
    monkeypatch.setattr(shard, "_write_new", write)
    build_fakes(small_config(scenes=14), root, sample_function=sample)
    assert len(found) == 6 and all(name.endswith(": right") and times > 20 for name, times in found.items()), found
    assert verify(root, deep=True).problems == ()


READ_ALL = """
import json, sys
import datagen as dg
from datagen.cli import run
from datagen.loader import collate
from torch.utils.data import DataLoader

root, out = sys.argv[1:]
data = dg.TransientDataset(root, ("histogram", "depth"), redraw_noise=True)
batches = [*DataLoader(data, 4, num_workers=1, collate_fn=collate), *DataLoader(data, 4, collate_fn=collate)]
status = {
    "scenes": sum(len(batch["scene"]) for batch in batches),
    **{" ".join(command): run([command[0], root, *command[1:]]) for command in (
        ["info"], ["verify", "--deep"], ["digest"], ["preview", "--scenes=0", "--out", out + "/page.html"],
        ["preview", "--scenes=0"], ["show", "0"], ["export", out + "/npz", "--format=npz"],
        ["export", root + "/npz", "--format=npz"],
    )},
    "grow": run(["build", out + "/c.yaml", root, "--scenes=16", "--quiet"]),
}
print("STATUS" + json.dumps(status))
"""


def test_a_dataset_that_may_only_be_read(tmp_path: Path) -> None:
    """Permissions bind root only where it gives up the right to pass over them."""
    bound: list[str] = []
    if os.geteuid() == 0:
        if shutil.which("setpriv") is None:
            pytest.skip("root may write everywhere, and there is no setpriv to give that up")
        bound = ["setpriv", "--bounding-set=-dac_override,-dac_read_search"]
    home, out = tmp_path / "home", tmp_path / "out"
    root = home / "set"
    out.mkdir()
    with one_worker_here():
        build_fakes(noisy_config(), root)
    (out / "c.yaml").write_text(noisy_config().model_dump_json())
    places = [home, *home.rglob("*")]
    before = {path: path.stat().st_mtime_ns for path in places}
    for path in places:
        path.chmod(path.stat().st_mode & ~0o222)
    try:
        done = subprocess.run(
            [*bound, sys.executable, "-c", READ_ALL, str(root), str(out)], capture_output=True, text=True, check=False
        )
    finally:
        for path in places:
            path.chmod(path.stat().st_mode | 0o200)
    (line,) = [line for line in done.stdout.splitlines() if line.startswith("STATUS")] or [done.stderr]
    status = json.loads(line.removeprefix("STATUS"))
    refused = {"preview --scenes=0", "show 0", f"export {root}/npz --format=npz", "grow"}
    assert status.pop("scenes") == 24
    assert {name: code for name, code in status.items() if code} == dict.fromkeys(refused, 2)
    lines = done.stderr.splitlines()
    assert len(lines) == len(refused) and all("cannot be written (Permission denied); name" in one for one in lines)
    assert {path: path.stat().st_mtime_ns for path in [home, *home.rglob("*")]} == before


@one_worker_here()
def test_a_build_changes_nothing_where_one_of_its_folders_cannot_be_written(
    dataset: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As of a dataset that was made by somebody else in part."""
    locked = dataset / "data.zarr/depth/c"

    def refuse(make: Callable[..., Any]) -> Callable[..., Any]:
        def made(*arguments: Any, dir: Any = None, **options: Any) -> Any:
            if dir == locked:
                raise PermissionError(13, "Permission denied")
            return make(*arguments, dir=dir, **options)

        return made

    monkeypatch.setattr("tempfile.TemporaryFile", refuse(tempfile.TemporaryFile))
    before = {path: path.read_bytes() for path in dataset.rglob("*") if path.is_file()}
    with pytest.raises(InputError, match=r"data\.zarr/depth/c cannot be written \(Permission denied\)"):
        build_fakes(small_config(scenes=16), dataset)
    assert {path: path.read_bytes() for path in dataset.rglob("*") if path.is_file()} == before
