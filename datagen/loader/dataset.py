"""A dataset on disk as a map-style torch `Dataset`."""

from __future__ import annotations

import operator
import sys
import warnings
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import cached_property
from pathlib import Path
from typing import Any, cast

import numpy as np
import pyarrow as pa
import torch
from numpy.typing import NDArray
from torch.utils.data import Dataset, get_worker_info

from datagen.errors import CheckError, InputError, shown
from datagen.loader.batch import JOINED, Item, NotHandedOn, Whole, goes_to_collate
from datagen.loader.crops import Crops
from datagen.loader.draw_counter import DrawCounter, check_epoch, shared_copy
from datagen.loader.events import events_of
from datagen.loader.redrawn_noise import TRANSIENT_OF, NoiseSource, drawn_field
from datagen.loader.sendable import check_sendable
from datagen.loader.volumes import Volumes
from datagen.loader.windows import Windows
from datagen.reconstruction.backprojection import GEOMETRY
from datagen.records import TimeAxis
from datagen.records.arrays import Ints
from datagen.records.checks import (
    as_names,
    check_callable,
    check_choice,
    check_flag,
    check_kind,
    check_number,
    check_path,
    check_seed,
)
from datagen.store import DatasetReader, Manifest, each_committed, read_manifest
from datagen.store.location import Bucket, location_of
from datagen.store.partial import is_complete, largest, shards_there, table_there
from datagen.store.reader import Part
from datagen.store.record import recorded_shards, scenes_made
from datagen.store.schema import Field
from datagen.store.stats import COUNTS, QUANTITIES, WITH_STATS
from datagen.store.table import TABLE, check_columns, read_table, splits_of_table, stats_of_rows

COUNT_TYPES = ("float32", "float64", "int32", "int64", "stored")


class TransientDataset(Dataset[dict[str, torch.Tensor]]):
    """A dataset on disk as a map-style torch `Dataset`.

    An item maps each field, and `"scene"` (its index), to a tensor of the scene's shape (`data.shape(field)`):
    histogram and transient (L, P, T), label images (row, column), volumes (depth, row, column). `time_of(field)` has
    the bins of T. Of sequences what differs from frame to frame has a leading axis: histogram (F, L, P, T).

    Each process opens the files for itself, at its first read; a dataset can be sent to loader workers that are
    started in any way. Scenes whose simulation failed are left out, with a warning.

    Parameters
    ----------
    path : the folder of a complete dataset that `build` made, or its address `s3://bucket/name`. A complete dataset
        that grows is what it was until the growth is complete.
    fields : names of the fields of an item. `data.fields` lists all fields of the dataset, and "objects" stands for
        those that begin with `object_` (classes, poses and boxes of the objects; `data.classes` names the classes).
    counts : dtype of the histograms of an item, since torch lacks most operations for uint16 and uint32. float32 is
        exact up to 2²⁴ counts a bin. `"stored"` keeps the stored dtype, which has the fewest bytes to move from
        worker to device: cast it there, `batch["histogram"].to(device).float()`. Other fields keep their dtype.
    redraw_noise : draw histograms anew from the stored transient, with the detector of the scene, at every read. The
        n-th read of a scene is its draw n, a function of (`seed`, n, scene). So each epoch has new noise, with any
        wrapper, sampler or worker; you do not have to call `set_epoch`, which sets n. Of sequences each frame has
        noise of its own, and the n-th reads of windows that overlap agree in the frames that both have. A
        `background_histogram` is drawn anew, too, if the dataset has the field `background_transient`; otherwise it
        is the stored one.
    representation : `"dense"`, `"events"` or `"volume"`.
        With `"events"` an item has, instead of `histogram`, the fields `events`, (N, 3) laser, pixel and bin of every
        filled bin (int16, or int32 for long axes), and `counts`, (N,) the counts of these bins. They are an input for
        networks on points, and smaller if most bins are empty. `collate` joins the items of a batch, with the index
        of the sample as the first column, and `dense` turns them into histograms on any device. Of sequences `events`
        has the frame within the item before the laser point.
        With `"volume"` an item has, instead of `histogram`, the field `volume`, float32 (depth, row, column), an
        input for convolutions: the backprojection onto the space behind the label images of the counts minus their
        mean over the scan, in units of their noise, divided by the root of the number of histograms. Noise alone has
        a standard deviation of about 1, and an object stands out from it at the pixels of its label. Of sequences
        each frame has a volume (`minus`). `volume_bounds`, float32 (2, 3), has its lowest and its highest corner
        along (right, up, depth) of the label frame, metres; row 0 is at the top and column 0 at the least right.
    voxels : number of voxels of a `volume` along (depth, row, column).
    minus : what is taken off the counts before a `volume` is made of them: `"scan"`, their mean over the scan, or, of
        sequences, `"mean"`, their mean over the frames of the item, in which what stands is gone.
    frames : items are windows of so many frames of a sequence, and `"frame"` in an item is the first of them. A split
        has all windows of its scenes. Left out: an item is a whole sequence. Of each chunk only the frames of the
        window are decoded (the first read with `check` takes all).
    frame_step : frames from the first one of a window to that of the next; left out: `frames`, so that none overlap.
    split : read the scenes of one split only: `"train"`, `"val"`, `"test"`, or a split that the configuration holds
        out by what scenes show (`splits.held_out`). All scenes that show the same room are in one split, and scenes
        keep their split when the dataset grows.
    fractions : fractions of train, val and test, instead of those of the configuration.
    seed : of the redrawn noise.
    check : compare every value with the digest in its commit record when it is first read, once for all workers and
        epochs; a part is therefore read as a whole the first time. This costs about 1 ms per MiB of decoded values.
        Without it missing and damaged files are still found, but not files that were exchanged.
    lasers : the laser points to read, in this order: a slice, indices, a mask, or rows and columns of a scan that is
        a grid, such as `lasers=np.s_[8:24, 8:24]`. This cuts all fields with that axis: histograms, transients,
        `laser_points`, the `sensor_points` of a confocal scan. Of each chunk only the blocks of 256 KiB from the
        first of these laser points to the last are decoded. Redrawn noise is that of the whole scan, cut afterwards.
    pixels : the pixels to read, in the same way.
    bins : a slice of the time bins (of the histogram, where the sensor merges bins). It saves memory; it saves
        decoding only together with the other two.
    transform : a function from an item to what is used in its place, such as the item with `histogram` normalised. It
        runs where the item is read: in the worker, if the loader has workers. Workers that are started by spawn need
        a function that `pickle` can send, one at the top of a module.
    evidence_at_least : read only scenes in which every object has at least this significance (docs/physics.md); below
        3 nothing can be learnt. Scenes without objects stay. `data.parameters("evidence.weakest")` has the
        significance of the weakest object of each scene, and the field `object_significance` (label `objects`) that
        of each object.
    partial : read the shards that are there now, while the first build or the growth of a dataset goes on or after it
        was interrupted. Shards that are made later are there when the dataset is opened anew. A scene may change its
        split as long as the first scene that shows its room is missing.

    Raises
    ------
    InputError : the folder is no dataset, shards are not committed, an unknown field or split, an empty split, or
        no scene with so much evidence.
    CheckError : values are missing, damaged or not as written; mostly while reading, with file, scene and remedy.

    Examples
    --------
    Batches of a dataset (the docstring of `build` makes one):

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
        transform: Callable[[Item], Any] | None = None,
        evidence_at_least: float | None = None,
        partial: bool = False,
        frames: int | None = None,
        frame_step: int | None = None,
        minus: str = "scan",
    ) -> None:
        if not isinstance(path, Bucket):
            check_path("path", path, "name the folder that build made")
        check_seed(seed)
        wanted = as_names("fields", fields, "such as ('histogram', 'depth')")
        for name, flag in (("redraw_noise", redraw_noise), ("check", check), ("partial", partial)):
            check_flag(name, flag)
        if evidence_at_least is not None:
            sigmas = "standard deviations, such as 3"
            check_number("TransientDataset", "evidence_at_least", evidence_at_least, 0.0, 1e9, sigmas)
        check_callable("transform", transform, "it gets an item and returns one")
        self.transform = transform
        # Read first: where a link leads to itself there is no dataset, and no path.
        manifest = read_manifest(path)
        self.path = location_of(path).resolve()
        # Whether shards are missing, so that the records of the others stand in for the table.
        self._partial = partial and not is_complete(self.path, largest(self.path, manifest))
        self._manifest = manifest = largest(self.path, manifest) if self._partial else manifest
        self._schema = manifest.schema
        self.fields = tuple(self._schema.by_name)
        tables = tuple(name for name in self.fields if name.startswith("object_")) or ("objects",)
        self.selected = tuple(dict.fromkeys(f for name in wanted for f in (tables if name == "objects" else (name,))))
        # Histogram that is drawn anew → field of the transient that it is drawn from.
        self._light = {name: light for name, light in TRANSIENT_OF.items() if redraw_noise and light in self.fields}
        for name in self.selected:
            if name not in self.fields and name not in self._light:
                raise InputError(f"fields: {name!r} is not in {path}; it has {', '.join(self.fields)}")
        self._counts = self._dtype_of_counts(counts)
        check_choice("representation", representation, ("dense", "events", "volume"))
        # The representation that replaces the histogram of an item, if any.
        self._instead = representation if representation != "dense" and "histogram" in self.selected else None
        if self._instead == "events":
            # Compiled here, once, before workers are forked.
            events_of(np.zeros((1, 1, 1, 64), self._schema.by_name["histogram"].dtype))
        if redraw_noise and "transient" not in self.fields:
            raise InputError(
                f"redraw_noise: {path} has no field transient to draw from; build it with one (store.fields)"
            )
        check_choice("minus", minus, ("scan", "mean"))
        self._crops = Crops(manifest, lasers, pixels, bins)
        self._windows = Windows.of(manifest, frames, frame_step)
        # Fields of an item: those stored, and histograms that are drawn although none is stored.
        self._fields = {name: drawn_field(name, light, manifest) for name, light in self._light.items()}
        self._fields |= self._schema.by_name
        # Of each field the part of each window; the same one for what all frames share. Of light that counts are
        # drawn from, that of the whole scan, and what is cut from the counts then.
        self._parts = {name: self._parts_of(field, self._crops) for name, field in self._fields.items()}
        whole = Crops(manifest, None, None, None)
        self._whole_scans = {name: self._parts_of(self._fields[name], whole) for name in self._light.values()}
        self._cuts = {
            name: self._crops.part(self._fields[name], np.arange(self._windows.length or 1))
            if self._crops.chosen else None
            for name in self._light
        }  # fmt: skip
        self._volumes = Volumes(manifest, self._crops, voxels, minus) if self._instead == "volume" else None
        self._noise = NoiseSource(manifest) if redraw_noise else None
        number = len(self._windows.firsts)
        self._draws = DrawCounter(self._schema.scenes * number) if redraw_noise else None
        self.scenes = self._scenes_there(manifest)
        self.split = split
        if split is not None:
            self.scenes = self._scenes_of(split, fractions)
        elif fractions is not None:
            raise InputError("fractions: divide a dataset into splits; name the one to read, such as split='train'")
        if evidence_at_least is not None:
            self.scenes = self._scenes_with_evidence(evidence_at_least)
        # (N,) scene and window of each item.
        self._window = np.tile(np.arange(number), len(self.scenes))
        self.scenes = np.repeat(self.scenes, number)
        self.seed = seed
        # In shared memory, so that no worker checks a value that another has checked.
        stored = [self._light.get(name, name) for name in self.selected]
        stored += GEOMETRY if self._volumes else ()
        self._seen: dict[str, Any] = {
            name: shared_copy(torch.zeros(self._schema.scenes, dtype=torch.bool)) for name in stored
        }
        self._check = check
        self._reader: DatasetReader | None = None

    def __len__(self) -> int:
        return len(self.scenes)

    def __getitem__(self, item: int) -> dict[str, torch.Tensor]:
        place = self._place_of(item)
        found = self._item(place, self._draws_of([place])[0])
        if self.transform is None:
            return found
        changed = self.transform(found)
        if changed is None:
            raise InputError(f"transform: returned nothing for item {item}; it must return the item")
        return cast(dict[str, torch.Tensor], changed)

    def __repr__(self) -> str:
        part = f" of split {self.split!r}" if self.split else ""
        part += f"; of each {self._crops}" if self._crops.chosen else ""
        anew = ", drawn anew at every read"
        handed = {"histogram": "volume"} if self._volumes else {}
        fields = (
            f"{handed.get(name, name)}{anew if name in self._light else ''} {self.shape(handed.get(name, name))}"
            for name in self.selected
        )
        items = f"{len(self)} scenes"
        if self._windows.are_asked_for:
            scenes = len(np.unique(self.scenes))
            items = f"{len(self)} windows of {self._windows.length} frames, in {scenes} scenes"
        return f"TransientDataset({str(self.path)!r}: {items}{part}; {', '.join(fields)})"

    @NotHandedOn
    def __getitems__(self, items: Sequence[int]) -> list[dict[str, torch.Tensor]]:
        """Several items; a `DataLoader` calls this for a batch. They are those that `data[item]` gives one by one."""
        # In a worker torch joins items in the memory in which they are sent, so that nothing is gained there.
        if self.gives_stored_items and get_worker_info() is None and goes_to_collate(sys._getframe(1)):
            places = [self._place_of(item) for item in items]
            return cast(list[Item], Whole(self._whole(places, self._draws_of(places))))
        # What a subclass or a transform makes of an item happens to each item. But a class that has ways of its own
        # to read one and several gets here what it changes in either.
        classes: list[Any] = [*type(self).__mro__]
        several = [one for one in classes[: classes.index(TransientDataset)] if "__getitems__" in vars(one)]
        if several and "__getitem__" in vars(several[-1]):
            return [super(several[-1], self).__getitem__(item) for item in items]
        return [self[item] for item in items]

    def __getstate__(self) -> dict[str, Any]:
        """The state without the reader: each process makes its own."""
        check_sendable("transform", self.transform)
        return self.__dict__ | {"_reader": None}

    def __setstate__(self, state: dict[str, Any]) -> None:
        """A copy has memory of its own that it shares with its workers."""
        self.__dict__.update(state)
        self._seen = {name: seen if seen.is_shared() else shared_copy(seen) for name, seen in self._seen.items()}

    def set_epoch(self, epoch: int, items: Sequence[int] | None = None) -> None:
        """Set the next draw of every item (or of `items`) to number `epoch`; later reads count on from it.

        You do not have to call this for new noise. Call it to repeat the noise of an epoch, to continue an earlier
        run, or to make draws independent of reads that workers had begun when an epoch was left early. Running
        workers follow. `EpochSampler` calls it at the start of each epoch.
        """
        chosen = np.arange(len(self)) if items is None else np.asarray(items)
        if chosen.ndim != 1 or (chosen.size and chosen.dtype.kind not in "iu"):
            raise InputError(f"items = {shown(items)}: must be a list of whole numbers, the items' own")
        check_epoch(epoch)
        if self._draws is not None:
            self._draws.fix(epoch, self.drawn[chosen.astype(np.int64)])

    def state_dict(self) -> dict[str, Any]:
        """How often each scene was read, which redrawn noise goes on from; empty without `redraw_noise`.

        torchdata's `StatefulDataLoader` saves it with its own state.
        """
        return {} if self._draws is None else {"draws": self._draws.state_dict()}

    def load_state_dict(self, state: Mapping[str, Any]) -> None:
        """Go on with the noise after the reads of a state that `state_dict` returned.

        Raises `InputError` for the state of a dataset of another size, or without redrawn noise.
        """
        check_kind("load_state_dict", state, Mapping, remedy="what state_dict returned")
        if self._draws is not None:
            self._draws.load_state_dict(state.get("draws", {}))

    def shape(self, field: str) -> tuple[int, ...]:
        """The shape of a field of an item."""
        check_kind("field", field, str, remedy=f"one of {', '.join(self.fields)}")
        if field == "volume" and self._volumes is not None:
            frames = () if self._windows.length is None else (self._windows.length,)
            return (*frames, *self._volumes.shape)
        if field == "volume_bounds" and self._volumes is not None:
            return (2, 3)
        if field not in self._fields:
            raise InputError(f"field = {shown(field)}: is not in {self.path}; it has {', '.join(self.fields)}")
        return (self._parts[field][0] or self._fields[field]).shape

    def time_of(self, field: str = "histogram") -> TimeAxis:
        """The bins of a histogram or a transient of an item. They differ where the sensor merges bins
        (`detector.bins_merged`)."""
        check_kind("field", field, str, remedy="name histogram or transient")
        axis, part = self._manifest.time_of(field), self._parts.get(field, [None])[0]
        if field not in self._fields or self._fields[field].dims[-1] not in ("bin", "transient_bin"):
            raise InputError(
                f"field = {shown(field)}: has no axis of time in {self.path}; name histogram or transient"
            )
        if part is None or not isinstance(part.last, slice):
            return axis
        first, stop = part.last.start, part.last.stop
        return replace(axis, bins=stop - first, start_s=axis.start_s + first * axis.width_s)

    @property
    def drawn(self) -> Ints:
        """(N,) number of what is drawn anew in each item: its scene, or the window among those of all scenes. Draws
        are counted for each number."""
        return self.scenes * len(self._windows.firsts) + self._window

    @property
    def first_frames(self) -> Ints:
        """(N,) the first frame of each item; 0 without windows."""
        return np.asarray(self._windows.firsts[self._window])

    @property
    def gives_stored_items(self) -> bool:
        """Whether items are as they were stored or drawn; False if a subclass or a transform may change them."""
        return self.reads_its_items and self.transform is None

    @property
    def reads_its_items(self) -> bool:
        """Whether an item is one read of the scene of its number; False if a subclass may read others."""
        return type(self).__getitem__ is _OWN_ITEM

    def layout(self) -> dict[str, str]:
        """What datasets have in common that can be joined: fields of an item; shape, type, unit and bins of each."""
        found = {"fields": ", ".join(self.selected) + (f" as {self._instead}" if self._instead else "")}
        for name in self.selected:
            field = self._fields[name]
            dtype = self._counts if name in COUNTS and self._counts is not None else field.dtype
            found |= {f"shape of {name}": str(self.shape(name)), f"type of {name}": str(dtype)}
            found |= {f"unit of {name}": field.unit, f"classes of {name}": ", ".join(field.classes)}
            if field.dims[-1] in ("bin", "transient_bin"):
                axis = self.time_of(name)
                width, start = axis.width_s * 1e12, axis.start_s * 1e9
                found[f"bins of {name}"] = f"{width:.9g} ps from {start:.9g} ns since {axis.origin}"
        if self._volumes is not None:
            found["shape of volume"] = str(self.shape("volume"))
        return found

    @property
    def classes(self) -> tuple[str, ...]:
        """Names of the classes that `object_class` numbers; empty if the dataset has no such field."""
        field = self._schema.by_name.get("object_class")
        return () if field is None else field.classes

    def parameters(self, name: str) -> NDArray[np.generic]:
        """A column of `samples.parquet` (scene parameters, error estimates) in the order of the items."""
        check_kind("name", name, str, remedy="a column of samples.parquet")
        column: NDArray[np.generic] = self._table([name])[name].take(self.scenes).to_numpy()
        return column

    @cached_property
    def stats(self) -> dict[str, dict[str, float]]:
        """Field → `mean` and `std` of its values in all scenes of this dataset (with `split`: of the split), of a
        histogram those of log(1 + counts); and `nonzero`, the fraction of values that are not 0. It has the
        histograms, as stored (not as drawn anew), and the labels that are quantities."""
        columns = [
            f"stats.{name}.{quantity}" for name in WITH_STATS if name in self.fields for quantity in QUANTITIES
        ]
        # All scenes have as many windows.
        rows = self._table(columns).take(np.unique(self.scenes))
        try:
            return stats_of_rows(rows)
        except (TypeError, ValueError, OverflowError) as error:
            raise CheckError(f"{self.path / TABLE}: its stats are not as datagen writes them ({error})") from None

    def _table(self, columns: Sequence[str] | None) -> pa.Table:
        """Columns of the table (None: all), with a row for each scene of the dataset."""
        if not self._partial:
            return read_table(self.path, columns, self._schema.scenes)
        table = table_there(self.path, self._manifest)
        check_columns(self.path / TABLE, columns, table.column_names)
        return table if columns is None else table.select([*columns])

    def _scenes_of(self, split: str, fractions: tuple[float, float, float] | None) -> Ints:
        """(N,) the scenes of `self.scenes` that belong to a split."""
        splits = self._manifest.splits()
        if not isinstance(split, str) or split not in splits.names:
            raise InputError(f"split = {shown(split)}: {self.path} has {', '.join(splits.names)}")
        if fractions is not None:
            splits = splits.with_shares(fractions)
        if fractions is None:
            found = self._table(["split"])["split"].to_pylist()
        else:
            found = splits_of_table(self._table(None), splits)
        chosen = self.scenes[[found[scene] == split for scene in self.scenes]]
        if not len(chosen):
            others = Counter(found[scene] for scene in self.scenes)
            there = ", ".join(f"{name} {count}" for name, count in others.items())
            raise InputError(f"split = {split!r}: holds no scene of {self.path} ({there}); other fractions may help")
        return chosen

    def _scenes_with_evidence(self, least: float) -> Ints:
        """(N,) the scenes of `self.scenes` in which every object has at least this significance."""
        table = self._table(None)
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

    def _scenes_there(self, manifest: Manifest) -> Ints:
        """(N,) the scenes that could be made. Raises `InputError` if shards are missing."""
        if self._partial:
            made = [scene.index for scene in scenes_made(shards_there(self.path, manifest))]
            if not made:
                raise InputError(f"{self.path}: no scene of it is there yet; wait for `datagen build`")
            return np.array(made, np.int64)
        there, failed = self._shards_and_failures(manifest)
        if len(there) < self._schema.shards:
            first = next(shard for shard in range(self._schema.shards) if shard not in there)
            raise InputError(
                f"{self.path}: {self._schema.shards - len(there)} of {self._schema.shards} shards are not committed, "
                f"the first is {first}; run the same `datagen build` again to finish it, or read those that are "
                "there with partial=True"
            )
        if failed:
            warnings.warn(f"{self.path}: {len(failed)} scenes could not be made and are left out", stacklevel=3)
        return np.delete(np.arange(self._schema.scenes), sorted(failed))

    def _shards_and_failures(self, manifest: Manifest) -> tuple[set[int], set[int]]:
        """The committed shards and the failed scenes. They come from the table if the dataset is complete, because
        reading all commit records of a large dataset takes long."""
        there = {shard for shard in recorded_shards(self.path) if shard < self._schema.shards}
        if len(there) == self._schema.shards and (self.path / TABLE).is_file():
            failure = read_table(self.path, ["failure"], self._schema.scenes)["failure"]
            return there, set(np.flatnonzero(failure.is_valid().to_numpy()).tolist())
        found = {record.shard: record.failures for record in each_committed(self.path, manifest)}
        return {*found}, {scene for failures in found.values() for scene in failures}

    def _dtype_of_counts(self, counts: object) -> np.dtype[Any] | None:
        """The dtype that `counts` names; None for "stored"."""
        check_choice("counts", counts, COUNT_TYPES)
        if counts == "int32" and "histogram" in self.fields and self._schema.by_name["histogram"].dtype == "uint32":
            raise InputError("counts = 'int32': histograms are stored as uint32, which it cannot hold; use 'int64'")
        return None if counts == "stored" else np.dtype(str(counts))

    def _parts_of(self, field: Field, crops: Crops) -> list[Part | None]:
        """The part of a field that is read of each window."""
        every = range(len(self._windows.firsts))
        if not self._windows.are_asked_for or field.frame_bytes is None:
            return [crops.part(field)] * len(every)
        return [crops.part(field, self._windows.frames_of(window)) for window in every]

    def _place_of(self, item: object) -> int:
        """The place of an item among `scenes`."""
        try:
            number = operator.index(item)  # type: ignore[arg-type]
        except TypeError:
            several = "; `torch.utils.data.Subset` has several" if isinstance(item, slice | list | tuple) else ""
            raise InputError(f"item {shown(item)}: must be a whole number{several}") from None
        # A subclass may have another length, and choose items by itself.
        if not -len(self.scenes) <= number < len(self.scenes):
            raise IndexError(f"item {shown(number)}: this dataset has {len(self.scenes)} items")
        return number % len(self.scenes)

    def _draws_of(self, places: Sequence[int]) -> list[tuple[int, int]]:
        """(number, stream) of the draw of each item, where any field is drawn."""
        drawn = self._draws is not None and any(name in self._light for name in self.selected)
        if not drawn or self._draws is None:
            return [(0, 0)] * len(places)
        windows = len(self._windows.firsts)
        return self._draws.take([int(self.scenes[k]) * windows + int(self._window[k]) for k in places])

    def _item(self, place: int, draw: tuple[int, int]) -> Item:
        """One item, in memory of its own."""
        whole = self._whole([place], [draw])
        item = {name: values[0] for name, values in whole.items() if name not in JOINED}
        if "events" in whole:
            # Without the first column, the index of the sample.
            item |= {"events": whole["events"][:, 1:].contiguous(), "counts": whole["counts"]}
        return item

    def _whole(self, places: Sequence[int], draws: Sequence[tuple[int, int]]) -> Item:
        """The batch of some items, with one read for each field."""
        scenes, windows = self.scenes[places].tolist(), self._window[places].tolist()
        drawn = self._drawn(scenes, windows, draws)
        batch = {
            name: torch.from_numpy(drawn[name]) if name in drawn else self._tensor(name, scenes, windows)
            for name in self.selected
            if name != "histogram" or self._instead is None
        } | {"scene": torch.tensor(scenes)}
        if self._windows.are_asked_for:
            batch["frame"] = torch.tensor(self._windows.firsts[windows].tolist())
        if self._instead is None:
            return batch
        counts = drawn.get("histogram")
        if counts is None:
            counts = self._stored("histogram", scenes, windows)
        if self._volumes is not None:
            geometry = {name: self._stored(name, scenes, windows) for name in GEOMETRY}
            volumes, bounds = self._volumes.backproject(scenes, counts, geometry)
            return batch | {"volume": torch.from_numpy(volumes), "volume_bounds": torch.from_numpy(bounds)}
        events, of_events = events_of(counts)
        return batch | {"events": torch.from_numpy(events), "counts": torch.from_numpy(self._cast(of_events))}

    def _stored(
        self, name: str, scenes: Sequence[int], windows: Sequence[int], out: NDArray[np.generic] | None = None,
        parts: Sequence[Part | None] | None = None,
    ) -> NDArray[np.generic]:  # fmt: skip
        """(len(scenes), …) stored values of a field in some windows. parts : of each window; left out: those of an
        item."""
        if self._reader is None:
            seen = {field: checked.numpy() for field, checked in self._seen.items()}
            self._reader = DatasetReader(self.path, self._manifest, seen, self._check, seen)
        every = self._parts[name] if parts is None else parts
        chosen = [part for window in windows if (part := every[window]) is not None]
        return self._reader.read(name, scenes, part=chosen or None, out=out)

    def _tensor(self, name: str, scenes: Sequence[int], windows: Sequence[int]) -> torch.Tensor:
        """(len(scenes), *shape) stored values of a field; histograms in the dtype that `counts` names."""
        field = self._schema.by_name[name]
        dtype = self._counts if name in COUNTS and self._counts is not None else np.dtype(field.dtype)
        return torch.from_numpy(
            self._stored(name, scenes, windows, np.empty((len(scenes), *self.shape(name)), dtype))
        )

    def _cast(self, counts: NDArray[np.generic]) -> NDArray[np.generic]:
        if self._counts is None:
            return counts
        most = int(np.max(counts, initial=0))
        if self._counts.kind == "i" and most > np.iinfo(self._counts).max:
            raise InputError(f"counts = {self._counts.name!r}: {most} counts do not fit; use 'int64'")
        return counts.astype(self._counts)

    def _drawn(
        self, scenes: Sequence[int], windows: Sequence[int], draws: Sequence[tuple[int, int]]
    ) -> dict[str, NDArray[np.generic]]:
        """Field → (len(scenes), *shape) counts, of the selected fields whose noise is drawn anew."""
        found = dict[str, NDArray[np.generic]]()
        for name in (name for name in self.selected if name in self._light):
            light, every = self._light[name], []
            # Noise is drawn for the whole scan and cut afterwards, so that a part equals that part of the whole.
            stored = self._stored(light, scenes, windows, parts=self._whole_scans[light])
            for transient, scene, window, draw in zip(stored, scenes, windows, draws, strict=True):
                counts, part = self._draw(light, transient, scene, window, draw), self._cuts[name]
                every.append(counts if part is None else part.cut(counts))
            drawn = np.stack(every)
            found[name] = drawn if name == "histogram" and self._instead else self._cast(drawn)
        return found

    def _draw(
        self, light: str, transient: NDArray[np.generic], scene: int, window: int, draw: tuple[int, int]
    ) -> NDArray[np.generic]:
        """Counts of a scene, or of each frame of a window, drawn from its transient."""
        assert self._noise is not None
        if self._windows.length is None:
            return self._noise.draw(light, transient, scene, self.seed, *draw)
        frames = self._windows.frames_of(window).tolist()
        drawn = [
            self._noise.draw(light, one, scene, self.seed, *draw, frame)
            for one, frame in zip(transient, frames, strict=True)
        ]
        return np.stack(drawn)


_OWN_ITEM = TransientDataset.__getitem__
"""How items are read, unless a subclass or a user has put something in its place."""
