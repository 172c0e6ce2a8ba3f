"""Connections proven clear: never one that a shadow ray would find blocked, and the same transient either way."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import trimesh
from numpy.typing import NDArray
from rooms import bins_of_path, furnished_box, one_point_capture, rectangle, square_pixels
from scene.random_specs import LAYOUTS, random_scene

from datagen import Accuracy, Capture, Lambertian, Laser, Part, Scene, Sensor, simulate
from datagen.errors import InputError
from datagen.transport.fields_of_view import PixelCones, fov_pool
from datagen.transport.sampling import stream_seeds
from datagen.transport.visibility.clear_sight import ClearSight
from datagen.transport.visibility.raycast import Raycaster

BLOCKS = 8


def sensor_of(scene: Scene, pixels_a_side: int, share: float = 1.0) -> Sensor:
    """Looks at `share` of a scene's relay wall, up to its edges."""
    wall, device = scene.relay_wall, scene.device_position
    assert wall is not None and device is not None
    return Sensor.grid(device, wall.center, share * wall.right, share * wall.up, pixels_a_side, pixels_a_side)


def vertices_of(caster: Raycaster, sensor: Sensor, count: int, seed: int) -> tuple[NDArray[np.float64], ...]:
    """Ends of short walks from the field of view: points on all surfaces, seen from it or not."""
    rng = np.random.default_rng(seed)
    hits = caster.closest(
        sensor.position, (sensor.pixels.mean(axis=1) - sensor.position)[rng.integers(len(sensor.pixels), size=count)]
    )
    position, normal = hits.position[hits.valid], hits.normal[hits.valid]
    found = []
    for _ in range(2):
        toward = normal + 0.999 * _unit(rng, len(position))
        hits = caster.closest(position + caster.offset_m * normal, toward)
        position, normal = hits.position[hits.valid], hits.normal[hits.valid]
        found.append((position, normal))
    return tuple(np.concatenate(pair) for pair in zip(*found, strict=True))


def _unit(rng: np.random.Generator, count: int) -> NDArray[np.float64]:
    v = rng.normal(size=(count, 3))
    return v / np.linalg.norm(v, axis=1, keepdims=True)


def proven_and_wrong(
    scene: Scene, sensor: Sensor, vertices: int, seed: int, confocal: bool = False
) -> NDArray[np.int64]:
    """Connections that face both ways, those of them proven clear, those proven but blocked, those clear in truth."""
    caster = Raycaster(scene)
    position, normal = vertices_of(caster, sensor, vertices, seed)
    pixels = np.arange(len(sensor.pixels))
    pool = fov_pool(caster, scene, sensor, PixelCones.of(sensor), pixels, 2, BLOCKS, stream_seeds(seed, 7, pixels))
    sight = ClearSight.of(caster, sensor, "auto", 2 if confocal else 2 * len(pixels), expected=1 << 26)
    sight.prepare(1)
    tile = sight.tiles(pool, pixels)
    own = np.random.default_rng(seed).integers(len(pixels), size=len(position)) if confocal else None
    clear = sight.clear(position, normal, own)
    counts = np.zeros(4, np.int64)
    for p in pixels:
        chosen = np.arange(len(position)) if own is None else np.flatnonzero(own == p)
        used = np.flatnonzero(pool.weight[p] > 0)
        x3, n3 = pool.position[p, used], pool.normal[p, used]
        d = x3[None] - position[chosen, None]
        faces = (np.einsum("vqk,vk->vq", d, normal[chosen]) > 0) & (np.einsum("vqk,qk->vq", d, n3) < 0)
        v, q = np.nonzero(faces)
        starts = position[chosen[v]] + caster.offset_m * normal[chosen[v]]
        hidden = caster.occluded(starts, x3[q] + caster.offset_m * n3[q])
        t = tile[p, used[q]].astype(np.int64)
        proven = (t >= 0) & ((clear[chosen[v]] >> np.maximum(t, 0).astype(np.uint64)) & np.uint64(1)).astype(bool)
        counts += [len(v), proven.sum(), (proven & hidden).sum(), (~hidden).sum()]
    return counts


def touching() -> Scene:
    """Boxes that touch floor, walls and each other, a tilted card that stands on a wall, an acute corner."""
    parts = []
    for k, (size, at) in enumerate(
        [
            ((0.6, 0.6, 1.0), (0.3, -1.2, 0.5)),
            ((0.6, 0.5, 0.5), (0.9, -1.25, 0.25)),
            ((0.5, 0.5, 2.5), (2.0, 0.3, 1.25)),
        ]
    ):
        box = trimesh.creation.box(size)
        box.apply_translation(at)
        parts.append(Part(f"box{k}", box, Lambertian(0.7)))
    card = rectangle((1.5, 1.2, 1.2), (0.0, 0.3, 0.4), (0.6, 0.0, 0.0))
    wedge = rectangle((0.5, 1.0, 1.25), (0.5, 0.1, 0.0), (0.0, 0.0, 1.25))
    parts += [Part("card", card, Lambertian(0.6)), Part("wedge", wedge, Lambertian(0.6))]
    room = furnished_box()
    mesh = trimesh.Trimesh(room.vertices, room.triangles[room.face_part < 4], process=False)
    return Scene.from_parts([Part("shell", mesh, Lambertian(0.7), "structure"), *parts])


def with_mesh(subdivisions: int = 5) -> Scene:
    """A room with objects of 1280 and 20 480 triangles (or fewer), so that boxes stand for triangles."""
    room = furnished_box()
    mesh = trimesh.Trimesh(room.vertices, room.triangles[room.face_part < 4], process=False)
    ball = trimesh.creation.icosphere(subdivisions=subdivisions, radius=0.4)
    ball.apply_translation((1.8, 0.5, 0.9))
    egg = trimesh.creation.icosphere(subdivisions=3, radius=0.3)
    egg.apply_transform(np.diag([1.0, 0.6, 1.8, 1.0]))
    egg.apply_translation((1.0, -0.8, 1.0))
    return Scene.from_parts(
        [
            Part("shell", mesh, Lambertian(0.7), "structure"),
            Part("ball", ball, Lambertian(0.5)),
            Part("egg", egg, Lambertian(0.5)),
        ]
    )


def whole_wall(pixels_a_side: int) -> Sensor:
    """Looks at the wall x = 0 of `furnished_box`, floor to ceiling and side to side."""
    return Sensor.grid((1.5, 0.1, 1.3), (0, 0, 1.25), (0, 1.5, 0), (0, 0, 1.25), pixels_a_side, pixels_a_side)


@pytest.mark.parametrize("rooms", [1, pytest.param(3, marks=pytest.mark.nightly)], ids=["daily", "more rooms"])
@pytest.mark.parametrize("confocal", [False, True], ids=["every pixel", "own pixel"])
def test_nothing_proven_clear_is_blocked(confocal: bool, rooms: int) -> None:
    """Some 400 000 connections and more in furnished, touching and meshed rooms and in random ones of every layout
    (out of square, with doorways, uneven relay walls and clutter): what is proven a ray confirms, and much of what is
    clear is proven."""
    vertices = 1000 if confocal else 300
    total = np.zeros(4, np.int64)
    # Where a box touches the wall looked at, most views of a whole tile are not free.
    for scene, least in ((furnished_box(), 0.85), (touching(), 0.1), (with_mesh(), 0.4)):
        counts = proven_and_wrong(scene, whole_wall(4), 2 * vertices, 1, confocal)
        assert counts[1] > least * counts[3]
        total += counts
    rng = np.random.default_rng(5)
    for kind in LAYOUTS:
        for k in range(rooms):
            scene = random_scene(rng, kind, 3, k)[1]
            total += proven_and_wrong(scene, sensor_of(scene, 4), vertices, k, confocal)
    assert total[2] == 0
    assert total[0] > rooms * (75_000 if confocal else 333_333)
    assert total[1] > 0.3 * total[3]


@pytest.mark.parametrize("pairing", ["exhaustive", "confocal"])
@pytest.mark.parametrize(
    "scene", [furnished_box(), touching(), with_mesh(3)], ids=["furnished", "touching", "meshes"]
)
def test_the_transient_is_the_same_with_and_without_proofs(scene: Scene, pairing: str) -> None:
    """Bin by bin to rounding, component by component; and every connection is counted once."""
    sensor = whole_wall(6)
    targets = sensor.pixels.mean(axis=1) if pairing == "confocal" else np.array([[0, 0.4, 1.2]])
    capture = Capture(Laser(sensor.position, targets), sensor, bins_of_path(64, 0.3, 0.0), pairing)  # type: ignore[arg-type]
    lookins = 1024 if pairing == "confocal" else 2048
    asked, proven = (
        simulate(scene, capture, Accuracy(lookins, 4, 4, 2, direct=True, occlusion=occlusion), seed=3)  # type: ignore[arg-type]
        for occlusion in ("on", "auto")
    )
    for name, component in asked.components.items():
        np.testing.assert_allclose(proven.components[name], component, rtol=1e-9, atol=1e-13 * component.max())
    np.testing.assert_allclose(proven.overflow, asked.overflow, rtol=1e-9)
    assert asked.rays["proven"] == asked.rays["assumed"] == proven.rays["assumed"] == 0
    assert sum(proven.rays.values()) == asked.rays["asked"]
    assert proven.rays["proven"] > 0.1 * asked.rays["asked"]


def test_without_occlusion_nothing_is_asked_and_light_is_only_added() -> None:
    """Off: no ray for any connection, exact where nothing stands in the way, too much light where something does."""
    axis = bins_of_path(64, 0.3, 0.0)
    wall, plate = rectangle((0, 0, 0), (0, 1, 0), (0, 0, 1)), rectangle((1, 0, 0), (0, -0.3, 0), (0, 0, 0.3))
    bare = Scene.from_parts([Part("wall", wall, Lambertian(0.8), "structure"), Part("plate", plate, Lambertian(0.6))])
    sensor = Sensor((2.0, 0, 1.5), square_pixels([[0, 0.2, 0.6]], 0.1))
    capture = Capture(Laser((2.0, 0, 1.5), [[0, -0.4, 0.5]]), sensor, axis, "exhaustive")
    accuracy = Accuracy(2048, 4, 3, 2)
    on, off = (simulate(bare, capture, replace(accuracy, occlusion=o), seed=1) for o in ("on", "off"))  # type: ignore[arg-type]
    np.testing.assert_allclose(off.total, on.total, rtol=1e-12)
    assert on.total.sum() > 0
    assert off.rays["asked"] == off.rays["proven"] == 0 and off.rays["assumed"] == on.rays["asked"] > 0
    room, capture = furnished_box(), one_point_capture(time=axis)
    on, off = (simulate(room, capture, replace(accuracy, occlusion=o), seed=1) for o in ("on", "off"))  # type: ignore[arg-type]
    assert (off.total >= on.total * (1 - 1e-12)).all()
    assert off.total.sum() > 1.001 * on.total.sum()


def test_few_connections_are_asked_and_a_target_proves_once_enough_were() -> None:
    """What is done is a matter of counts: the same every time."""
    room, capture = furnished_box(), one_point_capture(time=bins_of_path(64, 0.3, 0.0))
    few = simulate(room, capture, Accuracy(64, 2, 4, 2), seed=1)
    assert few.rays["proven"] == 0 and few.rays["asked"] > 0
    runs = [simulate(room, capture, Accuracy(1 << 15, 4, 4, 2), seed=1) for _ in range(2)]
    assert runs[0].rays == runs[1].rays and runs[0].rays["proven"] > 0
    np.testing.assert_array_equal(runs[0].total, runs[1].total)


def test_an_unknown_way_with_occlusion_is_refused() -> None:
    with pytest.raises(InputError, match="occlusion = 'maybe': must be one of auto"):
        Accuracy(occlusion="maybe")  # type: ignore[arg-type]
