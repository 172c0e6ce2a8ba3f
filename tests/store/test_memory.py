"""A worker's memory does not grow with the scenes it makes."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import Future
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from here_and_now import HereAndNow, jobs_go_to

from datagen.building.build import build
from datagen.config import config_from_mapping

MOST_MB_A_1000 = 4.0
"""Growth that allocators may cause; a leak of one histogram a scene would be 8 MB."""


def resident_mb() -> float:
    status = Path("/proc/self/status").read_text()
    return next(int(line.split()[1]) for line in status.splitlines() if line.startswith("VmRSS")) / 1024


@pytest.mark.nightly
@pytest.mark.skipif(not Path("/proc/self/status").is_file(), reason="no /proc")
def test_memory_of_a_worker_is_flat(tmp_path: Path) -> None:
    """10 000 scenes made by one process that is not replaced, as a worker makes its shards."""
    assert abs(growth_mb_a_1000(tmp_path, 10_000)) < MOST_MB_A_1000


class Watched(HereAndNow):
    """An engine that notes the memory of this process after each shard."""

    def __init__(self) -> None:
        self.resident_mb: list[float] = []

    def submit(self, function: Callable[..., Any], *arguments: Any) -> Future[Any]:
        done = super().submit(function, *arguments)
        self.resident_mb.append(resident_mb())
        return done


def growth_mb_a_1000(folder: Path, scenes: int) -> float:
    """Slope of the resident memory over the shards after the first fifth, MB in 1000 scenes."""
    config = config_from_mapping({
        "scenes": scenes, "transport": {"lookins": 16, "fov_samples": 1, "max_bounces": 3},
        "capture": {"scan": {"rows": 2, "columns": 2}, "time": {"bins": 512, "bin_width_ps": 100}},
        "store": {"fields": ["histogram", "transient"], "scenes_per_shard": 16},
    })  # fmt: skip
    here = Watched()
    with jobs_go_to(here):
        build(config, folder / "set", progress=False)
    assert len(here.resident_mb) == -(-scenes // 16)
    settled = np.array(here.resident_mb[len(here.resident_mb) // 5 :])
    return float(np.polyfit(np.arange(len(settled)) * 0.016, settled, 1)[0])
