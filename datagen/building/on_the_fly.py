"""Samples without files: the loader's worker that reads a sample simulates it."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np
import torch
from torch.utils.data import IterableDataset, get_worker_info

from datagen.config import DatasetConfig
from datagen.design.exposure import with_exposure_found
from datagen.errors import InputError, shown
from datagen.loader.ranks import number_of_ranks, rank_of_process
from datagen.pipeline import simulate_sample
from datagen.records.checks import as_names, check_integer, check_kind
from datagen.store import schema_of
from datagen.store.shard import encoded_value
from datagen.store.stats import COUNTS


class GeneratedDataset(IterableDataset[dict[str, torch.Tensor]]):
    """The samples of a configuration, simulated while they are read: the same as in a dataset built with it.

    Scenes are dealt out to the processes of distributed training, and those of a process to its loader's workers;
    without either, scenes come in order. All processes get the same number of scenes: if they do not divide evenly,
    some come twice. Nothing is shuffled, so there is no `set_epoch` to call: an epoch ends after the configuration's
    number of `scenes`, and the next epoch simulates the same scenes again. If you want to read scenes twice, build a
    dataset; if you want to see no scene twice, raise `scenes`.

    torchdata's `StatefulDataLoader` goes on after the scenes that were done, without simulating them again.

    Parameters
    ----------
    config : what to make. The search for `detector.exposure_for`, if that is given, runs at once.
    fields : fields of an item, out of `config.store.fields`. Histograms become float32.
    first : number of the first scene, ≥ 0; for example the number of scenes that an earlier run has read.
    rank, ranks : index of this process and number of processes, instead of those that `torch.distributed` knows, or
        RANK and WORLD_SIZE; `ranks=1` if somebody else deals out the items, as Accelerate does.

    Raises
    ------
    InputError : a field that the configuration does not give; a scene that cannot be made.

    Examples
    --------
    >>> import datagen as dg
    >>> from datagen.config import config_from_mapping
    >>> config = config_from_mapping({
    ...     "scenes": 2, "transport": {"target": 0.1},
    ...     "capture": {"scan": {"rows": 2, "columns": 2}, "time": {"bins": 64, "bin_width_ps": 800}}})
    >>> [tuple(item["histogram"].shape) for item in dg.GeneratedDataset(config, ("histogram",))]
    [(4, 1, 64), (4, 1, 64)]
    """

    def __init__(
        self,
        config: DatasetConfig,
        fields: Sequence[str] = ("histogram", "depth"),
        *,
        first: int = 0,
        rank: int | None = None,
        ranks: int | None = None,
    ) -> None:
        check_kind("config", config, DatasetConfig, remedy="such as load_config(path)")
        known = schema_of(config).by_name
        fields = as_names("fields", fields, "such as ('histogram', 'depth')")
        for name in fields:
            if name not in known:
                raise InputError(f"fields: {name!r} is not in store.fields; there are {', '.join(known)}")
        check_integer("GeneratedDataset", "first", first, 0, 2**62)
        if ranks is not None:
            check_integer("GeneratedDataset", "ranks", ranks, 1, 2**31)
            check_integer("GeneratedDataset", "rank", 0 if rank is None and ranks == 1 else rank, 0, ranks - 1)
        elif rank is not None:
            raise InputError(f"rank = {rank}: give the number of processes, too, such as ranks=2")
        config = with_exposure_found(config)
        self._config, self._fields, self._first = config, {name: known[name] for name in fields}, first
        self._given = None if ranks is None else (rank or 0, ranks)
        # Of the process that started this one, a worker.
        self._found: tuple[int, int] | None = None

    def __len__(self) -> int:
        _, ranks = self._place()
        return -(-max(0, self._config.scenes - self._first) // ranks)

    def __iter__(self) -> Iterator[dict[str, torch.Tensor]]:
        rank, ranks = self._place()
        worker = get_worker_info()
        begin, step = (worker.id, worker.num_workers) if worker is not None else (0, 1)
        every = np.arange(self._first, max(self._first, self._config.scenes))
        dealt = np.resize(every, len(self) * ranks)
        shares = {"first": self._first, "scenes": self._config.scenes, "ranks": ranks, "workers": step}
        return _Scenes(self, dealt[rank::ranks][begin::step].tolist(), shares)

    def __getstate__(self) -> dict[str, Any]:
        """The state with the rank of this process, which a spawned worker takes over."""
        return self.__dict__ | {"_found": self._place()}

    def sample(self, scene: int) -> dict[str, torch.Tensor]:
        """The item of a scene."""
        check_integer("GeneratedDataset", "scene", scene, 0, 2**62)
        sample = simulate_sample(self._config, scene)
        values = {name: encoded_value(field, sample.arrays[name]) for name, field in self._fields.items()}
        values |= {name: values[name].astype(np.float32) for name in COUNTS if name in values}
        item = {name: torch.from_numpy(np.ascontiguousarray(array)) for name, array in values.items()}
        return item | {"scene": torch.tensor(scene)}

    def _place(self) -> tuple[int, int]:
        if self._given is not None:
            return self._given
        rank, ranks = self._found or (None, None)
        # Of more processes than there are, such as where RANK alone is stated, each makes every scene.
        rank, ranks = rank_of_process(rank), number_of_ranks(ranks)
        return (rank, ranks) if rank < ranks else (0, 1)


class _Scenes(Iterator[dict[str, torch.Tensor]]):
    """The items of some scenes, one after the other; `StatefulDataLoader` saves and loads how many are done."""

    def __init__(self, data: GeneratedDataset, scenes: list[int], shares: dict[str, int]) -> None:
        self._data, self._scenes, self._shares, self._done = data, scenes, shares, 0

    def __next__(self) -> dict[str, torch.Tensor]:
        if self._done >= len(self._scenes):
            raise StopIteration
        self._done += 1
        return self._data.sample(self._scenes[self._done - 1])

    def state_dict(self) -> dict[str, int]:
        """`done`, the number of items that were handed out, and what scenes were shared out, and among how many."""
        return {"done": self._done, **self._shares}

    def load_state_dict(self, state: Mapping[str, Any]) -> None:
        """Leave out the items that were handed out. Raises `InputError` if scenes were shared out otherwise."""
        check_kind("load_state_dict", state, Mapping, remedy="what state_dict returned")
        for name, here in self._shares.items():
            if state.get("done") and state.get(name, here) != here:
                raise InputError(
                    f"load_state_dict: {name} = {shown(state[name])} when the state was saved, now {here}, so that "
                    "scenes would come twice or never; give it the same, or the scenes that are left by first="
                )
        check_integer("load_state_dict", "done", state.get("done"), 0, len(self._scenes))
        self._done = int(state["done"])
