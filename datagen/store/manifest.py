"""`dataset.json`, the manifest: configuration, fields and origin. A folder with a manifest is a dataset."""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated, Any, Literal

import pydantic

from datagen.config import DatasetConfig, SplitsConfig, config_from_mapping, stored_axes
from datagen.config.capture import TimeConfig
from datagen.config.dataset import MOST_SCENES
from datagen.config.imported import ImportedFile
from datagen.config.scene_contents import MeshFolder, MeshItem
from datagen.config.scene_layouts import ImportedCaptures
from datagen.errors import InputError, shown
from datagen.records import TimeAxis
from datagen.records.clock import MOST_FRAMES
from datagen.store.arrays import GROUP, Axis, coordinates, metadata_files, shard_shape
from datagen.store.environment import STATED, made_with
from datagen.store.files import is_intact, parsed_json, read_if_there, sealed_bytes
from datagen.store.location import Location, location_of
from datagen.store.record import Digest, recorded_shards
from datagen.store.schema import FORMAT, FORMAT_OF_SEQUENCES, Field, Schema, check_size, schema_of
from datagen.store.stats import FieldStats
from datagen.store.table import COLUMNS, TABLE

MANIFEST = "dataset.json"
REMEDY = "build the dataset again with its configuration, which writes it anew"
_KNOWN = f"formats {FORMAT} and {FORMAT_OF_SEQUENCES}"
_KEPT = ("stats", "config", "meshes", "mesh_folder", "metadata", "made_by", "fingerprint")
"""Fields of `Manifest` that the file contains unchanged."""


class DamagedManifest(InputError):
    """Raised for a `dataset.json` that is not as it was written. A build with its configuration writes it anew."""


class MissingMesh(InputError):
    """Raised for a stored scene whose mesh file is no longer where its configuration says."""


@dataclass(frozen=True)
class Manifest:
    """The content of `dataset.json`.

    config : the configuration as plain values.
    meshes : mesh file → digest of its bytes.
    mesh_folder : the folder from which relative mesh paths start; None without such paths, so that no machine's paths
        are stored then.
    fingerprint : of the configuration and the meshes.
    metadata : `zarr.json` files and files of coordinates → SHA-256.
    made_by : versions and machine that began the dataset (`made_with`).
    stats : split → field → `mean`, `std` and `nonzero` of its values; None before the dataset is complete.
    """

    config: dict[str, Any]
    meshes: dict[str, str]
    mesh_folder: str | None
    fingerprint: str
    schema: Schema
    metadata: dict[str, str]
    made_by: dict[str, str]
    stats: dict[str, dict[str, dict[str, float]]] | None = None

    @property
    def seed(self) -> int:
        """The dataset seed."""
        return int(self.config["seed"])

    @property
    def format(self) -> int:
        """Number of the stored format."""
        return FORMAT if self.frames is None else FORMAT_OF_SEQUENCES

    @property
    def frames(self) -> int | None:
        """Number of frames of each scene; None of scenes that are measured once."""
        sequence = self.config.get("sequence")
        return None if sequence is None else int(sequence["frames"])

    @property
    def bins_merged(self) -> int:
        """Bins of a transient that make one bin of a histogram."""
        return int(self.config["detector"]["bins_merged"])

    @property
    def time(self) -> TimeAxis:
        """The bins of the histogram (also those of the transient unless the sensor merges bins)."""
        return self.time_of("histogram")

    def time_of(self, field: str) -> TimeAxis:
        """The bins of a field: of a transient, those that are simulated."""
        fine = TimeConfig.model_validate(self.config["capture"]["time"]).axis()
        return fine if "transient" in field else fine.merged(self.bins_merged)

    @property
    def imported(self) -> tuple[ImportedFile, ...]:
        """The files that the captures were imported from; empty if they were simulated."""
        layout = self.config["scene"]["layout"]
        is_imported = layout.get("kind") == "imported"
        return ImportedCaptures.model_validate_json(json.dumps(layout)).files if is_imported else ()

    def parsed_config(self, meshes: bool = True) -> DatasetConfig:
        """The configuration as models. The version of datagen that made the dataset makes its scenes again from it.

        meshes : compare the mesh files with their digests. Without it they may be missing or others, and scenes with
            meshes must not be generated.

        Raises `MissingMesh` if a mesh file is no longer where it was, and `InputError` if it has changed, a setting
        no longer exists, or the fields are not those that the configuration gives.
        """
        models = config_from_mapping(self.config, MANIFEST, self.mesh_folder or ".", look_for_files=False)
        if meshes:
            self._check_meshes(models)
        due = {(field.name, field.shape) for field in schema_of(models, self.schema.scenes_per_shard).fields}
        # A later version of datagen may store further fields with the same configuration.
        if not {(field.name, field.shape) for field in self.schema.fields} <= due:
            raise InputError(
                f"{MANIFEST}: its fields are not those that its configuration gives; build the dataset anew"
            )
        return models

    def _check_meshes(self, config: DatasetConfig) -> None:
        """Raise `InputError` for a mesh file or folder that is missing, or is not the one of the scenes."""
        for i, item in enumerate(config.scene.contents):
            if not isinstance(item, MeshItem):
                continue
            due, named = self.meshes.get(item.path), f"scene.contents[{i}].path = {item.path!r}"
            if due is None:
                raise DamagedManifest(f"{MANIFEST}: meshes: has no digest of {named}; {REMEDY}")
            remedy = f"put the one of SHA-256 {due} there, from which the dataset was made"
            # What is no plain file, such as a device, may have no end.
            is_there = os.path.isdir(item.place) if isinstance(item, MeshFolder) else os.path.isfile(item.place)
            try:
                now = item.digest() if is_there else None
            except OSError as error:
                raise InputError(f"{named}: {item.place}: cannot be read ({error.strerror or error})") from None
            if now is None:
                raise MissingMesh(f"{named}: {item.place} is missing; {remedy}")
            if now != due:
                raise InputError(f"{named}: {item.place} has changed (SHA-256 {now}); {remedy}")

    def splits(self) -> SplitsConfig:
        """The division into splits."""
        return SplitsConfig.model_validate_json(json.dumps(self.config["splits"]))

    def to_bytes(self) -> bytes:
        """The content of `dataset.json`."""
        schema, config = self.schema, self.config
        values: dict[str, Any] = {"format": self.format}
        values |= {key: config[key] for key in ("name", "description")} | {"seed": self.seed}
        values |= {key: getattr(schema, key) for key in ("scenes", "scenes_per_shard", "shards")}
        values |= {"fingerprint": self.fingerprint, "fields": [_field_row(field, schema) for field in schema.fields]}
        values |= {"samples": {"file": TABLE, "columns": COLUMNS}}
        return sealed_bytes(values | {key: getattr(self, key) for key in _KEPT if key not in values})


def describe(config: DatasetConfig, schema: Schema) -> Manifest:
    """The manifest of a new dataset."""
    values, meshes = config.model_dump(mode="json"), config.scene.mesh_digests()
    metadata = metadata_hashes(schema, stored_axes(config))
    return Manifest(values, meshes, mesh_folder(config), config.fingerprint(), schema, metadata, made_with())


def metadata_hashes(schema: Schema, axes: Mapping[str, Axis]) -> dict[str, str]:
    """File of `metadata_files` → hex SHA-256."""
    return {name: hashlib.sha256(content).hexdigest() for name, content in metadata_files(schema, axes).items()}


def mesh_folder(config: DatasetConfig) -> str | None:
    """The folder from which the relative mesh paths of a configuration start; None if it has no such paths."""
    bases = (item.base for item in config.scene.contents if isinstance(item, MeshItem))
    return next((str(base) for base in bases if base is not None), None)


def read_manifest(root: str | Location) -> Manifest:
    """The manifest of a dataset. The file is not trusted: names, sizes and types that datagen does not write are
    refused. `Manifest.parsed_config` checks the settings.

    Raises `InputError` if the folder is no dataset or one of another format, and `DamagedManifest`.
    """
    root = location_of(root)
    path = root / MANIFEST
    try:
        content = read_if_there(path)
    except InputError as error:
        raise DamagedManifest(f"{error}; {REMEDY}") from None
    if content is None and recorded_shards(root):
        raise DamagedManifest(f"{path}: missing, and there are shards; {REMEDY}")
    if content is None:
        what = "is no dataset: it has no dataset.json" if root.is_dir() else "no such dataset"
        raise InputError(f"{root}: {what}; name a folder that `datagen build` made")
    try:
        stated = parsed_json(path, content, dict[str, Any])
    except InputError as error:
        raise DamagedManifest(f"{error}; {REMEDY}") from None
    number = stated.get("format")
    if type(number) is not int:
        raise DamagedManifest(
            f"{path}: is not the manifest of a datagen dataset (format = {shown(number)}, this datagen reads "
            f"{_KNOWN}); name a folder that `datagen build` made"
        )
    if not is_intact(content):
        raise DamagedManifest(f"{path}: has changed since it was written (its checksum differs); {REMEDY}")
    if number not in (FORMAT, FORMAT_OF_SEQUENCES):
        raise InputError(
            f"{path}: format = {number}, this datagen reads {_KNOWN}; use the version of datagen that made it"
        )
    try:
        manifest = _manifest_of(parsed_json(path, content, _File), stated)
        # What these hold is checked by parsing it.
        manifest.splits(), manifest.imported, manifest.time
        return manifest
    except pydantic.ValidationError as error:
        raise DamagedManifest(f"{path}: damaged: {' '.join(str(error).split())}; {REMEDY}") from None
    except InputError as error:
        raise DamagedManifest(f"{path}: damaged: {str(error).removeprefix(f'{path}: ')}; {REMEDY}") from None


Name = Annotated[str, pydantic.Field(pattern=r"^[a-z][a-z0-9_]{0,63}$")]
"""A name of a field or a dimension. It must not be a path, because folders are named after fields."""
Size = Annotated[int, pydantic.Field(ge=1, lt=2**40)]


@dataclass(frozen=True)
class _FieldRow:
    name: Name
    dims: tuple[Name, ...]
    shape: tuple[Size, ...]
    dtype: Literal["uint8", "uint16", "uint32", "int16", "int32", "float32", "float64"]
    unit: str
    meaning: str
    shard: tuple[Size, ...] | None
    classes: tuple[str, ...] = ()


@dataclass(frozen=True)
class _Capture:
    time: dict[str, Any]
    pairing: Literal["exhaustive", "confocal"]


@dataclass(frozen=True)
class _Detector:
    bins_merged: Annotated[int, pydantic.Field(ge=1, le=2**20)]


@dataclass(frozen=True)
class _Scene:
    layout: dict[str, Any]


@dataclass(frozen=True)
class _Sequence:
    frames: Annotated[int, pydantic.Field(ge=2, le=MOST_FRAMES)]


@dataclass(frozen=True)
class _Config:
    """The keys of a stored configuration that are read without parsing all of it."""

    name: str
    description: str
    seed: Annotated[int, pydantic.Field(ge=0, lt=2**63)]
    scene: _Scene
    capture: _Capture
    detector: _Detector
    splits: dict[str, Any]
    license: str
    sequence: _Sequence | None = None


@dataclass(frozen=True)
class _File:
    """The keys of `dataset.json` that are used."""

    format: int
    scenes: Annotated[int, pydantic.Field(ge=1, le=MOST_SCENES)]
    scenes_per_shard: Literal[1, 2, 4, 8, 16, 32, 64, 128, 256]
    fingerprint: Digest
    fields: tuple[_FieldRow, ...]
    config: _Config
    meshes: dict[str, Digest]
    mesh_folder: str | None
    metadata: dict[str, Digest]
    made_by: dict[str, str]
    stats: dict[str, dict[str, FieldStats]] | None = None


def _manifest_of(file: _File, stated: dict[str, Any]) -> Manifest:
    """The manifest that a file states. Raises `InputError` if its parts contradict each other."""
    fields = tuple(
        Field(row.name, row.dims, row.shape[1:], row.dtype, row.unit, row.meaning, row.shard is not None, row.classes)
        for row in file.fields
    )
    schema = Schema(fields, file.scenes, file.scenes_per_shard)
    if not fields or len(schema.by_name) < len(fields):
        raise InputError("no fields, or two of one name")
    for field, row in zip(fields, stated["fields"], strict=True):
        if len(field.dims) != len(row["shape"]) or field.dims[:1] != ("scene",):
            raise InputError(f"field {field.name}: {len(field.dims)} axes of {len(row['shape'])} sizes")
        check_size(field, schema.scenes_per_shard)
        if _field_row(field, schema) != row:
            raise InputError(f"field {field.name}: is cut into other chunks than datagen cuts it")
    due = {f"{GROUP}/zarr.json", *(f"{GROUP}/{field.name}/zarr.json" for field in fields)}
    axes = ["bin", "transient_bin"] if file.config.detector.bins_merged > 1 else ["bin"]
    frames = None if file.config.sequence is None else file.config.sequence.frames
    if file.format != (FORMAT if frames is None else FORMAT_OF_SEQUENCES):
        raise InputError(f"format = {file.format} with {'no' if frames is None else 'a'} sequence in its settings")
    sizes = {field.shape[k] for field in fields for k, name in enumerate(field.dims[1:]) if name == "frame"}
    if sizes - {frames} or any("frame" in field.dims[2:] for field in fields):
        raise InputError("fields: their frames are not those of its settings")
    axes += [] if frames is None else ["frame"]
    if set(file.metadata) != due | set(coordinates(axes)):
        raise InputError("metadata: other files than its fields have")
    if not set(file.made_by) >= STATED:
        raise InputError("made_by: incomplete")
    return Manifest(schema=schema, **{"stats": None} | {key: stated[key] for key in _KEPT if key in stated})


def _field_row(field: Field, schema: Schema) -> dict[str, Any]:
    k = schema.scenes_per_shard
    row: dict[str, Any] = {"name": field.name, "dims": list(field.dims), "shape": [schema.scenes, *field.shape]}
    row |= {key: getattr(field, key) for key in ("dtype", "unit", "meaning")}
    row["chunk"] = [1, *field.chunk] if field.sharded else [k, *field.shape]
    row["shard"] = list(shard_shape(field, k)) if field.sharded else None
    return row | ({"classes": list(field.classes)} if field.classes else {})
