"""Mesh files as hidden objects: loading, repair, scaling, simplification, or a refusal that says why."""

from __future__ import annotations

import os
import re
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from scene_library.arrays import Floats
from scene_library.glb_files import read_glb
from scene_library.mesh_file import BadMesh, MeshFile
from scene_library.open3d_import import import_open3d
from scene_library.polygon_files import BENT, read_obj, read_ply
from scene_library.solids import Solid
from scene_library.stl_files import HEADER_BYTES, count_by_size, read_stl

SUFFIXES = (".obj", ".ply", ".stl", ".glb")
POLYGONS = {".obj": read_obj, ".ply": read_ply}
"""Formats whose faces may have any number of corners; STL and GLB know triangles only."""

FRONTS = {"z": "-y", "-z": "y", "y": "z", "-y": "-z", "x": "-y", "-x": "-y"}
"""Axis of the file that points up → the one that points to the front where nothing is said."""


def upward_axis(path: Path | str) -> str:
    """The axis that points up in a file that is read without options: glTF fixes y; other formats leave it open."""
    return "y" if Path(path).suffix.lower() == ".glb" else "z"


@dataclass(frozen=True)
class MeshOptions:
    """How a file is read.

    Attributes
    ----------
    up : its upward axis; None: that of `upward_axis`.
    front : the axis that its front looks along, across `up`; None: that of `FRONTS`.
    max_triangles : simplify above that number; None: never.
    """

    up: str | None = None
    front: str | None = None
    max_triangles: int | None = None


COARSEST_STEP = 1e-3
"""Steps of a file's coordinates, relative to the object's size, above which its shape is taken to be lost."""
MOST_TRIANGLES, MOST_THINNED = 4_000_000, 16_000_000
"""Triangles of a mesh that is used as it is, and of one that `max_triangles` thins. Four million take 4.3 GiB and
half a minute a scene, six million three minutes to be thinned; a laser scanner makes as many of a statue."""
MOST_BYTES = 2**31
"""Size of the largest file that is read, 2 GiB: 16 million triangles as text have some 1.3 GB."""
MESHES_KEPT = 256
"""Meshes held in memory by each process; beyond that the oldest is dropped."""
PACKED = {b"\x1f\x8b": "gzip", b"PK\x03\x04": "zip", b"BZh": "bzip2", b"\xfd7zX": "xz", b"\x28\xb5\x2f\xfd": "zstd"}
"""First bytes of a file → the program that packed it."""


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
    except (OSError, ValueError) as error:
        # A ValueError for a null character, which no path has.
        raise BadMesh(f"cannot be read ({getattr(error, 'strerror', None) or error})") from None
    key = (str(path.resolve()), state.st_mtime_ns, state.st_size, options)
    if key not in _cache:
        if len(_cache) >= MESHES_KEPT:
            del _cache[next(iter(_cache))]
        _cache[key] = _unit(path, options)
    return _cache[key]


def read_mesh(path: Path) -> MeshFile:
    """The surface of a mesh file, in its own coordinates, or, where its format fixes another axis than z as up,
    turned about x until z is up. Raises `BadMesh`."""
    if not os.path.isfile(path):
        raise BadMesh("cannot be read (no such file)")
    mesh = _mesh_file_of(path, MeshOptions())
    if not np.isfinite(mesh.vertices).all():
        raise BadMesh("has vertices that are not finite; export it again")
    up = upward_axis(path)
    return mesh if up == "z" else replace(mesh, vertices=mesh.vertices @ _upright(up, FRONTS[up]).T)


def _unit(path: Path, options: MeshOptions) -> tuple[Solid, str]:
    mesh = _mesh_file_of(path, options)
    vertices, faces = cleaned(mesh.vertices, mesh.triangles)
    _check_steps(vertices)
    if options.max_triangles is not None and len(faces) > options.max_triangles:
        vertices, faces = cleaned(*simplified(vertices, faces, options.max_triangles))
    up = options.up or upward_axis(path)
    if options.front is not None and options.front[-1] == up[-1]:
        raise BadMesh(f"has {up} as its upward axis, and front = {options.front} must lie across it; set another")
    vertices = vertices @ _upright(up, options.front or FRONTS[up]).T
    low, high = vertices.min(axis=0), vertices.max(axis=0)
    if not high[2] - low[2] > 1e-9 * float((high - low).max()):
        across = ", ".join(axis for axis in "xyz" if axis != up[-1])
        raise BadMesh(
            f"is flat along its upward axis {up}, so it has no height to scale; set another `up` ({across})"
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


def _mesh_file_of(path: Path, options: MeshOptions) -> MeshFile:
    """All triangles of a file, the transforms of its scene graph applied."""
    suffix = path.suffix.lower()
    if suffix not in SUFFIXES:
        raise BadMesh(f"is no mesh file that is known; convert it to one of {' '.join(SUFFIXES)}")
    if not os.path.isfile(path):
        raise BadMesh("is no plain file; name a mesh file")
    _check_content(path)
    try:
        _check_count(_triangles_told(path), options)
        with np.errstate(all="ignore"):
            match suffix:
                case ".glb":
                    glb = read_glb(path)
                    _check_count(glb.triangles(), options)
                    mesh = glb.surface()
                case ".stl":
                    mesh = read_stl(path)
                case _:
                    mesh = _of_polygons(path, options)
    except BadMesh:
        raise
    except MemoryError:
        raise BadMesh("does not fit into memory; thin it in a mesh editor") from None
    except Exception as error:
        # Whatever a parser stumbles over in a broken file is the file's fault, and its message the best there is.
        reason = " ".join(str(error).split())[:120] or type(error).__name__
        raise BadMesh(f"cannot be parsed ({reason}); export it again as one of {' '.join(SUFFIXES)}") from None
    if not len(mesh.triangles):
        if len(mesh.vertices):
            raise BadMesh("is a point cloud or holds only lines, and has no triangles; reconstruct a surface first")
        raise BadMesh("holds no triangles, or is cut short; export a surface mesh again")
    if mesh.triangles.min() < 0 or mesh.triangles.max() >= len(mesh.vertices):
        raise BadMesh(f"names vertices that it does not hold (1 … {len(mesh.vertices)} exist); export it again")
    return mesh


def _check_content(path: Path) -> None:
    """Raise `BadMesh` for a file that is empty, too large or packed, whatever its format."""
    size = path.stat().st_size
    if size == 0:
        raise BadMesh("is empty (0 bytes); export it again")
    if size > MOST_BYTES:
        raise BadMesh(f"has {size} bytes, and at most {MOST_BYTES} are read; thin it in a mesh editor")
    with path.open("rb") as file:
        start = file.read(4)
    for mark, program in PACKED.items():
        if start.startswith(mark):
            raise BadMesh(f"is packed by {program}; unpack it first")


def _of_polygons(path: Path, options: MeshOptions) -> MeshFile:
    """The surface of a file whose faces may have any number of corners."""
    faces = POLYGONS[path.suffix.lower()](path)
    _check_count(int(np.maximum(faces.counts - 2, 0).sum()), options)
    triangles, bent = faces.triangles()
    doubt = (
        f"{bent} of {len(faces.counts)} faces have more than three corners and lie off a plane by more than "
        f"{BENT:.0%} of their size, and the file does not say how they bend; triangulate them in a "
        "mesh editor if it matters"
    )
    return MeshFile(faces.vertices, triangles, doubt if bent else "")


def _check_count(count: int, options: MeshOptions) -> None:
    """Raise `BadMesh` for more triangles than can be handled, before they are read."""
    most = MOST_TRIANGLES if options.max_triangles is None else MOST_THINNED
    if count > most:
        thin = "set max_triangles, such as 20000, or " if count <= MOST_THINNED else ""
        raise BadMesh(f"has {count} triangles, and at most {most} are handled; {thin}thin it in a mesh editor")


def _triangles_told(path: Path) -> int:
    """At least how many triangles a file holds, by its header, its size, or the marks of its text; 0 if unclear."""
    with path.open("rb") as file:
        start = file.read(2**16)
        match path.suffix.lower():
            case ".glb":
                return 0
            case ".ply":
                told = re.search(rb"element[ \t]+face[ \t]+(\d+)", start.partition(b"end_header")[0])
                return int(told[1]) if told else 0
            case ".stl":
                count = count_by_size(start[:HEADER_BYTES], path.stat().st_size)
                if count is not None:
                    return count
        mark = b"\nf " if path.suffix.lower() == ".obj" else b"endfacet"
        return start.count(mark) + sum(piece.count(mark) for piece in iter(lambda: file.read(2**24), b""))


def cleaned(vertices: Floats, faces: NDArray[np.int64]) -> tuple[Floats, NDArray[np.int64]]:
    """Merge vertices that coincide; drop triangles without area, repeated triangles and unused vertices."""
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
