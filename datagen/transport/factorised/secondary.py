"""Full secondary scattering: laser point → observed point → lookin → FoV point, all paths, at the cost of one sum.

Each lookin b is a Lambertian surface point. What arrives through its Ñ observed points and what leaves it through
its FoV points factorise, so all Ñ × M pairs are one convolution in time (`convolution.py`). A sample is a pair
(observed point o, lookin b) drawn in either of two ways, joined by the balance heuristic (Veach & Guibas, SIGGRAPH
1995):

- b by a cosine ray from a FoV point, o by a cosine ray from b. The density of b, Σ share_q cosθ₄ cosθ_b V / (π R²)
  over its FoV points q, is a by-product of the paths that leave it, so that what leaves, divided by the density,
  never exceeds what the whole FoV weighs;
- b the same, o one of the points that cosine rays from the laser point meet near it, which bounds the 1/R₁ₒ².

Both need b to keep its distance from the laser point. Lookins near it are found by a walk from it instead, whose
connections to the FoV are bounded by their own means (`connections.py`): where laser point and FoV share a corner, so
do all vertices of the brightest paths. Any sample count is unbiased, and one sample is bounded.
Lookins placed by rays from the laser point, as the paper has it, miss all those the laser does not light itself.
Scholes & Leach, Sensors 24, 6522 (2024), sec. 4.
"""

from __future__ import annotations

import numpy as np

from datagen.errors import InputError
from datagen.records.arrays import Bools, Floats, Ints
from datagen.seeding import LightStream
from datagen.transport.brdf import LAMBERTIAN, MaterialTable
from datagen.transport.error_control.cost import Work, factorised_work
from datagen.transport.factorised import convolution
from datagen.transport.factorised import secondary_kernels as kernels
from datagen.transport.factorised import secondary_samples as samples
from datagen.transport.factorised.convolution import SUB_BINS, Histograms, Paths, Sums
from datagen.transport.factorised.secondary_kernels import FovPoints, Frame, LaserVicinity, Lookins, Pace, Surfaces
from datagen.transport.factorised.secondary_samples import Placement, SecondaryTask
from datagen.transport.fields_of_view import FovPool
from datagen.transport.path_tracing.averages import Average
from datagen.transport.path_tracing.connections import Clock, Receiver, Rows, Tally
from datagen.transport.path_tracing.replicate_spread import Sketch, standard_error
from datagen.transport.path_tracing.trace import WalkTask
from datagen.transport.path_tracing.vertices import AreaTarget, continued, draw_lookins, runs_of, scattered_rays
from datagen.transport.sampling import Streams, scrambled_sobol, stream_seeds
from datagen.transport.visibility import clearance
from datagen.transport.visibility.clearance import LightBuffer
from datagen.units import path_from_time

RAYS_PER_CHUNK = 1 << 17
"""Rays of the lookins followed at once: what bounds the memory."""
LASERS_AT_ONCE = 64
WALKS_PER_LOOKIN = 4
"""Walks from each laser point; only those whose second vertex is near it count, and cost more than two rays."""
HISTOGRAM_VALUES_AT_ONCE = 1 << 22
RAYS_WORTH_A_BUFFER = 200_000
"""Shadow rays of a laser point that take as long as making its light buffer, about; so many rays a triangle, too."""
RAYS_WORTH_A_TRIANGLE = 6
BUFFERS_AT_MOST = 256
EVERY_BIN = 1 << 60


def factorising(materials: MaterialTable) -> Bools:
    """(K,) the parts whose lookins factorise: where light goes does not depend on where it came from (Lambert)."""
    return np.asarray(materials.kind == LAMBERTIAN)


def secondary_transient(
    task: WalkTask, observed: int, carriers: Bools | None = None, *, placement: Placement = "fov",
    plain: bool = False, sketch: Sketch | None = None,
) -> Average:  # fmt: skip
    """The four-bounce transient, every path from `observed` observed points through all FoV points of a lookin.

        L = ∫∫∫ f₁ cosθ₁cosθₒ V/R₁ₒ² · fₒ · cosθₒ′cosθ_b V/Rₒ_b² · (ρ_b/π) cosθ_b′cosθ₄ V/R_b4² · f₄ · A dΩ dA_b dAₒ

    Parameters
    ----------
    task : its accuracy gives the lookins, the FoV points for each of them, the replicates, and how many of the
        strongest arriving paths are kept (the paper's optimised scheme has 1); fewer than all leaves out energy.
    observed : points for each lookin.
    carriers : (K,) parts that may carry lookins, all of them Lambertian (`factorising`); paths whose lookin lies on
        another part are left out, for another method to add. None: all parts, which then must all be Lambertian.
        The other vertices may have any BRDF.
    placement : `fov` draws lookins from FoV points, unbiased. `laser` draws them from the laser point as the paper
        does: biased low, as it misses all paths whose lookin (the third vertex) the laser point does not see, and
        without bound where lookins far from the laser point are close to the field of view.
    plain : form Eq. 8's double sum as it is written, O(Ñ²), over the very same points: what tests compare with.
    sketch : gets each replicate's transient too, for the correlations between bins.

    Raises
    ------
    InputError : for a lookin's material that does not factorise.
    """
    scene, capture, caster, materials = task.scene, task.capture, task.caster, task.materials
    allowed = np.ones(len(materials.kind), np.bool_) if carriers is None else carriers
    wrong = np.flatnonzero(allowed & ~factorising(materials))
    if len(wrong):
        raise InputError(
            f"part {scene.part_names[wrong[0]]!r}: {type(scene.materials[wrong[0]]).__name__} does not factorise; "
            "only Lambertian lookins do: follow this part's light by the walk instead"
        )
    axis = capture.time
    own = SecondaryTask(
        **vars(task), observed=observed, placement=placement, plain=plain,
        carries=allowed & (materials.values[:, 0] > 0),
        surfaces=Surfaces(
            caster.corners[:, 0].copy(), caster.face_normal, scene.face_part, materials.kind, materials.values
        ),
        pace=Pace(
            SUB_BINS / float(path_from_time(axis.width_s)), SUB_BINS * axis.start_s / axis.width_s + 0.5,
            float(axis.origin == "source"), scene.attenuation_per_m,
        ),
        frame=Frame(caster.center, caster.half_extent_m, caster.offset_m),
        face_plane=clearance.plane_of_faces(caster),
    )  # fmt: skip
    total, squares, overflow = np.zeros(capture.shape), np.zeros(capture.shape), np.zeros(capture.shape[:2])
    sums = Sums.zeros(*capture.shape)
    lookins, fov_samples = task.accuracy.lookins, task.accuracy.fov_samples
    replicates = min(task.accuracy.replicates, lookins)
    for replicate in range(replicates):
        count = lookins // replicates + (replicate < lookins % replicates)
        for array in sums:
            array.fill(0.0)
        for lasers, pixels in own.groups():
            _add_group(own, lasers, pixels, count, replicate, sums.take(lasers))
        total += sums.transient
        overflow += sums.overflow
        if sketch is not None:
            sketch.add(replicate, sums.transient, 0)
        squares += np.square(sums.transient, out=sums.transient)
    total /= replicates
    work = Work(0, 0, total.size * replicates, 0)
    for lasers, pixels in own.groups():
        work += factorised_work(lookins, observed, len(lasers), len(pixels), fov_samples, axis.bins, replicates)
    return Average([total], standard_error([total], squares, replicates), overflow / replicates, work)


def _add_group(task: SecondaryTask, lasers: Ints, pixels: Ints, count: int, replicate: int, sums: Sums) -> None:
    """Add `count` lookins' worth of paths from `lasers` to `pixels`; `sums` begins with the first of `lasers`."""
    pool, fov, blocks = samples.fov_points(task, pixels, count, replicate)
    if not fov.share.any():
        return
    patch = None
    if len(task.caster.corners) < 5 * fov.weight.size // blocks:
        used = fov.weight > 0
        patch = clearance.flat_patch(fov.position[used], fov.normal[used], task.caster.offset_m)
    lookins = samples.place_lookins(task, fov, blocks, lasers, pixels, count, replicate)
    vicinities = samples.laser_vicinities(task, lasers, count, replicate)
    worth = count * task.observed > max(RAYS_WORTH_A_BUFFER, RAYS_WORTH_A_TRIANGLE * len(task.caster.corners))
    buffers = [
        clearance.light_buffer(task.caster, task.face_plane, vicinity.position, vicinity.normal)
        if worth and len(lasers) <= BUFFERS_AT_MOST
        else clearance.no_light_buffer()
        for vicinity in vicinities
    ]
    seeds = stream_seeds(task.seed, LightStream.FACTORISED_SECOND, replicate, int(lasers[0]))
    base = scrambled_sobol(seeds, task.observed, 2)[0]
    size = max(
        1, RAYS_PER_CHUNK // max(task.observed + max(len(s.lit_part) for s in vicinities), fov.weight.size // blocks)
    )
    for start in range(0, len(lookins.part), size):
        chunk = lookins.take(slice(start, start + size))
        _add_lookins(task, fov, patch, chunk, base, count, lasers, vicinities, buffers, sums)
    if vicinities[0].near_square > 0:
        _walk_near(task, lasers, pixels, pool, count, replicate, sums)


def _walk_near(
    task: SecondaryTask, lasers: Ints, pixels: Ints, pool: FovPool, count: int, replicate: int, sums: Sums
) -> None:
    """Add the paths whose lookin is near the laser point, by walks from it."""
    bins = sums.transient.shape[2]
    nothing = AreaTarget(0.0, np.empty(0, np.int64), np.empty(0), 1.0, np.zeros(len(task.caster.corners), np.bool_))
    seed = int(stream_seeds(task.seed, LightStream.FACTORISED_WALKS)[0])
    streams = Streams.of(seed, np.array([replicate]), np.arange(len(task.points.part)))
    splits = np.zeros(len(task.materials.kind), np.int64)
    axis, walks = task.capture.time, WALKS_PER_LOOKIN * count
    at_once = max(1, min(RAYS_PER_CHUNK // walks, HISTOGRAM_VALUES_AT_ONCE // (len(pixels) * bins)))
    for run in runs_of(lasers, at_once):
        lookins = draw_lookins(task.caster, task.scene, task.materials, task.points, run, walks, nothing, streams, 2)
        rays = scattered_rays(task.caster, task.materials, lookins, lookins.numbers(0))
        found = continued(task.scene, lookins, *rays)
        apart = ((found.position - task.points.position[found.laser]) ** 2).sum(axis=1)
        found = found.take(np.flatnonzero((apart < task.near_square) & task.carries[found.part]))
        device_leg = task.points.leg[run] if axis.origin == "source" else np.full(len(run), -1.0)
        receiver = Receiver(
            task.caster, task.scene, task.materials, task.capture.sensor, pool, task.cones.take(pixels),
            task.patches.take(pixels), task.accuracy.fov_samples,
            Clock(task.pace.per_metre / SUB_BINS, axis.start_s / axis.width_s, device_leg),
            Rows(int(run[0]), task.capture.pairing == "confocal", len(pixels), 1),
            Tally(np.zeros((len(run) * len(pixels), bins)), np.zeros(len(run) * len(pixels))),
        )  # fmt: skip
        receiver.connect(found, found.numbers(1)[:, 0], splits)
        found = found.take(receiver.near(found))
        receiver.follow(found, *scattered_rays(task.caster, task.materials, found, found.numbers(1)), splits)
        rows = slice(run[0] - lasers[0], run[-1] + 1 - lasers[0])
        sums.transient[rows] += receiver.tally.histogram.reshape(len(run), len(pixels), bins)
        sums.overflow[rows] += receiver.tally.overflow.reshape(len(run), len(pixels))


def _add_lookins(
    task: SecondaryTask, fov: FovPoints, patch: Floats | None, lookins: Lookins, base: Floats, count: int,
    lasers: Ints, vicinities: list[LaserVicinity], buffers: list[LightBuffer], sums: Sums,
) -> None:  # fmt: skip
    leaving_paths, density = _leaving(task, fov, patch, lookins)
    pixels = fov.weight.shape[0]
    displacement = np.repeat(1.0 - lookins.displacement, pixels)
    every = np.full(len(displacement), EVERY_BIN)
    leaving = convolution.histograms(leaving_paths, displacement, -every, every)
    if task.placement == "laser":
        density = samples.density_from(vicinities[0], lookins)
    alive = (leaving.total.reshape(-1, pixels).sum(axis=1) > 0) & (density > 0)
    if not alive.any():
        return
    if not alive.all() and not task.plain:
        lookins, density = lookins.take(alive), density[alive]
        leaving = convolution.take_rows(leaving, np.repeat(alive, pixels))
    origin, direction = kernels.observing_rays(lookins, base, task.frame)
    face = task.caster.closest_scaled(origin, direction)
    low, high = convolution.reachable(leaving, len(lookins.part), pixels, sums.transient.shape[2])
    arriving: list[Histograms] = []
    for k, (vicinity, buffer) in enumerate(zip(vicinities, buffers, strict=True)):
        paths, rays = kernels.arriving_paths(
            lookins, density * count, face, direction, vicinity, buffer, task.surfaces, task.pace, task.frame
        )
        kernels.drop_hidden(rays, task.caster.occluded_scaled(rays.origin, rays.span), paths.energy)
        if task.accuracy.strongest is not None:
            convolution.keep_strongest(paths, task.accuracy.strongest)
        if task.plain:
            convolution.double_sum(
                _in_bins(paths), _in_bins(leaving_paths, 0.5), sums.of_laser(lasers[k] - lasers[0])
            )
            continue
        arriving.append(convolution.histograms(paths, lookins.displacement, low, high))
        # A laser ray that met nothing leaves a gap in the rows.
        ends_run = k + 1 == len(vicinities) or lasers[k + 1] != lasers[k] + 1
        if ends_run or len(arriving) == LASERS_AT_ONCE:
            rows = np.arange(lasers[k] + 1 - len(arriving), lasers[k] + 1) - lasers[0]
            convolution.convolve(arriving, leaving, sums.take(rows))
            arriving = []


def _in_bins(paths: Paths, offset: float = 0.0) -> Paths:
    return paths._replace(position=(paths.position + offset) / SUB_BINS)


def _leaving(task: SecondaryTask, fov: FovPoints, patch: Floats | None, lookins: Lookins) -> tuple[Paths, Floats]:
    """Paths out of the lookins, rows (lookin, pixel), and the density with which each lookin is drawn, per area."""
    clear = np.zeros(len(lookins.part), np.bool_)
    if patch is not None:
        caster = task.caster
        clear = clearance.pyramids_clear(lookins.position, patch, caster.corners, caster.face_normal, caster.offset_m)
    paths, each, rays = kernels.leaving_paths(
        lookins, clear, fov, task.accuracy.fov_samples, task.surfaces, task.pace, task.frame
    )
    hidden = task.caster.occluded_scaled(rays.origin, rays.span)
    kernels.drop_hidden(rays, hidden, paths.energy)
    kernels.drop_hidden(rays, hidden, each)
    return paths, kernels.sum_rows(paths.first, each, fov.weight.shape[0])
