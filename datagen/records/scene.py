"""A scene: triangles, the part that each belongs to, and the material of each part."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Literal, get_args

import numpy as np
from numpy.typing import ArrayLike, NDArray

from datagen.errors import InputError, shown
from datagen.records.arrays import Floats, Ints
from datagen.records.checks import (
    as_points,
    as_reals,
    check_choice,
    check_kind,
    check_mapping,
    check_name,
    check_number,
    check_places,
    check_reals,
)
from datagen.records.materials import Material
from datagen.records.path import LONGEST_S, Moves, Path

if TYPE_CHECKING:
    import trimesh

Role = Literal["relay_wall", "structure", "object"]
"""`relay_wall`: the visible wall and what stands before it; `structure`: the other walls, floor and ceiling;
`object`: what a reconstruction should find."""


@dataclass(frozen=True)
class Pose:
    """Class and orientation of an object, which do not follow from its triangles.

    Attributes
    ----------
    label : its class.
    axes : (3, 3) rows: the object's own unit axes in the scene's frame, right-handed: width, depth (the back lies at
        +depth, so a front looks along −depth) and height.
    """

    label: str
    axes: Floats

    def __post_init__(self) -> None:
        check_name("Pose.label", self.label)
        axes = as_points("Pose.axes", self.axes, (3, 3))
        if not np.allclose(axes @ axes.T, np.eye(3), atol=1e-6):
            raise InputError(f"Pose.axes of {self.label!r}: its rows must be orthogonal unit vectors")
        object.__setattr__(self, "axes", axes)

    @classmethod
    def upright(cls, label: str, rotation_deg: float = 0.0) -> Pose:
        """Height along z; width and depth along x and y, rotated by `rotation_deg` about z."""
        check_number("Pose.upright", "rotation_deg", rotation_deg, -1e9, 1e9, "degrees")
        c, s = float(np.cos(np.radians(rotation_deg))), float(np.sin(np.radians(rotation_deg)))
        return cls(label, np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]]))


@dataclass(frozen=True)
class Part:
    """A named surface with one material. Raises `InputError` for values of other types; `Scene.from_parts` checks the
    triangles.

    Attributes
    ----------
    name : unique in its scene; up to 100 printable characters, of which the first is a letter or a digit, no comma.
    mesh : a `trimesh.Trimesh` in metres, or anything with `vertices` (V, 3), metres, and `faces` (F, 3), indices of
        vertices; triangles scatter on both sides, whichever way they are wound.
    material : how it scatters (`Lambertian`, `Phong`, `GGX` …).
    role : "relay_wall", "structure" (other walls, floor, ceiling) or "object" (to be reconstructed).
    pose : class and axes of its label box; left out: the part's name, and the axes of the scene.
    path : how an object moves: its mesh, and its pose, are taken along the path, mesh origin to place. None: it
        stands where its mesh is.

    Examples
    --------
    >>> import trimesh
    >>> import datagen as dg
    >>> box = dg.Part("box", trimesh.creation.box((0.4, 0.3, 0.5)), dg.Lambertian(0.7))
    >>> box.role, len(box.mesh.faces)
    ('object', 12)
    """

    name: str
    mesh: trimesh.Trimesh
    material: Material
    role: Role = "object"
    pose: Pose | None = None
    path: Path | None = None

    def __post_init__(self) -> None:
        check_name("Part.name", self.name)
        # A dataset lists the parts of a scene between commas, and a legend leaves out what begins with a mark.
        if not self.name[0].isalnum() or "," in self.name:
            raise InputError(
                f"Part.name = {shown(self.name)}: must begin with a letter or a digit and have no comma; rename it"
            )
        if not hasattr(self.mesh, "vertices") or not hasattr(self.mesh, "faces"):
            raise InputError(f"Part {self.name!r}: mesh = {shown(self.mesh)}: a trimesh.Trimesh in metres is needed")
        check_kind(f"Part {self.name!r}: material", self.material, Material, remedy="such as Lambertian(0.8)")
        check_choice(f"Part {self.name!r}: role", self.role, get_args(Role))
        if self.pose is not None:
            check_kind(f"Part {self.name!r}: pose", self.pose, Pose)
        if self.path is not None:
            check_kind(f"Part {self.name!r}: path", self.path, Path, remedy="such as dg.Path(times_s, places)")
            if self.role != "object":
                raise InputError(
                    f"Part {self.name!r}: a path with role = {self.role!r}: only objects move, and the walls that "
                    "laser and sensor look at stand; make it an object, or leave path out"
                )


@dataclass(frozen=True)
class Rectangle:
    """A rectangle in space: `center ± right ± up` (half-extent vectors, metres), each (3,)."""

    center: Floats
    right: Floats
    up: Floats

    def __post_init__(self) -> None:
        for name in ("center", "right", "up"):
            object.__setattr__(self, name, as_points(f"Rectangle.{name}", getattr(self, name), (3,)))

    @classmethod
    def of(cls, center: ArrayLike, right: ArrayLike, up: ArrayLike) -> Rectangle:
        """The rectangle of array-like values; raises `InputError` for half extents that are 0 or not
        perpendicular."""
        made = cls(center, right, up)  # type: ignore[arg-type]
        across = float(np.linalg.norm(made.right) * np.linalg.norm(made.up))
        if across == 0 or abs(float(made.right @ made.up)) > 1e-9 * across:
            raise InputError("Rectangle: right and up must be perpendicular half-extent vectors, neither of them 0")
        return made

    @property
    def normal(self) -> Floats:
        """Unit normal right × up; for a relay wall it points into the room. Shape (3,)."""
        n = np.cross(self.right, self.up)
        return np.asarray(n / np.linalg.norm(n))

    @property
    def corners(self) -> Floats:
        """The four corners in order (−−, +−, ++, −+) of (right, up). Shape (4, 3), metres."""
        signs = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]], np.float64)
        return self.center + signs[:, :1] * self.right + signs[:, 1:] * self.up

    @property
    def area_m2(self) -> float:
        """Area, m²."""
        return 4.0 * float(np.linalg.norm(np.cross(self.right, self.up)))


@dataclass(frozen=True)
class Scene:
    """Triangles with parts and materials, and the places in the room that captures and labels refer to.

    Where parts move (`paths`), the triangles are those of time 0, at which the first frame begins: whatever asks for
    no time sees the room as it is then, and `Scene.at` gives it as it is at another time.

    Attributes
    ----------
    vertices : (V, 3) float64, metres; right-handed frame, z up.
    triangles : (F, 3) int32 indices into `vertices`.
    face_part : (F,) int32, index into `part_names`, `materials`, `roles`.
    relay_wall : the rectangle of the relay wall that the device sees, in the nominal plane of an uneven wall; None if
        unknown.
    hidden_view : the window in the plane of the relay wall through which label images look at the hidden part
        (orthographically, along the normal); None if unknown.
    hidden_bounds : (2, 3) corners of the box that volume labels fill; None if unknown.
    device_position : (3,) where laser and sensor stand unless a capture says otherwise; None if unknown.
    parameters : every number drawn for this scene, by dotted name; stored with the sample.
    attenuation_per_m : Napierian attenuation of the air, 1/m: every leg R passes exp(−a R).
    poses : object part → its class and axes; a part without one stands along the scene's axes, named by its part.
    paths : object part → its path; parts without one stand.
    """

    vertices: Floats
    triangles: NDArray[np.int32]
    face_part: NDArray[np.int32]
    part_names: tuple[str, ...]
    materials: tuple[Material, ...]
    roles: tuple[Role, ...]
    relay_wall: Rectangle | None = None
    hidden_view: Rectangle | None = None
    hidden_bounds: Floats | None = None
    device_position: Floats | None = None
    parameters: Mapping[str, float | int | str | bool] = field(default_factory=dict)
    attenuation_per_m: float = 0.0
    poses: Mapping[str, Pose] = field(default_factory=dict)
    paths: Mapping[str, Path] = field(default_factory=dict)

    def __post_init__(self) -> None:
        check_number("Scene", "attenuation_per_m", self.attenuation_per_m, 0.0, 1e12, "1/m; 0 for clear air")
        for name, shape in (("vertices", (3,)), ("triangles", (3,)), ("face_part", ())):
            array = getattr(self, name)
            if not isinstance(array, np.ndarray) or array.ndim != 1 + len(shape) or array.shape[1:] != shape:
                wanted = ", ".join(("n", *map(str, shape)))
                raise InputError(f"Scene.{name} = {shown(array)}: an array ({wanted}) needed; see Scene.from_parts")
        for name, kind in (("part_names", str), ("materials", Material), ("roles", str)):
            check_kind(f"Scene.{name}", getattr(self, name), Sequence, remedy="see Scene.from_parts")
            for number, one in enumerate(getattr(self, name)):
                check_kind(f"Scene.{name}[{number}]", one, kind, remedy="see Scene.from_parts")
        parts = len(self.part_names)
        if not len(self.triangles) == len(self.face_part) or not parts == len(self.materials) == len(self.roles):
            raise InputError(
                f"Scene: {len(self.triangles)} triangles with {len(self.face_part)} of face_part, {parts} part_names "
                f"with {len(self.materials)} materials and {len(self.roles)} roles; each needs as many"
            )
        for name in ("relay_wall", "hidden_view"):
            if getattr(self, name) is not None:
                check_kind(f"Scene.{name}", getattr(self, name), Rectangle, remedy="such as Rectangle.of(...)")
        if self.hidden_bounds is not None:
            check_reals("Scene.hidden_bounds", self.hidden_bounds, (2, 3))
        if self.device_position is not None:
            check_reals("Scene.device_position", self.device_position, (3,))
        check_kind("Scene.parameters", self.parameters, Mapping)
        check_mapping("Scene.poses", self.poses, Pose, remedy="the pose of each part that has one")
        check_mapping("Scene.paths", self.paths, Path, remedy="the path of each part that moves")
        for name in self.paths:
            if name not in self.objects:
                raise InputError(f"Scene.paths: {shown(name)} is no object of this scene; only objects move")

    @classmethod
    def from_parts(
        cls, parts: Iterable[Part], *, relay_wall: Rectangle | None = None, hidden_view: Rectangle | None = None,
        hidden_bounds: ArrayLike | None = None, device_position: ArrayLike | None = None,
        parameters: Mapping[str, float | int | str | bool] | None = None, attenuation_per_m: float = 0.0,
    ) -> Scene:  # fmt: skip
        """Join parts into one scene. Zero-area triangles are dropped; parts keep their order, and those with a path
        are put where it has them at time 0.

        Raises `InputError` for no parts, a repeated name, vertices that are not finite or beyond 10⁹ m, indices out
        of range, or a part left with no area.

        >>> import trimesh
        >>> import datagen as dg
        >>> wall = trimesh.creation.box((0.01, 3, 2.5))
        >>> box = trimesh.creation.box((0.4, 0.3, 0.5)).apply_translation((-1.5, 1, 0))
        >>> parts = [dg.Part("wall", wall, dg.Lambertian(0.8), "relay_wall"), dg.Part("box", box, dg.Phong(0.5))]
        >>> scene = dg.Scene.from_parts(parts)
        >>> scene.part_names, scene.triangles.shape, len(scene.faces_of("box"))
        (('wall', 'box'), (24, 3), 12)
        """
        if isinstance(parts, Part) or not isinstance(parts, Iterable):
            raise InputError(f"Scene.from_parts: parts = {shown(parts)}: a list of Part is needed")
        parts = list(parts)
        for number, part in enumerate(parts):
            check_kind(f"Scene.from_parts: parts[{number}]", part, Part)
        if not parts:
            raise InputError("Scene.from_parts: no parts given; a scene needs at least one surface")
        names = tuple(p.name for p in parts)
        for name in names:
            if names.count(name) > 1:
                raise InputError(f"Scene.from_parts: part name {name!r} is used twice; names must be unique")
        bounds = None if hidden_bounds is None else as_points("Scene.hidden_bounds", hidden_bounds, (2, 3))
        device = None if device_position is None else as_points("Scene.device_position", device_position, (3,))
        vertices, triangles, face_part, offset = [], [], [], 0
        for index, part in enumerate(parts):
            v, f = _checked_triangles(part)
            v = v if part.path is None else part.path.at(0.0).apply(v)
            vertices.append(v)
            triangles.append(f + offset)
            face_part.append(np.full(len(f), index, np.int32))
            offset += len(v)
        return cls(
            vertices=np.concatenate(vertices), triangles=np.concatenate(triangles).astype(np.int32),
            face_part=np.concatenate(face_part), part_names=names, materials=tuple(p.material for p in parts),
            roles=tuple(p.role for p in parts), relay_wall=relay_wall, hidden_view=hidden_view,
            hidden_bounds=bounds,
            device_position=device,
            parameters=_scalars({} if parameters is None else parameters), attenuation_per_m=attenuation_per_m,
            poses={part.name: pose for part in parts if (pose := _first_pose(part)) is not None},
            paths={part.name: part.path for part in parts if part.path is not None},
        )  # fmt: skip

    def pose_of(self, part: str) -> Pose:
        """Class and axes of a part."""
        check_kind("part", part, str, remedy="the name of a part")
        return self.poses.get(part) or Pose.upright(part)

    @property
    def objects(self) -> tuple[str, ...]:
        """Names of the parts whose role is object, in their order."""
        return tuple(name for name, role in zip(self.part_names, self.roles, strict=True) if role == "object")

    def without(self, *names: str) -> Scene:
        """The scene without the named parts; everything else, parameters too, stays.

        Raises `InputError` for an unknown part, and where no part would be left.
        """
        gone = self.faces_of(*names)
        kept = [k for k, name in enumerate(self.part_names) if name not in names]
        if not kept:
            raise InputError(f"Scene.without: {', '.join(names)}: a scene needs at least one surface")
        triangles = np.delete(self.triangles, gone, axis=0)
        used, renumbered = np.unique(triangles, return_inverse=True)
        number = np.full(len(self.part_names), -1, np.int32)
        number[kept] = np.arange(len(kept), dtype=np.int32)
        return replace(
            self, vertices=self.vertices[used], triangles=renumbered.reshape(triangles.shape).astype(np.int32),
            face_part=number[np.delete(self.face_part, gone)], part_names=tuple(self.part_names[k] for k in kept),
            materials=tuple(self.materials[k] for k in kept), roles=tuple(self.roles[k] for k in kept),
            poses={name: pose for name, pose in self.poses.items() if name not in names},
            paths={name: path for name, path in self.paths.items() if name not in names},
        )  # fmt: skip

    @property
    def moving(self) -> tuple[str, ...]:
        """Names of the parts that move, in their order; one whose path stays in one place does not."""
        return tuple(name for name in self.part_names if name in self.paths and not self.paths[name].stands)

    def moves(self, part: str, times_s: ArrayLike) -> Moves:
        """The moves, of the shape of `times_s`, that take the triangles of a part from where `vertices` has them to
        where they are at these times.

        At time 0, and at all times for a part that stands, a move leaves every point as it is, to the bit.
        """
        self.faces_of(part)
        path = self.paths.get(part, _STANDS)
        return path.at(times_s).since(path.at(0.0))

    def at(self, time_s: float) -> Scene:
        """The scene without paths in which everything stands where it is at a time; `parameters` stay as they are.

        >>> import trimesh
        >>> import datagen as dg
        >>> path = dg.Path(times_s=(0, 1), places=[(2, 0, 0.2), (2, 1, 0.2)])
        >>> box = dg.Part("box", trimesh.creation.box((0.4, 0.4, 0.4)), dg.Lambertian(0.5), path=path)
        >>> scene = dg.Scene.from_parts([box])
        >>> scene.at(0.25).vertices.mean(axis=0).round(3).tolist(), scene.moving, scene.at(0.25).moving
        ([2.0, 0.25, 0.2], ('box',), ())
        """
        check_number("Scene.at", "time_s", time_s, -LONGEST_S, LONGEST_S, "seconds since the first frame began")
        vertices, poses = self.vertices.copy(), dict(self.poses)
        for name in self.moving:
            move = self.moves(name, time_s)
            own = np.unique(self.triangles[self.faces_of(name)])
            vertices[own] = move.apply(vertices[own])
            poses[name] = _pose_after(self.pose_of(name), move)
        return replace(self, vertices=vertices, poses=poses, paths={})

    @property
    def corners(self) -> Floats:
        """(F, 3, 3): the three corners of every triangle, metres."""
        return self.vertices[self.triangles]

    def faces_of(self, *names: str) -> Ints:
        """Indices of the triangles of the named parts, ascending."""
        unknown = [n for n in names if not isinstance(n, str) or n not in self.part_names]
        if unknown:
            raise InputError(f"part {shown(unknown[0])}: this scene has {', '.join(self.part_names)}")
        return np.flatnonzero(np.isin(self.face_part, [self.part_names.index(n) for n in names]))


_STANDS = Path((0.0,), [(0.0, 0.0, 0.0)])


def _first_pose(part: Part) -> Pose | None:
    """The pose of a part at time 0; None for one that stands along the scene's axes, named by its part."""
    if part.path is None:
        return part.pose
    return _pose_after(part.pose or Pose.upright(part.name), part.path.at(0.0))


def _pose_after(pose: Pose, move: Moves) -> Pose:
    """The pose after one move."""
    return replace(pose, axes=move.turn(pose.axes))


def _scalars(parameters: Mapping[str, float | int | str | bool]) -> dict[str, float | int | str | bool]:
    check_kind("Scene.parameters", parameters, Mapping)
    for name, value in parameters.items():
        check_name("Scene.parameters: name", name)
        if not isinstance(value, (float, int, str, bool, np.generic)):
            raise InputError(f"Scene.parameters[{shown(name)}] = {shown(value)}: text or a number needed")
    return dict(parameters)


def _checked_triangles(part: Part) -> tuple[Floats, Ints]:
    vertices = as_reals(f"part {part.name!r}: vertices", part.mesh.vertices)
    numbers = as_reals(f"part {part.name!r}: triangles", part.mesh.faces)
    faces = numbers.astype(np.int64)
    if vertices.ndim != 2 or vertices.shape[1] != 3 or faces.ndim != 2 or faces.shape[1] != 3 or len(faces) == 0:
        raise InputError(f"part {part.name!r}: needs vertices (V, 3) and at least one triangle (F, 3)")
    check_places(f"part {part.name!r}: vertices", vertices)
    if (numbers != faces).any() or faces.min() < 0 or faces.max() >= len(vertices):
        raise InputError(f"part {part.name!r}: triangle indices must lie in 0 … {len(vertices) - 1}")
    a, b, c = (vertices[faces[:, k]] for k in range(3))
    extent = float(np.ptp(vertices, axis=0).max())
    has_area = np.linalg.norm(np.cross(b - a, c - a), axis=1) > 1e-14 * extent**2
    if not has_area.any():
        raise InputError(f"part {part.name!r}: all {len(faces)} triangles have zero area; nothing can scatter light")
    return vertices, faces[has_area]
