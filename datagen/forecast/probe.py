"""What worker processes cost beside their scenes: started and tried, as a build would."""

from __future__ import annotations

import time
from dataclasses import dataclass

import numpy as np

from datagen.building.engines import started
from datagen.config import DatasetConfig
from datagen.config.transport import TransportConfig
from datagen.forecast.pilots import Pilots, effort_reduced


@dataclass(frozen=True)
class Workers:
    """What worker processes cost beside their scenes.

    Attributes
    ----------
    startup_s : from asking for a process until its scenes go as quickly as ever: imports, compiled kernels loaded.
    startup_processor_s : processor seconds of that.
    slowdown : how many times longer a scene takes when the workers asked for are at it together; ≥ 1.
    """

    startup_s: float
    startup_processor_s: float
    slowdown: float = 1.0


def probe_workers(config: DatasetConfig, pilots: Pilots, processes: int) -> Workers:
    """Start `processes` workers as a build does, and let all of them simulate the first pilot scene twice."""
    rungs = pilots.ladder.rungs
    rung = max((p for p in rungs if p.total_s <= 1.0), key=lambda p: p.effort, default=rungs[0])
    reduced, _ = effort_reduced(config, 1 / rung.effort)
    with started("local", processes, None) as engine:
        asked = time.time()
        futures = [engine.submit(_twice, reduced, rung.index, config.transport) for _ in range(processes)]
        outcomes = [future.result() for future in futures]
    again_s = float(np.mean([outcome.again_s for outcome in outcomes]))
    return Workers(
        max(0.0, float(np.median([outcome.warm_at - asked - outcome.again_s for outcome in outcomes]))),
        max(0.0, float(np.median([outcome.processor_s - outcome.again_processor_s for outcome in outcomes]))),
        max(1.0, again_s / rung.total_s) if processes > 1 else 1.0,
    )


@dataclass(frozen=True)
class _Outcome:
    """warm_at : Unix time when the first run was through; processor_s : of the process until then; again_s,
    again_processor_s : of the second run."""

    warm_at: float
    processor_s: float
    again_s: float
    again_processor_s: float


def _twice(config: DatasetConfig, index: int, planned: TransportConfig) -> _Outcome:
    from datagen.pipeline import simulate_sample

    simulate_sample(config, index, planned)
    warm_at, processor_s = time.time(), time.process_time()
    again_s = sum(simulate_sample(config, index, planned).seconds.values())
    return _Outcome(warm_at, processor_s, again_s, time.process_time() - processor_s)
