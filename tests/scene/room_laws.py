"""What must hold in every generated room, checked independently of the code that places things.

The oracle is a plain float64 segment–triangle test (Möller & Trumbore 1997) on the finished triangles; it shares
nothing with the plan-view tests of `scene_library`.
"""

from __future__ import annotations

from collections import Counter

import numpy as np
from embreex.mesh_construction import TriangleMesh
from embreex.rtcore_scene import EmbreeScene

from datagen.records import Scene


def crossings(triangles: np.ndarray, start: np.ndarray, end: np.ndarray) -> np.ndarray:
    """(n, F): whether segment start → end (n, 3) passes through triangle (F, 3, 3)."""
    a, e1, e2 = triangles[:, 0], triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0]
    d = (end - start)[:, None]
    p = np.cross(d, e2[None])
    det = (e1[None] * p).sum(-1)
    safe = np.where(np.abs(det) < 1e-14, 1.0, det)
    s = start[:, None] - a[None]
    u = (s * p).sum(-1) / safe
    q = np.cross(s, e1[None])
    v = (d * q).sum(-1) / safe
    t = (e2[None] * q).sum(-1) / safe
    return (np.abs(det) >= 1e-14) & (u >= 0) & (v >= 0) & (u + v <= 1) & (t > 1e-9) & (t < 1 - 1e-9)


def triangles_of(scene: Scene, *roles: str) -> np.ndarray:
    wanted = [i for i, r in enumerate(scene.roles) if r in roles]
    return scene.corners[np.isin(scene.face_part, wanted)]


def object_names(scene: Scene) -> list[str]:
    return [n for n, r in zip(scene.part_names, scene.roles, strict=True) if r == "object"]


def surface_points(triangles: np.ndarray, n: int, rng: np.random.Generator) -> np.ndarray:
    area = np.linalg.norm(np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0]), axis=1)
    face = rng.choice(len(area), size=n, p=area / area.sum())
    u, v = rng.random(n), rng.random(n)
    u, v = np.where(u + v > 1, 1 - u, u)[:, None], np.where(u + v > 1, 1 - v, v)[:, None]
    t = triangles[face]
    return t[:, 0] + u * (t[:, 1] - t[:, 0]) + v * (t[:, 2] - t[:, 0])


def assert_closed_surface(scene: Scene) -> None:
    """The room's own triangles form a closed surface: every edge belongs to exactly two of them."""
    edges: Counter[frozenset[tuple[float, ...]]] = Counter()
    for triangle in triangles_of(scene, "relay_wall", "structure"):
        corners = [tuple(c) for c in triangle]
        edges.update(frozenset((corners[k], corners[k - 1])) for k in range(3))
    assert set(edges.values()) == {2}


def assert_light_stays_inside(scene: Scene, rng: np.random.Generator, rays: int = 500) -> None:
    """Rays from where the device stands, and from what they hit, always hit again."""
    embree = EmbreeScene()
    TriangleMesh(embree, scene.corners.astype(np.float32))
    origin = np.repeat(scene.device_position[None], rays, axis=0)
    for _ in range(3):
        direction = rng.normal(size=(rays, 3))
        direction /= np.linalg.norm(direction, axis=1)[:, None]
        hit = embree.run(origin.astype(np.float32), direction.astype(np.float32), query="DISTANCE")
        assert (hit < 1e3).all()
        origin = origin + 0.5 * hit[:, None] * direction


def assert_nothing_intersects(scene: Scene) -> None:
    """No edge of an object passes through another object or through the room, and none lies inside another."""
    names = object_names(scene)
    structure = triangles_of(scene, "relay_wall", "structure")
    extent = float(np.ptp(scene.vertices, axis=0).max())
    for name in names:
        own = scene.corners[scene.faces_of(name)]
        start, end = own.reshape(-1, 3), np.roll(own, -1, axis=1).reshape(-1, 3)
        # Objects may rest on floor or ceiling; pulled in by a hair they must be free of them.
        middle = own.reshape(-1, 3).mean(axis=0)
        inward = 1e-6
        assert not crossings(structure, start + inward * (middle - start), end + inward * (middle - end)).any(), name
        for other in names:
            if other != name:
                theirs = scene.corners[scene.faces_of(other)]
                # Triangles apart from the object's bounding box cannot be met by its edges.
                near = (theirs.max(axis=1) >= start.min(axis=0)) & (theirs.min(axis=1) <= start.max(axis=0))
                assert not crossings(theirs[near.all(axis=1)], start, end).any(), (name, other)
                far = middle + extent * np.array([0.03, 0.04, 5.0])
                inside = crossings(theirs, start[:1], far[None]).sum() % 2
                assert inside == 0, f"{name} inside {other}"
        if scene.parameters["layout.kind"] == "isolated_wall":
            continue
        # Inside the room: straight up from the object there is a ceiling, straight down a floor.
        up = crossings(structure, middle[None], middle[None] + [0.0, 0.0, extent]).sum()
        down = crossings(structure, middle[None], middle[None] - [0.0, 0.0, extent]).sum()
        assert up % 2 == 1
        assert down % 2 == 1


def assert_hidden(scene: Scene, rng: np.random.Generator, points: int = 100) -> None:
    """No point of an object, corners included, is in sight of the device; objects do not help to hide each other."""
    structure = triangles_of(scene, "relay_wall", "structure")
    for name in object_names(scene):
        own = scene.corners[scene.faces_of(name)]
        on_it = np.concatenate([np.unique(own.reshape(-1, 3), axis=0), surface_points(own, points, rng)])
        blocked = crossings(structure, np.broadcast_to(scene.device_position, on_it.shape), on_it).any(axis=1)
        assert blocked.all(), name


def assert_seen_from_wall(scene: Scene, rng: np.random.Generator, points: int = 200, batches: int = 40) -> None:
    """The device sees the relay wall's rectangle, and points of it see some of every object."""
    wall = scene.relay_wall
    across, up = rng.uniform(-1, 1, (2, points, 1))
    on_wall = wall.center + across * wall.right + up * wall.up
    to_wall = on_wall + 1e-3 * (scene.device_position - on_wall)
    assert not crossings(scene.corners, np.broadcast_to(scene.device_position, to_wall.shape), to_wall).any()
    for name in object_names(scene):
        assert any(_sees_some(scene, name, on_wall, rng) for _ in range(batches)), name


def _sees_some(scene: Scene, name: str, on_wall: np.ndarray, rng: np.random.Generator) -> bool:
    on_wall = on_wall[rng.choice(len(on_wall), 40)]
    on_it = surface_points(scene.corners[scene.faces_of(name)], len(on_wall), rng)
    near_wall, near_it = on_wall + 1e-6 * (on_it - on_wall), on_it + 1e-6 * (on_wall - on_it)
    return bool((~crossings(scene.corners, near_wall, near_it).any(axis=1)).any())


def assert_room_laws(scene: Scene, rng: np.random.Generator) -> None:
    if scene.parameters["layout.kind"] != "isolated_wall":
        assert_closed_surface(scene)
        assert_light_stays_inside(scene, rng)
    assert_nothing_intersects(scene)
    assert_hidden(scene, rng)
    assert_seen_from_wall(scene, rng)
