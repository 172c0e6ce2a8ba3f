"""Preparation of a folder for a build: a new dataset, one to resume, or one whose metadata is restored."""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

from datagen._version import __version__
from datagen.config import DatasetConfig, stored_axes
from datagen.config.dataset import WITHOUT_EFFECT
from datagen.errors import InputError
from datagen.locks import alone_in
from datagen.records.checks import as_given
from datagen.store.arrays import GROUP, coordinates, metadata_files
from datagen.store.files import PARTIAL, clear_partials, holds, own_path, write_first, write_if_changed
from datagen.store.growth import growth_of, remove_empty, standing_shards, take_places
from datagen.store.location import Location
from datagen.store.manifest import (
    MANIFEST,
    DamagedManifest,
    Manifest,
    describe,
    mesh_folder,
    metadata_hashes,
    read_manifest,
)  # fmt: skip
from datagen.store.record import BUILD, GROWTH, recorded_shards, sound_records
from datagen.store.schema import schema_of

WHEN_COMPLETE = ("samples.parquet", "croissant.json")
"""Files that exist only if all shards exist."""


def is_fresh(root: Path) -> bool:
    """Whether a build starts a new dataset: no folder, an empty one, or only the rest of a first file."""
    if not os.path.exists(root):
        return True
    return root.is_dir() and all(
        path.name.startswith(f"{MANIFEST}.") and path.name.endswith(PARTIAL) for path in root.iterdir()
    )


def planned_manifest(root: Path, config: DatasetConfig) -> Manifest:
    """The manifest that `prepare` would write; no file is changed.

    A dataset may grow (more `scenes`); nothing else of its content may change. One that grows can also be built with
    the scenes that it is complete with. A dataset whose `dataset.json` is
    missing or damaged can be resumed if its shards were made with this configuration.

    Raises `InputError` for a folder of other files, another dataset, fewer scenes than it has, and if a symbolic link
    would lead the build out of the folder.
    """
    if is_fresh(root) or not root.is_dir():
        return describe(config, schema_of(config))
    try:
        manifest = _resumed_manifest(root, config)
    except DamagedManifest:
        restored = _restored_manifest(root, config)
        if restored is None:
            raise
        manifest = restored
    files = [*WHEN_COMPLETE, "README.md", MANIFEST, BUILD, *coordinates(stored_axes(config))]
    files += [f"{GROUP}/{field.name}/{below}" for field in manifest.schema.fields for below in ("zarr.json", "c")]
    for name in files:
        own_path(root, name)
        own_path(root, f"{GROWTH}/{name}")
    return manifest


def build_folders(root: Path, manifest: Manifest) -> list[Path]:
    """The folders in which a build makes files; not all of them exist yet."""
    shards = [f"{GROUP}/{field.name}/c/0" for field in manifest.schema.fields]
    names = [MANIFEST, f"{BUILD}/shard", *manifest.metadata, *shards]
    names += [f"{GROWTH}/{name}" for name in names]
    return [*dict.fromkeys((root / name).parent for name in names)]


def prepare(root: Path, config: DatasetConfig) -> Manifest:
    """Create a dataset, or resume an existing one; returns its manifest. Raises as `planned_manifest` does.

    Only the parent process of a build calls this. Every step can be repeated: if a build is killed in between, the
    next one resumes. Of several builds that begin at once one comes first, and the others see what it began.
    """
    root.mkdir(parents=True, exist_ok=True)
    with alone_in(root):
        return _prepared_manifest(root, config)


def _prepared_manifest(root: Path, config: DatasetConfig) -> Manifest:
    """What `prepare` returns, with nobody else in the folder, if its file system has locks."""
    is_new = is_fresh(root)
    manifest = planned_manifest(root, config)
    for folder in build_folders(root, manifest):
        clear_partials(folder)
    _go_on_with_growth(root, manifest)
    is_growing = _is_complete_and_smaller(root, manifest)
    home, content = root / GROWTH if is_growing else root, manifest.to_bytes()
    home.mkdir(parents=True, exist_ok=True)
    if not is_growing and not holds(root / MANIFEST, content):
        # The dataset is repaired, or grows before it is complete: files that say it is complete go before anything
        # else changes.
        forget_complete(root)
    if is_new and not write_first(root / MANIFEST, content):
        return _prepared_manifest(root, config)
    write_if_changed(home / MANIFEST, content)
    for name, metadata in metadata_files(manifest.schema, stored_axes(config)).items():
        if not (is_growing and holds(root / name, metadata)):
            (home / name).parent.mkdir(parents=True, exist_ok=True)
            write_if_changed(home / name, metadata)
    (root / BUILD).mkdir(exist_ok=True)
    return manifest


def _go_on_with_growth(root: Path, manifest: Manifest) -> None:
    """Let files that wait take their places if a growth was interrupted in its last step, or after it; and those of a
    dataset that is as large as its growth already, which lost its manifest."""
    remove_empty(root)
    try:
        waiting = read_manifest(root / GROWTH)
    except InputError:
        return
    if waiting.fingerprint == manifest.fingerprint and (
        waiting.stats is not None or (waiting.schema.scenes <= manifest.schema.scenes and _is_damaged(root))
    ):
        take_places(root)


def _is_damaged(root: Path) -> bool:
    """Whether a dataset has no sound manifest."""
    try:
        read_manifest(root)
    except InputError:
        return True
    return False


def _is_complete_and_smaller(root: Path, manifest: Manifest) -> bool:
    """Whether there is a complete dataset that grows into that of `manifest`."""
    if not standing_shards(root, manifest):
        return False
    smaller = read_manifest(root)
    is_described = smaller.stats is not None and all((root / name).is_file() for name in WHEN_COMPLETE)
    return is_described and {*recorded_shards(root)} >= {*range(smaller.schema.shards)}


def forget_complete(root: Location) -> None:
    """Remove the files that say that all shards are there, before a shard is made again."""
    for name in WHEN_COMPLETE:
        (root / name).unlink(missing_ok=True)


def _restored_manifest(root: Path, config: DatasetConfig) -> Manifest | None:
    """The manifest of a dataset that lost its own, from the configuration and the shards; None without any shard,
    since nothing then says that the folder belongs to this configuration."""
    records = list(sound_records(root))
    if not records:
        return None
    fingerprint = config.fingerprint()
    for record in records:
        _check_version(root, record.made_by)
        if record.fingerprint != fingerprint:
            raise InputError(
                f"output {root}: has no sound dataset.json, and shard {record.shard} was made with another "
                f"configuration (fingerprint {record.fingerprint[:12]}, not {fingerprint[:12]}); build with that one"
            )
    last = records[-1]
    if last.last_scene >= config.scenes:
        raise InputError(
            f"output {root}: has no sound dataset.json, and shards up to scene {last.last_scene}; ask for at least "
            f"{as_given('scenes', last.last_scene + 1)}"
        )
    # Shard s begins at scene s · scenes_per_shard.
    k = last.first_scene // last.shard if last.shard else 0
    schema = schema_of(config, k if 0 < k <= 256 and k & (k - 1) == 0 else None)
    return replace(describe(config, schema), made_by=dict(records[0].made_by))


def _resumed_manifest(root: Path, config: DatasetConfig) -> Manifest:
    """The manifest of an existing dataset, with the scenes of this configuration. Raises as
    `planned_manifest` does."""
    if not (root / MANIFEST).is_file():
        first = sorted(path.name for path in root.iterdir())[0]
        raise DamagedManifest(
            f"output {root}: holds {first!r} and no dataset.json, so it is no dataset; name a new or an empty folder"
        )
    old = read_manifest(root)
    larger = growth_of(root, old)
    if larger is not None and larger.stats is not None:
        # Everything of the larger dataset is there, and takes its place at the next build.
        old = larger
    _check_version(root, old.made_by)
    _check_same(root, old, config)
    if config.scenes < old.schema.scenes:
        raise InputError(
            f"output {root}: holds a dataset of {old.schema.scenes} scenes, scenes = {config.scenes} is fewer; "
            "a dataset may only grow: ask for at least as many, or name another folder"
        )
    if larger is not None and old.schema.scenes < config.scenes < larger.schema.scenes:
        raise InputError(
            f"output {root}: holds a dataset of {old.schema.scenes} scenes that grows to {larger.schema.scenes}, "
            f"scenes = {config.scenes} lies between; ask for {larger.schema.scenes} or more, which goes on with that "
            f"growth, or for {old.schema.scenes}, which is complete"
        )
    schema = schema_of(config, old.schema.scenes_per_shard)
    values, metadata = config.model_dump(mode="json"), metadata_hashes(schema, stored_axes(config))
    stats = old.stats if (schema, values) == (old.schema, old.config) else None
    return replace(old, config=values, mesh_folder=mesh_folder(config), schema=schema, metadata=metadata, stats=stats)


def _check_version(root: Path, made_by: Mapping[str, str]) -> None:
    """Raise `InputError` unless this version of datagen began the dataset."""
    if made_by["datagen"] != __version__:
        raise InputError(
            f"output {root}: holds a dataset that datagen {made_by['datagen']} began, and this is {__version__}, "
            "which may make other scenes of the same seed; go on with that version, or name another folder"
        )


def _check_same(root: Path, old: Manifest, config: DatasetConfig) -> None:
    """Raise `InputError`, which names the first difference, unless a dataset was made with this configuration."""
    if config.fingerprint() == old.fingerprint:
        return
    new = config.model_dump(mode="json", exclude={*WITHOUT_EFFECT})
    # A setting that is left out where it is not set.
    new.setdefault("sequence", _MISSING)
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
    """(dotted key, old value, new value) of every difference, except top-level keys that only `old` has."""
    if isinstance(old, dict) and isinstance(new, dict):
        names = list(new) if not key else [*new, *(name for name in old if name not in new)]
        for name in names:
            below = f"{key}.{name}" if key else str(name)
            yield from _differences(old.get(name, _MISSING), new.get(name, _MISSING), below)
    elif isinstance(old, list) and isinstance(new, list) and len(old) == len(new):
        for place, (was, now) in enumerate(zip(old, new, strict=True)):
            yield from _differences(was, now, f"{key}[{place}]")
    elif old != new:
        yield key, _value_text(old), _value_text(new)


def _value_text(value: Any) -> str:
    if value is _MISSING:
        return "nothing"
    text = repr(value)
    return text if len(text) <= 80 else text[:77] + "..."
