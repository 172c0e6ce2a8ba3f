"""How much of what the field of view sees stands right beside it, where path tracing from the laser seldom gets."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from datagen.seeding import LightStream
from datagen.transport.brdf import cosine_directions
from datagen.transport.path_tracing.trace import blocks_for, pool_for
from datagen.transport.problem import Problem
from datagen.transport.sampling import Streams, scrambled_sobol, stream_seeds

PIXELS, POINTS, RAYS = 8, 16, 64
"""Pixels, FoV points of each, and rays from each point that the share is estimated from, to some hundredths; with
half as many of each, to a tenth."""
VERTICES_KNOWN = 1024
"""Vertices of path tracing, spread over all surfaces: path tracing is taken to know an area that has one of them on
average. With half as many, what is near reaches √2 times as far."""
CONTACT = 0.1
"""Share of what the field of view sees that, if it stands right beside the field of view, calls for the factorised
form of the secondary. Half of it does so where path tracing does as well; twice of it leaves light that no path
meets."""


def surroundings(problem: Problem, seed: int) -> float:
    """Share, weighted by the cosine, of what the field of view sees that lies within √(area of the scene /
    `VERTICES_KNOWN`): so near that path tracing seldom has a vertex there.

    A pixel at the foot of another wall gets most of its secondary from the few centimetres beside it. Path tracing
    without a vertex there misses that light, and the scatter of its samples does not show that it is missing; the
    factorised form starts from the FoV points and finds the light at once.
    """
    pixels = np.arange(len(problem.patches.radius))
    few = np.unique(pixels[np.linspace(0, len(pixels) - 1, min(len(pixels), PIXELS)).astype(int)])
    one_each = replace(
        problem, seed=seed, accuracy=replace(problem.accuracy, target=None, part_target=None, fov_samples=1)
    )
    pool = pool_for(one_each, few, blocks_for(one_each, few, POINTS), Streams.of(seed, np.zeros(1, np.int64), few))
    seen = pool.part >= 0
    if not seen.any():
        return 0.0
    position = np.repeat(pool.position[seen], RAYS, axis=0)
    normal = np.repeat(pool.normal[seen], RAYS, axis=0)
    numbers = scrambled_sobol(stream_seeds(seed, LightStream.CLUSTERS), len(position), 2)[0]
    hits = problem.caster.leaving(position, normal, cosine_directions(normal, numbers))
    reach = math.sqrt(float(problem.caster.face_area_m2.sum()) / VERTICES_KNOWN)
    return float((hits.valid & (np.linalg.norm(hits.position - position, axis=1) < reach)).mean())
