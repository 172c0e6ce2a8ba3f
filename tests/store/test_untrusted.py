"""Datasets and configurations from anywhere: each is refused in one line with status 2, in bounded time and memory,
and nothing outside of the folder is touched."""

from __future__ import annotations

import json
import os
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import google_crc32c
import numpy as np
import pyarrow.parquet as pq
import pytest
from damage import reseal, told
from fake_samples import build_fakes, small_config
from limits import little_memory

import datagen as dg
from datagen.cli import run
from datagen.errors import CheckError, InputError
from datagen.formats import export
from datagen.loader import TransientDataset
from datagen.store import verify
from datagen.store.files import sha256_of
from datagen.store.info import info

pytestmark = pytest.mark.usefixtures("builds_here")


Change = Callable[[dict[str, Any]], object]


def field(**changes: Any) -> Change:
    """Change the first row of the fields."""
    return lambda values: values["fields"][0].update(changes)


def renamed(name: str) -> Change:
    def change(values: dict[str, Any]) -> None:
        old = values["fields"][-1]["name"]
        values["fields"][-1]["name"] = name
        values["metadata"][f"data.zarr/{name}/zarr.json"] = values["metadata"].pop(f"data.zarr/{old}/zarr.json")

    return change


def resized(row: int, size: Any) -> Change:
    """Another last size of a field, in all the places that state it."""

    def change(values: dict[str, Any]) -> None:
        for key in ("shape", "chunk", "shard"):
            if values["fields"][row][key] is not None:
                values["fields"][row][key][-1] = size

    return change


def scenes(number: int) -> Change:
    def change(values: dict[str, Any]) -> None:
        values["scenes"] = number
        for row in values["fields"]:
            row["shape"][0] = number

    return change


HOSTILE: dict[str, Change] = {
    "a name that leaves the folder": renamed("../../x"),
    "a name with an escape": renamed("\x1b[31mred"),
    "the same name twice": renamed("histogram"),
    "a negative size": resized(0, -16),
    "a size that is no integer": resized(0, 16.5),
    "8 GB of a small field": resized(-1, 2**30),
    "8 EB of a scene": resized(0, 2**60),
    "no sizes": field(shape=[]),
    "fewer axes than sizes": field(dims=["scene"]),
    "objects": field(dtype="object"),
    "other chunks": field(chunk=[1, 1, 1, 1]),
    "10¹² scenes": scenes(10**12),
    "−1 scenes": scenes(-1),
    "no fields": lambda values: values.update(fields=[]),
    "shards of 10⁹ scenes": lambda values: values.update(scenes_per_shard=10**9),
    "metadata elsewhere": lambda values: values["metadata"].update({"../../../etc/passwd": "0" * 64}),
    "no origin": lambda values: values.update(made_by={}),
    "an origin of lists": lambda values: values["made_by"].update(datagen=[[]]),
    "no configuration": lambda values: values.update(config={}),
    "an infinite time axis": lambda values: values["config"]["capture"]["time"].update(start_ns=float("inf")),
    "a format of the future": lambda values: values.update(format=10**9),
    "a format of before 1.0": lambda values: values.update(format="datagen dataset", schema_version=22),
}  # fmt: skip


@pytest.mark.parametrize("harm", HOSTILE)
def test_a_hostile_manifest_is_one_line(dataset: Path, capsys: pytest.CaptureFixture[str], harm: str) -> None:
    reseal(dataset / "dataset.json", HOSTILE[harm])
    before = sorted(dataset.parent.rglob("*"))
    with little_memory():
        for command in (["info"], ["verify", "--deep"], ["show", "0"]):
            assert run([command[0], str(dataset), *command[1:]]) == 2
            out, err = capsys.readouterr()
            assert out == "" and err.count("\n") == 1 and "dataset.json" in err and "\x1b" not in err
        with pytest.raises(InputError, match=r"dataset\.json"):
            TransientDataset(dataset)
    assert sorted(dataset.parent.rglob("*")) == before


def test_json_that_no_parser_should_swallow(dataset: Path) -> None:
    for name in ("dataset.json", "build/shard-000000.json", "croissant.json"):
        kept = (dataset / name).read_bytes()
        for text in (
            "[" * 10**6, '{"a":' * 10**5, '{"format": 1e999}', '{"a": 1' + "0" * 5000 + "}",
            '{"format": "\\ud800"}', "\xff", "NaN", '{"format": true}',
        ):  # fmt: skip
            (dataset / name).write_bytes(text.encode("latin-1"))
            with pytest.raises((InputError, CheckError), match=name) as refused:
                TransientDataset(dataset)[0]
            assert "\n" not in str(refused.value)
        (dataset / name).write_bytes(kept)


def test_files_without_end_are_not_read_to_it(dataset: Path) -> None:
    with little_memory():
        for name in ("dataset.json", "build/shard-000000.json", "README.md", "croissant.json", "data.zarr/zarr.json"):
            path = dataset / name
            kept = path.read_bytes()
            os.truncate(path, 2**36)
            assert told(lambda: verify(dataset, deep=True).problems) != ()
            for endless in (lambda of: of.symlink_to("/dev/zero"), os.mkfifo):
                path.unlink()
                endless(path)
                assert told(lambda: verify(dataset, deep=True).problems) != ()
            path.unlink()
            path.write_bytes(kept)


def test_a_record_names_its_own_files_only(dataset: Path) -> None:
    def elsewhere(values: dict[str, Any]) -> None:
        values["files"]["../../secret"] = values["files"].pop("data.zarr/depth/c/0/0/0")

    reseal(dataset / "build/shard-000000.json", elsewhere)
    assert verify(dataset).problems[0] == "shard 0: its record lists other files than the shard has"
    with pytest.raises(CheckError, match="lists other files"):
        TransientDataset(dataset)[0]


def test_millions_of_missing_shards_are_one_line(dataset: Path) -> None:
    """Only shards that exist are read, whatever number the manifest claims."""
    reseal(dataset / "dataset.json", scenes(100_000_000))
    problems = verify(dataset).problems
    assert len(problems) < 5 and any(problem.startswith("shards 3-24999999: not there") for problem in problems)
    assert "of 100000000" in info(dataset)
    with pytest.raises(InputError, match=r"24999997 of 25000000 shards are not committed, the first is 3"):
        TransientDataset(dataset)
    with pytest.raises(InputError, match="must be ≥ 1 and ≤ 100000000"):
        build_fakes(small_config(), dataset.parent / "new", scenes=10**12)


def test_a_chunk_that_claims_more_than_it_holds_is_refused(dataset: Path) -> None:
    """The checksum is right, and blosc itself would trust the length in the chunk's header."""
    path = dataset / "data.zarr/laser_points/c/0/0/0"
    body = bytearray(path.read_bytes()[:-4])
    for place, value in ((4, 2**31 - 1), (12, 10**6)):
        harmed = body[:place] + value.to_bytes(4, "little") + body[place + 4 :]
        path.write_bytes(bytes(harmed) + google_crc32c.value(bytes(harmed)).to_bytes(4, "little"))
        for check in (True, False):
            with little_memory(), pytest.raises(CheckError, match="belong"):
                TransientDataset(dataset, ("laser_points",), check=check)[0]
    os.truncate(path, 2**36)
    with little_memory(), pytest.raises(CheckError, match="the checksum does not match"):
        TransientDataset(dataset, ("laser_points",), check=False)[0]


def test_an_index_that_asks_for_much_gets_nothing(dataset: Path) -> None:
    path = dataset / "data.zarr/histogram/c/0/0/0/0"
    data = path.read_bytes()
    index = np.frombuffer(data[-68:-4], "<u8").copy()
    for offset, size in ((0, 2**62), (2**63, 10), (0, 3)):
        index[:2] = offset, size
        path.write_bytes(data[:-68] + index.tobytes() + google_crc32c.value(index.tobytes()).to_bytes(4, "little"))
        with pytest.raises(CheckError, match="scene 0: the checksum does not match"):
            TransientDataset(dataset, ("histogram",))[0]


def snapshot(folder: Path) -> dict[str, tuple[int, bytes]]:
    return {str(p): (p.stat().st_mtime_ns, p.read_bytes()) for p in folder.rglob("*") if p.is_file()}


@pytest.mark.parametrize("inside", ["data.zarr", "data.zarr/depth", "data.zarr/depth/c/0", "build", "README.md"])
def test_a_build_follows_no_link_out_of_its_folder(dataset: Path, tmp_path: Path, inside: str) -> None:
    """The shard is damaged, so that a build would delete and write it."""
    outside = tmp_path / "outside"
    shutil.move(dataset / inside, outside)
    (dataset / inside).symlink_to(outside)
    if inside != "README.md":
        (dataset / "data.zarr/depth/c/0/0/0").write_bytes(b"mine")
    # Found before anything is touched, but for what only the writer of a shard looks at.
    untouched = outside if inside == "data.zarr/depth/c/0" else tmp_path
    before = snapshot(untouched)
    with pytest.raises(InputError, match="is a symbolic link"):
        build_fakes(small_config(), dataset)
    assert snapshot(untouched) == before


def test_a_build_writes_through_no_link_that_stands_in_for_a_file_of_its_own(dataset: Path, tmp_path: Path) -> None:
    outside = tmp_path / "outside"
    outside.write_text("years of work")
    (dataset / f"README.md.{os.getpid()}.partial").symlink_to(outside)
    (dataset / "README.md").unlink()
    # The dataset itself may be a link.
    (tmp_path / "link").symlink_to(dataset)
    assert build_fakes(small_config(), tmp_path / "link").complete
    (dataset / "build/shard-000000.running").symlink_to(outside)
    (dataset / "build/shard-000000.json").unlink()
    with pytest.raises(CheckError, match=r"shard-000000\.running"):
        build_fakes(small_config(), dataset)
    assert outside.read_text() == "years of work"


@pytest.mark.parametrize("inside", ["data.zarr", "data.zarr/depth/c/0/0/0", "README.md", "more"])
def test_a_folder_for_the_hub_has_nothing_that_links_lead_to(dataset: Path, tmp_path: Path, inside: str) -> None:
    """It is made to be published."""
    secret = tmp_path / "secret"
    if (dataset / inside).exists():
        shutil.move(dataset / inside, secret)
    else:
        secret.write_text("key")
    (dataset / inside).symlink_to(secret)
    with pytest.raises(InputError, match=f"{inside}: is a symbolic link, .*cp -rL"):
        export(dataset, tmp_path / "hub", "hub")
    assert not (tmp_path / "hub").exists()


def test_files_are_named_after_splits_of_the_dataset_alone(dataset: Path, tmp_path: Path) -> None:
    table = pq.read_table(dataset / "samples.parquet")
    place = table.column_names.index("split")
    pq.write_table(
        table.set_column(place, "split", [["../../../secret"] * table.num_rows]), dataset / "samples.parquet"
    )
    card = json.loads((dataset / "croissant.json").read_text())
    card["distribution"][0]["sha256"] = sha256_of(dataset / "samples.parquet")
    (dataset / "croissant.json").write_text(json.dumps(card))
    with pytest.raises(
        InputError, match=r"samples\.parquet: split '\.\./\.\./\.\./secret' is none of train, val, test"
    ):
        export(dataset, tmp_path / "a/b/hub", "hub")
    assert not (tmp_path / "a").exists() and not list(tmp_path.rglob("secret*"))


def test_values_come_through_links_only_where_checksums_vouch_for_them(dataset: Path, tmp_path: Path) -> None:
    """Caches of downloads keep the files of a dataset elsewhere, and link to them."""
    name = dataset / "data.zarr/depth/c/0/0/0"
    due = TransientDataset(dataset)[0]["depth"]
    shutil.move(name, tmp_path / "blob")
    name.symlink_to(tmp_path / "blob")
    assert verify(dataset, deep=True).problems == () and (TransientDataset(dataset)[0]["depth"] == due).all()
    for other in (dataset / "data.zarr/depth/c/1/0/0", Path("/etc/passwd"), tmp_path):
        name.unlink()
        name.symlink_to(other)
        with pytest.raises(CheckError, match="run the same `datagen build` again"):
            TransientDataset(dataset)[0]
    for linked in ("dataset.json", "build/shard-000000.json", "croissant.json"):
        kept = (dataset / linked).read_bytes()
        (dataset / linked).unlink()
        (dataset / linked).symlink_to("/etc/passwd")
        with pytest.raises((InputError, CheckError), match=linked) as refused:
            TransientDataset(dataset)[0]
        assert "root:" not in str(refused.value) and "\n" not in str(refused.value)
        (dataset / linked).unlink()
        (dataset / linked).write_bytes(kept)


READS: dict[str, Change] = {
    "a device": lambda values: values["config"]["capture"].update(device="SECRET.yaml"),
    "a map of zones": lambda values: values["config"]["capture"].update(
        device=dg.device("tmf8820").model_dump(mode="json") | {"zones": {"map": "SECRET.npz"}}
    ),
    "edges": lambda values: values["config"]["detector"].update(tdc_edges_ps="SECRET.csv"),
}


@pytest.mark.parametrize("what", READS)
def test_a_stored_configuration_reads_no_file(
    dataset: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], what: str
) -> None:
    for suffix in ("yaml", "npz", "csv"):
        (tmp_path / f"secret.{suffix}").write_text("key: hunter2")

    def change(values: dict[str, Any]) -> None:
        READS[what](values)
        values["config"] = json.loads(json.dumps(values["config"]).replace("SECRET", str(tmp_path / "secret")))

    reseal(dataset / "dataset.json", change)
    before = sorted(tmp_path.rglob("*"))
    for command in (
        ["show", str(dataset), "0"],
        ["preview", str(dataset)],
        ["verify", str(dataset), "--resimulate=1"],
        ["replay", str(dataset), "0"],
    ):
        assert run(command) == 2
        out, err = capsys.readouterr()
        assert err.count("\n") == 1 and "a path, where a dataset has the values" in err
        # What verify found before it came to the scenes.
        found = "dataset.json: its configuration is not the one its fingerprint was taken of\n"
        assert out == (found if command[0] == "verify" else "") and "hunter2" not in err
    with pytest.raises(InputError, match=r"redraw_noise: .* a path, where a dataset has the values"):
        TransientDataset(dataset, redraw_noise=True)
    assert sorted(tmp_path.rglob("*")) == before


def test_no_escape_sequence_reaches_a_terminal_or_the_card(
    dataset: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    evil = "\x1b]0;owned\x07\x9b31m\u202e"
    reseal(dataset / "dataset.json", lambda values: values["config"].update(name=evil, description=evil))
    reseal(dataset / "build/shard-000001.json", lambda values: values["scenes"][0].update(failure=evil))
    for command in ("verify", "info"):
        run([command, str(dataset)])
    run(["info", str(tmp_path / evil)])
    described = small_config(scenes=1, name=evil, description=f"\r{evil}\r\ntwo\u2028")
    build_fakes(described, tmp_path / "new")
    assert verify(tmp_path / "new").problems == () and build_fakes(described, tmp_path / "new").built == 0
    shown = "".join(capsys.readouterr()) + (tmp_path / "new/README.md").read_text(encoding="utf-8")
    assert "owned" in shown and not [c for c in shown if c != "\n" and not c.isprintable()]


BOMB = "a: &a [x, x, x, x, x, x, x, x, x]\n" + "".join(
    f"{name}: &{name} [{', '.join(['*' + below] * 9)}]\n"
    for below, name in zip("abcdefghijk", "bcdefghijkl", strict=True)
)


def test_a_hostile_configuration_is_one_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for text, piece in (
        (BOMB, "aliases make it hold 100000 values"),
        ("seed: " + "9" * 5000, "4300 digits"),
        ("seed: 0x" + "f" * 5000, "4300 digits"),
        ("scene: " + "[" * 900, "nested too deeply"),
        ("name: " + "x" * 2**19, "characters; shorten it"),
        ("capture: {time: {start_ns: .inf}}", "capture.time.start_ns"),
        ("capture: {time: {start_ns: .nan}}", "capture.time.start_ns"),
    ):
        (tmp_path / "c.yaml").write_text(text)
        with little_memory():
            assert run(["build", str(tmp_path / "c.yaml"), str(tmp_path / "out")]) == 2
        out, err = capsys.readouterr()
        assert out == "" and err.count("\n") == 1 and piece in err
    assert os.listdir(tmp_path) == ["c.yaml"]
