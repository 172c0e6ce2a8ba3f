"""Scenes of a dataset simulated again and compared bit for bit with the stored values."""

from __future__ import annotations

import random

from datagen._version import __version__
from datagen.building.engines import started
from datagen.config import DatasetConfig
from datagen.errors import CheckError, InputError
from datagen.pipeline import simulate_sample
from datagen.store import Schema, committed, read_manifest
from datagen.store.environment import made_with, mixed
from datagen.store.location import Location, location_of
from datagen.store.scenes import Scenes
from datagen.store.shard import digest, encoded


def resimulate(path: str | Location, scenes: int) -> tuple[list[int], list[str]]:
    """Simulate `scenes` scenes of a dataset again (all if it has fewer). Each call draws other scenes at random.

    Returns
    -------
    The indices of the scenes, and a line for each scene that has fields with other values than the stored ones.

    Raises
    ------
    InputError : no dataset, one of another version of datagen, `scenes` < 1, or a mesh file is missing or
        has changed.
    CheckError : no scene of the dataset is there.
    """
    root = location_of(path)
    if scenes < 1:
        raise InputError(f"--resimulate {scenes}: must be ≥ 1")
    manifest = read_manifest(root)
    if manifest.made_by["datagen"] != __version__:
        raise InputError(
            f"{root}: made by datagen {manifest.made_by['datagen']}, and this is {__version__}, which may make other "
            "scenes of the same seed; use the version that made it"
        )
    config = manifest.parsed_config()
    made = Scenes(root).made()
    if not made:
        raise CheckError(f"{root}: no scene is there to be simulated again; build it first")
    chosen = sorted(random.SystemRandom().sample(made, min(scenes, len(made))))
    problems = []
    # In a worker with one thread, as in a build: several threads could add numbers up in another order.
    with started("local", 1, None) as running:
        for index in chosen:
            record = committed(root, manifest, [index // manifest.schema.scenes_per_shard])[0]
            scene = next(scene for scene in record.scenes if scene.index == index)
            now = running.submit(_digests, config, manifest.schema, index).result()
            fields = [name for name, due in scene.digests.items() if now[name] != due]
            if fields:
                why = "; ".join(mixed([record.made_by, made_with()], also=("processor",)))
                made_otherwise = f" (what it was made with differs: {why})" if why else ""
                problems.append(f"scene {index}: simulated again, {', '.join(fields)} differ{made_otherwise}")
    return chosen, problems


def _digests(config: DatasetConfig, schema: Schema, index: int) -> dict[str, str]:
    arrays = simulate_sample(config, index).arrays
    return {field.name: digest(field, encoded(field, arrays[field.name])) for field in schema.fields}
