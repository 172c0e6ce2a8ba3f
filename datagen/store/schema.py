"""The schema of a dataset: fields, shapes, units, and the division into chunks and shards.

The schema follows from the configuration alone, so every shape is known before the first scene is made. Histograms
are (L, P, T) for `L` laser points, `P` pixels for each (1 in a confocal scan) and `T` bins, transients likewise (with
more bins where the sensor merges bins); label images have the configured rows and columns.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from datagen.config import DatasetConfig
from datagen.config.scene_layouts import ImportedCaptures
from datagen.errors import InputError
from datagen.records.label_fields import LABEL_FIELDS
from datagen.records.sample import OF_THE_DEVICE

FORMAT, FORMAT_OF_SEQUENCES = 1, 2
"""Numbers of the stored format: of scenes that are measured once, and of sequences, whose fields have an axis
`frame`. A number rises when the bytes of a file or the meaning of a field change, not when a field is added, nor when
a seed gives other light: `made_by` in `dataset.json` has the version of datagen for that."""
CHUNK_BYTES = 4 * 2**20
"""Largest raw size of a chunk; a scene with more is cut, first along `laser`. Smaller chunks take more requests to an
object store; the time to read from a disk does not depend on it."""
SHARD_BYTES = 256 * 2**20
"""Largest raw size of a shard over all fields: a worker holds a shard in memory, and each shard has its files."""
LARGEST_CHUNK_BYTES = 2**31 - 17
"""Blosc's own limit."""
LARGEST_SCENE_BYTES = 2**34
"""Largest raw size of one field of a scene: a worker's memory could not hold more."""

_MEASURED = ("laser", "pixel", "bin")
_LIGHT = ("laser", "pixel", "transient_bin")
"""Axes of a transient whose bins the sensor merges (`detector.bins_merged`), so that a histogram has fewer."""


@dataclass(frozen=True)
class Field:
    """One array of a dataset.

    dims : dimension names; the first is `scene`, of what differs from frame to frame the second `frame`. A name has
        the same size in all fields of a dataset.
    shape : the shape of one scene's value, without the scene axis.
    sharded : whether each scene has chunks of its own, in shards of K scenes (large fields), or a chunk holds K
        scenes (small fields).
    classes : names of the classes 0, 1, 2 …, if the values are classes.
    """

    name: str
    dims: tuple[str, ...]
    shape: tuple[int, ...]
    dtype: str
    unit: str
    meaning: str
    sharded: bool = True
    classes: tuple[str, ...] = ()

    @property
    def bytes_per_scene(self) -> int:
        """Raw bytes of one scene's value."""
        return math.prod(self.shape) * np.dtype(self.dtype).itemsize

    @property
    def frame_bytes(self) -> int | None:
        """Raw bytes of one frame; None for a field that does not differ from frame to frame."""
        return self.bytes_per_scene // self.shape[0] if self.dims[1:2] == ("frame",) else None

    @property
    def chunk(self) -> tuple[int, ...]:
        """The shape of the part of one scene that is compressed, and read, as a whole.

        The leading axes are cut, of a sequence between frames first, until a chunk has at most `CHUNK_BYTES`. The
        last axis (time, or an image row) is never cut.
        """
        cut = list(self.shape)
        for axis in range(len(cut) - 1):
            size = math.prod(cut) * np.dtype(self.dtype).itemsize
            if size <= CHUNK_BYTES:
                break
            most = max(1, CHUNK_BYTES // (size // cut[axis]))
            cut[axis] = math.ceil(cut[axis] / math.ceil(cut[axis] / most))
        return tuple(cut)


@dataclass(frozen=True)
class Schema:
    """All fields of a dataset and its division into shards: shard s holds scenes s·K … min((s+1)·K, scenes) − 1."""

    fields: tuple[Field, ...]
    scenes: int
    scenes_per_shard: int

    @property
    def shards(self) -> int:
        """The number of shards."""
        return math.ceil(self.scenes / self.scenes_per_shard)

    def scenes_of(self, shard: int) -> range:
        """The scene indices of a shard."""
        k = self.scenes_per_shard
        return range(shard * k, min((shard + 1) * k, self.scenes))

    @cached_property
    def by_name(self) -> dict[str, Field]:
        """Name → field."""
        return {field.name: field for field in self.fields}

    @property
    def bytes_per_scene(self) -> int:
        """Raw bytes of one scene over all fields."""
        return sum(field.bytes_per_scene for field in self.fields)


def schema_of(config: DatasetConfig, scenes_per_shard: int | None = None) -> Schema:
    """The schema that a configuration describes.

    scenes_per_shard : that of an existing dataset, which keeps it.

    Raises `InputError` if one time series is larger than a chunk can be.
    """
    fields = _measured_fields(config) + _label_fields(config) + _small_fields(config)
    if scenes_per_shard is None:
        scenes_per_shard = config.store.scenes_per_shard or _scenes_per_shard(fields, config.scenes)
    for field in fields:
        check_size(field, scenes_per_shard)
    return Schema(fields, config.scenes, scenes_per_shard)


def check_size(field: Field, scenes_per_shard: int) -> None:
    """Raise `InputError` if a chunk of a field exceeds `LARGEST_CHUNK_BYTES`, or a scene `LARGEST_SCENE_BYTES`."""
    scenes = 1 if field.sharded else scenes_per_shard
    chunk = math.prod(field.chunk if field.sharded else field.shape)
    chunk_bytes = scenes * chunk * np.dtype(field.dtype).itemsize
    if chunk_bytes > LARGEST_CHUNK_BYTES:
        raise InputError(
            f"field {field.name!r}: {field.shape} values a scene need a chunk of {chunk_bytes} bytes, at most "
            f"{LARGEST_CHUNK_BYTES} are possible; take fewer bins{'' if field.sharded else ' or scenes a shard'}"
        )
    if field.bytes_per_scene > LARGEST_SCENE_BYTES:
        raise InputError(
            f"field {field.name!r}: {field.shape} values a scene are {field.bytes_per_scene} bytes, at most "
            f"{LARGEST_SCENE_BYTES} are possible; take fewer bins, laser points or pixels"
        )


def _scenes_per_shard(fields: tuple[Field, ...], scenes: int) -> int:
    """K, the number of scenes in a shard: the largest power of two up to 256 that leaves eight shards to the dataset,
    but at least 8; less than 8 only if eight scenes would exceed `SHARD_BYTES`. It does not depend on the number of
    workers, so the stored bytes do not either."""
    k = 256
    while k > 8 and k * 8 > scenes:
        k //= 2
    while k > 1 and k * sum(field.bytes_per_scene for field in fields) > SHARD_BYTES:
        k //= 2
    return k


def _measured_fields(config: DatasetConfig) -> tuple[Field, ...]:
    """The measurements that the configuration stores."""
    before, frames = (("scene",), ()) if config.sequence is None else (("scene", "frame"), (config.sequence.frames,))
    measured, light = (*frames, *config.histogram_shape), (*frames, *config.capture.shape)
    counted = (*before, *_MEASURED)
    of_light = counted if measured == light else (*before, *_LIGHT)
    imported = isinstance(config.scene.layout, ImportedCaptures)
    photons = "as in the file" if imported else "photons at the aperture per emitted photon"
    known = (
        Field("histogram", counted, measured, config.store.histogram_dtype, "counts",
              "photons detected over the exposure"),
        Field("transient", of_light, light, "float32", photons,
              "signal over time, as the file has it" if imported else
              "expected impulse response of the scene, before the detector"),
        Field("transient_stderr", of_light, light, "float32", photons,
              "standard error of the transient from independent replicates; NaN when there was only one"),
        Field("moving_transient", of_light, light, "float32", photons,
              "light of the frame less that of the scene without what moves: what that brings less what it blocks"),
        Field("background_histogram", counted, measured, config.store.histogram_dtype, "counts",
              "photons detected over an exposure of the same room without its objects, with noise of its own"),
        Field("background_transient", of_light, light, "float32", photons,
              "expected impulse response of the same room without its objects"),
    )  # fmt: skip
    return tuple(field for field in known if field.name in config.store.fields)


def _label_fields(config: DatasetConfig) -> tuple[Field, ...]:
    """The labels that the configuration stores; tables have rows enough for the objects of every scene of it."""
    classes, voxels = config.scene.object_classes(), config.labels.voxels
    if "objects" in config.store.fields and len(classes) > np.iinfo(np.int16).max:
        raise InputError(f"store.fields: 'objects' can number 32767 classes, scene.contents has {len(classes)}")
    is_sequence = config.sequence is not None
    sizes = {
        "frame": 1 if config.sequence is None else config.sequence.frames,
        "row": config.labels.rows, "column": config.labels.columns, "axis": 3, "own_axis": 3,
        "voxel_depth": voxels[0], "voxel_row": voxels[1], "voxel_column": voxels[2],
        "object": config.scene.most_objects(), "sensor_pixel": _all_pixels(config),
    }  # fmt: skip
    return tuple(
        Field(
            of.name, ("scene", *of.dims_in(is_sequence)), tuple(sizes[name] for name in of.dims_in(is_sequence)),
            of.dtype, of.unit, of.meaning, sharded=of.is_image or of.is_volume,
            classes=classes if of.name == "object_class" else (),
        )
        for of in LABEL_FIELDS
        if of.label in config.store.fields and (is_sequence or of.over_frames != "only")
    )  # fmt: skip


def _all_pixels(config: DatasetConfig) -> int:
    """Number of all pixels of the sensor."""
    confocal = config.capture.pairing == "confocal"
    return config.capture.scan.laser_points if confocal else config.capture.shape[1]


def _small_fields(config: DatasetConfig) -> tuple[Field, ...]:
    """The fields that say where laser, sensor, relay wall and hidden part are; every dataset has them."""
    lasers, all_pixels = config.capture.scan.laser_points, _all_pixels(config)
    rectangle = ("scene", "vector", "axis")
    imported = isinstance(config.scene.layout, ImportedCaptures)
    unknown = "; NaN when unknown" if imported else ""
    unstated = " and where the file does not say it" if imported else ""
    # The axis `laser` of a flood's histograms has length 1, so its many points need an axis of another name.
    point = "laser" if lasers == config.capture.shape[0] else "laser_point"
    small = (
        ("laser_points", ("scene", point, "axis"), (lasers, 3),
         "where each laser ray meets the scene (of a flood: its quadrature points); NaN where it meets nothing"),
        ("laser_normals", ("scene", point, "axis"), (lasers, 3),
         f"unit normal of the surface at each laser point, on the laser's side; NaN as in laser_points{unstated}"),
        ("sensor_pixels", ("scene", "sensor_pixel", "corner", "axis"), (all_pixels, 4, 3),
         ("corners, in order around, of each pixel's field of view on (or beyond) the relay wall"
          if config.capture.device is None else
          "corners, in order around, of each pixel's field of view in the plane 1 m ahead of the sensor")
         + ("; all on one point: its extent is unknown" if imported and config.capture.device is None else "")),
        ("sensor_points", ("scene", "sensor_pixel", "axis"), (all_pixels, 3),
         "where the ray from the sensor through the middle of each pixel first meets the scene; NaN where it meets "
         f"nothing{unstated}"),
        ("sensor_normals", ("scene", "sensor_pixel", "axis"), (all_pixels, 3),
         f"unit normal of the surface at each of sensor_points, on the sensor's side; NaN as there{unstated}"),
        ("laser_position", ("scene", "axis"), (3,), f"where the laser stands{unknown}"),
        ("sensor_position", ("scene", "axis"), (3,), f"centre of the sensor's aperture{unknown}"),
        ("relay_wall", rectangle, (3, 3), "the visible wall: centre and half extents right, up; NaN when unknown"),
        ("hidden_view", rectangle, (3, 3),
         "the rectangle label images look from: centre and half extents right, up; NaN when unknown"),
        ("hidden_bounds", ("scene", "bound", "axis"), (2, 3),
         "two opposite corners of the box that holds the hidden part; NaN when unknown"),
    )  # fmt: skip
    fields = tuple(
        Field(name, dims, shape, "float64", "1" if name.endswith("normals") else "m", text, sharded=False)
        for name, dims, shape, text in small
    )
    if config.sequence is None:
        return fields
    if config.capture.motion is not None:
        fields = tuple(
            replace(of, dims=("scene", "frame", *of.dims[1:]), shape=(config.sequence.frames, *of.shape))
            if of.name in OF_THE_DEVICE else of
            for of in fields
        )  # fmt: skip
    times = Field(
        "laser_time", ("scene", "frame", "laser"), (config.sequence.frames, config.capture.shape[0]), "float64", "s",
        "middle of the exposure of each laser point, since the first frame began", sharded=False,
    )  # fmt: skip
    return (*fields, times)
