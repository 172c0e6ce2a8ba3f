"""Meeting an accuracy target: rounds of ever more samples until the error is small enough."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from datagen.records import Spend
from datagen.transport.averages import Estimate, walk_average
from datagen.transport.walk import Job

SCRAMBLINGS = 16


def meet_target(job: Job) -> Estimate:
    """Double the lookins until the estimated relative L2 error is within the target."""
    target = job.accuracy.target
    assert target is not None
    lookins, cost, rounds = 512, 0.0, 0
    while True:
        counts = replace(job.accuracy, target=None, lookins=lookins, fov_samples=4, scramblings=SCRAMBLINGS)
        average = walk_average(replace(job, accuracy=counts))
        components, parts = average.split(job.splits)
        norm = float(np.linalg.norm(sum(components.values())))
        error = float(np.linalg.norm(average.stderr)) / norm if norm > 0 else 0.0
        cost, rounds = cost + average.work.cost, rounds + 1
        if error <= target or 2 * lookins > job.accuracy.max_lookins:
            break
        lookins *= 2
    spend = Spend(
        dict.fromkeys(components, float(lookins)), dict.fromkeys(components, 1 / len(components)),
        dict.fromkeys(components, "walk"), dict.fromkeys(components, 4), rounds, cost,
        "target met" if error <= target else "max_lookins reached before the target was met",
    )  # fmt: skip
    return Estimate(components, parts, average.stderr, average.overflow, spend, error, error <= target)
