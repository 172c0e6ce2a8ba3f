"""The transport solver: scene and capture in, transient out."""

from __future__ import annotations

import time as clock_time
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from datagen.errors import InputError
from datagen.records import Accuracy, Capture, Scene, Transient
from datagen.transport.brdf import MaterialTable
from datagen.transport.connections import Clock, Rows, Tally, connect, follow
from datagen.transport.fov import FovPool, PixelCones, PixelPatches, fov_pool
from datagen.transport.lookins import AreaTarget, LaserPoints, draw_lookins
from datagen.transport.raycast import Raycaster
from datagen.transport.sampling import stream_seeds
from datagen.units import path_from_time

FOV_STREAM = 3
LOOKINS_PER_CHUNK = 1 << 17
"""Lookins traced at once, over as many laser points as fit."""
HISTOGRAM_VALUES_PER_CHUNK = 1 << 22
"""Histogram entries filled at once (32 MiB), over as many laser points as fit."""
FOV_POINTS_PER_POOL = 1 << 19
"""FoV points kept at once, over all pixels of a chunk."""


def simulate(
    scene: Scene, capture: Capture, accuracy: Accuracy | None = None, seed: int = 0, *, split_parts: bool = True
) -> Transient:
    """Follow light from each laser point around the corner and back (three bounces: the primary).

    The photons that reach the aperture per emitted photon, with f the BRDFs, V the visibility, x₁ the laser point,
    x₂ a lookin and x₃ a FoV point (DESIGN, sec. 2; the paths are those of Eq. 6 of Scholes & Leach, Sensors 24, 6522
    (2024), with radiometric weights):

        L = ∫∫ f₁ cosθ₁ cosθ₂ V₁₂/R₁₂² · f₂ · cosθ₂′ cosθ₃ V₂₃/R₂₃² · f₃ cosθ₃′ V₃ₛ A/R₃ₛ² dA₂ dA₃

    Parameters
    ----------
    scene, capture : what is looked at, and how.
    accuracy : sample counts; default `Accuracy()`.
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
    cones = PixelCones.of(capture.sensor)
    points = LaserPoints.of(caster, scene, capture.laser)
    job = _Job(
        scene, capture, caster, cones, MaterialTable.of(scene.materials),
        PixelPatches.of(caster, capture.sensor, cones, accuracy.fov_samples), points,
        AreaTarget.choose(caster, scene, points, seed), seed, split_parts,
    )  # fmt: skip
    prepared = clock_time.perf_counter()
    transient = _primary(job, accuracy)
    finished = clock_time.perf_counter()
    return Transient(
        time=capture.time,
        components={"primary": transient.mean},
        parts=transient.parts,
        stderr=transient.stderr,
        overflow=transient.overflow,
        laser_points=points.position,
        seconds={"prepare": prepared - began, "primary": finished - prepared},
    )


@dataclass(frozen=True)
class _Job:
    scene: Scene
    capture: Capture
    caster: Raycaster
    cones: PixelCones
    materials: MaterialTable
    patches: PixelPatches
    points: LaserPoints
    target: AreaTarget
    seed: int
    split_parts: bool


@dataclass(frozen=True)
class _Estimate:
    mean: NDArray[np.float64]
    parts: dict[str, NDArray[np.float64]]
    stderr: NDArray[np.float64]
    overflow: NDArray[np.float64]


def _primary(job: _Job, accuracy: Accuracy) -> _Estimate:
    """Average over independent scramblings; their spread is the standard error."""
    lasers, pixels, bins = job.capture.shape
    confocal = job.capture.pairing == "confocal"
    names = job.scene.part_names if job.split_parts else ()
    splits = max(len(names), 1)
    scramblings = min(accuracy.scramblings, accuracy.lookins)
    total = np.zeros((lasers, pixels, bins))
    squares = np.zeros_like(total)
    overflow = np.zeros((lasers, pixels))
    parts = {name: np.zeros_like(total) for name in names}
    existing = np.flatnonzero(job.points.part >= 0)
    for scrambling in range(scramblings):
        count = accuracy.lookins // scramblings + (scrambling < accuracy.lookins % scramblings)
        size = min(LOOKINS_PER_CHUNK // count, HISTOGRAM_VALUES_PER_CHUNK // (pixels * splits * bins))
        shared = None if confocal else _pool(job, accuracy, np.arange(pixels), count, scrambling)
        for chunk in _chunks(existing, max(1, size)):
            pool = _pool(job, accuracy, chunk, count, scrambling) if shared is None else shared
            tally = _trace_chunk(job, accuracy, chunk, pool, count, scrambling, splits)
            histogram = tally.histogram.reshape(-1, pixels, splits, bins)
            summed = histogram[:, :, 0] if splits == 1 else histogram.sum(axis=2)
            rows = slice(chunk[0], chunk[0] + len(histogram))
            total[rows] += summed
            squares[rows] += summed**2
            overflow[rows] += tally.overflow.reshape(-1, pixels, splits).sum(axis=2)
            for k, name in enumerate(names):
                parts[name][rows] += histogram[:, :, k]
    mean = total / scramblings
    if scramblings > 1:
        variance = np.maximum(squares / scramblings - mean**2, 0.0)
        stderr = np.sqrt(variance / (scramblings - 1))
    else:
        stderr = np.full_like(mean, np.nan)
    return _Estimate(
        mean, {name: values / scramblings for name, values in parts.items()}, stderr, overflow / scramblings
    )


def _chunks(lasers: NDArray[np.int64], size: int) -> list[NDArray[np.int64]]:
    """Runs of consecutive laser points, at most `size` in each; a laser ray that met nothing ends a run."""
    runs = np.split(lasers, np.flatnonzero(np.diff(lasers) != 1) + 1)
    return [run[k : k + size] for run in runs for k in range(0, len(run), size)] if len(lasers) else []


def _trace_chunk(
    job: _Job,
    accuracy: Accuracy,
    chunk: NDArray[np.int64],
    pool: FovPool,
    count: int,
    scrambling: int,
    splits: int,
) -> Tally:
    _, pixels, bins = job.capture.shape
    confocal = job.capture.pairing == "confocal"
    sensor, axis = job.capture.sensor, job.capture.time
    device_legs = axis.origin == "source"
    split_of_part = np.arange(splits, dtype=np.int64) if splits > 1 else np.zeros(len(job.scene.part_names), np.int64)
    clock = Clock(1.0 / float(path_from_time(axis.width_s)), axis.start_s / axis.width_s)
    tally = Tally(np.zeros((len(chunk) * pixels * splits, bins)), np.zeros(len(chunk) * pixels * splits))
    lookins = draw_lookins(
        job.caster, job.scene, job.materials, job.points, chunk, count, job.target, job.seed, scrambling, device_legs
    )
    seen = chunk if confocal else np.arange(pixels)
    rows = Rows(int(chunk[0]), confocal, pixels, split_of_part, splits)
    patches = job.patches.take(seen)
    connect(job.caster, job.materials, lookins, pool, patches, accuracy.fov_samples, clock, rows, tally)
    follow(
        job.caster, job.scene, sensor, job.cones.take(seen), patches, job.materials,
        lookins, accuracy.fov_samples, clock, rows, tally,
        device_legs,
    )  # fmt: skip
    return tally


def _pool(job: _Job, accuracy: Accuracy, pixels: NDArray[np.int64], count: int, scrambling: int) -> FovPool:
    """Enough blocks of FoV points for the detail a time bin can show of the pixel, never more than lookins to use
    them or memory to hold them; a power of two, so that they cover the pixel evenly."""
    bin_path = float(path_from_time(job.capture.time.width_s))
    across = 2 * float(job.patches.radius[pixels].max()) / bin_path
    useful = 64 * (1 + across) ** 2 / accuracy.fov_samples
    affordable = FOV_POINTS_PER_POOL / (len(pixels) * accuracy.fov_samples)
    blocks = 1 << max(0, int(min(count, affordable, useful)).bit_length() - 1)
    return fov_pool(
        job.caster, job.scene, job.capture.sensor, job.cones, pixels, accuracy.fov_samples, blocks,
        stream_seeds(job.seed, FOV_STREAM, scrambling, pixels), job.capture.time.origin == "source",
    )  # fmt: skip
