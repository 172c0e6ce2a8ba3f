"""The environment in which a dataset is made: versions of libraries, commit of the code, hardware."""

from __future__ import annotations

import functools
import importlib.metadata
import os
import platform
import subprocess
from collections.abc import Mapping, Sequence
from pathlib import Path

from datagen._version import __version__

LIBRARIES = (
    "numpy", "scipy", "numba", "llvmlite", "embreex", "trimesh", "zarr", "numcodecs", "pydantic", "pyarrow",
)  # fmt: skip
"""The libraries whose versions can change a dataset's bytes."""
STATED = {"datagen", "pyarrow", "processor", "system", "commit"}
"""Entries of `made_by` that are read again, so that a file which lacks one is damaged."""


@functools.cache
def made_with() -> dict[str, str]:
    """Name → value of all that a dataset states of its making, in `made_by`: versions of datagen, Python and
    `LIBRARIES`; architecture, processor, system; commit."""
    versions = {"datagen": __version__, "python": platform.python_version()}
    for name in LIBRARIES:
        try:
            versions[name] = importlib.metadata.version(name)
        except importlib.metadata.PackageNotFoundError:
            versions[name] = "not installed"
    machine = platform.machine()
    versions |= {"machine": machine, "processor": processor(), "system": f"{platform.system()} {machine}"}
    return versions | {"commit": commit() or "unknown"}


def environment_differences(environments: Sequence[Mapping[str, str]], also: Sequence[str] = ()) -> list[str]:
    """Differences between environments that may give other bytes for the same seed, such as `numpy 2.3.1 and 2.4.6`.

    Another processor of the same architecture may give other last digits of light, well within its claimed error; the
    workers of a cluster may differ in it, and it is compared only if `also` names it. An entry that one of the
    environments lacks is ignored.
    """
    found = []
    for name in ("datagen", "python", *LIBRARIES, "machine", *also):
        named = (environment[name].split(" and ") for environment in environments if name in environment)
        values = dict.fromkeys(value for several in named for value in several)
        if len(values) > 1:
            found.append(f"{name} {' and '.join(values)}")
    return found


def joined_environment(old: Mapping[str, str], new: Mapping[str, str]) -> dict[str, str]:
    """The environment of a shard whose scenes were made in two environments. Values that differ are joined by "and",
    where `environment_differences` splits them."""
    both = {name: f"{old[name]} and {value}" for name, value in new.items() if old.get(name, value) != value}
    return {**old, **new, **both}


def cores() -> int:
    """Processor cores this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def processor() -> str:
    """The processor's model name."""
    cpuinfo = Path("/proc/cpuinfo")
    if cpuinfo.is_file():
        for line in cpuinfo.read_text(errors="replace").splitlines():
            if line.startswith("model name"):
                return line.partition(":")[2].strip()
    return platform.processor() or platform.machine()


@functools.cache
def commit() -> str | None:
    """The git commit of the code if it runs from a checkout ("+changes" if that is modified), else None."""
    folder = Path(__file__).resolve().parents[2]
    if not (folder / ".git").exists():
        return None
    answers = []
    for question in (["rev-parse", "HEAD"], ["status", "--porcelain", "--untracked-files=no"]):
        command = ["git", "-C", str(folder), *question]
        try:
            done = subprocess.run(command, capture_output=True, text=True, check=True, timeout=10)
        except (OSError, subprocess.SubprocessError):
            return None
        answers.append(done.stdout.strip())
    return answers[0] + ("+changes" if answers[1] else "")
