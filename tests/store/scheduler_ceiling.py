"""How many shards a second one Dask scheduler hands out at most: jobs that do nothing, through the engine of a build.

python tests/store/scheduler_ceiling.py
"""

from __future__ import annotations

import logging
import time
from concurrent.futures import FIRST_COMPLETED, Future, wait
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from datagen.building.engines import started
from datagen.building.shard_job import Recipe
from datagen.config import load_config
from datagen.pipeline import simulate_sample
from datagen.store import prepare
from datagen.store.environment import made_with

JOBS, RESERVE = 2000, 200
"""Number of jobs, and of jobs under way at once (those of a hundred workers)."""


def nothing(recipe: Recipe, shard: int, submitted: float) -> dict[int, str]:
    """The result of a shard without failures, at once."""
    return {}


def main() -> None:
    config = load_config("configs/quickstart.yaml")
    with TemporaryDirectory() as folder:
        recipe = Recipe(Path(folder), config, prepare(Path(folder), config), simulate_sample, made_with())
    logging.getLogger("distributed").setLevel(logging.CRITICAL)
    with started("dask", 2, None) as engine:
        for jobs in (RESERVE, JOBS):
            begun, spent, left = time.perf_counter(), time.process_time(), jobs
            running: set[Future[Any]] = set()
            while left or running:
                while left and len(running) < RESERVE:
                    left -= 1
                    running.add(engine.submit(nothing, recipe, left, 0.0))
                _, running = wait(running, return_when=FIRST_COMPLETED)
            seconds, spent = time.perf_counter() - begun, time.process_time() - spent
        print(f"{jobs / seconds:.0f} jobs a second, {1e3 * spent / jobs:.1f} ms of one core for each")


if __name__ == "__main__":
    main()
