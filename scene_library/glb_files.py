"""GLB files (glTF 2.0): the triangles of the scene that a file shows when it is opened, at rest.

Read here and not by trimesh, which leaves out sparse values, morph targets, skins, instances and the scale of
normalized integers without a word, and opens whatever file a buffer names. The JSON alone decides what is read: all
of glTF's own geometry, and the extensions `APPLIED`. What else may change the shape is refused by its name, or, where
the file lets readers leave it out, told in a line.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from scene_library.arrays import Floats
from scene_library.gltf_values import (
    COMPRESSED,
    FLOAT,
    INDICES,
    SMALL_OR_FLOAT,
    UNSIGNED_BYTE,
    UNSIGNED_SHORT,
    Gltf,
    Ints,
    Json,
    extension,
    not_read,
    read_gltf,
    whole,
)
from scene_library.mesh_file import BadMesh, MeshFile

INSTANCES, VISIBILITY, LEVELS = "EXT_mesh_gpu_instancing", "KHR_node_visibility", "MSFT_lod"
APPLIED = (INSTANCES, VISIBILITY, LEVELS, "KHR_mesh_quantization")
"""Extensions that decide about the surface, and are read."""
HARMLESS = frozenset({
    "KHR_animation_pointer", "KHR_gaussian_splatting", "KHR_implicit_shapes", "KHR_interactivity",
    "KHR_node_hoverability", "KHR_node_selectability", "KHR_physics_rigid_bodies", "KHR_xmp", "KHR_xmp_json_ld",
    "EXT_instance_features", "EXT_mesh_features", "EXT_mesh_manifold", "EXT_structural_metadata",
    "ADOBE_materials_clearcoat_specular", "ADOBE_materials_clearcoat_tint",
    "ADOBE_materials_thin_transparency", "AGI_stk_metadata", "CESIUM_primitive_outline", "FB_geometry_metadata",
    "GODOT_single_root", "GRIFFEL_bim_data", "NV_materials_mdl", "VRM", "VRMC_materials_mtoon", "VRMC_springBone",
    "VRMC_vrm",
})  # fmt: skip
HARMLESS_BEGINNINGS = (
    "KHR_audio_", "KHR_lights_", "KHR_materials_", "KHR_texture_", "EXT_lights_", "EXT_texture_", "MSFT_packing_",
    "MSFT_texture_",
)  # fmt: skip
"""Extensions of these names, and those in `HARMLESS`, are about looks, sounds, notes, and what happens later: the
surface at rest is the same without them."""
MOST_PARTS = 100_000
"""Nodes, primitives and morph targets, each as often as it is read: as many nodes take three seconds, as many
primitives ten."""
_TRIANGLES, _STRIP, _FAN = 4, 5, 6
"""Modes of primitives that are surfaces; 0 … 3 are points and lines."""
_APPLY = "apply its armature and shape keys in a mesh editor"


@dataclass(frozen=True)
class _Piece:
    """Triangles of a primitive: vertices (m, 3) and faces (f, 3)."""

    vertices: Floats
    faces: Ints

    def placed(self, matrices: Floats) -> _Piece:
        """All its instances, by their matrices (k, 4, 4); mirrored ones are wound the other way, to face outwards."""
        vertices = self.vertices @ matrices[:, :3, :3].transpose(0, 2, 1) + matrices[:, None, :3, 3]
        faces = self.faces + len(self.vertices) * np.arange(len(matrices))[:, None, None]
        is_mirrored = np.linalg.det(matrices[:, :3, :3]) < 0
        faces[is_mirrored] = faces[is_mirrored][:, :, ::-1]
        return _Piece(vertices.reshape(-1, 3), faces.reshape(-1, 3))


@dataclass
class GlbFile:
    """The scene of a GLB file.

    Attributes
    ----------
    places : node → (4, 4) its place in the scene.
    shown : nodes that show a mesh.
    parts : how many parts were read so far, at most `MOST_PARTS`.
    doubts : lines about what the file leaves open.
    """

    gltf: Gltf
    places: dict[int, Floats] = field(default_factory=dict)
    shown: list[int] = field(default_factory=list)
    parts: int = 0
    doubts: dict[str, str] = field(default_factory=dict)
    _sizes: dict[int, int] = field(default_factory=dict)

    def triangles(self) -> int:
        """How many triangles the scene has, by the JSON: each mesh as often as it is shown."""
        nodes = (self.gltf.one("nodes", number) for number in self.shown)
        return sum(size * self._instances(node) for node in nodes if (size := self._size_of_mesh(node["mesh"])))

    def surface(self) -> MeshFile:
        """The surface of the scene. Raises `BadMesh` for what is not read, by its name, and errors of a parser for a
        damaged file."""
        instances: dict[tuple[int, tuple[float, ...], int | None], list[Floats]] = {}
        for number in self.shown:
            node = self.gltf.one("nodes", number)
            mesh = self.gltf.one("meshes", node["mesh"])
            self._note_extensions(node, f"node {number}")
            self._note_extensions(mesh, f"mesh {node['mesh']}")
            if self._size_of_mesh(node["mesh"]):
                weights = tuple(float(weight) for weight in node.get("weights", mesh.get("weights")) or ())
                key = node["mesh"], weights, node.get("skin")
                instances.setdefault(key, []).append(self._matrices(node, number))
        if not instances:
            raise self._nothing()
        whole_surface = _joined_piece([self._mesh(*key).placed(np.concatenate(of)) for key, of in instances.items()])
        return MeshFile(whole_surface.vertices, whole_surface.faces, "; ".join(self.doubts.values()))

    def find_nodes(self) -> None:
        """Fill in `places` and `shown`. Raises `BadMesh` for nodes of several parents, whose number could double from
        level to level."""
        nodes = self.gltf.all("nodes")
        parents = Counter(child for node in nodes for child in node.get("children", []))
        roots = self._roots(parents)
        parents.update(roots)
        for number, count in parents.most_common(1):
            if count > 1:
                raise BadMesh(f"has a node ({number}) with {count} parents, and glTF allows one; export it again")
        coarse = {number for node in nodes for number in extension(node, LEVELS).get("ids", [])}
        ahead: list[tuple[Any, int | None, bool]] = [(number, None, True) for number in reversed(roots)]
        order: list[tuple[int, int | None]] = []
        while ahead:
            number, above, is_visible = ahead.pop()
            node = self.gltf.one("nodes", number)
            self._count_parts(1)
            order.append((number, above))
            # What is hidden at rest, and what stands in for a node that is far away, is no part of the surface.
            is_visible = is_visible and extension(node, VISIBILITY).get("visible", True) and number not in coarse
            if is_visible and "mesh" in node:
                self.shown.append(number)
            ahead += [(child, number, is_visible) for child in reversed(node.get("children", []))]
        within = _matrices_of([(number, nodes[number]) for number, _ in order])
        for (number, above), matrix in zip(order, within, strict=True):
            self.places[number] = matrix if above is None else self.places[above] @ matrix

    def _roots(self, parents: Counter[Any]) -> list[int]:
        """The nodes at which the scene begins: that of the key `scene`, or the only one; nodes outside of it are not
        shown."""
        scenes = self.gltf.all("scenes")
        if not scenes:
            return [number for number in range(len(self.gltf.all("nodes"))) if number not in parents]
        if "scene" not in self.gltf.tree and len(scenes) > 1:
            self.doubts["scenes"] = f"has {len(scenes)} scenes and does not say which one is meant: the first is read"
        return list(self.gltf.one("scenes", self.gltf.tree.get("scene", 0)).get("nodes", []))

    def _nothing(self) -> BadMesh:
        """Why there are no triangles."""
        if not self.shown:
            where = "all are hidden, or stand outside of it" if self.gltf.all("meshes") else "the file has none"
            return BadMesh(f"shows no mesh in its scene ({where}); export what is to be seen")
        numbers = {self.gltf.one("nodes", number)["mesh"] for number in self.shown}
        if any(p.get("mode", _TRIANGLES) < _TRIANGLES for number in numbers for p in self._primitives(number)):
            return BadMesh("is a point cloud or holds only lines, and has no triangles; reconstruct a surface first")
        return BadMesh("holds no triangles; export a surface mesh again")

    def _count_parts(self, more: int) -> None:
        self.parts += more
        if self.parts > MOST_PARTS:
            raise BadMesh(f"has more than {MOST_PARTS} nodes and parts of meshes; join them in a mesh editor")

    def _note_extensions(self, of: Json, where: str) -> None:
        """Note extensions that might change the shape, and that the file lets readers leave out."""
        for name in of.get("extensions", {}):
            if not _is_known(name) and name not in COMPRESSED and len(self.doubts) < 5:
                self.doubts.setdefault(
                    name, f"has the glTF extension {name[:60]} ({where}), which is left out, as the file allows"
                )

    def _primitives(self, mesh: Any) -> list[Json]:
        found: list[Json] = self.gltf.one("meshes", mesh)["primitives"]
        return found

    def _size(self, primitive: Json) -> int:
        """Number of triangles of a primitive."""
        numbers = primitive.get("indices"), primitive["attributes"].get("POSITION")
        mode = whole(primitive, "mode", _TRIANGLES)
        if mode > _FAN:
            raise ValueError(f"a primitive of mode {mode}")
        # Without places there is nothing to show.
        if mode < _TRIANGLES or numbers[1] is None:
            return 0
        count = whole(self.gltf.one("accessors", next(n for n in numbers if n is not None)), "count")
        return count // 3 if mode == _TRIANGLES else max(count - 2, 0)

    def _size_of_mesh(self, mesh: Any) -> int:
        """Number of triangles of a mesh."""
        if mesh not in self._sizes:
            self._sizes[mesh] = sum(map(self._size, self._primitives(mesh)))
        return self._sizes[mesh]

    def _mesh(self, mesh: int, weights: tuple[float, ...], skin: int | None) -> _Piece:
        """The triangles of a mesh."""
        return _joined_piece([self._piece(one, weights, skin) for one in self._primitives(mesh) if self._size(one)])

    def _piece(self, primitive: Json, weights: tuple[float, ...], skin: Any) -> _Piece:
        """The triangles of a primitive, morph targets and skin applied."""
        self._note_extensions(primitive, "a primitive")
        attributes, targets = primitive["attributes"], primitive.get("targets", [])
        self._count_parts(1 + len(targets))
        self._check_values(primitive)
        positions = self.gltf.values(attributes["POSITION"], "VEC3", SMALL_OR_FLOAT)
        order = self._order(primitive, len(positions))
        used, faces = np.unique(_faces(order, primitive.get("mode", _TRIANGLES)), return_inverse=True)
        vertices, faces = positions.rows(used), faces.reshape(-1, 3)
        if any(weights) and len(weights) != len(targets):
            raise BadMesh(f"has {len(weights)} weights for {len(targets)} morph targets; {_APPLY}")
        for weight, target in zip(weights, targets, strict=False):
            if weight and "POSITION" in target:
                moves = self.gltf.values(target["POSITION"], "VEC3", SMALL_OR_FLOAT)
                if len(moves) != len(positions):
                    raise ValueError(f"a morph target of {len(moves)} of {len(positions)} vertices")
                vertices = vertices + weight * moves.rows(used)
        if skin is not None:
            blended = self._blended(attributes, self.gltf.one("skins", skin), used)
            vertices = np.einsum("vij,vj->vi", blended[:, :, :3], vertices) + blended[:, :, 3]
            is_mirrored = np.linalg.det(blended[:, :, :3])[faces[:, 0]] < 0
            faces[is_mirrored] = faces[is_mirrored][:, ::-1]
        return _Piece(vertices, faces)

    def _check_values(self, primitive: Json) -> None:
        """Raise `BadMesh` for numbers that are in an extension only."""
        for number in (primitive["attributes"]["POSITION"], primitive.get("indices")):
            if number is None:
                continue
            accessor = self.gltf.one("accessors", number)
            self._note_extensions(accessor, f"accessor {number}")
            if "bufferView" in accessor:
                self._note_extensions(self.gltf.one("bufferViews", accessor["bufferView"]), "a buffer view")
            elif "sparse" not in accessor:
                for name in primitive.get("extensions", {}):
                    if not _is_known(name):
                        raise not_read(name)
                raise BadMesh(f"has a surface whose numbers are missing (accessor {number}); export it again")

    def _order(self, primitive: Json, count: int) -> Ints:
        """(n,) the vertices of a primitive in its order."""
        if "indices" not in primitive:
            return np.arange(count)
        indices = self.gltf.values(primitive["indices"], "SCALAR", INDICES)
        last, order = indices.largest, indices.rows(of=np.int64)[:, 0]
        if (order == last).any():
            raise BadMesh(
                f"has the index {last}, which restarts a strip (primitive restart), as glTF 2.0 does not allow; "
                "export plain triangles"
            )
        if (order >= count).any():
            raise BadMesh(f"names vertices that it does not hold ({count} exist, numbered from 0); export it again")
        return order

    def _blended(self, attributes: Json, skin: Json, used: Ints) -> Floats:
        """(m, 3, 4) transforms of vertices: those of the joints of a skin, by their weights. The place of the node
        that has the skin is of no account."""
        joints = skin["joints"]
        outside = [joint for joint in joints if joint not in self.places]
        if outside:
            raise BadMesh(f"has a skin with a joint (node {outside[0]}) outside of the scene; {_APPLY}")
        matrices = np.stack([self.places[joint] for joint in joints])
        if "inverseBindMatrices" in skin:
            back = self.gltf.values(skin["inverseBindMatrices"], "MAT4", (FLOAT,))
            # Matrices are stored by columns.
            matrices = matrices @ back.rows(np.arange(len(joints))).reshape(-1, 4, 4).transpose(0, 2, 1)
        blended, total = np.zeros((len(used), 3, 4)), np.zeros(len(used))
        for number in range(len(attributes)):
            if f"JOINTS_{number}" not in attributes:
                break
            of = self.gltf.values(attributes[f"JOINTS_{number}"], "VEC4", (UNSIGNED_BYTE, UNSIGNED_SHORT)).rows(used)
            weights = self.gltf.values(attributes[f"WEIGHTS_{number}"], "VEC4", SMALL_OR_FLOAT).rows(used)
            # Joints without weight may be any.
            of = np.where(weights > 0, of, 0).astype(np.int64)
            for k in range(4):
                blended += weights[:, k, None, None] * matrices[of[:, k], :3]
                total += weights[:, k]
        if not (total > 0).all():
            raise BadMesh(f"has a skin and {np.count_nonzero(~(total > 0))} vertices that no joint moves; {_APPLY}")
        return np.asarray(blended / total[:, None, None])

    def _instances(self, node: Json) -> int:
        """How often a node shows its mesh."""
        attributes = extension(node, INSTANCES).get("attributes", {})
        counts = {whole(self.gltf.one("accessors", number), "count") for number in attributes.values()}
        if len(counts) > 1:
            raise ValueError(f"instances that are {' and '.join(map(str, sorted(counts)))}")
        return counts.pop() if counts else 1

    def _matrices(self, node: Json, number: int) -> Floats:
        """(k, 4, 4) places of the mesh of a node."""
        attributes = extension(node, INSTANCES).get("attributes", {})
        if "skin" in node:
            if attributes:
                raise BadMesh(f"has instances ({INSTANCES}) of a mesh with a skin, which are not read; {_APPLY}")
            return np.eye(4)[None]
        if not attributes:
            return self.places[number][None]
        count = self._instances(node)
        moves, turns, scales = (
            self.gltf.values(attributes[name], kind, SMALL_OR_FLOAT).rows() if name in attributes
            else np.tile(np.array(default), (count, 1))
            for name, kind, default in (
                ("TRANSLATION", "VEC3", [0.0] * 3), ("ROTATION", "VEC4", [0.0, 0.0, 0.0, 1.0]),
                ("SCALE", "VEC3", [1.0] * 3),
            )
        )  # fmt: skip
        return np.asarray(self.places[number] @ _transforms(moves, turns, scales))


def read_glb(path: Path) -> GlbFile:
    """A GLB file whose nodes are known, and whose triangles can be counted before they are read.

    Raises `BadMesh` for an extension that the file needs and that is not read, and for other files to open.
    """
    gltf = read_gltf(path.read_bytes())
    for name in gltf.tree.get("extensionsRequired", []):
        if not _is_known(str(name)):
            raise not_read(str(name))
    found = GlbFile(gltf)
    found.find_nodes()
    return found


def _joined_piece(pieces: list[_Piece]) -> _Piece:
    """Some pieces as one."""
    sizes = np.cumsum([0, *(len(piece.vertices) for piece in pieces)])
    return _Piece(
        np.concatenate([piece.vertices for piece in pieces]),
        np.concatenate([piece.faces + offset for piece, offset in zip(pieces, sizes, strict=False)]),
    )


def _is_known(name: str) -> bool:
    return name in APPLIED or name in HARMLESS or name.startswith(HARMLESS_BEGINNINGS)


def _faces(order: Ints, mode: int) -> Ints:
    """(f, 3) triangles of vertices in their order; what is left over at its end is none."""
    if mode == _TRIANGLES:
        return order[: len(order) // 3 * 3].reshape(-1, 3)
    k = np.arange(len(order) - 2)
    if mode == _FAN:
        return np.stack([np.broadcast_to(order[:1], k.shape), order[k + 1], order[k + 2]], axis=1)
    # Every second triangle of a strip runs the other way round.
    return np.stack([order[k], order[k + 1 + k % 2], order[k + 2 - k % 2]], axis=1)


def _matrices_of(nodes: list[tuple[int, Json]]) -> Floats:
    """(n, 4, 4) places of nodes, given with their numbers, in those above them."""
    if not nodes:
        return np.empty((0, 4, 4))
    steps = (("translation", (0, 0, 0)), ("rotation", (0, 0, 0, 1)), ("scale", (1, 1, 1)))
    moves, turns, scales = (
        np.array([node.get(key, default) for _, node in nodes], np.float64).reshape(len(nodes), -1)
        for key, default in steps
    )
    found = _transforms(moves, turns, scales)
    for at, (number, node) in enumerate(nodes):
        if "matrix" in node:
            # Matrices are stored by columns.
            found[at] = np.array(node["matrix"], np.float64).reshape(4, 4).T
            if not np.array_equal(found[at, 3], [0, 0, 0, 1]) or any(key in node for key, _ in steps):
                raise BadMesh(f"has a node ({number}) with two places or a distorted one; apply its transforms")
    return found


def _transforms(moves: Floats, turns: Floats, scales: Floats) -> Floats:
    """(k, 4, 4) transforms: scale, turn by a unit quaternion x, y, z, w, and move."""
    lengths = np.linalg.norm(turns, axis=1, keepdims=True)
    if (np.abs(lengths - 1) > 0.02).any():
        raise BadMesh("has a rotation that is no unit quaternion; apply its transforms in a mesh editor")
    x, y, z, w = (turns / lengths).T
    turn = np.array([
        [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
        [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
        [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
    ])  # fmt: skip
    found = np.tile(np.eye(4), (len(moves), 1, 1))
    found[:, :3, :3] = turn.transpose(2, 0, 1) * scales[:, None, :]
    found[:, :3, 3] = moves
    return found
