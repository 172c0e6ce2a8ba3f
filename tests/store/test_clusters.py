"""The scripts of docs/clusters, and a Dask cluster whose scheduler is lost half way."""

from __future__ import annotations

import importlib.util
import os
import re
import signal
import socket
import subprocess
import sys
import time
from pathlib import Path

import pytest
from fake_samples import fake_sample
from kills import many_shards

from datagen.building.build import build, parse_shards
from datagen.config import DatasetConfig
from datagen.records import Sample
from datagen.store.verify import dataset_digest

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


PATIENCE_S = 120.0
CHILD = """
import sys
from kills import many_shards
from test_clusters import unhurried
from datagen.building.build import build
build(many_shards(), sys.argv[1], engine="dask", scheduler=sys.argv[2], sample_function=unhurried)
"""


def unhurried(config: DatasetConfig, index: int) -> Sample:
    """A sample that takes long enough for the test to kill the scheduler in the middle of the build."""
    time.sleep(0.1)
    return fake_sample(config, index)


class Cluster:
    """A scheduler and a worker, as processes."""

    def __init__(self, folder: Path) -> None:
        with socket.socket() as free:
            free.bind(("127.0.0.1", 0))
            self.address = f"tcp://127.0.0.1:{free.getsockname()[1]}"
        # Workers fork from a server that has imported what they need.
        quick = {"DASK_DISTRIBUTED__WORKER__MULTIPROCESSING_METHOD": "forkserver"}
        here = {"PYTHONPATH": os.pathsep.join([str(Path(__file__).parent), *filter(None, sys.path)])}
        self.folder, self.environment = folder, os.environ | quick | here
        self.begin()

    def begin(self) -> None:
        """Both, anew."""
        self.running = [
            subprocess.Popen(
                [sys.executable, "-m", f"distributed.cli.dask_{part}", *arguments, "--no-dashboard"],
                env=self.environment, cwd=self.folder, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
            )
            for part, arguments in (
                ("scheduler", ["--host", self.address]),
                ("worker", [self.address, "--nthreads", "1", "--death-timeout", "60"]),
            )
        ]  # fmt: skip

    def end(self) -> None:
        for process in self.running:
            process.send_signal(signal.SIGTERM)
        for process in self.running:
            try:
                process.wait(20)
            except subprocess.TimeoutExpired:
                process.kill()
                process.wait()


@pytest.mark.nightly
def test_a_cluster_whose_scheduler_is_lost_ends_with_the_same_dataset(tmp_path: Path) -> None:
    cluster = Cluster(tmp_path)
    try:
        command = [sys.executable, "-c", CHILD, str(tmp_path / "set"), cluster.address]
        with subprocess.Popen(command, env=cluster.environment, text=True, stderr=subprocess.PIPE) as running:
            try:
                last = time.monotonic() + PATIENCE_S
                while len(list(tmp_path.glob("set/build/shard-*.json"))) < 5:
                    assert time.monotonic() < last and running.poll() is None, running.communicate()
                    time.sleep(0.05)
                cluster.running[0].kill()
                cluster.end()
                cluster.begin()
                _, said = running.communicate(timeout=PATIENCE_S)
            finally:
                running.kill()
        assert running.returncode == 0, said
        assert f"the scheduler {cluster.address} was lost; waiting" in said and "Traceback" not in said
    finally:
        cluster.end()
    build(many_shards(), tmp_path / "here", sample_function=fake_sample, progress=False)
    assert dataset_digest(tmp_path / "set") == dataset_digest(tmp_path / "here")
