"""Runs that were stopped in the middle of an epoch go on in order and noise; the lines of docs/resuming.md."""

from __future__ import annotations

import importlib.util
import itertools
import json
import os
import pickle
import socket
import subprocess
import sys
from contextlib import redirect_stdout
from io import StringIO
from pathlib import Path
from typing import Any

import pytest
import resumed_run
import torch
from datasets import write_dataset
from fake_samples import fake_sample, noisy_config, sequence_config
from torch.utils.data import BatchSampler, ConcatDataset, DataLoader, Dataset, Subset
from torchdata.stateful_dataloader import StatefulDataLoader

import datagen as dg
from datagen.config import config_from_mapping
from datagen.errors import InputError
from datagen.store import read_manifest

# torchdata 0.11 calls what torch 2.13 has given up.
pytestmark = pytest.mark.filterwarnings("ignore:'set_vital' is deprecated")

Rows = list[tuple[int, bytes]]


@pytest.fixture(scope="module")
def dataset(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_dataset(noisy_config(), tmp_path_factory.mktemp("resumed") / "set", fake_sample)


EITHER = {"scenes": noisy_config(), "windows": sequence_config(scenes=6)}


@pytest.fixture(scope="module", params=EITHER)
def either(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Of twelve items: scenes, or windows of sequences, of which neighbours have a frame in common."""
    return write_dataset(EITHER[request.param], tmp_path_factory.mktemp("either") / "set", fake_sample)


def fresh(path: Path) -> dg.TransientDataset:
    windows = {} if read_manifest(path).frames is None else {"frames": 2, "frame_step": 1}
    return dg.TransientDataset(path, ("histogram",), redraw_noise=True, **windows)


def rows(batch: dict[str, torch.Tensor]) -> Rows:
    return [(int(s), h.numpy().tobytes()) for s, h in zip(batch["scene"], batch["histogram"], strict=True)]


def free_port() -> str:
    with socket.socket() as found:
        found.bind(("127.0.0.1", 0))
        return str(found.getsockname()[1])


BY_DAY = {("stateful", 0, 1), ("plain", 2, 1), ("lightning", 0, 1), ("accelerate", 0, 2)}
LONG = [
    pytest.param(*run, marks=[] if run in BY_DAY else pytest.mark.nightly)
    for run in itertools.product(("stateful", "plain", "lightning", "accelerate"), (0, 2), (1, 2))
]


@pytest.mark.parametrize(("way", "workers", "ranks"), LONG)
def test_a_run_goes_on_as_the_page_writes_it(
    dataset: Path, tmp_path: Path, way: str, workers: int, ranks: int
) -> None:
    """In this process, or in some that join by gloo on this machine. All scenes once in each epoch, in every process
    the same steps."""
    module = {"lightning": "pytorch_lightning", "accelerate": "accelerate"}.get(way, "torchdata")
    if importlib.util.find_spec(module) is None:
        pytest.skip(f"{module} is not installed (pip install 'nlos-datagen[training]')")
    due = f"RESULT {18 // ranks} steps, stopped after {8 // ranks}, the same"
    if ranks == 1 and module == "torchdata":
        with redirect_stdout(StringIO()) as printed:
            resumed_run.main(way, str(dataset), str(tmp_path), str(workers))
        assert due in printed.getvalue()
        return
    here, port = Path(__file__).with_name("resumed_run.py"), free_port()
    together = {
        "WORLD_SIZE": str(ranks), "MASTER_ADDR": "127.0.0.1", "MASTER_PORT": port, "ACCELERATE_USE_CPU": "true",
        "OMP_NUM_THREADS": "1",
    }  # fmt: skip
    started = [
        subprocess.Popen(
            [sys.executable, here, way, dataset, tmp_path, str(workers)], text=True,
            env=os.environ | (together | {"RANK": str(rank), "LOCAL_RANK": str(rank)} if ranks > 1 else {}),
            stdout=subprocess.PIPE, stderr=subprocess.PIPE,
        )
        for rank in range(ranks)
    ]  # fmt: skip
    for process in started:
        out, errors = process.communicate(timeout=600)
        assert due in out, errors[-3000:]


def taken_up(make: Any, stop: int) -> tuple[list[Rows], list[Rows]]:
    """Batches of three epochs without a stop, and with one after `stop` batches, by new objects."""
    loader, whole, state = make(), [], {}
    for _ in range(3):
        for batch in loader:
            whole.append(rows(batch))
            if len(whole) == stop:
                state = pickle.loads(pickle.dumps(loader.state_dict()))
    again = make()
    again.load_state_dict(state)
    found = whole[:stop]
    while len(found) < len(whole):
        found += [rows(batch) for batch in again]
    return whole, found


ORDERS = [*itertools.product(("in order", "shuffled", "EpochSampler"), (0, 2)), ("persistent", 2)]


@pytest.mark.parametrize(
    ("either", "order", "workers"),
    [*(("scenes", *order) for order in ORDERS), ("windows", "shuffled", 0), ("windows", "persistent", 2)],
    indirect=["either"],
)
@pytest.mark.parametrize("stop", [3, 7], ids=["after an epoch", "within one"])
def test_a_stateful_loader_goes_on_in_order_and_noise(either: Path, workers: int, stop: int, order: str) -> None:
    """Although workers had read ahead when the state was saved."""

    def make() -> StatefulDataLoader[Any]:
        data = fresh(either)
        torch.manual_seed(7)
        options: dict[str, Any] = {"shuffle": order != "in order"}
        if order in ("EpochSampler", "persistent"):
            options = {"sampler": dg.EpochSampler(data), "persistent_workers": order == "persistent"}
        start = {"multiprocessing_context": "fork"} if workers else {}
        return StatefulDataLoader(data, 4, num_workers=workers, collate_fn=dg.collate, **start, **options)

    whole, found = taken_up(make, stop)
    assert found == whole and len({row for batch in whole for row in batch}) == 36


@pytest.mark.parametrize("stop", [1, 5, 7, 11])
def test_repeats_go_on_where_they_stopped(dataset: Path, stop: int) -> None:
    """Of scenes that come several times in an epoch, through parts of a dataset and a dataset of a user's."""

    class Doubled(Dataset[Any]):
        def __init__(self, data: dg.TransientDataset) -> None:
            self.data = data

        def __len__(self) -> int:
            return len(self.data)

        def __getitem__(self, item: int) -> Any:
            found = self.data[item]
            return found | {"histogram": found["histogram"] * 2}

    def make() -> StatefulDataLoader[Any]:
        data = fresh(dataset)
        often = ConcatDataset([Doubled(data), Subset(data, [3, 3, 5, 5, 5])])
        return StatefulDataLoader(often, 4, sampler=dg.EpochSampler(often), collate_fn=dg.collate)

    whole, found = taken_up(make, stop)
    assert found == whole and len(whole) == 15


def test_the_number_of_items_that_are_done_is_enough(dataset: Path) -> None:
    """For torch's own loader, whatever it fetched ahead; and a state says the same."""
    data = fresh(dataset)
    order = dg.EpochSampler(data, seed=3)
    order.set_epoch(5)
    whole = [rows(batch) for batch in DataLoader(data, 2, sampler=order, num_workers=1, collate_fn=dg.collate)]
    for state in ({"epoch": 5, "done": 8}, order.state_dict() | {"epoch": 5, "done": 8}):
        again = fresh(dataset)
        order = dg.EpochSampler(again, seed=3)
        order.load_state_dict(state)
        order.set_epoch(5)  # as Accelerate and Lightning do before every epoch
        assert place(order) == (5, 8)
        loader = DataLoader(again, 2, sampler=order, collate_fn=dg.collate)
        assert [rows(batch) for batch in loader] == whole[4:]
        assert place(order) == (6, 0) and len([*loader]) == 6
    order.set_epoch(6)
    assert order.state_dict(done=4) == order.state_dict() | {"epoch": 6, "done": 4}


def place(order: dg.EpochSampler) -> tuple[int, int]:
    state = order.state_dict()
    return state["epoch"], state["done"]


def test_a_state_of_another_order_is_refused_within_an_epoch(dataset: Path) -> None:
    """As of a dataset that has grown since: some of its scenes would come twice and some never. A state at the end
    of an epoch is one of all orders."""
    data = fresh(dataset)
    state = json.loads(json.dumps(dg.EpochSampler(data, seed=1).state_dict(done=5)))
    for other, message in (
        (dg.EpochSampler(ConcatDataset([data, data]), seed=1), "items = 12, .* 5 items are done, this one has 24"),
        (dg.EpochSampler(Subset(data, range(9)), seed=1), "items = 12, .* this one has 9"),
        (dg.EpochSampler(data, seed=2), "seed = 1, .* this one has 2"),
        (dg.EpochSampler(data, seed=1, shuffle=False), "shuffle = True, .* this one has False"),
        (dg.EpochSampler(data, seed=1, rank=1, ranks=2), "5 items are done in 1 processes, which 2 cannot share"),
    ):
        with pytest.raises(InputError, match=message):
            other.load_state_dict(state)
        other.load_state_dict(state | {"done": 12})
        assert place(other) == (0, len(other)) and list(other) == []
        other.load_state_dict({"epoch": 3, "done": 0})
        assert len(list(other)) == len(other)


@pytest.mark.parametrize(("before", "after", "done"), [(1, 2, 4), (1, 3, 6), (2, 1, 3), (2, 3, 3), (3, 2, 2)])
def test_an_epoch_goes_on_in_another_number_of_processes(either: Path, before: int, after: int, done: int) -> None:
    """No scene comes twice, and the noise is that of the epoch."""

    def run(ranks: int, most: int, state: Any = None) -> tuple[list[tuple[int, bytes]], list[Any]]:
        found, states = [], []
        for rank in range(ranks):
            data = fresh(either)
            order = dg.EpochSampler(data, rank=rank, ranks=ranks)
            if state:
                order.load_state_dict(state)
            for batch in itertools.islice(DataLoader(data, 1, sampler=order, collate_fn=dg.collate), most):
                found += rows(batch)
            states.append(order.state_dict())
        return found, states

    whole, _ = run(1, 12)
    first, states = run(before, done)
    rest, _ = run(after, 12, states[-1])
    assert sorted(first + rest) == sorted(whole)


def test_an_epoch_left_early_is_over(dataset: Path) -> None:
    order = dg.EpochSampler(fresh(dataset))
    items = iter(order)
    first = [next(items) for _ in range(3)]
    assert place(order) == (0, 3)
    other = list(order)
    assert len(other) == 12 and other[:3] != first and place(order) == (2, 0)


def test_a_sampler_whose_state_was_hidden_is_refused(dataset: Path) -> None:
    """torch's BatchSampler keeps it from the loader. The line is that of the process that asks for items."""

    def make() -> StatefulDataLoader[Any]:
        data = fresh(dataset)
        return StatefulDataLoader(data, batch_sampler=BatchSampler(dg.EpochSampler(data), 4, False))

    with pytest.raises(InputError, match=r"begins epoch 0, but .* is of epoch 2; call set_epoch\(2, done=…\)"):
        taken_up(make, 7)


def test_states_of_something_else_are_refused(dataset: Path) -> None:
    data, plain = fresh(dataset), dg.TransientDataset(dataset)
    assert plain.state_dict() == {}
    plain.load_state_dict({})
    for state in ({}, {"draws": {}}, {"draws": {"number": torch.zeros(3)}}, 5):
        with pytest.raises(InputError, match="load_state_dict"):
            data.load_state_dict(state)  # type: ignore[arg-type]
    order = dg.EpochSampler(data)
    for wrong in (
        {},
        {"epoch": 1},
        {"epoch": -1, "done": 0},
        {"epoch": 1, "done": 13},
        {"epoch": 1, "done": 0.5},
        None,
    ):
        with pytest.raises(InputError, match=r"load_state_dict|EpochSampler"):
            order.load_state_dict(wrong)  # type: ignore[arg-type]


TINY = {
    "seed": 5, "scenes": 5, "transport": {"samples": 64}, "labels": {"rows": 4, "columns": 4},
    "capture": {"scan": {"rows": 2, "columns": 2}, "time": {"bins": 64, "bin_width_ps": 800}},
}  # fmt: skip


def scenes_of(data: Any) -> list[int]:
    return [int(item["scene"]) for item in data]


@pytest.fixture
def simulated(monkeypatch: pytest.MonkeyPatch) -> list[int]:
    """The scenes that are simulated, by a stand-in."""
    found: list[int] = []

    def sample(config: Any, scene: int) -> Any:
        found.append(scene)
        return fake_sample(config, scene)

    monkeypatch.setattr("datagen.building.on_the_fly.simulate_sample", sample)
    return found


def test_generated_scenes_are_dealt_out_to_processes_and_workers(
    simulated: list[int], monkeypatch: pytest.MonkeyPatch
) -> None:
    config = config_from_mapping(TINY)
    data = dg.GeneratedDataset(config, ("histogram",))
    assert scenes_of(data) == [0, 1, 2, 3, 4]
    shares = [dg.GeneratedDataset(config, ("histogram",), rank=rank, ranks=2) for rank in range(2)]
    assert [scenes_of(share) for share in shares] == [[0, 2, 4], [1, 3, 0]] and [len(s) for s in shares] == [3, 3]
    workers = DataLoader(shares[1], None, num_workers=2, multiprocessing_context="fork")
    assert sorted(scenes_of(workers)) == [0, 1, 3]
    late = dg.GeneratedDataset(config, ("histogram",), first=3, rank=1, ranks=3)
    assert scenes_of(late) == [4] and scenes_of(dg.GeneratedDataset(config, ("histogram",), first=9)) == []
    monkeypatch.setenv("RANK", "1")
    assert scenes_of(data) == [0, 1, 2, 3, 4], "nobody says how many there are"
    monkeypatch.setenv("WORLD_SIZE", "2")
    assert scenes_of(data) == [1, 3, 0] and scenes_of(shares[0]) == [0, 2, 4]
    sent = pickle.dumps(data)
    monkeypatch.delenv("RANK")
    monkeypatch.delenv("WORLD_SIZE")
    assert scenes_of(pickle.loads(sent)) == [1, 3, 0], "a worker that is started afresh"
    for rank, ranks in ((2, 2), (-1, 2), (None, 2), (0, 0), (1, None)):
        with pytest.raises(InputError, match="rank"):
            dg.GeneratedDataset(config, ("histogram",), rank=rank, ranks=ranks)


@pytest.mark.parametrize("workers", [0, 2])
def test_generated_scenes_go_on_without_simulating_anew(simulated: list[int], workers: int) -> None:
    config = config_from_mapping(TINY | {"scenes": 8})

    def make() -> StatefulDataLoader[Any]:
        start = {"multiprocessing_context": "fork"} if workers else {}
        data = dg.GeneratedDataset(config, ("histogram",))
        return StatefulDataLoader(data, 2, num_workers=workers, collate_fn=dg.collate, **start)

    loader = make()
    whole, state = [], {}
    for batch in loader:
        whole.append(rows(batch))
        if len(whole) == 2:
            state = pickle.loads(pickle.dumps(loader.state_dict()))
    again = make()
    again.load_state_dict(state)
    simulated.clear()
    assert [rows(batch) for batch in again] == whole[2:]
    assert len(simulated) == (0 if workers else 4)


def test_generated_scenes_that_were_shared_out_otherwise_are_refused(simulated: list[int]) -> None:
    def share(scenes: int = 8, **options: Any) -> Any:
        config = config_from_mapping(TINY | {"scenes": scenes})
        return iter(dg.GeneratedDataset(config, ("histogram",), **options))

    items = share()
    next(items)
    state = json.loads(json.dumps(items.state_dict()))
    for other, message in (
        (share(scenes=9), "scenes = 8 when the state was saved, now 9"),
        (share(first=2), "first = 0 .* now 2"),
        (share(rank=0, ranks=2), "ranks = 1 .* now 2, so that scenes would come twice or never"),
    ):
        with pytest.raises(InputError, match=message):
            other.load_state_dict(state)
        other.load_state_dict(state | {"done": 0})
    again = share()
    again.load_state_dict(state)
    assert scenes_of(again) == [1, 2, 3, 4, 5, 6, 7]
