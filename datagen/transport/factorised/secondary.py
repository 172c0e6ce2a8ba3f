"""The secondary in its factorised form: laser point → observed point o → lookin b → FoV point, paths of four bounces.

The observed point is the first hidden vertex and the lookin the second; both words are those of Scholes & Leach,
Sensors 24, 6522 (2024). A lookin is a Lambertian surface point with Ñ observed points and M FoV points. Its half
paths from the laser and its half paths to the sensor factorise, so that all Ñ × M paths by way of it are one
convolution in time (`convolution.py`). A pair (o, b) is drawn in two ways, which the balance heuristic combines
(Veach & Guibas, SIGGRAPH 1995):

- b by a cosine-distributed ray from a FoV point, o by a cosine-distributed ray from b. The density of b is
  Σ share_q cosθ₄ cosθ_b V / (π R²) over its FoV points q, the same sum that the half paths out of b take; so their
  energy divided by the density never exceeds the weight of the whole field of view;
- b as before, o one of the points near the laser point where cosine-distributed rays from it land; this bounds the
  1/R₁ₒ² of a short first leg.

Neither way bounds the weight of a lookin near the laser point. Such lookins are drawn by path tracing from the laser
point instead, and `path_tracing/connections.py` bounds their connections to the FoV points. They matter most where
laser point and field of view lie in the same corner, as the brightest paths then stay there. The mean is right for
any number of samples, and the weight of each sample is bounded.

The paper itself places lookins by rays from the laser point (sec. 4, and `paper/` here), which leaves out all
lookins that the laser point does not light.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from datagen.errors import InputError
from datagen.records.arrays import Bools, Floats, Ints
from datagen.seeding import LightStream
from datagen.transport.brdf import LAMBERTIAN, MaterialTable, cosine_directions
from datagen.transport.error_control.cost import Work, factorised_work
from datagen.transport.factorised.convolution import SUB_BINS, Paths, Sums, convolve, keep_strongest
from datagen.transport.factorised.half_paths import (
    FovPoints,
    LaserVicinity,
    Lookins,
    Room,
    arriving_paths,
    leaving_paths,
    observing_rays,
)
from datagen.transport.fields_of_view import FovPool, fov_pool
from datagen.transport.memory import VALUES_AT_ONCE
from datagen.transport.path_tracing.averages import Average
from datagen.transport.path_tracing.connections import Clock, Receiver, Rows, Tally
from datagen.transport.path_tracing.replicate_spread import Sketch, standard_error
from datagen.transport.path_tracing.vertices import (
    AreaTarget,
    continued,
    draw_hidden_vertices,
    runs_of,
    scattered_rays,
)
from datagen.transport.problem import Problem
from datagen.transport.sampling import Streams, scrambled_sobol, stream_seeds
from datagen.units import path_from_time

PATHS_PER_LOOKIN = 4
"""Paths traced from each laser point for each lookin. Only those whose second hidden vertex lies near the laser point
count and cost more than two rays. Half as many double the variance of that light."""
RAYS_FROM_LASER_POINT = 1 / 8
"""Rays drawn from each laser point, as a share of the number of lookins or of observed points, whichever is larger.
Half as many double the variance of light by observed points near the laser point, which other rays seldom meet."""
NEAR = 0.1
"""Distance up to which a vertex is near a laser point, in half extents of the scene: 0.5 m in a room of 10 m. Half of
it lets the weight of lookins and of observed points just beyond it grow fourfold."""


def factorising(materials: MaterialTable) -> Bools:
    """(K,) whether lookins on a part factorise: those of Lambertian parts do, as the direction of the light that
    arrives has no influence on that of the light that leaves."""
    return np.asarray(materials.kind == LAMBERTIAN)


@dataclass(frozen=True)
class _Secondary:
    """A secondary that is being computed.

    observed : number of observed points of each lookin. carries : (K,) whether a part carries lookins. room : the
    scene for the compiled loops. sums : the light of the current replicate so far.
    """

    task: Problem
    observed: int
    carries: Bools
    room: Room
    sums: Sums

    @classmethod
    def of(cls, task: Problem, observed: int, allowed: Bools) -> _Secondary:
        caster, axis, scene, materials = task.caster, task.capture.time, task.scene, task.materials
        room = Room(
            caster.corners[:, 0].copy(), caster.face_normal, scene.face_part, materials.kind, materials.values,
            np.array([*caster.center, caster.half_extent_m]), caster.offset_m,
            SUB_BINS / float(path_from_time(axis.width_s)), SUB_BINS * axis.start_s / axis.width_s + 0.5,
            float(axis.origin == "source"), scene.attenuation_per_m,
        )  # fmt: skip
        shape = task.capture.shape
        return cls(
            task, observed, allowed & (materials.values[:, 0] > 0), room, Sums(np.zeros(shape), np.zeros(shape[:2]))
        )

    @property
    def near_square(self) -> float:
        """Square of the distance up to which a vertex is near a laser point, m².

        0 where only the strongest paths are kept: the paper's scheme knows no second way to draw vertices.
        """
        return 0.0 if self.task.accuracy.strongest is not None else (NEAR * self.task.caster.half_extent_m) ** 2

    def groups(self) -> list[tuple[Ints, Ints]]:
        """Groups of laser points that share their lookins: (indices of the laser points, indices of the pixels)."""
        existing = np.flatnonzero(self.task.points.part >= 0)
        if self.task.capture.pairing == "confocal":
            return [(existing[k : k + 1], existing[k : k + 1]) for k in range(len(existing))]
        return [(existing, np.arange(len(self.task.capture.sensor.pixels)))] if len(existing) else []


def secondary_transient(
    task: Problem, observed: int, carriers: Bools | None = None, *, sketch: Sketch | None = None
) -> Average:
    """The light of paths of four bounces, mean over replicates: one row (L, P, T), with its standard error and work.

    Every lookin b combines all paths by its `observed` observed points o with all paths by its FoV points x₄:

        L = ∫∫∫ f₁ cosθ₁cosθₒ V/R₁ₒ² · fₒ · cosθₒ′cosθ_b V/Rₒ_b² · (ρ_b/π) cosθ_b′cosθ₄ V/R_b4² · f₄ · A dΩ dA_b dAₒ

    Parameters
    ----------
    task : the problem. Its accuracy gives the number of lookins, of FoV points for each lookin, and of replicates,
        and how many of the strongest half paths into a lookin are kept (1 in the paper's optimised scheme; fewer than
        all leave out energy).
    observed : number of observed points for each lookin.
    carriers : (K,) whether a part may carry lookins; these parts must be Lambertian (`factorising`). Paths whose
        lookin lies on another part are left out, for another method to add. None stands for all parts. The other
        vertices may have any BRDF.
    sketch : receives each replicate's transient, for the correlations between bins.

    Raises
    ------
    InputError : a part that may carry lookins has a material that does not factorise.
    """
    scene, capture, materials = task.scene, task.capture, task.materials
    allowed = np.ones(len(materials.kind), np.bool_) if carriers is None else carriers
    wrong = np.flatnonzero(allowed & ~factorising(materials))
    if len(wrong):
        raise InputError(
            f"part {scene.part_names[wrong[0]]!r}: {type(scene.materials[wrong[0]]).__name__} does not factorise; "
            "only Lambertian lookins do: use path tracing for this part's light"
        )
    state = _Secondary.of(task, observed, allowed)
    total, squares, overflow = np.zeros(capture.shape), np.zeros(capture.shape), np.zeros(capture.shape[:2])
    lookins, fov_samples = task.accuracy.lookins, task.accuracy.fov_samples
    replicates = min(task.accuracy.replicates, lookins)
    for replicate in range(replicates):
        count = lookins // replicates + (replicate < lookins % replicates)
        for array in state.sums:
            array.fill(0.0)
        for lasers, pixels in state.groups():
            _add_group(state, lasers, pixels, count, replicate)
        total += state.sums.transient
        overflow += state.sums.overflow
        if sketch is not None:
            sketch.add(replicate, state.sums.transient, 0)
        squares += np.square(state.sums.transient, out=state.sums.transient)
    total /= replicates
    work = Work(0, 0, total.size * replicates, 0)
    for lasers, pixels in state.groups():
        work += factorised_work(
            lookins, observed, len(lasers), len(pixels), fov_samples, capture.time.bins, replicates
        )
    return Average([total], standard_error([total], squares, replicates), overflow / replicates, work)


def _add_group(state: _Secondary, lasers: Ints, pixels: Ints, count: int, replicate: int) -> None:
    """Add to the sums the paths from `lasers` by `count` lookins to `pixels`."""
    pool, fov, blocks = _fov_points(state.task, pixels, count, replicate)
    if not fov.share.any():
        return
    lookins = _place_lookins(state, fov, blocks, int(lasers[0]), count, replicate)
    vicinities = list(_vicinities(state, lasers, count, replicate))
    seeds = stream_seeds(state.task.seed, LightStream.FACTORISED_SECOND, replicate, int(lasers[0]))
    points = scrambled_sobol(seeds, state.observed, 2)[0]
    rays = max(state.observed + max(len(one.lit_part) for one in vicinities), fov.weight.size // blocks)
    size = max(1, VALUES_AT_ONCE // (32 * rays))
    for start in range(0, len(lookins.part), size):
        _add_lookins(state, fov, lookins.take(slice(start, start + size)), points, count, lasers, vicinities)
    if state.near_square > 0:
        _trace_near(state, lasers, pixels, pool, count, replicate)


def _fov_points(task: Problem, pixels: Ints, count: int, replicate: int) -> tuple[FovPool, FovPoints, int]:
    """FoV points of `pixels` in blocks, as the pool and as `FovPoints`, and the number of blocks.

    The number is a power of two, so that the points of all blocks together cover a pixel evenly. Within a block, over
    all pixels, a lookin is drawn from a FoV point in proportion to the point's weight times its albedo.
    """
    affordable = VALUES_AT_ONCE // 64 // (len(pixels) * task.accuracy.fov_samples)
    blocks = 1 << max(0, min(count, affordable).bit_length() - 1)
    pool = fov_pool(
        task.caster, task.scene, task.capture.sensor, task.cones, pixels, task.accuracy.fov_samples, blocks,
        stream_seeds(task.seed, LightStream.FACTORISED_FOV_POINTS, replicate, pixels),
    )  # fmt: skip
    worth = np.where(pool.weight > 0, pool.weight * task.materials.values[pool.part, 0], 0.0)
    of_block = worth.reshape(len(pixels), blocks, -1).sum(axis=(0, 2))
    share = worth / np.where(of_block > 0, of_block, 1.0).repeat(task.accuracy.fov_samples)
    arrays = pool.position, pool.normal, pool.to_sensor, pool.part, pool.weight, pool.last_leg
    return pool, FovPoints(*arrays, share), blocks


def _place_lookins(state: _Secondary, fov: FovPoints, blocks: int, laser: int, count: int, replicate: int) -> Lookins:
    """Up to `count` lookins where cosine-distributed rays from FoV points land; those on parts that carry no lookins
    are left out."""
    task, points = state.task, state.task.accuracy.fov_samples
    sobol = scrambled_sobol(stream_seeds(task.seed, LightStream.FACTORISED_FIRST, replicate, laser), count, 6)[0]
    scaled = sobol[:, 0] * blocks
    block = np.minimum(scaled, blocks - 1).astype(np.int64)
    share = fov.share.reshape(len(fov.share), blocks, -1).transpose(1, 0, 2).reshape(blocks, -1)
    running = np.cumsum(share, axis=1)
    # One search serves all blocks: the running shares of block k fill k … k + 1.
    shares = (running / np.where(running[:, -1:] > 0, running[:, -1:], 1.0) + np.arange(blocks)[:, None]).ravel()
    pick = np.searchsorted(shares, block + np.clip(scaled - block, 0.0, 1.0), side="left")
    pick = np.clip(pick - block * share.shape[1], 0, share.shape[1] - 1)
    pixel, point = pick // points, block * points + pick % points
    position, normal = fov.position[pixel, point], fov.normal[pixel, point]
    hits = task.caster.closest(position + task.caster.offset_m * normal, cosine_directions(normal, sobol[:, 1:3]))
    part = np.where(hits.valid, task.scene.face_part[hits.face], 0).astype(np.int64)
    kept = hits.valid & (running[block, -1] > 0) & state.carries[part]
    return Lookins(hits.position[kept], hits.normal[kept], part[kept], block[kept], sobol[kept, 3], sobol[kept, 4:])


def _vicinities(state: _Secondary, lasers: Ints, count: int, replicate: int) -> Iterator[LaserVicinity]:
    """Each laser point, with the points near it where cosine-distributed rays from it land."""
    task, points = state.task, state.task.points
    rays = int(np.ceil(max(count, state.observed) * RAYS_FROM_LASER_POINT)) if state.near_square > 0 else 0
    seeds = stream_seeds(task.seed, LightStream.FACTORISED_LIT, replicate, lasers)
    uv = scrambled_sobol(seeds, rays, 2).reshape(-1, 2)
    owner = np.repeat(lasers, rays)
    n1, x1 = points.normal[owner], points.position[owner]
    hits = task.caster.closest(x1 + task.caster.offset_m * n1, cosine_directions(n1, uv))
    part = np.where(hits.valid, task.scene.face_part[hits.face], 0).astype(np.int64)
    is_lit = hits.valid & (((hits.position - x1) ** 2).sum(axis=1) < state.near_square)
    for k, laser in enumerate(lasers):
        near = np.flatnonzero(is_lit[k * rays : (k + 1) * rays]) + k * rays
        yield LaserVicinity(
            points.position[laser], points.normal[laser], points.to_laser[laser], int(points.part[laser]),
            float(points.leg[laser]), rays, state.near_square, hits.position[near], hits.normal[near], part[near],
        )  # fmt: skip


def _add_lookins(
    state: _Secondary, fov: FovPoints, lookins: Lookins, points: Floats, count: int, lasers: Ints,
    vicinities: list[LaserVicinity],
) -> None:  # fmt: skip
    """Add to the sums the paths by way of the given lookins.

    points : (Ñ, 2) the net of directions to observed points that all lookins share, each with its own shift.
    """
    caster, pixels = state.task.caster, fov.weight.shape[0]
    leaving, density = _leaving(state, fov, lookins)
    # A lookin that no FoV point sees sends nothing to the sensor, so the light into it need not be found.
    alive = density > 0
    if not alive.any():
        return
    leaving, lookins, density = leaving.take(np.repeat(alive, pixels)), lookins.take(alive), density[alive]
    origin, direction = observing_rays(lookins, points, state.room)
    face = caster.closest_scaled(origin, direction)
    for laser, vicinity in zip(lasers, vicinities, strict=True):
        arriving, *rays = arriving_paths(lookins, density * count, face, direction, vicinity, state.room)
        arriving.energy[caster.occluded_scaled(*rays)] = 0.0
        if state.task.accuracy.strongest is not None:
            keep_strongest(arriving, state.task.accuracy.strongest)
        convolve(arriving, leaving, lookins.displacement, state.sums.of_laser(laser))


def _leaving(state: _Secondary, fov: FovPoints, lookins: Lookins) -> tuple[Paths, Floats]:
    """Half paths out of the lookins, rows (lookin, pixel), and the density (n,), 1/m², with which each is drawn.

    The density is the sum over the FoV points of the lookin's block that see it.
    """
    paths, each, *rays = leaving_paths(lookins, fov, state.task.accuracy.fov_samples, state.room)
    hidden = state.task.caster.occluded_scaled(*rays)
    paths.energy[hidden], each[hidden] = 0.0, 0.0
    of_lookin = np.repeat(np.arange(len(lookins.part)), np.diff(paths.first[:: fov.weight.shape[0]]))
    return paths, np.bincount(of_lookin, each, len(lookins.part)).astype(np.float64, copy=False)


def _trace_near(state: _Secondary, lasers: Ints, pixels: Ints, pool: FovPool, count: int, replicate: int) -> None:
    """Add to the sums the paths whose lookin lies near the laser point, by path tracing from the laser point."""
    task, sums, bins = state.task, state.sums, state.sums.transient.shape[2]
    nothing = AreaTarget(0.0, np.empty(0, np.int64), np.empty(0), 1.0, np.zeros(len(task.caster.corners), np.bool_))
    seed = int(stream_seeds(task.seed, LightStream.FACTORISED_WALKS)[0])
    streams = Streams.of(seed, np.array([replicate]), np.arange(len(task.points.part)))
    splits = np.zeros(len(task.materials.kind), np.int64)
    axis, paths = task.capture.time, PATHS_PER_LOOKIN * count
    at_once = max(1, min(VALUES_AT_ONCE // (32 * paths), VALUES_AT_ONCE // (len(pixels) * bins)))
    for run in runs_of(lasers, at_once):
        # Of such a path the lookin is the second hidden vertex.
        first = draw_hidden_vertices(
            task.caster, task.scene, task.materials, task.points, run, paths, nothing, streams, 2
        )
        rays = scattered_rays(task.caster, task.materials, first, first.numbers(0))
        second = continued(task.scene, first, *rays)
        apart = ((second.position - task.points.position[second.laser]) ** 2).sum(axis=1)
        second = second.take(np.flatnonzero((apart < state.near_square) & state.carries[second.part]))
        device_leg = task.points.leg[run] if axis.origin == "source" else np.full(len(run), -1.0)
        receiver = Receiver(
            task.caster, task.scene, task.materials, task.capture.sensor, pool, task.cones.take(pixels),
            task.patches.take(pixels), task.accuracy.fov_samples,
            Clock(state.room.per_metre / SUB_BINS, axis.start_s / axis.width_s, device_leg),
            Rows(int(run[0]), task.capture.pairing == "confocal", len(pixels), 1),
            Tally(np.zeros((len(run) * len(pixels), bins)), np.zeros(len(run) * len(pixels))),
        )  # fmt: skip
        receiver.connect(second, second.numbers(1)[:, 0], splits)
        second = second.take(receiver.near(second))
        receiver.follow(second, *scattered_rays(task.caster, task.materials, second, second.numbers(1)), splits)
        rows = slice(run[0], run[-1] + 1)
        sums.transient[rows] += receiver.tally.histogram.reshape(len(run), len(pixels), bins)
        sums.overflow[rows] += receiver.tally.overflow.reshape(len(run), len(pixels))
