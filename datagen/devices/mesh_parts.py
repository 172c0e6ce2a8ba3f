"""Mesh files of what stood before a sensor, divided into parts of one material each."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from warnings import warn

import numpy as np

from datagen.devices.surfaces import UNIT
from datagen.errors import InputError, InputWarning
from datagen.records import Lambertian, Part
from datagen.records.checks import as_paths, option
from scene_library.mesh_file import BadMesh
from scene_library.meshes import read_mesh

CONCAVE_RAD = 0.1
"""Angle of a concave edge from which it divides a mesh into parts; flatter ones are taken for curved surfaces."""
MOST_PARTS = 8
"""Pieces of a mesh that get albedos of their own. A mesh of more is one part: nine zones tell few albedos apart."""


def read_parts(paths: Sequence[str | Path]) -> list[Part]:
    """The parts of mesh files in metres, in the coordinates of the poses: their albedos are fitted one by one.

    A file is divided at its concave edges, where surfaces usually change (a thing on a table), as far as these cut it
    into pieces. A `.glb`, whose y is up, is turned about x until z is up. Raises `InputError` for a file that
    cannot be read.
    """
    # Here, because it takes half a second, and every command that makes a scene imports this module.
    import trimesh

    parts = []
    for path in as_paths(option("paths"), paths, "name mesh files"):
        try:
            mesh_file = read_mesh(path)
        except BadMesh as error:
            raise InputError(f"{path}: {error}") from None
        if mesh_file.doubt:
            warn(f"{path}: {mesh_file.doubt}", InputWarning, stacklevel=2)
        whole = trimesh.Trimesh(mesh_file.vertices, mesh_file.triangles, process=True)
        joined = whole.face_adjacency_convex | (whole.face_adjacency_angles < CONCAVE_RAD)
        pieces = trimesh.graph.connected_components(
            whole.face_adjacency[joined], nodes=np.arange(len(whole.faces)), min_len=1
        )
        pieces = sorted(pieces, key=lambda piece: -float(whole.area_faces[piece].sum()))
        if len(pieces) > MOST_PARTS:
            pieces = [np.arange(len(whole.faces))]
        for number, piece in enumerate(pieces):
            name = path.stem if len(pieces) == 1 else f"{path.stem} {number}"
            mesh = trimesh.Trimesh(whole.vertices, whole.faces[piece], process=False)
            parts.append(Part(name, mesh, Lambertian(UNIT), "object"))
    names = [part.name for part in parts]
    if len(set(names)) < len(names):
        raise InputError(f"{option('paths')}: {', '.join(names)}: two files give parts of one name; rename a file")
    return parts
