"""Building a suite, and saying whether its bytes are the published ones."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from pathlib import Path

from datagen.building.build import build
from datagen.errors import CheckError
from datagen.records.checks import check_kind
from datagen.store import read_manifest
from datagen.store.card import readable
from datagen.store.files import bytes_below
from datagen.store.table import read_table
from datagen.store.verify import dataset_digest
from datagen.suites.catalogue import SUITES, Suite, differing_versions, find_suite


@dataclass(frozen=True)
class SuiteResult:
    """A suite that was built.

    Attributes
    ----------
    name, path : which, and where.
    digest, published : hex SHA-256 of its values, and that of the published ones.
    splits : split → scenes.
    bytes : on disk.
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
    """Build a benchmark set of a name, and compare its digest with the published one.

    Parameters
    ----------
    name : such as `letters-4`; `datagen suite` lists them.
    path : the folder to make, or to go on with.
    workers, progress : as of `build`; the bytes do not depend on them.

    Returns
    -------
    SuiteResult; the set itself is a dataset like any other, read by `TransientDataset(path, split="train")`.

    Raises
    ------
    InputError : no such suite, or the folder holds something else.
    CheckError : the bytes are not the published ones. The dataset stays; the line says which versions differ.
    """
    check_kind("name", name, str, remedy=f"one of {', '.join(SUITES)}")
    suite = find_suite(name)
    build(suite.config, path, workers, progress=progress)
    result = examined(suite, Path(path))
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


def examined(suite: Suite, path: Path) -> SuiteResult:
    """What was built of a suite."""
    splits = read_table(path, ["split"], read_manifest(path).schema.scenes)["split"].to_pylist()
    counted = Counter(str(split) for split in splits)
    size = bytes_below(path)
    ordered = {split: counted[split] for split in sorted(counted, key=["train", "val", "test"].index)}
    return SuiteResult(suite.name, path, dataset_digest(path), suite.digest, ordered, size)


def listing() -> str:
    """Name, scenes and description of each suite."""
    width = max(map(len, SUITES))
    configs = [suite.config for suite in SUITES.values()]
    lines = [f"{config.name:{width}}  {config.scenes:4} scenes  {config.description}" for config in configs]
    return "\n".join([*lines, "", "Build one with `datagen suite NAME OUT`; `datagen preview OUT` draws it."])
