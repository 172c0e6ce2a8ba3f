"""A build on the workers of a SLURM cluster: `pip install 'nlos-datagen[cluster]' dask-jobqueue`, on the login node.

python docs/clusters/slurm_dask.py rooms.yaml /scratch/rooms.zarr
"""

from __future__ import annotations

import sys
from typing import Any

import datagen as dg


def cluster(host: str | None = None) -> Any:
    """Jobs of 16 workers, one core each: a worker is one process with one thread, as everywhere. `host`: the login
    node's address that compute nodes see, where it has several."""
    from dask_jobqueue import SLURMCluster

    one_thread = "export OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 MKL_NUM_THREADS=1 NUMBA_NUM_THREADS=1"
    return SLURMCluster(
        cores=16, processes=16, memory="32GB", walltime="24:00:00", job_script_prologue=[one_thread],
        worker_extra_args=["--lifetime", "23h", "--lifetime-stagger", "10m"],
        scheduler_options={"host": host, "dashboard_address": "127.0.0.1:0"},
    )  # fmt: skip


if __name__ == "__main__":
    with cluster() as machines:
        machines.scale(jobs=64)
        print(dg.build(dg.load_config(sys.argv[1]), sys.argv[2], engine="dask", scheduler=machines.scheduler_address))
