"""What stands right beside the field of view, where walks from the laser seldom come by."""

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
"""Pixels looked at, FoV points of each, and rays from each point."""
VERTICES_KNOWN = 1024
"""Vertices, spread over all surfaces, that are taken to know what an area that has one of them on average gives."""
CONTACT = 0.1
"""Share of what the field of view sees from which surfaces right beside it decide how the secondary is found."""


def surroundings(task: Problem, seed: int) -> float:
    """Share, by cosine, of what the field of view sees that is so near that a walk would seldom be there.

    A pixel at the foot of another wall gets most of its secondary from the few centimetres beside it. A walk that has
    not been there yet knows nothing of that light, and neither does its scatter; the factorised form starts from the
    FoV points and finds it at once. Near is what is within the square root of a scene's area for each of
    `VERTICES_KNOWN` vertices.
    """
    pixels = np.arange(len(task.patches.radius))
    few = np.unique(pixels[np.linspace(0, len(pixels) - 1, min(len(pixels), PIXELS)).astype(int)])
    one_each = replace(task, seed=seed, accuracy=replace(task.accuracy, target=None, part_target=None, fov_samples=1))
    pool = pool_for(one_each, few, blocks_for(one_each, few, POINTS), Streams.of(seed, np.zeros(1, np.int64), few))
    seen = pool.part >= 0
    if not seen.any():
        return 0.0
    position = np.repeat(pool.position[seen], RAYS, axis=0)
    normal = np.repeat(pool.normal[seen], RAYS, axis=0)
    numbers = scrambled_sobol(stream_seeds(seed, LightStream.SURROUNDINGS), len(position), 2)[0]
    hits = task.caster.leaving(position, normal, cosine_directions(normal, numbers))
    reach = math.sqrt(float(task.caster.face_area_m2.sum()) / VERTICES_KNOWN)
    return float((hits.valid & (np.linalg.norm(hits.position - position, axis=1) < reach)).mean())
