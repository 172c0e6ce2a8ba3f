"""A dataset on disk as a map-style torch `Dataset`."""

from __future__ import annotations

import operator
import os
import warnings
from collections import Counter
from collections.abc import Sequence
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch.utils.data import Dataset

from datagen.errors import CheckError, InputError
from datagen.loader.batch import Batch
from datagen.loader.crops import Crops
from datagen.loader.events import events_of
from datagen.loader.redrawn_noise import TRANSIENT_OF, DrawCounter, NoiseSource
from datagen.loader.volumes import Volumes
from datagen.reconstruction.backprojection import GEOMETRY
from datagen.records.checks import check_flag, check_kind, check_number, check_seed, shown
from datagen.store import DatasetReader, Manifest, committed, read_manifest
from datagen.store.location import Bucket, location_of
from datagen.store.reader import Part
from datagen.store.record import recorded_shards
from datagen.store.schema import EVIDENCE_SINCE, SPLITS_SINCE
from datagen.store.stats import COUNTS, QUANTITIES, WITH_STATS
from datagen.store.table import TABLE, read_splits, read_table, stats_of_rows

COUNT_TYPES = ("float32", "float64", "int32", "int64", "stored")


class TransientDataset(Dataset[dict[str, torch.Tensor]]):
    """A dataset on disk as a map-style torch `Dataset`.

    An item maps each field, and `"scene"` (its index), to a tensor of the scene's shape (`data.shape(field)`):
    histogram and transient (L, P, T), label images (row, column), volumes (depth, row, column).

    Parameters
    ----------
    path : the folder that `build` made, complete, or `s3://bucket/name` of one that it put into an object store.
    fields : any of the dataset's fields; `data.fields` lists all, and "objects" stands for those that begin with
        `object_` (the classes, poses and boxes of the objects; `data.classes` names the classes).
    counts : dtype that histograms are handed over in, since torch lacks most operations for uint16 and uint32.
        float32 is exact up to 2²⁴ counts a bin. `"stored"` leaves them as they are, the least to move from worker to
        device: cast them there, `batch["histogram"].to(device).float()`. Other fields keep their dtype.
    redraw_noise : draw histograms anew from the stored transient, with the detector of the scene, at every read: the
        n-th read of a scene is its draw n, a function of (`seed`, n, scene). So each epoch has new noise, with any
        wrapper, sampler or worker; you do not have to call `set_epoch`, which sets n. A `background_histogram` is
        drawn anew, too, where the dataset has the field `background_transient`; elsewhere it is the stored one.
    representation : `"events"`: instead of `histogram` an item has `events`, (N, 3) laser, pixel and bin of every
        filled bin (int16, int32 where an axis is longer), and `counts`, (N,) of these bins: an input for networks on
        points, and less to move where most bins are empty. `collate` joins a batch, with the number of the sample as
        first column, and `dense` makes histograms of it on any device. `"volume"`: instead of `histogram` an item
        has `volume`, float32 (depth, row, column), an input for convolutions: the backprojection of the counts, minus
        their mean over the scan and in units of their noise, onto the space behind the label images, divided by the
        root of the number of histograms. Objects stand out from a noise of about 1 at the pixel of their label.
    voxels : of a `volume`.
    split : the scenes of one split alone: `"train"`, `"val"`, `"test"`, or one that the configuration holds out by
        what scenes show (`splits.held_out`). A room, and every scene that shows it, is in one split; growing a
        dataset moves none.
    fractions : of train, val and test, instead of the configuration's.
    seed : of the redrawn noise.
    check : compare every value with the digest in its commit record when it is first read, once for all workers and
        epochs; a part is therefore read as a whole the first time. It costs about 1 ms a MiB of decoded values.
        Without it missing and damaged files are still found, but not files that were exchanged.
    lasers : the laser points that are read, in this order: a slice, indices, a mask, or rows and columns of a scan
        that is a grid, `lasers=np.s_[8:24, 8:24]`. All fields with that axis are cut: histograms, transients,
        `laser_points`, the `sensor_pixels` of a confocal scan. Blocks of 256 KiB without any of these are not
        decoded. Noise that is drawn anew is that of the whole scan, cut.
    pixels : likewise the pixels.
    bins : a slice of the time bins; saves memory, and decoding only with the other two.
    evidence_at_least : only scenes whose every object has at least this significance (docs/physics.md), 3 for what
        can be learnt at all; scenes without objects stay. `data.parameters("evidence.weakest")` has the numbers, and
        with the label `objects` the field `object_significance` that of each object.

    Files are opened by each process for itself, at the first read; a dataset can be handed to loader workers started
    in any way. Scenes whose simulation failed are left out, with a warning.

    Raises
    ------
    InputError : the folder is no dataset, shards are not committed, an unknown field or split, an empty split, or
        no scene with so much evidence.
    CheckError : for what is missing, damaged or other than was written, mostly while reading; naming file, scene and
        remedy.

    Examples
    --------
    A batch of a dataset that `build` made (there is an example):

    >>> import datagen as dg, torch
    >>> def batches(path):
    ...     data = dg.TransientDataset(path, fields=("histogram", "depth"), redraw_noise=True)
    ...     yield from torch.utils.data.DataLoader(data, 16, shuffle=True, collate_fn=dg.collate)
    >>> next(batches("nowhere.zarr"))
    Traceback (most recent call last):
        ...
    datagen.errors.InputError: nowhere.zarr: no such dataset; name a folder that `datagen build` made
    """

    def __init__(
        self,
        path: str | Path,
        fields: Sequence[str] = ("histogram", "depth"),
        *,
        representation: str = "dense",
        voxels: tuple[int, int, int] = (32, 32, 32),
        split: str | None = None,
        fractions: tuple[float, float, float] | None = None,
        counts: str = "float32",
        redraw_noise: bool = False,
        seed: int = 0,
        check: bool = True,
        lasers: slice | Sequence[int] | NDArray[np.generic] | tuple[slice, slice] | None = None,
        pixels: slice | Sequence[int] | NDArray[np.generic] | tuple[slice, slice] | None = None,
        bins: slice | None = None,
        evidence_at_least: float | None = None,
    ) -> None:
        check_kind("path", path, str, os.PathLike, Bucket, remedy="name the folder that build made")
        check_seed(seed)
        check_kind("fields", fields, str, Sequence, remedy="such as ('histogram', 'depth')")
        wanted = (fields,) if isinstance(fields, str) else tuple(fields)
        for name in wanted:
            check_kind("fields", name, str, remedy="such as ('histogram', 'depth')")
        for name, flag in (("redraw_noise", redraw_noise), ("check", check)):
            check_flag(name, flag)
        if evidence_at_least is not None:
            sigmas = "standard deviations, such as 3"
            check_number("TransientDataset", "evidence_at_least", evidence_at_least, 0.0, 1e9, sigmas)
        self.path = location_of(path).resolve()
        self._manifest = manifest = read_manifest(path)
        self._schema = manifest.schema
        self.fields = tuple(self._schema.by_name)
        tables = tuple(name for name in self.fields if name.startswith("object_")) or ("objects",)
        self.selected = tuple(dict.fromkeys(f for name in wanted for f in (tables if name == "objects" else (name,))))
        self._light = {name: of for name, of in TRANSIENT_OF.items() if redraw_noise and of in self.fields}
        for name in self.selected:
            if name not in self.fields and name not in self._light:
                raise InputError(f"fields: {name!r} is not in {path}; it has {', '.join(self.fields)}")
        if counts == "int32" and "histogram" in self.fields and self._schema.by_name["histogram"].dtype == "uint32":
            raise InputError("counts = 'int32': histograms are stored as uint32, which it cannot hold; use 'int64'")
        if counts not in COUNT_TYPES:
            raise InputError(f"counts = {counts!r}: must be one of {', '.join(COUNT_TYPES)}")
        self._counts = None if counts == "stored" else np.dtype(counts)
        if representation not in ("dense", "events", "volume"):
            raise InputError(f"representation = {representation!r}: must be 'dense', 'events' or 'volume'")
        # What an item has instead of a histogram, if anything.
        self._instead = representation if representation != "dense" and "histogram" in self.selected else None
        if self._instead == "events":
            # Compiled here, once, for all workers that are forked.
            events_of(np.zeros((1, 1, 1, 64), self._schema.by_name["histogram"].dtype))
        if redraw_noise and "transient" not in self.fields:
            raise InputError(
                f"redraw_noise: {path} has no field transient to draw from; build it with one (store.fields)"
            )
        self._crops = Crops(manifest, lasers, pixels, bins)
        self._parts = {name: self._crops.part(field) for name, field in self._schema.by_name.items()}
        self._volumes = Volumes(manifest, self._crops, voxels) if self._instead == "volume" else None
        self._noise = NoiseSource(manifest) if redraw_noise else None
        self._draws = DrawCounter(self._schema.scenes) if redraw_noise else None
        self.scenes = self._scenes_there(manifest)
        self.split = split
        if split is not None:
            self.scenes = self._scenes_of(split, fractions)
        elif fractions is not None:
            raise InputError("fractions: divide a dataset into splits; name the one to read, such as split='train'")
        if evidence_at_least is not None:
            self.scenes = self._scenes_with_evidence(evidence_at_least)
        self.seed = seed
        # Shared memory: no worker checks what another has.
        stored = [self._light.get(name, name) for name in self.selected]
        stored += GEOMETRY if self._volumes else ()
        self._seen: dict[str, Any] = {
            name: torch.zeros(self._schema.scenes, dtype=torch.bool).share_memory_() for name in stored
        }
        self._check = check
        self._reader: DatasetReader | None = None

    def __len__(self) -> int:
        return len(self.scenes)

    def __getitem__(self, item: int) -> dict[str, torch.Tensor]:
        return self.__getitems__([item])[0]

    def __repr__(self) -> str:
        """Path, number of samples, split, and fields with their shapes."""
        part = f" of split {self.split!r}" if self.split else ""
        part += f"; of each {self._crops}" if self._crops.chosen else ""
        anew = ", drawn anew at every read"
        handed = {"histogram": "volume"} if self._volumes else {}
        fields = (
            f"{handed.get(name, name)}{anew if name in self._light else ''} {self.shape(handed.get(name, name))}"
            for name in self.selected
        )
        return f"TransientDataset({str(self.path)!r}: {len(self)} scenes{part}; {', '.join(fields)})"

    def __getitems__(self, items: Sequence[int]) -> list[dict[str, torch.Tensor]]:
        """Several items in one read each field; the batch that a `DataLoader` asks for."""
        scenes = [int(self.scenes[self._checked(item)]) for item in items]
        drawn = self._drawn(scenes)
        batch = {
            name: torch.from_numpy(drawn[name]) if name in drawn else self._tensor(name, scenes)
            for name in self.selected
            if name != "histogram" or self._instead is None
        } | {"scene": torch.tensor(scenes)}
        if self._instead is None:
            return Batch(batch)
        counts = drawn.get("histogram")
        if counts is None:
            counts = self._stored("histogram", scenes, part=self._parts["histogram"])
        if self._volumes is not None:
            geometry = {name: self._stored(name, scenes, part=self._parts[name]) for name in GEOMETRY}
            return Batch(batch | {"volume": torch.from_numpy(self._volumes.of(scenes, counts, geometry))})
        events, of_events = events_of(counts)
        return Batch(batch, torch.from_numpy(events), torch.from_numpy(self._cast(of_events)))

    def __getstate__(self) -> dict[str, Any]:
        """Open files stay with the process that opened them."""
        return self.__dict__ | {"_reader": None}

    def set_epoch(self, epoch: int, items: Sequence[int] | None = None) -> None:
        """Set the next draw of every item (or of `items`) to number `epoch`; later reads count on from it.

        New noise does not need this call. It repeats the noise of an epoch, continues an earlier run, and makes draws
        independent of reads that workers had begun when an epoch was left early. Running workers see it.
        `EpochSampler` calls it at the start of each epoch.
        """
        chosen = np.arange(len(self)) if items is None else np.asarray(items)
        if chosen.ndim != 1 or (chosen.size and chosen.dtype.kind not in "iu"):
            raise InputError(f"items = {shown(items)}: must be a list of whole numbers, the items' own")
        if self._draws is not None:
            self._draws.fix(epoch, self.scenes[chosen.astype(np.int64)])

    def shape(self, field: str) -> tuple[int, ...]:
        """The shape of one scene's value of a field, as it is handed over."""
        if field == "volume" and self._volumes is not None:
            return self._volumes.shape
        if field not in (*self.fields, *self._light):
            raise InputError(f"shape: {field!r} is not in {self.path}; it has {', '.join(self.fields)}")
        name = self._light.get(field, field)
        return (self._parts[name] or self._schema.by_name[name]).shape

    @property
    def classes(self) -> tuple[str, ...]:
        """What the numbers of `object_class` stand for; empty where the dataset has no such field."""
        field = self._schema.by_name.get("object_class")
        return () if field is None else field.classes

    def parameters(self, name: str) -> NDArray[np.generic]:
        """A column of `samples.parquet` (scene parameters, error estimates) in the order of the items."""
        column: NDArray[np.generic] = read_table(self.path, [name], self._schema.scenes)[name].to_numpy()
        return column[self.scenes]

    @cached_property
    def stats(self) -> dict[str, dict[str, float]]:
        """Field → `mean` and `std` of all its values in this dataset (with `split`, in that split), of a histogram
        those of log(1 + counts), and `nonzero`, the share of values that are not 0. Histograms, and labels that are
        quantities; as stored, not as drawn anew.
        """
        if self._manifest.schema_version < SPLITS_SINCE:
            raise InputError(f"stats: {self.path} is of an earlier schema version, which has none; build it anew")
        columns = [f"stats.{name}.{of}" for name in WITH_STATS if name in self.fields for of in QUANTITIES]
        rows = read_table(self.path, columns, self._schema.scenes).take(self.scenes)
        try:
            return stats_of_rows(rows)
        except (TypeError, ValueError, OverflowError) as error:
            raise CheckError(f"{self.path / TABLE}: its stats are not as datagen writes them ({error})") from None

    def _scenes_of(self, split: str, fractions: tuple[float, float, float] | None) -> NDArray[np.int64]:
        """(N,) the scenes of `self.scenes` that belong to a split."""
        splits = self._manifest.splits()
        if split not in splits.names:
            raise InputError(f"split = {split!r}: {self.path} has {', '.join(splits.names)}")
        if fractions is not None:
            splits = splits.with_shares(fractions)
        scenes = self._schema.scenes
        if fractions is None and self._manifest.schema_version >= SPLITS_SINCE:
            found = read_table(self.path, ["split"], scenes)["split"].to_pylist()
        else:
            found = read_splits(self.path, scenes, splits)
        chosen = self.scenes[[found[scene] == split for scene in self.scenes]]
        if not len(chosen):
            others = Counter(found[scene] for scene in self.scenes)
            there = ", ".join(f"{name} {count}" for name, count in others.items())
            raise InputError(f"split = {split!r}: holds no scene of {self.path} ({there}); other fractions may help")
        return chosen

    def _scenes_with_evidence(self, least: float) -> NDArray[np.int64]:
        """(N,) the scenes of `self.scenes` whose weakest object has this significance, and those without objects."""
        if self._manifest.schema_version < EVIDENCE_SINCE:
            raise InputError(
                f"evidence_at_least: {self.path} is of an earlier schema version, which has none; build it anew"
            )
        table = read_table(self.path, None, self._schema.scenes)
        if "evidence.weakest" not in table.column_names:
            return self.scenes
        weakest = table["evidence.weakest"].to_pylist()
        chosen = self.scenes[[weakest[scene] is None or weakest[scene] >= least for scene in self.scenes]]
        if not len(chosen):
            most = max(weakest[scene] for scene in self.scenes)
            raise InputError(
                f"evidence_at_least = {least:g}: no scene of {self.path} has it in every object, the best "
                f"{most:.3g}; lower it, or build with a longer exposure"
            )
        return chosen

    def _scenes_there(self, manifest: Manifest) -> NDArray[np.int64]:
        there, failed = self._shards_and_failures(manifest)
        if len(there) < self._schema.shards:
            first = next(shard for shard in range(self._schema.shards) if shard not in there)
            raise InputError(
                f"{self.path}: {self._schema.shards - len(there)} of {self._schema.shards} shards are not committed, "
                f"the first is {first}; run the same `datagen build` again to finish it"
            )
        if failed:
            warnings.warn(f"{self.path}: {len(failed)} scenes could not be made and are left out", stacklevel=3)
        return np.delete(np.arange(self._schema.scenes), sorted(failed))

    def _shards_and_failures(self, manifest: Manifest) -> tuple[set[int], set[int]]:
        """The committed shards and the scenes that failed, from the table when the dataset is complete: reading all
        commit records of a large dataset takes long.
        """
        there = {shard for shard in recorded_shards(self.path) if shard < self._schema.shards}
        if len(there) == self._schema.shards and (self.path / TABLE).is_file():
            failure = read_table(self.path, ["failure"], self._schema.scenes)["failure"]
            return there, set(np.flatnonzero(failure.is_valid().to_numpy()).tolist())
        records = committed(self.path, manifest)
        return {record.shard for record in records}, {scene for record in records for scene in record.failures}

    def _checked(self, item: object) -> int:
        try:
            number = operator.index(item)  # type: ignore[arg-type]
        except TypeError:
            several = "; `torch.utils.data.Subset` has several" if isinstance(item, slice | list | tuple) else ""
            raise InputError(f"item {item!r}: must be a whole number{several}") from None
        if not -len(self) <= number < len(self):
            raise IndexError(f"item {number}: this dataset has {len(self)} items")
        return number

    def _stored(
        self, name: str, scenes: Sequence[int], part: Part | None = None, out: NDArray[np.generic] | None = None
    ) -> NDArray[np.generic]:
        if self._reader is None:
            seen = {field: of.numpy() for field, of in self._seen.items()}
            self._reader = DatasetReader(self.path, self._manifest, seen, self._check, seen)
        return self._reader.read(name, scenes, part=part, out=out)

    def _tensor(self, name: str, scenes: Sequence[int]) -> torch.Tensor:
        """(len(scenes), *shape): values as they are stored, counts in the dtype that `counts` names."""
        field = self._schema.by_name[name]
        dtype = self._counts if name in COUNTS and self._counts is not None else np.dtype(field.dtype)
        return torch.from_numpy(
            self._stored(name, scenes, self._parts[name], np.empty((len(scenes), *self.shape(name)), dtype))
        )

    def _cast(self, counts: NDArray[np.generic]) -> NDArray[np.generic]:
        if self._counts is None:
            return counts
        most = int(np.max(counts, initial=0))
        if self._counts.kind == "i" and most > np.iinfo(self._counts).max:
            raise InputError(f"counts = {self._counts.name!r}: {most} counts do not fit; use 'int64'")
        return counts.astype(self._counts)

    def _drawn(self, scenes: Sequence[int]) -> dict[str, NDArray[np.generic]]:
        """Field → (len(scenes), *shape) counts, of those selected fields whose noise is drawn anew."""
        wanted = [name for name in self.selected if name in self._light]
        if not wanted:
            return {}
        assert self._noise is not None and self._draws is not None
        taken, found = self._draws.take(scenes), dict[str, NDArray[np.generic]]()
        for name in wanted:
            light = self._light[name]
            part, every = self._parts[light], []
            for transient, scene, draw in zip(self._stored(light, scenes), scenes, taken, strict=True):
                # A draw is of the whole scan, of which a part is then what it would be in the whole.
                counts = self._noise.draw(light, transient, scene, self.seed, *draw)
                every.append(counts if part is None else part.of(counts))
            drawn = np.stack(every)
            found[name] = drawn if name == "histogram" and self._instead else self._cast(drawn)
        return found
