"""Mesh files as hidden objects: loading, repair, scaling, simplification, or a refusal that says why."""

from __future__ import annotations

import json
import re
from collections import Counter
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scene_library.arrays import Floats
from scene_library.open3d_import import import_open3d
from scene_library.polygon_files import BENT, NotSimple, read_obj, read_ply
from scene_library.solids import Solid

SUFFIXES = (".obj", ".ply", ".stl", ".glb")
POLYGONS = {".obj": read_obj, ".ply": read_ply}
"""Formats whose faces may have any number of corners; STL and GLB know triangles only."""

FRONTS = {"z": "-y", "-z": "y", "y": "z", "-y": "-z", "x": "-y", "-x": "-y"}
"""Axis of the file that points up → the one that points to the front where nothing is said."""


class BadMesh(ValueError):
    """A file that cannot be used: the message says what is wrong with it and what to do."""


@dataclass(frozen=True)
class MeshOptions:
    """How a file is read.

    Attributes
    ----------
    up : its upward axis.
    front : the axis that its front looks along, across `up`; None: that of `FRONTS`.
    max_triangles : simplify above that number; None: never.
    """

    up: str = "z"
    front: str | None = None
    max_triangles: int | None = None


COARSEST_STEP = 1e-3
"""Steps of a file's coordinates, relative to the object's size, above which its shape is taken to be lost."""
MOST_TRIANGLES, MOST_THINNED = 4_000_000, 16_000_000
"""Triangles of a mesh that is used as it is, and of one that `max_triangles` thins. Four million take 4.3 GiB and
half a minute a scene, six million three minutes to be thinned; a laser scanner makes as many of a statue."""
MESHES_KEPT = 256
"""Meshes held in memory by each process; beyond that the oldest is dropped."""


@dataclass(frozen=True)
class MeshFile:
    """The surface of a file.

    Attributes
    ----------
    vertices, triangles : (V, 3) and (F, 3), in the file's coordinates.
    doubt : what the file leaves open, in a line for users; "" where nothing.
    """

    vertices: Floats
    triangles: NDArray[np.int64]
    doubt: str


_cache: dict[tuple[str, int, int, MeshOptions], tuple[Solid, str]] = {}


def unit_mesh(path: Path, options: MeshOptions) -> Solid:
    """The file's surface, repaired and simplified, turned z up, scaled to height 1, standing on the origin.

    Kept in memory, by path, time of change, size and options. Raises `BadMesh`.
    """
    return unit_mesh_and_doubt(path, options)[0]


def unit_mesh_and_doubt(path: Path, options: MeshOptions) -> tuple[Solid, str]:
    """`unit_mesh`, and what the file leaves open (`MeshFile.doubt`)."""
    try:
        state = path.stat()
    except OSError as error:
        raise BadMesh(f"cannot be read ({error.strerror or error})") from None
    key = (str(path.resolve()), state.st_mtime_ns, state.st_size, options)
    if key not in _cache:
        if len(_cache) >= MESHES_KEPT:
            del _cache[next(iter(_cache))]
        _cache[key] = _unit(path, options)
    return _cache[key]


def read_mesh(path: Path) -> MeshFile:
    """The surface of a mesh file. Raises `BadMesh`."""
    if not path.is_file():
        raise BadMesh("cannot be read (no such file)")
    mesh = _read(path, MeshOptions())
    if not np.isfinite(mesh.vertices).all():
        raise BadMesh("has vertices that are not finite; export it again")
    return mesh


def _unit(path: Path, options: MeshOptions) -> tuple[Solid, str]:
    mesh = _read(path, options)
    vertices, faces = cleaned(mesh.vertices, mesh.triangles)
    _check_steps(vertices)
    if options.max_triangles is not None and len(faces) > options.max_triangles:
        vertices, faces = cleaned(*simplified(vertices, faces, options.max_triangles))
    vertices = vertices @ _upright(options.up, options.front or FRONTS[options.up]).T
    low, high = vertices.min(axis=0), vertices.max(axis=0)
    if not high[2] - low[2] > 1e-9 * float((high - low).max()):
        across = ", ".join(axis for axis in "xyz" if axis != options.up[-1])
        raise BadMesh(
            f"is flat along its upward axis {options.up}, so it has no height to scale; set another `up` ({across})"
        )
    vertices = (vertices - [(low[0] + high[0]) / 2, (low[1] + high[1]) / 2, low[2]]) / (high[2] - low[2])
    return Solid.of(vertices, faces), mesh.doubt


def _upright(up: str, front: str) -> Floats:
    """(3, 3) rotation that takes the file's axis `up` to +z and its axis `front` to −y."""
    z, y = _axis(up), -_axis(front)
    return np.stack([np.cross(y, z), y, z]) + 0.0


def _axis(name: str) -> Floats:
    return np.asarray((-1.0 if name.startswith("-") else 1.0) * np.eye(3)["xyz".index(name[-1])])


def _check_steps(vertices: Floats) -> None:
    """Raise `BadMesh` for what was rounded to single precision far from its origin, as surveyed models may be."""
    single = vertices.astype(np.float32)
    step = float(np.spacing(np.abs(single).max())) / float(np.ptp(vertices, axis=0).max())
    if step > COARSEST_STEP and np.array_equal(single, vertices):
        raise BadMesh(
            f"lies so far from its origin that its coordinates, in single precision, go in steps of {step:.2g} of "
            "its size; move it to the origin and export it again"
        )


def _read(path: Path, options: MeshOptions) -> MeshFile:
    """All triangles of a file, the transforms of its scene graph applied."""
    suffix = path.suffix.lower()
    if suffix not in SUFFIXES:
        raise BadMesh(f"is no mesh file that is known; convert it to one of {' '.join(SUFFIXES)}")
    if path.stat().st_size == 0:
        raise BadMesh("is empty (0 bytes); export it again")
    try:
        _check_count(_triangles_told(path), options)
        with np.errstate(all="ignore"):
            mesh = _of_polygons(path) if suffix in POLYGONS else _of_triangles(path)
    except BadMesh:
        raise
    except NotSimple as error:
        raise BadMesh(f"has a face that has no triangles ({error}); triangulate it in a mesh editor") from None
    except Exception as error:
        # Whatever a parser stumbles over in a broken file is the file's fault, and its message the best there is.
        reason = " ".join(str(error).split())[:120] or type(error).__name__
        raise BadMesh(f"cannot be parsed ({reason}); export it again as one of {' '.join(SUFFIXES)}") from None
    if not len(mesh.triangles):
        if len(mesh.vertices):
            raise BadMesh("is a point cloud or holds only lines, and has no triangles; reconstruct a surface first")
        raise BadMesh("holds no triangles, or is cut short; export a surface mesh again")
    return mesh


def _of_polygons(path: Path) -> MeshFile:
    """The surface of a file whose faces may have any number of corners."""
    faces = POLYGONS[path.suffix.lower()](path)
    triangles, bent = faces.triangles()
    doubt = (
        f"{bent} of {len(faces.counts)} faces have more than three corners and lie off a plane by more than "
        f"{BENT:.0%} of their size, and the file does not say how they bend; triangulate them in a "
        "mesh editor if it matters"
    )
    return MeshFile(faces.vertices, triangles, doubt if bent else "")


def _of_triangles(path: Path) -> MeshFile:
    """The surface of a file of triangles, by trimesh."""
    import trimesh

    loaded: Any = trimesh.load(path, force="scene", process=False, skip_materials=True)
    vertices, triangles, offset = [np.empty((0, 3))], [np.empty((0, 3), np.int64)], 0
    for node in loaded.graph.nodes_geometry:
        transform, name = loaded.graph[node]
        geometry = loaded.geometry[name]
        if len(getattr(geometry, "faces", ())):
            vertices.append(np.asarray(geometry.vertices, np.float64) @ transform[:3, :3].T + transform[:3, 3])
            triangles.append(np.asarray(geometry.faces, np.int64) + offset)
            offset += len(vertices[-1])
    return MeshFile(np.concatenate(vertices), np.concatenate(triangles), "")


def _check_count(count: int, options: MeshOptions) -> None:
    """Raise `BadMesh` for more triangles than can be handled, before they are read."""
    most = MOST_TRIANGLES if options.max_triangles is None else MOST_THINNED
    if count > most:
        thin = "set max_triangles, such as 20000, or " if count <= MOST_THINNED else ""
        raise BadMesh(f"has {count} triangles, and at most {most} are handled; {thin}thin it in a mesh editor")


def _triangles_told(path: Path) -> int:
    """At least how many triangles a file holds, by its header, its size, or the marks of its text; 0 if unclear.

    The nodes of a scene graph, which may show one mesh many times, are counted before they are expanded.
    """
    with path.open("rb") as file:
        start = file.read(2**16)
        match path.suffix.lower():
            case ".glb":
                file.seek(20)
                return _triangles_of_nodes(json.loads(file.read(int.from_bytes(start[12:16], "little"))))
            case ".ply":
                told = re.search(rb"element face +(\d+)", start.partition(b"end_header")[0])
                return int(told[1]) if told else 0
            case ".stl":
                count = int.from_bytes(start[80:84], "little")
                if path.stat().st_size == 84 + 50 * count:
                    return count
        mark = b"\nf " if path.suffix.lower() == ".obj" else b"endfacet"
        return start.count(mark) + sum(piece.count(mark) for piece in iter(lambda: file.read(2**24), b""))


def _triangles_of_nodes(tree: dict[str, Any]) -> int:
    """The triangles of a glTF file's meshes, each as often as nodes show it. Raises `BadMesh` for nodes of several
    parents, whose number could double from level to level."""

    def size(primitive: dict[str, Any]) -> int:
        used = primitive.get("indices"), primitive["attributes"].get("POSITION")
        counts = [int(tree["accessors"][number]["count"]) for number in used if number is not None]
        return max(counts, default=0) // 3

    parents = Counter(child for node in tree.get("nodes", []) for child in node.get("children", []))
    for node, count in parents.most_common(1):
        if count > 1:
            raise BadMesh(f"has a node ({node}) with {count} parents, and glTF allows one; export it again")
    in_mesh = [sum(map(size, mesh["primitives"])) for mesh in tree.get("meshes", [])]
    return max(sum(in_mesh), sum(in_mesh[int(node["mesh"])] for node in tree.get("nodes", []) if "mesh" in node))


def cleaned(vertices: Floats, faces: NDArray[np.int64]) -> tuple[Floats, NDArray[np.int64]]:
    """Merge vertices that coincide; drop triangles without area, repeated triangles and unused vertices."""
    if faces.min() < 0 or faces.max() >= len(vertices):
        raise BadMesh(f"names vertices that it does not hold (1 … {len(vertices)} exist); export it again")
    vertices, faces = _without_unused(vertices, faces)
    bad = np.count_nonzero(~np.isfinite(vertices).all(axis=1))
    if bad:
        raise BadMesh(
            f"has NaN or infinite coordinates in {bad} of {len(vertices)} vertices; remove them in a mesh editor"
        )
    vertices = _of_ordinary_size(vertices)
    extent = float(np.ptp(vertices, axis=0).max())
    if extent == 0:
        raise BadMesh("has no area: all its vertices are one point; export it again")
    grid = np.round((vertices - vertices.min(axis=0)) / (1e-7 * extent)).astype(np.int64)
    first, merged = _distinct(grid)
    faces = merged[faces]
    vertices = vertices[first]
    a, b, c = (vertices[faces[:, k]] for k in range(3))
    area = np.linalg.norm(np.cross(b - a, c - a), axis=1)
    faces = faces[area > 1e-14 * extent**2]
    if len(faces) == 0:
        raise BadMesh("has no area: every triangle is degenerate; export it again")
    faces = faces[np.sort(_distinct(np.sort(faces, axis=1))[0])]
    return _without_unused(vertices, faces)


def _without_unused(vertices: Floats, faces: NDArray[np.int64]) -> tuple[Floats, NDArray[np.int64]]:
    used = np.zeros(len(vertices), np.bool_)
    used[faces] = True
    return vertices[used], (np.cumsum(used) - 1)[faces]


def _distinct(rows: NDArray[np.int64]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Which rows (n, 3) are the first of their kind, in lexical order, and the number of each row in it.

    As `np.unique` of rows has them, in a third of the time.
    """
    order = np.lexsort(rows.T[::-1])
    in_order = rows[order]
    is_new = np.append(True, (in_order[1:] != in_order[:-1]).any(axis=1))
    number = np.empty(len(rows), np.int64)
    number[order] = np.cumsum(is_new) - 1
    return order[is_new], number


def _of_ordinary_size(vertices: Floats) -> Floats:
    """The vertices times a power of two, which rounds nothing, so that their extent is 512 … 1024.

    The file's unit is of no account, since objects are scaled to a height: areas must neither overflow nor vanish,
    nor must Open3D take the quadrics of a mesh in metres for singular (it does below a determinant of 10⁻⁴, and then
    puts merged vertices in worse places than it would for the same mesh in millimetres).
    """
    _, exponent = np.frexp(np.abs(vertices).max())
    vertices = np.ldexp(vertices, -exponent)
    _, exponent = np.frexp(np.ptp(vertices, axis=0).max())
    return np.asarray(np.ldexp(vertices, 10 - exponent))


def simplified(vertices: Floats, faces: NDArray[np.int64], max_triangles: int) -> tuple[Floats, NDArray[np.int64]]:
    """At most `max_triangles` triangles, by quadric edge collapse (Garland & Heckbert 1997, as in Open3D)."""
    try:
        open3d = import_open3d()
    except ImportError as error:
        needs = f"simplifying to {max_triangles} needs {error}"
        raise BadMesh(f"has {len(faces)} triangles and {needs}, or leave max_triangles out") from None
    mesh = open3d.geometry.TriangleMesh(
        open3d.utility.Vector3dVector(vertices), open3d.utility.Vector3iVector(faces.astype(np.int32))
    )
    smaller = mesh.simplify_quadric_decimation(max_triangles)
    left = np.asarray(smaller.triangles, np.int64)
    if len(left) == 0:
        raise BadMesh(f"falls apart when simplified to {max_triangles} triangles; raise max_triangles")
    if len(left) > max_triangles:
        raise BadMesh(f"cannot be simplified below {len(left)} triangles; raise max_triangles ({max_triangles})")
    return np.asarray(smaller.vertices, np.float64), left
