"""Scenes of a dataset, drawn at random, made again and compared with the stored ones."""

from __future__ import annotations

import random

from datagen._version import __version__
from datagen.building.comparison import Comparison
from datagen.building.engines import running_engine
from datagen.building.replay import config_to_replay, replayed_by
from datagen.errors import CheckError, InputError
from datagen.store.location import Location
from datagen.store.scenes import Scenes


def resimulate(path: str | Location, scenes: int) -> tuple[list[int], list[str]]:
    """Make `scenes` scenes of a dataset again (all if it has fewer), at least 1. Each call draws others at random.

    Returns
    -------
    The indices of the scenes, and a line for each scene that is not the same as the stored one, or not in agreement
    with it if another processor made that.

    Raises
    ------
    InputError : no dataset, one of another version of datagen, scenes that cannot be made again, or a
        mesh file is missing or has changed.
    CheckError : no scene of the dataset is there.
    """
    stored = Scenes(path)
    manifest = stored.manifest
    if manifest.made_by["datagen"] != __version__:
        raise InputError(
            f"{stored.root}: made by datagen {manifest.made_by['datagen']}, and this is {__version__}, which may "
            "make other scenes of the same seed; use the version that made it, or `datagen replay` for a single scene"
        )
    config = config_to_replay(stored.root, manifest)
    made = stored.made()
    if not made:
        raise CheckError(f"{stored.root}: no scene is there to be simulated again; build it first")
    chosen = sorted(random.SystemRandom().sample(made, min(scenes, len(made))))
    # In a worker with one thread, as in a build: several threads could add numbers up in another order.
    with running_engine("local", 1, None) as running:
        found = [replayed_by(running, stored, config, index) for index in chosen]
    return chosen, [line for comparison in found for line in _problems(comparison)]


def _problems(found: Comparison) -> list[str]:
    if found.again.record.failure is not None:
        return [f"scene {found.index}: cannot be made again: {found.again.record.failure}"]
    lines = []
    if found.differing:
        names = [row.name if row.name != "parameters" else f"parameters of {row.stage}" for row in found.differing]
        otherwise = f" (what it was made with differs: {'; '.join(found.elsewhere)})" if found.elsewhere else ""
        lines.append(f"scene {found.index}: simulated again, {', '.join(names)} differ{otherwise}")
    if found.damaged:
        lines.append(f"scene {found.index}: {', '.join(row.name for row in found.damaged)}: damaged")
    return lines
