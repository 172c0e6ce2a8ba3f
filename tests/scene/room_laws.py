"""What must hold in every generated room, checked independently of the code that places things.

The oracle is a plain float64 segment–triangle test (`crossing_counts.py`) on the finished triangles; it shares
nothing with the plan-view tests of `scene_library`.
"""

from __future__ import annotations

from collections import Counter
from itertools import combinations

import numpy as np
from crossing_counts import crossing_counts
from embreex.mesh_construction import TriangleMesh
from embreex.rtcore_scene import EmbreeScene
from random_specs import CLOSED

from datagen.capture import capture_for
from datagen.config import SceneConfig, config_from_mapping
from datagen.config.distributions import support
from datagen.errors import InputError
from datagen.records import Scene
from scene_library.polygons import convex_hull

ROOM = ("relay_wall", "walls", "floor", "ceiling", "screen")
"""The room's own parts; what else is no object is clutter before the relay wall."""


def room_triangles(scene: Scene, *names: str) -> np.ndarray:
    """(F, 3, 3) of the room's own parts, or of those named."""
    wanted = [i for i, name in enumerate(scene.part_names) if name in (names or ROOM)]
    return scene.corners[np.isin(scene.face_part, wanted)]


def all_but_objects(scene: Scene) -> np.ndarray:
    return scene.corners[np.array([role != "object" for role in scene.roles])[scene.face_part]]


def without_clutter(scene: Scene) -> np.ndarray:
    kept = [n in ROOM or r == "object" for n, r in zip(scene.part_names, scene.roles, strict=True)]
    return scene.corners[np.array(kept)[scene.face_part]]


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
    """The room's own triangles form a closed surface: every edge belongs to exactly two of them.

    Where floor or ceiling is left out, the edges it would have had belong to one.
    """
    edges: Counter[frozenset[tuple[float, ...]]] = Counter()
    for triangle in room_triangles(scene):
        corners = [tuple(c) for c in triangle]
        edges.update(frozenset((corners[k], corners[k - 1])) for k in range(3))
    tops = {scene.parameters["layout.height_m"], scene.parameters.get("layout.door_height_m")}
    open_at = ({0.0} if "floor" not in scene.part_names else set()) | (
        tops if "ceiling" not in scene.part_names else set()
    )
    for edge, uses in edges.items():
        heights = {corner[2] for corner in edge}
        assert uses == 2 or (uses == 1 and len(heights) == 1 and heights <= open_at), (edge, uses)


def assert_light_stays_inside(scene: Scene, rng: np.random.Generator, rays: int = 500) -> None:
    """Rays from where the device stands, and from what they hit, always hit again.

    Only where floor or ceiling is left out may they leave, downwards or upwards.
    """
    embree = EmbreeScene()
    TriangleMesh(embree, scene.corners.astype(np.float32))
    origin = np.repeat(scene.device_position[None], rays, axis=0)
    for _ in range(3):
        direction = rng.normal(size=(len(origin), 3))
        direction /= np.linalg.norm(direction, axis=1)[:, None]
        hit = embree.run(origin.astype(np.float32), direction.astype(np.float32), query="DISTANCE")
        escaped = hit > 1e3
        down, up = direction[:, 2] < 0, direction[:, 2] > 0
        free = (down & ("floor" not in scene.part_names)) | (up & ("ceiling" not in scene.part_names))
        assert not (escaped & ~free).any(), f"{(escaped & ~free).sum()} rays escape"
        origin = (origin + 0.5 * hit[:, None] * direction)[~escaped]


def assert_nothing_intersects(scene: Scene) -> None:
    """No edge of an object passes through another object or through the room, none lies inside another, and all are
    inside the room.
    """
    names = object_names(scene)
    structure = all_but_objects(scene)
    extent = float(np.ptp(scene.vertices, axis=0).max())
    for name in names:
        own = scene.corners[scene.faces_of(name)]
        start, end = own.reshape(-1, 3), np.roll(own, -1, axis=1).reshape(-1, 3)
        # Objects may rest on floor or ceiling; pulled in by a hair they must be free of them.
        middle = own.reshape(-1, 3).mean(axis=0)
        inward = 1e-6
        start_in, end_in = start + inward * (middle - start), end + inward * (middle - end)
        assert not crossing_counts(structure, start_in, end_in).any(), name
        for other in names:
            if other != name:
                theirs = scene.corners[scene.faces_of(other)]
                # Triangles apart from the object's bounding box cannot be met by its edges.
                near = (theirs.max(axis=1) >= start.min(axis=0)) & (theirs.min(axis=1) <= start.max(axis=0))
                assert not crossing_counts(theirs[near.all(axis=1)], start, end).any(), (name, other)
                far = middle + extent * np.array([0.03, 0.04, 5.0])
                if _may_be_open(scene, other) and not _is_closed(theirs):
                    continue
                assert crossing_counts(theirs, start[:1], far[None])[0] % 2 == 0, f"{name} inside {other}"
        if scene.parameters["layout.kind"] not in CLOSED:
            continue
        # Inside the room: on the level, every way out leads through its walls, which close around it. A hair of rise
        # keeps it off the edges that the grid of an uneven wall has at half the height.
        out = middle + extent * np.array([4.0, 1.234, 1e-3])
        assert crossing_counts(structure, middle[None], out[None])[0] % 2 == 1, f"{name} outside"
        assert -1e-9 <= own[..., 2].min() < own[..., 2].max() <= scene.parameters["layout.height_m"] + 1e-9, name


def _may_be_open(scene: Scene, name: str) -> bool:
    """Everything the library makes is closed; a user's mesh may be a mere sheet, which has no inside."""
    return str(scene.parameters[f"{name}.kind"]).startswith("mesh")


def _is_closed(triangles: np.ndarray) -> bool:
    keys = np.unique(triangles.reshape(-1, 3), axis=0, return_inverse=True)[1].reshape(-1, 3)
    edges = np.sort(keys[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
    return bool((np.unique(edges, axis=0, return_counts=True)[1] % 2 == 0).all())


def assert_nothing_floats(scene: Scene) -> None:
    """Whatever stands has its lowest point on the floor, whatever hangs its highest at the ceiling, but for the
    elevation drawn for it.
    """
    height = scene.parameters["layout.height_m"]
    for name in object_names(scene):
        low, high = (f(scene.corners[scene.faces_of(name)][..., 2]) for f in (np.min, np.max))
        gap = scene.parameters.get(f"{name}.elevation_m", 0.0)
        if scene.parameters.get(f"{name}.placement") == "hanging":
            np.testing.assert_allclose(high, height - gap, atol=1e-9 * height, err_msg=name)
        else:
            np.testing.assert_allclose(low, gap, atol=1e-9 * height, err_msg=name)
        if scene.parameters[f"{name}.kind"] == "pillar":
            np.testing.assert_allclose([low, high], [0, height], atol=1e-9 * height, err_msg=name)


def plan_gap(a: np.ndarray, b: np.ndarray) -> float:
    """How far apart the convex hulls of two sets of points in plan are: the largest gap along a normal of an edge."""
    a, b = convex_hull(a), convex_hull(b)
    edges = np.concatenate([np.roll(polygon, -1, axis=0) - polygon for polygon in (a, b)])
    normals = np.stack([edges[:, 1], -edges[:, 0]], axis=1) / np.linalg.norm(edges, axis=1)[:, None]
    pa, pb = normals @ a.T, normals @ b.T
    return float(np.maximum(pb.min(axis=1) - pa.max(axis=1), pa.min(axis=1) - pb.max(axis=1)).max())


def assert_keeps_clear(scene: Scene, clearance_m: float) -> None:
    """No corner of an object is nearer to a wall than the clearance, and one placed at a wall is just as far from it;
    objects are as far from each other, in plan or in height."""
    upright = room_triangles(scene, "relay_wall", "walls", "screen")
    upright = upright[np.ptp(upright[..., 2], axis=1) > 0]
    sides = np.roll(upright, -1, axis=1)[..., :2] - upright[..., :2]
    longest = np.linalg.norm(sides, axis=2).argmax(axis=1)
    start, along = upright[np.arange(len(upright)), longest, :2], sides[np.arange(len(upright)), longest]
    least = clearance_m * (1 - 1e-6) - 1e-9
    placed = {name: scene.corners[scene.faces_of(name)].reshape(-1, 3) for name in object_names(scene)}
    for name, points in placed.items():
        offset = np.unique(points[:, :2], axis=0)[:, None] - start
        t = np.clip((offset * along).sum(-1) / (along**2).sum(-1), 0, 1)
        gap = float(np.linalg.norm(offset - t[..., None] * along, axis=-1).min())
        assert gap > least, f"{name}: {gap} m to the wall"
        if scene.parameters.get(f"{name}.placement") == "wall":
            assert gap < clearance_m * (1 + 1e-3) + 1e-6, f"{name}: {gap} m from the wall it stands against"
    for (name, a), (other, b) in combinations(placed.items(), 2):
        above = max(a[:, 2].min() - b[:, 2].max(), b[:, 2].min() - a[:, 2].max())
        assert above > least or plan_gap(a[:, :2], b[:, :2]) > least, f"{name} is near {other}"


def assert_hidden_from(scene: Scene, eye: np.ndarray, rng: np.random.Generator, points: int = 100) -> None:
    """No point of an object, corners included, is in sight of `eye`; objects and clutter do not help to hide."""
    structure = room_triangles(scene)
    for name in object_names(scene):
        own = scene.corners[scene.faces_of(name)]
        on_it = np.concatenate([np.unique(own.reshape(-1, 3), axis=0), surface_points(own, points, rng)])
        assert crossing_counts(structure, eye, on_it).all(), f"{name} is in sight"


def assert_hidden(scene: Scene, rng: np.random.Generator) -> None:
    """No object is in sight of the device."""
    assert_hidden_from(scene, scene.device_position, rng)


def assert_seen_from_wall(scene: Scene, rng: np.random.Generator, points: int = 200, batches: int = 400) -> None:
    """The device sees the relay wall's rectangle, and points of it see some of every object: one pair in a thousand
    is missed once in 10⁷ objects."""
    on_wall = _on_wall(scene, rng, points)
    to_wall = on_wall + 1e-3 * (scene.device_position - on_wall)
    assert not crossing_counts(without_clutter(scene), scene.device_position, to_wall).any()
    for name in object_names(scene):
        assert any(_sees_some(scene, name, rng) for _ in range(batches)), f"{name} is not seen from the wall"


def _on_wall(scene: Scene, rng: np.random.Generator, points: int) -> np.ndarray:
    """(points, 3) uniform on the relay wall's rectangle."""
    wall = scene.relay_wall
    across, up = rng.uniform(-1, 1, (2, points, 1))
    return np.asarray(wall.center + across * wall.right + up * wall.up)


def _sees_some(scene: Scene, name: str, rng: np.random.Generator) -> bool:
    on_wall = _on_wall(scene, rng, 40)
    on_it = surface_points(scene.corners[scene.faces_of(name)], len(on_wall), rng)
    near_wall, near_it = on_wall + 1e-6 * (on_it - on_wall), on_it + 1e-6 * (on_wall - on_it)
    return bool((crossing_counts(scene.corners, near_wall, near_it) == 0).any())


def assert_frames_hold_the_objects(scene: Scene) -> None:
    """Bounds and view hold every object; view and visible part lie in the relay wall's plane and face the room."""
    low, high = scene.hidden_bounds
    view = scene.hidden_view
    for name in object_names(scene):
        corners = scene.corners[scene.faces_of(name)].reshape(-1, 3)
        assert (corners >= low - 1e-9).all() and (corners <= high + 1e-9).all(), name
        across = (corners - view.center) @ view.right
        assert (np.abs(across) <= view.right @ view.right * (1 + 1e-9)).all(), name
    # An uneven wall lies behind the plane.
    wall = scene.corners[scene.faces_of("relay_wall")]
    assert np.ptp(wall[..., 0]) == 0 or "relay_wall.kind" in scene.parameters
    for rectangle in (scene.relay_wall, view):
        np.testing.assert_allclose(rectangle.corners[:, 0], wall[..., 0].min())
        np.testing.assert_allclose(rectangle.normal, [-1, 0, 0], atol=1e-12)


def assert_no_more_is_visible(scene: Scene) -> None:
    """Just beyond each side of the visible part, and above it, the wall is out of sight or has ended."""
    wall = scene.relay_wall
    surface = scene.corners[scene.faces_of("relay_wall")]
    # Under a lintel that is out of square the rectangle ends at the lowest of the sight lines.
    above = [] if "layout.wall_0_turned_deg" in scene.parameters else [wall.up]
    for beyond in (wall.right, -wall.right, *above):
        edge = wall.center + (1 + 1e-3) * beyond
        before, behind = (edge + far * (scene.device_position - edge) for far in (1e-4, -1e-4))
        hidden = crossing_counts(scene.corners, scene.device_position[None], before[None]).any()
        assert hidden or not crossing_counts(surface, before[None], behind[None]).any()


def assert_as_declared(spec: SceneConfig, scene: Scene) -> None:
    """Parameters lie in their ranges, and the triangles and materials are those of the parameters."""
    p = scene.parameters
    declared = {f"layout.{name}": of for name, of in spec.layout.dimensions().items()}
    declared |= {n: spec.layout.out_of_square_deg for n, of in p.items() if n.endswith("_turned_deg") and of != 0}
    for name, distribution in declared.items():
        low, high = support(distribution)
        assert low <= p[name] <= high, name
    for name in ("floor", "ceiling"):
        assert (name in scene.part_names) == getattr(spec.layout, name)
    for name, material in zip(scene.part_names, scene.materials, strict=True):
        assert p[f"{name}.albedo"] == material.albedo
    np.testing.assert_allclose(np.ptp(scene.vertices[:, 2]), p["layout.height_m"], rtol=1e-12)
    for name in object_names(scene):
        corners = scene.corners[scene.faces_of(name)].reshape(-1, 3)
        np.testing.assert_allclose(np.ptp(corners[:, 2]), p[f"{name}.height_m"], rtol=1e-9)
        # Along its own axes the object is as wide and deep as was drawn, and stands where the pose says.
        turn = np.radians(p[f"{name}.rotation_deg"])
        axis = np.array([np.cos(turn), np.sin(turn)])
        for unit, size in ((axis, "width_m"), (np.array([-axis[1], axis[0]]), "depth_m")):
            reach = corners[:, :2] @ unit
            np.testing.assert_allclose(np.ptp(reach), p[f"{name}.{size}"], rtol=1e-9)
            place = unit @ [p[f"{name}.x_m"], p[f"{name}.y_m"]]
            np.testing.assert_allclose((reach.min() + reach.max()) / 2, place, atol=1e-9)


def assert_room_laws(scene: Scene, rng: np.random.Generator, clearance_m: float | None = None) -> None:
    if scene.parameters["layout.kind"] in CLOSED:
        assert_closed_surface(scene)
        assert_light_stays_inside(scene, rng)
    assert_nothing_intersects(scene)
    assert_nothing_floats(scene)
    if clearance_m is not None:
        assert_keeps_clear(scene, clearance_m)
    assert_hidden(scene, rng)
    assert_seen_from_wall(scene, rng)
    assert_frames_hold_the_objects(scene)
    assert_no_more_is_visible(scene)


MISPLACED = ("behind the plane of the relay wall", "hides", "in plain sight", "outside the room")


def assert_moved_devices(scene: Scene, rng: np.random.Generator) -> bool:
    """Fit a capture whose laser and sensor stand off the scene's device; whether it was accepted.

    Accepted, every laser point and every pixel's middle is in free sight and no object is; refused, it says why.
    """
    reach = float(rng.choice([0.05, 0.3, 1.0]))
    laser, sensor = (rng.uniform(-reach, reach, 3) * [1.0, 1.0, 0.5] for _ in range(2))
    capture = {
        "scan": {"rows": 3, "columns": 3},
        "laser_offset_m": [float(x) for x in laser],
        "sensor_offset_m": [float(x) for x in sensor],
    }
    config = config_from_mapping({"capture": capture})
    try:
        fitted = capture_for(config, scene)
    except InputError as error:
        assert any(reason in str(error) for reason in MISPLACED), error
        assert "_offset_m" in str(error), error
        assert "\n" not in str(error)
        return False
    for eye, points in (
        (fitted.laser.position, fitted.laser.targets),
        (fitted.sensor.position, fitted.sensor.pixels.mean(axis=1)),
    ):
        before = points + 1e-3 * (eye - points)
        assert not crossing_counts(without_clutter(scene), eye, before).any(), (
            "a point of the capture is out of sight"
        )
        assert_hidden_from(scene, eye, rng)
    return True
