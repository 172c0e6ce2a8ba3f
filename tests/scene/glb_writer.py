"""GLB files by hand: one solid, a slab with a tower at its end, in the many ways that glTF 2.0 can say it."""

from __future__ import annotations

import base64
import json
import struct
from collections.abc import Callable
from pathlib import Path
from typing import Any
from urllib.parse import quote_from_bytes

import numpy as np
import trimesh

Tree = dict[str, Any]
Solid = tuple[np.ndarray, np.ndarray]
"""Vertices, y up, and triangles."""


def box(size: tuple[float, float, float], at: tuple[float, float, float]) -> Solid:
    made = trimesh.creation.box(size).apply_translation(at)
    return np.asarray(made.vertices, np.float32), np.asarray(made.faces)


SLAB, TOWER = box((2, 0.4, 1), (0, 0.2, 0)), box((0.4, 1.6, 0.4), (0.8, 1.2, 0))
AREA, VOLUME = 9.28, 1.056
Z_UP_BOUNDS = [[-1.0, -0.5, 0.0], [1.0, 0.5, 2.0]]
TYPES = {"<i1": 5120, "<u1": 5121, "<i2": 5122, "<u2": 5123, "<u4": 5125, "<f4": 5126}


class Glb:
    """A file that grows by accessors, meshes and nodes."""

    def __init__(self) -> None:
        self.blob = b""
        self.tree: Tree = {"asset": {"version": "2.0"}, "scene": 0, "scenes": [{"nodes": []}]}

    def add(self, kind: str, thing: Tree) -> int:
        self.tree.setdefault(kind, []).append(thing)
        return len(self.tree[kind]) - 1

    def view(self, data: bytes, **keys: Any) -> int:
        self.blob += b"\0" * (-len(self.blob) % 4)
        place = {"buffer": 0, "byteOffset": len(self.blob), "byteLength": len(data)}
        self.blob += data
        return self.add("bufferViews", place | keys)

    def numbers(self, values: np.ndarray, dtype: str, kind: str = "VEC3", **keys: Any) -> int:
        view = self.view(values.astype(dtype).tobytes())
        return self.add("accessors", {
            "bufferView": view, "componentType": TYPES[dtype], "count": len(values), "type": kind,
        } | keys)  # fmt: skip

    def primitive(self, solid: Solid, index_type: str = "<u2", **keys: Any) -> Tree:
        vertices, faces = solid
        return {
            "attributes": {"POSITION": self.numbers(vertices, "<f4")},
            "indices": self.numbers(faces.reshape(-1), index_type, "SCALAR"),
        } | keys  # fmt: skip

    def mesh(self, *primitives: Tree, **keys: Any) -> int:
        return self.add("meshes", {"primitives": list(primitives)} | keys)

    def node(self, is_root: bool = True, **keys: Any) -> int:
        number = self.add("nodes", keys)
        if is_root:
            self.tree["scenes"][0]["nodes"].append(number)
        return number

    def show(self, *solids: Solid) -> None:
        for solid in solids:
            self.node(mesh=self.mesh(self.primitive(solid)))

    def needs(self, *names: str, **keys: Any) -> None:
        self.tree |= {"extensionsUsed": list(names), "extensionsRequired": list(names)} | keys

    def write(self, path: Path) -> Path:
        self.blob += b"\0" * (-len(self.blob) % 4)
        self.tree.setdefault("buffers", [{"byteLength": len(self.blob)}])
        text = json.dumps(self.tree).encode()
        text += b" " * (-len(text) % 4)
        parts = struct.pack("<I4s", len(text), b"JSON") + text
        if self.blob:
            parts += struct.pack("<I4s", len(self.blob), b"BIN\0") + self.blob
        path.write_bytes(b"glTF" + struct.pack("<II", 2, 12 + len(parts)) + parts)
        return path


Write = Callable[[Glb], None]
READ: dict[str, Write] = {}
"""Kind → what writes the solid that way."""
REFUSED: dict[str, tuple[str, Write]] = {}
"""Kind → a word of the refusal, and what writes the file."""


def read(write: Write) -> Write:
    READ[write.__name__] = write
    return write


def refused(word: str) -> Callable[[Write], Write]:
    def kept(write: Write) -> Write:
        REFUSED[write.__name__] = word, write
        return write

    return kept


@read
def plain(glb: Glb) -> None:
    glb.show(SLAB, TOWER)


@read
def indices_of_one_byte_and_of_four(glb: Glb) -> None:
    glb.node(mesh=glb.mesh(glb.primitive(SLAB, "<u1"), glb.primitive(TOWER, "<u4")))


@read
def without_indices(glb: Glb) -> None:
    for vertices, faces in (SLAB, TOWER):
        soup = vertices[faces].reshape(-1, 3)
        glb.node(mesh=glb.mesh({"attributes": {"POSITION": glb.numbers(soup, "<f4")}}))


def in_mode(glb: Glb, mode: int) -> None:
    """Each triangle on its own, and the four sides of the tower at once."""
    v, n = TOWER[0].copy(), np.asarray(trimesh.Trimesh(*TOWER).face_normals)
    upright = np.flatnonzero(np.abs(n[:, 1]) < 0.5)
    low = [np.flatnonzero((v == corner).all(axis=1))[0] for corner in np.array(
        [[0.6, 0.4, -0.2], [0.6, 0.4, 0.2], [1.0, 0.4, 0.2], [1.0, 0.4, -0.2]], np.float32)]  # fmt: skip
    high = [np.flatnonzero((v == v[k] + np.float32([0, 1.6, 0])).all(axis=1))[0] for k in low]
    assert len(upright) == 8
    around = [k for pair in zip(high, low, strict=True) for k in pair] + [high[0], low[0]]
    at = glb.numbers(v, "<f4")
    lids = [
        at_mode(glb, at, [high[0], high[1], high[2], high[3]], 6),
        at_mode(glb, at, [low[3], low[2], low[1], low[0]], 6),
    ]
    sides = [at_mode(glb, at, around, 5)]
    if mode == 6:
        corners = [[low[k], low[(k + 1) % 4], high[(k + 1) % 4], high[k]] for k in range(4)]
        sides = [at_mode(glb, at, four, 6) for four in corners]
    slab_at = glb.numbers(SLAB[0], "<f4")
    glb.node(mesh=glb.mesh(*lids, *sides, *(at_mode(glb, slab_at, list(face), mode) for face in SLAB[1])))


def at_mode(glb: Glb, at: int, order: list[int], mode: int) -> Tree:
    return {"attributes": {"POSITION": at}, "indices": glb.numbers(np.array(order), "<u2", "SCALAR"), "mode": mode}


@read
def strips(glb: Glb) -> None:
    in_mode(glb, 5)


@read
def fans(glb: Glb) -> None:
    in_mode(glb, 6)


@read
def points_and_lines_beside(glb: Glb) -> None:
    """They bring no surface."""
    far = np.array([[50, 0, 0], [60, 0, 0], [50, 9, 0]], np.float32)
    extra = [{"attributes": {"POSITION": glb.numbers(far, "<f4")}, "mode": mode} for mode in (0, 1, 2, 3)]
    glb.node(mesh=glb.mesh(glb.primitive(SLAB), *extra, glb.primitive(TOWER)))


@read
def interleaved(glb: Glb) -> None:
    for vertices, faces in (SLAB, TOWER):
        rows = np.hstack([np.tile(np.float32([0, 1, 0]), (len(vertices), 1)), vertices]).astype("<f4")
        accessor = {"bufferView": glb.view(rows.tobytes(), byteStride=24), "byteOffset": 12, "componentType": 5126}
        at = glb.add("accessors", accessor | {"count": len(vertices), "type": "VEC3"})
        order = glb.numbers(faces.reshape(-1), "<u2", "SCALAR")
        glb.node(mesh=glb.mesh({"attributes": {"POSITION": at}, "indices": order}))


@read
def one_accessor_for_both(glb: Glb) -> None:
    at = glb.numbers(np.concatenate([SLAB[0], TOWER[0]]), "<f4")
    glb.node(mesh=glb.mesh(*(
        {"attributes": {"POSITION": at}, "indices": glb.numbers(faces.reshape(-1) + more, "<u2", "SCALAR")}
        for faces, more in ((SLAB[1], 0), (TOWER[1], len(SLAB[0])))
    )))  # fmt: skip


def quantized(glb: Glb, dtype: str, is_normalized: bool) -> None:
    most = np.iinfo(dtype).max
    for vertices, faces in (SLAB, TOWER):
        low, high = vertices.min(axis=0), vertices.max(axis=0)
        middle = (low + high) / 2 if dtype[1] == "i" else low
        size = float(np.abs(vertices - middle).max())
        rows = np.round((vertices - middle) / size * most).astype(dtype)
        # Rows begin at multiples of four bytes.
        step = -(-rows.dtype.itemsize * 3 // 4) * 4
        data = np.zeros((len(rows), step // rows.dtype.itemsize), dtype)
        data[:, :3] = rows
        accessor = {"bufferView": glb.view(data.tobytes(), byteStride=step), "componentType": TYPES[dtype]}
        accessor |= {"count": len(rows), "type": "VEC3", "normalized": is_normalized}
        order = glb.numbers(faces.reshape(-1), "<u2", "SCALAR")
        mesh = glb.mesh({"attributes": {"POSITION": glb.add("accessors", accessor)}, "indices": order})
        scale = size if is_normalized else size / most
        glb.node(mesh=mesh, translation=middle.tolist(), scale=[scale] * 3)
    glb.needs("KHR_mesh_quantization")


for _type in ("<i1", "<u1", "<i2", "<u2"):
    for _is_normalized in (False, True):
        READ[f"quantized {_type[1:]}{' normalized' * _is_normalized}"] = (
            lambda glb, dtype=_type, is_normalized=_is_normalized: quantized(glb, dtype, is_normalized)
        )


def short_tower() -> Solid:
    low = TOWER[0].copy()
    low[:, 1] = np.minimum(low[:, 1], 0.5)
    return low, TOWER[1]


@read
def sparse(glb: Glb) -> None:
    part = glb.primitive(short_tower())
    rows = np.flatnonzero(TOWER[0][:, 1] > 0.5)
    glb.tree["accessors"][part["attributes"]["POSITION"]]["sparse"] = {
        "count": len(rows), "indices": {"bufferView": glb.view(rows.astype("<u2").tobytes()), "componentType": 5123},
        "values": {"bufferView": glb.view(TOWER[0][rows].astype("<f4").tobytes())},
    }  # fmt: skip
    glb.node(mesh=glb.mesh(glb.primitive(SLAB), part))


@read
def sparse_alone(glb: Glb) -> None:
    """Without values to begin with, which are zeros then."""
    part, n = glb.primitive(TOWER), len(TOWER[0])
    glb.tree["accessors"][part["attributes"]["POSITION"]] = {
        "componentType": 5126, "count": n, "type": "VEC3", "sparse": {
            "count": n, "indices": {"bufferView": glb.view(bytes(range(n))), "componentType": 5121},
            "values": {"bufferView": glb.view(TOWER[0].astype("<f4").tobytes())},
        },
    }  # fmt: skip
    glb.node(mesh=glb.mesh(glb.primitive(SLAB), part))


def morphed(glb: Glb, of_mesh: list[float], of_node: list[float] | None, is_short: bool = True) -> None:
    """A tower that its second target makes tall if `is_short`, and the first one wide."""
    base = short_tower() if is_short else TOWER
    wide = glb.numbers(base[0] * 9, "<f4")
    tall = glb.numbers(TOWER[0] - short_tower()[0], "<f4")
    part = glb.primitive(base, targets=[{"POSITION": wide}, {"POSITION": tall}])
    glb.show(SLAB)
    glb.node(mesh=glb.mesh(part, weights=of_mesh), **({} if of_node is None else {"weights": of_node}))


@read
def morph_weights(glb: Glb) -> None:
    morphed(glb, [0.0, 1.0], None)


@read
def morph_weights_of_the_node(glb: Glb) -> None:
    morphed(glb, [0.5, 0.5], [0.0, 1.0])


@read
def morph_weights_of_zero(glb: Glb) -> None:
    morphed(glb, [0.0, 0.0], None, is_short=False)


def skinned(glb: Glb, split: bool) -> None:
    """The solid lies down in centimetres, its heights a fourth; joints stand it up. The node's own place is of no
    account. `split`: half of the weight is a second joint's, at another place, and its matrix makes up for it."""
    both = trimesh.util.concatenate([trimesh.Trimesh(*SLAB, process=False), trimesh.Trimesh(*TOWER, process=False)])
    v = np.asarray(both.vertices)
    lying = np.stack([v[:, 0], -v[:, 2], v[:, 1] / 4], axis=1) * 100
    part = glb.primitive((lying, np.asarray(both.faces)))
    stands = np.eye(4)
    stands[:3, :3] = [[0.01, 0, 0], [0, 0, 0.04], [0, -0.01, 0]]
    moved = np.eye(4)
    moved[:3, 3] = [7, 8, 9]
    joints = np.tile([1, 0, 0, 0], (len(v), 1))
    weights = np.tile([0.5, 0.5, 0, 0] if split else [1.0, 0, 0, 0], (len(v), 1))
    part["attributes"] |= {
        "JOINTS_0": glb.numbers(joints, "<u1", "VEC4"),
        "WEIGHTS_0": glb.numbers(weights, "<f4", "VEC4"),
    }
    back = np.stack([np.linalg.inv(moved), np.eye(4)]).transpose(0, 2, 1).reshape(2, 16)
    body = glb.node(mesh=glb.mesh(part), skin=0, translation=[100, 0, 0])
    assert body == 0
    above = glb.node(matrix=stands.T.ravel().tolist(), children=[2, 3])
    far = glb.node(False, matrix=moved.T.ravel().tolist())
    assert (above, far) == (1, 2)
    glb.node(False)
    glb.add("skins", {"joints": [2, 3], "inverseBindMatrices": glb.numbers(back, "<f4", "MAT4")})


@read
def skin(glb: Glb) -> None:
    skinned(glb, split=False)


@read
def skin_of_two_joints(glb: Glb) -> None:
    skinned(glb, split=True)


@read
def instances(glb: Glb) -> None:
    """The boxes are instances of one cube: moved, turned, scaled."""
    quarter = float(np.sqrt(0.5))
    attributes = {
        "TRANSLATION": glb.numbers(np.array([[0, 0.2, 0], [0.8, 1.2, 0]]), "<f4"),
        "ROTATION": glb.numbers(np.array([[0, 0, 0, 1], [quarter, 0, 0, quarter]]), "<f4", "VEC4"),
        "SCALE": glb.numbers(np.array([[2, 0.4, 1], [0.4, 0.4, 1.6]]), "<f4"),
    }  # fmt: skip
    extension = {"EXT_mesh_gpu_instancing": {"attributes": attributes}}
    cube = glb.mesh(glb.primitive(box((1, 1, 1), (0, 0, 0))))
    above = glb.node(translation=[0, 0, 5], children=[1])
    assert above == 0
    glb.node(False, mesh=cube, extensions=extension, translation=[0, 0, -5])
    glb.needs("EXT_mesh_gpu_instancing")


@read
def instances_that_are_not_required(glb: Glb) -> None:
    instances(glb)
    del glb.tree["extensionsRequired"]


@read
def nodes_that_share_a_mesh(glb: Glb) -> None:
    """One of them mirrored, one by a matrix."""
    cube = glb.mesh(glb.primitive(box((1, 1, 1), (0, 0.5, 0))))
    glb.node(children=[1, 2])
    glb.node(False, mesh=cube, scale=[2, 0.4, -1])
    matrix = np.diag([0.4, 1.6, 0.4, 1.0])
    matrix[:3, 3] = [0.8, 0.4, 0]
    glb.node(False, mesh=cube, matrix=matrix.T.ravel().tolist())


@read
def a_chain_of_nodes(glb: Glb) -> None:
    """Deeper than Python calls itself."""
    mesh = glb.mesh(glb.primitive(SLAB), glb.primitive(TOWER))
    for k in range(5000):
        glb.node(k == 0, children=[k + 1], translation=[0, 0.25 * (-1) ** k, 0])
    glb.node(False, mesh=mesh)


BIG = box((8, 8, 8), (0, 4, 0))


@read
def another_scene_before(glb: Glb) -> None:
    glb.show(BIG, SLAB, TOWER)
    glb.tree |= {"scenes": [{"nodes": [0]}, {"nodes": [1, 2]}], "scene": 1}


@read
def a_node_outside_of_the_scene(glb: Glb) -> None:
    glb.show(BIG, SLAB, TOWER)
    glb.tree["scenes"] = [{"nodes": [1, 2]}]


@read
def hidden_nodes(glb: Glb) -> None:
    plain(glb)
    glb.node(extensions={"KHR_node_visibility": {"visible": False}}, children=[3])
    glb.node(False, mesh=glb.mesh(glb.primitive(BIG)))
    glb.needs("KHR_node_visibility")


@read
def coarse_stand_ins(glb: Glb) -> None:
    plain(glb)
    coarse = glb.node(mesh=glb.mesh(glb.primitive(BIG)))
    glb.tree["nodes"][0]["extensions"] = {"MSFT_lod": {"ids": [coarse]}}


@read
def an_animation_and_a_camera(glb: Glb) -> None:
    """At rest."""
    plain(glb)
    times, places = glb.numbers(np.arange(2.0), "<f4", "SCALAR"), glb.numbers(np.ones((2, 3)) * 50, "<f4")
    channel = {"sampler": 0, "target": {"node": 1, "path": "translation"}}
    glb.add("animations", {"channels": [channel], "samplers": [{"input": times, "output": places}]})
    glb.add("cameras", {"type": "perspective", "perspective": {"yfov": 1, "znear": 0.1}})
    glb.node(camera=0, translation=[0, 50, 0])


@read
def looks_and_lights(glb: Glb) -> None:
    """Extensions that do not touch the shape, required or not; an image that is in another file."""
    plain(glb)
    part = glb.tree["meshes"][0]["primitives"][0]
    part["extensions"] = {"KHR_materials_variants": {"mappings": []}}
    part["material"] = glb.add("materials", {"extensions": {"KHR_materials_unlit": {}}})
    glb.tree["nodes"][0]["extensions"] = {"KHR_lights_punctual": {"light": 0}}
    glb.add("images", {"uri": "/dev/zero"})
    glb.needs("KHR_materials_unlit", "KHR_texture_transform", "KHR_lights_punctual", "KHR_materials_variants")


def with_draco(glb: Glb) -> Tree:
    plain(glb)
    part: Tree = glb.tree["meshes"][1]["primitives"][0]
    view = glb.view(b"DRACO" + bytes(range(59)))
    part["extensions"] = {"KHR_draco_mesh_compression": {"bufferView": view, "attributes": {"POSITION": 0}}}
    glb.tree["extensionsUsed"] = ["KHR_draco_mesh_compression"]
    return part


@read
def draco_beside_its_plain_numbers(glb: Glb) -> None:
    with_draco(glb)


def in_the_json(glb: Glb, head: str, text: str) -> None:
    glb.tree["buffers"] = [{"byteLength": len(glb.blob), "uri": f"{head},{text}"}]
    glb.blob = b""


@read
def a_buffer_in_the_json(glb: Glb) -> None:
    plain(glb)
    in_the_json(glb, "data:application/octet-stream;base64", base64.b64encode(glb.blob).decode())


@read
def a_buffer_in_the_json_in_capitals(glb: Glb) -> None:
    plain(glb)
    in_the_json(glb, "DATA:Application/Octet-Stream;Base64", base64.b64encode(glb.blob).decode())


@read
def a_buffer_in_the_json_without_base64(glb: Glb) -> None:
    plain(glb)
    in_the_json(glb, "data:application/octet-stream", quote_from_bytes(glb.blob))


@read
def no_scenes_at_all(glb: Glb) -> None:
    plain(glb)
    del glb.tree["scenes"], glb.tree["scene"]


@refused("KHR_draco_mesh_compression.*Draco")
def draco(glb: Glb) -> None:
    part = with_draco(glb)
    for number in (part["attributes"]["POSITION"], part["indices"]):
        del glb.tree["accessors"][number]["bufferView"]
    glb.tree["extensionsRequired"] = ["KHR_draco_mesh_compression"]


@refused("KHR_draco_mesh_compression.*Draco")
def draco_that_is_not_required(glb: Glb) -> None:
    draco(glb)
    del glb.tree["extensionsRequired"]


def packed(glb: Glb, name: str) -> None:
    plain(glb)
    for view in glb.tree["bufferViews"]:
        own = {"buffer": 0, "byteLength": 40, "byteStride": 12, "count": view["byteLength"] // 12}
        view |= {"buffer": 1, "extensions": {name: own | {"mode": "ATTRIBUTES"}}}
    stand_in = {"byteLength": len(glb.blob), "extensions": {name: {"fallback": True}}}
    glb.tree["buffers"] = [{"byteLength": 100}, stand_in]
    glb.blob = bytes(100)


@refused("EXT_meshopt_compression.*meshopt")
def meshopt(glb: Glb) -> None:
    packed(glb, "EXT_meshopt_compression")
    glb.needs("EXT_meshopt_compression")


@refused("KHR_meshopt_compression.*meshopt")
def meshopt_that_is_not_required(glb: Glb) -> None:
    packed(glb, "KHR_meshopt_compression")


@refused("ACME_bent_space")
def an_unknown_extension(glb: Glb) -> None:
    plain(glb)
    glb.needs("ACME_bent_space")


@refused("in another file, '/dev/zero'")
def a_buffer_in_another_file(glb: Glb) -> None:
    plain(glb)
    glb.tree["buffers"] = [{"byteLength": len(glb.blob), "uri": "/dev/zero"}]


@refused("in another file, 'more.bin'")
def a_second_buffer_in_another_file(glb: Glb) -> None:
    plain(glb)
    glb.tree["buffers"] = [{"byteLength": len(glb.blob)}, {"byteLength": 9, "uri": "more.bin"}]


@refused("primitive restart")
def primitive_restart(glb: Glb) -> None:
    order = np.array([0, 1, 2, 65535, 3, 4, 5])
    at = glb.numbers(TOWER[0], "<f4")
    glb.node(mesh=glb.mesh(at_mode(glb, at, list(order), 5)))


@refused("only lines")
def lines_alone(glb: Glb) -> None:
    glb.node(mesh=glb.mesh(glb.primitive(TOWER, mode=1)))


@refused("shows no mesh")
def all_meshes_outside_of_the_scene(glb: Glb) -> None:
    glb.node(False, mesh=glb.mesh(glb.primitive(TOWER)))


@refused("no unit quaternion")
def a_long_quaternion(glb: Glb) -> None:
    glb.node(mesh=glb.mesh(glb.primitive(TOWER)), rotation=[0, 0, 1, 1])


@refused("two places")
def a_matrix_and_a_place(glb: Glb) -> None:
    matrix = np.eye(4).ravel().tolist()
    glb.node(mesh=glb.mesh(glb.primitive(TOWER)), matrix=matrix, translation=[1, 0, 0])


@refused("joint")
def a_joint_outside_of_the_scene(glb: Glb) -> None:
    skinned(glb, split=False)
    glb.tree["scenes"][0]["nodes"] = [0]


@refused("morph targets")
def weights_for_no_targets(glb: Glb) -> None:
    glb.node(mesh=glb.mesh(glb.primitive(TOWER), weights=[1.0]))


@refused("2 parents")
def a_circle_of_nodes(glb: Glb) -> None:
    glb.node(mesh=glb.mesh(glb.primitive(TOWER)), children=[1])
    glb.node(False, children=[0])


def claimed(glb: Glb, of: Tree, **keys: Any) -> None:
    """A mesh of three vertices, of which an accessor claims more than the file has."""
    glb.node(mesh=glb.mesh(glb.primitive(TOWER)))
    glb.tree["accessors"][of["accessor"]] |= keys


@refused("not that many bytes")
def more_vertices_than_there_are(glb: Glb) -> None:
    claimed(glb, {"accessor": 0}, count=10**9)


@refused("has 333333333 triangles")
def more_indices_than_there_are(glb: Glb) -> None:
    claimed(glb, {"accessor": 1}, count=10**9)


@refused("not that many bytes")
def values_beyond_their_view(glb: Glb) -> None:
    claimed(glb, {"accessor": 0}, byteOffset=4)


@refused("not that many bytes")
def sparse_values_that_are_not_there(glb: Glb) -> None:
    place = {"bufferView": 0, "componentType": 5125}
    claimed(glb, {"accessor": 0}, sparse={"count": 10**9, "indices": place, "values": {"bufferView": 0}})


@refused("MAT4")
def matrices_for_places(glb: Glb) -> None:
    claimed(glb, {"accessor": 0}, type="MAT4", count=10**8)


@refused("has 12000000000 triangles")
def a_billion_instances(glb: Glb) -> None:
    cube = glb.mesh(glb.primitive(TOWER))
    many = glb.add("accessors", {"componentType": 5126, "count": 10**9, "type": "VEC3"})
    glb.node(mesh=cube, extensions={"EXT_mesh_gpu_instancing": {"attributes": {"TRANSLATION": many}}})


@refused("names vertices that it does not hold")
def indices_beyond_the_vertices(glb: Glb) -> None:
    part = glb.primitive(TOWER)
    part["indices"] = glb.numbers(np.array([0, 1, 200]), "<u2", "SCALAR")
    glb.node(mesh=glb.mesh(part))
