"""Mesh files named in a configuration: where they are, which classes a folder holds."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Annotated, Literal

from pydantic import AfterValidator, Field, ValidationInfo

from scene_library.meshes import SUFFIXES

RESERVED_NAMES = ("relay_wall", "walls", "floor", "ceiling", "screen")
"""Names of the room's own parts."""


def resolved(path: str, info: ValidationInfo) -> Path:
    """The absolute path; a relative one starts at the configuration's folder (validation context)."""
    base = (info.context or {}).get("base_directory")
    return Path(base or ".").resolve() / path


def is_placed(info: ValidationInfo) -> bool:
    """Whether there is a folder to start from: when an old dataset's settings are read, no file need be there."""
    return (info.context or {}).get("base_directory") is not None


def _existing_file(path: str, info: ValidationInfo) -> str:
    place = resolved(path, info)
    if is_placed(info) and not place.is_file():
        found = "is a directory (kind: mesh_folder reads one)" if place.is_dir() else "no such file"
        raise ValueError(f"{path!r}: {found} ({place}); paths start at the configuration's folder")
    return path


def _existing_folder(path: str, info: ValidationInfo) -> str:
    place = resolved(path, info)
    if is_placed(info) and not place.is_dir():
        found = "is a file (kind: mesh reads one)" if place.is_file() else "no such folder"
        raise ValueError(f"{path!r}: {found} ({place}); paths start at the configuration's folder")
    if is_placed(info) and not classed_files(place):
        raise ValueError(f"{path!r}: holds no mesh files ({place}); {' '.join(SUFFIXES)} are read")
    return path


MeshPath = Annotated[str, Field(min_length=1), AfterValidator(_existing_file)]
FolderPath = Annotated[str, Field(min_length=1), AfterValidator(_existing_folder)]
Axis = Literal["x", "-x", "y", "-y", "z", "-z"]
TriangleBudget = Annotated[int, Field(ge=4)] | None


def classed_files(folder: Path) -> dict[str, tuple[Path, ...]]:
    """Class → mesh files: the first sub-folder on the way to a file, or its own name when there is none."""
    found: dict[str, list[Path]] = {}
    for file in sorted(folder.rglob("*")):
        if file.suffix.lower() in SUFFIXES and file.is_file():
            inner = file.relative_to(folder)
            found.setdefault(inner.parts[0] if len(inner.parts) > 1 else inner.stem, []).append(file)
    return {name: tuple(files) for name, files in sorted(found.items())}


def label_of(path: str) -> str:
    """A part name from the name of a file or folder: lower case letters, digits and underscores."""
    stem = re.sub(r"[^a-z0-9]+", "_", Path(path).stem.lower()).strip("_")[:40]
    if not stem or not stem[0].isalpha() or stem in RESERVED_NAMES:
        stem = f"mesh_{stem}".rstrip("_")
    return stem
