"""The scripts of docs/clusters."""

from __future__ import annotations

import importlib.util
import os
import re
import subprocess
from pathlib import Path

import pytest

from datagen.building.build import parse_shards

CLUSTERS = Path(__file__).resolve().parents[2] / "docs" / "clusters"


@pytest.mark.parametrize(("shards", "tasks"), [(20, 7), (3, 5), (64, 64)])
def test_tasks_of_a_job_array_share_all_shards(tmp_path: Path, shards: int, tasks: int) -> None:
    calls, fake = tmp_path / "calls", tmp_path / "datagen"
    fake.write_text(f'#!/bin/sh\necho "$@" >> {calls}\n')
    fake.chmod(0o755)
    for task in range(tasks):
        slurm = {"SLURM_ARRAY_TASK_ID": task, "SLURM_ARRAY_TASK_COUNT": tasks, "SLURM_CPUS_PER_TASK": 4}
        env = {"PATH": f"{tmp_path}:{os.environ['PATH']}", "SHARDS": str(shards)}
        command = ["sh", str(CLUSTERS / "slurm_array.sh"), "a config.yaml", "out.zarr"]
        subprocess.run(command, check=True, env=env | {key: str(value) for key, value in slurm.items()})
    made = [line.partition("--shards ")[2].split()[0] for line in calls.read_text().splitlines()]
    assert sorted(shard for text in made for shard in parse_shards(text, shards)) == list(range(shards))
    assert calls.read_text().startswith("build a config.yaml out.zarr --workers 4 --shards 0-")


def test_the_job_of_dask_workers_is_as_documented() -> None:
    pytest.importorskip("dask_jobqueue", reason="dask-jobqueue is not installed")
    found = importlib.util.spec_from_file_location("slurm_dask", CLUSTERS / "slurm_dask.py")
    assert found is not None and found.loader is not None
    module = importlib.util.module_from_spec(found)
    found.loader.exec_module(module)
    with module.cluster("127.0.0.1") as machines:
        script = machines.job_script()
    assert "#SBATCH --cpus-per-task=16" in script and "#SBATCH -t 24:00:00" in script
    assert "export OMP_NUM_THREADS=1" in script and {"--nthreads 1", "--nworkers 16"} <= {
        *re.findall(r"--n\w+ \d+", script)
    }
