"""The key `scene.contents`: which objects stand in the hidden part, how many, how large and where."""

from __future__ import annotations

import hashlib
import os
import re
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal, Self

from pydantic import (
    AfterValidator,
    Field,
    PrivateAttr,
    SerializerFunctionWrapHandler,
    ValidationInfo,
    model_serializer,
    model_validator,
)

from datagen.config.base import check_known, folder_of, is_stored, without_unset
from datagen.config.distributions import Count, Distribution, Fraction, Length, NotNegative, Uniform, within
from datagen.config.scene_materials import SurfaceMaterial
from datagen.config.scene_motion import Motion, Points, Walk
from datagen.untrusted import content_of, why_no_file
from scene_library.meshes import SUFFIXES, upward_axis
from scene_library.objects.classes import CLASSES, GROUPS, classes_of

Name = Annotated[str, Field(pattern=r"^[a-z][a-z0-9_]{0,40}$")]
RESERVED_NAMES = ("relay_wall", "walls", "floor", "ceiling", "screen")
"""Names of the room's own parts."""


Axis = Literal["x", "-x", "y", "-y", "z", "-z"]


def classed_files(folder: Path) -> dict[str, tuple[Path, ...]]:
    """Class → mesh files. The class is the first sub-folder on the way to a file; without one, the file's own
    name."""
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


class Item(SurfaceMaterial):
    """What all objects share."""

    name: Name | None = None
    """Name of the part; left out: its kind. Further ones of the same name are numbered: box, box_2, box_3."""
    count: Count = 1
    """How many."""
    along: Fraction = Uniform(uniform=(0.0, 1.0))
    """Position of the centre within the hidden part: 0 farthest from the relay wall's plane, 1 in it."""
    across: Fraction = Uniform(uniform=(0.0, 1.0))
    """Position of the centre within the hidden part: 0 on the side it is entered from, 1 on the far side."""
    distance_m: Length | None = None
    """Distance of the centre from the relay wall's plane, in place of `along`."""
    offset_m: Annotated[Distribution, within(-1000, 1000)] | None = None
    """Distance of the centre to the right of the middle of the relay wall's visible part, for somebody who faces the
    wall, in place of `across`."""
    rotation_deg: Annotated[Distribution, within(-360, 360)] = Uniform(uniform=(0.0, 360.0))
    """Rotation about the vertical."""
    evidence_at_least: Annotated[float, Field(gt=0, le=1e4)] | None = None
    """Least detectability σ of each of these objects: all objects of a scene are placed anew until
    they have it, which makes near, large and bright objects more frequent; where things move, in the median of the
    beginning, the middle and the end of the sequence. Left out: no limit."""
    motion: Motion | None = None
    """How each of these objects moves while the frames of `sequence` are measured; what is said of its place and
    rotation, and of what must be seen, then holds at the beginning. Left out: it stands."""

    sizes: ClassVar[tuple[str, ...]] = ()
    """Names of the keys that set the object's size, in the order they are drawn."""

    def _check(self) -> None:
        super()._check()
        if self.name in RESERVED_NAMES:
            raise ValueError(f"name = {self.name!r}: is a part of the room; choose another")
        self._only_one_of("along", "distance_m")
        self._only_one_of("across", "offset_m")
        given = [key for key in ("along", "across", "distance_m", "offset_m") if key in self.changed()]
        if isinstance(self.motion, Points) and given:
            raise ValueError(f"{given[0]} beside motion of kind points, whose points say where it is: leave it out")

    @model_serializer(mode="wrap")
    def _plain(self, plain: SerializerFunctionWrapHandler) -> dict[str, Any]:
        return without_unset(self, plain, "motion")

    @property
    def part_name(self) -> str:
        """Name of its part in the scene."""
        return self.name or str(getattr(self, "kind", "object"))

    @property
    def class_names(self) -> tuple[str, ...]:
        """The classes of object that can be drawn."""
        return (self.part_name,)


class Standing(Item):
    """Objects that stand on the floor, stand with their back to a wall, or hang from the ceiling."""

    placement: Literal["floor", "wall", "hanging"] = "floor"
    """`floor`: anywhere, rotated by `rotation_deg`. `wall`: back to a wall of the hidden part; `along`, `across` and
    `rotation_deg` then follow from the wall. `hanging`: from the ceiling."""
    elevation_m: NotNegative = 0.0
    """Height of the lowest point above the floor; hanging: the gap between ceiling and highest point."""

    def _check(self) -> None:
        super()._check()
        if self.placement == "wall" and isinstance(self.motion, Walk | Points):
            raise ValueError(
                f"placement = 'wall' with motion of kind {self.motion.kind}, which decides the rotation: set it to "
                "floor"
            )


class Pillar(Item):
    """A pillar from floor to ceiling."""

    kind: Literal["pillar"] = "pillar"
    shape: Literal["square", "round"] = "square"
    """`round`: an ellipse of 32 sides."""
    width_m: Length = Uniform(uniform=(0.25, 0.6))
    depth_m: Length | None = None
    """Left out: as deep as wide."""
    sizes = ("width_m", "depth_m")


class Box(Standing):
    """A cuboid."""

    kind: Literal["box"] = "box"
    width_m: Length = Uniform(uniform=(0.3, 0.9))
    depth_m: Length = Uniform(uniform=(0.3, 0.9))
    height_m: Length = Uniform(uniform=(0.3, 1.4))
    sizes = ("width_m", "depth_m", "height_m")


def _known_classes(names: tuple[str, ...]) -> tuple[str, ...]:
    for name in names:
        check_known(name, CLASSES, "a class of the library", GROUPS)
    return names


KnownClasses = Annotated[tuple[str, ...], Field(min_length=1), AfterValidator(_known_classes)]


class Library(Standing):
    """An object of the library: its class is drawn, then its proportions."""

    kind: Literal["library"] = "library"
    classes: KnownClasses = ("furniture", "household", "figures")
    """Classes (chair, mannequin, letter_a, digit_7, sphere, …) or groups of them; all equally likely."""
    height_m: Length | None = None
    """Scale to this height; left out: natural size."""
    sizes = ("height_m",)

    @property
    def class_names(self) -> tuple[str, ...]:
        """The classes, groups resolved."""
        return classes_of(self.classes)


class MeshItem(Standing):
    """An object read from a mesh file, scaled to a height."""

    path: Annotated[str, Field(min_length=1)]
    height_m: Length = Uniform(uniform=(0.5, 1.5))
    """The object is scaled to this height."""
    up: Axis | None = None
    """The axis of the file that points up. Left out: y of .glb files, whose format says so; z of others."""
    front: Axis | None = None
    """The axis of the file along which the object's front looks, at right angles to `up`; width, depth and box of the
    object follow from it. Left out: -y with up = z, z with up = y."""
    max_triangles: Annotated[int, Field(ge=4)] | None = None
    """Simplify to at most this many triangles; left out: never."""
    sizes = ("height_m",)

    _base: Path = PrivateAttr(default=Path())

    @model_validator(mode="after")
    def _found_from(self, info: ValidationInfo) -> Self:
        self._base = folder_of(info).resolve()
        # The settings of a stored dataset are read even where its files are gone.
        if info.context is not None and not is_stored(info):
            self._look()
        return self

    def _look(self) -> None:
        """Raise `ValueError` where there is no such file or folder."""

    @property
    def base(self) -> Path | None:
        """Absolute path of the folder at which `path` starts, that of the configuration; None if it is absolute."""
        return None if Path(self.path).is_absolute() else self._base

    @property
    def place(self) -> Path:
        """Absolute path of the file or folder."""
        return self._base / self.path

    def _check(self) -> None:
        super()._check()
        if self.front is not None and self.up is not None and self.front[-1] == self.up[-1]:
            raise ValueError(f"front = {self.front!r}: must lie across up = {self.up!r}; choose another axis")


class Mesh(MeshItem):
    """A mesh file, scaled to a height."""

    kind: Literal["mesh"] = "mesh"
    path: Annotated[str, Field(min_length=1)]
    """An .obj, .ply, .stl or .glb file; relative to the configuration's folder."""

    def _check(self) -> None:
        if self.up is None:
            # A dataset stores what holds for its file.
            object.__setattr__(self, "up", upward_axis(self.path))
        super()._check()

    def _look(self) -> None:
        if (found := why_no_file(self.place)) is not None:
            found += " (kind: mesh_folder reads one)" if os.path.isdir(self.place) else ""
            raise ValueError(
                f"path = {self.path!r}: {found} ({self.place}); paths start at the configuration's folder"
            )

    @property
    def part_name(self) -> str:
        """Name of its part in the scene; left out: that of the file."""
        return self.name or label_of(self.path)

    def digest(self) -> str:
        """Hex SHA-256 of the file's bytes."""
        return hashlib.sha256(content_of(self.place)).hexdigest()


class MeshFolder(MeshItem):
    """A folder of mesh files: one is drawn, scaled to a height; the name of its sub-folder is its class."""

    kind: Literal["mesh_folder"] = "mesh_folder"
    path: Annotated[str, Field(min_length=1)]
    """A folder with a sub-folder for each class; files directly in it are classes of their own."""
    classes: tuple[str, ...] | None = None
    """Names of the sub-folders to draw from, equally likely; left out: all."""

    _found: dict[str, tuple[Path, ...]] | None = PrivateAttr(default=None)

    def _look(self) -> None:
        if not os.path.isdir(self.place):
            found = "is a file (kind: mesh reads one)" if os.path.isfile(self.place) else "no such folder"
            raise ValueError(
                f"path = {self.path!r}: {found} ({self.place}); paths start at the configuration's folder"
            )
        classes = classed_files(self.place)
        if not classes:
            raise ValueError(
                f"path = {self.path!r}: holds no mesh files ({self.place}); {' '.join(SUFFIXES)} are read"
            )
        for name in self.classes or ():
            check_known(name, classes, f"a sub-folder of {self.path!r} with meshes")

    @property
    def class_names(self) -> tuple[str, ...]:
        """The classes in the folder, of those wanted."""
        return tuple(self.files())

    def files(self) -> dict[str, tuple[Path, ...]]:
        """Class → its files, both sorted by name, of the classes wanted."""
        if self._found is None:
            found = classed_files(self.place)
            self._found = found if self.classes is None else {c: found[c] for c in self.classes if c in found}
        return self._found

    def shown(self, file: Path) -> str:
        """A file of the folder as messages and parameters show it: `path`, and the way from there."""
        return f"{self.path}/{file.relative_to(self.place).as_posix()}"

    def digest(self) -> str:
        """Hex SHA-256 of the names and bytes of all files that can be drawn."""
        total = hashlib.sha256()
        for file in (file for files in self.files().values() for file in files):
            total.update(f"{file.relative_to(self.place).as_posix()}\0".encode())
            total.update(hashlib.sha256(content_of(file)).digest())
        return total.hexdigest()


Content = Annotated[Pillar | Box | Library | Mesh | MeshFolder, Field(discriminator="kind")]
