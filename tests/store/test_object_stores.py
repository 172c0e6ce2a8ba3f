"""Datasets in an object store: a real server on this machine, and the same words as for folders."""

from __future__ import annotations

import pickle
import shutil
import urllib.request
import warnings
from collections.abc import Iterator
from contextlib import suppress
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import pytest
import torch
from fake_samples import build_fakes, fake_sample, file_of, sequence_config, small_config
from here_and_now import one_worker_here

from datagen.building import replay
from datagen.building.build import BuildResult
from datagen.cli import run
from datagen.config import DatasetConfig
from datagen.errors import CheckError, InputError
from datagen.formats import export
from datagen.loader import TransientDataset
from datagen.store import verify
from datagen.store.info import info
from datagen.store.location import Bucket, _store_of, location_of
from datagen.store.scenes import Scenes
from datagen.store.verify import dataset_digest

obstore = pytest.importorskip("obstore", reason="the extra s3 is not installed")
if find_spec("moto") is None:
    pytest.skip("moto is not installed", allow_module_level=True)

ADDRESS = "s3://rooms/of/set.zarr"
FIELDS = ("histogram", "transient", "depth")


@pytest.fixture(scope="module")
def server() -> Iterator[str]:
    from moto.server import ThreadedMotoServer

    running = ThreadedMotoServer("127.0.0.1", 0, verbose=False)
    running.start()
    yield "http://{}:{}".format(*running.get_host_and_port())
    running.stop()


@pytest.fixture
def bucket(server: str, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Bucket:
    for key, value in {
        "AWS_ACCESS_KEY_ID": "a", "AWS_SECRET_ACCESS_KEY": "b", "AWS_REGION": "us-east-1",
        "AWS_ENDPOINT_URL": server, "DATAGEN_STAGING": str(tmp_path / "staging"),
    }.items():  # fmt: skip
        monkeypatch.setenv(key, value)
    urllib.request.urlopen(urllib.request.Request(f"{server}/rooms", method="PUT"), timeout=30)
    found = location_of(ADDRESS)
    assert isinstance(found, Bucket)
    if old := [str(key) for key in found._below()]:
        obstore.delete(_store_of(found.bucket), old)
    return found


def two_shards(seed: int = 3) -> DatasetConfig:
    """The server takes milliseconds for each of its answers, of which a shard needs hundreds."""
    return small_config(scenes=8, seed=seed)


def built(config: DatasetConfig | None = None, **options: Any) -> BuildResult:
    return build_fakes(config or two_shards(), ADDRESS, **options)


@pytest.fixture(
    scope="module",
    params=[
        pytest.param(small_config, id="scenes"),
        # A store has objects, whatever axes the fields in them have.
        pytest.param(sequence_config, id="sequences", marks=pytest.mark.nightly),
    ],
)
def config(request: pytest.FixtureRequest) -> DatasetConfig:
    made: DatasetConfig = request.param(scenes=8)
    return made


@pytest.fixture(scope="module")
def local(config: DatasetConfig, tmp_path_factory: pytest.TempPathFactory) -> Path:
    root = tmp_path_factory.mktemp("local") / "set"
    build_fakes(config, root)
    return root


def test_a_dataset_in_a_store_equals_one_in_a_folder(
    bucket: Bucket, config: DatasetConfig, local: Path, tmp_path: Path
) -> None:
    """All that is read of it: items here and in a worker, columns, single scenes, exports. A folder for the Hub is
    made of a folder."""
    result = built(config)
    assert result.complete and str(result.path) == ADDRESS
    assert verify(ADDRESS, deep=True).problems == () and dataset_digest(ADDRESS) == dataset_digest(local)
    windows = {} if config.sequence is None else {"frames": 2}
    there, here = (TransientDataset(path, FIELDS, **windows) for path in (ADDRESS, local))
    sent = pickle.loads(pickle.dumps(there))
    for scene in range(8):
        assert all(torch.equal(data[scene][name], here[scene][name]) for data in (there, sent) for name in FIELDS)
    assert there.parameters("kind").tolist() == here.parameters("kind").tolist()
    assert info(ADDRESS).split("seconds per scene")[0] == info(local).split("seconds per scene")[0]
    assert Scenes(ADDRESS).made() == Scenes(local).made()
    exported = [export(dataset, tmp_path / f"{k}", "npz", [5])[0] for k, dataset in enumerate((ADDRESS, local))]
    assert exported[0].read_bytes() == exported[1].read_bytes()
    with pytest.raises(InputError, match=f"{ADDRESS}: a folder for the Hub is made of a dataset in a folder"):
        export(ADDRESS, tmp_path / "hub", "hub")
    unread = TransientDataset(ADDRESS, ("histogram",))
    forked = torch.utils.data.DataLoader(unread, 4, num_workers=1, multiprocessing_context="fork")
    with warnings.catch_warnings(), pytest.raises(CheckError, match="do not survive a fork"):
        warnings.simplefilter("ignore", DeprecationWarning)
        next(iter(forked))
    names = {key.relative_to(bucket.key).as_posix() for key in bucket._below()}
    assert names == {path.relative_to(local).as_posix() for path in local.rglob("*") if path.is_file()}
    # The folder it was made in is not needed any more.
    shutil.rmtree(tmp_path / "staging")
    again = built(config)
    assert (again.built, again.kept) == (0, 2)
    grown = built(config, scenes=12)
    assert (grown.built, grown.kept, grown.complete) == (1, 2, True) and verify(ADDRESS).problems == ()


def test_a_scene_is_made_again_from_there(
    bucket: Bucket, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(replay, "simulate_sample", fake_sample)
    built()
    with one_worker_here():
        assert run(["replay", ADDRESS, "5"]) == 0
    assert capsys.readouterr().out.startswith(f"{ADDRESS}, scene 5: made again")
    assert (replay.replay(ADDRESS, 5).arrays["histogram"] == Scenes(ADDRESS).read(5).arrays["histogram"]).all()


@pytest.mark.parametrize("puts", [17, *(pytest.param(n, marks=pytest.mark.nightly) for n in (1, 6, 11))])
def test_an_interrupted_upload_is_resumed(
    bucket: Bucket, config: DatasetConfig, local: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, puts: int
) -> None:
    """Whatever the last object was; with the folder that shards were made in, and (odd numbers) without."""
    left, whole = puts, Bucket.put

    def put(self: Bucket, file: Path) -> None:
        nonlocal left
        left -= 1
        if left < 0:
            raise KeyboardInterrupt
        whole(self, file)

    with monkeypatch.context() as patch:
        patch.setattr(Bucket, "put", put)
        with pytest.raises(KeyboardInterrupt):
            built(config)
    with suppress(InputError):
        assert verify(ADDRESS).problems != ()
        with pytest.raises(InputError, match="not committed"):
            TransientDataset(ADDRESS)
    if puts % 2:
        shutil.rmtree(tmp_path / "staging")
    built(config)
    assert verify(ADDRESS, deep=True).problems == () and dataset_digest(ADDRESS) == dataset_digest(local)


@pytest.mark.parametrize("puts", [25, *(pytest.param(n, marks=pytest.mark.nightly) for n in (0, 10, 40, 47, 48))])
def test_a_growth_that_is_interrupted_leaves_the_dataset_what_it_was(
    bucket: Bucket, config: DatasetConfig, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, puts: int
) -> None:
    """Whatever the last object was; with the folder that shards were made in, and (odd numbers) without."""
    config = config.model_copy(update={"scenes": 6})
    built(config)
    left, whole = puts, Bucket.put

    def put(self: Bucket, file: Path | bytes) -> None:
        nonlocal left
        left -= 1
        if left < 0:
            raise KeyboardInterrupt
        whole(self, file)

    with monkeypatch.context() as patch:
        patch.setattr(Bucket, "put", put)
        with pytest.raises(KeyboardInterrupt):
            built(config, scenes=9)
    there = TransientDataset(ADDRESS, FIELDS)
    build_fakes(config, tmp_path / "few")
    few = TransientDataset(tmp_path / "few", FIELDS)
    assert verify(ADDRESS, deep=True).problems == () and len(there) == 6 and there.stats == few.stats
    assert all(torch.equal(there[scene][name], few[scene][name]) for scene in range(6) for name in FIELDS)
    # The new shard, and at the end the scenes that the last one gets.
    assert puts < 20 or len(TransientDataset(ADDRESS, partial=True)) in (7, 9)
    if puts % 2:
        shutil.rmtree(tmp_path / "staging")
    assert built(config, scenes=9).complete
    build_fakes(config, tmp_path / "many", scenes=9)
    names = {key.relative_to(bucket.key).as_posix() for key in bucket._below()}
    many = tmp_path / "many"
    assert names == {path.relative_to(many).as_posix() for path in many.rglob("*") if path.is_file()}
    assert verify(ADDRESS, deep=True).problems == () and dataset_digest(ADDRESS) == dataset_digest(many)


def test_a_record_that_is_listed_and_not_found_is_a_problem(bucket: Bucket, monkeypatch: pytest.MonkeyPatch) -> None:
    """Between the listing and the request an object may go, or the store answers wrongly."""
    built()
    chunks = Bucket.chunks

    def answered(self: Bucket) -> Any:
        if self.name == "shard-000001.json":
            raise FileNotFoundError(2, "no such object", str(self))
        return chunks(self)

    monkeypatch.setattr(Bucket, "chunks", answered)
    found = verify(ADDRESS)
    assert found.shards == 1 and any("shard 1: its commit record" in problem for problem in found.problems)
    with pytest.raises(CheckError, match="1 of 2 shards are missing or damaged"):
        dataset_digest(ADDRESS)
    with pytest.raises(CheckError, match="shard 1 is not committed"):
        TransientDataset(ADDRESS)[5]


def test_damage_in_the_store_is_reported_and_repaired(bucket: Bucket, config: DatasetConfig, local: Path) -> None:
    built(config)
    name = file_of(local, "histogram", 1).relative_to(local).as_posix()
    shard, record = bucket / name, bucket / "build/shard-000000.json"
    sound = shard.read_bytes()
    for harmed in (sound[:-1], sound[:40] + bytes([sound[40] ^ 1]) + sound[41:]):
        obstore.put(_store_of(shard.bucket), str(shard.key), harmed)
        assert any("data.zarr/histogram/c/1" in problem for problem in verify(ADDRESS).problems)
        with pytest.raises(CheckError, match=f"{ADDRESS}/{name}"):
            TransientDataset(ADDRESS)[4]
    shard.unlink()
    with pytest.raises(CheckError, match="cannot be opened"):
        TransientDataset(ADDRESS)[4]
    record.unlink()
    with pytest.raises(InputError, match="2 of 2 shards are not committed, the first is 0"):
        TransientDataset(ADDRESS)
    built(config)
    assert verify(ADDRESS, deep=True).problems == ()


def test_other_objects_are_left_alone(bucket: Bucket, tmp_path: Path) -> None:
    with pytest.raises(InputError, match="no such dataset"):
        info(f"{ADDRESS}/nothing")
    with pytest.raises(CheckError, match=r"s3://nowhere/set.*look at the address"):
        info("s3://nowhere/set")
    thesis = bucket / "thesis.tex"
    obstore.put(_store_of(thesis.bucket), str(thesis.key), b"years of work")
    with pytest.raises(InputError, match="holds objects and no dataset"):
        built()
    thesis.unlink()
    built()
    for _ in range(2):
        with pytest.raises(InputError, match=r"seed = 3, this configuration has 4"):
            built(two_shards(seed=4))
        # The second time without the folder it was made in.
        shutil.rmtree(tmp_path / "staging", ignore_errors=True)
    assert verify(ADDRESS).problems == ()
    for address in ("s3://rooms", "s3://key:secret@rooms/set", "s3://rooms/../set", "gs://rooms/set"):
        with pytest.raises(InputError, match="must be s3://bucket/name") as refused:
            location_of(address)
        assert "secret" not in str(refused.value)


@pytest.mark.parametrize(("home", "why"), [("~", "this user has no home"), ("/proc/nothing", "cannot be written")])
def test_without_a_folder_to_stage_shards_in_a_build_names_the_remedy(
    monkeypatch: pytest.MonkeyPatch, home: str, why: str
) -> None:
    """A container's user may have no home, or one that cannot be written."""
    for name in ("DATAGEN_STAGING", "XDG_CACHE_HOME"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setattr("os.path.expanduser", lambda path: path.replace("~", home))
    with pytest.raises(InputError, match=f"{ADDRESS}: .*{why}.*DATAGEN_STAGING"):
        built()
