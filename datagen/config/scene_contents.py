"""The key `scene.contents`: which objects stand in the hidden part, how many, how large and where."""

from __future__ import annotations

import hashlib
import re
from pathlib import Path
from typing import Annotated, ClassVar, Literal, Self

import numpy as np
from pydantic import AfterValidator, Field, PrivateAttr, Tag, ValidationInfo, model_validator

from datagen.config.base import Settings, tag
from datagen.config.distributions import Choice, Distribution, Fraction, Length, Uniform, draw, support, within
from datagen.config.scene_kinds import kind_of, unknown_kind
from datagen.config.scene_layouts import NonNegative


def _whole(value: Distribution) -> Distribution:
    bounds = value.choice if isinstance(value, Choice) else support(value)
    if any(b != int(b) or b < 0 for b in bounds):
        shown = ", ".join(f"{b:g}" for b in dict.fromkeys(bounds))
        raise ValueError(f"{shown} given; whole numbers ≥ 0 are needed")
    return value


Count = Annotated[Distribution, AfterValidator(_whole)]
"""A distribution of whole numbers; `{uniform: [1, 3]}` makes 1, 2 and 3 equally likely."""


def draw_count(count: Distribution, rng: np.random.Generator) -> int:
    """A whole number; continuous distributions other than the uniform are rounded."""
    if isinstance(count, Uniform):
        low, high = count.uniform
        return int(rng.integers(int(low), int(high), endpoint=True))
    return round(draw(count, rng))


Angle = Annotated[Distribution, within(-360, 360)]
ANY_ANGLE = Uniform(uniform=(0.0, 360.0))
RESERVED_NAMES = ("relay_wall", "walls", "floor", "ceiling", "screen")
Name = Annotated[str, Field(pattern=r"^[a-z][a-z0-9_]{0,40}$")]


class Item(Settings):
    """What all objects share."""

    name: Name | None = None
    """Name of the part; left out: its kind. Further ones of the same name are numbered: box, box_2, box_3."""
    count: Count = 1
    """How many."""
    along: Fraction = Uniform(uniform=(0.0, 1.0))
    """Position of the centre within the hidden part: 0 farthest from the relay wall's plane, 1 in it."""
    across: Fraction = Uniform(uniform=(0.0, 1.0))
    """Position of the centre within the hidden part: 0 on the side it is entered from, 1 on the far side."""
    rotation_deg: Angle = ANY_ANGLE
    """Turn about the vertical."""
    albedo: Fraction = Uniform(uniform=(0.3, 0.9))
    """Share of light that the surface returns, Lambertian."""

    sizes: ClassVar[tuple[str, ...]] = ()
    """Names of the keys that set the object's size, in the order they are drawn."""

    @model_validator(mode="after")
    def _not_reserved(self) -> Self:
        if self.name in RESERVED_NAMES:
            raise ValueError(f"name = {self.name!r}: is a part of the room; choose another")
        return self

    @property
    def part_name(self) -> str:
        return self.name or str(getattr(self, "kind", "object"))

    def smallest_footprint_m(self) -> tuple[float, float] | None:
        """Short and long side of the smallest footprint, or None if only the drawn object tells."""
        return None

    def smallest_height_m(self) -> float:
        return 0.0

    def plan_sizes(self) -> list[str]:
        """Names of the keys that decide how much floor the object takes."""
        given = [name for name in self.sizes if getattr(self, name) is not None]
        return [name for name in given if name != "height_m"] or given


class Standing(Item):
    """An object that stands on the floor, at a height above it, or hangs from the ceiling."""

    elevation_m: NonNegative = 0.0
    """Height of its lowest point above the floor."""
    hanging: bool = False
    """Hang it from the ceiling: then `elevation_m` is the gap between its top and the ceiling."""


class Pillar(Item):
    """A rectangular pillar from floor to ceiling."""

    kind: Literal["pillar"] = "pillar"
    width_m: Length = Uniform(uniform=(0.25, 0.6))
    depth_m: Length | None = None
    """Left out: as deep as wide."""

    sizes: ClassVar[tuple[str, ...]] = ("width_m", "depth_m")

    def smallest_footprint_m(self) -> tuple[float, float] | None:
        return _sides(self.width_m, self.width_m if self.depth_m is None else self.depth_m)


class Box(Standing):
    """A cuboid."""

    kind: Literal["box"] = "box"
    width_m: Length = Uniform(uniform=(0.3, 0.9))
    depth_m: Length = Uniform(uniform=(0.3, 0.9))
    height_m: Length = Uniform(uniform=(0.3, 1.4))

    sizes: ClassVar[tuple[str, ...]] = ("width_m", "depth_m", "height_m")

    def smallest_footprint_m(self) -> tuple[float, float] | None:
        return _sides(self.width_m, self.depth_m)

    def smallest_height_m(self) -> float:
        return support(self.height_m)[0]


def _existing(path: str, info: ValidationInfo) -> str:
    base = (info.context or {}).get("base_directory")
    if base is not None and not (Path(base) / path).is_file():
        found = "is a directory" if (Path(base) / path).is_dir() else "no such file"
        raise ValueError(f"{path!r}: {found} ({Path(base) / path}); paths start at the configuration's folder")
    return path


class Mesh(Standing):
    """A mesh file, scaled to a height."""

    kind: Literal["mesh"] = "mesh"
    path: Annotated[str, Field(min_length=1), AfterValidator(_existing)]
    """An .obj, .ply, .stl or .glb file; relative to the configuration's folder."""
    height_m: Length = Uniform(uniform=(0.5, 1.5))
    """The object is scaled to this height."""
    up: Literal["x", "-x", "y", "-y", "z", "-z"] = "z"
    """The axis of the file that points up."""
    max_triangles: Annotated[int, Field(ge=4)] | None = None
    """Simplify to at most this many triangles; left out: never."""

    sizes: ClassVar[tuple[str, ...]] = ("height_m",)

    _file: Path = PrivateAttr(default=Path())

    @model_validator(mode="after")
    def _resolve(self, info: ValidationInfo) -> Self:
        base = (info.context or {}).get("base_directory")
        self._file = Path(base or ".").resolve() / self.path
        return self

    @property
    def file(self) -> Path:
        """Where `path` led when the configuration was read."""
        return self._file

    @property
    def part_name(self) -> str:
        stem = re.sub(r"[^a-z0-9]+", "_", Path(self.path).stem.lower()).strip("_")[:40]
        if not stem or not stem[0].isalpha() or stem in RESERVED_NAMES:
            stem = f"mesh_{stem}".rstrip("_")
        return self.name or stem

    def smallest_height_m(self) -> float:
        return support(self.height_m)[0]

    def digest(self) -> str:
        """Hex SHA-256 of the file's bytes."""
        return hashlib.sha256(self._file.read_bytes()).hexdigest()


def _sides(a: Distribution, b: Distribution) -> tuple[float, float]:
    short, long = sorted((support(a)[0], support(b)[0]))
    return short, long


KINDS = ("pillar", "box", "mesh")
Content = Annotated[
    Annotated[Pillar, Tag(tag("pillar"))]
    | Annotated[Box, Tag(tag("box"))]
    | Annotated[Mesh, Tag(tag("mesh"))]
    | Annotated[Box, *unknown_kind(*KINDS)],
    kind_of(*KINDS),
]
