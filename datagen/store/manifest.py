"""`dataset.json`: what a dataset is. It is the first file of a dataset, and says which folder is one."""

from __future__ import annotations

import hashlib
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from datagen.config import DatasetConfig, config_from_mapping
from datagen.config.scene_contents import Mesh
from datagen.errors import InputError
from datagen.store.arrays import metadata_files, shard_shape
from datagen.store.environment import commit, environment, hardware
from datagen.store.files import PARTIAL, json_bytes, read_json, write_if_changed
from datagen.store.record import BUILD
from datagen.store.schema import SCHEMA_VERSION, SCHEMA_VERSIONS, Field, Schema, schema_of

MANIFEST = "dataset.json"
FORMAT = "datagen dataset"
WHEN_COMPLETE = ("samples.parquet", "croissant.json")
"""Files that are there only when all shards are."""
_RENAMED_SINCE = {1: (("transport", "scramblings", "replicates"),)}
"""Schema version → (section, key then, key now) of its stored configuration."""
_KEPT = (
    "config", "meshes", "mesh_folder", "metadata", "versions", "commit", "hardware", "fingerprint", "schema_version",
)  # fmt: skip
"""Fields of `Manifest` that stand in the file as they are."""


@dataclass(frozen=True)
class Manifest:
    """The content of `dataset.json`.

    Attributes
    ----------
    config : the configuration as plain values, with the key names of its `schema_version`.
    meshes : mesh file → digest of its bytes.
    mesh_folder : where relative mesh paths start; None when there are none, so that no machine's paths are stored.
    metadata : `zarr.json` files → SHA-256.
    """

    config: dict[str, Any]
    meshes: dict[str, str]
    mesh_folder: str | None
    fingerprint: str
    schema: Schema
    metadata: dict[str, str]
    versions: dict[str, str]
    commit: str | None
    hardware: dict[str, Any]
    schema_version: int = SCHEMA_VERSION

    @property
    def seed(self) -> int:
        """The dataset seed."""
        return int(self.config["seed"])

    def parsed_config(self) -> DatasetConfig:
        """The configuration as models, able to generate the scenes again (other ones than the stored, if the dataset
        is of an earlier schema version).

        Raises `InputError` when a mesh file is no longer where it was, or a setting no longer exists.
        """
        config = self.config
        for section, old, new in _RENAMED_SINCE.get(self.schema_version, ()):
            renamed = {new if key == old else key: value for key, value in config[section].items()}
            config = config | {section: renamed}
        return config_from_mapping(config, source=MANIFEST, base_directory=self.mesh_folder or ".")

    def to_bytes(self) -> bytes:
        """The file `dataset.json`."""
        schema, config = self.schema, self.config
        values = {"format": FORMAT, "schema_version": self.schema_version}
        values |= {key: config[key] for key in ("name", "description")} | {"seed": self.seed}
        values |= {key: getattr(schema, key) for key in ("scenes", "scenes_per_shard", "shards")}
        values |= {"fingerprint": self.fingerprint, "fields": [_field_row(field, schema) for field in schema.fields]}
        return json_bytes(values | {key: getattr(self, key) for key in _KEPT if key not in values})


def describe(config: DatasetConfig, schema: Schema) -> Manifest:
    """The manifest of a new dataset."""
    values, meshes, metadata = config.model_dump(mode="json"), config.scene.mesh_digests(), _metadata(schema)
    made_by = environment(), commit(), hardware()
    return Manifest(values, meshes, _mesh_folder(config), config.fingerprint(), schema, metadata, *made_by)


def read_manifest(root: str | Path) -> Manifest:
    """Read `dataset.json`, of any schema version so far; the configuration in it is not looked at.

    Raises `InputError` when the folder is no dataset, or one of a later schema version.
    """
    root = Path(root)
    path = root / MANIFEST
    if not path.is_file():
        what = "is no dataset: it has no dataset.json" if root.is_dir() else "no such dataset"
        raise InputError(f"{root}: {what}; name a folder that `datagen build` made")
    values = read_json(path)
    if not isinstance(values, dict) or values.get("format") != FORMAT:
        raise InputError(f"{path}: is not the manifest of a datagen dataset; name a folder that `datagen build` made")
    if values.get("schema_version") not in SCHEMA_VERSIONS:
        raise InputError(
            f"{path}: schema_version = {values.get('schema_version')!r}, this datagen reads 1 … {SCHEMA_VERSION}; "
            "use the version of datagen that made it"
        )
    try:
        fields = tuple(_field_of(row) for row in values["fields"])
        schema = Schema(fields, int(values["scenes"]), int(values["scenes_per_shard"]))
        return Manifest(schema=schema, **{key: values[key] for key in _KEPT})
    except (KeyError, TypeError, ValueError) as error:
        raise InputError(f"{path}: damaged, {type(error).__name__}: {error}; build the dataset again") from None


def is_fresh(root: Path) -> bool:
    """Whether nothing is there yet: no folder, an empty one, or one where a build died over its very first file."""
    if not root.exists():
        return True
    return root.is_dir() and all(
        path.name.startswith(f"{MANIFEST}.") and path.name.endswith(PARTIAL) for path in root.iterdir()
    )


def prepare(root: Path, config: DatasetConfig) -> Manifest:
    """Create a dataset, or take up one that exists; returns its manifest.

    Only the parent of a build calls this. Every step can be repeated, so a build killed in the middle is taken up by
    the next one. A dataset may grow (more `scenes`); nothing else of its content may change.
    """
    manifest = describe(config, schema_of(config)) if is_fresh(root) else _taken_up(root, config)
    root.mkdir(parents=True, exist_ok=True)
    if (root / MANIFEST).is_file() and read_manifest(root).schema != manifest.schema:
        # It grows: what described the smaller dataset as complete goes before anything else changes.
        for name in WHEN_COMPLETE:
            (root / name).unlink(missing_ok=True)
    write_if_changed(root / MANIFEST, manifest.to_bytes())
    for name, content in metadata_files(manifest.schema).items():
        path = root / name
        path.parent.mkdir(parents=True, exist_ok=True)
        write_if_changed(path, content)
    (root / BUILD).mkdir(exist_ok=True)
    return manifest


def check_output(root: Path, config: DatasetConfig) -> None:
    """Raise `InputError` when `prepare` would: a foreign folder, another dataset, fewer scenes than there are."""
    if root.is_dir() and not is_fresh(root):
        _taken_up(root, config)


def _taken_up(root: Path, config: DatasetConfig) -> Manifest:
    if not (root / MANIFEST).is_file():
        first = sorted(path.name for path in root.iterdir())[0]
        raise InputError(
            f"output {root}: holds {first!r} and no dataset.json, so it is no dataset; name a new or an empty folder"
        )
    old = read_manifest(root)
    if old.schema_version != SCHEMA_VERSION:
        raise InputError(
            f"output {root}: holds a dataset of schema version {old.schema_version}, and this datagen, of version "
            f"{SCHEMA_VERSION}, makes other scenes of the same seed; build into a new folder"
        )
    _check_same(root, old, config)
    if config.scenes < old.schema.scenes:
        raise InputError(
            f"output {root}: holds a dataset of {old.schema.scenes} scenes, scenes = {config.scenes} is fewer; "
            "a dataset may only grow: ask for at least as many, or name another folder"
        )
    schema = schema_of(config, old.schema.scenes_per_shard)
    metadata = old.metadata if schema == old.schema else _metadata(schema)
    values = config.model_dump(mode="json")
    return replace(old, config=values, mesh_folder=_mesh_folder(config), schema=schema, metadata=metadata)


def _metadata(schema: Schema) -> dict[str, str]:
    """`zarr.json` file → hex SHA-256 of its content."""
    return {name: hashlib.sha256(content).hexdigest() for name, content in metadata_files(schema).items()}


def _mesh_folder(config: DatasetConfig) -> str | None:
    for item in config.scene.contents:
        if isinstance(item, Mesh) and not Path(item.path).is_absolute():
            return str(item.file)[: -len(item.path)]
    return None


def _check_same(root: Path, old: Manifest, config: DatasetConfig) -> None:
    if config.fingerprint() == old.fingerprint:
        return
    new = config.model_dump(mode="json", exclude={"name", "description", "scenes"})
    for key, was, now in _differences(old.config, new):
        raise InputError(
            f"output {root}: holds a dataset made with {key} = {was}, this configuration has {now}; "
            "name another folder, or change it back to resume"
        )
    for key, was, now in _differences(old.meshes, config.scene.mesh_digests()):
        raise InputError(
            f"output {root}: the mesh file {key} has changed since the dataset was begun (SHA-256 {str(was)[:12]} → "
            f"{str(now)[:12]}); name another folder, or put the file back"
        )
    raise InputError(
        f"output {root}: holds a dataset with the fingerprint {old.fingerprint[:12]}, this configuration has "
        f"{config.fingerprint()[:12]}; name another folder"
    )


_MISSING = object()


def _differences(old: Any, new: Any, key: str = "") -> Iterator[tuple[str, str, str]]:
    """(dotted key, old value, new value) of every difference, save top-level keys that only `old` has."""
    if isinstance(old, dict) and isinstance(new, dict):
        names = list(new) if not key else [*new, *(name for name in old if name not in new)]
        for name in names:
            below = f"{key}.{name}" if key else str(name)
            yield from _differences(old.get(name, _MISSING), new.get(name, _MISSING), below)
    elif isinstance(old, list) and isinstance(new, list) and len(old) == len(new):
        for place, (was, now) in enumerate(zip(old, new, strict=True)):
            yield from _differences(was, now, f"{key}[{place}]")
    elif old != new:
        yield key, _shown(old), _shown(new)


def _shown(value: Any) -> str:
    if value is _MISSING:
        return "nothing"
    text = repr(value)
    return text if len(text) <= 80 else text[:77] + "..."


_TEXTS = ("dtype", "unit", "meaning")


def _field_row(field: Field, schema: Schema) -> dict[str, Any]:
    k = schema.scenes_per_shard
    row: dict[str, Any] = {"name": field.name, "dims": list(field.dims), "shape": [schema.scenes, *field.shape]}
    row |= {key: getattr(field, key) for key in _TEXTS}
    row["chunk"] = [1, *field.chunk] if field.sharded else [k, *field.shape]
    row["shard"] = list(shard_shape(field, k)) if field.sharded else None
    return row | ({"classes": list(field.classes)} if field.classes else {})


def _field_of(row: dict[str, Any]) -> Field:
    texts, is_sharded = {key: row[key] for key in _TEXTS}, row["shard"] is not None
    shape, classes = tuple(row["shape"][1:]), tuple(row.get("classes", ()))
    return Field(row["name"], tuple(row["dims"]), shape, sharded=is_sharded, classes=classes, **texts)
