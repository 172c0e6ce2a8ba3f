"""Which suites there are: a configuration of each beside this file, and the digests of what they give."""

from __future__ import annotations

import difflib
import functools
import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from datagen.config import DatasetConfig, load_config
from datagen.errors import InputError
from datagen.store import Manifest
from datagen.store.environment import LIBRARIES, made_with

FOLDER = Path(__file__).parent
PINNED = FOLDER / "digests.json"


@dataclass(frozen=True)
class Suite:
    """A named, versioned benchmark set.

    Attributes
    ----------
    name : with its version; what a name gives never changes.
    digest : hex SHA-256 of all its values as published (`datagen digest`).
    """

    name: str
    digest: str

    @property
    def path(self) -> Path:
        """Its configuration file."""
        return FOLDER / f"{self.name}.yaml"

    @property
    def config(self) -> DatasetConfig:
        """Its configuration."""
        return load_config(self.path)


@functools.cache
def pinned() -> dict[str, Any]:
    """`made_with`: versions and architecture for which bytes are promised; `digests`: suite → hex SHA-256."""
    values: dict[str, Any] = json.loads(PINNED.read_text())
    return values


SUITES: dict[str, Suite] = {
    path.stem: Suite(path.stem, pinned()["digests"].get(path.stem, "")) for path in sorted(FOLDER.glob("*.yaml"))
}
"""Name → suite."""


def find_suite(name: str) -> Suite:
    """The suite of a name. Raises `InputError` for one that there is not."""
    if name not in SUITES:
        near = difflib.get_close_matches(name, SUITES, 1, 0.4)
        meant = f"did you mean {near[0]!r}? There are" if near else "there are"
        raise InputError(f"NAME = {name!r}: no such suite; {meant} {', '.join(SUITES)}")
    return SUITES[name]


def suite_of(manifest: Manifest) -> Suite | None:
    """The suite that a dataset has the configuration of, if any."""
    suite = SUITES.get(str(manifest.config["name"]))
    if suite is None:
        return None
    config = suite.config
    # Which scenes are tested is no part of the fingerprint, and part of a benchmark.
    same = manifest.schema.scenes == config.scenes and manifest.config["splits"] == config.splits.model_dump(
        mode="json"
    )
    return suite if same and manifest.fingerprint == config.fingerprint() else None


def differing_versions() -> str:
    """What here may give other bytes than those published: `numpy 2.3.1 (published with 2.4.6)`; "" for nothing."""
    here, there = made_with(), pinned()["made_with"]
    names = [name for name in (*LIBRARIES, "machine") if here[name] != there[name]]
    return ", ".join(f"{name} {here[name]} (published with {there[name]})" for name in names)
