"""The transport solver: scene and capture in, transient out."""

from __future__ import annotations

import time as clock_time
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from datagen.errors import InputError
from datagen.records import Accuracy, Capture, Scene, Transient
from datagen.transport.brdf import MaterialTable
from datagen.transport.connections import Clock, Receiver, Rows, Tally
from datagen.transport.fov import FovPool, PixelCones, PixelPatches, fov_pool
from datagen.transport.raycast import Raycaster
from datagen.transport.sampling import stream_seeds
from datagen.transport.secondary import factorising, secondary_transient
from datagen.transport.spread import standard_error
from datagen.transport.vertices import (
    SOBOL_STEPS,
    AreaTarget,
    LaserPoints,
    continued,
    draw_lookins,
    scattered_rays,
    spot_vertices,
)
from datagen.units import path_from_time

COMPONENTS: tuple[str, ...] = ("direct", "primary", "secondary", "higher")
FOV_STREAM = 16
LOOKINS_PER_CHUNK = 1 << 17
"""Lookins traced at once, over as many laser points as fit."""
HISTOGRAM_VALUES_PER_CHUNK = 1 << 22
"""Histogram entries filled at once (32 MiB), over as many laser points as fit."""
FOV_POINTS_PER_POOL = 1 << 19
"""FoV points kept at once, over all pixels of a chunk."""
ROULETTE_FROM = 4
"""Bounce order of the first vertices that Russian roulette may end, when all orders are followed."""
SURVIVAL = (0.05, 0.95)
"""Bounds of the survival probability: the first keeps weights bounded, the second ends every walk."""


def simulate(
    scene: Scene, capture: Capture, accuracy: Accuracy | None = None, seed: int = 0, *, split_parts: bool = True
) -> Transient:
    """Follow light from each laser point around the corner and back.

    The photons that reach the aperture per emitted photon; with f the BRDFs, V the visibility, x₁ the laser point,
    x₂ a lookin and x₃ a FoV point, the primary (three bounces) is (DESIGN, sec. 2; the paths are those of Eq. 6 of
    Scholes & Leach, Sensors 24, 6522 (2024), with radiometric weights)

        L = ∫∫ f₁ cosθ₁ cosθ₂ V₁₂/R₁₂² · f₂ · cosθ₂′ cosθ₃ V₂₃/R₂₃² · f₃ cosθ₃′ V₃ₛ A/R₃ₛ² dA₂ dA₃

    and each further bounce adds a surface between x₂ and x₃. Light is traced from the laser point; every vertex is
    joined to the FoV points, which gives all orders at once (the secondary is that of Eq. 8, all paths).

    Parameters
    ----------
    scene, capture : what is looked at, and how.
    accuracy : sample counts and effects; default `Accuracy()`.
    seed : any integer ≥ 0; the same arguments and seed give the same transient.
    split_parts : also keep the primary split by part (`Transient.parts`), K times the memory for K parts.

    Returns
    -------
    Transient with arrays (L, P, T), photons at the aperture per emitted photon and bin. A laser ray that meets
    nothing, or a pixel that sees nothing, gives zeros.

    Raises
    ------
    InputError : for a pixel that is no convex quadrilateral, or a negative seed.
    """
    accuracy = accuracy or Accuracy()
    if not 0 <= seed < 2**64:
        raise InputError(f"seed = {seed}: must be an integer in 0 … 2^64 − 1")
    began = clock_time.perf_counter()
    caster = Raycaster(scene)
    materials = MaterialTable.of(scene.materials)
    cones = PixelCones.of(capture.sensor)
    points = LaserPoints.of(caster, scene, capture.laser)
    job = _Job(
        scene, capture, accuracy, caster, materials, cones,
        PixelPatches.of(caster, capture.sensor, cones, accuracy.fov_samples), points,
        AreaTarget.choose(caster, scene, materials, points, seed), seed, _Splits.of(scene, accuracy, split_parts),
        _walked(accuracy, materials),
    )  # fmt: skip
    prepared = clock_time.perf_counter()
    estimate = _estimate(job)
    traced = clock_time.perf_counter()
    if "secondary" in estimate.components and not job.walked.all():
        _add_factorised(job, estimate)
    finished = clock_time.perf_counter()
    return Transient(
        time=capture.time,
        components=estimate.components,
        parts=estimate.parts,
        stderr=estimate.stderr,
        overflow=estimate.overflow,
        laser_points=points.position,
        seconds={"prepare": prepared - began, "trace": traced - prepared, "secondary": finished - traced},
    )


@dataclass(frozen=True)
class _Splits:
    """Rows of the tally for each laser point and pixel: one for each part of the primary (or one for all of it), then
    one for each other component."""

    parts: tuple[str, ...]
    components: tuple[str, ...]
    all_parts: int

    @classmethod
    def of(cls, scene: Scene, accuracy: Accuracy, split_parts: bool) -> _Splits:
        orders = accuracy.max_bounces or 5
        secondary = orders >= 4 and accuracy.secondary != "none"
        others = ("direct",) * accuracy.direct + ("secondary",) * secondary + ("higher",) * (orders >= 5)
        return cls(scene.part_names if split_parts else (), others, len(scene.part_names))

    @property
    def primary(self) -> int:
        """How many rows the primary takes."""
        return max(len(self.parts), 1)

    @property
    def count(self) -> int:
        return self.primary + len(self.components)

    def of_part(self, order: int) -> NDArray[np.int64]:
        """(K,) the row of a contribution of `order` bounces that comes from a vertex on each part."""
        if order == 3:
            return np.arange(self.all_parts) if self.parts else np.zeros(self.all_parts, np.int64)
        name = "direct" if order < 3 else "secondary" if order == 4 else "higher"
        if name not in self.components:
            return np.zeros(self.all_parts, np.int64)
        return np.full(self.all_parts, self.primary + self.components.index(name))


@dataclass(frozen=True)
class _Job:
    scene: Scene
    capture: Capture
    accuracy: Accuracy
    caster: Raycaster
    materials: MaterialTable
    cones: PixelCones
    patches: PixelPatches
    points: LaserPoints
    target: AreaTarget
    seed: int
    splits: _Splits
    walked: NDArray[np.bool_]
    """(K,) parts whose vertices the walk joins to the FoV in fourth-bounce paths; the others are left out, or left to
    the factorised form of `secondary.py`."""


@dataclass(frozen=True)
class _Estimate:
    components: dict[str, NDArray[np.float64]]
    parts: dict[str, NDArray[np.float64]]
    stderr: NDArray[np.float64]
    overflow: NDArray[np.float64]


def _estimate(job: _Job) -> _Estimate:
    """Average over independent scramblings; their spread is the standard error."""
    lasers, pixels, bins = job.capture.shape
    splits, lookins = job.splits, job.accuracy.lookins
    scramblings = min(job.accuracy.scramblings, lookins)
    confocal = job.capture.pairing == "confocal"
    squares = np.zeros((lasers, pixels, bins))
    overflow = np.zeros((lasers, pixels))
    rows = [np.zeros((lasers, pixels, bins)) for _ in range(splits.count)]
    existing = np.flatnonzero(job.points.part >= 0)
    for scrambling in range(scramblings):
        count = lookins // scramblings + (scrambling < lookins % scramblings)
        size = min(LOOKINS_PER_CHUNK // count, HISTOGRAM_VALUES_PER_CHUNK // (pixels * splits.count * bins))
        shared = None if confocal else _pool(job, np.arange(pixels), count, scrambling)
        for chunk in _chunks(existing, max(1, size)):
            pool = _pool(job, chunk, count, scrambling) if shared is None else shared
            tally = _trace_chunk(job, chunk, pool, count, scrambling)
            histogram = tally.histogram.reshape(-1, pixels, splits.count, bins)
            place = slice(chunk[0], chunk[0] + len(chunk))
            squares[place] += histogram.sum(axis=2) ** 2
            overflow[place] += tally.overflow.reshape(-1, pixels, splits.count).sum(axis=2)
            for k, row in enumerate(rows):
                row[place] += histogram[:, :, k]
    for row in rows:
        row /= scramblings
    parts = dict(zip(splits.parts, rows, strict=False))
    others = dict(zip(splits.components, rows[splits.primary :], strict=True))
    primary = rows[0].copy() if splits.primary > 1 else rows[0]
    for row in rows[1 : splits.primary]:
        primary += row
    components = {
        name: primary if name == "primary" else others[name]
        for name in COMPONENTS
        if name == "primary" or name in others
    }
    return _Estimate(components, parts, standard_error(rows, squares, scramblings), overflow / scramblings)


def _walked(accuracy: Accuracy, materials: MaterialTable) -> NDArray[np.bool_]:
    if accuracy.secondary == "none":
        return np.zeros(len(materials.kind), np.bool_)
    return np.ones(len(materials.kind), np.bool_) if accuracy.observed is None else ~factorising(materials)


def _add_factorised(job: _Job, estimate: _Estimate) -> None:
    """Add what the factorised form gives of the secondary; its error is independent of the walk's."""
    accuracy = job.accuracy
    assert accuracy.observed is not None
    more = secondary_transient(
        job.caster, job.scene, job.materials, job.capture, job.points, job.cones, job.patches,
        lookins=accuracy.lookins, observed=accuracy.observed, fov_samples=accuracy.fov_samples,
        scramblings=accuracy.scramblings, strongest=accuracy.strongest, seed=job.seed, carriers=~job.walked,
    )  # fmt: skip
    estimate.components["secondary"] += more.mean
    np.hypot(estimate.stderr, more.stderr, out=estimate.stderr)
    estimate.overflow[:] += more.overflow


def _chunks(lasers: NDArray[np.int64], size: int) -> list[NDArray[np.int64]]:
    """Runs of consecutive laser points, at most `size` in each; a laser ray that met nothing ends a run."""
    runs = np.split(lasers, np.flatnonzero(np.diff(lasers) != 1) + 1)
    return [run[k : k + size] for run in runs for k in range(0, len(run), size)] if len(lasers) else []


def _trace_chunk(job: _Job, chunk: NDArray[np.int64], pool: FovPool, count: int, scrambling: int) -> Tally:
    """One scrambling's light from a run of laser points: a walk that joins every vertex to the FoV."""
    receiver = _receiver(job, chunk, pool)
    last = job.accuracy.max_bounces
    if job.accuracy.direct:
        _add_direct(job, receiver, chunk, count, scrambling)
    steps = SOBOL_STEPS + 1 if last is None else last - 2
    vertices = draw_lookins(
        job.caster, job.scene, job.materials, job.points, chunk, count, job.target, job.seed, scrambling, steps
    )
    if last == 4 and not job.walked.any():
        last = 3
    order = 3
    while len(vertices):
        numbers = vertices.numbers(order - 3)
        split_of_part = job.splits.of_part(order)
        joined = np.flatnonzero(job.walked[vertices.part]) if order == 4 else np.arange(len(vertices))
        receiver.connect(vertices.take(joined), numbers[joined, 0], split_of_part)
        if order == last:
            joined = joined[receiver.near(vertices.take(joined))]
            vertices, numbers, joined = vertices.take(joined), numbers[joined], np.arange(len(joined))
        hits, directions, throughput = scattered_rays(job.caster, job.materials, vertices, numbers)
        receiver.follow(
            vertices.take(joined), hits.take(joined), directions[joined], throughput[joined], split_of_part
        )
        if order == last:
            break
        if last is None and order >= ROULETTE_FROM:
            survival = np.clip(throughput, *SURVIVAL)
            throughput = np.where(numbers[:, 3] < survival, throughput / survival, 0.0)
        vertices = continued(job.scene, vertices, hits, directions, throughput)
        order += 1
    return receiver.tally


def _add_direct(job: _Job, receiver: Receiver, chunk: NDArray[np.int64], count: int, scrambling: int) -> None:
    """One bounce: the laser point seen by a pixel. Two: a surface in the FoV that the laser point lights."""
    split_of_part = job.splits.of_part(2)
    receiver.spots(job.points, chunk, int(split_of_part[0]))
    spots = spot_vertices(job.points, chunk, count, job.seed, scrambling, job.scene.attenuation_per_m)
    numbers = spots.numbers(0)
    receiver.connect(spots, numbers[:, 0], split_of_part)
    near = receiver.near(spots)
    spots, numbers = spots.take(near), numbers[near]
    hits, directions, throughput = scattered_rays(job.caster, job.materials, spots, numbers)
    receiver.follow(spots, hits, directions, throughput, split_of_part)


def _receiver(job: _Job, chunk: NDArray[np.int64], pool: FovPool) -> Receiver:
    _, pixels, bins = job.capture.shape
    confocal = job.capture.pairing == "confocal"
    axis = job.capture.time
    seen = chunk if confocal else np.arange(pixels)
    device_leg = job.points.leg[chunk] if axis.origin == "source" else np.full(len(chunk), -1.0)
    rows = len(chunk) * pixels * job.splits.count
    return Receiver(
        job.caster, job.scene, job.materials, job.capture.sensor, pool, job.cones.take(seen), job.patches.take(seen),
        job.accuracy.fov_samples,
        Clock(1.0 / float(path_from_time(axis.width_s)), axis.start_s / axis.width_s, device_leg),
        Rows(int(chunk[0]), confocal, pixels, job.splits.count),
        Tally(np.zeros((rows, bins)), np.zeros(rows)),
    )  # fmt: skip


def _pool(job: _Job, pixels: NDArray[np.int64], count: int, scrambling: int) -> FovPool:
    """Enough blocks of FoV points for what varies across the pixel (arrival times by the bin, amplitudes by some
    hundredth of the scene), never more than lookins to use them or memory to hold them; a power of two, so that they
    cover the pixel evenly."""
    samples = job.accuracy.fov_samples
    detail_m = min(float(path_from_time(job.capture.time.width_s)), job.caster.half_extent_m / 50)
    across = 2 * float(job.patches.radius[pixels].max()) / detail_m
    useful = 64 * (1 + across) ** 2 / samples
    affordable = FOV_POINTS_PER_POOL / (len(pixels) * samples)
    blocks = 1 << max(0, int(min(count, affordable, useful)).bit_length() - 1)
    return fov_pool(
        job.caster, job.scene, job.capture.sensor, job.cones, pixels, samples, blocks,
        stream_seeds(job.seed, FOV_STREAM, scrambling, pixels),
    )  # fmt: skip
