"""Benchmark suites: datasets with a name and a number. Beside this file lie the configuration of each, and what is
published of its first scenes (`published`)."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from datagen.config import DatasetConfig, load_config
from datagen.config.base import near_hint
from datagen.errors import InputError
from datagen.records.checks import as_given

FOLDER = Path(__file__).parent


@dataclass(frozen=True)
class Suite:
    """A benchmark suite.

    name : its name with a number, such as `letters-1`. Rooms and light of a name never change beyond rounding and the
        claimed errors; what must change gets another number.
    """

    name: str

    @property
    def path(self) -> Path:
        """Its configuration file."""
        return FOLDER / f"{self.name}.yaml"

    @property
    def config(self) -> DatasetConfig:
        """Its configuration."""
        return load_config(self.path)


SUITES: dict[str, Suite] = {path.stem: Suite(path.stem) for path in sorted(FOLDER.glob("*.yaml"))}
"""Name → suite."""


def find_suite(name: str) -> Suite:
    """The suite of a name. Raises `InputError` for an unknown name."""
    if name not in SUITES:
        hint = near_hint(name, SUITES, f"there are {', '.join(SUITES)}", 0.4)
        raise InputError(f"{as_given('name', name)}: no such suite; {hint}")
    return SUITES[name]


def listing() -> str:
    """Name, scenes and description of each suite."""
    width = max(map(len, SUITES))
    configs = [suite.config for suite in SUITES.values()]
    lines = [f"{config.name:{width}}  {config.scenes:4} scenes  {config.description}" for config in configs]
    return "\n".join([*lines, "", "Build one with `datagen suite NAME OUT`; `datagen preview OUT` draws it."])
