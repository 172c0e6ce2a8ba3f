"""Suites as datasets: building one, and knowing one again."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from pathlib import Path

from datagen.building.build import build
from datagen.errors import CheckError
from datagen.records.checks import check_kind
from datagen.store import Manifest, read_manifest
from datagen.store.card import readable
from datagen.store.files import bytes_below
from datagen.store.table import read_table
from datagen.suites.catalogue import SUITES, Suite, find_suite
from datagen.suites.published import check_agreement, published_of


def suite_of(manifest: Manifest) -> Suite | None:
    """The suite whose configuration a dataset has, or None."""
    suite = SUITES.get(str(manifest.config["name"]))
    if suite is None:
        return None
    # A dataset's own configuration lacks keys that came later, and then has another fingerprint.
    config, own = suite.config, manifest.parsed_config()
    # The number of scenes and their splits are part of a benchmark, but not of the fingerprint.
    same = (own.scenes, own.splits, own.fingerprint()) == (config.scenes, config.splits, config.fingerprint())
    return suite if same else None


def is_published(dataset: str | Path, manifest: Manifest) -> bool:
    """Whether a dataset is a suite, and agrees with what is published of it."""
    suite = suite_of(manifest)
    if suite is None:
        return False
    try:
        check_agreement(dataset, published_of(suite))
    except CheckError:
        return False
    return True


@dataclass(frozen=True)
class SuiteResult:
    """A suite that was built.

    Attributes
    ----------
    name, path : name of the suite, and folder of the dataset.
    difference, allowed : relative L2 difference of its first scenes' counts from the published ones, and the largest
        that their errors allow.
    splits : split → number of scenes.
    bytes : size on disk.
    """

    name: str
    path: Path
    difference: float
    allowed: float
    splits: dict[str, int]
    bytes: int

    def summary(self) -> str:
        """One line for people."""
        splits = ", ".join(f"{split} {scenes}" for split, scenes in self.splits.items())
        head = f"{self.path}: {self.name}, {sum(self.splits.values())} scenes ({splits}), {readable(self.bytes)}"
        return f"{head}; agrees with the published set (same rooms, counts {self.difference:.1%} off)"


def build_suite(name: str, path: str | Path, workers: int = 1, *, progress: bool = True) -> SuiteResult:
    """Build a benchmark suite, and compare its first scenes with the published ones.

    Parameters
    ----------
    name : such as `letters-1`; `datagen suite` lists all names.
    path : the folder of the dataset, new or to be resumed.
    workers, progress : as for `build`; the bytes do not depend on them.

    Returns
    -------
    SuiteResult; the suite itself is a dataset like any other, read by `TransientDataset(path, split="train")`.

    Raises
    ------
    InputError : no such suite, or the folder holds something else.
    CheckError : rooms or counts are not the published ones within their errors. The dataset stays.
    """
    check_kind("name", name, str, remedy=f"one of {', '.join(SUITES)}")
    suite = find_suite(name)
    build(suite.config, path, workers, progress=progress)
    of_scenes = read_table(Path(path), ["split"], read_manifest(path).schema.scenes)["split"].to_pylist()
    counted = Counter(map(str, of_scenes))
    splits = {split: counted[split] for split in ("train", "val", "test") if split in counted}
    size = bytes_below(Path(path))
    agreement = check_agreement(path, published_of(suite))
    return SuiteResult(suite.name, Path(path), agreement.difference, agreement.allowed, splits, size)
