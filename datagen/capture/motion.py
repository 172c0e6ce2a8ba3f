"""How laser and sensor of a scene move from frame to frame: together, as one rigid thing, on a way that is free."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.spatial.transform import Rotation

from datagen.capture.devices import has_elbow_room
from datagen.capture.in_sight import in_plain_sight
from datagen.config import DatasetConfig
from datagen.config.capture_motion import DrawnMotion, Drive, GivenPlaces, Hand, SensorPoint, SensorPoints
from datagen.config.distributions import Distribution, draw
from datagen.errors import InputError
from datagen.records import Capture, Clock, Path, Rectangle, Scalar, Scene
from datagen.records.arrays import Bools, Floats
from datagen.seeding import Purpose, generator
from scene_library.sightlines import first_faces

TRIES = 40
"""Ways that are tried before a motion is refused."""
STEP_M = 0.02
"""A way is checked at so many metres, as those of objects are, and when frames begin."""
MOST_CHECKS = 4096
SINES = 3
"""Sines of which a sway is the sum, for place and direction each."""
WALL_POINTS = 7
"""Points along each side of the relay wall of which a given place has to see one, or it is in no room."""

Poses = tuple[Floats, Floats]
"""(n, 3) metres from where a sensor stands, and (n, 3) rotation vectors, radians, from how it stands."""


@dataclass(frozen=True)
class SensorWay:
    """A way of a sensor.

    at : times (n,), seconds → poses.
    parameters : what was drawn, by name, for a sample's parameters.
    """

    at: Callable[[Floats], Poses]
    parameters: Mapping[str, Scalar]

    def captures(self, capture: Capture, times_s: Floats) -> tuple[Capture, ...]:
        """The capture at each of some times (n,), from that of the sensor as it stands."""
        return tuple(moved_capture(capture, *pose) for pose in zip(*self.at(times_s), strict=True))


def moved_capture(capture: Capture, shift_m: Floats, turn_rad: Floats) -> Capture:
    """A capture after a turn of laser and sensor about the sensor's place by a rotation vector (3,), and a shift
    (3,); the same one if both are 0."""
    if not shift_m.any() and not turn_rad.any():
        return capture
    laser, sensor, turn = capture.laser, capture.sensor, Rotation.from_rotvec(turn_rad)
    about = sensor.position

    def place(points: Floats) -> Floats:
        turned = turn.apply((points - about).reshape(-1, 3)).reshape(points.shape)
        return np.asarray(about + shift_m + turned)

    cells = None if laser.cells is None else place(laser.cells)
    return replace(
        capture,
        laser=replace(laser, position=place(laser.position), targets=place(laser.targets), cells=cells),
        sensor=replace(sensor, position=about + shift_m, pixels=place(sensor.pixels)),
    )


def sensor_way(
    config: DatasetConfig, scene: Scene, capture: Capture, index: int, clock: Clock | None = None
) -> SensorWay | None:
    """The way of the sensor of scene `index`, as `capture.motion` asks for; None if it stands, or if its captures are
    given.

    The sensor stays in the room, `ELBOW_ROOM_M` from everything; objects that are hidden from where it begins stay
    hidden; a scan that is not a device's own stays on the relay wall. Ways are drawn anew until one keeps to that.

    capture : of the sensor as it stands. clock : of the sequence; left out, as configured.

    Raises
    ------
    InputError : none of `TRIES` ways keeps to that; the scene names no relay wall.
    """
    motion, clock = config.capture.motion, config.clock if clock is None else clock
    if motion is None or clock is None or isinstance(motion, GivenPlaces):
        return None
    if scene.relay_wall is None:
        raise InputError("capture.motion: this scene names no relay wall, which places and bearings count from")
    rng = generator(config.seed, index, Purpose.SENSOR_MOTION)
    laws = _Laws(scene, capture, motion, clock, config.capture.device is None)
    refused = Counter[str]()
    for way in _ways(motion, scene, scene.relay_wall, capture, rng):
        why = laws.broken_by(way)
        if why is None:
            return way
        refused[why] += 1
    tries = refused.total()
    which, often = ("the way", "") if tries == 1 else (f"all of {tries} ways", ", most often")
    raise InputError(
        f"capture.motion.kind = {motion.kind!r}: in scene {index} {which} had to be refused{often} since "
        f"{refused.most_common(1)[0][0]}; {_REMEDIES[motion.kind]}"
    )


_REMEDIES = {
    "hand": "lower sway_mm or sway_deg, or make the scan smaller",
    "drive": "lower speed_m_s, allow other bearings, or take fewer frames",
    "points": "give other places",
}


def _ways(
    motion: DrawnMotion, scene: Scene, wall: Rectangle, capture: Capture, rng: np.random.Generator
) -> Iterator[SensorWay]:
    """The ways to be tried, `TRIES` of them, or one where nothing of it is drawn. How far and how fast the sensor
    moves is drawn once, so that those of which fewer are free are not rarer than declared."""
    match motion:
        case Hand():
            sway_mm, sway_deg = draw(motion.sway_mm, rng), draw(motion.sway_deg, rng)
            fastest_hz = draw(motion.fastest_hz, rng)
            for _ in range(TRIES):
                yield _sway(sway_mm, sway_deg, fastest_hz, rng)
        case Drive():
            speed = draw(motion.speed_m_s, rng)
            for _ in range(TRIES if _is_drawn(motion.bearing_deg) else 1):
                yield _drive(speed, draw(motion.bearing_deg, rng), wall)
        case SensorPoints():
            keys = ("along", "across", "distance_m", "offset_m", "height_m", "rotation_deg")
            drawn = any(_is_drawn(getattr(point, key)) for point in motion.points for key in keys)
            for _ in range(TRIES if drawn else 1):
                yield _through(motion, scene, wall, capture.sensor.position, rng)


def _is_drawn(key: Distribution | None) -> bool:
    return not isinstance(key, int | float | None)


def _sway(sway_mm: float, sway_deg: float, fastest_hz: float, rng: np.random.Generator) -> SensorWay:
    """Sums of sines, each in a direction of its own, whose amplitudes sum to the greatest sway."""
    amplitude = rng.dirichlet(np.ones(SINES), size=2)[..., None] * [[[1e-3 * sway_mm]], [[np.radians(sway_deg)]]]
    direction = rng.normal(size=(2, SINES, 3))
    direction /= np.linalg.norm(direction, axis=-1, keepdims=True)
    hz, phase = fastest_hz * rng.random((2, SINES)), 2 * np.pi * rng.random((2, SINES))

    def at(times_s: Floats) -> Poses:
        waves = np.sin(2 * np.pi * hz[:, None] * np.asarray(times_s)[None, :, None] + phase[:, None])
        shifts, turns = waves @ (amplitude * direction)
        return shifts, turns

    return SensorWay(at, {"kind": "hand", "sway_mm": sway_mm, "sway_deg": sway_deg, "fastest_hz": fastest_hz})


def _drive(speed_m_s: float, bearing_deg: float, wall: Rectangle) -> SensorWay:
    along, bearing = np.array([wall.right[0], wall.right[1], 0.0]), np.radians(bearing_deg)
    along /= np.linalg.norm(along)
    # The relay wall's normal, right × up, points into the room.
    towards = np.array([-along[1], along[0], 0.0])
    velocity = speed_m_s * (np.cos(bearing) * along + np.sin(bearing) * towards)

    def at(times_s: Floats) -> Poses:
        shifts = np.asarray(times_s)[:, None] * velocity
        return shifts, np.zeros_like(shifts)

    return SensorWay(at, {"kind": "drive", "speed_m_s": speed_m_s, "bearing_deg": bearing_deg})


def _through(
    motion: SensorPoints, scene: Scene, wall: Rectangle, standing: Floats, rng: np.random.Generator
) -> SensorWay:
    places, headings = list[Floats](), list[float]()
    height, heading = float(standing[2]), 0.0
    for point in motion.points:
        height = height if point.height_m is None else draw(point.height_m, rng)
        heading = heading if point.rotation_deg is None else draw(point.rotation_deg, rng)
        places.append(np.array([*_place(point, scene, wall, rng), height]))
        headings.append(heading)
    path = Path([point.time_s for point in motion.points], np.array(places), headings)

    def at(times_s: Floats) -> Poses:
        moves = path.at(times_s)
        turns = np.zeros_like(moves.shifts_m)
        turns[:, 2] = moves.turns_rad
        return moves.shifts_m - standing, turns

    return SensorWay(at, {"kind": "points"})


def _place(point: SensorPoint, scene: Scene, wall: Rectangle, rng: np.random.Generator) -> tuple[float, float]:
    """x and y of a point, which counts as places of objects do."""
    if scene.hidden_bounds is None:
        raise InputError("capture.motion.points: this scene has no hidden_bounds, which along and across count in")
    (x0, y0), (x1, y1) = scene.hidden_bounds[:, :2]
    if point.along is not None:
        x = x0 + draw(point.along, rng) * (x1 - x0)
    else:
        assert point.distance_m is not None
        x = wall.center[0] - draw(point.distance_m, rng)
    if point.across is None:
        assert point.offset_m is not None
        return float(x), float(wall.center[1] + draw(point.offset_m, rng) * np.sign(wall.right[1]))
    across = draw(point.across, rng)
    # A hidden part to the left is entered at its low-y side.
    entered_low = scene.parameters.get("layout.turn") != "right"
    return float(x), float(y0 + across * (y1 - y0) if entered_low else y1 - across * (y1 - y0))


@dataclass(frozen=True)
class _Laws:
    """What a way has to keep to.

    standing : the capture of the sensor as it stands. stays_on_wall : whether laser points and pixels do.
    """

    scene: Scene
    standing: Capture
    motion: DrawnMotion
    clock: Clock
    stays_on_wall: bool

    def broken_by(self, way: SensorWay) -> str | None:
        """Which law a way breaks first, as a clause; None if it keeps to all."""
        times = self._times(way)
        # One by one: most ways that break a law do so soon.
        captures = (moved_capture(self.standing, *pose) for pose in zip(*way.at(times), strict=True))
        first = moved_capture(self.standing, *(of[0] for of in way.at(times[:1])))
        hidden, before = self._hidden_objects(first), self.standing
        if isinstance(self.motion, SensorPoints) and first is not self.standing:
            before = first
            if not _is_in_room(self.scene.at(0.0), first.sensor.position):
                return "its first place is outside of the room: it sees nothing of the relay wall"
        for time_s, capture in zip(times.tolist(), captures, strict=True):
            if capture is not self.standing and (why := self._broken_at(time_s, before, capture, hidden)):
                return why
            before = capture
        return None

    def _broken_at(self, time_s: float, before: Capture, now: Capture, hidden: list[str]) -> str | None:
        scene = self.scene.at(time_s) if self.scene.moving else self.scene
        corners, wall, when = scene.corners, scene.relay_wall, f"at {time_s:.3g} s"
        assert wall is not None
        for device in ("laser", "sensor"):
            start, end = getattr(before, device).position, getattr(now, device).position
            is_behind = (end - wall.center) @ np.cross(wall.right, wall.up) <= 0
            is_cut = (start != end).any() and first_faces(corners, start, end[None], slack=0.0)[0] >= 0
            if is_behind or is_cut or not has_elbow_room(corners, end):
                return f"something stands in its way {when}"
        seen = in_plain_sight(scene, now.sensor.position, hidden)
        if seen:
            return f"{seen[0]!r}, which has to stay hidden, comes into plain sight {when}"
        if self.stays_on_wall and not (_on_relay_wall(scene, now) | ~self._on_wall).all():
            return f"its laser points or pixels leave the relay wall {when}"
        return None

    def _times(self, way: SensorWay) -> Floats:
        """When a way is checked."""
        frames, end = self.clock.frames, self.clock.duration_s
        shifts, _ = way.at(np.linspace(0.0, end, 16 * frames + 1))
        length_m = float(np.linalg.norm(np.diff(shifts, axis=0), axis=1).sum())
        steps = frames * int(np.ceil(max(length_m / STEP_M, 1.0) / frames))
        return np.linspace(0.0, end, min(steps, max(MOST_CHECKS, frames)) + 1)

    def _hidden_objects(self, first: Capture) -> list[str]:
        """Objects that are hidden from where the sensor stands; a device begins where its first point is."""
        starts = isinstance(self.motion, SensorPoints) and not self.stays_on_wall
        scene, eye = self.scene.at(0.0), (first if starts else self.standing).sensor.position
        seen = in_plain_sight(scene, eye, scene.objects)
        return [name for name in scene.objects if name not in seen]

    @cached_property
    def _on_wall(self) -> Bools:
        return _on_relay_wall(self.scene.at(0.0), self.standing)


def _on_relay_wall(scene: Scene, capture: Capture) -> Bools:
    """(L + P,) whether each laser ray, and the ray through the middle of each pixel, first meets the relay wall."""
    relay, laser, sensor = np.array([role == "relay_wall" for role in scene.roles]), capture.laser, capture.sensor
    faces = [
        first_faces(scene.corners, laser.position, laser.targets, slack=-np.inf),
        first_faces(scene.corners, sensor.position, sensor.pixels.mean(axis=1), slack=-np.inf),
    ]
    face = np.concatenate(faces)
    return np.asarray((face >= 0) & relay[scene.face_part[face]])


def _is_in_room(scene: Scene, place: Floats) -> bool:
    """Whether a place sees any of some points of the relay wall's visible part, from before it."""
    wall = scene.relay_wall
    assert wall is not None
    if (place - wall.center) @ np.cross(wall.right, wall.up) <= 0:
        return False
    steps = np.linspace(-0.9, 0.9, WALL_POINTS)
    points = (wall.center + steps[:, None, None] * wall.right + steps[None, :, None] * wall.up).reshape(-1, 3)
    face = first_faces(scene.corners, place, points)
    relay = np.array([role == "relay_wall" for role in scene.roles])
    return bool(((face < 0) | relay[scene.face_part[face]]).any())
