"""How the tests run: one thread each, the long files first."""

from __future__ import annotations

import gc
import os
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from here_and_now import one_worker_here
from legible import too_small
from matplotlib.figure import Figure

# Test processes are the parallelism, as workers are in a build; read when numpy is loaded, which is later.
for _library in ("OMP", "OPENBLAS", "MKL"):
    os.environ.setdefault(f"{_library}_NUM_THREADS", "1")

# Tests start a hundred processes. Where Python is told to keep no bytecode beside sources, each of them would compile
# those of torch and numba anew, for some seconds.
if os.environ.pop("PYTHONDONTWRITEBYTECODE", ""):
    os.environ["PYTHONPYCACHEPREFIX"] = str(Path(__file__).resolve().parents[1] / ".pytest_cache/bytecode")
    sys.pycache_prefix, sys.dont_write_bytecode = os.environ["PYTHONPYCACHEPREFIX"], False

FIRST = (
    "physics/test_accuracy_target.py",
    "detector/test_laws.py",
    "detector/test_samplers.py",
    "detector/test_numerics.py",
    "detector/test_interface.py",
    "store/test_fresh_noise.py",
    "store/test_growth.py",
    "store/test_object_stores.py",
    "store/test_resuming.py",
    "store/test_in_use.py",
    "store/test_items_kept.py",
    "store/test_build.py",
    "equivalence/test_all_ways.py",
    "test_pages.py",
    "formats/test_imports.py",
    "store/test_kills.py",
    "fuzz/test_fuzz_transport.py",
    "cli/test_readme.py",
    "paper/test_radiometric.py",
    "devices/test_devices_in_configs.py",
    "devices/test_compare.py",
    "effects/test_switchboard.py",
    "evidence/test_in_sight.py",
    "evidence/test_presence.py",
    "capture/test_configs_built.py",
    "physics/test_primary_truths.py",
    "physics/test_all_bounces.py",
    "report/test_reproduce.py",
)
"""A file goes to one process as a whole, in this order: the next one to the process that has two tests left. While
one process compiles the transport's kernels with the first file, the other has files that need none of them, up to
`test_all_ways.py`: it compiles those of the detector, and stores what is made up. Two processes that need a kernel at
once both compile it. A long file begun last would leave the other process idle.
"""


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    def rank(item: pytest.Item) -> int:
        file = item.nodeid.partition("::")[0].removeprefix("tests/")
        return FIRST.index(file) if file in FIRST else len(FIRST)

    items.sort(key=rank)


def pytest_collection_finish() -> None:
    """The collector need not look again and again at what the libraries brought and stays."""
    gc.freeze()


@pytest.fixture(scope="session", autouse=True)
def letters_can_be_read() -> Iterator[None]:
    """Of each picture that any test saves, whichever command or example draws it."""
    save = Figure.savefig

    def saved(figure: Figure, *given: Any, **named: Any) -> None:
        small = too_small(figure)
        assert not small, f"letters too small for a page: {small[:5]}"
        save(figure, *given, **named)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Figure, "savefig", saved)
        yield


@pytest.fixture(scope="module")
def builds_here() -> Iterator[None]:
    """Builds of one worker run in the test's own process. For files whose tests need a dataset and are not about how
    it is built: a new worker loads the kernels of the transport anew, which takes longer than most of these builds.
    """
    with one_worker_here():
        yield
