"""The library's classes, letters, placements and mesh folders."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh
from crossing_counts import crossing_counts
from room_laws import assert_room_laws, object_names
from scipy import stats

from datagen.config import SceneConfig, config_from_mapping
from datagen.errors import InputError
from datagen.scene import check_scene_config, generate_scene
from scene_library.objects import CLASSES, GROUPS, build
from scene_library.placement import FreeSpace, Occupied
from scene_library.plates import union_plate
from scene_library.polygons import contains, rotation
from scene_library.solids import Solid, regular_polygon


def contents(*items: dict[str, Any], base: Path | str = ".", **scene: Any) -> SceneConfig:
    return config_from_mapping({"scene": {"contents": list(items), **scene}}, base_directory=base).scene


def volume_of_closed(solid: Solid) -> float:
    """Its volume; closed by the divergence theorem: the vector area is zero; outward: the volume is positive."""
    corners = solid.vertices[solid.triangles]
    area = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]) / 2
    assert np.linalg.norm(area, axis=1).min() > 0
    np.testing.assert_allclose(area.sum(axis=0), 0, atol=1e-9)
    assert abs(solid.vertices[:, 2].min()) < 1e-12
    volume = float((corners[:, 0] * np.cross(corners[:, 1], corners[:, 2])).sum() / 6)
    assert volume > 0
    return volume


class Corners(np.random.Generator):
    """Draws nothing but the ends of every range: the corners of a class's space of proportions."""

    def __init__(self, seed: int) -> None:
        super().__init__(np.random.PCG64(seed))

    def uniform(self, low: Any = 0.0, high: Any = 1.0, size: Any = None) -> Any:
        super().uniform(low, high)
        return np.where(super().random(size) < 0.5, low, high) if size is not None else (low, high)[self._coin()]

    def integers(self, low: Any, high: Any = None, **keys: Any) -> Any:
        first, last = (0, low) if high is None else (low, high)
        return (first, last - (not keys.get("endpoint", False)))[self._coin()]

    def _coin(self) -> int:
        return int(super().random() < 0.5)


@pytest.mark.parametrize("group", GROUPS)
def test_every_class_is_a_closed_solid_standing_at_the_origin(group: str) -> None:
    """At the corners of its proportions, too. Regression: a tall pot under a low plant left no height for leaves,
    once in two hundred plants."""
    for name in GROUPS[group]:
        solids = [build(name, np.random.default_rng(seed)) for seed in (0, 1)]
        for solid in solids:
            low, high = solid.vertices.min(axis=0), solid.vertices.max(axis=0)
            assert volume_of_closed(solid) <= np.prod(high - low) * (1 + 1e-9)
            np.testing.assert_allclose((low + high)[:2], 0, atol=1e-12)
            assert 0.05 < (high - low).max() < 2.5
            np.testing.assert_allclose(solid.top_m, high[2])
        assert not np.array_equal(solids[0].vertices, solids[1].vertices)
        np.testing.assert_array_equal(build(name, np.random.default_rng(0)).vertices, solids[0].vertices)
        for seed in range(2 if group in ("letters", "digits") else 12):
            volume_of_closed(build(name, Corners(seed)))


def test_every_class_is_in_one_group() -> None:
    assert sorted(name for names in GROUPS.values() for name in names) == sorted(CLASSES)


def test_union_has_the_area_of_the_union() -> None:
    """Random overlapping polygons: the plate's faces cover what a point test says."""
    rng = np.random.default_rng(3)
    for _ in range(8):
        polygons = [
            regular_polygon(rng.uniform(0.3, 1.0), int(rng.integers(3, 9))) @ rotation(rng.uniform(0, 6)).T
            + rng.uniform(-0.3, 0.3, 2)
            for _ in range(int(rng.integers(1, 5)))
        ]
        plate = trimesh.Trimesh(*union_plate(polygons, 0.1), process=False)
        points = rng.uniform(-1, 1, (400, 2))
        inside = np.any([contains(p, points) for p in polygons], axis=0)
        start = np.column_stack([points[:, 0], np.full(400, -1.0), points[:, 1]])
        hits = crossing_counts(plate.triangles, start, start + np.array([0.0, 2.0, 0.0]))
        np.testing.assert_array_equal(hits, np.where(inside, 2, 0))
        np.testing.assert_allclose(plate.volume / 0.1, 4 * inside.mean(), atol=5 * 4 * 0.5 / np.sqrt(400))


def test_objects_have_the_name_of_their_class_unless_given_one_and_the_height_drawn() -> None:
    names = {"chair", "vase", "letter_a", "digit_7"}
    for given, allowed in (({}, names), ({"name": "thing"}, {"thing"})):
        spec = contents({"kind": "library", "classes": sorted(names), "height_m": 0.5, **given})
        drawn = [generate_scene(spec, 0, i) for i in range(24)]
        assert {object_names(scene)[0] for scene in drawn} == allowed
        assert {scene.parameters[f"{object_names(scene)[0]}.class"] for scene in drawn} == names
    spec = contents({"kind": "library", "classes": ["shapes"], "name": "it"})
    assert {generate_scene(spec, 1, i).parameters["it.class"] for i in range(12)} <= set(GROUPS["shapes"])


@pytest.mark.parametrize("kind", ["l_corridor", "doorway_room", "straight_corridor"])
def test_wall_placement_puts_the_back_to_a_wall(kind: str) -> None:
    """The back face lies one clearance before a wall: straight behind the middle there is wall at once."""
    item = {"kind": "library", "classes": ["wardrobe"], "height_m": 1.5, "placement": "wall", "name": "it"}
    layout = {"kind": kind, "out_of_square_deg": {"uniform": [-3, 3]}}
    spec = contents(item, layout=layout, clearance_m=0.03)
    for index in range(4):
        scene = generate_scene(spec, 2, index)
        p = scene.parameters
        turn = np.radians(p["it.rotation_deg"] + 90)
        back = np.array([np.cos(turn), np.sin(turn), 0.0])
        start = np.array([p["it.x_m"], p["it.y_m"], 0.7]) + back * p["it.depth_m"] / 2
        walls = scene.corners[scene.faces_of("walls")]
        assert crossing_counts(walls, start[None], (start + 0.0301 * back)[None]).any()
        assert not crossing_counts(walls, start[None], (start + 0.0299 * back)[None]).any()
        assert_room_laws(scene, np.random.default_rng(index), spec.clearance_m)


@pytest.mark.parametrize("hanging_first", [True, False])
@pytest.mark.parametrize(("gap_m", "free"), [(0.11, True), (0.09, False), (-0.5, False)])
def test_an_object_may_stand_under_a_hanging_one_that_is_clear_of_it(
    hanging_first: bool, gap_m: float, free: bool
) -> None:
    """Whichever of the two is placed first; beside each other they need the same clearance."""
    floor = np.array([(0.0, 0.0), (4.0, 0.0), (4.0, 4.0), (0.0, 4.0)])
    square = np.array([(1.5, 1.5), (2.5, 1.5), (2.5, 2.5), (1.5, 2.5)])
    walls = np.stack([floor, np.roll(floor, -1, axis=0)], axis=1)
    lamp, box = Occupied(square, 1.5, 2.5), Occupied(square, 0.0, 1.5 - gap_m)
    first, second = (lamp, box) if hanging_first else (box, lamp)

    def obstacle(one: Occupied) -> str | None:
        space = FreeSpace(floor, floor[[0, 2]], walls, 2.5, np.zeros((0, 3, 2)), 0.1, [first])
        return space.obstacle(one)

    assert obstacle(second) == (None if free else "object")
    for aside, clear in ((1.05, False), (1.15, True)):
        beside = Occupied(square + np.array([aside, 0.0]), second.bottom_m, second.top_m)
        assert obstacle(beside) == (None if free or clear else "object")


def test_round_pillars_are_round() -> None:
    spec = contents({"kind": "pillar", "shape": "round", "width_m": 0.4})
    scene = generate_scene(spec, 0, 0)
    corners = scene.corners[scene.faces_of("pillar")].reshape(-1, 3)
    centre = [scene.parameters["pillar.x_m"], scene.parameters["pillar.y_m"]]
    np.testing.assert_allclose(np.linalg.norm(corners[:, :2] - centre, axis=1), 0.2)


def _folder(tmp_path: Path) -> Path:
    folder = tmp_path / "zoo"
    for label, shape in (("ball", trimesh.creation.icosphere(1)), ("block", trimesh.creation.box())):
        (folder / label / "deep").mkdir(parents=True)
        shape.export(folder / label / "one.ply")
        shape.export(folder / label / "deep" / "two.stl")
    trimesh.creation.cone(1, 2).export(folder / "Party Hat.obj")
    (folder / "readme.txt").write_text("no mesh")
    return folder


def test_mesh_folders_give_class_labels(tmp_path: Path) -> None:
    _folder(tmp_path)
    spec = contents({"kind": "mesh_folder", "path": "zoo", "height_m": 0.5}, base=tmp_path)
    check_scene_config(spec)
    labels, files = [], set()
    for index in range(60):
        scene = generate_scene(spec, 0, index)
        (name,) = object_names(scene)
        labels.append(scene.parameters[f"{name}.class"])
        files.add(scene.parameters[f"{name}.file"])
    assert stats.chisquare([labels.count(n) for n in ("ball", "block", "Party Hat")]).pvalue > 1e-3
    deep = {f"zoo/{label}/{name}" for label in ("ball", "block") for name in ("one.ply", "deep/two.stl")}
    assert files == deep | {"zoo/Party Hat.obj"}
    only = contents({"kind": "mesh_folder", "path": "zoo", "classes": ["block"]}, base=tmp_path)
    assert object_names(generate_scene(only, 0, 0)) == ["block"]


def test_fingerprint_follows_the_meshes_of_a_folder(tmp_path: Path) -> None:
    folder = _folder(tmp_path)
    item = {"kind": "mesh_folder", "path": "zoo"}
    first = contents(item, base=tmp_path).mesh_digests()
    assert set(first) == {"zoo"}
    (folder / "readme.txt").write_text("still no mesh")
    assert contents(item, base=tmp_path).mesh_digests() == first
    (folder / "ball" / "one.ply").rename(folder / "ball" / "uno.ply")
    assert contents(item, base=tmp_path).mesh_digests() != first


def test_bad_folders_are_refused(tmp_path: Path) -> None:
    folder = _folder(tmp_path)
    (tmp_path / "empty").mkdir()
    for path, reason in (
        ("nowhere", "no such folder"),
        ("empty", "holds no mesh files"),
        ("zoo/readme.txt", "a file"),
    ):
        with pytest.raises(InputError, match=reason):
            contents({"kind": "mesh_folder", "path": path}, base=tmp_path)
    with pytest.raises(InputError, match=r"'cat' is not a sub-folder of 'zoo' with meshes; .*Hat, ball, block"):
        contents({"kind": "mesh_folder", "path": "zoo", "classes": ["cat"]}, base=tmp_path)
    (folder / "block" / "one.ply").write_text("")
    with pytest.raises(InputError, match=r"scene\.contents\[0\]\.path = 'zoo/block/one.ply': is empty"):
        check_scene_config(contents({"kind": "mesh_folder", "path": "zoo"}, base=tmp_path))
