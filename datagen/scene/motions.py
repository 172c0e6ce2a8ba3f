"""Ways of the objects that move: through free space at all times, with nothing on them that moves itself."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace

import numpy as np

from datagen.config.distributions import draw
from datagen.config.scene_motion import Jump, Motion, Points, Straight, Walk
from datagen.records import Clock, Path, Rectangle, Scalar
from datagen.scene.draws import DrawnRoom, Thing
from datagen.scene.placing import Spot, Spots, Unmet, draw_place, has_one_place
from scene_library.moving import Mover, obstacle_on_way
from scene_library.placement import FreeSpace, Obstacle
from scene_library.rooms import FloorPlan

TRIES = 40
"""Ways, legs of a walk, or places of a jump that are tried before all objects of the room are placed anew."""
WALKS = 4
"""Walks that are begun anew because one of them came to where no leg leads on."""

Pose = tuple[float, float, float]
"""x and y, metres, and the rotation about the vertical, degrees."""


@dataclass(frozen=True)
class Pace:
    """Kind of motion of an object, and its speed and turning, drawn once, as far as the kind has them."""

    kind: str
    speed_m_s: float = 0.0
    turning_deg_s: float = 0.0


def draw_paces(things: Iterable[Thing], rng: np.random.Generator) -> dict[str, Pace]:
    """Name of each object that moves → its pace. It is drawn with the room, so that fast objects, whose ways are
    harder to find, are as frequent as they are declared to be."""
    paces = dict[str, Pace]()
    for thing in things:
        motion = thing.item.motion
        if isinstance(motion, Walk | Straight):
            paces[thing.name] = Pace(motion.kind, draw(motion.speed_m_s, rng), draw(motion.turning_deg_s, rng))
        elif motion is not None:
            paces[thing.name] = Pace(motion.kind)
    return paces


def pace_parameters(paces: Mapping[str, Pace]) -> dict[str, Scalar]:
    """The numbers of paces by dotted name, for a scene's parameters."""
    return {f"{name}.motion.{key}": value for name, pace in paces.items() for key, value in asdict(pace).items()}


def first_rotation(thing: Thing, rotation_deg: float, rng: np.random.Generator) -> float:
    """The rotation with which an object is placed: that of its first point, if it moves through points and that says
    one."""
    motion = thing.item.motion
    given = motion.points[0].rotation_deg if isinstance(motion, Points) else None
    return rotation_deg if given is None else draw(given, rng)


@dataclass(frozen=True)
class Ways:
    """What the ways of a room's objects are looked for in.

    wall : the visible part of the relay wall.
    clock : frames of the sequence.
    paces : object that moves → its pace.
    """

    plan: FloorPlan
    wall: Rectangle
    clock: Clock
    paces: Mapping[str, Pace]

    def found(
        self, room: DrawnRoom, spots: Mapping[str, Spot], space: FreeSpace, rng: np.random.Generator
    ) -> dict[str, Mover]:
        """Name of each object that moves → its way. It begins at the object's place; of a walk the rotation there is
        that of its first leg, and a jump may have another place in the first frame, too.

        The objects that come first have their ways first, past all others where these stand; an object that comes
        later goes out of the way of those before it, each at the same times.

        space : with everything that stands, the objects in their order at the end. Raises `Unmet`.
        """
        movers = dict[str, Mover]()
        fixed = space.taken[: len(space.taken) - len(room.things)]
        # Each object has random numbers of its own, so that the way of one does not depend on how others were found.
        for thing, own in zip(room.things, rng.spawn(len(room.things)), strict=True):
            if thing.item.motion is None:
                continue
            standing = [o.name for o in room.things if o.name not in movers and o.name != thing.name]
            taken = [spots[o.name].space_taken(o.solid) for o in room.things if o.name in standing]
            around = replace(space, taken=[*fixed, *taken])
            movers[thing.name] = self._way(thing, spots[thing.name], around, [*movers.values()], own)
        return movers

    def _way(
        self, thing: Thing, spot: Spot, space: FreeSpace, others: Sequence[Mover], rng: np.random.Generator
    ) -> Mover:
        obstacles: Counter[Obstacle] = Counter()

        def is_free(mover: Mover, start_s: float, end_s: float) -> bool:
            found = obstacle_on_way(space, mover, others, start_s, end_s)
            if found is not None:
                obstacles[found] += 1
            return found is None

        mover = _Search(thing, spot, self, space.clearance_m, is_free, rng).of(thing.item.motion)
        if mover is None:
            raise Unmet(thing.where, f"way {obstacles.most_common(1)[0][0]}")
        return mover


def path_of(mover: Mover) -> Path:
    """The path of the part that a mover is, whose mesh stands at the origin."""
    places = np.column_stack([mover.poses[:, :2], np.full(len(mover.poses), mover.bottom_m)])
    return Path(mover.times_s, places, mover.poses[:, 2])


@dataclass(frozen=True)
class _Search:
    """The search for the way of one object.

    is_free : (way, start, end) → whether nothing is in the way between these times.
    """

    thing: Thing
    spot: Spot
    ways: Ways
    clearance_m: float
    is_free: Callable[[Mover, float, float], bool]
    rng: np.random.Generator

    def of(self, motion: Motion | None) -> Mover | None:
        """A free way, or None if none was found."""
        match motion:
            case Walk():
                walks = (self._walk(motion) for _ in range(WALKS))
                return next((walk for walk in walks if walk is not None), None)
            case Straight():
                return self._first_free(self._straight, 1 if self._pace.speed_m_s == 0 else TRIES)
            case Points():
                later = motion.points[1:]
                is_drawn = any(not has_one_place(p) or not isinstance(p.rotation_deg, float | None) for p in later)
                return self._first_free(lambda: self._through(motion), TRIES if is_drawn else 1)
            case Jump():
                return self._jumps()
        raise TypeError(f"no way is known for {type(motion).__name__}")

    def _first_free(self, draw_way: Callable[[], Mover], tries: int) -> Mover | None:
        ways = (draw_way() for _ in range(tries))
        return next((way for way in ways if self.is_free(way, 0.0, self._duration_s)), None)

    def _walk(self, motion: Walk) -> Mover | None:
        pace = self._pace
        times, poses = [0.0], [(self.spot.x_m, self.spot.y_m, 0.0)]
        while times[-1] < self._duration_s:
            for _ in range(TRIES):
                x, y, before = poses[-1]
                direction, length_m = 2 * np.pi * self.rng.random(), draw(motion.leg_m, self.rng)
                # The front looks along −y.
                rotation = np.degrees(direction) + 90.0
                if len(times) == 1:
                    begun_s, begun = [0.0], [(x, y, rotation % 360.0)]
                else:
                    rotation = before + (rotation - before + 180.0) % 360.0 - 180.0
                    turned_s = times[-1] + abs(rotation - before) / pace.turning_deg_s
                    begun_s, begun = [*times, turned_s], [*poses, (x, y, rotation)]
                end = x + length_m * np.cos(direction), y + length_m * np.sin(direction), begun[-1][2]
                way = self._mover([*begun_s, begun_s[-1] + length_m / pace.speed_m_s], [*begun, end])
                if self.is_free(way, times[-1], float(way.times_s[-1])):
                    times, poses = way.times_s.tolist(), [*map(tuple, way.poses.tolist())]
                    break
            else:
                return None
        return self._mover(times, poses)

    def _straight(self) -> Mover:
        direction, duration = 2 * np.pi * self.rng.random(), self._duration_s
        x, y, rotation = self.spot.pose
        long, turned = self._pace.speed_m_s * duration, self._pace.turning_deg_s * duration
        end = x + long * np.cos(direction), y + long * np.sin(direction), rotation + turned
        return self._mover([0.0, duration], [(x, y, rotation), end])

    def _through(self, motion: Points) -> Mover:
        poses = [self.spot.pose]
        for point in motion.points[1:]:
            rotation = poses[-1][2] if point.rotation_deg is None else draw(point.rotation_deg, self.rng)
            spot = draw_place(point, self.ways.plan, self.ways.wall, self.spot.z_m, rotation, self.rng)
            poses.append((spot.x_m, spot.y_m, rotation))
        return self._mover([point.time_s for point in motion.points], poses)

    def _jumps(self) -> Mover | None:
        clock, item = self.ways.clock, self.thing.item
        ends = np.append(clock.starts_s, clock.duration_s)
        spots = Spots.of(self.thing, self.ways.plan, self.ways.wall, self.clearance_m)
        poses = [self.spot.pose]
        for frame in range(clock.frames):
            for trial in range(TRIES):
                if frame or trial:
                    spot = spots.draw(draw(item.rotation_deg, self.rng), self.rng)
                    poses[frame:] = [spot.pose]
                standing = self._mover([ends[frame]], poses[frame:])
                if self.is_free(standing, float(ends[frame]), float(ends[frame + 1])):
                    break
            else:
                return None
        # It stands until the next frame begins, and then has jumped.
        times = np.repeat(ends, 2)[1:-1]
        return Mover(self.thing.solid, self.spot.z_m, times, np.repeat(np.array(poses), 2, axis=0))

    @property
    def _pace(self) -> Pace:
        return self.ways.paces[self.thing.name]

    @property
    def _duration_s(self) -> float:
        return self.ways.clock.duration_s

    def _mover(self, times_s: Sequence[float], poses: Sequence[Pose]) -> Mover:
        """The way through some poses, up to the end of the sequence."""
        whole = Mover(self.thing.solid, self.spot.z_m, np.array(times_s), np.array(poses))
        within = whole.times_s < self._duration_s
        if within.all():
            return whole
        last = [whole.pose(self._duration_s)]
        return replace(
            whole, times_s=np.append(whole.times_s[within], self._duration_s),
            poses=np.concatenate([whole.poses[within], last]),
        )  # fmt: skip
