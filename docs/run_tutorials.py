"""Runs tutorials, and keeps them with what they print and draw, of which the pages are made: `make docs`.

python docs/run_tutorials.py docs/tutorials/*.ipynb out/tutorials
"""

from __future__ import annotations

import os
import sys
import tempfile
import time
from pathlib import Path

import nbformat
from nbclient import NotebookClient

LONGEST_CELL_S = 600
"""Many times what any of them takes; the first one of all compiles the kernels of the light."""


def run(source: Path, out: Path) -> float:
    """Run a notebook in an empty folder of its own and write it with its outputs to `out`; returns the seconds.

    Raises `nbclient.exceptions.CellExecutionError` with cell and traceback if a cell fails.
    """
    notebook = nbformat.read(source, as_version=4)
    began = time.perf_counter()
    # Commands (`!datagen …`) are those of this interpreter's environment, whether it was activated or not.
    path = os.pathsep.join((str(Path(sys.executable).parent), os.environ["PATH"]))
    quiet = {"OPEN3D_DISABLE_WEB_VISUALIZER": "true"}  # or open3d prints lines about a viewer that nobody asked for
    with tempfile.TemporaryDirectory() as folder:
        client = NotebookClient(
            notebook, timeout=LONGEST_CELL_S, kernel_name="python3", resources={"metadata": {"path": folder}},
            # Or each kernel warns that it talks to this process without encryption, which stays on this machine.
            extra_arguments=["--log-level=ERROR"],
        )  # fmt: skip
        client.execute(env=os.environ | quiet | {"PATH": path})
    out.parent.mkdir(parents=True, exist_ok=True)
    nbformat.write(notebook, out)
    return time.perf_counter() - began


if __name__ == "__main__":
    *notebooks, folder = map(Path, sys.argv[1:])
    for notebook in notebooks:
        print(f"{notebook}: {run(notebook, folder / notebook.name):.0f} s", flush=True)
