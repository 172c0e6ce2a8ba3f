"""A script that reads a dataset ends as it should: no thread of Arrow is left that could abort the process."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

SCRIPT = """
import os, sys
import datagen as dg
from datagen.store import verify
from datagen.store.table import parquet_file, rows_of

def threads():
    return set(os.listdir("/proc/self/task")) if os.path.isdir("/proc") else set()

dg.TransientDataset      # importing begins threads of other libraries
before, folder = threads(), sys.argv[1]
data = dg.TransientDataset(folder, ("histogram", "transient"), split="train")
assert not verify(folder).problems
with open(folder + "/samples.parquet", "rb") as file:
    rows_of(parquet_file(file))
for sample in data:
    sample["histogram"].sum() + sample["transient"].sum()
# Last, so that threads of it would still be at work when the interpreter ends.
data.stats, data.parameters("box.width_m"), data.parameters("kind")
left = threads() - before
assert not left, f"{len(left)} threads are left"
"""


# With threads left behind a third of runs aborted: two hundred clean ends by chance have the chance 10⁻³⁵.
@pytest.mark.parametrize("times", [1, pytest.param(200, marks=pytest.mark.nightly)])
def test_reading_leaves_no_thread_and_the_process_ends_in_order(pristine: Path, times: int) -> None:
    environment = os.environ | {"PYTHONPATH": str(Path(__file__).resolve().parents[2]), "OMP_NUM_THREADS": "1"}
    for _ in range(times):
        subprocess.run([sys.executable, "-c", SCRIPT, pristine], env=environment, check=True)
