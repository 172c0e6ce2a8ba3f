"""Samples without files: the loader's worker that reads a sample simulates it."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
import torch
from torch.utils.data import IterableDataset, get_worker_info

from datagen.config import DatasetConfig
from datagen.design.exposure import with_exposure_found
from datagen.errors import InputError
from datagen.pipeline import simulate_sample
from datagen.store import schema_of
from datagen.store.shard import encoded
from datagen.store.stats import COUNTS


class GeneratedDataset(IterableDataset[dict[str, torch.Tensor]]):
    """The samples of a configuration, simulated while they are read: the same as in a dataset built with it.

    Each of n loader workers makes every n-th scene; with no worker or one, scenes come in order. An epoch ends after
    the configuration's number of `scenes`, and the next epoch simulates the same scenes again. If you want to read
    scenes twice, build a dataset; if you want to see no scene twice, raise `scenes`.

    Parameters
    ----------
    config : what to make. The search for `detector.exposure_for`, if that is given, runs at once.
    fields : fields of an item, out of `config.store.fields`. Histograms become float32.
    first : number of the first scene, ≥ 0; for example the number of scenes that an earlier run has read.

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
        self, config: DatasetConfig, fields: Sequence[str] = ("histogram", "depth"), *, first: int = 0
    ) -> None:
        known = schema_of(config).by_name
        for name in fields:
            if name not in known:
                raise InputError(f"fields: {name!r} is not in store.fields; there are {', '.join(known)}")
        if first < 0:
            raise InputError(f"first = {first}: must be ≥ 0")
        config = with_exposure_found(config)
        self._config, self._fields, self._first = config, {name: known[name] for name in fields}, first

    def __len__(self) -> int:
        return max(0, self._config.scenes - self._first)

    def __iter__(self) -> Iterator[dict[str, torch.Tensor]]:
        worker = get_worker_info()
        begin, step = (worker.id, worker.num_workers) if worker is not None else (0, 1)
        for scene in range(self._first + begin, self._config.scenes, step):
            sample = simulate_sample(self._config, scene)
            values = {name: encoded(field, sample.arrays[name]) for name, field in self._fields.items()}
            values |= {name: values[name].astype(np.float32) for name in COUNTS if name in values}
            item = {name: torch.from_numpy(np.ascontiguousarray(array)) for name, array in values.items()}
            yield item | {"scene": torch.tensor(scene)}
