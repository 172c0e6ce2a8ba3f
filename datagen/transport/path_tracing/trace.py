"""Path tracing from a run of laser points: draw hidden vertices, connect them with the pixels' FoV points, bounce.

One path serves all orders of bounces: connecting its first hidden vertex gives a path of three bounces, the next one
a path of four. Vertices of orders that the problem does not ask for are passed through but not connected, which saves
most of their cost.
"""

from __future__ import annotations

import numpy as np

from datagen.records.arrays import Ints
from datagen.seeding import LightStream
from datagen.transport.error_control import cost
from datagen.transport.error_control.cost import Work
from datagen.transport.fields_of_view import FovPool, fov_pool
from datagen.transport.memory import VALUES_AT_ONCE
from datagen.transport.path_tracing import vertices as ends
from datagen.transport.path_tracing.connections import Clock, Receiver, Rows, Tally
from datagen.transport.path_tracing.vertices import SOBOL_STEPS
from datagen.transport.problem import Problem, component_of
from datagen.transport.sampling import ROULETTE_FROM, SURVIVAL, Streams
from datagen.units import path_from_time


def trace_chunk(problem: Problem, chunk: Ints, pool: FovPool, count: int, streams: Streams) -> tuple[Tally, Work]:
    """The light (row, bin) of a run of consecutive laser points, and the work that it took.

    chunk : indices of the laser points. count : first hidden vertices of each. streams : the random numbers of each
    of the problem's laser points. pool : FoV points, with one set for each replicate in the run, in the order of the
    replicates; confocally one set, with the FoV points of each laser point's own pixel.
    """
    receiver = _receiver(problem, chunk, pool, streams)
    requested, last = problem.tally_rows.components, problem.last_order
    rays, connections, bright = 0, 0, 0
    per_vertex = problem.accuracy.fov_samples * (1 if receiver.rows.confocal else receiver.rows.pixels)
    if "direct" in requested:
        bright += _add_direct(problem, receiver, chunk, count, streams)
        rays += count * len(chunk)
        connections += count * len(chunk) * per_vertex
    if requested == ("direct",):
        return receiver.tally, Work(rays, connections, receiver.tally.histogram.size, bright=bright)
    vertices = ends.draw_hidden_vertices(
        problem.caster, problem.scene, problem.materials, problem.points, chunk, count, problem.aim(), streams,
        SOBOL_STEPS + 1 if last is None else last - 2,
    )  # fmt: skip
    rays += count * len(chunk)
    axis = problem.capture.time
    window_end_m = max(float(path_from_time(axis.start_s + axis.bins * axis.width_s)), 1e-9)
    order = 3
    while len(vertices.laser):
        numbers = vertices.numbers(order - 3)
        name = component_of(order)
        connected = np.arange(len(vertices.laser)) if name in requested else np.empty(0, np.int64)
        # What the factorised form adds is not connected here.
        if order == 4:
            connected = connected[problem.walked[vertices.part[connected]]]
        if len(connected):
            split_of_part = problem.tally_rows.of_part(order)
            bright += receiver.connect(vertices.take(connected), numbers[connected, 0], split_of_part)
            connections += len(connected) * per_vertex
        # At the last order a ray serves no further bounce, only vertices near a pixel's patch.
        if order == last:
            connected = connected[receiver.near(vertices.take(connected))]
            vertices, numbers, connected = vertices.take(connected), numbers[connected], np.arange(len(connected))
        hits, directions, throughput = ends.scattered_rays(problem.caster, problem.materials, vertices, numbers)
        rays += len(vertices.laser)
        if len(connected):
            receiver.follow(
                vertices.take(connected),
                hits.take(connected),
                directions[connected],
                throughput[connected],
                split_of_part,
            )
        if order == last:
            break
        if last is None and order >= ROULETTE_FROM:
            # Within the window the chance to survive falls with each metre of path, not with each bounce: a path that
            # bounces to and fro in a narrow corner would otherwise come out of it with a weight without bound. On a
            # length as long as the window weights grow e-fold.
            metres = np.linalg.norm(np.where(hits.valid[:, None], hits.position - vertices.position, 0.0), axis=1)
            stays = np.where(vertices.path > window_end_m, SURVIVAL[1], np.exp(-metres / window_end_m))
            survival = np.clip(throughput * stays, SURVIVAL[0], 1.0)
            throughput = np.where(numbers[:, 3] < survival, throughput / survival, 0.0)
        vertices = ends.continued(problem.scene, vertices, hits, directions, throughput)
        order += 1
    calls = 1 + cost.ORDER_CALL * (order - 3)
    return receiver.tally, Work(rays, connections, receiver.tally.histogram.size, calls, bright)


def _add_direct(problem: Problem, receiver: Receiver, chunk: Ints, count: int, streams: Streams) -> int:
    """Number of connections that could carry energy, after adding the direct light to the receiver.

    Paths of one bounce: a pixel sees the laser point. Of two: the laser point lights a surface in the field of view.
    One bounce of a beam that states its cells is left to `one_bounce_of_beam`.
    """
    split_of_part = problem.tally_rows.of_part(2)
    if problem.capture.laser.cells is None:
        receiver.add_laser_points(problem.points, chunk, int(split_of_part[0]))
    if problem.accuracy.max_bounces == 1:
        return 0
    vertices = ends.laser_point_vertices(problem.points, chunk, count, streams, problem.scene.attenuation_per_m)
    numbers = vertices.numbers(0)
    bright = receiver.connect(vertices, numbers[:, 0], split_of_part)
    near = receiver.near(vertices)
    vertices, numbers = vertices.take(near), numbers[near]
    hits, directions, throughput = ends.scattered_rays(problem.caster, problem.materials, vertices, numbers)
    receiver.follow(vertices, hits, directions, throughput, split_of_part)
    return bright


def _receiver(problem: Problem, chunk: Ints, pool: FovPool, streams: Streams) -> Receiver:
    """The receiver of a run of laser points, with an empty tally."""
    _, pixels, bins = problem.capture.shape
    confocal = problem.capture.pairing == "confocal"
    axis = problem.capture.time
    seen = chunk if confocal else np.arange(pixels)
    device_leg = problem.points.leg[chunk] if axis.origin == "source" else np.full(len(chunk), -1.0)
    rows = len(chunk) * pixels * problem.tally_rows.count
    pool_set = None if pool.sets == 1 else np.unique(streams.replicate[chunk], return_inverse=True)[1]
    return Receiver(
        problem.caster, problem.scene, problem.materials, problem.capture.sensor, pool, problem.cones.take(seen),
        problem.patches.take(seen), problem.accuracy.fov_samples,
        Clock(1.0 / float(path_from_time(axis.width_s)), axis.start_s / axis.width_s, device_leg),
        Rows(int(chunk[0]), confocal, pixels, problem.tally_rows.count),
        Tally(np.zeros((rows, bins)), np.zeros(rows)), problem.accuracy.occlusion != "off", pool_set,
    )  # fmt: skip


def blocks_for(problem: Problem, pixels: Ints, count: int) -> int:
    """Number of blocks of FoV points for `count` hidden vertices, a power of two, so that they cover a pixel evenly.

    There are as many as the pixel's patch has details, but no more than hidden vertices or than memory has room for.
    """
    samples = problem.accuracy.fov_samples
    across = problem.patch_detail(pixels)
    useful = 64 * (1 + across) ** 2 / samples
    affordable = VALUES_AT_ONCE / (8 * len(pixels) * samples)
    return 1 << max(0, int(min(count, affordable, useful)).bit_length() - 1)


def pool_for(problem: Problem, pixels: Ints, blocks: int, streams: Streams) -> FovPool:
    """`blocks` blocks of FoV points for each of `pixels`, which may repeat; `streams` has a row for each of them."""
    return fov_pool(
        problem.caster, problem.scene, problem.capture.sensor, problem.cones, pixels, problem.accuracy.fov_samples,
        blocks, streams.seeds(LightStream.FOV_POINTS, np.arange(len(pixels))),
    )  # fmt: skip
