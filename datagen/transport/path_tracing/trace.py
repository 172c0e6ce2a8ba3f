"""One walk of light from a run of laser points: the vertices of the orders asked for are joined to the FoV.

A walk gives all orders at once. Where orders are found apart (`meet_target.py`) it still visits the vertices of lower
orders but saves their connections, which are most of its cost.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, fields, replace

import numpy as np

from datagen.records import Accuracy, Capture, Laser, Scene, Sensor
from datagen.records.arrays import Bools, Ints
from datagen.seeding import LightStream
from datagen.transport.brdf import MaterialTable
from datagen.transport.error_control import cost
from datagen.transport.error_control.cost import Work
from datagen.transport.fields_of_view import FovPool, PixelCones, PixelPatches, fov_pool
from datagen.transport.path_tracing import vertices as ends
from datagen.transport.path_tracing.connections import Clock, Receiver, Rows, Tally
from datagen.transport.path_tracing.vertices import SOBOL_STEPS, AreaTarget, LaserPoints
from datagen.transport.sampling import Streams
from datagen.transport.visibility.clear_sight import ClearSight
from datagen.transport.visibility.raycast import Raycaster
from datagen.units import path_from_time

COMPONENTS: tuple[str, ...] = ("direct", "primary", "secondary", "higher")
FOV_POINTS_PER_POOL = 1 << 19
"""FoV points kept at once, over all pixels of a chunk."""
ROULETTE_FROM = 4
"""Bounce order of the first vertices that Russian roulette may end, when all orders are followed."""
LIVES_PER_WINDOW = 1.0
"""Mean free paths of the roulette in the window: weights within it grow to e at most, and not with every bounce."""
SURVIVAL_BEYOND = 0.95
"""Survival at each bounce of light that comes after the window: what ends every walk."""
SURVIVAL_AT_LEAST = 0.05
"""So that no weight grows by more than its inverse at once."""


def _component_of(order: int) -> str:
    """The component that paths of `order` bounces belong to."""
    return "direct" if order < 3 else "primary" if order == 3 else "secondary" if order == 4 else "higher"


def components_asked(accuracy: Accuracy) -> tuple[str, ...]:
    """The components that an accuracy asks for, in the order of `COMPONENTS`."""
    orders = accuracy.max_bounces or 5
    asked = {
        "direct": accuracy.direct,
        "primary": True,
        "secondary": orders >= 4 and accuracy.secondary != "none",
        "higher": orders >= 5,
    }
    return tuple(name for name in COMPONENTS if asked[name])


@dataclass(frozen=True)
class Splits:
    """Rows of the tally for each laser point and pixel: one for each part of the primary (or one for all of it), then
    one for each other component.

    Attributes
    ----------
    parts : names of the parts that the primary is split by; none for all of it in one row.
    components : those computed.
    all_parts : how many parts the scene has.
    """

    parts: tuple[str, ...]
    components: tuple[str, ...]
    all_parts: int

    @property
    def primary(self) -> int:
        """How many rows the primary takes."""
        return max(len(self.parts), 1) if "primary" in self.components else 0

    @property
    def others(self) -> tuple[str, ...]:
        """The components other than the primary, in order."""
        return tuple(name for name in self.components if name != "primary")

    @property
    def count(self) -> int:
        """Rows for each laser point and pixel."""
        return self.primary + len(self.others)

    def of_part(self, order: int) -> Ints:
        """(K,) the row of a contribution of `order` bounces that comes from a vertex on each part."""
        name = _component_of(order)
        if name == "primary":
            return np.arange(self.all_parts) if self.parts else np.zeros(self.all_parts, np.int64)
        return np.full(self.all_parts, self.primary + self.others.index(name))


@dataclass(frozen=True)
class WalkTask:
    """What is looked at, how finely, and the scene as the kernels want it.

    `capture`, `cones`, `patches` and `points` may be some laser points (and, confocally, their pixels) of a larger
    capture. The components computed are those of `splits`.
    """

    scene: Scene
    capture: Capture
    accuracy: Accuracy
    caster: Raycaster
    materials: MaterialTable
    cones: PixelCones
    patches: PixelPatches
    points: LaserPoints
    aim: Callable[[], AreaTarget]
    """What lookins are aimed at, for which rays are traced, once they are drawn: cells draw none."""
    seed: int
    splits: Splits
    sight: ClearSight
    walked: Bools
    """(K,) parts whose vertices the walk joins to the FoV in fourth-bounce paths; the others are left out, or left to
    the factorised form of `secondary.py`."""

    @property
    def last_order(self) -> int | None:
        """The highest order to be followed; None for all."""
        asked = self.splits.components
        if "higher" in asked:
            return self.accuracy.max_bounces
        return 4 if "secondary" in asked and self.walked.any() else 3

    def patch_detail(self, pixels: Ints) -> float:
        """How many details the largest patch of some pixels is across: arrival times vary by the bin, amplitudes by
        some hundredth of the scene."""
        detail_m = min(float(path_from_time(self.capture.time.width_s)), self.caster.half_extent_m / 50)
        return 2 * float(self.patches.radius[pixels].max()) / detail_m


def part_of(task: WalkTask, lasers: Ints) -> WalkTask:
    """The same task for some of its laser points (confocally, and their pixels), or for several copies of them."""
    points = LaserPoints(**{f.name: getattr(task.points, f.name)[lasers] for f in fields(task.points)})
    sensor, cones, patches, sight = task.capture.sensor, task.cones, task.patches, task.sight
    if task.capture.pairing == "confocal":
        sensor = Sensor(sensor.position, sensor.pixels[lasers], sensor.aperture_radius_m, sensor.finite_aperture)
        cones, patches, sight = cones.take(lasers), patches.take(lasers), sight.take(lasers)
    laser = Laser(task.capture.laser.position, task.capture.laser.targets[lasers])
    capture = Capture(laser, sensor, task.capture.time, task.capture.pairing)
    return replace(task, capture=capture, cones=cones, patches=patches, points=points, sight=sight)


def trace_chunk(task: WalkTask, chunk: Ints, pool: FovPool, count: int, streams: Streams) -> tuple[Tally, Work]:
    """The light from a run of consecutive laser points, and the work of finding it.

    streams : the random numbers of each of the task's laser points. pool : as many sets of FoV points as the run has
    replicates, in the order of their first laser points; confocally one, with each laser point's own pixel.
    """
    receiver = _receiver(task, chunk, pool, streams)
    asked, last = task.splits.components, task.last_order
    rays, connections = 0, 0
    per_vertex = task.accuracy.fov_samples * (1 if receiver.rows.confocal else receiver.rows.pixels)
    if "direct" in asked:
        _add_direct(task, receiver, chunk, count, streams)
        rays += count * len(chunk)
        connections += count * len(chunk) * per_vertex
    if asked == ("direct",):
        return receiver.tally, Work(rays, connections, receiver.tally.histogram.size)
    vertices = ends.draw_lookins(
        task.caster, task.scene, task.materials, task.points, chunk, count, task.aim(), streams,
        SOBOL_STEPS + 1 if last is None else last - 2,
    )  # fmt: skip
    rays += count * len(chunk)
    axis = task.capture.time
    window_end_m = max(float(path_from_time(axis.start_s + axis.bins * axis.width_s)), 1e-9)
    order = 3
    while len(vertices):
        numbers = vertices.numbers(order - 3)
        name = _component_of(order)
        joined = np.arange(len(vertices)) if name in asked else np.empty(0, np.int64)
        if order == 4:
            joined = joined[task.walked[vertices.part[joined]]]
        if len(joined):
            split_of_part = task.splits.of_part(order)
            receiver.connect(vertices.take(joined), numbers[joined, 0], split_of_part)
            connections += len(joined) * per_vertex
        if order == last:
            joined = joined[receiver.near(vertices.take(joined))]
            vertices, numbers, joined = vertices.take(joined), numbers[joined], np.arange(len(joined))
        hits, directions, throughput = ends.scattered_rays(task.caster, task.materials, vertices, numbers)
        rays += len(vertices)
        if len(joined):
            receiver.follow(
                vertices.take(joined), hits.take(joined), directions[joined], throughput[joined], split_of_part
            )
        if order == last:
            break
        if last is None and order >= ROULETTE_FROM:
            # Within the window light that loses nothing is ended by the metre, not by the bounce: a path that bounces
            # to and fro in a corner would else come out of it with a weight beyond all bounds.
            metres = np.linalg.norm(np.where(hits.valid[:, None], hits.position - vertices.position, 0.0), axis=1)
            stays = np.where(
                vertices.path > window_end_m, SURVIVAL_BEYOND, np.exp(-LIVES_PER_WINDOW * metres / window_end_m)
            )
            survival = np.clip(throughput * stays, SURVIVAL_AT_LEAST, 1.0)
            throughput = np.where(numbers[:, 3] < survival, throughput / survival, 0.0)
        vertices = ends.continued(task.scene, vertices, hits, directions, throughput)
        order += 1
    return receiver.tally, Work(rays, connections, receiver.tally.histogram.size, 1 + cost.ORDER_CALL * (order - 3))


def _add_direct(task: WalkTask, receiver: Receiver, chunk: Ints, count: int, streams: Streams) -> None:
    """One bounce: the laser point seen by a pixel. Two: a surface in the FoV that the laser point lights."""
    split_of_part = task.splits.of_part(2)
    receiver.add_laser_points(task.points, chunk, int(split_of_part[0]))
    vertices = ends.laser_point_vertices(task.points, chunk, count, streams, task.scene.attenuation_per_m)
    numbers = vertices.numbers(0)
    receiver.connect(vertices, numbers[:, 0], split_of_part)
    near = receiver.near(vertices)
    vertices, numbers = vertices.take(near), numbers[near]
    hits, directions, throughput = ends.scattered_rays(task.caster, task.materials, vertices, numbers)
    receiver.follow(vertices, hits, directions, throughput, split_of_part)


def _receiver(task: WalkTask, chunk: Ints, pool: FovPool, streams: Streams) -> Receiver:
    _, pixels, bins = task.capture.shape
    confocal = task.capture.pairing == "confocal"
    axis = task.capture.time
    seen = chunk if confocal else np.arange(pixels)
    device_leg = task.points.leg[chunk] if axis.origin == "source" else np.full(len(chunk), -1.0)
    rows = len(chunk) * pixels * task.splits.count
    pool_set = None if pool.sets == 1 else np.unique(streams.replicate[chunk], return_inverse=True)[1]
    return Receiver(
        task.caster, task.scene, task.materials, task.capture.sensor, pool, task.cones.take(seen),
        task.patches.take(seen), task.accuracy.fov_samples,
        Clock(1.0 / float(path_from_time(axis.width_s)), axis.start_s / axis.width_s, device_leg),
        Rows(int(chunk[0]), confocal, pixels, task.splits.count),
        Tally(np.zeros((rows, bins)), np.zeros(rows)), task.sight, pool_set,
    )  # fmt: skip


def blocks_for(task: WalkTask, pixels: Ints, count: int) -> int:
    """Enough blocks of FoV points for what varies across the pixel, never more than lookins to use them or memory to
    hold them; a power of two, so that they cover the pixel evenly."""
    samples = task.accuracy.fov_samples
    across = task.patch_detail(pixels)
    useful = 64 * (1 + across) ** 2 / samples
    affordable = FOV_POINTS_PER_POOL / (len(pixels) * samples)
    return 1 << max(0, int(min(count, affordable, useful)).bit_length() - 1)


def pool_for(task: WalkTask, pixels: Ints, blocks: int, streams: Streams) -> FovPool:
    """So many blocks of FoV points for each of `pixels`, which may repeat; `streams` has a row for each."""
    return fov_pool(
        task.caster, task.scene, task.capture.sensor, task.cones, pixels, task.accuracy.fov_samples, blocks,
        streams.seeds(LightStream.FOV_POINTS, np.arange(len(pixels))),
    )  # fmt: skip
