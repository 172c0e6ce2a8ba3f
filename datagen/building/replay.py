"""One stored scene made again, from what the dataset holds of it: configuration, seed and number."""

from __future__ import annotations

import warnings
from pathlib import Path

import numpy as np

from datagen.building.comparison import Again, Comparison, compare
from datagen.building.engines import Engine, WorkerDied, running_engine
from datagen.building.shard_job import attempt
from datagen.config import DatasetConfig
from datagen.config.scene_layouts import NoLayout
from datagen.errors import CheckError, InputError
from datagen.pipeline import simulate_sample
from datagen.records import Sample
from datagen.store import Manifest, Schema, schema_of
from datagen.store.location import Location
from datagen.store.scenes import Scenes
from datagen.store.shard import encoded_value, record_of


def replay(path: str | Path, scene: int) -> Sample:
    """Scene number `scene` of a dataset, made again from its stored configuration and seed: room, capture, light,
    counts, evidence and labels.

    The command `datagen replay` does the same, compares every field with what is stored, and names the stage where
    they first differ.

    Parameters
    ----------
    path : a dataset that was built from a configuration, also an incomplete one: a folder or `s3://bucket/name`.
    scene : the number of a scene whose shard is there. Its values are not read, so they may be damaged.

    Returns
    -------
    The sample: `arrays` of the stored fields in the types in which they are stored, and the `transient` also if it is
    not stored; `parameters` as in `samples.parquet`; `seconds` of each stage, now. With the versions that built the
    dataset, on the same kind of processor and with one thread (OMP_NUM_THREADS=1), values are the same to the bit.

    Raises
    ------
    InputError : no dataset; no such scene, or not yet; scenes that were imported or made in Python; a mesh file that
        is gone or has changed; a scene that cannot be made, for the reason that its record has.
    CheckError : a commit record that is damaged.

    Examples
    --------
    >>> import datagen as dg, numpy as np, tempfile
    >>> from datagen.config import config_from_mapping
    >>> config = config_from_mapping({
    ...     "scenes": 2, "transport": {"target": 0.1},
    ...     "capture": {"scan": {"rows": 2, "columns": 2}, "time": {"bins": 64, "bin_width_ps": 800}}})
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     result = dg.build(config, f"{folder}/small.zarr", progress=False)
    ...     stored = dg.TransientDataset(f"{folder}/small.zarr", ("histogram",), counts="stored")[1]
    ...     sample = dg.replay(f"{folder}/small.zarr", 1)
    >>> bool((sample.arrays["histogram"] == stored["histogram"].numpy()).all())
    True
    >>> sample.arrays["transient"].shape, [*sample.seconds]
    ((4, 1, 64), ['scene', 'effects', 'transport', 'evidence', 'detector', 'labels'])
    """
    scenes = Scenes(path)
    config = config_to_replay(scenes.root, scenes.manifest)
    scenes.record(scene)
    config = _with_transient(config)
    sample = simulate_sample(config, int(scene))
    arrays = {field.name: encoded_value(field, sample.arrays[field.name]) for field in schema_of(config).fields}
    return Sample(sample.index, arrays, sample.parameters, sample.seconds)


def replay_comparison(path: str | Location, index: int) -> Comparison:
    """Scene `index` of a dataset compared with itself made again, in a worker process with one thread as in a build.

    Raises `InputError` and `CheckError` as `replay` does, but for a scene that can be made now or could be then.
    """
    scenes = Scenes(path)
    config = config_to_replay(scenes.root, scenes.manifest)
    scenes.record(index, "SCENE")
    with running_engine("local", 1, None) as running:
        return replayed_by(running, scenes, config, index)


def replayed_by(running: Engine, scenes: Scenes, config: DatasetConfig, index: int) -> Comparison:
    """As `replay_comparison`, by a worker of `running`. config : that of `config_to_replay`."""
    shard, stored = scenes.record(index)
    try:
        again = running.submit(make_again, config, scenes.manifest.schema, index).result()
    except WorkerDied:
        raise CheckError(
            f"{scenes.root}: scene {index}: the process that made it again died; most likely memory ran out"
        ) from None
    if stored.failure is not None and again.record.failure is not None:
        reasons = dict.fromkeys([stored.failure, again.record.failure])
        raise InputError(
            f"scene {index}: could not be made when {scenes.root} was built, and cannot be made now "
            f"({'; now: '.join(reasons)}); name another one"
        )
    return compare(scenes, shard, stored, again)


def config_to_replay(root: Location, manifest: Manifest) -> DatasetConfig:
    """The configuration of a dataset whose scenes can be made again. Raises `InputError` if they cannot."""
    config = manifest.parsed_config()
    if isinstance(config.scene.layout, NoLayout):
        raise InputError(f"{root}: its scenes cannot be made again: {config.scene.layout.why}")
    return config


def make_again(config: DatasetConfig, schema: Schema, index: int) -> Again:
    """Scene `index`, made as a build makes it. It runs in a worker."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        sample = attempt(simulate_sample, _with_transient(config), index)
    record, values = record_of(schema.fields, index, sample)
    light = 0.0 if isinstance(sample, str) else float(np.linalg.norm(sample.arrays["transient"]))
    said = dict.fromkeys(" ".join(str(warning.message).split()) for warning in caught)
    return Again(record, {field.name: value for field, value in values.items()}, light, tuple(said))


def _with_transient(config: DatasetConfig) -> DatasetConfig:
    """The configuration with the transient among its fields, which changes no other field."""
    fields = tuple(dict.fromkeys((*config.store.fields, "transient")))
    return config.model_copy(update={"store": config.store.model_copy(update={"fields": fields})})
