"""Benchmark suites: datasets with a name, a version and published bytes. The configuration of each lies beside this
file, and the digest of its values is in `digests.json`."""

from __future__ import annotations

import functools
import json
from collections import Counter
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from datagen.building.build import build
from datagen.config import DatasetConfig, load_config
from datagen.config.base import near_hint
from datagen.errors import CheckError, InputError
from datagen.records.checks import check_kind
from datagen.store import Manifest, read_manifest
from datagen.store.card import readable
from datagen.store.environment import LIBRARIES, made_with
from datagen.store.files import bytes_below
from datagen.store.table import read_table
from datagen.store.verify import dataset_digest

FOLDER = Path(__file__).parent
PINNED = FOLDER / "digests.json"


@dataclass(frozen=True)
class Suite:
    """A benchmark suite.

    name : its name with the version, such as `letters-10`. The bytes of a name never change.
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
    """The content of `digests.json`: versions and architecture that give the published bytes (`made_with`), and suite
    → hex SHA-256 (`digests`)."""
    values: dict[str, Any] = json.loads(PINNED.read_text())
    return values


SUITES: dict[str, Suite] = {
    path.stem: Suite(path.stem, pinned()["digests"].get(path.stem, "")) for path in sorted(FOLDER.glob("*.yaml"))
}
"""Name → suite."""


def find_suite(name: str) -> Suite:
    """The suite of a name. Raises `InputError` for an unknown name."""
    if name not in SUITES:
        hint = near_hint(name, SUITES, 0.4)
        raise InputError(
            f"NAME = {name!r}: no such suite; {hint}{'There' if hint else 'there'} are {', '.join(SUITES)}"
        )
    return SUITES[name]


def suite_of(manifest: Manifest) -> Suite | None:
    """The suite whose configuration a dataset has, or None."""
    suite = SUITES.get(str(manifest.config["name"]))
    if suite is None:
        return None
    config = suite.config
    # The number of scenes and their splits are part of a benchmark, but not of the fingerprint.
    same = manifest.schema.scenes == config.scenes and manifest.config["splits"] == config.splits.model_dump(
        mode="json"
    )
    return suite if same and manifest.fingerprint == config.fingerprint() else None


def differing_versions() -> str:
    """Versions here that may give other bytes, such as `numpy 2.3.1 (published with 2.4.6)`; "" if there are none."""
    here, there = made_with(), pinned()["made_with"]
    names = [name for name in (*LIBRARIES, "machine") if here[name] != there[name]]
    return ", ".join(f"{name} {here[name]} (published with {there[name]})" for name in names)


@dataclass(frozen=True)
class SuiteResult:
    """A suite that was built.

    Attributes
    ----------
    name, path : name of the suite, and folder of the dataset.
    digest, published : hex SHA-256 of the values that were built, and of the published values.
    splits : split → number of scenes.
    bytes : size on disk.
    """

    name: str
    path: Path
    digest: str
    published: str
    splits: dict[str, int]
    bytes: int

    @property
    def as_published(self) -> bool:
        """Whether every value is the published one."""
        return self.digest == self.published

    def summary(self) -> str:
        """One line for people."""
        splits = ", ".join(f"{split} {scenes}" for split, scenes in self.splits.items())
        head = f"{self.path}: {self.name}, {sum(self.splits.values())} scenes ({splits}), {readable(self.bytes)}"
        return f"{head}; the published bytes (digest {self.digest[:12]})"


def build_suite(name: str, path: str | Path, workers: int = 1, *, progress: bool = True) -> SuiteResult:
    """Build a benchmark suite, and compare its digest with the published one.

    Parameters
    ----------
    name : such as `letters-10`; `datagen suite` lists all names.
    path : the folder of the dataset, new or to be resumed.
    workers, progress : as for `build`; the bytes do not depend on them.

    Returns
    -------
    SuiteResult; the suite itself is a dataset like any other, read by `TransientDataset(path, split="train")`.

    Raises
    ------
    InputError : no such suite, or the folder holds something else.
    CheckError : the bytes are not the published ones. The dataset stays; the error names the versions that differ.
    """
    check_kind("name", name, str, remedy=f"one of {', '.join(SUITES)}")
    suite = find_suite(name)
    build(suite.config, path, workers, progress=progress)
    of_scenes = read_table(Path(path), ["split"], read_manifest(path).schema.scenes)["split"].to_pylist()
    counted = Counter(map(str, of_scenes))
    splits = {split: counted[split] for split in ("train", "val", "test") if split in counted}
    size = bytes_below(Path(path))
    result = SuiteResult(suite.name, Path(path), dataset_digest(path), suite.digest, splits, size)
    if not result.as_published:
        different = differing_versions()
        reason = (
            f"made here with {different}: scores on it are not those of the published set to the last digit"
            if different
            else "and the versions are those of the published: one of the two is at fault; `datagen verify --deep` "
            "tells whether this one is as it was written"
        )
        raise CheckError(
            f"{path}: {name} is built, but not of the published bytes (digest {result.digest[:12]}, published "
            f"{suite.digest[:12]}), {reason}"
        )
    return result


def listing() -> str:
    """Name, scenes and description of each suite."""
    width = max(map(len, SUITES))
    configs = [suite.config for suite in SUITES.values()]
    lines = [f"{config.name:{width}}  {config.scenes:4} scenes  {config.description}" for config in configs]
    return "\n".join([*lines, "", "Build one with `datagen suite NAME OUT`; `datagen preview OUT` draws it."])
